//! Gaussian smoothing in millimetres, for gradients that noise does not rule.

use super::{ImageError, Volume};

/// Half-width of the kernel in standard deviations.
const REACH: f64 = 3.5;

/// The volume convolved with a Gaussian of `sigma_mm` along each of its axes; at the border the kernel is cut and renormalised, so
/// that a constant stays constant. Axes whose spacing is much coarser than `sigma_mm` change little, as they should.
///
/// # Errors
/// [`ImageError::Preprocessing`] if `sigma_mm` is negative or not finite.
pub fn gaussian_smoothed(volume: &Volume, sigma_mm: f64) -> Result<Volume, ImageError> {
    if !(sigma_mm >= 0.0 && sigma_mm.is_finite()) {
        return Err(ImageError::Preprocessing { reason: format!("a Gaussian of {sigma_mm} mm cannot smooth") });
    }
    let grid = volume.grid();
    let shape = grid.shape();
    let strides = [1, shape[0], shape[0] * shape[1]];
    let mut values = volume.values().to_vec();
    for axis in 0..3 {
        let sigma_voxels = sigma_mm / grid.spacing_mm()[axis];
        let reach = (REACH * sigma_voxels).ceil().min(shape[axis] as f64) as usize;
        if reach == 0 {
            continue;
        }
        let kernel: Vec<f64> = (0..=reach).map(|n| (-0.5 * (n as f64 / sigma_voxels).powi(2)).exp()).collect();
        let smoothed = |flat: usize| {
            let at = flat / strides[axis] % shape[axis];
            let first = flat - at * strides[axis];
            let (mut sum, mut total) = (0.0, 0.0);
            for other in at.saturating_sub(reach)..=(at + reach).min(shape[axis] - 1) {
                let weight = kernel[other.abs_diff(at)];
                sum += weight * f64::from(values[first + other * strides[axis]]);
                total += weight;
            }
            (sum / total) as f32
        };
        values = (0..values.len()).map(smoothed).collect();
    }
    Volume::new(grid.clone(), values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Grid;
    use nalgebra::Vector3;

    #[test]
    fn a_wave_keeps_its_phase_and_loses_what_a_gaussian_takes() {
        let grid = Grid::axis_aligned([160, 3, 3], Vector3::zeros(), Vector3::new(0.5, 1.0, 8.0)).unwrap();
        let (wave_number, sigma_mm) = (0.8_f64, 1.3);
        let value = |flat: usize| (wave_number * 0.5 * (flat % 160) as f64).sin() as f32;
        let wave = Volume::new(grid.clone(), (0..grid.voxel_count()).map(value).collect()).unwrap();
        let smoothed = gaussian_smoothed(&wave, sigma_mm).unwrap();
        let damping = (-0.5 * (wave_number * sigma_mm).powi(2)).exp();
        for i in 20..140 {
            let expected = damping * f64::from(wave.at([i, 1, 1]));
            assert!((f64::from(smoothed.at([i, 1, 1])) - expected).abs() < 2e-3);
        }
    }

    #[test]
    fn constants_stay_and_nonsense_is_refused() {
        let grid = Grid::axis_aligned([4, 5, 1], Vector3::zeros(), Vector3::repeat(1.0)).unwrap();
        let constant = Volume::new(grid, vec![3.0; 20]).unwrap();
        assert!(gaussian_smoothed(&constant, 2.0).unwrap().values().iter().all(|v| (v - 3.0).abs() < 1e-6));
        assert_eq!(gaussian_smoothed(&constant, 0.0).unwrap(), constant);
        assert!(gaussian_smoothed(&constant, f64::NAN).is_err());
    }
}
