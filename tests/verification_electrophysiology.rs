//! The eikonal solver against closed forms, against itself renumbered, and its derivative against finite differences.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panicking, and may show its figures")]

use cardiotwin::electrophysiology::{Conduction, Onset, activate};
use cardiotwin::mesh::TetMesh;
use nalgebra::Vector3;

/// A box of `count` cells of `size_mm`, each cut into six tetrahedra around its diagonal.
fn box_mesh(count: [usize; 3], size_mm: f64) -> TetMesh {
    let vertex = |i: usize, j: usize, k: usize| i + (count[0] + 1) * (j + (count[1] + 1) * k);
    let mut vertices = vec![];
    for k in 0..=count[2] {
        for j in 0..=count[1] {
            vertices.extend((0..=count[0]).map(|i| Vector3::new(i as f64, j as f64, k as f64) * size_mm));
        }
    }
    let mut tetrahedra = vec![];
    for k in 0..count[2] {
        for j in 0..count[1] {
            for i in 0..count[0] {
                let c = |corner: usize| vertex(i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2 & 1));
                let paths = [[1, 3], [3, 2], [2, 6], [6, 4], [4, 5], [5, 1]];
                tetrahedra.extend(paths.map(|[a, b]| [c(0), c(a), c(b), c(7)]));
            }
        }
    }
    TetMesh::new(vertices, tetrahedra).unwrap()
}

fn uniform(mesh: &TetMesh, speed_mm_per_s: f64, ratio: f64, fibre: Vector3<f64>) -> Conduction {
    let count = mesh.tetrahedron_count();
    Conduction::new(vec![speed_mm_per_s; count], ratio, vec![fibre; count]).unwrap()
}

const AT_ORIGIN: [Onset; 1] = [Onset { vertex: 0, time_s: 0.0 }];

/// Mean error over the box (ms) and error at the corner (20, 7, 3) mm, for a point source at the origin.
fn point_source_errors_ms(cells_per_mm: usize, speed: f64, ratio: f64, corner_ms: f64) -> (f64, f64) {
    let mesh = box_mesh([20 * cells_per_mm, 7 * cells_per_mm, 3 * cells_per_mm], 1.0 / cells_per_mm as f64);
    let map = activate(&mesh, &uniform(&mesh, speed, ratio, Vector3::x()), &AT_ORIGIN).unwrap();
    let exact_s = |p: &Vector3<f64>| (p.x * p.x + (p.y * p.y + p.z * p.z) / ratio).sqrt() / speed;
    let total: f64 = mesh.vertices_mm().iter().zip(map.times_s()).map(|(p, t)| (t - exact_s(p)).abs()).sum();
    let last = mesh.vertex_count() - 1;
    assert!((exact_s(&mesh.vertices_mm()[last]) * 1e3 - corner_ms).abs() < 5e-5);
    (total / mesh.vertex_count() as f64 * 1e3, (map.times_s()[last] * 1e3 - corner_ms).abs())
}

#[test]
fn a_point_source_converges_to_the_closed_form() {
    for (speed, ratio, corner_ms) in [(600.0, 0.25, 41.8994), (600.0, 1.0 / 9.0, 50.6074), (500.0, 0.16, 55.2268), (600.0, 1.0, 35.6682)] {
        let errors = [1, 2, 4].map(|cells| point_source_errors_ms(cells, speed, ratio, corner_ms));
        println!("v {speed} rho {ratio}: {errors:?}");
        assert!(errors[1].0 < 0.7 * errors[0].0 && errors[2].0 < 0.7 * errors[1].0, "{errors:?}");
    }
}
