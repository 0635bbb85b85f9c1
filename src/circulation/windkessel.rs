//! The three-element Windkessel behind a ventricle, \[Billet2009\] §2, \[Westerhof2009\].

use super::CirculationError;
use super::error::positive;

/// Arteries as a characteristic impedance Z in front of a compliance C that drains through a resistance R:
///
/// $$C\,\dot p_C = q - \frac{p_C - p_v}{R}, \qquad p_\text{ar} = p_C + Z q.$$
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Windkessel {
    resistance_kpa_s_per_ml: f64,
    impedance_kpa_s_per_ml: f64,
    compliance_ml_per_kpa: f64,
    venous_pressure_kpa: f64,
}

/// The arterial pressure at the end of a step as a function of the flow during it, p_ar = a + b q.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArterialResponse {
    /// a: pressure without flow, kPa.
    pub pressure_kpa: f64,
    /// b: rise with the flow, kPa·s/mL.
    pub impedance_kpa_s_per_ml: f64,
}

/// How fast the constants of a [`Windkessel`] change with something, in units of the constants per unit of that.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WindkesselRate {
    /// dR.
    pub resistance_kpa_s_per_ml: f64,
    /// dZ.
    pub impedance_kpa_s_per_ml: f64,
    /// dC.
    pub compliance_ml_per_kpa: f64,
    /// dp_v.
    pub venous_pressure_kpa: f64,
}

impl Windkessel {
    /// Arteries with R and Z in kPa·s/mL, C in mL/kPa and the pressure p_v behind R in kPa.
    ///
    /// # Errors
    /// [`CirculationError::Constant`] if R or C is not positive, Z negative, or p_v not finite.
    pub fn new(
        resistance_kpa_s_per_ml: f64,
        impedance_kpa_s_per_ml: f64,
        compliance_ml_per_kpa: f64,
        venous_pressure_kpa: f64,
    ) -> Result<Self, CirculationError> {
        if !venous_pressure_kpa.is_finite() {
            let (quantity, unit, requirement) = ("venous pressure", "kPa", "a number");
            return Err(CirculationError::Constant { quantity, value: venous_pressure_kpa, unit, requirement });
        }
        Ok(Self {
            resistance_kpa_s_per_ml: positive("resistance R", "kPa·s/mL", resistance_kpa_s_per_ml, false)?,
            impedance_kpa_s_per_ml: positive("impedance Z", "kPa·s/mL", impedance_kpa_s_per_ml, true)?,
            compliance_ml_per_kpa: positive("compliance C", "mL/kPa", compliance_ml_per_kpa, false)?,
            venous_pressure_kpa,
        })
    }

    /// The pressure p_C after a step of constant flow, kPa; exact:
    ///
    /// $$p_C(t+h) = p_v + (p_C - p_v)\,e^{-h/RC} + R\,(1 - e^{-h/RC})\,q.$$
    pub fn advance_kpa(&self, capacitor_pressure_kpa: f64, flow_ml_per_s: f64, step_s: f64) -> f64 {
        let rise = self.filled_fraction(step_s);
        let target_kpa = self.venous_pressure_kpa + self.resistance_kpa_s_per_ml * flow_ml_per_s;
        capacitor_pressure_kpa + (target_kpa - capacitor_pressure_kpa) * rise
    }

    /// The arterial pressure p_C + Z q, kPa.
    pub fn arterial_pressure_kpa(&self, capacitor_pressure_kpa: f64, flow_ml_per_s: f64) -> f64 {
        capacitor_pressure_kpa + self.impedance_kpa_s_per_ml * flow_ml_per_s
    }

    /// The arterial pressure at the end of a step as an affine function of its flow, b = Z + R (1 − e^{−h/RC}).
    pub fn response(&self, capacitor_pressure_kpa: f64, step_s: f64) -> ArterialResponse {
        ArterialResponse {
            pressure_kpa: self.advance_kpa(capacitor_pressure_kpa, 0.0, step_s),
            impedance_kpa_s_per_ml: self.impedance_kpa_s_per_ml + self.resistance_kpa_s_per_ml * self.filled_fraction(step_s),
        }
    }

    /// The derivative of [`Windkessel::advance_kpa`] where the constants, p_C and q change at the given rates, kPa.
    pub fn advance_rate_kpa(
        &self,
        rate: &WindkesselRate,
        (capacitor_pressure_kpa, capacitor_rate_kpa): (f64, f64),
        (flow_ml_per_s, flow_rate_ml_per_s): (f64, f64),
        step_s: f64,
    ) -> f64 {
        let target_kpa = self.venous_pressure_kpa + self.resistance_kpa_s_per_ml * flow_ml_per_s;
        let target_rate_kpa =
            rate.venous_pressure_kpa + rate.resistance_kpa_s_per_ml * flow_ml_per_s + self.resistance_kpa_s_per_ml * flow_rate_ml_per_s;
        capacitor_rate_kpa
            + (target_rate_kpa - capacitor_rate_kpa) * self.filled_fraction(step_s)
            + (target_kpa - capacitor_pressure_kpa) * self.filled_fraction_rate(rate, step_s)
    }

    /// The derivative of [`Windkessel::arterial_pressure_kpa`] likewise, kPa.
    pub fn arterial_pressure_rate_kpa(&self, rate: &WindkesselRate, capacitor_rate_kpa: f64, flow: (f64, f64)) -> f64 {
        capacitor_rate_kpa + rate.impedance_kpa_s_per_ml * flow.0 + self.impedance_kpa_s_per_ml * flow.1
    }

    /// The derivative of [`Windkessel::response`] likewise: da and db.
    pub fn response_rate(&self, rate: &WindkesselRate, capacitor: (f64, f64), step_s: f64) -> ArterialResponse {
        ArterialResponse {
            pressure_kpa: self.advance_rate_kpa(rate, capacitor, (0.0, 0.0), step_s),
            impedance_kpa_s_per_ml: rate.impedance_kpa_s_per_ml
                + rate.resistance_kpa_s_per_ml * self.filled_fraction(step_s)
                + self.resistance_kpa_s_per_ml * self.filled_fraction_rate(rate, step_s),
        }
    }

    /// $-e^{-h/RC}\,h\,(dR/R + dC/C)/RC$.
    fn filled_fraction_rate(&self, rate: &WindkesselRate, step_s: f64) -> f64 {
        let share = step_s / (self.resistance_kpa_s_per_ml * self.compliance_ml_per_kpa);
        let relative =
            rate.resistance_kpa_s_per_ml / self.resistance_kpa_s_per_ml + rate.compliance_ml_per_kpa / self.compliance_ml_per_kpa;
        -(-share).exp() * share * relative
    }

    /// 1 − e^{−h/RC}, without cancellation for short steps.
    fn filled_fraction(&self, step_s: f64) -> f64 {
        -(-step_s / (self.resistance_kpa_s_per_ml * self.compliance_ml_per_kpa)).exp_m1()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::TaylorTest;
    use nalgebra::DVector;
    use std::f64::consts::PI;

    fn aorta() -> Windkessel {
        Windkessel::new(0.13, 0.008, 10.0, 0.0).unwrap()
    }

    /// q [Z + R (1 − e^{−t/RC})], MODEL check; the step is exact, so any number of steps gives it to rounding.
    #[test]
    fn a_flow_switched_on_gives_the_closed_form_step_response() {
        let (arteries, flow, step_s) = (aorta(), 300.0, 0.005);
        let mut capacitor = 0.0;
        for count in 1..=400 {
            let response = arteries.response(capacitor, step_s);
            capacitor = arteries.advance_kpa(capacitor, flow, step_s);
            let exact = flow * (0.008 + 0.13 * (1.0 - (-step_s * f64::from(count) / 1.3).exp()));
            assert!((arteries.arterial_pressure_kpa(capacitor, flow) - exact).abs() < 1e-11 * exact);
            assert!((response.pressure_kpa + response.impedance_kpa_s_per_ml * flow - exact).abs() < 1e-11 * exact);
        }
    }

    /// Constant ejection q for T_e of each period HP: in the periodic state p_C at the start of ejection is
    /// R q (1 − e^{−T_e/τ}) e^{−(HP−T_e)/τ} / (1 − e^{−HP/τ}).
    #[test]
    fn a_periodic_constant_ejection_reaches_its_closed_form_state() {
        let (arteries, flow, ejection_steps, beat_steps, step_s) = (aorta(), 250.0, 60, 160, 0.005);
        let mut capacitor = 3.0;
        for step in 0..(40 * beat_steps) {
            capacitor = arteries.advance_kpa(capacitor, if step % beat_steps < ejection_steps { flow } else { 0.0 }, step_s);
        }
        let decay = |duration_s: f64| (-duration_s / 1.3).exp();
        let exact = 0.13 * flow * (1.0 - decay(0.3)) * decay(0.5) / (1.0 - decay(0.8));
        assert!((capacitor - exact).abs() < 1e-9 * exact, "{capacitor} {exact}");
    }

    /// Half-sine ejection q₀ sin(πt/T_e): over one ejection the particular solution is
    /// R q₀ (sin ωt − ωτ cos ωt)/(1 + ω²τ²). Steps hold the mean flow, so the error is second order in h.
    #[test]
    fn a_half_sine_ejection_converges_to_its_closed_form_at_second_order() {
        let (arteries, peak_flow, ejection_s) = (aorta(), 500.0, 0.3);
        let (omega, tau) = (PI / ejection_s, 1.3);
        let amplitude = 0.13 * peak_flow / (1.0 + (omega * tau).powi(2));
        let exact = amplitude * omega * tau * (1.0 + (-ejection_s / tau).exp());
        let error = |count: u32| {
            let step_s = ejection_s / f64::from(count);
            let mut capacitor = 0.0;
            for step in 0..count {
                let [start, end] = [step, step + 1].map(|s| (omega * f64::from(s) * step_s).cos());
                capacitor = arteries.advance_kpa(capacitor, peak_flow * (start - end) / (omega * step_s), step_s);
            }
            (capacitor - exact).abs() / exact
        };
        let order = (error(30) / error(60)).log2();
        assert!((order - 2.0).abs() < 0.05, "order {order}");
        assert!(error(300) < 1e-6, "{}", error(300));
    }

    /// All constants, p_C and q change at once; the remainder is of second order.
    #[test]
    fn the_rates_of_the_arteries_pass_the_taylor_test() {
        let step_s = 0.01;
        let outputs = |x: &DVector<f64>| {
            let arteries = Windkessel::new(x[0], x[1], x[2], x[3])?;
            let (capacitor, response) = (arteries.advance_kpa(x[4], x[5], step_s), arteries.response(x[4], step_s));
            let arterial = arteries.arterial_pressure_kpa(capacitor, x[5]);
            Ok::<_, CirculationError>(DVector::from_vec(vec![
                capacitor,
                arterial,
                response.pressure_kpa,
                response.impedance_kpa_s_per_ml * 1e3,
            ]))
        };
        let base = DVector::from_vec(vec![0.13, 0.008, 2.0, 0.7, 9.0, 310.0]);
        let d = DVector::from_vec(vec![0.02, 0.003, -0.5, 0.2, 0.4, 30.0]);
        let arteries = Windkessel::new(base[0], base[1], base[2], base[3]).unwrap();
        let rate = WindkesselRate {
            resistance_kpa_s_per_ml: d[0],
            impedance_kpa_s_per_ml: d[1],
            compliance_ml_per_kpa: d[2],
            venous_pressure_kpa: d[3],
        };
        let capacitor = arteries.advance_rate_kpa(&rate, (base[4], d[4]), (base[5], d[5]), step_s);
        let arterial = arteries.arterial_pressure_rate_kpa(&rate, capacitor, (base[5], d[5]));
        let response = arteries.response_rate(&rate, (base[4], d[4]), step_s);
        let slope = DVector::from_vec(vec![capacitor, arterial, response.pressure_kpa, response.impedance_kpa_s_per_ml * 1e3]);
        let order = TaylorTest::run(outputs, &base, &d, &slope, 0.1, 6).unwrap().order();
        assert!((order - 2.0).abs() < 0.1, "order {order}");
    }

    #[test]
    fn arteries_without_compliance_are_refused() {
        let error = Windkessel::new(0.13, 0.008, 0.0, 0.0).unwrap_err();
        assert_eq!(error.to_string(), "compliance C = 0 mL/kPa is not allowed; it must be finite and positive");
    }
}
