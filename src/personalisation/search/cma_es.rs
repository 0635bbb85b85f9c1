//! Evolution strategy with covariance matrix adaptation \[Hansen2016\], as a solver for argmin.
//!
//! $$ x_k = m + s\, B D z_k,\quad m \leftarrow \sum_{i \le \mu} w_i x_{i:\lambda},\quad
//! C \leftarrow (1 - c_1 - c_\mu) C + c_1 p_c p_c^\top + c_\mu \sum_i w_i y_{i:\lambda} y_{i:\lambda}^\top,\quad C = B D^2 B^\top $$
//!
//! with every constant as the tutorial has it, but for its negative weights, which are left out.

use argmin::core::{CostFunction, Error, IterState, KV, Problem, Solver, SyncAlias, TerminationReason, TerminationStatus};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// The strategy and its state.
pub(super) struct CmaEs {
    mean: DVector<f64>,
    step: f64,
    covariance: DMatrix<f64>,
    path_step: DVector<f64>,
    path_covariance: DVector<f64>,
    weights: Vec<f64>,
    generation_size: usize,
    generations: i32,
    tolerance: f64,
    rng: ChaCha8Rng,
}

/// The tutorial's table 1.
struct Rates {
    effective: f64,
    path_step: f64,
    damping: f64,
    path_covariance: f64,
    rank_one: f64,
    rank_mu: f64,
    /// E ‖N(0, I)‖.
    expected_norm: f64,
}

impl CmaEs {
    /// A search around `mean` with a first step s; it has converged when no coordinate's spread exceeds `tolerance`.
    pub(super) fn new(mean: DVector<f64>, step: f64, tolerance: f64, seed: u64) -> Self {
        let dimension = mean.len();
        let generation_size = 4 + (3.0 * (dimension as f64).ln()).floor() as usize;
        let parents = generation_size / 2;
        let raw: Vec<f64> = (1..=parents).map(|rank| (0.5 * (generation_size as f64 + 1.0)).ln() - (rank as f64).ln()).collect();
        let sum: f64 = raw.iter().sum();
        Self {
            step,
            covariance: DMatrix::identity(dimension, dimension),
            path_step: DVector::zeros(dimension),
            path_covariance: DVector::zeros(dimension),
            weights: raw.into_iter().map(|weight| weight / sum).collect(),
            generation_size,
            generations: 0,
            tolerance,
            rng: ChaCha8Rng::seed_from_u64(seed),
            mean,
        }
    }

    fn rates(&self) -> Rates {
        let n = self.mean.len() as f64;
        let effective = 1.0 / self.weights.iter().map(|weight| weight * weight).sum::<f64>();
        let path_step = (effective + 2.0) / (n + effective + 5.0);
        let rank_one = 2.0 / ((n + 1.3).powi(2) + effective);
        let rank_mu = 2.0 * (effective - 2.0 + 1.0 / effective) / ((n + 2.0).powi(2) + effective);
        Rates {
            effective,
            path_step,
            damping: 1.0 + 2.0 * (((effective - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + path_step,
            path_covariance: (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n),
            rank_one,
            rank_mu: rank_mu.min(1.0 - rank_one),
            expected_norm: n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
        }
    }

    /// Moves the mean along the best steps y (in order of their cost) and adapts step and covariance to them.
    fn adapt(&mut self, best_steps: &[DVector<f64>], inverse_root: &DMatrix<f64>) {
        let rates = self.rates();
        let along = self.weights.iter().zip(best_steps).fold(DVector::zeros(self.mean.len()), |sum, (&weight, y)| sum + y * weight);
        self.mean += &along * self.step;
        self.generations += 1;

        let c = rates.path_step;
        self.path_step = &self.path_step * (1.0 - c) + inverse_root * &along * (c * (2.0 - c) * rates.effective).sqrt();
        let length = self.path_step.norm();
        let settled = 1.0 - (1.0 - c).powi(2 * self.generations);
        let is_short = length / settled.sqrt() < (1.4 + 2.0 / (self.mean.len() as f64 + 1.0)) * rates.expected_norm;

        let c = rates.path_covariance;
        let push = if is_short { (c * (2.0 - c) * rates.effective).sqrt() } else { 0.0 };
        self.path_covariance = &self.path_covariance * (1.0 - c) + &along * push;
        let stalled = if is_short { 0.0 } else { c * (2.0 - c) };
        let mut covariance = &self.covariance * (1.0 - rates.rank_one - rates.rank_mu + rates.rank_one * stalled);
        covariance += &self.path_covariance * self.path_covariance.transpose() * rates.rank_one;
        for (&weight, y) in self.weights.iter().zip(best_steps) {
            covariance += y * y.transpose() * (rates.rank_mu * weight);
        }
        self.covariance = (&covariance + covariance.transpose()) * 0.5;
        self.step *= (rates.path_step / rates.damping * (length / rates.expected_norm - 1.0)).min(1.0).exp();
    }
}

impl<O> Solver<O, IterState<DVector<f64>, (), (), (), (), f64>> for CmaEs
where
    O: CostFunction<Param = DVector<f64>, Output = f64> + SyncAlias,
{
    fn name(&self) -> &str {
        "CMA-ES"
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<O>,
        state: IterState<DVector<f64>, (), (), (), (), f64>,
    ) -> Result<(IterState<DVector<f64>, (), (), (), (), f64>, Option<KV>), Error> {
        let eigen = self.covariance.clone().symmetric_eigen();
        let widths = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
        let root = &eigen.eigenvectors * DMatrix::from_diagonal(&widths);
        let inverse_root =
            &eigen.eigenvectors * DMatrix::from_diagonal(&widths.map(|width| 1.0 / width.max(1e-150))) * eigen.eigenvectors.transpose();
        let steps: Vec<DVector<f64>> = (0..self.generation_size)
            .map(|_| &root * DVector::from_fn(self.mean.len(), |_, _| StandardNormal.sample(&mut self.rng)))
            .collect();
        let points: Vec<DVector<f64>> = steps.iter().map(|y| &self.mean + y * self.step).collect();
        let costs = problem.bulk_cost(&points)?;
        let mut order: Vec<usize> = (0..costs.len()).collect();
        order.sort_by(|&a, &b| costs[a].total_cmp(&costs[b]));
        let best = order[0];
        let best_steps: Vec<_> = order.iter().take(self.weights.len()).map(|&index| steps[index].clone()).collect();
        self.adapt(&best_steps, &inverse_root);
        Ok((state.param(points[best].clone()).cost(costs[best]), None))
    }

    fn terminate(&mut self, _: &IterState<DVector<f64>, (), (), (), (), f64>) -> TerminationStatus {
        let spread = self.step * self.covariance.diagonal().amax().sqrt();
        if spread <= self.tolerance || !spread.is_finite() {
            return TerminationStatus::Terminated(TerminationReason::SolverConverged);
        }
        TerminationStatus::NotTerminated
    }
}
