//! Valves of one or two ventricles as one complementarity problem a step; the phases come out of it, \[Billet2009\] §2.

use nalgebra::{DMatrix, DVector};

use super::error::positive;
use super::{ArterialResponse, CirculationError};
use crate::units::MM3_PER_ML;

/// A valve counts as open or shut although its sign is wrong by this much: rounding, 10⁻⁸ mmHg.
const SIGN_TOLERANCE_KPA: f64 = 1e-9;

/// How the cavities answer to their pressures within one step: V(p) = V₀ + C p, one entry a cavity (1 or 2).
#[derive(Debug, Clone, PartialEq)]
pub struct CavityResponse {
    /// Volumes at zero pressure, mm³.
    pub volume_mm3: DVector<f64>,
    /// Compliance, mm³/kPa; symmetric positive definite.
    pub compliance_mm3_per_kpa: DMatrix<f64>,
}

/// What a ventricle is connected to at the end of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VentriclePorts {
    /// Pressure of its atrium, kPa.
    pub atrial_pressure_kpa: f64,
    /// Its artery.
    pub artery: ArterialResponse,
}

/// Which valves of a ventricle are open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum OpenValves {
    /// Isovolumetric.
    Neither,
    /// Filling.
    Inflow,
    /// Ejection.
    Outflow,
    /// Blood runs from the atrium through to the artery: the atrial pressure exceeds the arterial one.
    Both,
}

/// Pressure and flows of one ventricle at the end of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VentricleFlow {
    /// Ventricular pressure p, kPa.
    pub pressure_kpa: f64,
    /// Flow into the artery q_out ≥ 0, mL/s.
    pub outflow_ml_per_s: f64,
    /// Flow from the atrium q_in ≥ 0, mL/s.
    pub inflow_ml_per_s: f64,
    /// Valves that let it through.
    pub open: OpenValves,
}

/// One step of the valves: for every ventricle
///
/// $$0 \le q_\text{out} \perp p_\text{ar} + R_v q_\text{out} - p \ge 0, \qquad 0 \le q_\text{in} \perp p - p_\text{at} + R_v q_\text{in} \ge 0,$$
/// $$p_\text{ar} = a + b\,q_\text{out}, \qquad V_0 + C p = V^t - h\,(q_\text{out} - q_\text{in}).$$
///
/// With the pressures eliminated its matrix is diag(R_v + b, R_v) + h B ᵀC⁻¹B, positive definite, so there is exactly one solution.
#[derive(Debug, Clone, PartialEq)]
pub struct ValveProblem<'a> {
    response: &'a CavityResponse,
    volume_before_mm3: &'a [f64],
    ports: &'a [VentriclePorts],
    valve_resistance_kpa_s_per_ml: f64,
    step_s: f64,
}

impl OpenValves {
    /// In order of preference where rounding alone decides: an open inflow valve without flow is filling.
    const ALL: [Self; 4] = [Self::Inflow, Self::Neither, Self::Outflow, Self::Both];

    pub(super) fn has_inflow(self) -> bool {
        matches!(self, Self::Inflow | Self::Both)
    }

    pub(super) fn has_outflow(self) -> bool {
        matches!(self, Self::Outflow | Self::Both)
    }
}

impl<'a> ValveProblem<'a> {
    /// States the problem of a step of `step_s` that starts with the volumes `volume_before_mm3`; one entry a ventricle.
    ///
    /// # Errors
    /// [`CirculationError::Count`] if the numbers of ventricles differ, [`CirculationError::Constant`] if the step or the valve
    /// resistance is not positive.
    pub fn new(
        response: &'a CavityResponse,
        volume_before_mm3: &'a [f64],
        ports: &'a [VentriclePorts],
        valve_resistance_kpa_s_per_ml: f64,
        step_s: f64,
    ) -> Result<Self, CirculationError> {
        let response_count = response.volume_mm3.len();
        if response_count != ports.len()
            || response_count != volume_before_mm3.len()
            || response.compliance_mm3_per_kpa.shape() != (response_count, response_count)
        {
            let (port_count, volume_count) = (ports.len(), volume_before_mm3.len());
            return Err(CirculationError::Count { response_count, port_count, volume_count });
        }
        let valve_resistance_kpa_s_per_ml = positive("valve resistance", "kPa·s/mL", valve_resistance_kpa_s_per_ml, false)?;
        let step_s = positive("step", "s", step_s, false)?;
        Ok(Self { response, volume_before_mm3, ports, valve_resistance_kpa_s_per_ml, step_s })
    }

    /// The pressures and flows: the first combination of open valves whose signs are all right.
    ///
    /// There are 4 or 16 combinations of a 1 × 1 or 2 × 2 system each; nothing that can cycle.
    ///
    /// # Errors
    /// [`CirculationError::IndefiniteCompliance`] if the compliance is not positive definite or not finite.
    pub fn solve(&self) -> Result<Vec<VentricleFlow>, CirculationError> {
        let count = self.ports.len();
        let combination_count = OpenValves::ALL.len().pow(count as u32);
        let mut least_violation_kpa = f64::INFINITY;
        let mut best = None;
        for combination in 0..combination_count {
            let open: Vec<OpenValves> =
                (0..count).map(|ventricle| OpenValves::ALL[combination / OpenValves::ALL.len().pow(ventricle as u32) % 4]).collect();
            let pressure_kpa = self.pressures_kpa(&open)?;
            let violation_kpa = open.iter().zip(&pressure_kpa).zip(self.ports).map(|((&o, &p), ports)| violation_kpa(o, p, ports)).sum();
            if violation_kpa < least_violation_kpa {
                least_violation_kpa = violation_kpa;
                best = Some((open, pressure_kpa));
            }
            if violation_kpa <= SIGN_TOLERANCE_KPA {
                break;
            }
        }
        let (open, pressure_kpa) = best.ok_or_else(|| self.indefinite())?;
        Ok((0..count).map(|ventricle| self.flow(ventricle, open[ventricle], pressure_kpa[ventricle])).collect())
    }

    /// Pressures when the given valves are open: (C + h diag g) p = V^t − V₀ + h Σ g p_port, g the conductance of the open valves.
    fn pressures_kpa(&self, open: &[OpenValves]) -> Result<Vec<f64>, CirculationError> {
        let mut matrix = self.response.compliance_mm3_per_kpa.clone();
        let mut right = DVector::from_column_slice(self.volume_before_mm3) - &self.response.volume_mm3;
        let step_mm3 = self.step_s * MM3_PER_ML;
        for (ventricle, (&valves, ports)) in open.iter().zip(self.ports).enumerate() {
            if valves.has_inflow() {
                let conductance = step_mm3 / self.valve_resistance_kpa_s_per_ml;
                matrix[(ventricle, ventricle)] += conductance;
                right[ventricle] += conductance * ports.atrial_pressure_kpa;
            }
            if valves.has_outflow() {
                let conductance = step_mm3 / self.outflow_resistance(ports);
                matrix[(ventricle, ventricle)] += conductance;
                right[ventricle] += conductance * ports.artery.pressure_kpa;
            }
        }
        let solution = matrix.cholesky().ok_or_else(|| self.indefinite())?.solve(&right);
        if solution.iter().all(|p| p.is_finite()) { Ok(solution.iter().copied().collect()) } else { Err(self.indefinite()) }
    }

    fn flow(&self, ventricle: usize, open: OpenValves, pressure_kpa: f64) -> VentricleFlow {
        let ports = &self.ports[ventricle];
        let outflow_ml_per_s =
            if open.has_outflow() { (pressure_kpa - ports.artery.pressure_kpa) / self.outflow_resistance(ports) } else { 0.0 };
        let inflow_ml_per_s =
            if open.has_inflow() { (ports.atrial_pressure_kpa - pressure_kpa) / self.valve_resistance_kpa_s_per_ml } else { 0.0 };
        VentricleFlow { pressure_kpa, outflow_ml_per_s, inflow_ml_per_s, open }
    }

    fn outflow_resistance(&self, ports: &VentriclePorts) -> f64 {
        ports.artery.impedance_kpa_s_per_ml + self.valve_resistance_kpa_s_per_ml
    }

    fn indefinite(&self) -> CirculationError {
        let diagonal = self.response.compliance_mm3_per_kpa.diagonal();
        let smallest_mm3_per_kpa = diagonal.iter().copied().fold(f64::INFINITY, |least, c| if c < least || c.is_nan() { c } else { least });
        CirculationError::IndefiniteCompliance { smallest_mm3_per_kpa }
    }
}

/// By how much the driving pressures have the wrong sign: an open valve needs one that drives, a shut valve one that does not.
fn violation_kpa(open: OpenValves, pressure_kpa: f64, ports: &VentriclePorts) -> f64 {
    let outflow_drive = pressure_kpa - ports.artery.pressure_kpa;
    let inflow_drive = ports.atrial_pressure_kpa - pressure_kpa;
    let wrong = |is_open: bool, drive: f64| if is_open { (-drive).max(0.0) } else { drive.max(0.0) };
    wrong(open.has_outflow(), outflow_drive) + wrong(open.has_inflow(), inflow_drive)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::QuadraticProgram;
    use proptest::prelude::*;

    const RESISTANCE: f64 = 0.002;
    const STEP_S: f64 = 0.005;

    fn ports(atrial_pressure_kpa: f64, arterial_kpa: f64, impedance_kpa_s_per_ml: f64) -> VentriclePorts {
        VentriclePorts { atrial_pressure_kpa, artery: ArterialResponse { pressure_kpa: arterial_kpa, impedance_kpa_s_per_ml } }
    }

    fn solve_one(pressure_if_shut_kpa: f64) -> VentricleFlow {
        let response = CavityResponse { volume_mm3: DVector::repeat(1, 1e5), compliance_mm3_per_kpa: DMatrix::repeat(1, 1, 800.0) };
        let volume_mm3 = [1e5 + 800.0 * pressure_if_shut_kpa];
        let ports = [ports(1.0, 10.0, 0.01)];
        ValveProblem::new(&response, &volume_mm3, &ports, RESISTANCE, STEP_S).unwrap().solve().unwrap()[0]
    }

    #[test]
    fn the_pressure_alone_decides_which_valve_opens() {
        assert_eq!(solve_one(0.5).open, OpenValves::Inflow);
        assert_eq!(solve_one(5.0).open, OpenValves::Neither);
        assert!((solve_one(5.0).pressure_kpa - 5.0).abs() < 1e-12, "shut valves keep the volume");
        assert_eq!(solve_one(12.0).open, OpenValves::Outflow);
        let rest = solve_one(1.0);
        assert_eq!(rest.open, OpenValves::Inflow, "at equal pressures rounding must not end the filling");
        assert!(rest.inflow_ml_per_s.abs() < 1e-6);
    }

    #[test]
    fn an_atrium_above_its_artery_drives_blood_through_both_valves() {
        let response = CavityResponse { volume_mm3: DVector::repeat(1, 1e5), compliance_mm3_per_kpa: DMatrix::repeat(1, 1, 800.0) };
        let through = [ports(2.0, 1.0, 0.01)];
        let volume_mm3 = [1e5 + 800.0 * 1.5];
        let flow = ValveProblem::new(&response, &volume_mm3, &through, RESISTANCE, STEP_S).unwrap().solve().unwrap()[0];
        assert_eq!(flow.open, OpenValves::Both);
        assert!(flow.inflow_ml_per_s > 0.0 && flow.outflow_ml_per_s > 0.0);
    }

    #[test]
    fn a_cavity_that_does_not_yield_is_an_error_with_its_compliance() {
        for compliance in [-3.0, f64::NAN] {
            let response =
                CavityResponse { volume_mm3: DVector::repeat(1, 1e5), compliance_mm3_per_kpa: DMatrix::repeat(1, 1, compliance) };
            let ports = [ports(1.0, 10.0, 0.01)];
            let outcome = ValveProblem::new(&response, &[1e5], &ports, RESISTANCE, STEP_S).unwrap().solve();
            assert!(matches!(outcome, Err(CirculationError::IndefiniteCompliance { .. })));
        }
    }

    proptest! {
        /// Complementarity, flow conservation and signs on two coupled ventricles; failure means a missed active set.
        #[test]
        fn the_solution_is_complementary_and_conserves_blood(
            left in 200.0..3000.0f64, right in 200.0..5000.0f64, coupling in -0.9..0.9f64,
            shut in prop::array::uniform2(-5.0..20.0f64), atria in prop::array::uniform2(-1.0..4.0f64),
            arteries in prop::array::uniform2(0.0..15.0f64), impedance in 1e-4..0.05f64,
        ) {
            let mixed = coupling * (left * right).sqrt();
            let response = CavityResponse {
                volume_mm3: DVector::from_vec(vec![1e5, 1.4e5]),
                compliance_mm3_per_kpa: DMatrix::from_row_slice(2, 2, &[left, mixed, mixed, right]),
            };
            let before = &response.volume_mm3 + &response.compliance_mm3_per_kpa * DVector::from_column_slice(&shut);
            let ports = [0, 1].map(|v| ports(atria[v], arteries[v], impedance));
            let flows = ValveProblem::new(&response, before.as_slice(), &ports, RESISTANCE, STEP_S).unwrap().solve().unwrap();
            let pressure = DVector::from_iterator(2, flows.iter().map(|flow| flow.pressure_kpa));
            let after = &response.volume_mm3 + &response.compliance_mm3_per_kpa * pressure;
            for (v, flow) in flows.iter().enumerate() {
                let lost = before[v] - after[v];
                let sent = STEP_S * MM3_PER_ML * (flow.outflow_ml_per_s - flow.inflow_ml_per_s);
                prop_assert!((lost - sent).abs() < 1e-6, "ventricle {v}: {lost} against {sent} mm³");
                let gaps = [
                    (flow.outflow_ml_per_s, arteries[v] + (impedance + RESISTANCE) * flow.outflow_ml_per_s - flow.pressure_kpa),
                    (flow.inflow_ml_per_s, flow.pressure_kpa - atria[v] + RESISTANCE * flow.inflow_ml_per_s),
                ];
                for (q, gap) in gaps {
                    prop_assert!(q >= -1e-5 && gap >= -1e-8 && (q * gap).abs() < 1e-6, "ventricle {v}: flow {q}, gap {gap}");
                }
            }
        }

        /// The same flows by an interior-point solver on the pressures-eliminated QP ½ qᵀMq + cᵀq, q ≥ 0.
        #[test]
        fn the_enumeration_and_the_quadratic_program_agree(
            left in 200.0..3000.0f64, right in 200.0..5000.0f64, coupling in -0.9..0.9f64,
            shut in prop::array::uniform2(-2.0..20.0f64), atria in prop::array::uniform2(0.0..3.0f64),
            arteries in prop::array::uniform2(2.0..15.0f64), impedance in 1e-3..0.05f64,
        ) {
            let mixed = coupling * (left * right).sqrt();
            let compliance = DMatrix::from_row_slice(2, 2, &[left, mixed, mixed, right]);
            let response = CavityResponse { volume_mm3: DVector::repeat(2, 1e5), compliance_mm3_per_kpa: compliance.clone() };
            let shut = DVector::from_column_slice(&shut);
            let before = &response.volume_mm3 + &compliance * &shut;
            let ports = [0, 1].map(|v| ports(atria[v], arteries[v], impedance));
            let flows = ValveProblem::new(&response, before.as_slice(), &ports, RESISTANCE, STEP_S).unwrap().solve().unwrap();
            let signs = DMatrix::from_row_slice(2, 4, &[1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, -1.0]);
            let resistances = DVector::from_fn(4, |row, _| RESISTANCE + if row % 2 == 0 { impedance } else { 0.0 });
            let stiffness = signs.transpose() * compliance.try_inverse().unwrap() * &signs * (STEP_S * MM3_PER_ML);
            let hessian = DMatrix::from_diagonal(&resistances) + (&stiffness + stiffness.transpose()) * 0.5;
            let gradient = DVector::from_fn(4, |row, _| if row % 2 == 0 { arteries[row / 2] - shut[row / 2] } else { shut[row / 2] - atria[row / 2] });
            let value = |q: &DVector<f64>| (q.transpose() * &hessian * q)[0] / 2.0 + gradient.dot(q);
            let program = QuadraticProgram::new(hessian.clone(), gradient.clone()).unwrap();
            let program = program.with_bounds(DVector::zeros(4), DVector::repeat(4, f64::INFINITY)).unwrap();
            let solution = program.solve().unwrap().x;
            let found = DVector::from_iterator(4, flows.iter().flat_map(|flow| [flow.outflow_ml_per_s, flow.inflow_ml_per_s]));
            prop_assert!(found.min() >= -1e-5, "{found}");
            // Where a flow and its gap are both nearly zero, an interior point lies as far off as its tolerance on their product allows.
            let (least, other) = (value(&found), value(&solution));
            prop_assert!(least <= other + 1e-9 * (1.0 + other.abs()), "{least} against {other}");
            prop_assert!((&found - &solution).amax() < 1e-4 * (1.0 + solution.amax()), "{found} against {solution}");
        }
    }
}
