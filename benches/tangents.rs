//! What the derivatives of a beat cost beside the beat: 20 and 40 parameters along with 1 s in steps of 5 ms, on one thread by the processor and on two by the clock.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "a bench that fails loudly")]

use std::hint::black_box;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use cardiotwin::anatomy::AhaSegment;
use cardiotwin::heart::{HeartModel, Parameter, Part, RegionalParameter, SimulationPlan, simulate, simulate_with_tangents};
use cardiotwin::numerics::{CholeskyFactor, CholeskyWorkspace, PanelWorkspace};
use nalgebra::Vector3;

mod hearts;

/// What a study may free on a left ventricle: contraction, activation, circulation, tissue; the other twenty are σ0 by AHA segment and three
/// more.
const PARAMETERS: [Parameter; 20] = [
    Parameter::ContractionPeakLv,
    Parameter::ContractionRate,
    Parameter::RelaxationRate,
    Parameter::ActionPotentialDuration,
    Parameter::ConductionVelocity,
    Parameter::EndocardialSpeedFactor,
    Parameter::OnsetTime,
    Parameter::ResistanceSystemic,
    Parameter::ImpedanceSystemic,
    Parameter::ComplianceSystemic,
    Parameter::VenousPressureSystemic,
    Parameter::InitialPressureAorta,
    Parameter::AtrialPressureLeft,
    Parameter::AtrialKickLeft,
    Parameter::AtrialKickDuration,
    Parameter::FibreStiffness,
    Parameter::TransverseStiffness,
    Parameter::DampingStiffness,
    Parameter::BaseStiffnessNormal,
    Parameter::BaseStiffnessIsotropic,
];

const PLAN: SimulationPlan = SimulationPlan { start_time_s: 0.0, end_time_s: 1.0, frame_times_s: vec![] };

/// Seconds of the processor.
fn timed(what: impl FnOnce()) -> f64 {
    let start_s = hearts::processor_s();
    what();
    hearts::processor_s() - start_s
}

fn beat(model: &HeartModel) {
    black_box(simulate(model, &PLAN, &[], &mut |_, _| ControlFlow::Continue(())).unwrap());
}

fn tangents(model: &HeartModel, parameters: &[RegionalParameter]) {
    black_box(simulate_with_tangents(model, &PLAN, &[], parameters, &mut |_, _| ControlFlow::Continue(())).unwrap());
}

/// Triangular solves by the number of right-hand sides.
fn print_solves(model: &HeartModel) {
    let operator = hearts::step_operator(model.anatomy());
    let mut memory = CholeskyWorkspace::<f64>::default();
    let factor = CholeskyFactor::new(Arc::clone(operator.myocardium().structure()), operator.matrix(), &mut memory).unwrap();
    let load: Vec<Vector3<f64>> = operator.myocardium().rest_mm().to_vec();
    for count in [1, 2, 5, 10, 20, 40] {
        let mut columns = vec![load.clone(); count];
        let mut panel = PanelWorkspace::default();
        let panel_s = (0..4).map(|_| timed(|| factor.solve_panel(&mut columns, &mut panel).unwrap())).fold(f64::INFINITY, f64::min);
        let seconds = (0..4).map(|_| timed(|| factor.solve_in_place(&mut columns, &mut memory).unwrap())).fold(f64::INFINITY, f64::min);
        println!("    {count:2} right-hand sides: {:.1} ms, {:.1} ms as a panel", seconds * 1e3, panel_s * 1e3);
    }
}

fn print_costs(name: &str, edge_length_mm: f64, round_count: usize) {
    let segments = AhaSegment::all().filter_map(|segment| RegionalParameter::new(Parameter::ContractionPeakLv, Part::Segment(segment)));
    let twenty: Vec<RegionalParameter> = PARAMETERS.map(RegionalParameter::from).to_vec();
    let rest = [Parameter::PoissonRatio, Parameter::DampingMass, Parameter::ValveResistance].map(RegionalParameter::from);
    let forty: Vec<RegionalParameter> = twenty.iter().copied().chain(segments).chain(rest).collect();
    let model = hearts::heart(edge_length_mm);
    print_solves(&model);
    let things = || -> Vec<hearts::Timed<'_>> {
        vec![
            ("free beat", Box::new(|| beat(&model))),
            ("with 20 tangents", Box::new(|| tangents(&model, &twenty))),
            ("with 40 tangents", Box::new(|| tangents(&model, &forty))),
        ]
    };
    let title = format!("{name}, {} vertices", model.anatomy().mesh.vertex_count());
    hearts::print_in_turn(&title, round_count, things());
    // What a user waits for, where nobody else computes.
    let begun = Instant::now();
    let two = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let on_two = |thing: &mut (dyn FnMut() + Send)| two.install(thing);
    let things = vec![
        ("free beat", Box::new(|| on_two(&mut || beat(&model))) as Box<dyn FnMut()>),
        ("with 20 tangents", Box::new(|| on_two(&mut || tangents(&model, &twenty)))),
        ("with 40 tangents", Box::new(|| on_two(&mut || tangents(&model, &forty)))),
    ];
    hearts::print_in_turn_by(|| begun.elapsed().as_secs_f64(), &format!("{title}, two threads by the clock"), round_count, things);
}

fn main() {
    // One thread, this one, where nothing else is said.
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().unwrap();
    let is_small = std::env::args().any(|argument| argument == "5k");
    let sizes = if is_small { &hearts::SIZES[..1] } else { &hearts::SIZES[..2] };
    for &(name, edge_length_mm) in sizes {
        print_costs(name, edge_length_mm, if name == "5k" { 5 } else { 3 });
    }
}
