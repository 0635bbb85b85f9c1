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
}

#[cfg(test)]
mod tests {
    use super::*;

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
