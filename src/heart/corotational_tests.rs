//! Claims about whole beats under corotational kinematics.

use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use nalgebra::{Matrix3, Vector3};

use super::idealised_lv::IdealisedLv;
use super::*;
use crate::anatomy::mesher::MesherSettings;
use crate::anatomy::{Anatomy, AnatomySettings, IdealisedBiventricle, Ventricle};
use crate::circulation::Phase;
use crate::mechanics::{Kinematics, MotionState, StepLoad, StepSystem, TimeScheme};

fn anatomy() -> Arc<Anatomy> {
    static ANATOMY: OnceLock<Arc<Anatomy>> = OnceLock::new();
    Arc::clone(ANATOMY.get_or_init(|| Arc::new(IdealisedLv::default().anatomy())))
}

fn settings(step_s: f64) -> ModelSettings {
    ModelSettings { step_s, kinematics: Kinematics::Corotational, ..ModelSettings::default() }
}

fn with(values: &[(Parameter, f64)]) -> Parameters {
    values.iter().fold(Parameters::default(), |parameters, &(parameter, value)| parameters.with(parameter, value).unwrap())
}

/// Published stiffness and contraction, under which linear kinematics twist the wall by more than 60°.
fn published() -> Parameters {
    with(&[
        (Parameter::FibreStiffness, 30.0),
        (Parameter::TransverseStiffness, 20.0),
        (Parameter::ContractionPeakLv, 80.0),
        (Parameter::ContractionRate, 15.0),
        (Parameter::RelaxationRate, 25.0),
    ])
}

fn beat(model: &HeartModel, start_time_s: f64, end_time_s: f64, loads: &[&dyn StepLoad]) -> Trajectory {
    let plan = SimulationPlan { start_time_s, end_time_s, frame_times_s: vec![] };
    simulate(model, &plan, loads, &mut |_, _| ControlFlow::Continue(())).unwrap()
}

fn left(trajectory: &Trajectory) -> Vec<(f64, VentricleCurve)> {
    trajectory.curves.iter().map(|row| (row.time_s, row.ventricle(Ventricle::Left).unwrap())).collect()
}

fn farthest_mm(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

#[test]
fn a_heart_that_does_not_contract_stays_at_rest() {
    let parameters = with(&[(Parameter::ContractionPeakLv, 0.0), (Parameter::AtrialKickLeft, 0.0)]);
    let model = HeartModel::new(anatomy(), parameters, settings(0.005)).unwrap();
    let last = beat(&model, -0.1, 0.2, &[]).last;
    let moved_mm = farthest_mm(&last.motion.position_mm, anatomy().mesh.vertices_mm());
    assert!(moved_mm < 1e-6, "a vertex moved by {moved_mm} mm");
}

/// Soft tissue as it is measured, and a contraction near the paper's 90 kPa, give a normal beat of four phases without a lost drop.
#[test]
fn published_stiffness_and_contraction_give_a_normal_beat() {
    let trajectory = beat(&HeartModel::new(anatomy(), published(), settings(0.005)).unwrap(), -0.1, 1.6, &[]);
    let observables = BeatObservables::of_beat(&trajectory.curves, Ventricle::Left, 0.8, 0.8).unwrap();
    let ranges = [
        ("EDV", observables.end_diastolic_volume_ml, 110.0..190.0),
        ("EF", observables.ejection_fraction, 0.5..0.65),
        ("peak pressure", observables.pressure_peak_mmhg, 100.0..140.0),
        ("dP/dt", observables.pressure_rate_max_mmhg_per_s, 1200.0..5000.0),
        ("ejection", observables.ejection_ms, 230.0..360.0),
    ];
    for (name, value, range) in ranges {
        assert!(range.contains(&value), "{name} {value} outside {range:?}");
    }
    let rows = left(&trajectory);
    for pair in rows.windows(2) {
        let sent_ml = (pair[1].0 - pair[0].0) * (pair[1].1.inflow_ml_per_s - pair[1].1.outflow_ml_per_s);
        assert!((pair[1].1.volume_ml - pair[0].1.volume_ml - sent_ml).abs() < 1.01e-6, "at {} s", pair[1].0);
    }
    let mut phases: Vec<Phase> = rows.iter().filter(|(time_s, _)| *time_s > 0.7).map(|(_, curve)| curve.phase).collect();
    phases.dedup();
    let expected: Vec<Phase> = Phase::CYCLE.iter().copied().cycle().skip(3).take(phases.len()).collect();
    let from_filling: Vec<Phase> = std::iter::once(Phase::Filling).chain(Phase::CYCLE.iter().copied().cycle()).take(phases.len()).collect();
    assert!(phases == expected || phases == from_filling, "{phases:?}");
}

/// No twisted branch: the ejection fraction grows with σ0 and no pressure leaps, where a follower load breaks linear kinematics.
#[test]
fn a_stronger_soft_heart_ejects_more_and_its_pressure_does_not_leap() {
    let ejected = |peak_kpa: f64| {
        let parameters = published().with(Parameter::ContractionPeakLv, peak_kpa).unwrap();
        let rows = left(&beat(&HeartModel::new(anatomy(), parameters, settings(0.005)).unwrap(), -0.1, 0.45, &[]));
        let leap = |pair: &[(f64, VentricleCurve)]| (pair[1].1.pressure_kpa - pair[0].1.pressure_kpa).abs();
        let largest_leap_kpa = rows.windows(2).filter(|pair| pair[1].1.phase == Phase::Ejection).map(leap).fold(0.0, f64::max);
        assert!(largest_leap_kpa < 1.5, "{largest_leap_kpa} kPa in one step of ejection at {peak_kpa} kPa");
        let volumes = rows.iter().map(|(_, curve)| curve.volume_ml);
        volumes.clone().fold(0.0, f64::max) - volumes.fold(f64::INFINITY, f64::min)
    };
    let stroke_ml = [60.0, 80.0, 100.0].map(ejected);
    assert!(stroke_ml.windows(2).all(|pair| pair[1] > pair[0] + 5.0), "{stroke_ml:?} mL");
}

/// Both schemes tend to the same pressure as the step shrinks, generalised-α the faster.
#[test]
fn both_time_schemes_tend_to_the_same_contraction() {
    let pressure = |step_s: f64, time_scheme| {
        let settings = ModelSettings { time_scheme, ..settings(step_s) };
        beat(&HeartModel::new(anatomy(), published(), settings).unwrap(), -0.02, 0.06, &[]).last.ventricles[0].pressure_kpa
    };
    let second_order = TimeScheme::GeneralisedAlpha { spectral_radius: 0.5 };
    let (euler, alpha) = ([0.004, 0.002, 0.001].map(|h| pressure(h, TimeScheme::BackwardEuler)), pressure(0.001, second_order));
    let order = ((euler[0] - euler[1]) / (euler[1] - euler[2])).abs().log2();
    assert!((order - 1.0).abs() < 0.3, "order {order} of {euler:?} kPa");
    let limit = 2.0 * euler[2] - euler[1];
    assert!((alpha - limit).abs() < 0.5 * (euler[2] - limit).abs(), "generalised-α {alpha}, limit of Euler {limit}, Euler {}", euler[2]);
}

/// Springs that draw every vertex to a recorded motion.
struct Recorded {
    step_s: f64,
    positions_mm: Vec<Vec<Vector3<f64>>>,
    stiffness_mn_per_mm: Matrix3<f64>,
}

impl StepLoad for Recorded {
    fn add_to(&self, _: &MotionState, time_s: f64, step_s: f64, system: &mut StepSystem) {
        let step = ((time_s + step_s) / self.step_s).round() as usize;
        for (vertex, target) in self.positions_mm[step].iter().enumerate() {
            system.force_mn[vertex] += self.stiffness_mn_per_mm * target;
            system.stiffness_mn_per_mm[vertex] += self.stiffness_mn_per_mm;
        }
    }
}

/// Also where the data's stiffness is not symmetric, as the exact image forces are.
#[test]
fn data_that_agree_with_the_model_do_not_change_its_beat() {
    let model = HeartModel::new(anatomy(), published(), settings(0.005)).unwrap();
    let mut positions_mm = vec![];
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: 0.12, frame_times_s: vec![] };
    let observer = &mut |state: &HeartState, _: &CurveRow| {
        positions_mm.push(state.motion.position_mm.clone());
        ControlFlow::Continue(())
    };
    let free = simulate(&model, &plan, &[], observer).unwrap();
    for tilt in [0.0, 8.0] {
        let stiffness_mn_per_mm = Matrix3::new(30.0, tilt, 0.0, 0.0, 30.0, 0.0, 0.0, 0.0, 30.0);
        let data = Recorded { step_s: 0.005, positions_mm: positions_mm.clone(), stiffness_mn_per_mm };
        let guided = beat(&model, 0.0, 0.12, &[&data]);
        let apart_mm = farthest_mm(&free.last.motion.position_mm, &guided.last.motion.position_mm);
        assert!(apart_mm < 1e-3, "{apart_mm} mm with tilt {tilt}");
    }
}

#[test]
fn a_beat_does_not_depend_on_the_number_of_threads() {
    let model = HeartModel::new(anatomy(), published(), settings(0.005)).unwrap();
    let on = |thread_count: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(thread_count).build().unwrap();
        pool.install(|| beat(&model, 0.0, 0.12, &[]))
    };
    assert!(on(1) == on(2));
}

/// Two soft ventricles contracted twice as hard as they should be, whose tangent is not positive definite at end-systole. Newton's method
/// with the exact tangent alone ends after 0.12 s of it.
#[test]
fn soft_ventricles_that_are_contracted_hard_beat() {
    let shape = IdealisedBiventricle::default();
    let (mesher, settings_of_anatomy) = (MesherSettings::with_edge_length_mm(14.0), AnatomySettings::default());
    let ventricles = Arc::new(shape.build(&mesher, &settings_of_anatomy).unwrap());
    let parameters = with(&[
        (Parameter::FibreStiffness, 20.0),
        (Parameter::TransverseStiffness, 10.0),
        (Parameter::ContractionPeakLv, 200.0),
        (Parameter::ContractionPeakRv, 160.0),
        (Parameter::ContractionRate, 20.0),
        (Parameter::BaseStiffnessNormal, 0.0),
        (Parameter::BaseStiffnessIsotropic, 0.3),
        (Parameter::PericardiumStiffness, 0.1),
    ]);
    let trajectory = beat(&HeartModel::new(ventricles, parameters, settings(0.005)).unwrap(), 0.0, 0.3, &[]);
    let volumes = left(&trajectory).into_iter().map(|(_, curve)| curve.volume_ml);
    let ejected = 1.0 - volumes.clone().fold(f64::INFINITY, f64::min) / volumes.fold(0.0, f64::max);
    assert!(ejected > 0.6, "{ejected}");
}

/// A step in parts ends where the whole one would have, at its time; blood is conserved over it, and the parts tend to it as it shrinks.
#[test]
fn a_step_in_halves_tends_to_the_whole_step() {
    let apart = |step_s: f64| {
        let model = HeartModel::new(anatomy(), published(), settings(step_s)).unwrap();
        let start = beat(&model, -0.02, 0.04, &[]).last;
        let whole = model.step(&start, &[], &mut model.workspace()).unwrap();
        let why = StepError::NotConverged { time_s: 0.0, step_s, residual_mn: 1.0, tolerance_mn: 0.0, volume_defect_ml: 0.0 };
        let halves = model.halved_step(&start, &[], &mut model.workspace(), why).unwrap();
        assert_eq!((whole.substep_count, halves.substep_count), (1, 2));
        assert_eq!(whole.state.time_s.to_bits(), halves.state.time_s.to_bits());
        let (before, after) = (&start.ventricles[0], &halves.state.ventricles[0]);
        let sent_mm3 = 1e3 * step_s * (after.inflow_ml_per_s - after.outflow_ml_per_s);
        assert!((after.volume_mm3 - before.volume_mm3 - sent_mm3).abs() < 2.1e-3, "{sent_mm3} mm³");
        farthest_mm(&whole.state.motion.position_mm, &halves.state.motion.position_mm)
    };
    let distances = [0.004, 0.002, 0.001].map(apart);
    assert!(distances.windows(2).all(|pair| pair[1] < 0.4 * pair[0]), "{distances:?} mm");
}

/// What no part of a step makes better is told as the whole step's error.
#[test]
fn halves_that_fail_leave_the_error_of_the_whole_step() {
    struct Torn;
    impl StepLoad for Torn {
        fn add_to(&self, _: &MotionState, _: f64, _: f64, system: &mut StepSystem) {
            system.force_mn[5].x = f64::NAN;
        }
    }
    let model = HeartModel::new(anatomy(), published(), settings(0.004)).unwrap();
    let error = model.step(&model.initial_state(0.1), &[&Torn], &mut model.workspace()).unwrap_err();
    assert!(error.to_string().starts_with("at 0.1000 s (step 0.004 s)"), "{error}");
}

/// Steps of 0.5 to 10 ms, stiffness and contraction over their whole ranges: a beat, or (only in tissue a thousand times softer than
/// muscle) an error that says when, with the step.
#[test]
fn every_corner_of_the_ranges_gives_a_beat_or_an_error_with_its_time() {
    let coarse = Arc::new(IdealisedLv { resolution: [8, 4, 1], ..IdealisedLv::default() }.anatomy());
    let range = |parameter: Parameter| [parameter.spec().lower, parameter.spec().default, parameter.spec().upper];
    for step_s in [0.0005, 0.002, 0.01] {
        for stiffness_kpa in range(Parameter::FibreStiffness) {
            for peak_kpa in range(Parameter::ContractionPeakLv) {
                let values = [
                    (Parameter::FibreStiffness, stiffness_kpa),
                    (Parameter::TransverseStiffness, stiffness_kpa),
                    (Parameter::ContractionPeakLv, peak_kpa),
                ];
                let model = HeartModel::new(Arc::clone(&coarse), with(&values), settings(step_s)).unwrap();
                let plan = SimulationPlan { start_time_s: 0.0, end_time_s: 0.2, frame_times_s: vec![] };
                match simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())) {
                    Ok(trajectory) => {
                        let is_finite = |(_, curve): (f64, VentricleCurve)| curve.volume_ml.is_finite() && curve.pressure_kpa.is_finite();
                        assert!(left(&trajectory).into_iter().all(is_finite));
                    }
                    Err(error) => {
                        let words = error.to_string();
                        assert!(stiffness_kpa < 1.0, "{words} with a stiffness of {stiffness_kpa} kPa");
                        assert!(words.starts_with("at 0.") && words.contains(&format!("(step {step_s} s)")), "{words}");
                    }
                }
            }
        }
    }
}
