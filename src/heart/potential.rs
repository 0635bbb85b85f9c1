//! The potential that a corotational step goes down: what the balance of forces and the valves are the minimum of together.
//!
//! The forces but the pressures are the gradient of an energy E. The valves of a ventricle let more blood out the higher its pressure, so
//! its pressure is minus the slope of a convex $\Phi_k$ of the volume, and the step is where
//!
//! $$\Pi(Y) = E(Y) + \sum_k \bar p_k V_k(Y) + \Phi_k(V_k(Y))$$
//!
//! is least. A round takes E to second and V to first order about the trial; where its matrix is positive definite it leads downhill.

use super::newton::Goal;
use super::step::dot;
use super::{HeartModel, HeartState, StepWorkspace};
use crate::circulation::VentriclePorts;
use crate::mechanics::MechanicsError;
use crate::units::{MM3_PER_ML, ml_from_mm3};

/// Part of the linearised fall of the potential that a round must achieve (Armijo's rule).
const LEAST_FALL: f64 = 1e-4;

/// Where a round sets out from, and how far down it promises to lead.
pub(super) struct Descent {
    energy_mn_mm: f64,
    volumes_mm3: Vec<f64>,
    valves_mn_mm: f64,
    /// Fall of the linearised potential on the whole way; negative.
    promised_mn_mm: f64,
}

impl Descent {
    /// From the trial along the workspace's direction.
    pub(super) fn new(model: &HeartModel, goal: &Goal<'_>, workspace: &StepWorkspace) -> Result<Self, MechanicsError> {
        let StepWorkspace { system, trial_mm, gradients_mm2, newton, .. } = workspace;
        let (energy_mn_mm, _) = model.operator.energy_mn_mm(system, trial_mm)?;
        let volumes_mm3 = model.volumes_mm3(trial_mm);
        let grown_mm3: Vec<f64> = gradients_mm2.iter().map(|gradient| dot(gradient, &newton.direction_mm)).collect();
        let moved_mm3: Vec<f64> = volumes_mm3.iter().zip(&grown_mm3).map(|(volume, grown)| volume + grown).collect();
        let valves_mn_mm = model.valve_work_mn_mm(goal, &volumes_mm3);
        let pressed: f64 = newton.pressure_kpa.iter().zip(&grown_mm3).map(|(pressure, grown)| pressure * grown).sum();
        let promised_mn_mm =
            pressed - dot(&newton.residual_mn, &newton.direction_mm) + model.valve_work_mn_mm(goal, &moved_mm3) - valves_mn_mm;
        Ok(Self { energy_mn_mm, volumes_mm3, valves_mn_mm, promised_mn_mm })
    }

    /// Whether the potential has fallen far enough where the forces of the system were last computed, `part` of the way.
    pub(super) fn is_met(
        &self,
        part: f64,
        model: &HeartModel,
        state: &HeartState,
        goal: &Goal<'_>,
        workspace: &StepWorkspace,
    ) -> Result<bool, MechanicsError> {
        let StepWorkspace { system, trial_mm, newton, .. } = workspace;
        let (energy_mn_mm, rest_mn_mm) = model.operator.energy_mn_mm(system, trial_mm)?;
        let volumes_mm3 = model.volumes_mm3(&newton.candidate_mm);
        let rested = |(ventricle, (after, before)): (usize, (&f64, &f64))| state.ventricles[ventricle].rest_pressure_kpa * (after - before);
        let prestress_mn_mm: f64 = volumes_mm3.iter().zip(&self.volumes_mm3).enumerate().map(rested).sum();
        let valves_mn_mm = model.valve_work_mn_mm(goal, &volumes_mm3) - self.valves_mn_mm;
        let fall_mn_mm = energy_mn_mm - self.energy_mn_mm + rest_mn_mm + prestress_mn_mm + valves_mn_mm;
        Ok(self.promised_mn_mm < 0.0 && fall_mn_mm <= LEAST_FALL * part * self.promised_mn_mm)
    }
}

impl HeartModel {
    /// Σ Φ of cavities with the given volumes at the step's end.
    fn valve_work_mn_mm(&self, goal: &Goal<'_>, volumes_mm3: &[f64]) -> f64 {
        let step_s = self.settings.step_s;
        let work = |((volume, before), port): ((&f64, &f64), &VentriclePorts)| {
            valve_power(port, self.valve_resistance(), ml_from_mm3(before - volume) / step_s) * step_s * MM3_PER_ML
        };
        volumes_mm3.iter().zip(goal.before_mm3).zip(goal.ports).map(work).sum()
    }
}

/// $\int_0^q p\,dq$ of the pressure that a net outflow q (mL/s) needs, kPa·mL/s, but for a constant: $\max_p\,(p q - \Psi(p))$ with
/// $\Psi = \frac{(p - a)_+^2}{2(R_v + b)} + \frac{(p_\text{at} - p)_+^2}{2R_v}$, the slope of which is the outflow less the inflow.
fn valve_power(port: &VentriclePorts, valve_resistance: f64, net_outflow_ml_per_s: f64) -> f64 {
    let (q, shut, filled) = (net_outflow_ml_per_s, port.artery.pressure_kpa, port.atrial_pressure_kpa);
    let (out, into) = (1.0 / (valve_resistance + port.artery.impedance_kpa_s_per_ml), 1.0 / valve_resistance);
    let power = |p: f64| p * q - out * (p - shut).max(0.0).powi(2) / 2.0 - into * (filled - p).max(0.0).powi(2) / 2.0;
    let through = (q + out * shut + into * filled) / (out + into);
    let pressure_kpa = match q {
        _ if filled > shut && (shut..=filled).contains(&through) => through,
        _ if q > 0.0 => shut + q / out,
        _ if q < 0.0 => filled + q / into,
        _ => filled,
    };
    power(pressure_kpa)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circulation::{ArterialResponse, CavityResponse, ValveProblem};
    use nalgebra::{DMatrix, DVector};

    /// Its slope is the pressure that the valve problem finds for the flow, shut, filling, ejecting and with blood running through; and
    /// it is convex.
    #[test]
    fn the_slope_of_the_valves_work_is_the_pressure_of_the_valve_problem() {
        let (resistance, step_s, stiff) = (1e-3, 0.005, 1e-3);
        for (atrial, arterial) in [(1.0, 10.0), (12.0, 10.0)] {
            let artery = ArterialResponse { pressure_kpa: arterial, impedance_kpa_s_per_ml: 0.02 };
            let port = VentriclePorts { atrial_pressure_kpa: atrial, artery };
            for blown_mm3 in [-3e3, -2.1e3, -900.0, -40.0, 60.0, 700.0, 2e3] {
                // A cavity that hardly yields sends what its volume at no pressure asks for.
                let response = CavityResponse {
                    volume_mm3: DVector::repeat(1, 1e5 - blown_mm3),
                    compliance_mm3_per_kpa: DMatrix::repeat(1, 1, stiff),
                };
                let flow = ValveProblem::new(&response, &[1e5], &[port], resistance, step_s).unwrap().solve().unwrap()[0];
                let net = flow.outflow_ml_per_s - flow.inflow_ml_per_s;
                let power = |q: f64| valve_power(&port, resistance, q);
                let slope = (power(net + 1e-3) - power(net - 1e-3)) / 2e-3;
                assert!((slope - flow.pressure_kpa).abs() < 1e-6, "{slope} for {} kPa at {net} mL/s", flow.pressure_kpa);
                assert!(power(net + 50.0) + power(net - 50.0) > 2.0 * power(net));
            }
        }
    }
}
