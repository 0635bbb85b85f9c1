//! The active stress of a contracting fibre, \[Billet2009\] eq. 1.

use super::MechanicsError;

/// Contraction of one tissue, \[Billet2009\] eq. 1, repeated every beat. With $t_r = t_d + \mathrm{APD}$,
///
/// $$\sigma_C(t) = \begin{cases} \sigma_0 \left(1 - e^{k_{ATP}(t_d - t)}\right) & t_d \le t < t_r \\\\
/// \sigma_C(t_r)\, e^{k_{RS}(t_r - t)} & t_r \le t < t_d + HP \end{cases}$$
///
/// and zero before the first depolarisation. The stress tensor is $\sigma_C\, f \otimes f$.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContractionLaw {
    /// Peak contraction σ0, kPa.
    pub peak_kpa: f64,
    /// Contraction rate kATP, 1/s.
    pub contraction_rate_per_s: f64,
    /// Relaxation rate kRS, 1/s.
    pub relaxation_rate_per_s: f64,
    /// Action potential duration APD, s.
    pub action_potential_duration_s: f64,
    /// Heart period HP, s.
    pub period_s: f64,
}

/// How fast what a [`ContractionLaw`] is made of changes with something, but for σ0, which it is proportional to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ContractionRate {
    /// dkATP, 1/s.
    pub contraction_rate_per_s: f64,
    /// dkRS, 1/s.
    pub relaxation_rate_per_s: f64,
    /// dAPD, s.
    pub action_potential_duration_s: f64,
}

impl ContractionLaw {
    /// Checks the law.
    ///
    /// # Errors
    /// [`MechanicsError::Property`] if a value is negative, not finite, or the action potential outlasts the period.
    pub fn check(&self) -> Result<(), MechanicsError> {
        let positive = [
            ("contraction_rate_per_s", self.contraction_rate_per_s),
            ("relaxation_rate_per_s", self.relaxation_rate_per_s),
            ("action_potential_duration_s", self.action_potential_duration_s),
            ("heart_period_s", self.period_s),
        ];
        for (property, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(MechanicsError::Property { property, value, requirement: "finite and positive" });
            }
        }
        if !self.peak_kpa.is_finite() {
            return Err(MechanicsError::Property { property: "contraction_peak_kpa", value: self.peak_kpa, requirement: "finite" });
        }
        if self.action_potential_duration_s >= self.period_s {
            let value = self.action_potential_duration_s;
            return Err(MechanicsError::Property { property: "action_potential_duration_s", value, requirement: "below the heart period" });
        }
        Ok(())
    }

    /// σC, kPa, at a time for tissue that is first depolarised at `depolarisation_s` and then once a period.
    pub fn stress_kpa(&self, time_s: f64, depolarisation_s: f64) -> f64 {
        let since_first_s = time_s - depolarisation_s;
        if since_first_s < 0.0 || since_first_s.is_nan() {
            return 0.0;
        }
        self.stress_since_kpa(since_first_s.rem_euclid(self.period_s))
    }

    /// σC, kPa, for tissue whose latest depolarisation was `since_s` ≥ 0 ago.
    pub fn stress_since_kpa(&self, since_s: f64) -> f64 {
        let active_s = since_s.min(self.action_potential_duration_s);
        let built_up_kpa = -self.peak_kpa * (-self.contraction_rate_per_s * active_s).exp_m1();
        built_up_kpa * (-self.relaxation_rate_per_s * (since_s - active_s)).exp()
    }

    /// The derivative of [`ContractionLaw::stress_since_kpa`] where the law changes at `rate` and `since_s` at `since_rate` (dtd = −1 for
    /// later depolarisation), kPa. σC has kinks at td and tr: there it is the derivative of the later side.
    pub fn stress_since_rate_kpa(&self, rate: &ContractionRate, since_s: f64, since_rate: f64) -> f64 {
        let is_depolarised = since_s < self.action_potential_duration_s;
        let (active_s, active_rate) = match is_depolarised {
            true => (since_s, since_rate),
            false => (self.action_potential_duration_s, rate.action_potential_duration_s),
        };
        let left = (-self.contraction_rate_per_s * active_s).exp();
        let decay = (-self.relaxation_rate_per_s * (since_s - active_s)).exp();
        let building = left * (rate.contraction_rate_per_s * active_s + self.contraction_rate_per_s * active_rate);
        let decaying = rate.relaxation_rate_per_s * (since_s - active_s) + self.relaxation_rate_per_s * (since_rate - active_rate);
        self.peak_kpa * decay * (building - (1.0 - left) * decaying)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::TaylorTest;
    use nalgebra::DVector;

    const LAW: ContractionLaw = ContractionLaw {
        peak_kpa: 90.0,
        contraction_rate_per_s: 10.0,
        relaxation_rate_per_s: 25.0,
        action_potential_duration_s: 0.3,
        period_s: 0.8,
    };

    /// Fractions of σ0 reached 50, 200 and 324 ms after depolarisation, by rate; the published table of eq. 1.
    #[test]
    fn the_published_fractions_of_the_peak_are_reached() {
        for (rate, fractions) in [(5.0, [0.22, 0.63, 0.80]), (10.0, [0.39, 0.86, 0.96]), (15.0, [0.53, 0.95, 0.99])] {
            let law = ContractionLaw { contraction_rate_per_s: rate, action_potential_duration_s: 0.33, ..LAW };
            for (time_s, fraction) in [0.05, 0.2, 0.324].into_iter().zip(fractions) {
                assert!((law.stress_kpa(1.0 + time_s, 1.0) / law.peak_kpa - fraction).abs() < 0.005);
            }
        }
    }

    #[test]
    fn stress_is_continuous_at_repolarisation_and_halves_in_ln2_over_the_relaxation_rate() {
        let repolarisation_s = 0.1 + LAW.action_potential_duration_s;
        let peak_kpa = LAW.stress_kpa(repolarisation_s, 0.1);
        assert!((LAW.stress_kpa(repolarisation_s - 1e-9, 0.1) - peak_kpa).abs() < 1e-6);
        let half_s = 2f64.ln() / LAW.relaxation_rate_per_s;
        assert!((LAW.stress_kpa(repolarisation_s + half_s, 0.1) - peak_kpa / 2.0).abs() < 1e-10);
    }

    #[test]
    fn beats_repeat_and_nothing_contracts_before_the_first() {
        assert_eq!(LAW.stress_kpa(0.05, 0.1), 0.0);
        for time_s in [0.15, 0.35, 0.45, 0.7] {
            let later_kpa = LAW.stress_kpa(time_s + 3.0 * LAW.period_s, 0.1);
            assert!((later_kpa - LAW.stress_kpa(time_s, 0.1)).abs() < 1e-9);
        }
    }

    /// Depolarised and relaxing, in all that the law is made of at once.
    #[test]
    fn the_rate_of_the_stress_passes_the_taylor_test() {
        let since_s = [0.02, 0.25, 0.32, 0.6];
        let law = |x: &DVector<f64>| ContractionLaw {
            contraction_rate_per_s: x[0],
            relaxation_rate_per_s: x[1],
            action_potential_duration_s: x[2],
            ..LAW
        };
        let stress =
            |x: &DVector<f64>| Ok::<_, MechanicsError>(DVector::from_iterator(4, since_s.map(|s| law(x).stress_since_kpa(s + x[3]))));
        let base = DVector::from_vec(vec![10.0, 25.0, 0.3, 0.0]);
        let d = DVector::from_vec(vec![2.0, -3.0, 0.03, 0.02]);
        let rate = ContractionRate { contraction_rate_per_s: d[0], relaxation_rate_per_s: d[1], action_potential_duration_s: d[2] };
        let slope = DVector::from_iterator(4, since_s.map(|s| LAW.stress_since_rate_kpa(&rate, s, d[3])));
        let order = TaylorTest::run(stress, &base, &d, &slope, 0.2, 6).unwrap().order();
        assert!((order - 2.0).abs() < 0.1, "order {order}");
    }

    #[test]
    fn an_action_potential_longer_than_the_period_is_refused() {
        assert!(LAW.check().is_ok());
        assert!(ContractionLaw { period_s: 0.25, ..LAW }.check().is_err());
        assert!(ContractionLaw { contraction_rate_per_s: f64::NAN, ..LAW }.check().is_err());
    }
}
