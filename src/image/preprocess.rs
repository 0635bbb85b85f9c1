//! The preparation of cine images for tracking: isotropic voxels, clipped extremes, grey levels from 0 to 255 (\[Billet2009\] §6.2).
//!
//! With the quantiles q₋ and q₊ of the intensities of all frames together, every frame becomes
//!
//! $$ I' = 255\,\frac{\min(\max(I, q_-), q_+) - q_-}{q_+ - q_-}, $$
//!
//! trilinearly resampled. One scale for all frames: a boundary keeps its grey level through the beat.

use nalgebra::Matrix4;
use rayon::prelude::*;

use super::{CineSequence, Grid, ImageError, Volume};

/// How images are prepared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PreprocessSettings {
    /// Voxel edge after resampling, mm; `None` is the finest spacing of the images.
    pub spacing_mm: Option<f64>,
    /// Intensities below this quantile become 0.
    pub quantile_low: f64,
    /// Intensities above this quantile become 255.
    pub quantile_high: f64,
}

impl Default for PreprocessSettings {
    fn default() -> Self {
        Self { spacing_mm: None, quantile_low: 0.01, quantile_high: 0.99 }
    }
}

/// The largest intensity of a prepared image.
pub const PREPARED_MAX: f64 = 255.0;

/// Resamples, clips and rescales all frames alike. The new grid has the old one's axes and first voxel and does not reach beyond the old
/// outermost voxel centres.
///
/// # Errors
/// [`ImageError::Preprocessing`] if the settings are senseless or the quantiles coincide (an image without contrast).
pub fn preprocess(cine: &CineSequence, settings: &PreprocessSettings) -> Result<CineSequence, ImageError> {
    let (low, high) = (settings.quantile_low, settings.quantile_high);
    if !(0.0 <= low && low < high && high <= 1.0) {
        return Err(ImageError::Preprocessing { reason: format!("the quantiles {low} and {high} must ascend within 0 to 1") });
    }
    let mut intensities: Vec<f32> = cine.frames().iter().flat_map(|frame| frame.values().iter().copied()).collect();
    let [from, to] = [low, high].map(|q| quantile(&mut intensities, q));
    drop(intensities);
    if to <= from {
        let reason = format!("the intensities' quantiles {low} and {high} are both {from}: the images have no contrast there");
        return Err(ImageError::Preprocessing { reason });
    }
    let grid = isotropic_grid(cine.grid(), settings.spacing_mm)?;
    let scale = (PREPARED_MAX / (f64::from(to) - f64::from(from))) as f32;
    let frame = |frame: &Volume| {
        let mut values = resampled(frame.values(), frame.grid(), &grid);
        values.iter_mut().for_each(|v| *v = ((v.clamp(from, to) - from) * scale).min(PREPARED_MAX as f32));
        Volume::new(grid.clone(), values)
    };
    let frames = cine.frames().par_iter().map(frame).collect::<Result<Vec<_>, _>>()?;
    CineSequence::new(frames, cine.times_s().to_vec(), cine.period_s())
}

/// One image on isotropic voxels, by default of its finest spacing; the grid is that of [`preprocess`].
///
/// # Errors
/// [`ImageError::Preprocessing`] if the spacing is senseless.
pub fn resampled_isotropic(image: &Volume, spacing_mm: Option<f64>) -> Result<Volume, ImageError> {
    let grid = isotropic_grid(image.grid(), spacing_mm)?;
    let values = resampled(image.values(), image.grid(), &grid);
    Volume::new(grid, values)
}

/// The value below which a fraction `q` of the values lie (the nearest rank); reorders them.
fn quantile(values: &mut [f32], q: f64) -> f32 {
    let rank = (q * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(rank, f32::total_cmp).1
}

fn isotropic_grid(grid: &Grid, spacing_mm: Option<f64>) -> Result<Grid, ImageError> {
    const VOXELS_MAX: f64 = 5e8;
    let old_mm = grid.spacing_mm();
    let step_mm = spacing_mm.unwrap_or(old_mm.min());
    let counts = [0, 1, 2].map(|axis| ((grid.shape()[axis] - 1) as f64 * old_mm[axis] / step_mm + 1e-6).floor() + 1.0);
    if !(step_mm > 0.0 && step_mm.is_finite() && counts.iter().product::<f64>() <= VOXELS_MAX) {
        let reason = format!("voxels of {step_mm} mm make a grid of {counts:?}; choose a coarser isotropic spacing");
        return Err(ImageError::Preprocessing { reason });
    }
    let scale = Matrix4::new_nonuniform_scaling(&old_mm.map(|old| step_mm / old));
    Grid::new(counts.map(|n| n as usize), grid.voxel_to_world() * scale)
}

/// Trilinear values on a grid with the same axes and first voxel.
fn resampled(values: &[f32], old: &Grid, new: &Grid) -> Vec<f32> {
    let ratio = new.spacing_mm().component_div(&old.spacing_mm());
    let [i_nodes, j_nodes, k_nodes] = [0, 1, 2].map(|axis| nodes(new.shape()[axis], old.shape()[axis], ratio[axis]));
    let [ni, nj, _] = old.shape();
    let mut resampled = Vec::with_capacity(new.voxel_count());
    // Between slices and rows first: what is left to look up along i is one row that stays in the cache.
    let (mut slice, mut row) = (vec![0.0; ni * nj], vec![0.0; ni]);
    for k in &k_nodes {
        let plane = |k: usize| &values[ni * nj * k..][..ni * nj];
        mix_all(&mut slice, plane(k.lower), plane(k.upper), k.weight);
        for j in &j_nodes {
            mix_all(&mut row, &slice[ni * j.lower..][..ni], &slice[ni * j.upper..][..ni], j.weight);
            resampled.extend(i_nodes.iter().map(|i| mix(row[i.lower], row[i.upper], i.weight)));
        }
    }
    resampled
}

fn mix(a: f32, b: f32, weight: f32) -> f32 {
    a + weight * (b - a)
}

fn mix_all(mixed: &mut [f32], a: &[f32], b: &[f32], weight: f32) {
    mixed.iter_mut().zip(a.iter().zip(b)).for_each(|(mixed, (a, b))| *mixed = mix(*a, *b, weight));
}

/// Between which old voxels a new one lies along an axis.
struct Node {
    lower: usize,
    upper: usize,
    weight: f32,
}

fn nodes(new_count: usize, old_count: usize, ratio: f64) -> Vec<Node> {
    let node = |n: usize| {
        let at = (n as f64 * ratio).min((old_count - 1) as f64);
        let lower = at as usize;
        Node { lower, upper: (lower + 1).min(old_count - 1), weight: (at - lower as f64) as f32 }
    };
    (0..new_count).map(node).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    fn cine(field: impl Fn(usize, Vector3<f64>) -> f64) -> CineSequence {
        let rotation = Rotation3::from_euler_angles(0.4, 0.2, -1.0).to_homogeneous();
        let scale = Matrix4::new_nonuniform_scaling(&Vector3::new(1.5, 1.5, 8.0));
        let grid = Grid::new([12, 10, 5], Matrix4::new_translation(&Vector3::new(3.0, 4.0, 5.0)) * rotation * scale).unwrap();
        let frame = |n: usize| {
            let value = |flat: usize| field(n, grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|v| v as f64)))) as f32;
            Volume::new(grid.clone(), (0..grid.voxel_count()).map(value).collect()).unwrap()
        };
        CineSequence::new(vec![frame(0), frame(1)], vec![0.0, 0.4], 0.8).unwrap()
    }

    #[test]
    fn a_linear_image_stays_linear_in_the_world_on_isotropic_voxels() {
        let source = cine(|frame, x| frame as f64 + 0.5 * x.x - x.y + 0.25 * x.z);
        let settings = PreprocessSettings { quantile_low: 0.0, quantile_high: 1.0, ..PreprocessSettings::default() };
        let prepared = preprocess(&source, &settings).unwrap();
        let grid = prepared.grid();
        assert!((grid.spacing_mm() - Vector3::repeat(1.5)).norm() < 1e-12);
        assert_eq!(grid.shape(), [12, 10, 22]);
        let intensities = || source.frames().iter().flat_map(|frame| frame.values()).map(|&v| f64::from(v));
        let (from, to) = (intensities().fold(f64::INFINITY, f64::min), intensities().fold(f64::NEG_INFINITY, f64::max));
        for (n, frame) in prepared.frames().iter().enumerate() {
            for flat in 0..grid.voxel_count() {
                let x = grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|v| v as f64)));
                let expected = 255.0 * (n as f64 + 0.5 * x.x - x.y + 0.25 * x.z - from) / (to - from);
                assert!((f64::from(frame.values()[flat]) - expected).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn extremes_are_clipped_at_the_same_levels_in_all_frames() {
        let source = cine(|frame, x| if frame == 1 && x.norm() < 12.0 { 1e6 } else { (x.x * 7.1).sin() });
        let prepared =
            preprocess(&source, &PreprocessSettings { quantile_low: 0.05, quantile_high: 0.9, ..PreprocessSettings::default() }).unwrap();
        let values = || prepared.frames().iter().flat_map(|frame| frame.values());
        assert!(values().all(|v| (0.0..=255.0).contains(v)));
        assert!(values().any(|v| *v == 0.0) && values().any(|v| *v == 255.0));
        // A voxel of frame 0 and one of frame 1 that had the same intensity have the same grey level.
        let far = [11, 9, 4];
        assert!(source.frames()[0].at(far) == source.frames()[1].at(far));
        assert_eq!(prepared.frames()[0].at([11, 9, 21]), prepared.frames()[1].at([11, 9, 21]));
    }

    #[test]
    fn result_does_not_depend_on_the_number_of_threads() {
        let source = cine(|frame, x| (frame as f64 + 1.0) * (x.x * 0.3).sin() + x.y * 0.01);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| preprocess(&source, &PreprocessSettings::default()).unwrap())
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn senseless_settings_and_flat_images_are_refused() {
        let settings = |spacing_mm, quantile_low, quantile_high| PreprocessSettings { spacing_mm, quantile_low, quantile_high };
        let source = cine(|_, x| x.x);
        for bad in [settings(None, 0.9, 0.1), settings(None, f64::NAN, 1.0), settings(Some(0.0), 0.0, 1.0), settings(Some(1e-3), 0.0, 1.0)]
        {
            assert!(preprocess(&source, &bad).is_err(), "{bad:?}");
        }
        let message = preprocess(&cine(|_, _| 7.0), &PreprocessSettings::default()).unwrap_err().to_string();
        assert!(message.contains("no contrast"), "{message}");
    }
}
