//! A cine of 30 images followed by a heart of two ventricles and 15 thousand vertices in steps of 5 ms: frames a second, and what the
//! images cost over the free beat. `-- corotational` does the same under large rotations, `-- 5k` on a coarser mesh.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "a bench that fails loudly")]

use std::hint::black_box;
use std::ops::ControlFlow;

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{AnatomySettings, IdealisedBiventricle};
use cardiotwin::heart::{HeartModel, ModelSettings, Parameter, Parameters, SimulationPlan, simulate};
use cardiotwin::image::{CineSequence, PreprocessSettings, preprocess};
use cardiotwin::mechanics::Kinematics;
use cardiotwin::phantom::{ShortAxisStack, SyntheticCineSettings, synthetic_cine};
use cardiotwin::tracking::{BaseMode, BlockMatchingSettings, BoundarySettings, ForceScheme, TrackerSettings, track};

mod hearts;

const FRAMES: usize = 30;
const PERIOD_S: f64 = 0.8;
const STEP_S: f64 = 0.005;

fn heart(edge_length_mm: f64, kinematics: Kinematics) -> HeartModel {
    let mesher = MesherSettings::with_edge_length_mm(edge_length_mm);
    let anatomy = IdealisedBiventricle::default().build(&mesher, &AnatomySettings::default()).unwrap();
    let soft = [(Parameter::FibreStiffness, 30.0), (Parameter::TransverseStiffness, 20.0), (Parameter::ContractionPeakLv, 80.0)];
    let values = if kinematics == Kinematics::Corotational { &soft[..] } else { &[] };
    let parameters = Parameters::default().with(Parameter::HeartPeriod, PERIOD_S).unwrap();
    let parameters = values.iter().fold(parameters, |all, &(parameter, value)| all.with(parameter, value).unwrap());
    HeartModel::new(anatomy.into(), parameters, ModelSettings { kinematics, step_s: STEP_S, ..ModelSettings::default() }).unwrap()
}

/// Images of a heart that contracts by a third less than the one that is to follow them: 8 mm slices, texture, noise.
fn cine(model: &HeartModel) -> CineSequence {
    let anatomy = model.anatomy();
    let weaker = [Parameter::ContractionPeakLv, Parameter::ContractionPeakRv]
        .into_iter()
        .fold(model.parameters().clone(), |all, peak| all.with(peak, model.parameters()[peak] / 1.5).unwrap());
    let weaker = model.with_parameters(weaker).unwrap();
    let times_s: Vec<f64> = (0..FRAMES).map(|frame| PERIOD_S * frame as f64 / FRAMES as f64).collect();
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: PERIOD_S, frame_times_s: times_s.clone() };
    let truth = simulate(&weaker, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
    let frames_mm: Vec<_> = truth.frames.into_iter().map(|frame| frame.position_mm).collect();
    let grid = ShortAxisStack::default().grid(anatomy).unwrap();
    let imaged = synthetic_cine(anatomy, &frames_mm, &times_s, PERIOD_S, &grid, &SyntheticCineSettings::default()).unwrap();
    preprocess(&imaged.cine, &PreprocessSettings::default()).unwrap()
}

fn print_beats(model: &HeartModel, round_count: usize) {
    let start_s = hearts::processor_s();
    let cine = &cine(model);
    println!("images: {:?} voxels, {:.1} s", cine.grid().shape(), hearts::processor_s() - start_s);
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: PERIOD_S, frame_times_s: cine.times_s().to_vec() };
    let free = || {
        drop(black_box(simulate(model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap()));
    };
    let tracked = |scheme: ForceScheme, base: BaseMode| {
        let boundary = BoundarySettings { slice_distance_mm: Some(8.0), ..BoundarySettings::default() };
        let settings = TrackerSettings { scheme, base, boundary, ..TrackerSettings::default() };
        move || drop(black_box(track(model, cine, &settings, &mut |_, _| ControlFlow::Continue(())).unwrap()))
    };
    let matching = BaseMode::BlockMatching(BlockMatchingSettings::default());
    hearts::print_in_turn(
        &format!("{} vertices, a beat of {FRAMES} images, {} steps", model.anatomy().mesh.vertex_count(), PERIOD_S / STEP_S),
        round_count,
        vec![
            ("free", Box::new(free)),
            ("tracked, variational", Box::new(tracked(ForceScheme::Variational, BaseMode::Springs))),
            ("tracked, variational, blocks", Box::new(tracked(ForceScheme::Variational, matching))),
        ],
    );
}

fn main() {
    // One thread, this one: the clock is its own.
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().unwrap();
    let has = |word: &str| std::env::args().any(|argument| argument == word);
    let kinematics = if has("corotational") { Kinematics::Corotational } else { Kinematics::Linear };
    let edge_length_mm = if has("5k") { 5.0 } else { 3.2 };
    let model = heart(edge_length_mm, kinematics);
    print_beats(&model, if has("once") { 1 } else { 3 });
}
