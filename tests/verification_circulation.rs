//! The circulation from outside: arteries in closed form, valves against a quadratic program and an ordinary differential equation, and
//! what a whole heart must keep.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking, and may show its figures")]

use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{AnatomySettings, Ventricle};
use cardiotwin::circulation::{CavityResponse, OpenValves, Phase, ValveProblem, VentriclePorts, Windkessel};
use cardiotwin::heart::{HeartModel, ModelSettings, Parameter, Parameters, SimulationPlan, Trajectory, simulate};
use cardiotwin::numerics::QuadraticProgram;
use cardiotwin::phantom::IdealisedLv;
use cardiotwin::units::MM3_PER_ML;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};

const RESISTANCE: f64 = 0.13;
const IMPEDANCE: f64 = 0.008;
const COMPLIANCE: f64 = 10.0;
const TAU_S: f64 = RESISTANCE * COMPLIANCE;
const VALVE: f64 = 0.002;

fn aorta(venous_pressure_kpa: f64) -> Windkessel {
    Windkessel::new(RESISTANCE, IMPEDANCE, COMPLIANCE, venous_pressure_kpa).unwrap()
}

/// p_ar = q [Z + R (1 − e^{−t/RC})] + p_v for a flow switched on, whatever the steps are.
#[test]
fn the_step_response_does_not_depend_on_the_steps() {
    let (arteries, flow, venous) = (aorta(0.7), 300.0, 0.7);
    for steps in [vec![1.0], vec![0.001; 1000], vec![0.3, 0.05, 0.15, 0.5], vec![1e-9, 1.0 - 1e-9]] {
        let capacitor = steps.iter().fold(venous, |pressure, &step_s| arteries.advance_kpa(pressure, flow, step_s));
        let exact = venous + flow * (IMPEDANCE + RESISTANCE * (1.0 - (-1.0 / TAU_S).exp()));
        assert!((arteries.arterial_pressure_kpa(capacitor, flow) - exact).abs() < 1e-11 * exact, "{} steps", steps.len());
    }
}

/// Periodic ejection q(t) over T_e of each period: the periodic state has p_C at its start so that
/// p = p e^{−T/τ} + e^{−(T−T_e)/τ} ∫₀^{T_e} q e^{−(T_e−s)/τ} ds / C, with p over p_v. For q constant the integral is τ q (1 − e^{−T_e/τ}); for
/// q₀ sin ωt, ω = π/T_e, it is q₀ ω τ² (1 + e^{−T_e/τ}) / (1 + ω²τ²). Steps that hold the mean flow are exact and of second order.
#[test]
fn periodic_ejections_reach_their_closed_form_state() {
    let (period_s, ejection_s, peak, venous) = (0.8, 0.28, 480.0, 0.5);
    let decay = |duration_s: f64| (-duration_s / TAU_S).exp();
    let omega = PI / ejection_s;
    let periodic = |integral: f64| venous + decay(period_s - ejection_s) * integral / COMPLIANCE / (1.0 - decay(period_s));
    let constant_exact = periodic(TAU_S * peak * (1.0 - decay(ejection_s)));
    let sine_exact = periodic(peak * omega * TAU_S * TAU_S * (1.0 + decay(ejection_s)) / (1.0 + (omega * TAU_S).powi(2)));
    let settled = |beat_steps: usize, volume_until: &dyn Fn(f64) -> f64| {
        let (arteries, step_s) = (aorta(venous), period_s / beat_steps as f64);
        let mut capacitor = 4.0;
        for step in 0..60 * beat_steps {
            let time_s = (step % beat_steps) as f64 * step_s;
            let flow = (volume_until((time_s + step_s).min(ejection_s)) - volume_until(time_s.min(ejection_s))) / step_s;
            capacitor = arteries.advance_kpa(capacitor, flow, step_s);
        }
        capacitor
    };
    let constant = settled(200, &|time_s| peak * time_s);
    assert!((constant - constant_exact).abs() < 1e-9 * constant_exact, "{constant} {constant_exact}");
    let error = |beat_steps| settled(beat_steps, &|time_s| peak / omega * (1.0 - (omega * time_s).cos())) - sine_exact;
    let (coarse, fine) = (error(200), error(400));
    println!("half-sine: {sine_exact:.4} kPa, errors {coarse:.2e} {fine:.2e}");
    assert!((coarse / fine - 4.0).abs() < 0.05 && fine.abs() < 1e-4 * sine_exact);
    // The mean pressure of a periodic state is what drives the stroke volume through R.
    let stroke_ml = 2.0 * peak / omega;
    let (arteries, mut capacitor, mut sum) = (aorta(venous), sine_exact, 0.0);
    for step in 0..8000 {
        let [before, after] = [step, step + 1].map(|s| (omega * (f64::from(s) * 1e-4).min(ejection_s)).cos());
        sum += capacitor / 8000.0;
        capacitor = arteries.advance_kpa(capacitor, peak * (before - after) / (omega * 1e-4), 1e-4);
    }
    assert!((sum - venous - RESISTANCE * stroke_ml / period_s).abs() < 1e-3, "{sum}");
}

/// The valves as a minimum over the pressures: min ½pᵀCp − (V − V₀)ᵀp + h Σ s²/2R over s ≥ p − a, s' ≥ p_at − p, s, s' ≥ 0, the mirror image
/// of flows that are complementary to pressure drops; solved by the interior-point method.
#[test]
fn enumerated_valves_are_the_minimum_of_a_quadratic_program() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut seen = std::collections::HashSet::new();
    for trial in 0..400 {
        let mut between = |low: f64, high: f64| random.random_range(low..high);
        let [left, right, coupling] = [between(200.0, 3000.0), between(200.0, 5000.0), between(-0.9, 0.9)];
        let mixed = coupling * (left * right).sqrt();
        let compliance = DMatrix::from_row_slice(2, 2, &[left, mixed, mixed, right]);
        let shut = DVector::from_fn(2, |_, _| between(-2.0, 16.0));
        let step_s = between(0.0005, 0.01);
        let ports = [0, 1].map(|_| {
            let artery = aorta(0.0).response(between(2.0, 12.0), step_s);
            VentriclePorts { atrial_pressure_kpa: between(0.0, 3.0), artery }
        });
        let response = CavityResponse { volume_mm3: DVector::repeat(2, 1e5), compliance_mm3_per_kpa: compliance.clone() };
        let excess = &compliance * &shut;
        let before: Vec<f64> = excess.iter().map(|excess| 1e5 + excess).collect();
        let flows = ValveProblem::new(&response, &before, &ports, VALVE, step_s).unwrap().solve().unwrap();
        // Unknowns p₁, p₂, then for each ventricle the drops over its outflow and its inflow valve.
        let mut hessian = DMatrix::zeros(6, 6);
        hessian.view_mut((0, 0), (2, 2)).copy_from(&compliance);
        let (mut rows, mut rhs) = (DMatrix::zeros(4, 6), DVector::zeros(4));
        for (v, port) in ports.iter().enumerate() {
            let (outflow, inflow) = (2 + 2 * v, 3 + 2 * v);
            hessian[(outflow, outflow)] = step_s * MM3_PER_ML / (port.artery.impedance_kpa_s_per_ml + VALVE);
            hessian[(inflow, inflow)] = step_s * MM3_PER_ML / VALVE;
            (rows[(2 * v, v)], rows[(2 * v, outflow)], rhs[2 * v]) = (1.0, -1.0, port.artery.pressure_kpa);
            (rows[(2 * v + 1, v)], rows[(2 * v + 1, inflow)], rhs[2 * v + 1]) = (-1.0, -1.0, -port.atrial_pressure_kpa);
        }
        let gradient = DVector::from_fn(6, |row, _| if row < 2 { -excess[row] } else { 0.0 });
        let lower = DVector::from_fn(6, |row, _| if row < 2 { f64::NEG_INFINITY } else { 0.0 });
        let program = QuadraticProgram::new(hessian, gradient).unwrap().with_inequalities(rows, rhs).unwrap();
        let minimum = program.with_bounds(lower, DVector::repeat(6, f64::INFINITY)).unwrap().solve().unwrap().x;
        for (v, flow) in flows.iter().enumerate() {
            seen.insert(flow.open);
            assert!((flow.pressure_kpa - minimum[v]).abs() < 1e-6, "trial {trial}: {} against {} kPa", flow.pressure_kpa, minimum[v]);
            let outflow = minimum[2 + 2 * v] / (ports[v].artery.impedance_kpa_s_per_ml + VALVE);
            assert!((flow.outflow_ml_per_s - outflow).abs() < 1e-3, "trial {trial}: {} against {outflow} mL/s", flow.outflow_ml_per_s);
        }
    }
    assert!(seen.is_superset(&[OpenValves::Inflow, OpenValves::Neither, OpenValves::Outflow].into()), "{seen:?}");
}

/// A chamber p = E(t) V between an atrium and an aorta: stepped by the valves, and as the differential equation that it discretises.
mod chamber {
    use super::*;

    pub(super) const PERIOD_S: f64 = 0.8;
    const ATRIUM_KPA: f64 = 1.0;

    /// Elastance, kPa/mL.
    fn elastance(time_s: f64) -> f64 {
        let phase = (time_s / PERIOD_S).fract();
        0.01 + if phase < 0.5 { 0.25 * (2.0 * PI * phase).sin().powi(2) } else { 0.0 }
    }

    /// Volume (mL), pressure of the chamber and of the aorta (kPa), and the phases passed through.
    pub(super) fn stepped(step_s: f64, end_s: f64) -> (f64, f64, f64, Vec<Phase>) {
        let arteries = aorta(0.5);
        let (mut volume_mm3, mut pressure, mut capacitor, mut phases) = (1e5, ATRIUM_KPA, 8.0, vec![Phase::Filling]);
        for step in 1..=(end_s / step_s).round() as usize {
            let compliance = MM3_PER_ML / elastance(step as f64 * step_s);
            let response = CavityResponse { volume_mm3: DVector::zeros(1), compliance_mm3_per_kpa: DMatrix::repeat(1, 1, compliance) };
            let ports = [VentriclePorts { atrial_pressure_kpa: ATRIUM_KPA, artery: arteries.response(capacitor, step_s) }];
            let flow = ValveProblem::new(&response, &[volume_mm3], &ports, VALVE, step_s).unwrap().solve().unwrap()[0];
            capacitor = arteries.advance_kpa(capacitor, flow.outflow_ml_per_s, step_s);
            volume_mm3 -= step_s * MM3_PER_ML * (flow.outflow_ml_per_s - flow.inflow_ml_per_s);
            pressure = flow.pressure_kpa;
            let phase = phases.last().unwrap().after(flow.open);
            if phase != *phases.last().unwrap() {
                phases.push(phase);
            }
        }
        (volume_mm3 / MM3_PER_ML, pressure, capacitor, phases)
    }

    /// V̇ = q_in − q_out, C ṗ_C = q_out − (p_C − p_v)/R with valves that conduct one way, by the method of Runge and Kutta.
    pub(super) fn integrated(step_s: f64, end_s: f64) -> (f64, f64, f64) {
        let slope = |time_s: f64, [volume, capacitor]: [f64; 2]| {
            let pressure = elastance(time_s) * volume;
            let inflow = ((ATRIUM_KPA - pressure) / VALVE).max(0.0);
            let outflow = ((pressure - capacitor) / (IMPEDANCE + VALVE)).max(0.0);
            [inflow - outflow, (outflow - (capacitor - 0.5) / RESISTANCE) / COMPLIANCE]
        };
        let shifted = |state: [f64; 2], slope: [f64; 2], by: f64| [state[0] + by * slope[0], state[1] + by * slope[1]];
        let mut state = [100.0, 8.0];
        let count = (end_s / step_s).round() as usize;
        for step in 0..count {
            let time_s = step as f64 * step_s;
            let first = slope(time_s, state);
            let second = slope(time_s + step_s / 2.0, shifted(state, first, step_s / 2.0));
            let third = slope(time_s + step_s / 2.0, shifted(state, second, step_s / 2.0));
            let fourth = slope(time_s + step_s, shifted(state, third, step_s));
            let mean = [0, 1].map(|i| (first[i] + 2.0 * second[i] + 2.0 * third[i] + fourth[i]) / 6.0);
            state = shifted(state, mean, step_s);
        }
        (state[0], elastance(end_s) * state[0], state[1])
    }
}

/// Looked at in contraction, ejection, relaxation and filling of the second beat.
#[test]
fn stepped_valves_converge_to_the_differential_equation_at_first_order() {
    for end_s in [0.84, 1.0, 1.16, 1.3] {
        let exact = chamber::integrated(1e-6, end_s);
        let error = |step_s: f64| {
            let (volume, pressure, capacitor, _) = chamber::stepped(step_s, end_s);
            [volume - exact.0, pressure - exact.1, capacitor - exact.2]
        };
        let (coarse, fine) = (error(4e-4), error(2e-4));
        println!("{end_s} s: {exact:.4?}, errors {coarse:.6?} {fine:.6?}");
        for (coarse, fine) in coarse.iter().zip(fine) {
            assert!(fine.abs() < 0.02 && (fine.abs() < 1e-5 || (coarse / fine - 2.0).abs() < 0.4), "{end_s} s: {coarse} {fine}");
        }
    }
    let phases = chamber::stepped(0.005, 3.0 * chamber::PERIOD_S).3;
    let cycle: Vec<Phase> = Phase::CYCLE.iter().copied().cycle().take(phases.len() - 1).collect();
    assert!(phases.len() >= 12 && phases[1..] == cycle, "{phases:?}");
}

/// A coarse idealised left ventricle with parameters of its own.
fn ventricle(parameters: &[(Parameter, f64)]) -> HeartModel {
    static ANATOMY: OnceLock<Arc<cardiotwin::anatomy::Anatomy>> = OnceLock::new();
    let anatomy = ANATOMY.get_or_init(|| {
        Arc::new(IdealisedLv::default().build(&MesherSettings::with_edge_length_mm(9.0), &AnatomySettings::default()).unwrap())
    });
    let parameters = parameters.iter().fold(Parameters::default(), |all, &(parameter, value)| all.with(parameter, value).unwrap());
    HeartModel::new(Arc::clone(anatomy), parameters, ModelSettings::default()).unwrap()
}

fn beat(model: &HeartModel, start_time_s: f64, end_time_s: f64) -> Trajectory {
    let plan = SimulationPlan { start_time_s, end_time_s, frame_times_s: vec![] };
    simulate(model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap()
}

/// Prestress: whatever the atrial pressure, and with springs and dashpots all round, the mesh at rest is in equilibrium.
#[test]
fn a_heart_under_atrial_pressure_alone_stays_at_rest() {
    for atrial_kpa in [0.0, 1.0, 4.0] {
        let model = ventricle(&[
            (Parameter::ContractionPeakLv, 0.0),
            (Parameter::AtrialKickLeft, 0.0),
            (Parameter::AtrialPressureLeft, atrial_kpa),
            (Parameter::PericardiumStiffness, 0.075),
            (Parameter::PericardiumDamping, 0.005),
        ]);
        let last = beat(&model, 0.1, 0.6).last;
        let moved = last.motion.position_mm.iter().zip(model.anatomy().mesh.vertices_mm()).map(|(y, x)| (y - x).norm()).fold(0.0, f64::max);
        // 100 steps of rounding of coordinates of 70 mm, 1e-14 mm each.
        println!("{atrial_kpa} kPa: {moved:.1e} mm");
        assert!(moved < 1e-10, "{moved} mm under {atrial_kpa} kPa");
        assert!((last.ventricles[0].pressure_kpa - atrial_kpa).abs() < 1e-8);
    }
}

/// From the columns of `curves.csv` alone: blood is conserved, the aorta answers to its flow as the Windkessel's integral, and pressures
/// stand in the order of their valves.
#[test]
fn the_curves_of_a_beat_keep_what_a_circulation_must() {
    let model = ventricle(&[]);
    let trajectory = beat(&model, -0.1, 0.8);
    let parameters = model.parameters();
    let [resistance, impedance, compliance, venous, valve] = [
        Parameter::ResistanceSystemic,
        Parameter::ImpedanceSystemic,
        Parameter::ComplianceSystemic,
        Parameter::VenousPressureSystemic,
        Parameter::ValveResistance,
    ]
    .map(|parameter| parameters[parameter]);
    let curve: Vec<_> = trajectory.curves.iter().map(|row| (row.time_s, row.ventricle(Ventricle::Left).unwrap())).collect();
    let mut capacitor = parameters[Parameter::InitialPressureAorta];
    for pair in curve.windows(2) {
        let ((before_s, before), (after_s, after)) = (pair[0], pair[1]);
        let step_s = after_s - before_s;
        let sent_ml = step_s * (after.outflow_ml_per_s - after.inflow_ml_per_s);
        assert!((after.volume_ml - before.volume_ml + sent_ml).abs() < 1.01e-6, "at {after_s} s");
        // C ṗ = q − (p − p_v)/R in small steps of the method of Euler and Heun.
        let slope = |pressure: f64| (after.outflow_ml_per_s - (pressure - venous) / resistance) / compliance;
        for _ in 0..100 {
            let small_s = step_s / 100.0;
            let first = slope(capacitor);
            capacitor += small_s * (first + slope(capacitor + small_s * first)) / 2.0;
        }
        let aorta_kpa = capacitor + impedance * after.outflow_ml_per_s;
        assert!((after.arterial_pressure_kpa - aorta_kpa).abs() < 1e-7, "{} {aorta_kpa}", after.arterial_pressure_kpa);
        let (drop_out, drop_in) = (after.pressure_kpa - after.arterial_pressure_kpa, after.atrial_pressure_kpa - after.pressure_kpa);
        let [outflow, inflow] = [drop_out, drop_in].map(|drop| (drop / valve).max(0.0));
        assert!((after.outflow_ml_per_s - outflow).abs() < 1e-5 && (after.inflow_ml_per_s - inflow).abs() < 1e-5, "at {after_s} s");
    }
    let ejected_ml: f64 = curve.windows(2).map(|pair| (pair[1].0 - pair[0].0) * pair[1].1.outflow_ml_per_s).sum();
    assert!(ejected_ml > 40.0, "a beat that ejects {ejected_ml} mL tests nothing");
}
