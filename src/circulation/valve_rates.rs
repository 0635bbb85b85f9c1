//! The derivative of a step's pressures and flows, on the valves that are open.
//!
//! Between the instants at which a valve opens or shuts the open ones make a linear system, and so do its derivatives: with the
//! conductances $c_\text{in} = h/R_v$ and $c_\text{out} = h/(R_v + b)$ of the open valves
//!
//! $$(C + c)\,dp = dV^t - dV_0 + c_\text{out}\,(da + (dR_v + db)\,q_\text{out}) + c_\text{in}\,(dp_\text{at} - dR_v\,q_\text{in}),$$
//!
//! with $dV_0$ the change of the volumes at the step's end under unchanged pressures. Where a parameter moves such an instant over the end
//! of a step the flows have a kink, and these are the derivatives of one side.

use nalgebra::{DMatrix, DVector};

use super::error::positive;
use super::{ArterialResponse, CirculationError, VentricleFlow, VentriclePorts};
use crate::units::MM3_PER_ML;

/// How the surroundings of a ventricle change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PortRates {
    /// dp_at, kPa.
    pub atrial_pressure_kpa: f64,
    /// da and db.
    pub artery: ArterialResponse,
    /// dR_v, kPa·s/mL.
    pub valve_resistance_kpa_s_per_ml: f64,
    /// dV^t, mm³.
    pub volume_before_mm3: f64,
    /// dV₀ with the pressures as they are, mm³.
    pub free_volume_mm3: f64,
}

/// The derivative of a [`VentricleFlow`]; zero through a shut valve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VentricleFlowRate {
    /// dp, kPa.
    pub pressure_kpa: f64,
    /// dq_out, mL/s.
    pub outflow_ml_per_s: f64,
    /// dq_in, mL/s.
    pub inflow_ml_per_s: f64,
}

/// The linear system of a step's open valves, for as many derivatives as are wanted.
#[derive(Debug, Clone)]
pub struct ValveRates<'a> {
    flows: &'a [VentricleFlow],
    ports: &'a [VentriclePorts],
    valve_resistance_kpa_s_per_ml: f64,
    step_s: f64,
    inverse: DMatrix<f64>,
}

impl<'a> ValveRates<'a> {
    /// Of a step of `step_s` with the solution `flows`; the compliance $C_{kl} = dV_k/dp_l$ (mm³/kPa) need not be symmetric.
    ///
    /// # Errors
    /// [`CirculationError::Count`] if the numbers of ventricles differ, [`CirculationError::Constant`] for a step or valve resistance
    /// that is not positive, [`CirculationError::IndefiniteCompliance`] if the system is singular.
    pub fn new(
        compliance_mm3_per_kpa: &DMatrix<f64>,
        flows: &'a [VentricleFlow],
        ports: &'a [VentriclePorts],
        valve_resistance_kpa_s_per_ml: f64,
        step_s: f64,
    ) -> Result<Self, CirculationError> {
        let response_count = compliance_mm3_per_kpa.nrows();
        if !compliance_mm3_per_kpa.is_square() || response_count != ports.len() || response_count != flows.len() {
            return Err(CirculationError::Count { response_count, port_count: ports.len(), volume_count: flows.len() });
        }
        let valve_resistance_kpa_s_per_ml = positive("valve resistance", "kPa·s/mL", valve_resistance_kpa_s_per_ml, false)?;
        let step_s = positive("step", "s", step_s, false)?;
        let smallest_mm3_per_kpa = compliance_mm3_per_kpa.diagonal().iter().copied().fold(f64::INFINITY, f64::min);
        let mut this = Self { flows, ports, valve_resistance_kpa_s_per_ml, step_s, inverse: compliance_mm3_per_kpa.clone() };
        for ventricle in 0..response_count {
            let (into, out) = this.conductances_mm3_per_kpa(ventricle);
            this.inverse[(ventricle, ventricle)] += into + out;
        }
        this.inverse = this.inverse.try_inverse().ok_or(CirculationError::IndefiniteCompliance { smallest_mm3_per_kpa })?;
        Ok(this)
    }

    /// The derivative of every ventricle's pressure and flows, one entry a ventricle in and out.
    pub fn solve(&self, rates: &[PortRates]) -> Vec<VentricleFlowRate> {
        let right = DVector::from_iterator(rates.len(), rates.iter().enumerate().map(|(ventricle, rate)| self.right_mm3(ventricle, rate)));
        let pressure_kpa = &self.inverse * right;
        rates.iter().enumerate().map(|(ventricle, rate)| self.flow_rate(ventricle, rate, pressure_kpa[ventricle])).collect()
    }

    fn right_mm3(&self, ventricle: usize, rate: &PortRates) -> f64 {
        let (into, out) = self.conductances_mm3_per_kpa(ventricle);
        rate.volume_before_mm3 - rate.free_volume_mm3
            + out * self.outflow_without_pressure_kpa(ventricle, rate)
            + into * self.inflow_without_pressure_kpa(ventricle, rate)
    }

    /// da + (dR_v + db) q_out.
    fn outflow_without_pressure_kpa(&self, ventricle: usize, rate: &PortRates) -> f64 {
        let resistance = rate.valve_resistance_kpa_s_per_ml + rate.artery.impedance_kpa_s_per_ml;
        rate.artery.pressure_kpa + resistance * self.flows[ventricle].outflow_ml_per_s
    }

    /// dp_at − dR_v q_in.
    fn inflow_without_pressure_kpa(&self, ventricle: usize, rate: &PortRates) -> f64 {
        rate.atrial_pressure_kpa - rate.valve_resistance_kpa_s_per_ml * self.flows[ventricle].inflow_ml_per_s
    }

    /// What the open inflow and outflow valve of a ventricle let through in a step, mm³/kPa.
    fn conductances_mm3_per_kpa(&self, ventricle: usize) -> (f64, f64) {
        let open = self.flows[ventricle].open;
        let step_mm3 = self.step_s * MM3_PER_ML;
        let inflow = if open.has_inflow() { step_mm3 / self.valve_resistance_kpa_s_per_ml } else { 0.0 };
        let outflow = if open.has_outflow() { step_mm3 / self.outflow_resistance(ventricle) } else { 0.0 };
        (inflow, outflow)
    }

    fn outflow_resistance(&self, ventricle: usize) -> f64 {
        self.valve_resistance_kpa_s_per_ml + self.ports[ventricle].artery.impedance_kpa_s_per_ml
    }

    fn flow_rate(&self, ventricle: usize, rate: &PortRates, pressure_kpa: f64) -> VentricleFlowRate {
        let open = self.flows[ventricle].open;
        let outflow_kpa = pressure_kpa - self.outflow_without_pressure_kpa(ventricle, rate);
        let inflow_kpa = self.inflow_without_pressure_kpa(ventricle, rate) - pressure_kpa;
        VentricleFlowRate {
            pressure_kpa,
            outflow_ml_per_s: if open.has_outflow() { outflow_kpa / self.outflow_resistance(ventricle) } else { 0.0 },
            inflow_ml_per_s: if open.has_inflow() { inflow_kpa / self.valve_resistance_kpa_s_per_ml } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circulation::{CavityResponse, ValveProblem};
    use crate::numerics::TaylorTest;

    const STEP_S: f64 = 0.005;
    const BEFORE_MM3: [f64; 2] = [1e5, 1.2e5];

    /// Both ventricles' (p_at, a, b, R_v, V₀, V^t) in twelve numbers, R_v in common.
    fn problem(x: &DVector<f64>) -> (CavityResponse, [f64; 2], [VentriclePorts; 2]) {
        let compliance_mm3_per_kpa = DMatrix::from_row_slice(2, 2, &[700.0, 90.0, 90.0, 1500.0]);
        let port = |o: usize| VentriclePorts {
            atrial_pressure_kpa: x[o],
            artery: ArterialResponse { pressure_kpa: x[o + 1], impedance_kpa_s_per_ml: x[o + 2] },
        };
        let volume_mm3 = DVector::from_vec(vec![x[3], x[8]]);
        (CavityResponse { volume_mm3, compliance_mm3_per_kpa }, [x[4], x[9]], [port(0), port(5)])
    }

    fn flat(flows: &[VentricleFlow]) -> DVector<f64> {
        DVector::from_vec(flows.iter().flat_map(|f| [f.pressure_kpa, f.outflow_ml_per_s, f.inflow_ml_per_s]).collect())
    }

    /// Whatever is open on the two sides: ejection beside filling, isovolumetric beside ejection, and blood that runs through.
    #[test]
    fn the_rates_of_the_flows_pass_the_taylor_test() {
        let solve = |x: &DVector<f64>| {
            let (response, before, ports) = problem(x);
            ValveProblem::new(&response, &before, &ports, x[10], STEP_S)?.solve()
        };
        for (left, right) in [([1.0, 9.0, 12.0], [0.4, 2.0, 0.2]), ([1.0, 9.0, 5.0], [0.4, 2.0, 6.0]), ([9.0, 3.0, 6.0], [0.4, 2.0, 1.0])] {
            let side = |[atrial, arterial, shut]: [f64; 3], before: f64, compliance: f64| {
                [atrial, arterial, 0.01, before - compliance * shut, before]
            };
            let values = [side(left, BEFORE_MM3[0], 700.0), side(right, BEFORE_MM3[1], 1500.0)].concat();
            let base = DVector::from_iterator(11, values.into_iter().chain([0.002]));
            let d = DVector::from_vec(vec![0.1, 0.2, 0.001, 20.0, -30.0, 0.05, -0.1, 0.002, -40.0, 10.0, 0.0003]);
            let flows = solve(&base).unwrap();
            let (response, _, ports) = problem(&base);
            let rates = ValveRates::new(&response.compliance_mm3_per_kpa, &flows, &ports, base[10], STEP_S).unwrap();
            let rate = |o: usize| PortRates {
                atrial_pressure_kpa: d[o],
                artery: ArterialResponse { pressure_kpa: d[o + 1], impedance_kpa_s_per_ml: d[o + 2] },
                valve_resistance_kpa_s_per_ml: d[10],
                volume_before_mm3: d[o + 4],
                free_volume_mm3: d[o + 3],
            };
            let solved = rates.solve(&[rate(0), rate(5)]);
            let slope = DVector::from_vec(solved.iter().flat_map(|r| [r.pressure_kpa, r.outflow_ml_per_s, r.inflow_ml_per_s]).collect());
            let test = TaylorTest::run(|x: &DVector<f64>| solve(x).map(|flows| flat(&flows)), &base, &d, &slope, 0.2, 6).unwrap();
            assert!((test.order() - 2.0).abs() < 0.1, "order {} at {flows:?}", test.order());
        }
    }
}
