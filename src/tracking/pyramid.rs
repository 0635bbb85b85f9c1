//! A stretch of an image on isotropic voxels, with coarser levels, for block matching.

use nalgebra::{Matrix3, Matrix4, Vector3};

use super::instant::clamped_to_centres;
use crate::image::{Grid, Volume};

/// Finest level first; each next has voxels of twice the edge, after a binomial filter.
pub(super) struct Pyramid {
    levels: Vec<Level>,
}

/// One isotropic image. Its axes are the unit axes of the image it was made from.
pub(super) struct Level {
    shape: [usize; 3],
    values: Vec<f32>,
    origin_mm: Vector3<f64>,
    axes: Matrix3<f64>,
    voxel_mm: f64,
}

impl Pyramid {
    /// Resamples `volume` (trilinear) on the box around `points` with a margin of `reach_mm`, cut to the image.
    pub(super) fn around(volume: &Volume, points: &[Vector3<f64>], reach_mm: f64, voxel_mm: f64, level_count: usize) -> Self {
        let grid = volume.grid();
        let axes = unit_axes(grid);
        let mut low = Vector3::repeat(f64::INFINITY);
        let mut high = Vector3::repeat(f64::NEG_INFINITY);
        for point in points {
            let along = axes.transpose() * (point - grid.to_world_mm(&Vector3::zeros()));
            low = low.inf(&along);
            high = high.sup(&along);
        }
        let spacing = grid.spacing_mm();
        let end = Vector3::from_fn(|axis, _| (grid.shape()[axis] as f64 - 0.5) * spacing[axis] - 1e-6);
        low = (low - Vector3::repeat(reach_mm)).sup(&(-0.5 * spacing).add_scalar(1e-6));
        high = (high + Vector3::repeat(reach_mm)).inf(&end);
        let shape = [0, 1, 2].map(|axis| ((high[axis] - low[axis]) / voxel_mm).floor().max(0.0) as usize + 1);
        let origin_mm = grid.to_world_mm(&Vector3::zeros()) + axes * low;
        let mut values = Vec::with_capacity(shape.iter().product());
        for k in 0..shape[2] {
            for j in 0..shape[1] {
                for i in 0..shape[0] {
                    let at = origin_mm + axes * Vector3::new(i as f64, j as f64, k as f64) * voxel_mm;
                    let value = clamped_to_centres(grid, &at).and_then(|within| volume.sample(&within));
                    values.push(value.unwrap_or(0.0) as f32);
                }
            }
        }
        let mut levels = vec![Level { shape, values, origin_mm, axes, voxel_mm }];
        while levels.len() < level_count {
            let coarser = levels[levels.len() - 1].halved();
            levels.push(coarser);
        }
        Self { levels }
    }

    pub(super) fn levels(&self) -> &[Level] {
        &self.levels
    }
}

impl Level {
    pub(super) fn voxel_mm(&self) -> f64 {
        self.voxel_mm
    }

    /// Unit vectors of the grid, as columns.
    pub(super) fn axes(&self) -> &Matrix3<f64> {
        &self.axes
    }

    /// Reads the (2 r + 1)³ values around a point by trilinear interpolation (all with the same weights); false, and nothing
    /// useful, if the block leaves the image.
    pub(super) fn read_block(&self, centre_mm: &Vector3<f64>, radius: usize, values: &mut Vec<f32>) -> bool {
        values.clear();
        let index = self.axes.transpose() * (centre_mm - self.origin_mm) / self.voxel_mm;
        let mut low = [0; 3];
        let mut fraction = [0.0_f32; 3];
        for axis in 0..3 {
            let first = index[axis] - radius as f64;
            let last = index[axis] + radius as f64;
            if !(first >= 0.0 && last <= (self.shape[axis] as f64) - 1.0) {
                return false;
            }
            low[axis] = (first.floor() as usize).min(self.shape[axis].saturating_sub(2 * radius + 2));
            fraction[axis] = (first - low[axis] as f64) as f32;
        }
        let [ni, nj, nk] = self.shape;
        let stride = [1, ni, ni * nj];
        let step = [0, 1, 2].map(|axis| if [ni, nj, nk][axis] > low[axis] + 2 * radius + 1 { stride[axis] } else { 0 });
        let [u, v, w] = fraction;
        let mix = |a: f32, b: f32, share: f32| a + share * (b - a);
        for k in 0..=2 * radius {
            for j in 0..=2 * radius {
                let row = low[0] + ni * (low[1] + j + nj * (low[2] + k));
                for i in 0..=2 * radius {
                    let at = row + i;
                    let along_i = |from: usize| mix(self.values[from], self.values[from + step[0]], u);
                    let along_j = |from: usize| mix(along_i(from), along_i(from + step[1]), v);
                    values.push(mix(along_j(at), along_j(at + step[2]), w));
                }
            }
        }
        true
    }

    /// Half the resolution: binomial (1 4 6 4 1)/16 along each axis, every second voxel.
    fn halved(&self) -> Self {
        let mut values = self.values.clone();
        let mut stride = 1;
        for axis in 0..3 {
            values = binomial_along(&values, stride, self.shape[axis]);
            stride *= self.shape[axis];
        }
        let shape = self.shape.map(|n| n.div_ceil(2));
        let mut kept = Vec::with_capacity(shape.iter().product());
        for k in 0..shape[2] {
            for j in 0..shape[1] {
                for i in 0..shape[0] {
                    kept.push(values[2 * i + self.shape[0] * (2 * j + self.shape[1] * 2 * k)]);
                }
            }
        }
        Self { shape, values: kept, origin_mm: self.origin_mm, axes: self.axes, voxel_mm: 2.0 * self.voxel_mm }
    }
}

fn binomial_along(values: &[f32], stride: usize, count: usize) -> Vec<f32> {
    let last = count as isize - 1;
    let filtered = |flat: usize| {
        let place = (flat / stride % count) as isize;
        let at = |offset: isize| values[(flat as isize + ((place + offset).clamp(0, last) - place) * stride as isize) as usize];
        (at(-2) + at(2) + 4.0 * (at(-1) + at(1)) + 6.0 * at(0)) / 16.0
    };
    (0..values.len()).map(filtered).collect()
}

fn unit_axes(grid: &Grid) -> Matrix3<f64> {
    let affine: &Matrix4<f64> = grid.voxel_to_world();
    let mut axes: Matrix3<f64> = affine.fixed_view::<3, 3>(0, 0).into_owned();
    for mut column in axes.column_iter_mut() {
        column.normalize_mut();
    }
    axes
}
