//! The phantom against what it was made of: volumes, texture that belongs to the tissue, determinism.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings};
use cardiotwin::image::Grid;
use cardiotwin::phantom::{
    IdealisedLv, LABEL_CAVITY_LV, LABEL_WALL, PhantomError, PrescribedContraction, ShortAxisStack, SyntheticCineSettings, VoxelSampling,
    rasterise, synthetic_cine,
};
use nalgebra::{Matrix3, Matrix4, Rotation3, Vector2, Vector3};

fn oblique_lv() -> IdealisedLv {
    IdealisedLv { long_axis: Vector3::new(-0.5, 0.4, 0.6), centre_mm: Vector3::new(12.0, -30.0, 55.0), ..IdealisedLv::default() }
}

fn anatomy_of(lv: &IdealisedLv) -> Anatomy {
    lv.build(&MesherSettings::with_edge_length_mm(5.0), &AnatomySettings::default()).unwrap()
}

fn stack(voxel_mm: f64, slice_distance_mm: f64) -> ShortAxisStack {
    ShortAxisStack { voxel_mm, slice_distance_mm, margin_mm: 8.0, end_margin_mm: 9.0 }
}

/// The same grid turned about its origin, so that no plane of the heart follows its slices.
fn turned(grid: &Grid) -> Grid {
    let turn = Rotation3::from_euler_angles(0.21, -0.13, 0.4).to_homogeneous();
    let [ni, nj, nk] = grid.shape().map(|n| 0.5 * (n - 1) as f64);
    let centre = grid.to_world_mm(&Vector3::new(ni, nj, nk));
    Grid::new(grid.shape(), Matrix4::new_translation(&centre) * turn * Matrix4::new_translation(&-centre) * grid.voxel_to_world()).unwrap()
}

fn volume_errors(anatomy: &Anatomy, positions: &[Vector3<f64>], grid: &Grid, samples: usize) -> (f64, f64) {
    let sampling = VoxelSampling { samples_per_voxel: [samples; 3], thickness_share: 1.0 };
    let shares = rasterise(anatomy, positions, grid, &sampling).unwrap();
    let cavity_mm3 = anatomy.cavities[0].1.volume_mm3(positions);
    let volume = |t: usize| {
        let [a, b, c, d] = anatomy.mesh.tetrahedra()[t].map(|v| positions[v]);
        (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
    };
    let wall_mm3: f64 = (0..anatomy.mesh.tetrahedron_count()).map(volume).sum();
    for (blood, wall) in shares.cavities()[0].1.iter().zip(shares.wall()) {
        assert!(*blood >= 0.0 && *wall >= 0.0 && blood + wall <= 1.0 + 1e-5);
    }
    ((shares.cavity_volume_mm3(0) / cavity_mm3 - 1.0).abs(), (shares.wall_volume_mm3() / wall_mm3 - 1.0).abs())
}

#[test]
fn shares_of_voxels_add_up_to_the_volumes_of_the_mesh() {
    let lv = oblique_lv();
    let anatomy = anatomy_of(&lv);
    let moved = PrescribedContraction::default().positions_mm(&lv, anatomy.mesh.vertices_mm(), 0.7);
    for positions in [anatomy.mesh.vertices_mm(), &moved] {
        let grid = turned(&ShortAxisStack { margin_mm: 20.0, ..stack(2.0, 2.0) }.grid(&anatomy).unwrap());
        let coarse = volume_errors(&anatomy, positions, &grid, 2);
        assert!(coarse.0 < 5e-3 && coarse.1 < 5e-3, "{coarse:?}");
        let fine = volume_errors(&anatomy, positions, &grid, 6);
        assert!(fine.0 < 5e-4 && fine.1 < 5e-4, "{fine:?}");
        // Thick slices only gather the same samples differently.
        let thick = turned(&ShortAxisStack { margin_mm: 20.0, ..stack(2.0, 8.0) }.grid(&anatomy).unwrap());
        let thick = volume_errors(&anatomy, positions, &thick, 8);
        assert!(thick.0 < 1e-3 && thick.1 < 1e-3, "{thick:?}");
    }
}

#[test]
fn label_maps_have_the_codes_and_volumes_of_the_tissue() {
    let anatomy = anatomy_of(&oblique_lv());
    let grid = stack(1.5, 1.5).grid(&anatomy).unwrap();
    let labels = rasterise(&anatomy, anatomy.mesh.vertices_mm(), &grid, &VoxelSampling::CENTRES).unwrap().to_label_map().unwrap();
    let cavity_mm3 = labels.count(LABEL_CAVITY_LV) as f64 * grid.voxel_volume_mm3();
    let wall_mm3 = labels.count(LABEL_WALL) as f64 * grid.voxel_volume_mm3();
    // The base plane may fall half a voxel off: 0.75 mm of about 65 mm.
    assert!((cavity_mm3 / anatomy.cavities[0].1.volume_mm3(anatomy.mesh.vertices_mm()) - 1.0).abs() < 0.015);
    assert!((wall_mm3 / anatomy.mesh.total_volume_mm3() - 1.0).abs() < 0.015);
}

/// Heart and grid moved by the same affine map show the same image: the texture belongs to the material.
#[test]
fn texture_moves_with_the_tissue() {
    let anatomy = anatomy_of(&oblique_lv());
    let grid = turned(&stack(2.0, 6.0).grid(&anatomy).unwrap());
    let linear = Rotation3::from_euler_angles(0.5, 0.2, -0.9).matrix() * Matrix3::new(1.1, 0.2, 0.0, 0.0, 0.8, 0.1, 0.0, 0.0, 1.3);
    let mut map = linear.to_homogeneous();
    map.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::new(14.0, -3.0, 8.0));
    let rest = anatomy.mesh.vertices_mm().to_vec();
    let moved: Vec<_> = rest.iter().map(|p| map.transform_point(&(*p).into()).coords).collect();
    let moved_grid = Grid::new(grid.shape(), map * grid.voxel_to_world()).unwrap();
    let settings = SyntheticCineSettings {
        wall_texture: 0.5,
        background_texture: 0.0,
        continuation_mm: 0.0,
        noise: 0.0,
        ..SyntheticCineSettings::default()
    };
    let image = |positions: &Vec<Vector3<f64>>, grid: &Grid| {
        let frames = [positions.clone(), positions.clone()];
        synthetic_cine(&anatomy, &frames, &[0.0, 0.1], 1.0, grid, &settings).unwrap().cine.frames()[1].values().to_vec()
    };
    let (before, after, still) = (image(&rest, &grid), image(&moved, &moved_grid), image(&rest, &moved_grid));
    let differing = |a: &[f32], b: &[f32]| a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 0.05).count();
    assert_eq!(differing(&before, &after), 0);
    assert!(differing(&still, &after) > 1000, "the comparison must be able to fail");
}

#[test]
fn the_seed_and_not_the_threads_decide_every_bit() {
    let lv = oblique_lv();
    let anatomy = anatomy_of(&lv);
    let grid = stack(2.5, 8.0).grid(&anatomy).unwrap();
    let frames: Vec<_> =
        [0.0, 0.4, 0.8].iter().map(|&s| PrescribedContraction::default().positions_mm(&lv, anatomy.mesh.vertices_mm(), s)).collect();
    let image = |threads: usize, seed: u64| {
        let settings = SyntheticCineSettings { seed, ..SyntheticCineSettings::default() };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| synthetic_cine(&anatomy, &frames, &[0.0, 0.2, 0.4], 0.9, &grid, &settings).unwrap())
    };
    let one = image(1, 7);
    assert_eq!(one, image(3, 7));
    assert_ne!(one.cine, image(1, 8).cine);
    assert_eq!(one.labels, image(1, 8).labels);
    assert!((one.volumes_ml[2][0] / one.volumes_ml[0][0] - (1.0 - 0.8 * 0.6)).abs() < 0.01);
}

/// A slice that is displaced by whole voxels shows what it would have shown, that many voxels on: in image, labels and surroundings.
#[test]
fn a_displaced_slice_shows_the_same_elsewhere() {
    let lv = oblique_lv();
    let anatomy = anatomy_of(&lv);
    let grid = stack(2.0, 8.0).grid(&anatomy).unwrap();
    let frames: Vec<_> =
        [0.0, 0.8].iter().map(|&s| PrescribedContraction::default().positions_mm(&lv, anatomy.mesh.vertices_mm(), s)).collect();
    let image = |slice_shifts_mm: Vec<Vector2<f64>>| {
        let settings = SyntheticCineSettings { noise: 0.0, bias: 0.0, slice_shifts_mm, ..SyntheticCineSettings::default() };
        synthetic_cine(&anatomy, &frames, &[0.0, 0.2], 0.9, &grid, &settings).unwrap()
    };
    let (right, displaced) = (image(vec![]), image(vec![Vector2::zeros(), Vector2::zeros(), Vector2::zeros(), Vector2::new(4.0, -6.0)]));
    let [ni, nj, nk] = grid.shape();
    for (k, j, i) in (0..nk).flat_map(|k| (3..nj).flat_map(move |j| (0..ni - 2).map(move |i| (k, j, i)))) {
        let place = if k == 3 { [i + 2, j - 3, k] } else { [i, j, k] };
        for frame in 0..2 {
            let (one, other) = (right.cine.frames()[frame].at([i, j, k]), displaced.cine.frames()[frame].at(place));
            // Single precision, and samples that lie on a surface to rounding.
            assert!((one - other).abs() < 0.01, "{one} and {other} at {:?}", [i, j, k]);
            assert_eq!(right.labels[frame].at([i, j, k]), displaced.labels[frame].at(place));
        }
    }
}

#[test]
fn bad_input_is_named() {
    let anatomy = anatomy_of(&oblique_lv());
    let grid = stack(4.0, 8.0).grid(&anatomy).unwrap();
    let rest = anatomy.mesh.vertices_mm().to_vec();
    let cine = |frames: &[Vec<Vector3<f64>>], settings: &SyntheticCineSettings| {
        synthetic_cine(&anatomy, frames, &[0.0, 0.1], 1.0, &grid, settings).unwrap_err()
    };
    let settings = SyntheticCineSettings::default();
    let short = cine(&[rest.clone(), rest[1..].to_vec()], &settings);
    assert!(matches!(short, PhantomError::PositionCount { frame: 1, .. }), "{short}");
    let mut lost = rest.clone();
    lost[5].x = f64::NAN;
    let lost = cine(&[lost, rest.clone()], &settings);
    assert!(matches!(lost, PhantomError::NonFinitePosition { frame: 0, vertex: 5 }), "{lost}");
    let noisy = cine(&[rest.clone(), rest], &SyntheticCineSettings { noise: f64::NAN, ..settings });
    assert!(matches!(noisy, PhantomError::Setting { .. }), "{noisy}");
}
