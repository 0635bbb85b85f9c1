//! The recovery ladder's fast rungs: truth given back by the calibration on a beating left ventricle, same mesh, no images in between.
//!
//! A failure of the first two tests means that the calibration cannot be trusted with any data; of the third, that it does not say when its
//! bounds are wrong; of the fourth, that its intervals cannot be trusted.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{AhaSegment, AnatomySettings, Ventricle};
use cardiotwin::heart::{
    FrameState, HeartModel, ModelSettings, Parameter, Parameters, Part, RegionalParameter, SimulationPlan, TangentError, Trajectory,
    simulate, simulate_with_tangents,
};
use cardiotwin::mesh::SurfaceTag;
use cardiotwin::numerics::{TaylorTest, chi_square_quantile};
use cardiotwin::personalisation::{
    BoundaryResidual, Calibration, CalibrationFrame, CalibrationProblem, CalibrationTrajectory, FreeParameter, GaussNewtonSettings,
    NoiseScale, ParameterSpace, Residual, StackedResidual, SurfaceTarget, TangentModel, Uncertainty, VolumeCurveResidual, WithTangents,
    calibrate,
};
use cardiotwin::phantom::IdealisedLv;
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

const FRAME_COUNT: usize = 20;
const START_S: f64 = -0.1;

fn heart() -> &'static HeartModel {
    static HEART: OnceLock<HeartModel> = OnceLock::new();
    HEART.get_or_init(|| {
        let anatomy = IdealisedLv::default().build(&MesherSettings::with_edge_length_mm(10.0), &AnatomySettings::default()).unwrap();
        HeartModel::new(Arc::new(anatomy), Parameters::default(), ModelSettings::default()).unwrap()
    })
}

fn plan(period_s: f64) -> SimulationPlan {
    let frame_times_s = (0..FRAME_COUNT).map(|k| START_S + period_s * k as f64 / FRAME_COUNT as f64).collect();
    SimulationPlan { start_time_s: START_S, end_time_s: START_S + period_s, frame_times_s }
}

/// What the residuals look at, or its derivative times `factor`.
fn seen(trajectory: Trajectory, factor: f64) -> CalibrationTrajectory {
    let frame = |state: FrameState| CalibrationFrame {
        volume_ml: state.volume_ml.into_iter().map(|volume| volume * factor).collect(),
        pressure_kpa: Vec::new(),
        position_mm: state.position_mm.into_iter().map(|position| position * factor).collect(),
    };
    CalibrationTrajectory { frames: trajectory.frames.into_iter().map(frame).collect(), activation_s: Vec::new() }
}

fn beat(parameters: Parameters) -> CalibrationTrajectory {
    let model = heart().with_parameters(parameters).unwrap();
    let plan = plan(model.parameters()[Parameter::HeartPeriod]);
    seen(simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap(), 1.0)
}

/// The heart over the coordinates of a space.
struct Beating<'a>(&'a ParameterSpace);

impl TangentModel for Beating<'_> {
    type Trajectory = CalibrationTrajectory;
    type Error = TangentError;

    fn simulate(&self, coordinates: &DVector<f64>) -> Result<CalibrationTrajectory, TangentError> {
        let model = heart().with_parameters(self.0.to_parameters(coordinates).unwrap())?;
        let plan = plan(model.parameters()[Parameter::HeartPeriod]);
        Ok(seen(simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(()))?, 1.0))
    }

    fn simulate_with_tangents(&self, coordinates: &DVector<f64>) -> WithTangents<CalibrationTrajectory, TangentError> {
        let parameters = self.0.to_parameters(coordinates).unwrap();
        let slopes: Vec<f64> = self.0.free().map(|entry| entry.transform.slope(parameters[entry.parameter])).collect();
        let free: Vec<RegionalParameter> = self.0.free().map(|entry| entry.parameter).collect();
        let model = heart().with_parameters(parameters)?;
        let plan = plan(model.parameters()[Parameter::HeartPeriod]);
        let (here, tangents) = simulate_with_tangents(&model, &plan, &[], &free, &mut |_, _| ControlFlow::Continue(()))?;
        Ok((seen(here, 1.0), tangents.into_iter().zip(slopes).map(|(tangent, slope)| seen(tangent, slope)).collect()))
    }

    fn tangent_cost(&self, dimension: usize) -> f64 {
        1.0 + 0.15 * dimension as f64
    }
}

fn space(free: &[(Parameter, f64, f64)]) -> ParameterSpace {
    let entry = |&(parameter, lower, upper): &(Parameter, f64, f64)| {
        let entry = FreeParameter::new(parameter).between(lower, upper);
        let mean = entry.prior_mean;
        entry.with_prior(mean, f64::INFINITY)
    };
    ParameterSpace::new(Parameters::default(), free.iter().map(entry).collect()).unwrap()
}

fn with(values: &[(Parameter, f64)]) -> Parameters {
    values.iter().fold(Parameters::default(), |parameters, &(parameter, value)| parameters.with(parameter, value).unwrap())
}

/// The endocardium of every frame, without noise: targets are the true positions with the normals of the true surface.
fn targets(truth: &CalibrationTrajectory) -> Vec<SurfaceTarget> {
    let anatomy = heart().anatomy();
    let surface = &anatomy.surface;
    let mut segments = vec![0; anatomy.mesh.vertex_count()];
    for (corners, &segment) in anatomy.mesh.tetrahedra().iter().zip(&anatomy.aha_segments) {
        corners.iter().for_each(|&vertex| segments[vertex] = u32::from(segment));
    }
    let mut targets = Vec::new();
    for (frame, state) in truth.frames.iter().enumerate() {
        let areas = surface.vertex_area_vectors_mm2(SurfaceTag::EndocardiumLv, &state.position_mm);
        for vertex in surface.vertices_with(SurfaceTag::EndocardiumLv) {
            let (point_mm, normal) = (state.position_mm[vertex], areas[vertex]);
            targets.push(SurfaceTarget { frame, vertex, point_mm, normal, confidence: normal.norm(), group: segments[vertex] });
        }
    }
    targets
}

fn search(
    space: &ParameterSpace,
    residual: &dyn Residual<CalibrationTrajectory>,
    start: &DVector<f64>,
    settings: GaussNewtonSettings,
) -> (Calibration, Uncertainty) {
    let model = Beating(space);
    let problem = CalibrationProblem::new(&model, residual, space).unwrap();
    let found = calibrate(&problem, start, settings, &mut |_| ()).unwrap();
    let posterior = Uncertainty::new(&problem, found.linearisation.as_ref().unwrap(), NoiseScale::AsStated).unwrap();
    (found, posterior)
}

/// Volumes and endocardium of a true heart.
fn perfect_data(truth: &Parameters) -> StackedResidual<'static, CalibrationTrajectory> {
    let data = beat(truth.clone());
    let volumes_ml = data.frames.iter().map(|frame| frame.volume_ml[0]).collect();
    StackedResidual::default()
        .with("volume_lv", VolumeCurveResidual::new(Ventricle::Left, volumes_ml, 1.0).unwrap())
        .with("boundary", BoundaryResidual::new(&targets(&data), 0.5).unwrap())
}

const FREE: [(Parameter, f64, f64); 5] = [
    (Parameter::ContractionPeakLv, 30.0, 400.0),
    (Parameter::ActionPotentialDuration, 0.1, 0.6),
    (Parameter::ConductionVelocity, 150.0, 2000.0),
    (Parameter::RelaxationRate, 5.0, 60.0),
    (Parameter::ResistanceSystemic, 0.04, 0.4),
];
const TRUTH: [f64; 5] = [100.0, 0.26, 650.0, 18.0, 0.16];

fn assert_given_back(start: &DVector<f64>) {
    let values: Vec<_> = FREE.iter().zip(TRUTH).map(|(&(parameter, ..), value)| (parameter, value)).collect();
    let settings = GaussNewtonSettings { step_tolerance: 1e-5, ..GaussNewtonSettings::default() };
    let space = space(&FREE);
    let (found, _) = search(&space, &perfect_data(&with(&values)), start, settings);
    for ((value, truth), (parameter, ..)) in space.to_values(&found.coordinates).iter().zip(TRUTH).zip(FREE) {
        let name = parameter.spec().name;
        assert!((value / truth - 1.0).abs() < 1e-3, "{name}: {value} instead of {truth} ({:?})", found.outcome);
    }
    assert_eq!(found.outcome.status(), "converged");
}

/// MODEL §10: on the same mesh and without noise every global parameter comes back within 0.1 %.
#[test]
fn noise_free_beats_give_their_parameters_back_within_a_thousandth() {
    assert_given_back(&space(&FREE).initial());
}

/// All parameters half or twice the truth.
#[test]
fn a_start_that_is_off_by_a_factor_of_two_comes_to_the_same_truth() {
    for factor in [0.5_f64, 2.0] {
        let start = DVector::from_iterator(5, FREE.iter().zip(TRUTH).map(|(&(_, lower, upper), t)| (t * factor).clamp(lower, upper).ln()));
        assert_given_back(&start);
    }
}

/// The box ends below the true σ0: the answer lies on the bound, says so, and gives no interval for it.
#[test]
fn a_truth_outside_of_its_bounds_is_told_by_the_bound_that_holds() {
    let free = [(Parameter::ContractionPeakLv, 30.0, 110.0), (Parameter::ActionPotentialDuration, 0.15, 0.45)];
    let truth = with(&[(Parameter::ContractionPeakLv, 130.0), (Parameter::ActionPotentialDuration, 0.26)]);
    let space = space(&free);
    let (found, posterior) = search(&space, &perfect_data(&truth), &space.initial(), GaussNewtonSettings::default());
    assert_eq!(found.outcome.status(), "on_bound");
    assert!((space.to_values(&found.coordinates)[0] - 110.0).abs() < 1e-6);
    assert!(posterior.sd[0].is_none() && posterior.sd[1].is_some());
    let verdict = posterior.verdict(&space.names());
    assert!(verdict[0].contains("contraction_peak_lv_kpa is held by its bound"), "{verdict:?}");
}

/// One of the 17 segments contracts with a third of the strength of the others: it is found and sized, and nothing else is called weak. No
/// tie between neighbours helps or hinders.
#[test]
fn a_scar_in_one_segment_is_found_and_sized() {
    let in_segment =
        |number: u8| RegionalParameter::new(Parameter::ContractionPeakLv, Part::Segment(AhaSegment::new(number).unwrap())).unwrap();
    let truth = with(&[(Parameter::ContractionPeakLv, 110.0)]).with(in_segment(10), 40.0).unwrap();
    let entry = |number: u8| FreeParameter::new(in_segment(number)).between(5.0, 400.0).with_prior(100.0, f64::INFINITY);
    let space = ParameterSpace::new(Parameters::default(), (1..=17).map(entry).collect()).unwrap();
    let settings = GaussNewtonSettings { step_tolerance: 1e-4, ..GaussNewtonSettings::default() };
    let (found, _) = search(&space, &perfect_data(&truth), &space.initial(), settings);
    for (number, value) in (1..=17).zip(space.to_values(&found.coordinates)) {
        let expected = truth[in_segment(number)];
        assert!((value / expected - 1.0).abs() < 1e-3, "segment {number}: {value} kPa of {expected} ({:?})", found.outcome);
    }
}

/// Volumes with 2 mL of noise: the errors of σ0 and APD against their stated covariance, NEES within the 99 % band of χ² over six repeats.
#[test]
fn intervals_from_a_noisy_volume_curve_are_consistent() {
    const REPEATS: u64 = 6;
    const SD_ML: f64 = 2.0;
    let free = [(Parameter::ContractionPeakLv, 30.0, 400.0), (Parameter::ActionPotentialDuration, 0.15, 0.45)];
    let truth = with(&[(Parameter::ContractionPeakLv, 110.0), (Parameter::ActionPotentialDuration, 0.28)]);
    let (space, data) = (space(&free), beat(truth.clone()));
    let goal = space.to_coordinates(&truth);
    let noise = Normal::new(0.0, SD_ML).unwrap();
    let mut nees = 0.0;
    for seed in 0..REPEATS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let volumes_ml = data.frames.iter().map(|frame| frame.volume_ml[0] + noise.sample(&mut rng)).collect();
        let residual = VolumeCurveResidual::new(Ventricle::Left, volumes_ml, SD_ML).unwrap();
        let settings = GaussNewtonSettings { step_tolerance: 1e-3, ..GaussNewtonSettings::default() };
        let (found, posterior) = search(&space, &residual, &goal, settings);
        assert_eq!(found.outcome.status(), "converged", "seed {seed}");
        let error = &found.coordinates - &goal;
        nees += error.dot(&posterior.covariance.clone().cholesky().unwrap().solve(&error));
    }
    let degrees = 2.0 * REPEATS as f64;
    let band = chi_square_quantile(degrees, -2.576)..chi_square_quantile(degrees, 2.576);
    assert!(band.contains(&nees), "NEES {nees} outside {band:?}");
}

/// Volumes are a piecewise smooth function of the parameters, valves, activation and all: Gauss–Newton has something to hold on to. Steps
/// of 1 % stay within a piece; over 8 % valve events move to other time steps and the order falls to about 1.6.
#[test]
fn a_beat_has_a_second_order_taylor_remainder() {
    let free = [(Parameter::ContractionPeakLv, 30.0, 400.0), (Parameter::ActionPotentialDuration, 0.15, 0.45)];
    let space = space(&free);
    let volumes = |coordinates: &DVector<f64>| {
        space.to_parameters(coordinates).map(|parameters| {
            let trajectory = beat(parameters);
            DVector::from_iterator(FRAME_COUNT, trajectory.frames.iter().map(|frame| frame.volume_ml[0]))
        })
    };
    let (base, direction) = (space.initial(), DVector::from_vec(vec![1.0, 0.5]));
    let shift = &direction * 1e-4;
    let derivative = (volumes(&(&base + &shift)).unwrap() - volumes(&(&base - &shift)).unwrap()) / 2e-4;
    let test = TaylorTest::run(volumes, &base, &direction, &derivative, 0.01, 4).unwrap();
    assert!((1.7..2.3).contains(&test.order()), "order {} of {:?}", test.order(), test.remainders);
}
