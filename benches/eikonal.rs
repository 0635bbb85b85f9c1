//! What an activation map costs on about 200,000 and 1,000,000 tetrahedra, and its tangent.
#![allow(missing_docs, clippy::unwrap_used, reason = "criterion's macros, and a bench that fails loudly")]

use std::hint::black_box;

use cardiotwin::electrophysiology::{ActivationSettings, Conduction, Onset, activate, activate_with};
use cardiotwin::mesh::TetMesh;
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;

#[path = "../tests/meshes/mod.rs"]
mod meshes;

/// A cube of 1 mm cells with fibres that turn by 120° from one side to the other, as they do through the wall of a heart.
fn cube(cells: usize) -> (TetMesh, Conduction) {
    let (mesh, _) = meshes::block(Vector3::repeat(cells as f64), [cells; 3]);
    let fibre = |t: usize| {
        let depth = mesh.corners_mm(t).iter().map(|p| p.x).sum::<f64>() / (4.0 * cells as f64);
        let angle = (60.0 - 120.0 * depth).to_radians();
        Vector3::new(0.0, angle.cos(), angle.sin())
    };
    let count = mesh.tetrahedron_count();
    let conduction = Conduction::new(vec![600.0; count], 1.0 / 9.0, (0..count).map(fibre).collect()).unwrap();
    (mesh, conduction)
}

fn activation(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("eikonal");
    group.sample_size(10);
    for cells in [32, 55] {
        let (mesh, conduction) = cube(cells);
        let onsets = [Onset { vertex: 0, time_s: 0.0 }];
        let count = mesh.tetrahedron_count();
        group.bench_function(BenchmarkId::new("march_alone", count), |bencher| {
            let settings = ActivationSettings { ray_length_mm: Some(0.0) };
            bencher.iter(|| black_box(activate_with(&mesh, &conduction, &onsets, &settings).unwrap()));
        });
        group.bench_function(BenchmarkId::new("with_rays", count), |bencher| {
            bencher.iter(|| black_box(activate(&mesh, &conduction, &onsets).unwrap()));
        });
        let map = activate(&mesh, &conduction, &onsets).unwrap();
        group.bench_function(BenchmarkId::new("tangent", count), |bencher| {
            bencher.iter(|| black_box(map.tangent_s(&vec![1.0; count], &[0.0])));
        });
    }
    group.finish();
}

criterion_group!(benches, activation);
criterion_main!(benches);
