//! Analytic images and small meshes for the tests of this room.

use nalgebra::Vector3;
use rand::{Rng, SeedableRng};

use crate::image::{CineSequence, Grid, Volume};
use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};

/// A slab of `cells` × `cells` × 1 cubes over [−1, 1]² × [0, 1], each cut into six tetrahedra, its vertices moved by `map` (which
/// must keep the orientation). The image of the top is the LV endocardium, of the bottom the epicardium, of the sides the base.
pub(super) fn slab(cells: usize, map: impl Fn(Vector3<f64>) -> Vector3<f64>) -> (TetMesh, TaggedSurface) {
    let side = cells + 1;
    let number = |i: usize, j: usize, k: usize| i + side * (j + side * k);
    let unit = |n: usize| 2.0 * n as f64 / cells as f64 - 1.0;
    let mut flat = vec![Vector3::zeros(); 2 * side * side];
    for k in 0..2 {
        for j in 0..side {
            for i in 0..side {
                flat[number(i, j, k)] = Vector3::new(unit(i), unit(j), k as f64);
            }
        }
    }
    const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
    let mut tetrahedra = Vec::new();
    for j in 0..cells {
        for i in 0..cells {
            for (path, axes) in PATHS.iter().enumerate() {
                let mut corner = [i, j, 0];
                let mut tetrahedron = [number(i, j, 0); 4];
                for (step, &axis) in axes.iter().enumerate() {
                    corner[axis] += 1;
                    tetrahedron[step + 1] = number(corner[0], corner[1], corner[2]);
                }
                if path >= 3 {
                    tetrahedron.swap(2, 3);
                }
                tetrahedra.push(tetrahedron);
            }
        }
    }
    let heights: Vec<f64> = flat.iter().map(|v| v.z).collect();
    let mesh = TetMesh::new(flat.into_iter().map(map).collect(), tetrahedra).unwrap();
    let tag = |triangle: [usize; 3]| match triangle.map(|v| heights[v]) {
        [1.0, 1.0, 1.0] => SurfaceTag::EndocardiumLv,
        [0.0, 0.0, 0.0] => SurfaceTag::Epicardium,
        _ => SurfaceTag::Base,
    };
    let tags = mesh.boundary_triangles().into_iter().map(tag).collect();
    let surface = TaggedSurface::new(&mesh, tags).unwrap();
    (mesh, surface)
}

/// An image of a function of the world position (mm) over a box centred at the origin.
pub(super) fn image(half_mm: Vector3<f64>, spacing_mm: Vector3<f64>, intensity: impl Fn(Vector3<f64>) -> f64) -> Volume {
    let shape = [0, 1, 2].map(|axis| (2.0 * half_mm[axis] / spacing_mm[axis]).round() as usize + 1);
    let grid = Grid::axis_aligned(shape, -half_mm, spacing_mm).unwrap();
    let at = |flat| intensity(grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|n| n as f64)))) as f32;
    let values = (0..grid.voxel_count()).map(at).collect();
    Volume::new(grid, values).unwrap()
}

/// A smooth step from 0 to 1 over a few times `width_mm`.
pub(super) fn step(distance_mm: f64, width_mm: f64) -> f64 {
    1.0 / (1.0 + (-distance_mm / width_mm).exp())
}

/// A cine sequence that shows one image all the time.
pub(super) fn still(volume: Volume) -> CineSequence {
    CineSequence::new(vec![volume.clone(), volume], vec![0.0, 0.5], 1.0).unwrap()
}

/// A smooth random texture: a sum of plane waves of 6–20 mm.
pub(super) fn waves(seed: u64) -> impl Fn(Vector3<f64>) -> f64 {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut wave = move || {
        let direction = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)).normalize();
        let length_mm: f64 = random.random_range(6.0..20.0);
        (direction * std::f64::consts::TAU / length_mm, random.random_range(0.0..std::f64::consts::TAU))
    };
    let waves: Vec<_> = (0..40).map(|_| wave()).collect();
    move |p| 200.0 + waves.iter().map(|(k, phase)| 20.0 * (k.dot(&p) + phase).sin()).sum::<f64>()
}
