//! The motion of the base by block matching: every base vertex carries a block of the reference image and looks for the most
//! similar block in each frame, coarse to fine, sub-voxel at the end, \[Billet2009\] §5 with the practice of \[Ourselin2000\].

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::appearance::quantile;
use super::blocks::{Block, Match, WIDEST_BLOCK, blocks_of, search};
use super::pyramid::Pyramid;
use super::{BaseMatches, TrackingError};
use crate::image::CineSequence;

/// What makes two blocks alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Similarity {
    /// Sum of squared differences, as in \[Billet2009\] §5.
    Ssd,
    /// Normalised cross-correlation: blind to brightness and contrast.
    #[default]
    Ncc,
}

/// What a block is like when it is looked for in a later frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BlockShape {
    /// As it was, looked for around where all blocks were in the frame before, before the heart is tracked, \[Billet2009\] §5.
    #[default]
    Still,
    /// As the tracked heart has deformed it, looked for around where the heart has carried it, while it is tracked.
    Carried,
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
    /// What a block is like when it is looked for again.
    pub shape: BlockShape,
    /// Carried blocks see intensities within this many standard deviations of the wall's own, and what lies beyond as those ends;
    /// nothing: as they are. The edges of the wall outshine its texture, which alone tells how far it has moved along itself.
    pub window: Option<f64>,
}

impl Default for BlockMatchingSettings {
    fn default() -> Self {
        Self {
            similarity: Similarity::Ncc,
            voxel_mm: 1.5,
            block_radius_voxels: 4,
            levels: 3,
            range_mm: 6.0,
            variance_share: 0.75,
            trimmed_share: 0.75,
            shape: BlockShape::Still,
            window: None,
        }
    }
}

impl BlockMatchingSettings {
    /// The tissue around a block deforms as the vertices within this distance, mm: 1.5 times half the block's edge.
    pub(super) fn deformation_reach_mm(&self) -> f64 {
        0.75 * self.voxel_mm * (2 * self.block_radius_voxels + 1) as f64
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
            .map(|place| {
                if usable[place] {
                    search(&blocks[place], &moving, &centres[place], &start[place], (settings.similarity, settings.range_mm))
                } else {
                    None
                }
            })
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

pub(super) fn check(settings: &BlockMatchingSettings) -> Result<(), TrackingError> {
    TrackingError::check_setting("voxel_mm", settings.voxel_mm, 0.1, 20.0)?;
    TrackingError::check_setting("block_radius_voxels", settings.block_radius_voxels as f64, 1.0, (WIDEST_BLOCK / 2) as f64)?;
    TrackingError::check_setting("levels", settings.levels as f64, 1.0, 6.0)?;
    TrackingError::check_setting("window", settings.window.unwrap_or(1.0), 0.1, 100.0)?;
    TrackingError::check_setting("range_mm", settings.range_mm, settings.voxel_mm, 100.0)?;
    TrackingError::check_setting("variance_share", settings.variance_share, 0.01, 1.0)?;
    TrackingError::check_setting("trimmed_share", settings.trimmed_share, 0.01, 1.0)
}

/// Which places have the blocks of the highest variance.
pub(super) fn highest_variance(blocks: &[Vec<Block>], share: f64) -> Vec<bool> {
    let variances: Vec<Option<f64>> = blocks.iter().map(|list| list.first().map(|block| block.variance)).collect();
    let least = quantile(variances.iter().flatten().copied(), 1.0 - share);
    variances.iter().map(|variance| variance.is_some_and(|v| v >= least && v > 0.0)).collect()
}

/// The common affine motion of all matches by least trimmed squares, and the trust of each match: see [`trust`].
fn trim(centres: &[Vector3<f64>], raw: &[Option<Match>], share: f64) -> (Vec<Vector3<f64>>, Vec<f64>) {
    const ROUNDS: usize = 4;
    let mut trust: Vec<f64> = raw.iter().map(|m| m.map_or(0.0, |m| m.similarity)).collect();
    let mut common = vec![Vector3::zeros(); centres.len()];
    for _ in 0..ROUNDS {
        common = affine_motion(centres, raw, &trust);
        let residual: Vec<Option<f64>> = raw.iter().zip(&common).map(|(m, c)| m.map(|m| (m.displacement_mm - c).norm())).collect();
        trust = self::trust(residual.into_iter(), share);
    }
    (common, trust)
}

/// The trust of matches by their residuals, mm: zero for all but a `share` of them, otherwise $1/(1 + (r/\tau)^2)$ with τ twice the median
/// residual (at least a tenth of a millimetre).
pub(super) fn trust(residual_mm: impl Iterator<Item = Option<f64>>, share: f64) -> Vec<f64> {
    let residual_mm: Vec<Option<f64>> = residual_mm.collect();
    let largest_mm = quantile(residual_mm.iter().flatten().copied(), share);
    let scale_mm = (2.0 * quantile(residual_mm.iter().flatten().copied(), 0.5)).max(0.1);
    let one = |r: f64| if r <= largest_mm + 1e-9 { 1.0 / (1.0 + (r / scale_mm).powi(2)) } else { 0.0 };
    residual_mm.into_iter().map(|r| r.map_or(0.0, one)).collect()
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
    use super::super::fixtures::{image, waves};
    use super::*;
    use rand::{Rng, SeedableRng};

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
        let pattern = waves(7);
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
        let volume = image(Vector3::repeat(20.0), Vector3::repeat(2.0), waves(1));
        let cine = CineSequence::new(vec![volume.clone(), volume], vec![0.0, 0.5], 1.0).unwrap();
        let error = match_base(&cine, 0, &[0], &[Vector3::repeat(300.0)], &BlockMatchingSettings::default()).unwrap_err();
        assert!(matches!(error, TrackingError::BaseNotCovered { vertex_count: 1 }), "{error}");
    }
}
