//! What tests and benches of mechanics share: a thick sphere, a block, tissue without surroundings, extrapolation to no edge length.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used, reason = "every user takes what it needs, and a test fails by panicking")]

use cardiotwin::mechanics::PassiveProperties;
use cardiotwin::mesh::{SurfaceTag, TaggedSurface, TetMesh};
use nalgebra::Vector3;

/// Inner radius of the sphere.
pub const INNER_MM: f64 = 25.0;
/// Outer radius of the sphere.
pub const OUTER_MM: f64 = 35.0;

/// The three tetrahedra of a prism over a triangle; neighbours that sort the triangle's corners alike share their diagonals.
fn prism([mut a, mut b, mut c]: [usize; 3], lift: usize) -> [[usize; 4]; 3] {
    if a > b {
        std::mem::swap(&mut a, &mut b);
    }
    if b > c {
        std::mem::swap(&mut b, &mut c);
    }
    if a > b {
        std::mem::swap(&mut a, &mut b);
    }
    [[a, b, c, c + lift], [a, b, b + lift, c + lift], [a, a + lift, b + lift, c + lift]]
}

fn oriented(vertices_mm: Vec<Vector3<f64>>, tetrahedra: Vec<[usize; 4]>) -> TetMesh {
    let turned = tetrahedra
        .into_iter()
        .map(|[a, b, c, d]| {
            let [p, q, r, s] = [a, b, c, d].map(|v| vertices_mm[v]);
            if (q - p).cross(&(r - p)).dot(&(s - p)) > 0.0 { [a, b, c, d] } else { [a, c, b, d] }
        })
        .collect();
    TetMesh::new(vertices_mm, turned).unwrap()
}

/// A cube's faces of `edge` × `edge` squares blown up to the sphere, extruded into `layers` of prisms.
pub fn sphere(edge: usize, layers: usize) -> (TetMesh, TaggedSurface) {
    let mut directions: Vec<Vector3<f64>> = Vec::new();
    let mut index = std::collections::HashMap::new();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [0, edge] {
            let mut vertex = |u: usize, v: usize| {
                let mut lattice = [0; 3];
                (lattice[axis], lattice[(axis + 1) % 3], lattice[(axis + 2) % 3]) = (side, u, v);
                *index.entry(lattice).or_insert_with(|| {
                    // Equal angles instead of equal lengths keep the triangles alike.
                    let angle = |i: usize| (std::f64::consts::FRAC_PI_4 * (2.0 * i as f64 / edge as f64 - 1.0)).tan();
                    directions.push(Vector3::from(lattice.map(angle)).normalize());
                    directions.len() - 1
                })
            };
            for u in 0..edge {
                for v in 0..edge {
                    let [a, b, c, d] = [vertex(u, v), vertex(u + 1, v), vertex(u + 1, v + 1), vertex(u, v + 1)];
                    triangles.extend(if (u + v) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
                }
            }
        }
    }
    let count = directions.len();
    let radius = |layer: usize| INNER_MM + (OUTER_MM - INNER_MM) * layer as f64 / layers as f64;
    let vertices_mm: Vec<Vector3<f64>> = (0..=layers).flat_map(|layer| directions.iter().map(move |d| d * radius(layer))).collect();
    let tetrahedra = (0..layers).flat_map(|layer| triangles.iter().flat_map(move |t| prism(t.map(|v| v + layer * count), count))).collect();
    let mesh = oriented(vertices_mm, tetrahedra);
    let tag = |t: &[usize; 3]| if t.iter().all(|&v| v < count) { SurfaceTag::EndocardiumLv } else { SurfaceTag::Epicardium };
    let surface = TaggedSurface::new(&mesh, mesh.boundary_triangles().iter().map(tag).collect()).unwrap();
    (mesh, surface)
}

/// A box of cells cut into six tetrahedra each; the face x = 0 is the base.
pub fn block(size_mm: Vector3<f64>, cells: [usize; 3]) -> (TetMesh, TaggedSurface) {
    let [nx, ny, nz] = cells;
    let index = |i: usize, j: usize, k: usize| (i * (ny + 1) + j) * (nz + 1) + k;
    let mut vertices_mm = vec![];
    let mut tetrahedra = vec![];
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                vertices_mm.push(Vector3::new(i as f64 / nx as f64, j as f64 / ny as f64, k as f64 / nz as f64).component_mul(&size_mm));
            }
        }
    }
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                for [first, second] in [[0, 1], [1, 0], [0, 2], [2, 0], [1, 2], [2, 1]] {
                    let mut corner = [i, j, k];
                    let mut path = vec![index(i, j, k)];
                    for axis in [first, second] {
                        corner[axis] += 1;
                        path.push(index(corner[0], corner[1], corner[2]));
                    }
                    path.push(index(i + 1, j + 1, k + 1));
                    tetrahedra.push([path[0], path[1], path[2], path[3]]);
                }
            }
        }
    }
    let mesh = oriented(vertices_mm, tetrahedra);
    let is_base = |t: &[usize; 3]| t.iter().all(|&v| mesh.vertices_mm()[v].x == 0.0);
    let tag = |t: &[usize; 3]| if is_base(t) { SurfaceTag::Base } else { SurfaceTag::Epicardium };
    let surface = TaggedSurface::new(&mesh, mesh.boundary_triangles().iter().map(tag).collect()).unwrap();
    (mesh, surface)
}

/// Isotropic tissue of 10⁻⁶ kg/mm³ without springs or damping.
pub fn bare(stiffness_kpa: f64, poisson_ratio: f64) -> PassiveProperties {
    PassiveProperties {
        fibre_stiffness_kpa: stiffness_kpa,
        transverse_stiffness_kpa: stiffness_kpa,
        poisson_ratio,
        density_kg_per_mm3: 1e-6,
        damping_mass_per_s: 0.0,
        damping_stiffness_s: 0.0,
        base_stiffness_normal_kpa_per_mm: 0.0,
        base_stiffness_isotropic_kpa_per_mm: 0.0,
        pericardium_stiffness_kpa_per_mm: 0.0,
        pericardium_damping_kpa_s_per_mm: 0.0,
        volume_stiffness_kpa: 0.0,
        pericardium_base_share: 1.0,
        valve_ring_height_mm: 0.0,
        valve_ring_stiffness_kpa: 0.0,
    }
}

/// What three meshes, each of half the edge length of the one before, tend to.
#[derive(Debug, Clone, Copy)]
pub struct Extrapolation {
    /// log₂ of the ratio of the two changes: the order at which the value is settling on these meshes.
    pub order: f64,
    /// The value at edge length zero, if the error is c h² + d h⁴ (Romberg's extrapolation).
    pub limit: f64,
}

/// Extrapolates values on three meshes, coarse to fine.
pub fn extrapolate([coarse, middle, fine]: [f64; 3]) -> Extrapolation {
    let [first, second] = [(coarse, middle), (middle, fine)].map(|(before, after)| after + (after - before) / 3.0);
    Extrapolation { order: ((middle - coarse) / (fine - middle)).log2(), limit: second + (second - first) / 15.0 }
}
