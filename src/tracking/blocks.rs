//! Blocks of voxels and the search for the most similar one, whole or cut, as they were or deformed with the tissue.

use std::ops::RangeInclusive;

use nalgebra::{Matrix3, Vector3};

use super::Similarity;
use super::pyramid::{Level, Pyramid};

/// Voxels along the edge of the largest block.
pub(super) const WIDEST_BLOCK: usize = 33;

/// The voxels of a block at one level of the pyramid, with weights 1 where they count and 0 where they do not.
pub(super) struct Block {
    /// Values less their weighted mean, times their weights.
    values: Vec<f32>,
    weights: Vec<f32>,
    mean: f32,
    /// Sum of the weights.
    mass: f64,
    pub(super) variance: f64,
    /// 2 r + 1.
    side: usize,
}

impl Block {
    fn new(mut values: Vec<f32>, weights: Vec<f32>, radius: usize) -> Self {
        let mass = weights.iter().map(|&w| f64::from(w)).sum::<f64>().max(1.0);
        let mean = (values.iter().zip(&weights).map(|(&v, &w)| f64::from(v * w)).sum::<f64>() / mass) as f32;
        values.iter_mut().zip(&weights).for_each(|(value, weight)| *value = (*value - mean) * weight);
        let variance = values.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>() / mass;
        Self { values, weights, mean, mass, variance, side: 2 * radius + 1 }
    }
}

/// Where a block was found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Match {
    pub(super) displacement_mm: Vector3<f64>,
    /// 0..=1.
    pub(super) similarity: f64,
}

/// The blocks around a point, finest level first; levels at which the block leaves the image are cut off.
pub(super) fn blocks_of(pyramid: &Pyramid, centre_mm: &Vector3<f64>, radius: usize) -> Vec<Block> {
    let read = |level: &Level| {
        level.holds_block(centre_mm, radius).then(|| {
            let mut values = Vec::new();
            level.read_around(centre_mm, radius, &mut values);
            let weights = vec![1.0; values.len()];
            Block::new(values, weights, radius)
        })
    };
    pyramid.levels().iter().map_while(read).collect()
}

/// The block around a point as it looks when the tissue has deformed by F: its voxel at s shows what was at F⁻¹ s. Voxels that show what
/// `counts` does not are left out; nothing if the block leaves the image or fewer than a sixth of its voxels count.
pub(super) fn deformed_block(
    level: &Level,
    centre_mm: &Vector3<f64>,
    inverse: &Matrix3<f64>,
    radius: usize,
    counts: impl Fn(&Vector3<f64>) -> bool,
) -> Option<Block> {
    const LEAST_SHARE: f64 = 1.0 / 6.0;
    if !level.holds_block(centre_mm, radius) {
        return None;
    }
    let side = 2 * radius + 1;
    let [along_i, along_j, along_k] = [0, 1, 2].map(|axis| inverse * level.axes().column(axis) * level.voxel_mm());
    let corner_mm = centre_mm - (along_i + along_j + along_k) * radius as f64;
    let (mut values, mut weights) = (Vec::with_capacity(side.pow(3)), Vec::with_capacity(side.pow(3)));
    for k in 0..side {
        for j in 0..side {
            for i in 0..side {
                let point_mm = corner_mm + along_i * i as f64 + along_j * j as f64 + along_k * k as f64;
                values.push(level.value(&point_mm));
                weights.push(if counts(&point_mm) { 1.0 } else { 0.0 });
            }
        }
    }
    let block = Block::new(values, weights, radius);
    (block.mass >= LEAST_SHARE * side.pow(3) as f64).then_some(block)
}

/// The surroundings of a point of a level: a block and `reach` voxels more on every side.
struct Surroundings {
    values: Vec<f32>,
    side: usize,
    reach: i32,
    within: [RangeInclusive<i32>; 3],
}

impl Surroundings {
    /// Reads them into the memory of others.
    fn read(level: &Level, point_mm: &Vector3<f64>, block: &Block, reach: i32, mut values: Vec<f32>) -> Self {
        let radius = block.side / 2;
        level.read_around(point_mm, radius + reach as usize, &mut values);
        Self { values, side: block.side + 2 * reach as usize, reach, within: level.shifts(point_mm, radius, reach) }
    }

    /// Dissimilarity of a block and the one that is shifted by whole voxels, 0 (the same) to about 2, or nothing outside the image.
    ///
    /// With a and b the two blocks less the mean of a, over the voxels that count: SSD $\sum (a - b)^2 / 2 \sum a^2$, the reference's
    /// variance alone scaling it; NCC $1 - \rho$. Both from $\sum ab$, $\sum b^2$ and $\sum b$, a sum for each place in a row.
    fn dissimilarity(&self, block: &Block, shift: [i32; 3], similarity: Similarity) -> Option<f64> {
        if !self.within.iter().zip(shift).all(|(range, shift)| range.contains(&shift)) {
            return None;
        }
        let [i, j, k] = shift.map(|shift| (shift + self.reach) as usize);
        let mut sums = [[0.0_f32; WIDEST_BLOCK]; 3];
        let [products, squares, values] = &mut sums;
        let rows = block.values.chunks_exact(block.side).zip(block.weights.chunks_exact(block.side)).enumerate();
        for (row, (own, weights)) in rows {
            let start = i + self.side * (j + row % block.side + self.side * (k + row / block.side));
            let others = &self.values[start..start + block.side];
            let lanes = products.iter_mut().zip(&mut *squares).zip(&mut *values).zip(own).zip(weights).zip(others);
            for (((((product, square), value), &a), &weight), &b) in lanes {
                let b = b - block.mean;
                *product += a * b;
                *square += weight * b * b;
                *value += weight * b;
            }
        }
        let mean = |sums: &[f32; WIDEST_BLOCK]| sums.iter().map(|&s| f64::from(s)).sum::<f64>() / block.mass;
        let (product, square, value) = (mean(products), mean(squares), mean(values));
        Some(match similarity {
            Similarity::Ssd => (block.variance - 2.0 * product + square).max(0.0) / (2.0 * block.variance.max(f64::MIN_POSITIVE)),
            Similarity::Ncc => {
                let variance = (square - value * value).max(0.0);
                1.0 - product / (block.variance * variance).sqrt().max(f64::MIN_POSITIVE)
            }
        })
    }
}

/// The best match of a block, from the coarsest level down, each level searching the voxels around the best of the one above.
pub(super) fn search(
    blocks: &[Block],
    moving: &Pyramid,
    centre_mm: &Vector3<f64>,
    start_mm: &Vector3<f64>,
    (similarity, range_mm): (Similarity, f64),
) -> Option<Match> {
    let mut memory = Vec::new();
    let mut best_mm = *start_mm;
    let mut best = f64::INFINITY;
    for depth in (0..blocks.len()).rev() {
        let (level, block) = (&moving.levels()[depth], &blocks[depth]);
        let step_mm = level.voxel_mm();
        let is_coarsest = depth + 1 == blocks.len();
        let reach = if is_coarsest { (range_mm / step_mm).ceil() as i32 } else { 1 };
        let around_mm = best_mm;
        let seen = Surroundings::read(level, &(centre_mm + around_mm), block, reach, memory);
        best = f64::INFINITY;
        for shift in cube(reach) {
            if let Some(value) = seen.dissimilarity(block, shift, similarity)
                && value < best
            {
                (best, best_mm) = (value, around_mm + level.axes() * Vector3::from(shift.map(f64::from)) * step_mm);
            }
        }
        memory = seen.values;
    }
    if !best.is_finite() {
        return None;
    }
    let block = blocks.first()?;
    let finest = &moving.levels()[0];
    for step_mm in [finest.voxel_mm(), 0.5 * finest.voxel_mm()] {
        let mut at = |shift: Vector3<f64>| {
            let point_mm = centre_mm + best_mm + finest.axes() * shift * step_mm;
            let seen = Surroundings::read(finest, &point_mm, block, 0, std::mem::take(&mut memory));
            let value = seen.dissimilarity(block, [0; 3], similarity);
            memory = seen.values;
            value
        };
        let Some(middle) = at(Vector3::zeros()) else { break };
        let mut shift = Vector3::zeros();
        for axis in 0..3 {
            let unit = Vector3::ith(axis, 1.0);
            if let (Some(before), Some(after)) = (at(-unit), at(unit)) {
                shift[axis] = parabola_minimum(before, middle, after);
            }
        }
        best_mm += finest.axes() * shift * step_mm;
        best = best.min(middle);
    }
    Some(Match { displacement_mm: best_mm, similarity: (1.0 - best).clamp(0.0, 1.0) })
}

/// Where the parabola through (−1, a), (0, b), (1, c) is smallest, within ±1; 0 if it is not convex.
fn parabola_minimum(before: f64, middle: f64, after: f64) -> f64 {
    let curvature = before - 2.0 * middle + after;
    if curvature <= 0.0 { 0.0 } else { (0.5 * (before - after) / curvature).clamp(-1.0, 1.0) }
}

/// All offsets of a cube, from its centre outward, so that of equal matches the nearest wins.
fn cube(reach: i32) -> Vec<[i32; 3]> {
    let side = || -reach..=reach;
    let mut offsets: Vec<[i32; 3]> = side().flat_map(|k| side().flat_map(move |j| side().map(move |i| [i, j, k]))).collect();
    offsets.sort_by_key(|[i, j, k]| i * i + j * j + k * k);
    offsets
}
