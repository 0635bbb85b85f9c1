//! The beating surface of the heart for the page: positions by frame in 65536 steps of its box, values by vertex in 256 steps of their range.

use nalgebra::Vector3;
use serde::Serialize;

use super::colour::Scale;
use super::pack::{bytes_of, long_words_of, words_of};
use crate::report::figures::SurfaceView;

/// A surface that moves, with what it can be coloured by.
#[derive(Debug, Clone, PartialEq)]
pub struct BeatingHeart {
    /// Positions of the surface's vertices by frame, mm.
    pub frames_mm: Vec<Vec<Vector3<f64>>>,
    /// The parts of the surface with their names and triangles.
    pub parts: Vec<(String, Vec<[usize; 3]>)>,
    /// What it can be coloured by.
    pub fields: Vec<SurfaceField>,
    /// Sides that it can be seen from, the first one at the start.
    pub views: Vec<SurfaceView>,
}

/// A quantity on the vertices of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceField {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Values by vertex.
    pub values: SurfaceValues,
    /// Colours.
    pub scale: Scale,
}

/// Values by vertex.
#[derive(Debug, Clone, PartialEq)]
pub enum SurfaceValues {
    /// The same in every frame.
    Constant(Vec<f64>),
    /// By frame.
    ByFrame(Vec<Vec<f64>>),
}

/// What the script shows.
#[derive(Debug, Serialize)]
pub(super) struct HeartRecord {
    /// The corner of the box and its size, mm.
    low_mm: [f64; 3],
    size_mm: [f64; 3],
    positions: Vec<String>,
    parts: Vec<PartRecord>,
    fields: Vec<FieldRecord>,
    views: Vec<ViewRecord>,
}

#[derive(Debug, Serialize)]
struct PartRecord {
    name: String,
    triangles: String,
}

#[derive(Debug, Serialize)]
struct FieldRecord {
    name: String,
    unit: String,
    range: (f64, f64),
    scale: Scale,
    values: Vec<String>,
}

#[derive(Debug, Serialize)]
struct ViewRecord {
    name: String,
    to_eye: [f64; 3],
    up: [f64; 3],
}

impl SurfaceValues {
    fn arrays(&self) -> &[Vec<f64>] {
        match self {
            Self::Constant(values) => std::slice::from_ref(values),
            Self::ByFrame(frames) => frames,
        }
    }
}

impl BeatingHeart {
    /// The surface as the script takes it.
    pub(super) fn record(&self) -> HeartRecord {
        let points = || self.frames_mm.iter().flatten();
        let extreme =
            |pick: fn(f64, f64) -> f64, from: f64| points().fold(Vector3::repeat(from), |extreme, point| extreme.zip_map(point, pick));
        let (low, high) = (extreme(f64::min, f64::INFINITY), extreme(f64::max, f64::NEG_INFINITY));
        let size = (high - low).map(|length| if length.is_finite() && length > 0.0 { length } else { 1.0 });
        let step = |place: f64| (place * f64::from(u16::MAX)).round().clamp(0.0, f64::from(u16::MAX)) as u16;
        let packed =
            |frame: &Vec<Vector3<f64>>| words_of(frame.iter().flat_map(|point| (point - low).component_div(&size).map(step).data.0[0]));
        let part = |(name, triangles): &(String, Vec<[usize; 3]>)| PartRecord {
            name: name.clone(),
            triangles: long_words_of(triangles.iter().flatten().map(|&corner| corner as u32)),
        };
        let view = |view: &SurfaceView| ViewRecord {
            name: view.name.clone(),
            to_eye: view.to_eye.normalize().into(),
            up: view.up.normalize().into(),
        };
        HeartRecord {
            low_mm: low.into(),
            size_mm: size.into(),
            positions: self.frames_mm.iter().map(packed).collect(),
            parts: self.parts.iter().map(part).collect(),
            fields: self.fields.iter().map(field).collect(),
            views: self.views.iter().map(view).collect(),
        }
    }
}

fn field(field: &SurfaceField) -> FieldRecord {
    let arrays = field.values.arrays();
    let range = field.scale.range(trimmed(arrays).into_iter());
    FieldRecord {
        name: field.name.clone(),
        unit: field.unit.clone(),
        range,
        scale: field.scale,
        values: arrays.iter().map(|values| bytes_of(values.iter().copied(), range)).collect(),
    }
}

/// All values but the most extreme hundredth at either end, which would wash out the colours of all others.
fn trimmed(arrays: &[Vec<f64>]) -> Vec<f64> {
    let mut values: Vec<f64> = arrays.iter().flatten().copied().filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let cut = values.len() / 100;
    values[cut..values.len() - cut].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;

    /// Positions come back to half a step of a box of some centimetres: a micrometre.
    #[test]
    fn positions_come_back_to_a_micrometre() {
        let frames_mm = vec![
            vec![Vector3::new(-12.5, 3.0, 7.0), Vector3::new(80.0, 44.4, -31.0)],
            vec![Vector3::new(-10.5, 2.0, 9.0), Vector3::new(60.0, 43.21, -20.0)],
        ];
        let heart = BeatingHeart { frames_mm: frames_mm.clone(), parts: vec![], fields: vec![], views: vec![] };
        let record = heart.record();
        for (packed, frame) in record.positions.iter().zip(&frames_mm) {
            let bytes = STANDARD.decode(packed).unwrap();
            let numbers: Vec<u16> = bytes.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
            for (vertex, point) in frame.iter().enumerate() {
                for axis in 0..3 {
                    let back = record.low_mm[axis] + record.size_mm[axis] * f64::from(numbers[3 * vertex + axis]) / 65535.0;
                    assert!((back - point[axis]).abs() < 1e-3);
                }
            }
        }
    }

    #[test]
    fn an_outlier_does_not_set_the_range() {
        let mut values: Vec<f64> = (0..200).map(f64::from).collect();
        values[7] = 1e9;
        assert!(trimmed(&[values]).iter().all(|&value| value < 200.0));
        assert!(trimmed(&[vec![f64::NAN]]).is_empty());
    }
}
