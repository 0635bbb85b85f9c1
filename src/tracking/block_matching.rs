//! The motion of the base by block matching: every base vertex carries a block of the reference image and looks for the most
//! similar block in each frame, coarse to fine, sub-voxel at the end, \[Billet2009\] §5 with the practice of \[Ourselin2000\].

use std::ops::RangeInclusive;

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::appearance::quantile;
use super::pyramid::{Level, Pyramid};
use super::{BaseMatches, TrackingError};
use crate::image::CineSequence;

/// What makes two blocks alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Similarity {
    /// Sum of squared differences, as in \[Billet2009\] §5.
    #[default]
    Ssd,
    /// Normalised cross-correlation: blind to brightness and contrast.
    Ncc,
}

/// How blocks are matched.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BlockMatchingSettings {
    /// What makes two blocks alike.
    pub similarity: Similarity,
    /// Edge of the isotropic voxels that are compared, mm.
    pub voxel_mm: f64,
    /// A block has 2 r + 1 voxels along each axis, at every level.
    pub block_radius_voxels: usize,
    /// Levels of the pyramid; each halves the resolution.
    pub levels: usize,
    /// Search range around the position in the frame before, mm.
    pub range_mm: f64,
    /// Share of the blocks that is used: those of the highest variance.
    pub variance_share: f64,
    /// Share of the matches that is kept after trimming those farthest from the common affine motion.
    pub trimmed_share: f64,
}

impl Default for BlockMatchingSettings {
    fn default() -> Self {
        Self {
            similarity: Similarity::Ssd,
            voxel_mm: 1.5,
            block_radius_voxels: 4,
            levels: 3,
            range_mm: 6.0,
            variance_share: 0.75,
            trimmed_share: 0.75,
        }
    }
}

/// Matches the blocks around `vertices` (positions `position_mm` of the whole mesh, on the frame `reference_frame`) in every frame,
/// forward in time through one cycle, each frame's search starting from the frame before.
///
/// # Errors
/// [`TrackingError::SettingOutOfRange`], [`TrackingError::BaseNotCovered`] if no vertex has its block inside the image.
pub fn match_base(
    cine: &CineSequence,
    reference_frame: usize,
    vertices: &[usize],
    position_mm: &[Vector3<f64>],
    settings: &BlockMatchingSettings,
) -> Result<BaseMatches, TrackingError> {
    check(settings)?;
    let centres: Vec<Vector3<f64>> = vertices.iter().map(|&vertex| position_mm[vertex]).collect();
    let reach_mm = settings.range_mm * 2.0 + settings.voxel_mm * (settings.block_radius_voxels << (settings.levels - 1)) as f64;
    let pyramid_of = |frame: usize| Pyramid::around(&cine.frames()[frame], &centres, reach_mm, settings.voxel_mm, settings.levels);
    let frame_count = cine.frames().len();
    let reference = pyramid_of(reference_frame % frame_count);
    let blocks: Vec<Vec<Block>> = centres.iter().map(|centre| blocks_of(&reference, centre, settings.block_radius_voxels)).collect();
    let usable = highest_variance(&blocks, settings.variance_share);
    if usable.iter().all(|&is_usable| !is_usable) {
        return Err(TrackingError::BaseNotCovered { vertex_count: vertices.len() });
    }
    let mut displacement_mm = vec![vec![Vector3::zeros(); vertices.len()]; frame_count];
    let mut confidence = vec![vec![0.0; vertices.len()]; frame_count];
    let mut start = vec![Vector3::zeros(); vertices.len()];
    for step in 0..frame_count {
        let frame = (reference_frame + step) % frame_count;
        let moving = pyramid_of(frame);
        let raw: Vec<Option<Match>> = (0..vertices.len())
            .into_par_iter()
            .map(|place| if usable[place] { search(&blocks[place], &moving, &centres[place], &start[place], settings) } else { None })
            .collect();
        let (common, trust) = trim(&centres, &raw, settings.trimmed_share);
        for place in 0..vertices.len() {
            let found = raw[place].filter(|_| trust[place] > 0.0);
            displacement_mm[frame][place] = found.map_or(common[place], |m| m.displacement_mm);
            confidence[frame][place] = found.map_or(0.0, |m| m.similarity * trust[place]);
        }
        start = common;
    }
    Ok(BaseMatches::new(vertices.to_vec(), cine.times_s().to_vec(), cine.period_s(), displacement_mm, confidence))
}

/// Voxels along the edge of the largest block.
const WIDEST_BLOCK: usize = 33;

fn check(settings: &BlockMatchingSettings) -> Result<(), TrackingError> {
    TrackingError::check_setting("voxel_mm", settings.voxel_mm, 0.1, 20.0)?;
    TrackingError::check_setting("block_radius_voxels", settings.block_radius_voxels as f64, 1.0, (WIDEST_BLOCK / 2) as f64)?;
    TrackingError::check_setting("levels", settings.levels as f64, 1.0, 6.0)?;
    TrackingError::check_setting("range_mm", settings.range_mm, settings.voxel_mm, 100.0)?;
    TrackingError::check_setting("variance_share", settings.variance_share, 0.01, 1.0)?;
    TrackingError::check_setting("trimmed_share", settings.trimmed_share, 0.01, 1.0)
}

/// The voxels of a block at one level of the pyramid, less their mean.
struct Block {
    values: Vec<f32>,
    mean: f32,
    variance: f64,
    /// 2 r + 1.
    side: usize,
}

#[derive(Debug, Clone, Copy)]
struct Match {
    displacement_mm: Vector3<f64>,
    /// 0..=1.
    similarity: f64,
}

/// The blocks around a point, finest level first; levels at which the block leaves the image are cut off.
fn blocks_of(pyramid: &Pyramid, centre_mm: &Vector3<f64>, radius: usize) -> Vec<Block> {
    let read = |level: &Level| {
        level.shifts(centre_mm, radius, 0).iter().all(|range| range.contains(&0)).then(|| {
            let mut values = Vec::new();
            level.read_around(centre_mm, radius, &mut values);
            let count = values.len() as f64;
            let mean = (values.iter().map(|&v| f64::from(v)).sum::<f64>() / count) as f32;
            values.iter_mut().for_each(|value| *value -= mean);
            let variance = values.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>() / count;
            Block { values, mean, variance, side: 2 * radius + 1 }
        })
    };
    pyramid.levels().iter().map_while(read).collect()
}

fn highest_variance(blocks: &[Vec<Block>], share: f64) -> Vec<bool> {
    let variances: Vec<Option<f64>> = blocks.iter().map(|list| list.first().map(|block| block.variance)).collect();
    let least = quantile(variances.iter().flatten().copied(), 1.0 - share);
    variances.iter().map(|variance| variance.is_some_and(|v| v >= least && v > 0.0)).collect()
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
    /// SSD: $\sum (a - b)^2 / \sum ((a - \bar a)^2 + (b - \bar b)^2)$, without the denominator's dependence on b for the search: the
    /// reference's variance alone scales it. NCC: $1 - \rho$. Both from sums of $a - \bar a$ and $b - \bar a$, a sum for each place in a row.
    fn dissimilarity(&self, block: &Block, shift: [i32; 3], similarity: Similarity) -> Option<f64> {
        if !self.within.iter().zip(shift).all(|(range, shift)| range.contains(&shift)) {
            return None;
        }
        let [i, j, k] = shift.map(|shift| (shift + self.reach) as usize);
        let rows = block.values.chunks_exact(block.side).enumerate().map(|(row, values)| {
            let start = i + self.side * (j + row % block.side + self.side * (k + row / block.side));
            (values, &self.values[start..start + block.side])
        });
        let mut sums = [[0.0_f32; WIDEST_BLOCK]; 3];
        let [first, second, third] = &mut sums;
        let count = block.values.len() as f64;
        let total = |sums: &[f32; WIDEST_BLOCK]| sums.iter().map(|&s| f64::from(s)).sum::<f64>() / count;
        match similarity {
            Similarity::Ssd => {
                for (a, b) in rows {
                    for ((sum, &a), &b) in first.iter_mut().zip(a).zip(b) {
                        let apart = a - (b - block.mean);
                        *sum += apart * apart;
                    }
                }
                Some(total(first) / (2.0 * block.variance.max(f64::MIN_POSITIVE)))
            }
            Similarity::Ncc => {
                for (a, b) in rows {
                    for ((((ab, bb), b_sum), &a), &b) in first.iter_mut().zip(&mut *second).zip(&mut *third).zip(a).zip(b) {
                        let b = b - block.mean;
                        *ab += a * b;
                        *bb += b * b;
                        *b_sum += b;
                    }
                }
                let variance = (total(second) - total(third).powi(2)).max(0.0);
                Some(1.0 - total(first) / (block.variance * variance).sqrt().max(f64::MIN_POSITIVE))
            }
        }
    }
}

/// The best match of a block, from the coarsest level down, each level searching the voxels around the best of the one above.
fn search(
    blocks: &[Block],
    moving: &Pyramid,
    centre_mm: &Vector3<f64>,
    start_mm: &Vector3<f64>,
    settings: &BlockMatchingSettings,
) -> Option<Match> {
    let mut memory = Vec::new();
    let mut best_mm = *start_mm;
    let mut best = f64::INFINITY;
    for depth in (0..blocks.len()).rev() {
        let (level, block) = (&moving.levels()[depth], &blocks[depth]);
        let step_mm = level.voxel_mm();
        let is_coarsest = depth + 1 == blocks.len();
        let reach = if is_coarsest { (settings.range_mm / step_mm).ceil() as i32 } else { 1 };
        let around_mm = best_mm;
        let seen = Surroundings::read(level, &(centre_mm + around_mm), block, reach, memory);
        best = f64::INFINITY;
        for shift in cube(reach) {
            if let Some(value) = seen.dissimilarity(block, shift, settings.similarity)
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
            let value = seen.dissimilarity(block, [0; 3], settings.similarity);
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

/// The common affine motion of all matches by least trimmed squares, and the trust of each match: zero for the trimmed share
/// farthest from it, otherwise $1/(1 + (r/\tau)^2)$ with τ twice the median residual (at least a tenth of a millimetre).
fn trim(centres: &[Vector3<f64>], raw: &[Option<Match>], share: f64) -> (Vec<Vector3<f64>>, Vec<f64>) {
    const ROUNDS: usize = 4;
    let mut trust: Vec<f64> = raw.iter().map(|m| m.map_or(0.0, |m| m.similarity)).collect();
    let mut common = vec![Vector3::zeros(); centres.len()];
    for _ in 0..ROUNDS {
        common = affine_motion(centres, raw, &trust);
        let residual: Vec<Option<f64>> = raw.iter().zip(&common).map(|(m, c)| m.map(|m| (m.displacement_mm - c).norm())).collect();
        let largest = quantile(residual.iter().flatten().copied(), share);
        let scale = (2.0 * quantile(residual.iter().flatten().copied(), 0.5)).max(0.1);
        trust = residual.iter().map(|r| r.filter(|&r| r <= largest + 1e-9).map_or(0.0, |r| 1.0 / (1.0 + (r / scale).powi(2)))).collect();
    }
    (common, trust)
}

/// Weighted least squares d(x) = a + A (x − x̄), of least norm where the points lie in a plane or line.
fn affine_motion(centres: &[Vector3<f64>], raw: &[Option<Match>], weights: &[f64]) -> Vec<Vector3<f64>> {
    let used: Vec<usize> = (0..centres.len()).filter(|&place| weights[place] > 0.0 && raw[place].is_some()).collect();
    let mass: f64 = used.iter().map(|&place| weights[place]).sum();
    if mass <= 0.0 {
        return vec![Vector3::zeros(); centres.len()];
    }
    let middle = used.iter().map(|&place| centres[place] * weights[place]).sum::<Vector3<f64>>() / mass;
    let extent = (used.iter().map(|&place| weights[place] * (centres[place] - middle).norm_squared()).sum::<f64>() / mass).sqrt().max(1.0);
    let row = |place: usize| {
        let offset = (centres[place] - middle) / extent;
        [1.0, offset.x, offset.y, offset.z]
    };
    let matrix = DMatrix::from_fn(used.len(), 4, |r, c| weights[used[r]].sqrt() * row(used[r])[c]);
    let data = DMatrix::from_fn(used.len(), 3, |r, c| weights[used[r]].sqrt() * raw[used[r]].map_or(0.0, |m| m.displacement_mm[c]));
    let svd = matrix.svd(true, true);
    // Base rings are nearly flat: what lies out of the plane says nothing on gradients across it.
    let tolerance = 0.1 * svd.singular_values.max();
    let Ok(solution) = svd.solve(&data, tolerance) else { return vec![Vector3::zeros(); centres.len()] };
    let at = |place: usize| Vector3::from_fn(|c, _| row(place).iter().enumerate().map(|(r, x)| x * solution[(r, c)]).sum());
    (0..centres.len()).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::image;
    use super::*;
    use rand::{Rng, SeedableRng};

    /// A smooth random texture: a sum of plane waves of 6–20 mm.
    fn texture(seed: u64) -> impl Fn(Vector3<f64>) -> f64 {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut wave = move || {
            let direction = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)).normalize();
            let length_mm: f64 = random.random_range(6.0..20.0);
            (direction * std::f64::consts::TAU / length_mm, random.random_range(0.0..std::f64::consts::TAU))
        };
        let waves: Vec<_> = (0..40).map(|_| wave()).collect();
        move |p| 200.0 + waves.iter().map(|(k, phase)| 20.0 * (k.dot(&p) + phase).sin()).sum::<f64>()
    }

    fn noisy(volume: crate::image::Volume, amplitude: f32, seed: u64) -> crate::image::Volume {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let values = volume.values().iter().map(|v| v + random.random_range(-amplitude..=amplitude)).collect();
        crate::image::Volume::new(volume.grid().clone(), values).unwrap()
    }

    fn ring() -> Vec<Vector3<f64>> {
        (0..24).map(|n| Vector3::new(12.0 * (f64::from(n) * 0.2618).cos(), 12.0 * (f64::from(n) * 0.2618).sin(), 2.0)).collect()
    }

    /// Largest error (in voxels of 1.5 mm) of the recovered shifts, by similarity and noise amplitude; the waves' rms is 89.
    fn largest_error_voxels(similarity: Similarity, noise: f32, brighter: f64) -> f64 {
        let shifts = [Vector3::zeros(), Vector3::new(1.13, -0.64, 2.41), Vector3::new(2.9, 1.7, 5.2), Vector3::new(1.2, 0.4, 2.2)];
        let pattern = texture(7);
        let frames = shifts.iter().enumerate().map(|(n, shift)| {
            let gain = if n == 0 { 1.0 } else { brighter };
            noisy(image(Vector3::repeat(34.0), Vector3::repeat(1.5), |p| gain * pattern(p - shift)), noise, n as u64)
        });
        let cine = CineSequence::new(frames.collect(), vec![0.0, 0.2, 0.4, 0.6], 0.9).unwrap();
        let centres = ring();
        let vertices: Vec<usize> = (0..centres.len()).collect();
        let settings = BlockMatchingSettings { similarity, ..Default::default() };
        let motion = match_base(&cine, 0, &vertices, &centres, &settings).unwrap();
        let error = |frame: usize| {
            let shift = shifts[frame];
            motion.displacement_mm()[frame].iter().map(move |d| (d - shift).norm() / 1.5).fold(0.0, f64::max)
        };
        (0..shifts.len()).map(error).fold(0.0, f64::max)
    }

    /// Rigid sub-voxel shifts of a textured volume come back to less than a fifth of a voxel, also beneath noise of a fifth of the
    /// texture's rms in both images; NCC is blind to a gain of 1.4.
    #[test]
    fn rigid_shifts_are_recovered_to_a_fifth_of_a_voxel() {
        for (similarity, noise, brighter) in
            [(Similarity::Ssd, 0.0, 1.0), (Similarity::Ssd, 30.0, 1.0), (Similarity::Ncc, 30.0, 1.0), (Similarity::Ncc, 30.0, 1.4)]
        {
            let error = largest_error_voxels(similarity, noise, brighter);
            assert!(error < 0.2, "{similarity:?} with noise {noise}, gain {brighter}: {error} voxels");
        }
    }

    /// One quarter of wild matches neither moves the common motion nor keeps any trust.
    #[test]
    fn outliers_are_trimmed() {
        let centres = ring();
        let true_motion = |c: &Vector3<f64>| Vector3::new(1.0, 2.0, 3.0) + Vector3::new(0.02 * c.y, -0.01 * c.x, 0.03 * c.x);
        let matched = |place: usize| {
            let wild = if place.is_multiple_of(4) { Vector3::new(-7.0, 5.0, 9.0) } else { Vector3::zeros() };
            Some(Match { displacement_mm: true_motion(&centres[place]) + wild, similarity: 0.9 })
        };
        let raw: Vec<_> = (0..centres.len()).map(matched).collect();
        let (common, trust) = trim(&centres, &raw, 0.75);
        for place in 0..centres.len() {
            assert!((common[place] - true_motion(&centres[place])).norm() < 1e-6, "{place}");
            assert_eq!(trust[place] == 0.0, place.is_multiple_of(4), "{place}");
        }
    }

    #[test]
    fn a_base_outside_the_image_is_refused() {
        let volume = image(Vector3::repeat(20.0), Vector3::repeat(2.0), texture(1));
        let cine = CineSequence::new(vec![volume.clone(), volume], vec![0.0, 0.5], 1.0).unwrap();
        let error = match_base(&cine, 0, &[0], &[Vector3::repeat(300.0)], &BlockMatchingSettings::default()).unwrap_err();
        assert!(matches!(error, TrackingError::BaseNotCovered { vertex_count: 1 }), "{error}");
    }
}
