//! A stretch of an image on isotropic voxels, with coarser levels, for block matching.

use std::ops::RangeInclusive;

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

    /// The same with values beyond a range at its ends.
    pub(super) fn clipped(mut self, range: &RangeInclusive<f32>) -> Self {
        let values = self.levels.iter_mut().flat_map(|level| &mut level.values);
        values.for_each(|value| *value = value.clamp(*range.start(), *range.end()));
        self
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

    /// Reads the (2 r + 1)³ values around a point, r = `radius`, by trilinear interpolation (all with the same weights): along k and j by
    /// whole rows, then along i. Beyond the image stands its outermost value; [`Level::shifts`] says which blocks lie within.
    pub(super) fn read_around(&self, centre_mm: &Vector3<f64>, radius: usize, values: &mut Vec<f32>) {
        let index = self.index_of(centre_mm);
        let side = 2 * radius + 1;
        let low = [0, 1, 2].map(|axis| index[axis].floor() as isize - radius as isize);
        let [u, v, w] = [0, 1, 2].map(|axis| (index[axis] - index[axis].floor()) as f32);
        let clamped = |axis: usize, at: isize| at.clamp(0, self.shape[axis] as isize - 1) as usize;
        let columns: Vec<usize> = (0..=side).map(|i| clamped(0, low[0] + i as isize)).collect();
        let row = |j: usize, k: usize| {
            let start = self.shape[0] * (clamped(1, low[1] + j as isize) + self.shape[1] * clamped(2, low[2] + k as isize));
            &self.values[start..start + self.shape[0]]
        };
        let mix = |a: f32, b: f32, share: f32| a + share * (b - a);
        values.clear();
        let mut mixed = vec![0.0_f32; side + 1];
        for k in 0..side {
            for j in 0..side {
                let [near, right, above, far] = [row(j, k), row(j + 1, k), row(j, k + 1), row(j + 1, k + 1)];
                for (value, &i) in mixed.iter_mut().zip(&columns) {
                    *value = mix(mix(near[i], right[i], v), mix(above[i], far[i], v), w);
                }
                values.extend(mixed.windows(2).map(|pair| mix(pair[0], pair[1], u)));
            }
        }
    }

    /// By how many voxels along each axis a block of (2 r + 1)³ around a point can be shifted, at most `reach` either way, and lie in the
    /// image; an empty range if it cannot be.
    pub(super) fn shifts(&self, centre_mm: &Vector3<f64>, radius: usize, reach: i32) -> [RangeInclusive<i32>; 3] {
        let index = self.index_of(centre_mm);
        [0, 1, 2].map(|axis| {
            let before = index[axis] - radius as f64;
            let behind = self.shape[axis] as f64 - 1.0 - (index[axis] + radius as f64);
            (-before.floor() as i32).max(-reach)..=(behind.floor() as i32).min(reach)
        })
    }

    /// Whether the whole block around a point lies in the image.
    pub(super) fn holds_block(&self, centre_mm: &Vector3<f64>, radius: usize) -> bool {
        self.shifts(centre_mm, radius, 0).iter().all(|range| range.contains(&0))
    }

    /// The trilinear value at a point; beyond the image stands its outermost one.
    pub(super) fn value(&self, point_mm: &Vector3<f64>) -> f32 {
        let index = self.index_of(point_mm);
        let last = self.shape.map(|n| n - 1);
        let within = [0, 1, 2].map(|axis| index[axis].clamp(0.0, last[axis] as f64));
        let low = within.map(|at| at as usize);
        let share = [0, 1, 2].map(|axis| (within[axis] - low[axis] as f64) as f32);
        let at = |corner: usize| {
            let [i, j, k] = [0, 1, 2].map(|axis| (low[axis] + (corner >> axis & 1)).min(last[axis]));
            self.values[i + self.shape[0] * (j + self.shape[1] * k)]
        };
        let mix = |a: f32, b: f32, share: f32| a + share * (b - a);
        let along_i = |corner: usize| mix(at(corner), at(corner + 1), share[0]);
        mix(mix(along_i(0), along_i(2), share[1]), mix(along_i(4), along_i(6), share[1]), share[2])
    }

    fn index_of(&self, point_mm: &Vector3<f64>) -> Vector3<f64> {
        self.axes.transpose() * (point_mm - self.origin_mm) / self.voxel_mm
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
