//! Volumes enclosed by implicit surfaces.

use nalgebra::Vector3;

use super::Plane;
use crate::image::Volume;

/// Cells that the surface cuts are sampled at this many points along each axis.
const SAMPLES: usize = 5;

/// Volume (mL) where the trilinear `field` is negative, on the inner side of `base`, wherever that plane lies between the nodes.
pub fn enclosed_volume_ml(field: &Volume, base: &Plane) -> f64 {
    let grid = field.grid();
    let [ni, nj, nk] = grid.shape();
    // A layer of nodes on the plane, as in [`super::HeartFields`], is on it to rounding.
    let rounding_mm = 1e-6 * grid.spacing_mm().min();
    let mut cells = 0.0;
    for k in 0..nk.saturating_sub(1) {
        for j in 0..nj.saturating_sub(1) {
            for i in 0..ni.saturating_sub(1) {
                let node = |n: usize| [i + (n & 1), j + (n >> 1 & 1), k + (n >> 2)];
                let corners: [f64; 8] = std::array::from_fn(|n| f64::from(field.at(node(n))));
                if corners.iter().all(|&value| value >= 0.0) {
                    continue;
                }
                let height_mm = |n| base.signed_distance_mm(&grid.to_world_mm(&Vector3::from(node(n).map(|index| index as f64))));
                let heights_mm: [f64; 8] = std::array::from_fn(height_mm);
                let is_below = |limit_mm: f64| heights_mm.iter().all(|&height| height < limit_mm);
                if is_below(rounding_mm) {
                    cells += negative_fraction(&corners, None);
                } else if heights_mm.iter().any(|&height| height < -rounding_mm) {
                    cells += negative_fraction(&corners, Some(&heights_mm));
                }
            }
        }
    }
    cells * grid.voxel_volume_mm3() / 1000.0
}

/// The part of a cell where the field is negative, and where heights over a plane are given, below it. A sample stands for a small cell of its own,
/// of which the plane leaves a part.
fn negative_fraction(corners: &[f64; 8], heights_mm: Option<&[f64; 8]>) -> f64 {
    if heights_mm.is_none() && corners.iter().all(|&value| value < 0.0) {
        return 1.0;
    }
    let extent_mm = heights_mm.map_or(1.0, |h| (1..8).map(|n| (h[n] - h[0]).abs()).fold(0.0, f64::max) / SAMPLES as f64);
    let mut negative = 0.0;
    for flat in 0..SAMPLES.pow(3) {
        let at = [flat % SAMPLES, flat / SAMPLES % SAMPLES, flat / (SAMPLES * SAMPLES)].map(|n| (n as f64 + 0.5) / SAMPLES as f64);
        if trilinear(corners, at) < 0.0 {
            negative += heights_mm.map_or(1.0, |heights_mm| (0.5 - trilinear(heights_mm, at) / extent_mm).clamp(0.0, 1.0));
        }
    }
    negative / SAMPLES.pow(3) as f64
}

fn trilinear(corners: &[f64; 8], [u, v, w]: [f64; 3]) -> f64 {
    let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
    let on_edge = |n: usize| mix(corners[n], corners[n + 1], u);
    mix(mix(on_edge(0), on_edge(2), v), mix(on_edge(4), on_edge(6), v), w)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Grid;

    #[test]
    fn the_cap_of_a_ball_below_a_plane_has_its_volume_wherever_the_plane_lies_between_the_nodes() {
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
        for height_mm in [0.0, 0.1, 0.37, 0.5, 0.9, -3.25] {
            let share = (2.0 + 3.0 * height_mm / 12.0 - (height_mm / 12.0_f64).powi(3)) / 4.0;
            let found = enclosed_volume_ml(&ball, &base(height_mm)) / exact_ml;
            assert!((found - share).abs() < 3e-3, "{height_mm} mm: {found} for {share}");
        }
        // A plane that leans against the grid halves it too.
        let leaning = Plane { point_mm: Vector3::zeros(), normal: Vector3::new(0.3, -0.5, 0.9).normalize() };
        assert!((enclosed_volume_ml(&ball, &leaning) / exact_ml - 0.5).abs() < 3e-3);
    }
}
