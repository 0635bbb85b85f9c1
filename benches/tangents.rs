//! What the derivatives of a beat cost beside the beat: 20 and 40 parameters along with 1 s in steps of 5 ms.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "criterion's macros, and a bench that fails loudly")]

use std::hint::black_box;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use cardiotwin::anatomy::AhaSegment;
use cardiotwin::heart::{HeartModel, Parameter, Part, RegionalParameter, SimulationPlan, simulate, simulate_with_tangents};
use cardiotwin::numerics::{CholeskyFactor, CholeskyWorkspace};
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;
use rustix::time::{ClockId, clock_gettime};

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

/// Seconds on the clock, and of the processor in all threads.
fn timed(what: impl FnOnce()) -> (f64, f64) {
    let processor_s = || {
        let used = clock_gettime(ClockId::ProcessCPUTime);
        used.tv_sec as f64 + used.tv_nsec as f64 * 1e-9
    };
    let (clock, start_s) = (Instant::now(), processor_s());
    what();
    (clock.elapsed().as_secs_f64(), processor_s() - start_s)
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
        let seconds = (0..4).map(|_| timed(|| factor.solve_in_place(&mut columns, &mut memory).unwrap()).1).fold(f64::INFINITY, f64::min);
        println!("    {count:2} right-hand sides: {:.1} ms", seconds * 1e3);
    }
}

fn cost(_: &mut Criterion<hearts::ProcessorTime>) {
    let segments = AhaSegment::all().filter_map(|segment| RegionalParameter::new(Parameter::ContractionPeakLv, Part::Segment(segment)));
    let twenty: Vec<RegionalParameter> = PARAMETERS.map(RegionalParameter::from).to_vec();
    let rest = [Parameter::PoissonRatio, Parameter::DampingMass, Parameter::ValveResistance].map(RegionalParameter::from);
    let forty: Vec<RegionalParameter> = twenty.iter().copied().chain(segments).chain(rest).collect();
    for (name, edge_length_mm) in &hearts::SIZES[..2] {
        let model = hearts::heart(*edge_length_mm);
        println!("{name}, {} vertices", model.anatomy().mesh.vertex_count());
        print_solves(&model);
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let alone = pool.install(|| timed(|| beat(&model)));
            println!("    {threads} threads: beat {:.2} s, of the processor {:.2} s", alone.0, alone.1);
            for parameters in [&twenty, &forty] {
                let with = pool.install(|| timed(|| tangents(&model, parameters)));
                let (clock, processor) = (with.0 / alone.0, with.1 / alone.1);
                println!("        with {} tangents {clock:.2} times that, of the processor {processor:.2}", parameters.len());
            }
        }
    }
}

criterion_group! { name = benches; config = hearts::criterion(); targets = cost }
criterion_main!(benches);
