//! What images cost: the boundary search and the block matching, a tracked beat beside a free one, and three ways to keep the
//! preconditioner of K̃ + K_img.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "a bench that fails loudly")]

use std::hint::black_box;
use std::ops::ControlFlow;

use cardiotwin::heart::{HeartModel, ModelSettings, Parameter, Parameters, SimulationPlan, simulate};
use cardiotwin::image::{CineSequence, PreprocessSettings, preprocess};
use cardiotwin::mechanics::{MotionState, SolveSettings, StepLoad, StepOperator, StepSolver};
use cardiotwin::mesh::SurfaceTag;
use cardiotwin::phantom::{IdealisedLv, PrescribedContraction, ShortAxisStack, SyntheticCineSettings, synthetic_cine};
use cardiotwin::tracking::{
    AppearanceSettings, BaseMode, BlockMatchingSettings, BoundarySearch, BoundarySettings, ForceScheme, ImageForce, ImageInstant,
    Similarity, SurfaceAppearance, SurfaceGain, TrackerSettings, match_base, track,
};
use criterion::{BenchmarkId, Criterion};

mod hearts;

const FRAMES: usize = 30;
const PERIOD_S: f64 = 0.8;
const SURFACES: [SurfaceTag; 2] = [SurfaceTag::EndocardiumLv, SurfaceTag::Epicardium];

/// Images of the idealised ventricle in a motion that the model does not make: EF 0.5 in 0.3 s, 8 mm slices, texture, noise.
fn cine(model: &HeartModel) -> CineSequence {
    let (anatomy, shape) = (model.anatomy(), IdealisedLv::default());
    let motion = PrescribedContraction { ejection_fraction: 0.5, ..PrescribedContraction::default() };
    let times_s: Vec<f64> = (0..FRAMES).map(|frame| PERIOD_S * frame as f64 / FRAMES as f64).collect();
    let at =
        |time_s: &f64| motion.positions_mm(&shape, anatomy.mesh.vertices_mm(), PrescribedContraction::share_at(*time_s, 0.3, PERIOD_S));
    let frames_mm: Vec<_> = times_s.iter().map(at).collect();
    let grid = ShortAxisStack::default().grid(anatomy).unwrap();
    let imaged = synthetic_cine(anatomy, &frames_mm, &times_s, PERIOD_S, &grid, &SyntheticCineSettings::default()).unwrap();
    preprocess(&imaged.cine, &PreprocessSettings::default()).unwrap()
}

fn image_force<'a>(model: &'a HeartModel, cine: &'a CineSequence, scheme: ForceScheme, gain_kpa_per_mm: f64) -> ImageForce<'a> {
    let (anatomy, instant) = (model.anatomy(), ImageInstant::new(cine, 0.0));
    let learn = |tag| {
        let settings = AppearanceSettings::default();
        let at = (&instant, 0.0);
        let appearance = SurfaceAppearance::learn(&anatomy.surface, tag, anatomy.mesh.vertices_mm(), at, &settings).unwrap();
        let boundary = BoundarySettings { slice_distance_mm: Some(8.0), ..BoundarySettings::default() };
        SurfaceGain { search: BoundarySearch::new(appearance, settings, boundary).unwrap(), gain_kpa_per_mm }
    };
    ImageForce::new(cine, &anatomy.surface, SURFACES.map(learn).into(), scheme, Vec::new()).unwrap()
}

/// The pieces of a tracked step, and of its beat.
fn pieces(criterion: &mut Criterion<hearts::ProcessorTime>, model: &HeartModel, cine: &CineSequence) {
    let anatomy = model.anatomy();
    let force = image_force(model, cine, ForceScheme::Variational, 20.0);
    let rest_mm = anatomy.mesh.vertices_mm();
    let (mut workspace, mut state) = (model.workspace(), model.initial_state(0.0));
    let base = anatomy.surface.vertices_with(SurfaceTag::Base);
    let vertices = anatomy.mesh.vertex_count();
    println!("{vertices} vertices, {} of them on the base", base.len());
    let mut group = criterion.benchmark_group("tracking");
    group.bench_function(BenchmarkId::new("free_step", vertices), |bencher| {
        bencher.iter(|| state = model.step(&state, &[], &mut workspace).unwrap().state);
    });
    group
        .bench_function(BenchmarkId::new("boundary_search", vertices), |bencher| bencher.iter(|| force.targets(black_box(rest_mm), 0.123)));
    for similarity in [Similarity::Ssd, Similarity::Ncc] {
        let matching = BlockMatchingSettings { similarity, ..BlockMatchingSettings::default() };
        group.bench_function(BenchmarkId::new(format!("block_matching_{similarity:?}"), vertices), |bencher| {
            bencher.iter(|| match_base(black_box(cine), 0, &base, rest_mm, &matching).unwrap());
        });
    }
    group.finish();
}

/// A whole beat, free and tracked.
fn print_beats(model: &HeartModel, cine: &CineSequence) {
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: PERIOD_S, frame_times_s: cine.times_s().to_vec() };
    let free = || {
        let mut observer = |_: &_, _: &_| ControlFlow::Continue(());
        drop(black_box(simulate(model, &plan, &[], &mut observer).unwrap()));
    };
    let tracked = |scheme: ForceScheme, base: BaseMode| {
        let settings = TrackerSettings { scheme, base, ..TrackerSettings::default() };
        move || drop(black_box(track(model, cine, &settings, &mut |_, _| ControlFlow::Continue(())).unwrap()))
    };
    let matching = BaseMode::BlockMatching(BlockMatchingSettings::default());
    hearts::print_in_turn(
        &format!("{} vertices, a beat of {FRAMES} images", model.anatomy().mesh.vertex_count()),
        3,
        vec![
            ("free", Box::new(free)),
            ("tracked, variational", Box::new(tracked(ForceScheme::Variational, BaseMode::Springs))),
            ("tracked, exact", Box::new(tracked(ForceScheme::Exact, BaseMode::Springs))),
            ("tracked, variational, blocks", Box::new(tracked(ForceScheme::Variational, matching))),
        ],
    );
}

/// Steps of the passive wall drawn along the images, with the preconditioner as it is kept by default, factorised in every step, and
/// never again after the first.
fn print_preconditioners(model: &HeartModel, cine: &CineSequence) {
    const STEPS: usize = 20;
    let operator = hearts::step_operator(model.anatomy());
    for (scheme, gain_kpa_per_mm) in [(ForceScheme::Variational, 1.0), (ForceScheme::Variational, 20.0), (ForceScheme::Exact, 20.0)] {
        let force = image_force(model, cine, scheme, gain_kpa_per_mm);
        let ways = [("kept while it serves", 8), ("factorised in every step", 0), ("never again", usize::MAX)];
        let runs = ways.map(|(name, excess_iterations)| {
            let settings = SolveSettings { excess_iterations, ..SolveSettings::default() };
            let (iterations, factorisations) = drawn_along(&operator, &force, settings, STEPS);
            println!("    {name}: {iterations} iterations, {factorisations} factorisations in {STEPS} steps");
            let (operator, force) = (&operator, &force);
            (
                name,
                Box::new(move || {
                    black_box(drawn_along(operator, force, settings, STEPS));
                }) as Box<dyn FnMut()>,
            )
        });
        let vertices = operator.myocardium().vertex_count();
        let title = format!("{vertices} vertices, {STEPS} steps, {scheme:?}, {gain_kpa_per_mm} kPa/mm");
        hearts::print_in_turn(&title, 3, runs.into());
    }
}

/// Iterations and factorisations of some steps from rest.
fn drawn_along(operator: &StepOperator, force: &ImageForce, settings: SolveSettings, step_count: usize) -> (usize, usize) {
    let mut solver = StepSolver::new(settings);
    let mut state = MotionState::at_rest(operator.myocardium().rest_mm().to_vec());
    let mut system = operator.empty_system();
    let (mut iterations, mut factorisations) = (0, 0);
    for step in 0..step_count {
        operator.assemble(&state, None, &mut system).unwrap();
        force.add_to(&state, step as f64 * operator.step_s(), operator.step_s(), &mut system);
        let mut position_mm = state.position_mm.clone();
        let report = solver.solve(operator, &system, &mut position_mm, &mut []).unwrap();
        iterations += report.iteration_count;
        factorisations += usize::from(report.was_refactorised);
        state = operator.advance(&state, position_mm);
    }
    (iterations, factorisations)
}

fn main() {
    // One thread, this one: the clock is its own.
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().unwrap();
    let mut criterion = hearts::criterion();
    for (_, edge_length_mm) in &hearts::SIZES[..2] {
        let parameters = Parameters::default().with(Parameter::HeartPeriod, PERIOD_S).unwrap();
        let model = HeartModel::new(hearts::left_ventricle(*edge_length_mm), parameters, ModelSettings::default()).unwrap();
        let cine = cine(&model);
        pieces(&mut criterion, &model, &cine);
        print_preconditioners(&model, &cine);
        print_beats(&model, &cine);
    }
}
