//! What an image is, for people: grid, spacing, orientation, frames, times, and what is odd about it.

use nalgebra::Vector3;

use super::{CineSequence, Grid, estimate_slice_shifts};

/// Slice shifts above this are reported, mm.
const SHIFT_REPORTED_MM: f64 = 2.5;

/// Frame steps that differ by more than this fraction are reported.
const UNEVEN_STEP: f64 = 0.1;

/// A cine sequence in a few numbers.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct CineSummary {
    /// Voxels along i, j, k.
    pub shape: [usize; 3],
    /// Distance between voxel centres, mm.
    pub spacing_mm: [f64; 3],
    /// The world direction that each voxel axis is nearest to, one letter an axis: R(ight), L(eft), A(nterior), P(osterior), S(uperior),
    /// I(nferior).
    pub orientation: String,
    /// Largest angle between an axis and that direction, degrees.
    pub obliquity_deg: f64,
    /// World position of the centre, mm.
    pub centre_mm: [f64; 3],
    /// Number of frames.
    pub frame_count: usize,
    /// First and last frame time, s.
    pub time_range_s: [f64; 2],
    /// Heart period, s.
    pub period_s: f64,
    /// Smallest and largest intensity of all frames.
    pub intensity_range: [f64; 2],
    /// What is odd, in words.
    pub warnings: Vec<String>,
}

impl CineSummary {
    /// Summarises a sequence; `warnings` of its reading come first.
    pub fn new(cine: &CineSequence, warnings: &[String]) -> Self {
        let grid = cine.grid();
        let shape = grid.shape();
        let (orientation, obliquity_deg) = orientation(grid);
        let intensities = cine.frames().iter().flat_map(|frame| frame.values()).map(|&v| f64::from(v));
        let intensity_range = intensities.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
        let times_s = cine.times_s();
        let mut warnings = warnings.to_vec();
        warnings.extend(timing_warnings(cine));
        warnings.extend(geometry_warnings(grid));
        warnings.extend(estimate_slice_shifts(cine).warnings(SHIFT_REPORTED_MM));
        Self {
            shape,
            spacing_mm: grid.spacing_mm().into(),
            orientation,
            obliquity_deg,
            centre_mm: grid.to_world_mm(&Vector3::from(shape.map(|n| 0.5 * (n as f64 - 1.0)))).into(),
            frame_count: times_s.len(),
            time_range_s: [times_s[0], times_s[times_s.len() - 1]],
            period_s: cine.period_s(),
            intensity_range,
            warnings,
        }
    }
}

fn orientation(grid: &Grid) -> (String, f64) {
    const NAMES: [[char; 2]; 3] = [['R', 'L'], ['A', 'P'], ['S', 'I']];
    let mut letters = String::new();
    let mut obliquity_deg: f64 = 0.0;
    for axis in 0..3 {
        let direction = grid.voxel_to_world().fixed_view::<3, 1>(0, axis).normalize();
        let world = direction.iamax();
        letters.push(NAMES[world][usize::from(direction[world] < 0.0)]);
        obliquity_deg = obliquity_deg.max(direction[world].abs().min(1.0).acos().to_degrees());
    }
    (letters, obliquity_deg)
}

fn timing_warnings(cine: &CineSequence) -> Option<String> {
    let times_s = cine.times_s();
    let wrap_s = times_s[0] + cine.period_s() - times_s[times_s.len() - 1];
    let steps_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).chain([wrap_s]).collect();
    let (least_s, most_s) = steps_s.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), &step| (least.min(step), most.max(step)));
    (most_s - least_s > UNEVEN_STEP * most_s)
        .then(|| format!("the time between frames varies from {:.1} to {:.1} ms round the beat", 1000.0 * least_s, 1000.0 * most_s))
}

fn geometry_warnings(grid: &Grid) -> Vec<String> {
    const SHEAR: f64 = 0.02;
    const THICK_MM: f64 = 12.0;
    let axis = |n: usize| grid.voxel_to_world().fixed_view::<3, 1>(0, n).normalize();
    let shear = [(0, 1), (0, 2), (1, 2)].map(|(a, b)| axis(a).dot(&axis(b)).abs()).into_iter().fold(0.0, f64::max);
    let mut warnings = Vec::new();
    if shear > SHEAR {
        warnings.push(format!("the voxel axes are not at right angles (cosine {shear:.3})"));
    }
    if grid.spacing_mm().z > THICK_MM {
        warnings.push(format!("the slices are {:.1} mm apart: gaps?", grid.spacing_mm().z));
    }
    if grid.shape()[2] < 5 {
        warnings.push(format!("it has {} slices only", grid.shape()[2]));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Volume;
    use nalgebra::Matrix4;

    #[test]
    fn orientation_times_and_oddities_are_told() {
        // i to the left, j to the back, k up; sheared; four slices 13 mm apart.
        let affine = Matrix4::new(-2.0, 0.0, 1.0, 5.0, 0.0, -2.0, 0.0, 6.0, 0.0, 0.0, 13.0, 7.0, 0.0, 0.0, 0.0, 1.0);
        let grid = Grid::new([3, 3, 4], affine).unwrap();
        let frame = |v: f32| Volume::new(grid.clone(), vec![v; 36]).unwrap();
        let cine = CineSequence::new(vec![frame(1.0), frame(4.0), frame(2.0)], vec![0.0, 0.2, 0.3], 0.8).unwrap();
        let summary = CineSummary::new(&cine, &["first".into()]);
        assert_eq!(summary.orientation, "LPS");
        assert!((summary.obliquity_deg - (1.0_f64 / 13.0).atan().to_degrees()).abs() < 1e-9);
        assert_eq!(summary.intensity_range, [1.0, 4.0]);
        assert_eq!(summary.centre_mm, [5.0 - 2.0 + 1.5, 4.0, 7.0 + 19.5]);
        for (n, part) in ["first", "100.0 to 500.0 ms", "right angles", "apart", "4 slices"].iter().enumerate() {
            assert!(summary.warnings[n].contains(part), "{:?}", summary.warnings);
        }
    }
}
