//! Volumes enclosed by implicit surfaces.

use nalgebra::Vector3;

use super::Plane;
use crate::image::Volume;

/// Cells that the surface cuts are sampled at this many points along each axis.
const SAMPLES: usize = 5;

/// Volume (mL) where the trilinear `field` is negative, on the inner side of `base`. Cells count as below or beyond the plane by their
/// centre: exact where a layer of nodes lies on the plane, as in [`super::HeartFields`].
pub fn enclosed_volume_ml(field: &Volume, base: &Plane) -> f64 {
    let grid = field.grid();
    let [ni, nj, nk] = grid.shape();
    let mut cells = 0.0;
    for k in 0..nk.saturating_sub(1) {
        for j in 0..nj.saturating_sub(1) {
            for i in 0..ni.saturating_sub(1) {
                let corner = |n: usize| f64::from(field.at([i + (n & 1), j + (n >> 1 & 1), k + (n >> 2)]));
                let corners: [f64; 8] = std::array::from_fn(corner);
                let fraction = negative_fraction(&corners);
                if fraction > 0.0 {
                    let centre_mm = grid.to_world_mm(&Vector3::new(i as f64 + 0.5, j as f64 + 0.5, k as f64 + 0.5));
                    cells += if base.signed_distance_mm(&centre_mm) < 0.0 { fraction } else { 0.0 };
                }
            }
        }
    }
    cells * grid.voxel_volume_mm3() / 1000.0
}

fn negative_fraction(corners: &[f64; 8]) -> f64 {
    match corners.iter().filter(|&&v| v < 0.0).count() {
        0 => 0.0,
        8 => 1.0,
        _ => {
            let local = |n: usize| (n as f64 + 0.5) / SAMPLES as f64;
            let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
            let mut negative = 0;
            for flat in 0..SAMPLES.pow(3) {
                let (u, v, w) = (local(flat % SAMPLES), local(flat / SAMPLES % SAMPLES), local(flat / (SAMPLES * SAMPLES)));
                let on_edge = |n: usize| mix(corners[n], corners[n + 1], u);
                let value = mix(mix(on_edge(0), on_edge(2), v), mix(on_edge(4), on_edge(6), v), w);
                negative += usize::from(value < 0.0);
            }
            negative as f64 / SAMPLES.pow(3) as f64
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Grid;

    #[test]
    fn half_a_ball_below_a_plane_of_nodes_has_half_its_volume() {
        let grid = Grid::axis_aligned([31, 31, 31], Vector3::repeat(-15.0), Vector3::repeat(1.0)).unwrap();
        let distance = |flat| {
            let [i, j, k] = grid.voxel_of(flat);
            (grid.to_world_mm(&Vector3::new(i as f64, j as f64, k as f64)).norm() - 12.0) as f32
        };
        let ball = Volume::new(grid.clone(), (0..grid.voxel_count()).map(distance).collect()).unwrap();
        let exact_ml = 4.0 / 3.0 * std::f64::consts::PI * 12.0_f64.powi(3) / 1000.0;
        let base = |height_mm| Plane { point_mm: Vector3::new(0.0, 0.0, height_mm), normal: Vector3::z() };
        // Trilinear interpolation flattens a sphere of 12 steps by a few thousandths.
        assert!((enclosed_volume_ml(&ball, &base(20.0)) / exact_ml - 1.0).abs() < 5e-3);
        assert!((enclosed_volume_ml(&ball, &base(0.0)) / exact_ml - 0.5).abs() < 3e-3);
    }
}
