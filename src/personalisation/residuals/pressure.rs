//! Simulated against measured cavity pressure, at the frames where it was measured, over the standard deviation of the measurement.

use super::{CalibrationTrajectory, Loss};
use crate::anatomy::Ventricle;
use crate::personalisation::{PersonalisationError, Residual};

/// r = (p(t_k) − p_k)/σ_p.
#[derive(Debug, Clone, PartialEq)]
pub struct PressureResidual {
    ventricle: usize,
    /// Frame and pressure, kPa.
    measured: Vec<(usize, f64)>,
    sd_kpa: f64,
}

impl PressureResidual {
    /// Compares `ventricle` with pressures (kPa) at some frames, whose standard deviation is `sd_kpa`.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] if the standard deviation is not positive or a pressure not finite.
    pub fn new(ventricle: Ventricle, measured: Vec<(usize, f64)>, sd_kpa: f64) -> Result<Self, PersonalisationError> {
        if !(sd_kpa.is_finite() && sd_kpa > 0.0) {
            let remedy = "the standard deviation of a measured pressure must be positive";
            return Err(PersonalisationError::Setting { what: "sigma_pressure_kpa", value: sd_kpa, remedy });
        }
        if let Some(&(_, value)) = measured.iter().find(|(_, pressure)| !pressure.is_finite()) {
            return Err(PersonalisationError::Setting { what: "measured pressure, kPa", value, remedy: "must be finite" });
        }
        Ok(Self { ventricle: usize::from(ventricle == Ventricle::Right), measured, sd_kpa })
    }

    fn pressure_kpa(&self, trajectory: &CalibrationTrajectory, frame: usize) -> f64 {
        trajectory.frames.get(frame).and_then(|frame| frame.pressure_kpa.get(self.ventricle)).copied().unwrap_or(f64::NAN)
    }
}

impl Residual<CalibrationTrajectory> for PressureResidual {
    fn row_count(&self) -> usize {
        self.measured.len()
    }

    fn evaluate(&self, trajectory: &CalibrationTrajectory, rows: &mut [f64]) {
        for (row, &(frame, measured_kpa)) in rows.iter_mut().zip(&self.measured) {
            *row = (self.pressure_kpa(trajectory, frame) - measured_kpa) / self.sd_kpa;
        }
    }

    fn apply_tangent(&self, _: &CalibrationTrajectory, tangent: &CalibrationTrajectory, rows: &mut [f64]) {
        for (row, &(frame, _)) in rows.iter_mut().zip(&self.measured) {
            *row = self.pressure_kpa(tangent, frame) / self.sd_kpa;
        }
    }

    fn write_losses(&self, losses: &mut [Loss]) {
        losses.fill(Loss::Squares);
    }
}
