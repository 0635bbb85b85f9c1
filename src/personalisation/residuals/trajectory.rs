//! The part of a simulated beat that data speak of: volumes and positions at the image times.

use nalgebra::Vector3;

use crate::personalisation::tangents::LinearTrajectory;

/// The heart at one image time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CalibrationFrame {
    /// Cavity volume a ventricle (left, then right), mL.
    pub volume_ml: Vec<f64>,
    /// Cavity pressure a ventricle, kPa; may be empty where no pressure is compared.
    pub pressure_kpa: Vec<f64>,
    /// Positions that surface targets refer to by index, mm (all vertices, or those of the surfaces); may be empty.
    pub position_mm: Vec<Vector3<f64>>,
}

/// The heart at all image times; a tangent has the same shape.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CalibrationTrajectory {
    /// One entry an image.
    pub frames: Vec<CalibrationFrame>,
    /// td of the vertices, s; may be empty where no times are compared.
    pub activation_s: Vec<f64>,
}

impl LinearTrajectory for CalibrationTrajectory {
    fn difference_quotient(&self, base: &Self, step: f64) -> Self {
        let frames = self.frames.iter().zip(&base.frames);
        Self {
            frames: frames
                .map(|(there, here)| CalibrationFrame {
                    volume_ml: there.volume_ml.difference_quotient(&here.volume_ml, step),
                    pressure_kpa: there.pressure_kpa.difference_quotient(&here.pressure_kpa, step),
                    position_mm: there.position_mm.difference_quotient(&here.position_mm, step),
                })
                .collect(),
            activation_s: self.activation_s.difference_quotient(&base.activation_s, step),
        }
    }
}

impl CalibrationTrajectory {
    /// Volume of a ventricle at a frame; NaN where the simulation has none, so that the calibration stops and names the row.
    pub(super) fn volume_ml(&self, frame: usize, ventricle: usize) -> f64 {
        self.frames.get(frame).and_then(|frame| frame.volume_ml.get(ventricle)).copied().unwrap_or(f64::NAN)
    }

    /// Position of a vertex at a frame; NaN where the simulation has none.
    pub(super) fn position_mm(&self, frame: usize, vertex: usize) -> Vector3<f64> {
        let position = self.frames.get(frame).and_then(|frame| frame.position_mm.get(vertex));
        position.copied().unwrap_or_else(|| Vector3::repeat(f64::NAN))
    }
}
