//! Morris screening: mean and spread of elementary effects along random one-at-a-time paths, \[Morris1991\] with μ* of \[Campolongo2007\].
//!
//! $$ d_i = \frac{f(x + \Delta e_i) - f(x)}{\Delta},\qquad \mu^*_i = \overline{|d_i|},\qquad \sigma_i = \mathrm{sd}(d_i) $$
//!
//! μ* ranks the inputs; σ large beside μ* tells interactions or curvature. r (k + 1) evaluations for r paths in k inputs.

use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::bootstrap::Bootstrap;
use super::{Index, Measure, SensitivityError, without_gaps};
use crate::numerics::{mean, standard_deviation};

/// Points of all paths, one path after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct MorrisDesign {
    points: Vec<Vec<f64>>,
    /// Which input changes from point j to point j + 1 of a path.
    orders: Vec<Vec<usize>>,
    seed: u64,
}

impl MorrisDesign {
    /// `path_count` random paths over a grid of `level_count` (even) levels of the unit cube in `input_count` dimensions.
    ///
    /// # Errors
    /// [`SensitivityError::Setting`] for no inputs, fewer than two paths, or an odd or too small number of levels.
    pub fn new(input_count: usize, path_count: usize, level_count: usize, seed: u64) -> Result<Self, SensitivityError> {
        let refuse = |what, value: usize, remedy| Err(SensitivityError::Setting { what, value: value as f64, remedy });
        if input_count == 0 {
            return refuse("number of inputs", input_count, "must be at least one");
        }
        if path_count < 2 {
            return refuse("number of paths", path_count, "must be at least two");
        }
        if level_count < 2 || !level_count.is_multiple_of(2) {
            return refuse("number of levels", level_count, "must be even and at least two");
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let half = level_count / 2;
        let place = |level: usize| level as f64 / (level_count - 1) as f64;
        let (mut points, mut orders) = (Vec::new(), Vec::new());
        for _ in 0..path_count {
            // A jump of half the levels reaches every level equally often.
            let mut levels: Vec<usize> = (0..input_count).map(|_| rng.random_range(0..level_count)).collect();
            let mut order: Vec<usize> = (0..input_count).collect();
            order.shuffle(&mut rng);
            points.push(levels.iter().map(|&level| place(level)).collect());
            for &input in &order {
                levels[input] = if levels[input] < half { levels[input] + half } else { levels[input] - half };
                points.push(levels.iter().map(|&level| place(level)).collect());
            }
            orders.push(order);
        }
        Ok(Self { points, orders, seed })
    }

    /// Where to evaluate the model, in the unit cube.
    pub fn points(&self) -> &[Vec<f64>] {
        &self.points
    }

    /// An effect of which a point is a gap is left out.
    pub(super) fn indices(&self, values: &[f64]) -> Vec<Index> {
        let input_count = self.orders[0].len();
        // By input, then by path.
        let mut effects = vec![vec![f64::NAN; self.orders.len()]; input_count];
        for (path, order) in self.orders.iter().enumerate() {
            let first = path * (input_count + 1);
            for (place, &input) in order.iter().enumerate() {
                let (before, after) = (first + place, first + place + 1);
                let change = self.points[after][input] - self.points[before][input];
                effects[input][path] = (values[after] - values[before]) / change;
            }
        }
        let bootstrap = Bootstrap::new(self.orders.len(), self.seed);
        let summarise = |(input, effects): (usize, &Vec<f64>)| {
            let known = without_gaps(effects.iter().copied());
            let index = |measure, statistic: fn(&[f64]) -> f64, least: usize| {
                let of = |effects: Vec<f64>| if effects.len() < least { f64::NAN } else { statistic(&effects) };
                let interval = bootstrap.interval(|paths| of(without_gaps(paths.map(|path| effects[path]))));
                let value = of(known.clone());
                value.is_finite().then_some(Index { measure, input, partner: None, value, interval, sample_count: known.len() })
            };
            let mean_size = |effects: &[f64]| mean(&effects.iter().map(|effect| effect.abs()).collect::<Vec<_>>());
            [
                index(Measure::MeanAbsoluteEffect, mean_size, 1),
                index(Measure::MeanEffect, mean, 1),
                index(Measure::EffectSpread, standard_deviation, 2),
            ]
        };
        effects.iter().enumerate().flat_map(summarise).flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensitivity::Design;

    fn read(design: &MorrisDesign, model: impl Fn(&[f64]) -> Option<f64>) -> Vec<Index> {
        let response: Vec<_> = design.points().iter().map(|point| model(point)).collect();
        Design::Morris(design.clone()).indices(&response).unwrap()
    }

    fn find(indices: &[Index], measure: Measure, input: usize) -> Index {
        *indices.iter().find(|index| index.measure == measure && index.input == input).unwrap()
    }

    /// A plane has constant effects: its coefficients.
    #[test]
    fn effects_of_a_plane_are_its_coefficients() {
        let design = MorrisDesign::new(3, 10, 4, 1).unwrap();
        assert_eq!(design.points().len(), 40);
        let indices = read(&design, |x| Some(3.0 * x[0] - 2.0 * x[1] + x[2]));
        for (input, truth) in [3.0_f64, -2.0, 1.0].into_iter().enumerate() {
            assert!((find(&indices, Measure::MeanEffect, input).value - truth).abs() < 1e-12);
            assert!((find(&indices, Measure::MeanAbsoluteEffect, input).value - truth.abs()).abs() < 1e-12);
            assert!(find(&indices, Measure::EffectSpread, input).value < 1e-12);
        }
    }

    /// x₀ x₁ interacts: the effect of one is the other, uniform on the levels, with mean 1/2 and variance (1/12)(L + 1)/(L − 1).
    #[test]
    fn interactions_show_in_the_spread() {
        let design = MorrisDesign::new(2, 2000, 8, 2).unwrap();
        let indices = read(&design, |x| Some(x[0] * x[1]));
        let sd = (9.0_f64 / 7.0 / 12.0).sqrt();
        for input in [0, 1] {
            let (mean, spread) = (find(&indices, Measure::MeanEffect, input), find(&indices, Measure::EffectSpread, input));
            assert!((mean.value - 0.5).abs() < 0.03 && (spread.value - sd).abs() < 0.02, "{mean:?} {spread:?}");
            let (low, high) = mean.interval.unwrap();
            let expected = 2.0 * 1.96 * sd / 2000.0_f64.sqrt();
            assert!(low < 0.5 && 0.5 < high && ((high - low) / expected - 1.0).abs() < 0.15, "{mean:?} {expected}");
        }
    }

    #[test]
    fn failures_are_left_out_and_counted_and_seeds_repeat() {
        let design = MorrisDesign::new(2, 20, 4, 3).unwrap();
        assert_eq!(design, MorrisDesign::new(2, 20, 4, 3).unwrap());
        let indices = read(&design, |x| (x[0] <= 0.9).then_some(x[0]));
        let first = find(&indices, Measure::MeanEffect, 0);
        assert!(first.sample_count < 20 && first.sample_count > 0 && (first.value - 1.0).abs() < 1e-12, "{first:?}");
        let nothing = Design::Morris(design).indices(&[None; 60]);
        assert_eq!(nothing, Err(SensitivityError::NothingEvaluated { point_count: 60 }));
        assert!(MorrisDesign::new(0, 20, 4, 3).is_err() && MorrisDesign::new(2, 20, 5, 3).is_err());
    }
}
