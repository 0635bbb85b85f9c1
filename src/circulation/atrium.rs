//! Atrial pressure: a baseline with a kick before the ventricles' beat, \[Billet2009\] §2 ("the values of the pressures in the atria").

use std::f64::consts::PI;

use super::CirculationError;
use super::error::positive;

/// A given, periodic pressure of an atrium,
///
/// $$p_\text{at}(t) = p_0 + \Delta p\,\sin^2\!\Big(\pi\,\frac{t - (t_\text{e} - T)}{T}\Big) \quad\text{for } t_\text{e} - T \le t \le t_\text{e},$$
///
/// $p_0$ outside, repeated each heart period. Where the end $t_\text{e}$ comes before the ventricle contracts, the falling flank shuts the
/// valve; where it comes a little after the onset, the ventricle's rising pressure does, as in life.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtrialPressure {
    baseline_kpa: f64,
    kick_kpa: f64,
    kick_end_s: f64,
    kick_duration_s: f64,
    period_s: f64,
}

/// How fast the constants of an [`AtrialPressure`] change with something, in units of the constants per unit of that.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AtrialPressureRate {
    /// dp₀.
    pub baseline_kpa: f64,
    /// dΔp.
    pub kick_kpa: f64,
    /// dt_e.
    pub kick_end_s: f64,
    /// dT.
    pub kick_duration_s: f64,
}

impl AtrialPressure {
    /// An atrium with its baseline p₀ and kick Δp in kPa; the kick of length T ends at `kick_end_s`, modulo the period.
    /// A kick longer than the period is cut to the period.
    ///
    /// # Errors
    /// [`CirculationError::Constant`] if a duration is not positive, or a value is not finite.
    pub fn new(baseline_kpa: f64, kick_kpa: f64, kick_end_s: f64, kick_duration_s: f64, period_s: f64) -> Result<Self, CirculationError> {
        let period_s = positive("heart period", "s", period_s, false)?;
        let kick_duration_s = positive("atrial kick duration", "s", kick_duration_s, false)?.min(period_s);
        for (quantity, unit, value) in
            [("atrial pressure", "kPa", baseline_kpa), ("atrial kick", "kPa", kick_kpa), ("end of the atrial kick", "s", kick_end_s)]
        {
            if !value.is_finite() {
                return Err(CirculationError::Constant { quantity, value, unit, requirement: "a number" });
            }
        }
        Ok(Self { baseline_kpa, kick_kpa, kick_end_s, kick_duration_s, period_s })
    }

    /// Pressure at a time (any real number), kPa.
    pub fn pressure_kpa(&self, time_s: f64) -> f64 {
        let since_start_s = (time_s - self.kick_end_s + self.kick_duration_s).rem_euclid(self.period_s);
        if since_start_s >= self.kick_duration_s {
            return self.baseline_kpa;
        }
        self.baseline_kpa + self.kick_kpa * (PI * since_start_s / self.kick_duration_s).sin().powi(2)
    }

    /// The derivative of the pressure at a time where the constants change at the given rates, kPa; it exists everywhere, for the kick
    /// begins and ends level.
    pub fn pressure_rate_kpa(&self, rate: &AtrialPressureRate, time_s: f64) -> f64 {
        let since_start_s = (time_s - self.kick_end_s + self.kick_duration_s).rem_euclid(self.period_s);
        if since_start_s >= self.kick_duration_s {
            return rate.baseline_kpa;
        }
        let share = since_start_s / self.kick_duration_s;
        let share_rate = (rate.kick_duration_s - rate.kick_end_s - share * rate.kick_duration_s) / self.kick_duration_s;
        let (sine, cosine) = (PI * share).sin_cos();
        rate.baseline_kpa + rate.kick_kpa * sine * sine + self.kick_kpa * 2.0 * PI * sine * cosine * share_rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::TaylorTest;
    use nalgebra::DVector;

    /// At times before, within and after the kick, and two heart periods later.
    #[test]
    fn the_rate_of_the_pressure_passes_the_taylor_test() {
        let times_s = [-0.11, -0.07, -0.03, 0.01, 0.3, 1.57];
        let pressures = |x: &DVector<f64>| {
            let atrium = AtrialPressure::new(x[0], x[1], x[2], x[3], 0.8)?;
            Ok::<_, CirculationError>(DVector::from_iterator(6, times_s.map(|t| atrium.pressure_kpa(t))))
        };
        let base = DVector::from_vec(vec![1.0, 0.5, 0.02, 0.12]);
        let d = DVector::from_vec(vec![0.3, -0.2, 0.02, 0.05]);
        let atrium = AtrialPressure::new(base[0], base[1], base[2], base[3], 0.8).unwrap();
        let rate = AtrialPressureRate { baseline_kpa: d[0], kick_kpa: d[1], kick_end_s: d[2], kick_duration_s: d[3] };
        let slope = DVector::from_iterator(6, times_s.map(|t| atrium.pressure_rate_kpa(&rate, t)));
        let order = TaylorTest::run(pressures, &base, &d, &slope, 0.1, 6).unwrap().order();
        assert!((order - 2.0).abs() < 0.1, "order {order}");
    }

    #[test]
    fn the_kick_ends_when_told_and_repeats_each_period() {
        let atrium = AtrialPressure::new(1.0, 0.5, 0.02, 0.12, 0.8).unwrap();
        assert!((atrium.pressure_kpa(0.02) - 1.0).abs() < 1e-12);
        assert!((atrium.pressure_kpa(-0.04) - 1.5).abs() < 1e-12, "half of the kick before its end it peaks");
        assert_eq!(atrium.pressure_kpa(-0.11), 1.0);
        for beat in -3..4 {
            let shift_s = 0.8 * f64::from(beat);
            assert!((atrium.pressure_kpa(-0.01 + shift_s) - atrium.pressure_kpa(-0.01)).abs() < 1e-12);
        }
    }

    /// The integral of sin² over a half period is half its length: a kick of 0.5 kPa over 0.12 s adds 0.03 kPa·s.
    #[test]
    fn the_kick_has_the_area_of_its_closed_form() {
        let atrium = AtrialPressure::new(0.0, 0.5, 0.5, 0.12, 0.8).unwrap();
        let count = 8000;
        let area: f64 =
            (0..count).map(|i| atrium.pressure_kpa(0.8 * f64::from(i) / f64::from(count))).sum::<f64>() * 0.8 / f64::from(count);
        assert!((area - 0.03).abs() < 1e-9, "{area}");
    }

    #[test]
    fn a_period_of_zero_is_refused() {
        assert!(AtrialPressure::new(1.0, 0.5, 0.0, 0.1, 0.0).is_err());
        assert!(AtrialPressure::new(f64::NAN, 0.5, 0.0, 0.1, 0.8).is_err());
    }
}
