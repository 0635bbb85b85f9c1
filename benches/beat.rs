//! What one heartbeat costs: 1 s in steps of 5 ms at 15 thousand vertices.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "criterion's macros, and a bench that fails loudly")]

use std::hint::black_box;
use std::ops::ControlFlow;

use cardiotwin::heart::{SimulationPlan, simulate};
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

criterion_group! { name = benches; config = hearts::criterion(); targets = beat }
criterion_main!(benches);
