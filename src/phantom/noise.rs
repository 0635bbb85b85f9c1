//! What the scanner adds: noise of magnitude images and the falling-off sensitivity of its coils.

use nalgebra::{Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::image::Grid;

/// Replaces intensities A by $|A + n_1 + i\,n_2|$ with $n \sim N(0, \sigma^2)$: Rician noise, \[Gudbjartsson1995\]. Each `stream` of a seed is
/// independent of the others.
pub(super) fn add_rician_noise(values: &mut [f32], deviation: f64, seed: u64, stream: u64) {
    if deviation <= 0.0 {
        return;
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(stream);
    let deviation = deviation as f32;
    for value in values {
        let real: f32 = StandardNormal.sample(&mut random);
        let imaginary: f32 = StandardNormal.sample(&mut random);
        *value = (*value + deviation * real).hypot(deviation * imaginary);
    }
}

/// Displacements of slices (mm along i and j), independent and normal about zero: a patient who holds the breath a little differently for each.
pub fn breath_hold_shifts_mm(slice_count: usize, deviation_mm: f64, seed: u64) -> Vec<Vector2<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(u64::MAX);
    let mut displacement = || {
        let normal: f64 = StandardNormal.sample(&mut random);
        deviation_mm * normal
    };
    (0..slice_count).map(|_| Vector2::new(displacement(), displacement())).collect()
}

/// A smooth factor $e^{a s}$ on the intensities, s running from −1 to 1 across the image along one oblique direction of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BiasField {
    slope_per_voxel: Vector3<f64>,
    centre_voxel: Vector3<f64>,
}

impl BiasField {
    pub(super) fn new(grid: &Grid, amplitude: f64) -> Self {
        let last = grid.shape().map(|n| (n.max(2) - 1) as f64);
        // Mostly from front to back, a little across and along, as with a surface coil on the chest.
        let shares = [0.25, -0.65, 0.1];
        let slope_per_voxel = Vector3::from_fn(|axis, _| 2.0 * amplitude * shares[axis] / last[axis]);
        Self { slope_per_voxel, centre_voxel: Vector3::from(last) * 0.5 }
    }

    pub(super) fn factor(&self, voxel: [usize; 3]) -> f64 {
        let offset = Vector3::from_fn(|axis, _| voxel[axis] as f64) - self.centre_voxel;
        self.slope_per_voxel.dot(&offset).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// e^{−x} I₀(x) and e^{−x} I₁(x) by their integral (1/π) ∫ e^{x (cos t − 1)} cos(n t) dt.
    fn scaled_bessel(order: i32, x: f64) -> f64 {
        let count = 20_000;
        let at = |i: i32| {
            let t = std::f64::consts::PI * (f64::from(i) + 0.5) / f64::from(count);
            (x * (t.cos() - 1.0)).exp() * (f64::from(order) * t).cos()
        };
        (0..count).map(at).sum::<f64>() / f64::from(count)
    }

    #[test]
    fn the_noise_has_the_moments_of_a_rician() {
        let (deviation, count) = (7.0, 200_000);
        for signal in [0.0, 5.0, 20.0, 120.0] {
            let mut values = vec![signal as f32; count];
            add_rician_noise(&mut values, deviation, 11, 3);
            let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / count as f64;
            let square = values.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / count as f64;
            // E = σ √(π/2) L½(−A²/2σ²) with L½(−2x) = (1 + 2x) e^{−x} I₀(x) + 2x e^{−x} I₁(x);  E² = A² + 2σ².
            let x = (signal / deviation).powi(2) / 4.0;
            let laguerre = (1.0 + 2.0 * x) * scaled_bessel(0, x) + 2.0 * x * scaled_bessel(1, x);
            let expected = deviation * (std::f64::consts::PI / 2.0).sqrt() * laguerre;
            let standard_error = deviation / (count as f64).sqrt();
            assert!((mean - expected).abs() < 4.0 * standard_error, "signal {signal}: mean {mean} instead of {expected}");
            let expected = signal * signal + 2.0 * deviation * deviation;
            assert!((square / expected - 1.0).abs() < 0.01, "signal {signal}: mean square {square} instead of {expected}");
        }
    }

    #[test]
    fn streams_differ() {
        let noisy = |stream| {
            let mut values = vec![100.0; 8];
            add_rician_noise(&mut values, 5.0, 1, stream);
            values
        };
        assert_eq!(noisy(1), noisy(1));
        assert_ne!(noisy(1), noisy(2));
    }
}
