//! A beating cavity whose volume is known: bright blood with a papillary muscle, wall, a bright neighbour, dark lung, noise.

use super::*;
use crate::image::Volume;
use nalgebra::{Matrix4, Rotation3, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

const FRAMES: usize = 16;
const SPACING_MM: [f64; 3] = [1.5, 1.3, 9.0];

/// Semi-axes of the elliptic cavity, mm.
fn semi_axes_mm(slice: usize, frame: usize) -> [f64; 2] {
    let beat = 1.0 - 0.14 * (1.0 - (std::f64::consts::TAU * frame as f64 / FRAMES as f64).cos());
    let size = 26.0 - 3.0 * slice as f64;
    [size * beat, 0.85 * size * beat]
}

fn exact_ml(slice_count: usize, frame: usize) -> f64 {
    let area_mm2 = |slice: usize| semi_axes_mm(slice, frame).iter().product::<f64>() * std::f64::consts::PI;
    (0..slice_count).map(area_mm2).sum::<f64>() * SPACING_MM[2] / 1000.0
}

fn grid() -> Grid {
    let rotation = Rotation3::from_euler_angles(0.4, 0.2, -1.0).to_homogeneous();
    let scale = Matrix4::new_nonuniform_scaling(&Vector3::from(SPACING_MM));
    Grid::new([70, 76, 4], Matrix4::new_translation(&Vector3::new(3.0, 4.0, 5.0)) * rotation * scale).unwrap()
}

/// Distance from the cavity's edge relative to its size (negative inside), and the position about its centre; the centre wanders.
fn place(grid: &Grid, flat: usize, frame: usize) -> (f64, [f64; 2]) {
    let [i, j, k] = grid.voxel_of(flat);
    let drift_mm = 1.5 * (std::f64::consts::TAU * frame as f64 / FRAMES as f64).sin();
    let at = [i as f64 * SPACING_MM[0] - 52.0 - drift_mm, j as f64 * SPACING_MM[1] - 50.0];
    let [a, b] = semi_axes_mm(k, frame);
    ((at[0] / a).hypot(at[1] / b) - 1.0, at)
}

fn cine(noise: f64) -> CineSequence {
    let grid = grid();
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    let noise = Normal::new(0.0, noise).unwrap();
    let mut frame = |frame: usize| {
        let value = |flat: usize| {
            let (edge, at) = place(&grid, flat, frame);
            let [a, b] = semi_axes_mm(grid.voxel_of(flat)[2], frame);
            let depth_mm = edge * (a * b).sqrt();
            let papillary = (at[0] - 0.6 * a).hypot(at[1] - 0.35 * b) < 3.5;
            let step = |from: f64, to: f64, at_mm: f64| from + (to - from) / (1.0 + (-(depth_mm - at_mm) / 0.5).exp());
            match (papillary, depth_mm < 5.0, at[0] < -0.5 * a) {
                (true, ..) if depth_mm < 0.0 => 70.0,
                (_, true, _) => step(200.0, 60.0, 0.0),
                (_, _, true) => step(60.0, 210.0, 10.0),
                _ => step(60.0, 15.0, 10.0),
            }
        };
        let values = (0..grid.voxel_count()).map(|flat| (value(flat) + noise.sample(&mut random)) as f32).collect();
        Volume::new(grid.clone(), values).unwrap()
    };
    let frames = (0..FRAMES).map(&mut frame).collect();
    CineSequence::new(frames, (0..FRAMES).map(|n| 0.05 * n as f64).collect(), 0.8).unwrap()
}

/// Labels of the first frame, the papillary muscle counted to the cavity, on a grid of their own.
fn labels() -> LabelMap {
    let grid = grid();
    let labels = (0..grid.voxel_count()).map(|flat| u8::from(place(&grid, flat, 0).0 < 0.0)).collect();
    LabelMap::new(grid, labels).unwrap()
}

#[test]
fn the_volume_of_a_beating_cavity_is_followed_through_noise() {
    for (noise, tolerance) in [(0.0, 0.03), (20.0, 0.03)] {
        let contours = follow_cavity(&cine(noise), &labels(), 1, 0).unwrap();
        assert_eq!(contours.slices.len(), 4);
        for (frame, volume_ml) in contours.volumes_ml().into_iter().enumerate() {
            let error = volume_ml / exact_ml(4, frame) - 1.0;
            assert!(error.abs() < tolerance, "frame {frame}: {volume_ml} mL, {:.1} % off", 100.0 * error);
        }
    }
}

#[test]
fn the_outline_encloses_the_area_and_starts_on_the_i_axis() {
    let contours = follow_cavity(&cine(0.0), &labels(), 1, 0).unwrap();
    let slice = &contours.slices[1];
    let outline = slice.outline_mm(0);
    assert_eq!(outline.first(), outline.last());
    assert!((outline[0][1] - 50.0).abs() < 0.5 && (outline[0][0] - 52.0 - semi_axes_mm(1, 0)[0]).abs() < 1.0, "{:?}", outline[0]);
    let shoelace: f64 = outline.windows(2).map(|pair| 0.5 * (pair[0][0] * pair[1][1] - pair[1][0] * pair[0][1])).sum();
    assert!((shoelace / slice.area_mm2(0) - 1.0).abs() < 1e-9);
}

#[test]
fn labels_that_cannot_be_followed_say_why() {
    let cine = cine(0.0);
    let message = |labels: &LabelMap, code, frame| follow_cavity(&cine, labels, code, frame).unwrap_err().to_string();
    assert!(message(&labels(), 7, 0).contains("code 7"));
    assert!(message(&labels(), 1, 99).contains("16 frames"));
    let moved = |by_mm: Vector3<f64>| {
        let affine = grid().voxel_to_world() * Matrix4::new_translation(&by_mm.component_div(&Vector3::from(SPACING_MM)));
        LabelMap::new(Grid::new(grid().shape(), affine).unwrap(), labels().labels().to_vec()).unwrap()
    };
    assert!(message(&moved(Vector3::new(0.0, 0.0, 4.5)), 1, 0).contains("between the slices"));
    assert!(message(&moved(Vector3::new(0.0, 0.0, 18.0)), 1, 0).contains("outside"));
    let negative = |frame: &Volume| Volume::new(frame.grid().clone(), frame.values().iter().map(|v| 255.0 - v).collect()).unwrap();
    let negative = CineSequence::new(cine.frames().iter().map(negative).collect(), cine.times_s().to_vec(), cine.period_s()).unwrap();
    assert!(follow_cavity(&negative, &labels(), 1, 0).unwrap_err().to_string().contains("not brighter"));
}
