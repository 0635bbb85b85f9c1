//! The calibration as a cost over the solver's own coordinates; it remembers the best point that anyone has asked for.

use std::borrow::Borrow;
use std::sync::{Mutex, PoisonError};

use argmin::core::{CostFunction, Error, Gradient, SendAlias, SyncAlias};
use nalgebra::DVector;
use rayon::prelude::*;

use super::chart::Chart;
use crate::personalisation::problem::Evaluation;
use crate::personalisation::{CalibrationProblem, IterationRecord, PersonalisationError, RecordStatus, TangentModel};

/// Cost of a point that could not be simulated, at the best point; it grows with the distance from there, so that a search that has strayed
/// among such points finds the way back.
const WALL: f64 = 1e12;
/// Cost of a constraint's violation by one.
const PENALTY: f64 = 1e6;

/// The best point and how often the solver asked.
struct Best {
    coordinates: DVector<f64>,
    evaluation: Evaluation,
    evaluation_count: u64,
    linearisation_count: u64,
}

/// Cost and gradient over the coordinates of a chart.
pub(super) struct Objective<'p, 'a, M: TangentModel> {
    problem: &'p CalibrationProblem<'a, M>,
    chart: Chart,
    best: Mutex<Best>,
}

fn penalised(evaluation: &Evaluation) -> f64 {
    evaluation.cost() + PENALTY * evaluation.violation
}

impl<'p, 'a, M: TangentModel> Objective<'p, 'a, M> {
    /// The objective; the start is evaluated.
    pub(super) fn new(problem: &'p CalibrationProblem<'a, M>, chart: Chart, start: &DVector<f64>) -> Result<Self, PersonalisationError> {
        let best = Best { coordinates: start.clone(), evaluation: problem.evaluate(start)?, evaluation_count: 1, linearisation_count: 0 };
        Ok(Self { problem, chart, best: Mutex::new(best) })
    }

    /// u = 0.
    pub(super) fn origin(&self) -> DVector<f64> {
        DVector::zeros(self.problem.dimension())
    }

    /// Evaluations and linearisations that the solver asked for.
    pub(super) fn counts(&self) -> (u64, u64) {
        let best = self.best.lock().unwrap_or_else(PoisonError::into_inner);
        (best.evaluation_count, best.linearisation_count)
    }

    /// The best point.
    pub(super) fn into_best(self) -> (DVector<f64>, Evaluation) {
        let best = self.best.into_inner().unwrap_or_else(PoisonError::into_inner);
        (best.coordinates, best.evaluation)
    }

    /// The best point after an iteration.
    pub(super) fn record(&self, iteration: u64, previous: Option<&IterationRecord>) -> IterationRecord {
        let best = self.best.lock().unwrap_or_else(PoisonError::into_inner);
        let (theta, scales) = (&best.coordinates, self.problem.scales());
        let mut record = IterationRecord::at_start(theta, &best.evaluation, 0.0, self.problem.spent());
        let near = |index: &usize, bound: &DVector<f64>| (theta[*index] - bound[*index]).abs() <= 1e-6 * scales[*index];
        record.iteration = iteration;
        if iteration > 0 {
            record.status = RecordStatus::Accepted;
        }
        record.trials = best.evaluation_count;
        record.step_norm = previous.map_or(0.0, |previous| (theta - &previous.coordinates).component_div(&scales).norm());
        record.active_lower = (0..theta.len()).filter(|index| near(index, self.problem.lower())).collect();
        record.active_upper = (0..theta.len()).filter(|index| near(index, self.problem.upper())).collect();
        record
    }

    fn theta(&self, free: &DVector<f64>) -> DVector<f64> {
        self.problem.clamp(&self.chart.to_theta(free))
    }

    /// What became of a point; a failure is none.
    fn try_at(&self, theta: &DVector<f64>) -> Result<Option<Evaluation>, PersonalisationError> {
        match self.problem.evaluate(theta) {
            Ok(evaluation) => Ok(Some(evaluation)),
            Err(PersonalisationError::Simulation { .. } | PersonalisationError::NonFiniteResidual { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Its cost; the best point so far is kept.
    fn register(&self, theta: DVector<f64>, evaluation: Option<Evaluation>) -> f64 {
        let mut best = self.best.lock().unwrap_or_else(PoisonError::into_inner);
        best.evaluation_count += 1;
        let Some(evaluation) = evaluation else {
            let astray = (&theta - &best.coordinates).component_div(&self.problem.scales()).norm_squared();
            return WALL * (1.0 + astray);
        };
        let cost = penalised(&evaluation);
        if cost < penalised(&best.evaluation) {
            (best.coordinates, best.evaluation) = (theta, evaluation);
        }
        cost
    }
}

impl<M: TangentModel> CostFunction for &Objective<'_, '_, M> {
    type Param = DVector<f64>;
    type Output = f64;

    fn cost(&self, free: &DVector<f64>) -> Result<f64, Error> {
        let theta = self.theta(free);
        let evaluation = self.try_at(&theta)?;
        Ok(self.register(theta, evaluation))
    }

    /// A generation at once: simulated in parallel, registered in order.
    fn bulk_cost<P>(&self, points: &[P]) -> Result<Vec<f64>, Error>
    where
        P: Borrow<DVector<f64>> + SyncAlias,
        f64: SendAlias,
        Self: SyncAlias,
    {
        let thetas: Vec<_> = points.iter().map(|point| self.theta(point.borrow())).collect();
        let evaluations: Result<Vec<_>, _> = thetas.par_iter().map(|theta| self.try_at(theta)).collect();
        Ok(thetas.into_iter().zip(evaluations?).map(|(theta, evaluation)| self.register(theta, evaluation)).collect())
    }
}

impl<M: TangentModel> Gradient for &Objective<'_, '_, M> {
    type Param = DVector<f64>;
    type Gradient = DVector<f64>;

    /// Zero where nothing can be simulated: no search begins there, and none ends there, for its cost is far too high.
    fn gradient(&self, free: &DVector<f64>) -> Result<DVector<f64>, Error> {
        let theta = self.theta(free);
        self.best.lock().unwrap_or_else(PoisonError::into_inner).linearisation_count += 1;
        let Some(evaluation) = self.try_at(&theta)? else { return Ok(self.origin()) };
        let gradient = self.problem.linearise(&theta, &evaluation)?.gradient();
        let pushed = self.problem.constraints().filter(|constraint| constraint.value(&theta) > 0.0);
        let gradient = pushed.fold(gradient, |sum, constraint| sum + constraint.gradient(&theta) * PENALTY);
        Ok(gradient.component_mul(&self.chart.slopes(free)))
    }
}
