//! Simulated against measured depolarisation times, as a mapping catheter has them, over the standard deviation of the measurement.

use super::{CalibrationTrajectory, Loss};
use crate::personalisation::{PersonalisationError, Residual};

/// r = (td(v) − t)/σ_t.
#[derive(Debug, Clone, PartialEq)]
pub struct ActivationResidual {
    /// Vertex and time, s.
    measured: Vec<(usize, f64)>,
    sd_s: f64,
}

impl ActivationResidual {
    /// Compares td of some vertices (indices of [`CalibrationTrajectory::activation_s`]) with measured times, s.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] if the standard deviation is not positive or a time not finite.
    pub fn new(measured: Vec<(usize, f64)>, sd_s: f64) -> Result<Self, PersonalisationError> {
        if !(sd_s.is_finite() && sd_s > 0.0) {
            let remedy = "the standard deviation of a measured time must be positive";
            return Err(PersonalisationError::Setting { what: "sigma_activation_s", value: sd_s, remedy });
        }
        if let Some(&(_, value)) = measured.iter().find(|(_, time_s)| !time_s.is_finite()) {
            return Err(PersonalisationError::Setting { what: "measured depolarisation time, s", value, remedy: "must be finite" });
        }
        Ok(Self { measured, sd_s })
    }

    fn write(&self, trajectory: &CalibrationTrajectory, rows: &mut [f64], origin: impl Fn(f64) -> f64) {
        for (row, &(vertex, measured_s)) in rows.iter_mut().zip(&self.measured) {
            *row = (trajectory.activation_s.get(vertex).copied().unwrap_or(f64::NAN) - origin(measured_s)) / self.sd_s;
        }
    }
}

impl Residual<CalibrationTrajectory> for ActivationResidual {
    fn row_count(&self) -> usize {
        self.measured.len()
    }

    fn evaluate(&self, trajectory: &CalibrationTrajectory, rows: &mut [f64]) {
        self.write(trajectory, rows, |measured_s| measured_s);
    }

    fn apply_tangent(&self, _: &CalibrationTrajectory, tangent: &CalibrationTrajectory, rows: &mut [f64]) {
        self.write(tangent, rows, |_| 0.0);
    }

    fn write_losses(&self, losses: &mut [Loss]) {
        losses.fill(Loss::Squares);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::Ventricle;
    use crate::personalisation::residuals::{CalibrationFrame, PressureResidual};

    #[test]
    fn times_and_pressures_are_compared_where_they_were_measured() {
        let frame = |pressure: f64| CalibrationFrame { pressure_kpa: vec![pressure], ..CalibrationFrame::default() };
        let trajectory = CalibrationTrajectory { frames: vec![frame(1.0), frame(14.0)], activation_s: vec![0.02, 0.05] };
        let mut rows = [0.0];
        let times = ActivationResidual::new(vec![(1, 0.04)], 0.005).unwrap();
        times.evaluate(&trajectory, &mut rows);
        assert!((rows[0] - 2.0).abs() < 1e-12);
        times.apply_tangent(&trajectory, &trajectory, &mut rows);
        assert!((rows[0] - 10.0).abs() < 1e-12);
        let pressures = PressureResidual::new(Ventricle::Left, vec![(1, 13.0)], 0.5).unwrap();
        pressures.evaluate(&trajectory, &mut rows);
        assert_eq!(rows, [2.0]);
        pressures.apply_tangent(&trajectory, &trajectory, &mut rows);
        assert_eq!(rows, [28.0]);
        PressureResidual::new(Ventricle::Right, vec![(1, 3.0)], 0.5).unwrap().evaluate(&trajectory, &mut rows);
        assert!(rows[0].is_nan(), "what the heart does not have is not silently zero");
        assert!(ActivationResidual::new(vec![(0, f64::NAN)], 1.0).is_err() && PressureResidual::new(Ventricle::Left, vec![], 0.0).is_err());
    }
}
