//! Preparation of a cine sequence: isotropic voxels, extreme intensities clipped, 0 to 255, all frames alike, [Billet2009] §6.2.

use nalgebra::{Matrix4, Vector3};
use rayon::prelude::*;

use super::{CineSequence, Grid, ImageError, Volume};

/// How a cine sequence is prepared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PreprocessSettings {
    /// Voxel edge after resampling, mm; the smallest of the image where absent.
    pub spacing_mm: Option<f64>,
    /// Intensities below this quantile of all frames become 0.
    pub quantile_low: f64,
    /// Intensities above this quantile of all frames become 255.
    pub quantile_high: f64,
}

impl Default for PreprocessSettings {
    fn default() -> Self {
        Self { spacing_mm: None, quantile_low: 0.01, quantile_high: 0.99 }
    }
}

/// The largest intensity of a prepared image.
pub const PREPARED_MAX: f64 = 255.0;

/// Prepares a sequence: trilinear resampling between the centres of the first and the last voxels, clipping at quantiles of all frames
/// together, linear rescaling to 0..255.
///
/// # Errors
/// [`ImageError::InconsistentCine`] if the settings make no sense or the images have no contrast between the quantiles.
pub fn preprocess(cine: &CineSequence, settings: &PreprocessSettings) -> Result<CineSequence, ImageError> {
    let inconsistent = |reason: String| Err(ImageError::InconsistentCine { reason });
    let (low, high) = (settings.quantile_low, settings.quantile_high);
    if !(0.0..1.0).contains(&low) || !(low..=1.0).contains(&high) {
        return inconsistent(format!("the clipping quantiles {low} and {high} must ascend between 0 and 1"));
    }
    let spacing_mm = settings.spacing_mm.unwrap_or_else(|| cine.grid().spacing_mm().min());
    if !(spacing_mm.is_finite() && spacing_mm > 0.0) {
        return inconsistent(format!("a voxel edge of {spacing_mm} mm cannot be resampled to"));
    }
    let [black, white] = quantiles(cine, [low, high]);
    if white <= black {
        return inconsistent(format!("its intensities do not differ between the quantiles {low} and {high} (both {black})"));
    }
    let grid = isotropic_grid(cine.grid(), spacing_mm)?;
    let scale = PREPARED_MAX / (white - black);
    let prepare = |frame: &Volume| {
        let value = |voxel: [usize; 3]| {
            let at = grid.to_world_mm(&Vector3::from(voxel.map(|index| index as f64)));
            let clipped = frame.sample(&at).unwrap_or(black).clamp(black, white);
            ((clipped - black) * scale) as f32
        };
        let values = (0..grid.voxel_count()).into_par_iter().map(|flat| value(grid.voxel_of(flat))).collect();
        Volume::new(grid.clone(), values)
    };
    let frames = cine.frames().iter().map(prepare).collect::<Result<_, _>>()?;
    CineSequence::new(frames, cine.times_s().to_vec(), cine.period_s())
}

/// The grid of cubes of edge `spacing_mm` with the first voxel's centre and the axes of `grid`, as far as its last voxels' centres.
fn isotropic_grid(grid: &Grid, spacing_mm: f64) -> Result<Grid, ImageError> {
    let spacings_mm = grid.spacing_mm();
    let mut shape = grid.shape();
    let mut affine: Matrix4<f64> = *grid.voxel_to_world();
    for axis in 0..3 {
        let length_mm = (shape[axis].max(1) - 1) as f64 * spacings_mm[axis];
        // A last centre that misses by rounding is still there; sampling it is forgiven by the interpolation's own tolerance.
        shape[axis] = (length_mm / spacing_mm + 1e-6).floor() as usize + 1;
        let column = affine.fixed_view::<3, 1>(0, axis) * (spacing_mm / spacings_mm[axis]);
        affine.fixed_view_mut::<3, 1>(0, axis).copy_from(&column);
    }
    Grid::new(shape, affine)
}

/// Quantiles of the intensities of all frames together.
fn quantiles<const N: usize>(cine: &CineSequence, shares: [f64; N]) -> [f64; N] {
    let mut values: Vec<f32> = cine.frames().iter().flat_map(|frame| frame.values().iter().copied()).collect();
    let last = values.len().saturating_sub(1) as f64;
    shares.map(|share| {
        let (_, value, _) = values.select_nth_unstable_by((share * last).round() as usize, f32::total_cmp);
        f64::from(*value)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cine(value: impl Fn(f64, f64, f64, f64) -> f64) -> CineSequence {
        let grid = Grid::axis_aligned([9, 8, 5], Vector3::new(3.0, -2.0, 1.0), Vector3::new(2.0, 2.0, 8.0)).unwrap();
        let frame = |t: f64| {
            let at = |flat| grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|index: usize| index as f64)));
            let values = (0..grid.voxel_count()).map(at).map(|p| value(p.x, p.y, p.z, t) as f32).collect();
            Volume::new(grid.clone(), values).unwrap()
        };
        CineSequence::new(vec![frame(0.0), frame(1.0)], vec![0.0, 0.4], 0.8).unwrap()
    }

    #[test]
    fn a_linear_image_stays_linear_on_cubes_with_one_scale_for_all_frames() {
        let linear = |x: f64, y: f64, z: f64, t: f64| x + 2.0 * y - 0.5 * z + 30.0 * t;
        let settings = PreprocessSettings { quantile_low: 0.0, quantile_high: 1.0, ..PreprocessSettings::default() };
        let prepared = preprocess(&cine(linear), &settings).unwrap();
        assert_eq!(prepared.grid().shape(), [9, 8, 17]);
        assert!((prepared.grid().spacing_mm() - Vector3::repeat(2.0)).norm() < 1e-12);
        let (least, most) = (linear(3.0, -2.0, 33.0, 0.0), linear(19.0, 12.0, 1.0, 1.0));
        for (t, frame) in prepared.frames().iter().enumerate() {
            for flat in 0..frame.grid().voxel_count() {
                let p = frame.grid().to_world_mm(&Vector3::from(frame.grid().voxel_of(flat).map(|index| index as f64)));
                let expected = 255.0 * (linear(p.x, p.y, p.z, t as f64) - least) / (most - least);
                assert!((f64::from(frame.values()[flat]) - expected).abs() < 1e-3, "{flat}");
            }
        }
    }

    #[test]
    fn extreme_intensities_are_clipped_and_no_contrast_is_refused() {
        let spike = |x: f64, _: f64, _: f64, _: f64| if x > 18.0 { 1e6 } else { x };
        let settings = PreprocessSettings { quantile_low: 0.05, quantile_high: 0.85, ..PreprocessSettings::default() };
        let prepared = preprocess(&cine(spike), &settings).unwrap();
        assert_eq!(prepared.frames()[0].at([0, 0, 0]), 0.0);
        assert_eq!(prepared.frames()[0].at([7, 0, 0]), 255.0);
        let error = preprocess(&cine(|_, _, _, _| 7.0), &PreprocessSettings::default()).unwrap_err();
        assert!(error.to_string().contains("do not differ"), "{error}");
    }
}
