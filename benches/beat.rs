//! What one heartbeat costs: 1 s in steps of 5 ms at 15 thousand vertices.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "criterion's macros, and a bench that fails loudly")]

use std::hint::black_box;
use std::ops::ControlFlow;

use cardiotwin::heart::{HeartModel, SimulationPlan, simulate};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};

mod hearts;

fn beat(criterion: &mut Criterion<hearts::ProcessorTime>) {
    let mut group = criterion.benchmark_group("beat");
    for (name, edge_length_mm) in &hearts::SIZES[..2] {
        let model = hearts::heart(*edge_length_mm);
        let plan = SimulationPlan { start_time_s: 0.0, end_time_s: 1.0, frame_times_s: vec![] };
        let start_s = hearts::processor_s();
        simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
        println!("{name}, {} vertices: {:.2} s", model.anatomy().mesh.vertex_count(), hearts::processor_s() - start_s);
        group.bench_function(BenchmarkId::new("one_second", model.anatomy().mesh.vertex_count()), |bencher| {
            bencher.iter(|| simulate(black_box(&model), &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap());
        });
    }
    group.finish();
}

/// A contraction of soft tissue with large rotations beside the linear one of a stiffer wall, both on one core.
fn kinematics(criterion: &mut Criterion<hearts::ProcessorTime>) {
    let mut group = criterion.benchmark_group("kinematics");
    let core = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (name, edge_length_mm) = hearts::SIZES[0];
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: 0.4, frame_times_s: vec![] };
    let models = [("linear", hearts::heart(edge_length_mm)), ("corotational", hearts::soft_heart(edge_length_mm))];
    let contract = |model: &HeartModel| simulate(model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
    let seconds = [0, 1].map(|index| {
        core.install(|| {
            let start_s = hearts::processor_s();
            contract(black_box(&models[index].1));
            hearts::processor_s() - start_s
        })
    });
    println!("{name}: 0.4 s linear {:.2} s, corotational {:.2} s, {:.1} times it", seconds[0], seconds[1], seconds[1] / seconds[0]);
    for (kinematics, model) in &models {
        group.bench_function(BenchmarkId::new(*kinematics, name), |bencher| {
            core.install(|| bencher.iter(|| contract(black_box(model))));
        });
    }
    group.finish();
}

criterion_group! { name = benches; config = hearts::criterion(); targets = beat, kinematics }
criterion_main!(benches);
