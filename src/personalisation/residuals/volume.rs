//! Simulated against measured cavity volume, frame by frame, over the standard deviation of the measurement.

use super::{CalibrationTrajectory, Loss};
use crate::anatomy::Ventricle;
use crate::personalisation::{Cluster, PersonalisationError, Residual};

/// r_k = (V(t_k) − V_k)/σ_V.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeCurveResidual {
    ventricle: usize,
    measured_ml: Vec<f64>,
    sd_ml: f64,
    loss: Loss,
}

impl VolumeCurveResidual {
    /// Compares `ventricle` with a volume a frame, `measured_ml`, whose standard deviation is `sd_ml`.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] if the standard deviation is not positive or a volume is not positive and finite.
    pub fn new(ventricle: Ventricle, measured_ml: Vec<f64>, sd_ml: f64) -> Result<Self, PersonalisationError> {
        if !(sd_ml.is_finite() && sd_ml > 0.0) {
            let remedy = "the standard deviation of a measured volume must be positive";
            return Err(PersonalisationError::Setting { what: "volume_sd_ml", value: sd_ml, remedy });
        }
        if let Some(&value) = measured_ml.iter().find(|volume| !(volume.is_finite() && **volume > 0.0)) {
            return Err(PersonalisationError::Setting { what: "measured volume, mL", value, remedy: "must be positive and finite" });
        }
        let ventricle = match ventricle {
            Ventricle::Left => 0,
            Ventricle::Right => 1,
        };
        Ok(Self { ventricle, measured_ml, sd_ml, loss: Loss::Squares })
    }

    /// With another loss.
    #[must_use]
    pub fn with_loss(mut self, loss: Loss) -> Self {
        self.loss = loss;
        self
    }

    /// Root mean square difference in mL.
    pub fn rms_ml(&self, trajectory: &CalibrationTrajectory) -> f64 {
        let mut rows = vec![0.0; self.row_count()];
        self.evaluate(trajectory, &mut rows);
        self.sd_ml * crate::numerics::root_mean_square(&rows)
    }
}

impl Residual<CalibrationTrajectory> for VolumeCurveResidual {
    fn row_count(&self) -> usize {
        self.measured_ml.len()
    }

    fn evaluate(&self, trajectory: &CalibrationTrajectory, rows: &mut [f64]) {
        for (frame, (row, measured_ml)) in rows.iter_mut().zip(&self.measured_ml).enumerate() {
            *row = (trajectory.volume_ml(frame, self.ventricle) - measured_ml) / self.sd_ml;
        }
    }

    fn apply_tangent(&self, _: &CalibrationTrajectory, tangent: &CalibrationTrajectory, rows: &mut [f64]) {
        for (frame, row) in rows.iter_mut().enumerate() {
            *row = tangent.volume_ml(frame, self.ventricle) / self.sd_ml;
        }
    }

    fn write_losses(&self, losses: &mut [Loss]) {
        losses.fill(self.loss);
    }

    fn write_clusters(&self, clusters: &mut [Cluster]) {
        for (frame, cluster) in clusters.iter_mut().enumerate() {
            *cluster = Cluster { place: 0, instant: frame as u32 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::personalisation::residuals::CalibrationFrame;

    fn trajectory(volumes_ml: &[f64]) -> CalibrationTrajectory {
        let frame = |&volume_ml: &f64| CalibrationFrame { volume_ml: vec![volume_ml], ..CalibrationFrame::default() };
        CalibrationTrajectory { frames: volumes_ml.iter().map(frame).collect(), ..CalibrationTrajectory::default() }
    }

    #[test]
    fn rows_are_differences_over_their_standard_deviation() {
        let residual = VolumeCurveResidual::new(Ventricle::Left, vec![100.0, 60.0], 2.0).unwrap();
        let mut rows = [0.0; 2];
        residual.evaluate(&trajectory(&[104.0, 59.0]), &mut rows);
        assert_eq!(rows, [2.0, -0.5]);
        residual.apply_tangent(&trajectory(&[104.0, 59.0]), &trajectory(&[3.0, 0.0]), &mut rows);
        assert_eq!(rows, [1.5, 0.0]);
        assert!((residual.rms_ml(&trajectory(&[104.0, 59.0])) - 8.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn bad_measurements_are_refused_and_missing_frames_are_not_silent() {
        assert!(VolumeCurveResidual::new(Ventricle::Left, vec![100.0], 0.0).is_err());
        assert!(VolumeCurveResidual::new(Ventricle::Left, vec![f64::NAN], 1.0).is_err());
        let residual = VolumeCurveResidual::new(Ventricle::Right, vec![100.0], 1.0).unwrap();
        let mut rows = [0.0];
        residual.evaluate(&trajectory(&[100.0]), &mut rows);
        assert!(rows[0].is_nan(), "an LV-only trajectory has no right volume");
    }
}
