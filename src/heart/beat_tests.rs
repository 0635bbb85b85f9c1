//! Claims about whole beats of an idealised left ventricle.

use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use nalgebra::Vector3;
use rayon::prelude::*;

use super::idealised_lv::IdealisedLv;
use super::*;
use crate::anatomy::{Anatomy, Ventricle};
use crate::circulation::Phase;
use crate::mechanics::{MotionState, StepLoad, StepSystem};
use crate::mesh::SurfaceTag;

fn anatomy() -> Arc<Anatomy> {
    static ANATOMY: OnceLock<Arc<Anatomy>> = OnceLock::new();
    Arc::clone(ANATOMY.get_or_init(|| Arc::new(IdealisedLv::default().anatomy())))
}

fn model(parameters: Parameters, step_s: f64) -> HeartModel {
    HeartModel::new(anatomy(), parameters, ModelSettings { step_s, ..ModelSettings::default() }).unwrap()
}

fn beat(model: &HeartModel, start_time_s: f64, end_time_s: f64, loads: &[&dyn StepLoad]) -> Trajectory {
    let plan = SimulationPlan { start_time_s, end_time_s, frame_times_s: vec![] };
    simulate(model, &plan, loads, &mut |_, _| ControlFlow::Continue(())).unwrap()
}

/// Three beats with the defaults, computed once.
fn default_beats() -> &'static Trajectory {
    static BEATS: OnceLock<Trajectory> = OnceLock::new();
    BEATS.get_or_init(|| beat(&model(Parameters::default(), 0.005), -0.1, 2.4, &[]))
}

fn left(trajectory: &Trajectory) -> Vec<(f64, VentricleCurve)> {
    trajectory.curves.iter().map(|row| (row.time_s, row.ventricle(Ventricle::Left).unwrap())).collect()
}

/// Prestress: the mesh rests under the atrial pressure of its start, and the aorta drains by its closed form.
#[test]
fn a_heart_that_does_not_contract_stays_at_rest() {
    let parameters = [(Parameter::ContractionPeakLv, 0.0), (Parameter::AtrialKickLeft, 0.0)]
        .into_iter()
        .fold(Parameters::default(), |parameters, (parameter, value)| parameters.with(parameter, value).unwrap());
    let model = model(parameters.clone(), 0.005);
    let last = beat(&model, -0.2, 0.8, &[]).last;
    let farthest = last.motion.position_mm.iter().zip(anatomy().mesh.vertices_mm()).map(|(y, x)| (y - x).norm()).fold(0.0, f64::max);
    assert!(farthest < 1e-8, "a vertex moved by {farthest} mm");
    let decay = (-1.0 / (parameters[Parameter::ResistanceSystemic] * parameters[Parameter::ComplianceSystemic])).exp();
    let venous = parameters[Parameter::VenousPressureSystemic];
    let exact = venous + (parameters[Parameter::InitialPressureAorta] - venous) * decay;
    assert!((last.ventricles[0].arterial_pressure_kpa - exact).abs() < 1e-9);
}

/// What a search for σ0 rests on. A follower load breaks it: the wall snaps into a twisted state, which linear kinematics take for growth.
#[test]
fn a_stronger_heart_ejects_more_and_its_pressure_does_not_leap() {
    let ejected = |peak_kpa: f64| {
        let parameters = Parameters::default().with(Parameter::ContractionPeakLv, peak_kpa).unwrap();
        let rows = left(&beat(&model(parameters, 0.005), -0.1, 0.7, &[]));
        let leap = |pair: &[(f64, VentricleCurve)]| (pair[1].1.pressure_kpa - pair[0].1.pressure_kpa).abs();
        let largest_leap_kpa = rows.windows(2).filter(|pair| pair[1].1.phase == Phase::Ejection).map(leap).fold(0.0, f64::max);
        assert!(largest_leap_kpa < 1.5, "{largest_leap_kpa} kPa in one step of ejection at {peak_kpa} kPa");
        let volumes = rows.iter().map(|(_, curve)| curve.volume_ml);
        volumes.clone().fold(0.0, f64::max) - volumes.fold(f64::INFINITY, f64::min)
    };
    let stroke_ml = [80.0, 120.0, 160.0].map(ejected);
    assert!(stroke_ml.windows(2).all(|pair| pair[1] > pair[0] + 2.0), "{stroke_ml:?} mL");
}

#[test]
fn blood_is_conserved_to_a_millionth_of_a_millilitre_in_every_step() {
    for pair in left(default_beats()).windows(2) {
        let ((before_s, before), (after_s, after)) = (pair[0], pair[1]);
        let sent_ml = (after_s - before_s) * (after.inflow_ml_per_s - after.outflow_ml_per_s);
        let defect_ml = after.volume_ml - before.volume_ml - sent_ml;
        assert!(defect_ml.abs() < 1.01e-6, "{defect_ml} mL at {after_s} s");
    }
}

#[test]
fn the_pressures_stand_in_the_order_of_each_phase() {
    const ROUNDING_KPA: f64 = 1e-8;
    for (time_s, c) in left(default_beats()).into_iter().skip(1) {
        let is_in_order = match c.phase {
            Phase::Filling => c.pressure_kpa <= c.atrial_pressure_kpa + ROUNDING_KPA && c.outflow_ml_per_s == 0.0,
            Phase::Ejection => c.pressure_kpa >= c.arterial_pressure_kpa - ROUNDING_KPA && c.inflow_ml_per_s == 0.0,
            Phase::IsovolumetricContraction | Phase::IsovolumetricRelaxation => {
                c.pressure_kpa >= c.atrial_pressure_kpa - ROUNDING_KPA && c.pressure_kpa <= c.arterial_pressure_kpa + ROUNDING_KPA
            }
        };
        assert!(is_in_order, "at {time_s} s: {c:?}");
    }
}

#[test]
fn the_four_phases_follow_each_other_once_a_beat() {
    let mut phases: Vec<Phase> = left(default_beats()).iter().filter(|(t, _)| *t > 0.7).map(|(_, c)| c.phase).collect();
    phases.dedup();
    assert_eq!(phases[0], Phase::Filling);
    for (index, phase) in phases[1..].iter().enumerate() {
        assert_eq!(*phase, Phase::CYCLE[index % 4], "{phases:?}");
    }
    assert!((8..=10).contains(&phases.len()), "{phases:?}");
}

/// The ranges of a normal ventricle (volumes and pressures of \[Hudsmith2005\] and textbooks); durations looser, since they are not fitted.
#[test]
fn the_default_ventricle_beats_within_normal_ranges() {
    let beat = BeatObservables::of_beat(&default_beats().curves, Ventricle::Left, 1.6, 0.8).unwrap();
    let ranges = [
        ("EDV", beat.end_diastolic_volume_ml, 110.0..190.0),
        ("EF", beat.ejection_fraction, 0.5..0.65),
        ("peak pressure", beat.pressure_peak_mmhg, 100.0..140.0),
        ("end-diastolic pressure", beat.pressure_end_diastolic_mmhg, 5.0..12.0),
        ("dP/dt", beat.pressure_rate_max_mmhg_per_s, 1200.0..5000.0),
        ("arterial systolic", beat.arterial_pressure_systolic_mmhg, 100.0..140.0),
        ("arterial diastolic", beat.arterial_pressure_diastolic_mmhg, 65.0..90.0),
        ("ejection", beat.ejection_ms, 250.0..360.0),
    ];
    for (name, value, range) in ranges {
        assert!(range.contains(&value), "{name} {value} outside {range:?}");
    }
}

#[test]
fn beats_become_periodic() {
    let curves = left(default_beats());
    let change =
        |first: usize| (0..160).map(|k| (curves[first + 160 + k].1.volume_ml - curves[first + k].1.volume_ml).abs()).fold(0.0, f64::max);
    let (early, late) = (change(20), change(180));
    assert!(late < 0.6 * early, "{early} mL, then {late} mL");
}

/// Backward Euler in the muscle and steps of constant flow in the arteries: halving h halves the error. No valve moves on the way: the
/// atrial kick is over before.
#[test]
fn the_pressure_converges_at_first_order_in_the_step() {
    let parameters = Parameters::default().with(Parameter::AtrialKickOverlap, 0.0).unwrap();
    let pressure = |step_s: f64| beat(&model(parameters.clone(), step_s), -0.04, 0.056, &[]).last.ventricles[0].pressure_kpa;
    let pressures = [0.004, 0.002, 0.001, 0.0005].map(pressure);
    let orders: Vec<f64> = pressures.windows(3).map(|p| ((p[0] - p[1]) / (p[1] - p[2])).abs().log2()).collect();
    assert!((orders[1] - 1.0).abs() < 0.25, "orders {orders:?} of {pressures:?} kPa");
}

#[test]
fn a_changed_model_is_bitwise_a_fresh_one() {
    let reference = model(Parameters::default(), 0.005);
    let changes = [
        (Parameter::ContractionPeakLv, 250.0),
        (Parameter::ActionPotentialDuration, 0.27),
        (Parameter::ConductionVelocity, 450.0),
        (Parameter::ResistanceSystemic, 0.15),
        (Parameter::FibreStiffness, 280.0),
        (Parameter::OnsetTime, 0.03),
    ];
    for (parameter, value) in changes {
        let parameters = Parameters::default().with(parameter, value).unwrap();
        let changed = reference.with_parameters(parameters.clone()).unwrap();
        let fresh = model(parameters, 0.005);
        let [a, b] = [&changed, &fresh].map(|m| beat(m, -0.02, 0.15, &[]));
        assert!(a == b, "{parameter:?}");
        let keeps_factor = parameter != Parameter::FibreStiffness;
        assert_eq!(Arc::ptr_eq(&changed.operator, &reference.operator), keeps_factor, "{parameter:?}");
        let keeps_map = !matches!(parameter, Parameter::ConductionVelocity | Parameter::OnsetTime);
        assert_eq!(std::ptr::eq(changed.activation(), reference.activation()), keeps_map, "{parameter:?}");
    }
}

#[test]
fn threads_that_share_a_model_find_the_same_beat() {
    let model = model(Parameters::default(), 0.005);
    let alone = beat(&model, 0.0, 0.1, &[]);
    let together: Vec<Trajectory> = (0..4).into_par_iter().map(|_| beat(&model, 0.0, 0.1, &[])).collect();
    assert!(together.iter().all(|trajectory| *trajectory == alone));
}

/// Springs that draw every vertex to where it should be at the end of each step.
struct Recorded<'a> {
    start_s: f64,
    step_s: f64,
    positions_mm: &'a [Vec<Vector3<f64>>],
    stiffness_mn_per_mm: f64,
}

impl StepLoad for Recorded<'_> {
    fn add_to(&self, _: &MotionState, time_s: f64, step_s: f64, system: &mut StepSystem) {
        let step = ((time_s + step_s - self.start_s) / self.step_s).round() as usize;
        for (vertex, target) in self.positions_mm[step].iter().enumerate() {
            system.force_mn[vertex] += target * self.stiffness_mn_per_mm;
            system.stiffness_mn_per_mm[vertex] += nalgebra::Matrix3::identity() * self.stiffness_mn_per_mm;
        }
    }
}

fn recorded_motion(model: &HeartModel, end_s: f64) -> (Trajectory, Vec<Vec<Vector3<f64>>>) {
    let mut positions_mm = vec![];
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: end_s, frame_times_s: vec![] };
    let free = simulate(model, &plan, &[], &mut |state, _| {
        positions_mm.push(state.motion.position_mm.clone());
        ControlFlow::Continue(())
    });
    (free.unwrap(), positions_mm)
}

#[test]
fn data_that_agree_with_the_model_do_not_change_its_beat() {
    let model = model(Parameters::default(), 0.005);
    let (free, positions_mm) = recorded_motion(&model, 0.15);
    let data = Recorded { start_s: 0.0, step_s: 0.005, positions_mm: &positions_mm, stiffness_mn_per_mm: 30.0 };
    let guided = beat(&model, 0.0, 0.15, &[&data]);
    for (a, b) in left(&free).into_iter().zip(left(&guided)) {
        // The guided steps are solved iteratively, to 1e-8 of their right-hand sides.
        assert!((a.1.volume_ml - b.1.volume_ml).abs() < 1e-3 && (a.1.pressure_kpa - b.1.pressure_kpa).abs() < 1e-3, "{a:?} {b:?}");
    }
}

/// The stronger the data, the closer a heart with the wrong contraction comes to the recorded motion; volumes stay met.
#[test]
fn data_draw_a_wrong_heart_to_the_recorded_motion() {
    let truth = model(Parameters::default(), 0.005);
    let (recorded, positions_mm) = recorded_motion(&truth, 0.2);
    let wrong = truth.with_parameters(Parameters::default().with(Parameter::ContractionPeakLv, 150.0).unwrap()).unwrap();
    let volume_error = |stiffness_mn_per_mm: f64| {
        let data = Recorded { start_s: 0.0, step_s: 0.005, positions_mm: &positions_mm, stiffness_mn_per_mm };
        let guided = beat(&wrong, 0.0, 0.2, &[&data]);
        for pair in left(&guided).windows(2) {
            let sent_ml = (pair[1].0 - pair[0].0) * (pair[1].1.inflow_ml_per_s - pair[1].1.outflow_ml_per_s);
            assert!((pair[1].1.volume_ml - pair[0].1.volume_ml - sent_ml).abs() < 1.01e-6);
        }
        left(&recorded).iter().zip(left(&guided)).map(|(a, b)| (a.1.volume_ml - b.1.volume_ml).abs()).fold(0.0, f64::max)
    };
    let errors = [1e3, 1e4, 1e5].map(volume_error);
    assert!(errors[1] < 0.5 * errors[0] && errors[2] < 0.5 * errors[1] && errors[2] < 0.5, "{errors:?} mL");
}

#[test]
fn a_recorded_base_moves_the_base_and_a_resting_one_does_nothing() {
    let anatomy = anatomy();
    let base = anatomy.surface.vertices_with(SurfaceTag::Base);
    let rest_mm: Vec<Vector3<f64>> = base.iter().map(|&v| anatomy.mesh.vertices_mm()[v]).collect();
    let low_mm: Vec<Vector3<f64>> = rest_mm.iter().map(|x| x - Vector3::z() * 8.0).collect();
    let with_base = |positions_mm: Vec<Vec<Vector3<f64>>>| {
        let motion = BaseMotion::new(vec![0.0, 0.3], positions_mm, 0.8).unwrap();
        let settings = ModelSettings { base_motion: Some(Arc::new(motion)), ..ModelSettings::default() };
        beat(&HeartModel::new(Arc::clone(&anatomy), Parameters::default(), settings).unwrap(), 0.0, 0.3, &[]).last
    };
    let still = with_base(vec![rest_mm.clone(), rest_mm.clone()]);
    assert!(still == beat(&model(Parameters::default(), 0.005), 0.0, 0.3, &[]).last);
    let moved = with_base(vec![rest_mm, low_mm]);
    let descent = |state: &HeartState| {
        let sunk = base.iter().map(|&v| anatomy.mesh.vertices_mm()[v].z - state.motion.position_mm[v].z);
        sunk.sum::<f64>() / base.len() as f64
    };
    assert!(descent(&moved) - descent(&still) > 5.0, "{} against {} mm", descent(&moved), descent(&still));
}

#[test]
fn frames_lie_between_their_steps() {
    let model = model(Parameters::default(), 0.005);
    let plan = SimulationPlan { start_time_s: -0.02, end_time_s: 0.1, frame_times_s: vec![-0.5, -0.02, 0.0, 0.0525, 0.1, 0.2] };
    let trajectory = simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
    let times: Vec<f64> = trajectory.frames.iter().map(|frame| frame.time_s).collect();
    assert_eq!(times, [-0.02, 0.0, 0.0525, 0.1], "frames outside the simulation are left out");
    let curves = left(&trajectory);
    let middle = (curves[14].1.volume_ml + curves[15].1.volume_ml) / 2.0;
    assert!((trajectory.frames[2].volume_ml[0] - middle).abs() < 1e-9);
    let ends = trajectory.frames[3].position_mm.iter().zip(&trajectory.last.motion.position_mm);
    assert!(ends.map(|(frame, last)| (frame - last).norm()).fold(0.0, f64::max) < 1e-12);
}

#[test]
fn an_observer_can_stop_a_beat() {
    let model = model(Parameters::default(), 0.005);
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: 0.8, frame_times_s: vec![] };
    let stop =
        &mut |state: &HeartState, _: &CurveRow| if state.time_s > 0.0149 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let trajectory = simulate(&model, &plan, &[], stop).unwrap();
    assert!(trajectory.stopped);
    assert_eq!(trajectory.curves.len(), 4);
}

#[test]
fn hearts_that_cannot_beat_are_refused_with_the_reason() {
    let settings = ModelSettings { step_s: 0.2, ..ModelSettings::default() };
    let error = HeartModel::new(anatomy(), Parameters::default(), settings).unwrap_err();
    assert!(error.to_string().starts_with("step_s = 0.2 is not allowed"), "{error}");
    let too_long = Parameters::default().with(Parameter::HeartPeriod, 0.29).unwrap();
    assert!(matches!(model(Parameters::default(), 0.005).with_parameters(too_long), Err(HeartError::Mechanics(_))));
    let motion = Some(Arc::new(BaseMotion::new(vec![0.0], vec![vec![Vector3::zeros(); 3]], 0.8).unwrap()));
    let settings = ModelSettings { base_motion: motion, ..ModelSettings::default() };
    assert!(matches!(HeartModel::new(anatomy(), Parameters::default(), settings), Err(HeartError::BaseMotion { .. })));
    let mut short = (*anatomy()).clone();
    short.regions.pop();
    let error = HeartModel::new(Arc::new(short), Parameters::default(), ModelSettings::default()).unwrap_err();
    assert!(matches!(error, HeartError::AnatomyField { field: "regions", .. }));
}

/// Forces beyond all reason give an error with its time, not a NaN.
#[test]
fn a_heart_that_blows_up_says_when() {
    struct Torn;
    impl StepLoad for Torn {
        fn add_to(&self, _: &MotionState, time_s: f64, _: f64, system: &mut StepSystem) {
            if time_s > 0.01 {
                system.force_mn[0] += Vector3::repeat(1e12);
            }
        }
    }
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: 0.1, frame_times_s: vec![] };
    let error = simulate(&model(Parameters::default(), 0.005), &plan, &[&Torn], &mut |_, _| ControlFlow::Continue(())).unwrap_err();
    assert!(matches!(error, StepError::BlownUp { time_s, .. } if (time_s - 0.015).abs() < 1e-9), "{error}");
}
