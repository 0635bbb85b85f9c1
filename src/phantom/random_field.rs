//! Smooth random texture: a stationary Gaussian field with a given correlation length, the same for the same seed.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Lattice points a correlation length.
const POINTS_PER_LENGTH: f64 = 2.0;
/// Lattice points kept around the box, enough for the spline's support.
const MARGIN: usize = 3;
/// Most lattice points held in memory.
const POINT_LIMIT: f64 = 4.0e7;

/// A field of mean 0 and variance 1 (over the ensemble) whose correlation falls as $e^{-r^2 / 2\ell^2}$.
///
/// White noise on a lattice is smoothed by a Gaussian of deviation $\ell/\sqrt2$ and interpolated by cubic B-splines, so the field
/// is twice differentiable and costs 64 multiplications a value. Beyond the box it repeats its border values.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RandomField {
    origin_mm: Vector3<f64>,
    spacing_mm: f64,
    count: [usize; 3],
    values: Vec<f32>,
}

impl RandomField {
    /// A field for points between two corners. The lattice is coarsened if it would be too large to hold.
    pub(super) fn new([lowest_mm, highest_mm]: [Vector3<f64>; 2], correlation_mm: f64, seed: u64) -> Self {
        let size_mm = (highest_mm - lowest_mm).map(|x| x.max(0.0));
        let mut spacing_mm = correlation_mm / POINTS_PER_LENGTH;
        while size_mm.iter().map(|x| x / spacing_mm + 2.0 * MARGIN as f64 + 1.0).product::<f64>() > POINT_LIMIT {
            spacing_mm *= 1.5;
        }
        let count: [usize; 3] = std::array::from_fn(|axis| (size_mm[axis] / spacing_mm).ceil() as usize + 2 * MARGIN + 1);
        let origin_mm = lowest_mm - Vector3::repeat(MARGIN as f64 * spacing_mm);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut values: Vec<f32> = (0..count.iter().product()).map(|_| StandardNormal.sample(&mut random)).collect();
        // The spline smooths too: a cubic B-spline has the variance 1/3 (in spacings²), which the kernel leaves out.
        let deviation_points = correlation_mm / spacing_mm / std::f64::consts::SQRT_2;
        let kernel = gaussian_kernel((deviation_points * deviation_points - 1.0 / 3.0).max(0.05).sqrt());
        for axis in 0..3 {
            values = smoothed(&values, count, axis, &kernel);
        }
        let scale = 1.0 / deviation_after_smoothing(&kernel).powi(3) as f32;
        values.iter_mut().for_each(|value| *value *= scale);
        Self { origin_mm, spacing_mm, count, values }
    }

    /// The value at a point.
    pub(super) fn at(&self, point_mm: &Vector3<f64>) -> f64 {
        let mut first = [0; 3];
        let mut weights = [[0.0; 4]; 3];
        for axis in 0..3 {
            let place = (point_mm[axis] - self.origin_mm[axis]) / self.spacing_mm;
            let place = place.clamp(1.0, (self.count[axis] - 3) as f64);
            let cell = (place as usize).min(self.count[axis] - 3);
            first[axis] = cell - 1;
            weights[axis] = cubic_weights(place - cell as f64);
        }
        let [ni, nj, _] = self.count;
        let mut value = 0.0;
        for (k, wk) in weights[2].iter().enumerate() {
            for (j, wj) in weights[1].iter().enumerate() {
                let start = first[0] + ni * (first[1] + j + nj * (first[2] + k));
                let row = &self.values[start..start + 4];
                let along: f64 = row.iter().zip(&weights[0]).map(|(&v, w)| f64::from(v) * w).sum();
                value += wk * wj * along;
            }
        }
        value
    }
}

/// Cubic B-spline weights of four points around a place t ∈ [0, 1] after the second.
fn cubic_weights(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [s * s * s / 6.0, 2.0 / 3.0 - t * t * (1.0 - 0.5 * t), 2.0 / 3.0 - s * s * (1.0 - 0.5 * s), t * t * t / 6.0]
}

/// Gaussian weights from the centre outwards, of sum 1 over both sides.
fn gaussian_kernel(deviation: f64) -> Vec<f64> {
    let reach = (4.0 * deviation).ceil() as usize;
    let weights: Vec<f64> = (0..=reach).map(|x| (-0.5 * (x as f64 / deviation).powi(2)).exp()).collect();
    let total = 2.0 * weights.iter().sum::<f64>() - weights[0];
    weights.into_iter().map(|w| w / total).collect()
}

/// Deviation along one axis that kernel and spline leave of unit white noise, averaged over the places between lattice points.
fn deviation_after_smoothing(kernel: &[f64]) -> f64 {
    let at = |x: isize| kernel.get(x.unsigned_abs()).copied().unwrap_or(0.0);
    let reach = kernel.len() as isize + 3;
    const PLACE_COUNT: u8 = 64;
    let variance_at = |place: u8| {
        let weights = cubic_weights((f64::from(place) + 0.5) / f64::from(PLACE_COUNT));
        (-reach..=reach).map(|x| weights.iter().zip(0..).map(|(w, i)| w * at(x - i)).sum::<f64>().powi(2)).sum::<f64>()
    };
    ((0..PLACE_COUNT).map(variance_at).sum::<f64>() / f64::from(PLACE_COUNT)).sqrt()
}

/// Convolution with a symmetric kernel along one axis; the noise is continued periodically.
fn smoothed(values: &[f32], count: [usize; 3], axis: usize, kernel: &[f64]) -> Vec<f32> {
    let stride = [1, count[0], count[0] * count[1]][axis];
    let length = count[axis];
    let mut result = vec![0.0; values.len()];
    for (place, value) in result.iter_mut().enumerate() {
        let along = place / stride % length;
        let start = place - along * stride;
        let at = |offset: usize| f64::from(values[start + offset % length * stride]);
        let centre = kernel[0] * at(along);
        let sides = kernel.iter().enumerate().skip(1).map(|(x, w)| w * (at(along + x) + at(along + x.div_ceil(length) * length - x)));
        *value = (centre + sides.sum::<f64>()) as f32;
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variance_and_correlation_are_as_asked() {
        let bounds = [Vector3::zeros(), Vector3::repeat(120.0)];
        let length_mm: f64 = 4.0;
        let field = RandomField::new(bounds, length_mm, 5);
        let place = |i: usize| Vector3::new((i * 37 % 1103) as f64, (i * 101 % 1109) as f64, (i * 59 % 1117) as f64) / 10.0;
        let pairs = |offset: Vector3<f64>| {
            let products = (0..40_000).map(|i| field.at(&place(i)) * field.at(&(place(i) + offset)));
            products.sum::<f64>() / 40_000.0
        };
        // About 120³/(2√π·4)³ ≈ 600 independent patches: the sample variance deviates by √(2/600) ≈ 6 %.
        assert!((pairs(Vector3::zeros()) - 1.0).abs() < 0.15);
        for (axis, distance_mm) in [(0, 4.0), (1, 4.0), (2, 2.0)] {
            let expected = (-0.5 * (distance_mm / length_mm).powi(2)).exp();
            let correlation = pairs(Vector3::ith(axis, distance_mm)) / pairs(Vector3::zeros());
            assert!((correlation - expected).abs() < 0.06, "axis {axis}: {correlation} instead of {expected}");
        }
    }

    #[test]
    fn the_seed_alone_decides() {
        let bounds = [Vector3::zeros(), Vector3::repeat(20.0)];
        assert_eq!(RandomField::new(bounds, 3.0, 1), RandomField::new(bounds, 3.0, 1));
        assert_ne!(RandomField::new(bounds, 3.0, 1), RandomField::new(bounds, 3.0, 2));
    }
}
