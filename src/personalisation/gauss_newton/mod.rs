//! Gauss–Newton with a quadratic program a step, inside argmin: bounds, constraints and a trust region are met by every step.
//!
//! $$ \min_z \tfrac12 z^\top S H S z + g^\top S z \quad\text{s.t.}\quad l \le \theta + S z \le u,\; c + \nabla c^\top S z \le 0,\; \lVert z\rVert \le \Delta $$
//!
//! z is the step in units of the coordinates' scales S (prior standard deviations). The radius Δ follows the gain ratio (actual over
//! predicted decrease, \[Nocedal2006\] §4.1) of the merit function cost + π Σ max(0, c); a simulation that fails shrinks it.

mod outcome;
mod step;

pub use outcome::{Calibration, CalibrationOutcome, ConvergenceTest, IterationRecord, RecordStatus};

use argmin::core::{Error, Executor, IterState, KV, Problem, Solver, TerminationReason, TerminationStatus};
use nalgebra::{DMatrix, DVector};

use super::problem::{CalibrationProblem, Evaluation, Linearisation};
use super::{PersonalisationError, TangentModel};
use step::Proposal;

/// Decrease, as a part of the predicted one, that makes a step acceptable.
const ACCEPTABLE_GAIN: f64 = 1e-3;
/// Gain ratio below which the radius shrinks.
const POOR_GAIN: f64 = 0.25;
/// Gain ratio above which a step on the boundary lets the radius grow.
const GOOD_GAIN: f64 = 0.75;
/// The radius never grows beyond this many scales.
const LARGEST_RADIUS: f64 = 1e3;
/// Violation of the constraints under which a point counts as feasible.
const FEASIBLE: f64 = 1e-6;

/// Shape of the trust region, in scaled steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TrustShape {
    /// ‖z‖ ≤ Δ, a second-order cone.
    #[default]
    Ball,
    /// |z_i| ≤ Δ.
    Box,
}

/// How long and how carefully to search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussNewtonSettings {
    /// Most accepted steps.
    pub max_iterations: u64,
    /// Converged when every component of a full step is below this, in coordinates (1e-4 in a logarithm is 0.01 %).
    pub step_tolerance: f64,
    /// Converged when the decrease that a full step promises is below this part of the cost.
    pub cost_tolerance: f64,
    /// Converged when the projected gradient in scaled coordinates is below this.
    pub gradient_tolerance: f64,
    /// Shape of the trust region.
    pub trust_shape: TrustShape,
    /// First radius, in scales.
    pub initial_radius: f64,
    /// The search stalls when the radius falls below this.
    pub smallest_radius: f64,
}

impl Default for GaussNewtonSettings {
    fn default() -> Self {
        Self {
            max_iterations: 25,
            step_tolerance: 1e-4,
            cost_tolerance: 1e-6,
            gradient_tolerance: 1e-7,
            trust_shape: TrustShape::Ball,
            initial_radius: 1.0,
            smallest_radius: 1e-5,
        }
    }
}

/// argmin's state for this solver.
pub type CalibrationState = IterState<DVector<f64>, (), DMatrix<f64>, (), DVector<f64>, f64>;

/// The solver; [`calibrate`] runs it.
pub struct GaussNewtonQp<'o> {
    settings: GaussNewtonSettings,
    observer: &'o mut dyn FnMut(&IterationRecord),
    current: Option<Evaluation>,
    linearisation: Option<Linearisation>,
    radius: f64,
    /// π of the merit function.
    penalty: f64,
    records: Vec<IterationRecord>,
    outcome: Option<CalibrationOutcome>,
}

/// A point and the objective there.
type Reached = (DVector<f64>, Evaluation);

/// What became of a proposed step.
enum Trial {
    Accepted { evaluation: Evaluation, gain_ratio: f64 },
    Rejected,
    Failed,
    Stopped,
}

/// Minimises `problem` from `start` (moved into the box), telling `observer` of the start and of every accepted step.
///
/// # Errors
/// [`PersonalisationError`] if the start cannot be evaluated, or a quadratic program has no answer. A simulation that fails later shrinks
/// the step, and a search that does not converge says so in [`Calibration::outcome`].
pub fn calibrate<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    start: &DVector<f64>,
    settings: GaussNewtonSettings,
    observer: &mut dyn FnMut(&IterationRecord),
) -> Result<Calibration, PersonalisationError> {
    if start.len() != problem.dimension() {
        return Err(PersonalisationError::Shape { what: "start coordinates", found: start.len(), expected: problem.dimension() });
    }
    let start = problem.clamp(start);
    // One more iteration than steps: the last one finds that nothing is left to do.
    let run = Executor::new(problem, GaussNewtonQp::new(settings, observer))
        .configure(|state: CalibrationState| state.param(start).max_iters(settings.max_iterations + 1))
        .timer(false)
        .run()
        .map_err(|error| match error.downcast::<PersonalisationError>() {
            Ok(own) => own,
            Err(other) => PersonalisationError::Optimiser(other.to_string()),
        })?;
    let count = |name: &str| run.problem.counts.get(name).copied().unwrap_or(0);
    let (evaluation_count, linearisation_count) = (count("cost_count"), count("jacobian_count"));
    let solver = run.solver;
    let (Some(coordinates), Some(evaluation)) = (run.state.param, solver.current) else {
        return Err(PersonalisationError::Stopped);
    };
    Ok(Calibration {
        coordinates,
        evaluation,
        linearisation: solver.linearisation,
        outcome: solver.outcome.unwrap_or(CalibrationOutcome::MaxIterations),
        records: solver.records,
        evaluation_count,
        linearisation_count,
        spent: problem.spent(),
    })
}

impl<'o> GaussNewtonQp<'o> {
    /// A solver that has not started.
    pub fn new(settings: GaussNewtonSettings, observer: &'o mut dyn FnMut(&IterationRecord)) -> Self {
        Self {
            settings,
            observer,
            current: None,
            linearisation: None,
            radius: settings.initial_radius,
            penalty: 0.0,
            records: Vec::new(),
            outcome: None,
        }
    }

    fn record(&mut self, record: IterationRecord) {
        (self.observer)(&record);
        self.records.push(record);
    }

    /// The test that says that θ is a minimum of the constrained problem, if one does.
    fn convergence(&self, evaluation: &Evaluation, projected_gradient: f64, proposal: &Proposal) -> Option<ConvergenceTest> {
        let feasible = evaluation.violation <= FEASIBLE;
        if feasible && projected_gradient <= self.settings.gradient_tolerance {
            Some(ConvergenceTest::Gradient)
        } else if proposal.on_trust_boundary {
            None
        } else if proposal.step.amax() <= self.settings.step_tolerance {
            Some(ConvergenceTest::Step)
        } else if feasible && proposal.predicted_decrease <= self.settings.cost_tolerance * evaluation.cost() {
            Some(ConvergenceTest::Cost)
        } else {
            None
        }
    }

    /// Evaluates a proposal and adapts the radius.
    fn attempt<M: TangentModel>(
        &mut self,
        problem: &mut Problem<&CalibrationProblem<'_, M>>,
        at: &Evaluation,
        candidate: &DVector<f64>,
        proposal: &Proposal,
    ) -> Result<Trial, Error> {
        self.penalty = self.penalty.max(2.0 * proposal.largest_multiplier);
        let merit = |evaluation: &Evaluation| evaluation.cost() + self.penalty * evaluation.violation;
        let predicted = proposal.predicted_decrease + self.penalty * (at.violation - proposal.linear_violation);
        let reached = problem.problem("cost_count", |own| Ok(own.evaluate(candidate)))?;
        let gain_ratio = match &reached {
            Ok(evaluation) => (merit(at) - merit(evaluation)) / predicted,
            Err(PersonalisationError::Stopped) => return Ok(Trial::Stopped),
            Err(PersonalisationError::Simulation { .. } | PersonalisationError::NonFiniteResidual { .. }) => f64::NEG_INFINITY,
            Err(_) => return reached.map(|_| Trial::Rejected).map_err(Error::from),
        };
        // No prediction and no answer (0/0) is no gain.
        let gain_ratio = if gain_ratio.is_nan() { f64::NEG_INFINITY } else { gain_ratio };
        if gain_ratio < POOR_GAIN {
            self.radius = 0.25 * self.radius.min(proposal.norm);
        } else if gain_ratio > GOOD_GAIN && proposal.on_trust_boundary {
            self.radius = (2.0 * self.radius).min(LARGEST_RADIUS);
        }
        match reached {
            Ok(evaluation) if gain_ratio > ACCEPTABLE_GAIN => Ok(Trial::Accepted { evaluation, gain_ratio }),
            Ok(_) => Ok(Trial::Rejected),
            Err(_) => Ok(Trial::Failed),
        }
    }

    /// Proposes and tries until a step is accepted or the search ends.
    fn advance<M: TangentModel>(
        &mut self,
        problem: &mut Problem<&CalibrationProblem<'_, M>>,
        evaluation: &Evaluation,
        linearisation: &Linearisation,
        iteration: u64,
    ) -> Result<Option<Reached>, Error> {
        let theta = &linearisation.coordinates;
        let mut trials = 0;
        loop {
            let own = own_problem(problem)?;
            let radius = self.radius;
            let proposal = step::propose(own, linearisation, self.settings.trust_shape, radius)?;
            let projected_gradient = step::projected_gradient(own, linearisation);
            if let Some(test) = self.convergence(evaluation, projected_gradient, &proposal) {
                let held = proposal.holds() || step::touches_bound(own, theta);
                self.outcome = Some(if held { CalibrationOutcome::OnBound(test) } else { CalibrationOutcome::Converged(test) });
                return Ok(None);
            }
            if iteration > self.settings.max_iterations {
                return Ok(None);
            }
            if radius < self.settings.smallest_radius {
                self.outcome = Some(CalibrationOutcome::Stalled);
                return Ok(None);
            }
            let candidate = own.clamp(&(theta + &proposal.step));
            trials += 1;
            match self.attempt(problem, evaluation, &candidate, &proposal)? {
                Trial::Stopped => {
                    self.outcome = Some(CalibrationOutcome::Stopped);
                    return Ok(None);
                }
                Trial::Rejected => {}
                Trial::Failed => {
                    let start = IterationRecord::at_start(&candidate, evaluation, radius, own_problem(problem)?.spent());
                    let infinite = f64::INFINITY;
                    self.record(IterationRecord {
                        iteration,
                        status: RecordStatus::Failed,
                        cost: infinite,
                        data_cost: infinite,
                        step_norm: proposal.norm,
                        gain_ratio: f64::NEG_INFINITY,
                        trials,
                        ..start
                    });
                }
                Trial::Accepted { evaluation, gain_ratio } => {
                    self.record(IterationRecord {
                        iteration,
                        status: RecordStatus::Accepted,
                        cost: evaluation.cost(),
                        data_cost: evaluation.data_cost,
                        prior_cost: evaluation.prior_cost,
                        step_norm: proposal.norm,
                        trust_radius: radius,
                        gain_ratio,
                        trials,
                        spent: own_problem(problem)?.spent(),
                        active_lower: proposal.active_lower,
                        active_upper: proposal.active_upper,
                        active_constraints: proposal.active_constraints,
                        coordinates: candidate.clone(),
                    });
                    return Ok(Some((candidate, evaluation)));
                }
            }
        }
    }
}

impl<M: TangentModel> Solver<&CalibrationProblem<'_, M>, CalibrationState> for GaussNewtonQp<'_> {
    fn name(&self) -> &str {
        "Gauss-Newton with quadratic programs"
    }

    fn init(
        &mut self,
        problem: &mut Problem<&CalibrationProblem<'_, M>>,
        mut state: CalibrationState,
    ) -> Result<(CalibrationState, Option<KV>), Error> {
        let start = taken_param(&mut state)?;
        let evaluation = problem.problem("cost_count", |own| Ok(own.evaluate(&start)))??;
        self.record(IterationRecord::at_start(&start, &evaluation, self.radius, own_problem(problem)?.spent()));
        let cost = evaluation.cost();
        self.current = Some(evaluation);
        Ok((state.param(start).cost(cost), None))
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<&CalibrationProblem<'_, M>>,
        mut state: CalibrationState,
    ) -> Result<(CalibrationState, Option<KV>), Error> {
        let theta = taken_param(&mut state)?;
        let Some(evaluation) = self.current.take() else {
            return Err(PersonalisationError::Optimiser("solver used before its initialisation".to_owned()).into());
        };
        let linearised = problem.problem("jacobian_count", |own| Ok(own.linearise(&theta, &evaluation)))?;
        let mut reached = None;
        match linearised {
            Ok(linearisation) => {
                reached = self.advance(problem, &evaluation, &linearisation, state.iter + 1)?;
                self.linearisation = Some(linearisation);
            }
            Err(PersonalisationError::Stopped) => self.outcome = Some(CalibrationOutcome::Stopped),
            Err(error) if self.records.len() < 2 => return Err(error.into()),
            Err(error) => self.outcome = Some(CalibrationOutcome::Failed(error.to_string())),
        }
        let (theta, evaluation) = reached.unwrap_or((theta, evaluation));
        let cost = evaluation.cost();
        self.current = Some(evaluation);
        Ok((state.param(theta).cost(cost), None))
    }

    fn terminate(&mut self, _: &CalibrationState) -> TerminationStatus {
        match &self.outcome {
            Some(outcome) => TerminationStatus::Terminated(TerminationReason::SolverExit(outcome.status().to_owned())),
            None => TerminationStatus::NotTerminated,
        }
    }
}

fn taken_param(state: &mut CalibrationState) -> Result<DVector<f64>, Error> {
    state.take_param().ok_or_else(|| PersonalisationError::Optimiser("no start coordinates".to_owned()).into())
}

fn own_problem<'p, 'a, M: TangentModel>(
    problem: &Problem<&'p CalibrationProblem<'a, M>>,
) -> Result<&'p CalibrationProblem<'a, M>, PersonalisationError> {
    problem.problem.ok_or_else(|| PersonalisationError::Optimiser("no problem".to_owned()))
}

#[cfg(test)]
mod tests;
