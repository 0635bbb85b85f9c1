//! Image gains chosen from data: the gain that predicts held-out boundary points best, or that leaves residuals as large as the noise.
//!
//! γ is sought in log₁₀ γ: first a coarse scan (held-out error need not have one valley), then argmin's golden section around the best point;
//! the discrepancy principle is a root and is found by argmin's Brent iteration.

use std::cell::RefCell;

use argmin::core::{CostFunction, Error, Executor};
use argmin::solver::brent::BrentRoot;
use argmin::solver::goldensectionsearch::GoldenSectionSearch;

use super::PersonalisationError;

/// Where to look for a gain, and how closely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GainSearch {
    /// Smallest gain, in any unit.
    pub lower: f64,
    /// Largest gain.
    pub upper: f64,
    /// Points of the first scan, at least 3.
    pub scan_count: usize,
    /// Width in decades at which the search ends.
    pub tolerance_decades: f64,
}

impl Default for GainSearch {
    /// Four decades around 1 kPa/mm, to a quarter of a decade.
    fn default() -> Self {
        Self { lower: 1e-2, upper: 1e2, scan_count: 5, tolerance_decades: 0.25 }
    }
}

/// One gain tried.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct GainEvaluation {
    /// The gain.
    pub gain: f64,
    /// Root mean square residual; infinite where tracking failed.
    pub residual_rms: f64,
}

/// The gain chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct GainChoice {
    /// The gain.
    pub gain: f64,
    /// Its residual.
    pub residual_rms: f64,
    /// Everything tried, in the order tried.
    pub evaluations: Vec<GainEvaluation>,
    /// The choice is an end of the range: the range was too narrow, or the data do not decide.
    pub at_edge: bool,
}

/// A function of log₁₀ γ that remembers what it was asked.
struct Recorded<F> {
    evaluate: RefCell<F>,
    record: RefCell<Vec<GainEvaluation>>,
    target: f64,
}

impl<F: FnMut(f64) -> Option<f64>> Recorded<F> {
    fn new(evaluate: F, target: f64) -> Self {
        Self { evaluate: RefCell::new(evaluate), record: RefCell::new(Vec::new()), target }
    }

    /// The residual at log₁₀ γ; a failure counts as infinite.
    fn at(&self, log_gain: f64) -> f64 {
        let gain = 10.0_f64.powf(log_gain);
        if let Some(known) = self.record.borrow().iter().find(|known| known.gain == gain) {
            return known.residual_rms;
        }
        let residual_rms = (self.evaluate.borrow_mut())(gain).filter(|rms| !rms.is_nan()).unwrap_or(f64::INFINITY);
        self.record.borrow_mut().push(GainEvaluation { gain, residual_rms });
        residual_rms
    }

    fn choice(self, lower: f64, upper: f64, better: impl Fn(&GainEvaluation) -> f64) -> Result<GainChoice, PersonalisationError> {
        let evaluations = self.record.into_inner();
        let best = evaluations.iter().filter(|tried| tried.residual_rms.is_finite()).min_by(|a, b| better(a).total_cmp(&better(b)));
        let Some(&GainEvaluation { gain, residual_rms }) = best else {
            let remedy = "tracking failed at every gain tried; look at one gain by itself";
            return Err(PersonalisationError::Setting { what: "gain", value: upper, remedy });
        };
        let edge = |bound: f64| (gain / bound).log10().abs() < 1e-9;
        Ok(GainChoice { gain, residual_rms, at_edge: edge(lower) || edge(upper), evaluations })
    }
}

/// For argmin: the residual less the target, over a coordinate that starts at 1 (its golden section stops on a width relative to it).
struct Shifted<'a, F> {
    recorded: &'a Recorded<F>,
    origin: f64,
}

impl<F: FnMut(f64) -> Option<f64>> CostFunction for Shifted<'_, F> {
    type Param = f64;
    type Output = f64;

    fn cost(&self, coordinate: &f64) -> Result<f64, Error> {
        Ok(self.recorded.at(self.origin + coordinate) - self.recorded.target)
    }
}

impl GainSearch {
    fn check(&self) -> Result<(f64, f64), PersonalisationError> {
        let refuse = |what, value, remedy| Err(PersonalisationError::Setting { what, value, remedy });
        if !(self.lower > 0.0 && self.lower < self.upper && self.upper.is_finite()) {
            return refuse("gain range", self.lower, "must be positive and ascending");
        }
        if self.scan_count < 3 {
            return refuse("scan_count", self.scan_count as f64, "must be at least 3");
        }
        if !(self.tolerance_decades > 0.0 && self.tolerance_decades.is_finite()) {
            return refuse("tolerance_decades", self.tolerance_decades, "must be positive");
        }
        Ok((self.lower.log10(), self.upper.log10()))
    }

    /// The gain with the smallest residual on held-out boundary points; `held_out_rms` returns it for a gain, or `None` where tracking failed.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] for a bad range, or if no gain could be tried.
    pub fn by_held_out(&self, held_out_rms: impl FnMut(f64) -> Option<f64>) -> Result<GainChoice, PersonalisationError> {
        let (first, last) = self.check()?;
        let recorded = Recorded::new(held_out_rms, 0.0);
        let spacing = (last - first) / (self.scan_count - 1) as f64;
        let scan: Vec<f64> = (0..self.scan_count).map(|k| recorded.at(first + spacing * k as f64)).collect();
        let best = (0..scan.len()).min_by(|&a, &b| scan[a].total_cmp(&scan[b])).unwrap_or(0);
        let (left, right) = (best.saturating_sub(1), (best + 1).min(self.scan_count - 1));
        let origin = first + spacing * left as f64 - 1.0;
        let width = spacing * (right - left) as f64;
        let middle = 1.0 + spacing * (best - left) as f64;
        let start = if best == left || best == right { 1.0 + 0.381_966 * width } else { middle };
        // The solver's tolerance is relative to |x₁| + |x₂| ≤ 2(1 + width).
        let tolerance = self.tolerance_decades / (2.0 * (1.0 + width));
        if scan[best].is_finite() && width > self.tolerance_decades {
            GoldenSectionSearch::new(1.0, 1.0 + width)
                .and_then(|solver| solver.with_tolerance(tolerance))
                .and_then(|solver| {
                    let shifted = Shifted { recorded: &recorded, origin };
                    Executor::new(shifted, solver).configure(|state| state.param(start).max_iters(30)).timer(false).run().map(|_| ())
                })
                .map_err(|error| PersonalisationError::Optimiser(error.to_string()))?;
        }
        recorded.choice(self.lower, self.upper, |tried| tried.residual_rms)
    }

    /// The gain at which the residual on the points used equals their noise `noise_rms` (\[Morozov1966\]'s discrepancy principle): a larger
    /// gain would fit noise. The residual falls with the gain; where it never crosses the noise, the nearer end of the range is chosen.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] for a bad range or noise, or if no gain could be tried.
    pub fn by_discrepancy(&self, noise_rms: f64, residual_rms: impl FnMut(f64) -> Option<f64>) -> Result<GainChoice, PersonalisationError> {
        let (first, last) = self.check()?;
        if !(noise_rms > 0.0 && noise_rms.is_finite()) {
            return Err(PersonalisationError::Setting { what: "noise", value: noise_rms, remedy: "must be positive" });
        }
        let recorded = Recorded::new(residual_rms, noise_rms);
        let (weak, strong) = (recorded.at(first), recorded.at(last));
        if weak.is_finite() && strong.is_finite() && weak > noise_rms && strong < noise_rms {
            let shifted = Shifted { recorded: &recorded, origin: 0.0 };
            Executor::new(shifted, BrentRoot::new(first, last, self.tolerance_decades))
                .configure(|state| state.max_iters(30))
                .timer(false)
                .run()
                .map_err(|error| PersonalisationError::Optimiser(error.to_string()))?;
        }
        recorded.choice(self.lower, self.upper, |tried| (tried.residual_rms - noise_rms).abs())
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::numerics::root_mean_square;

    const MODEL_SD: f64 = 3.0;
    const NOISE_SD: f64 = 1.0;

    /// A static observer: the model is off by a (sd 3 mm), the data by b (sd 1 mm), and the state (m + γ z)/(1 + γ) has the error
    /// (a + γ b)/(1 + γ), smallest at γ = (3/1)² = 9. Held-out points see that error and their own noise.
    fn expected_held_out_rms(gain: f64) -> f64 {
        let state = (MODEL_SD.powi(2) + (gain * NOISE_SD).powi(2)) / (1.0 + gain).powi(2);
        (state + NOISE_SD * NOISE_SD).sqrt()
    }

    fn fine() -> GainSearch {
        GainSearch { tolerance_decades: 0.01, ..GainSearch::default() }
    }

    #[test]
    fn held_out_points_choose_the_best_linear_gain() {
        let choice = fine().by_held_out(|gain| Some(expected_held_out_rms(gain))).unwrap();
        assert!((choice.gain / 9.0).log10().abs() < 0.02, "{}", choice.gain);
        assert!(!choice.at_edge);
        assert!(choice.evaluations.len() < 20, "{} evaluations", choice.evaluations.len());
    }

    /// The same with sampled points, half of them held out: the error that held-out points show is smallest near the best gain.
    #[test]
    fn sampled_held_out_points_choose_nearly_the_same() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (model, noise) = (Normal::new(0.0, MODEL_SD).unwrap(), Normal::new(0.0, NOISE_SD).unwrap());
        let points: Vec<[f64; 3]> = (0..4000).map(|_| [model.sample(&mut rng), noise.sample(&mut rng), noise.sample(&mut rng)]).collect();
        let rms = |gain: f64| {
            let errors: Vec<f64> = points.iter().map(|[a, b, held]| (a + gain * b) / (1.0 + gain) - held).collect();
            Some(root_mean_square(&errors))
        };
        let choice = fine().by_held_out(rms).unwrap();
        assert!((choice.gain / 9.0).log10().abs() < 0.15, "{}", choice.gain);
    }

    /// Residual at used points: (z − m)/(1 + γ) has the rms √(a² + b²)/(1 + γ); it is the noise at γ = √(a² + b²)/b − 1.
    #[test]
    fn discrepancy_principle_leaves_the_noise() {
        let total = MODEL_SD.hypot(NOISE_SD);
        let choice = fine().by_discrepancy(NOISE_SD, |gain| Some(total / (1.0 + gain))).unwrap();
        assert!((choice.gain / (total / NOISE_SD - 1.0)).log10().abs() < 0.01, "{}", choice.gain);
        let quiet = fine().by_discrepancy(100.0, |gain| Some(total / (1.0 + gain))).unwrap();
        assert!(quiet.at_edge && quiet.gain < 0.011, "noise beyond every residual needs no gain");
        assert!(fine().by_discrepancy(0.0, |_| Some(1.0)).is_err());
    }

    #[test]
    fn failures_are_avoided_and_edges_are_told() {
        let failing_above_five = |gain: f64| (gain < 5.0).then(|| expected_held_out_rms(gain));
        let choice = fine().by_held_out(failing_above_five).unwrap();
        assert!(choice.gain < 5.0 && choice.gain > 4.0, "{}", choice.gain);
        assert!(fine().by_held_out(|_| None).is_err());
        let falling = fine().by_held_out(|gain| Some(1.0 / gain)).unwrap();
        assert!(falling.at_edge);
        assert!(GainSearch { lower: -1.0, ..fine() }.by_held_out(|_| Some(1.0)).is_err());
    }

    #[test]
    fn nothing_is_evaluated_twice() {
        let mut asked = Vec::new();
        let choice = fine()
            .by_held_out(|gain| {
                asked.push(gain);
                Some(expected_held_out_rms(gain))
            })
            .unwrap();
        let mut unique = asked.clone();
        unique.sort_by(f64::total_cmp);
        unique.dedup();
        assert_eq!(unique.len(), asked.len());
        assert_eq!(choice.evaluations.len(), asked.len());
    }
}
