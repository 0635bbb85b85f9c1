//! Raises the least dihedral angles of a stuffed mesh by moving vertices: inner ones freely, those of the surface on the surface, those
//! of the base plane in the plane, those of the rim on the rim.

use nalgebra::Vector3;

use super::lattice::Lattice;
use super::{LevelSet, StuffedMesh, surface_point};

/// Vertices whose worst tetrahedron is better than this (least sine of a dihedral angle) are left alone: 35°.
const GOOD_ENOUGH: f64 = 0.574;

/// Directions of the pattern search: along the axes and the diagonals of a cube.
const DIRECTIONS: [[f64; 3]; 14] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
    [0.6, 0.6, 0.6],
    [-0.6, 0.6, 0.6],
    [0.6, -0.6, 0.6],
    [0.6, 0.6, -0.6],
    [-0.6, -0.6, 0.6],
    [-0.6, 0.6, -0.6],
    [0.6, -0.6, -0.6],
    [-0.6, -0.6, -0.6],
];

/// Moves every vertex that has a poor tetrahedron to the best of its trial places, `passes` times, with shorter and shorter steps. A move is
/// made only if the worst tetrahedron around the vertex becomes better, so the least angle of the mesh never falls.
pub(super) fn optimise(mesh: &mut StuffedMesh, level: &LevelSet, lattice: &Lattice, passes: usize) {
    let mut holders = vec![vec![]; mesh.vertices_mm.len()];
    for (tetrahedron, corners) in mesh.tetrahedra.iter().enumerate() {
        for &vertex in corners {
            holders[vertex].push(tetrahedron);
        }
    }
    for pass in 0..passes {
        let step_mm = lattice.spacing_mm() * 0.15 * 0.75_f64.powi(pass as i32);
        for vertex in 0..mesh.vertices_mm.len() {
            improve(mesh, &holders[vertex], vertex, level, lattice, step_mm);
        }
    }
}

fn improve(mesh: &mut StuffedMesh, around: &[usize], vertex: usize, level: &LevelSet, lattice: &Lattice, step_mm: f64) {
    let start = mesh.vertices_mm[vertex];
    let Some(mut best) = worst_above(f64::NEG_INFINITY, mesh, around) else { return };
    if best > GOOD_ENOUGH {
        return;
    }
    let mut best_place = start;
    for direction in DIRECTIONS {
        let trial = start + Vector3::from(direction) * step_mm;
        let Some(place) = admissible(mesh, vertex, trial, level, lattice, step_mm) else {
            continue;
        };
        mesh.vertices_mm[vertex] = place;
        if let Some(worst) = worst_above(best, mesh, around) {
            (best, best_place) = (worst, place);
        }
    }
    mesh.vertices_mm[vertex] = best_place;
}

/// The place nearest to `trial` where the vertex may be; none if the surface is too far from it.
fn admissible(
    mesh: &StuffedMesh,
    vertex: usize,
    trial: Vector3<f64>,
    level: &LevelSet,
    lattice: &Lattice,
    step_mm: f64,
) -> Option<Vector3<f64>> {
    let normal = lattice.plane_normal();
    let is_in_plane = mesh.is_in_plane[vertex];
    let height = normal.dot(&(trial - mesh.vertices_mm[vertex]));
    let trial = if is_in_plane { trial - normal * height } else { trial };
    if !mesh.is_on_surface[vertex] {
        return Some(trial);
    }
    let place = surface_point(level, &trial, is_in_plane.then_some(&normal), 1e-4 * lattice.spacing_mm())?;
    ((place - trial).norm() < 2.0 * step_mm).then_some(place)
}

/// The worst tetrahedron around a vertex; none, without looking at the others, as soon as one is not better than `bound`.
fn worst_above(bound: f64, mesh: &StuffedMesh, around: &[usize]) -> Option<f64> {
    around.iter().try_fold(f64::INFINITY, |worst, &tetrahedron| {
        let sine = least_dihedral_sine(mesh.tetrahedra[tetrahedron].map(|vertex| mesh.vertices_mm[vertex]));
        (sine > bound).then(|| worst.min(sine))
    })
}

/// The least sine of the six dihedral angles, $\sin\theta_{ij} = \frac{3 V l_{ij}}{2 A_k A_l}$; negative if inverted. Small for angles near 0° and near
/// 180° alike.
pub(super) fn least_dihedral_sine([a, b, c, d]: [Vector3<f64>; 4]) -> f64 {
    let (ab, ac, ad, bc, bd, cd) = (b - a, c - a, d - a, c - b, d - b, d - c);
    // Twice the areas of the faces opposite to each corner.
    let area = [bc.cross(&bd).norm(), ac.cross(&ad).norm(), ab.cross(&ad).norm(), ab.cross(&ac).norm()];
    let six_volumes = ab.cross(&ac).dot(&ad);
    let sine = |edge: &Vector3<f64>, i: usize, j: usize| edge.norm() / (area[i] * area[j]);
    let least = [sine(&ab, 2, 3), sine(&ac, 1, 3), sine(&ad, 1, 2), sine(&bc, 0, 3), sine(&bd, 0, 2), sine(&cd, 0, 1)];
    six_volumes * if six_volumes > 0.0 { least.into_iter().fold(f64::INFINITY, f64::min) } else { least.into_iter().fold(0.0, f64::max) }
}
