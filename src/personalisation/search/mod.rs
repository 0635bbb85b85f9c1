//! The same calibration by any of five solvers, each run by argmin: Gauss–Newton with quadratic programs, and four that know less of it.
//!
//! Nelder–Mead, L-BFGS and CMA-ES search without bounds in u, where $\theta = m + h \sin(a u)$ with the box's middle m and half width h:
//! no point is ever outside, and a minimum on a bound is an ordinary one. Particles are held in the box by argmin itself. L-BFGS takes the
//! gradient Jᵀw r of the same tangents. A simulation that fails counts as a very high cost.

mod chart;
mod cma_es;
mod objective;

use argmin::core::{Error, Executor, IterState, KV, PopulationState, Problem, Solver, State, TerminationReason, TerminationStatus};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::neldermead::NelderMead;
use argmin::solver::particleswarm::{Particle, ParticleSwarm};
use argmin::solver::quasinewton::LBFGS;
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use self::chart::Chart;
use self::cma_es::CmaEs;
use self::objective::Objective;
use super::{
    Calibration, CalibrationOutcome, CalibrationProblem, ConvergenceTest, GaussNewtonSettings, IterationRecord, PersonalisationError,
    TangentModel, calibrate,
};

/// Which solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SearchMethod {
    /// Gauss–Newton with a quadratic program a step.
    GaussNewton,
    /// Downhill simplex \[Nelder1965\].
    NelderMead,
    /// Quasi-Newton of limited memory.
    Lbfgs,
    /// Particle swarm.
    ParticleSwarm,
    /// Evolution with an adapted covariance \[Hansen2016\].
    CmaEs,
}

/// How to search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchSettings {
    /// The solver.
    pub method: SearchMethod,
    /// Iterations and tolerances; the trust region is Gauss–Newton's alone.
    pub limits: GaussNewtonSettings,
    /// The search ends with the iteration in which the problem has spent this many simulations, those of earlier searches included.
    pub most_simulations: f64,
    /// Seed of the solvers that draw.
    pub seed: u64,
}

/// First step of the solvers without derivatives, in the problem's scales.
const FIRST_STEP: f64 = 0.25;
/// Pairs that L-BFGS remembers.
const MEMORY: usize = 7;

/// A direct search has ended when the best cost falls by less than its tolerance over this many iterations and five for
/// every coordinate.
const PATIENCE: usize = 10;

/// Minimises `problem` from `start`, telling `observer` of the start and of every iteration. All but Gauss–Newton tell of the best point so far.
///
/// # Errors
/// [`PersonalisationError`] as [`calibrate`]; that a solver gives up is an outcome.
pub fn search<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    start: &DVector<f64>,
    settings: SearchSettings,
    observer: &mut dyn FnMut(&IterationRecord),
) -> Result<Calibration, PersonalisationError> {
    if settings.method == SearchMethod::GaussNewton {
        return calibrate(problem, start, settings.limits, observer);
    }
    if start.len() != problem.dimension() {
        return Err(PersonalisationError::Shape { what: "start coordinates", found: start.len(), expected: problem.dimension() });
    }
    let start = problem.clamp(start);
    let chart = match settings.method {
        SearchMethod::ParticleSwarm => Chart::identity(start.len()),
        _ => Chart::around(problem, &start),
    };
    let objective = Objective::new(problem, chart, &start)?;
    let mut records: Vec<IterationRecord> = Vec::new();
    let mut after = |iteration: u64| {
        let record = objective.record(iteration, records.last());
        observer(&record);
        records.push(record);
        verdict(&records, problem.spent(), &settings)
    };
    after(0);
    let ended = run_solver(&objective, problem, &settings, &mut after);
    conclude(problem, objective, &settings, records, ended)
}

/// Why a search that goes on should end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The best cost does not fall any more.
    Settled,
    /// Its simulations are used up.
    Spent,
}

fn verdict(records: &[IterationRecord], spent: f64, settings: &SearchSettings) -> Option<End> {
    let best = records.last()?;
    let patience = PATIENCE + 5 * best.coordinates.len();
    let earlier = records.len().checked_sub(patience + 1).and_then(|place| records.get(place));
    if earlier.is_some_and(|earlier| earlier.cost - best.cost <= settings.limits.cost_tolerance * best.cost) {
        return Some(End::Settled);
    }
    (spent >= settings.most_simulations).then_some(End::Spent)
}

/// Called after every iteration; ends the search by an answer.
type AfterIteration<'w> = &'w mut dyn FnMut(u64) -> Option<End>;
/// argmin's state of a solver with gradient G.
type PointState<G> = IterState<DVector<f64>, G, (), (), (), f64>;
/// argmin's state of a swarm.
type SwarmState = PopulationState<Particle<DVector<f64>, f64>, f64>;

fn run_solver<M: TangentModel>(
    objective: &Objective<'_, '_, M>,
    problem: &CalibrationProblem<'_, M>,
    settings: &SearchSettings,
    after: AfterIteration<'_>,
) -> Result<TerminationStatus, Error> {
    let (limits, dimension) = (settings.limits, problem.dimension());
    let origin = objective.origin();
    let most = limits.max_iterations;
    match settings.method {
        SearchMethod::NelderMead => {
            let edge = |index: usize| &origin + DVector::from_fn(dimension, |row, _| if row == index { FIRST_STEP } else { 0.0 });
            let simplex = std::iter::once(origin.clone()).chain((0..dimension).map(edge)).collect();
            let solver = NelderMead::new(simplex).with_sd_tolerance(limits.cost_tolerance)?;
            run(objective, solver, after, |state: PointState<()>| state.max_iters(most))
        }
        SearchMethod::Lbfgs => {
            let solver = LBFGS::new(MoreThuenteLineSearch::new(), MEMORY).with_tolerance_grad(limits.gradient_tolerance)?;
            run(objective, solver, after, |state: PointState<DVector<f64>>| state.param(origin).max_iters(most))
        }
        SearchMethod::ParticleSwarm => {
            let count = 10 + 2 * (dimension as f64).sqrt() as usize;
            let solver = ParticleSwarm::new((problem.lower().clone(), problem.upper().clone()), count)
                .with_rng_generator(ChaCha8Rng::seed_from_u64(settings.seed));
            run(objective, solver, after, |state: SwarmState| state.max_iters(most))
        }
        SearchMethod::CmaEs | SearchMethod::GaussNewton => {
            let solver = CmaEs::new(origin, FIRST_STEP, limits.step_tolerance, settings.seed);
            run(objective, solver, after, |state: PointState<()>| state.max_iters(most))
        }
    }
}

fn run<O, S, I>(objective: O, solver: S, after: AfterIteration<'_>, configure: impl FnOnce(I) -> I) -> Result<TerminationStatus, Error>
where
    I: State<Float = f64>,
    S: Solver<O, I>,
{
    let watched = Watched { inner: solver, after, end: None };
    let result = Executor::new(objective, watched).configure(configure).timer(false).run()?;
    Ok(result.state.get_termination_status().clone())
}

/// A solver that is listened to, and ended from outside. (argmin's own observers must not borrow.)
struct Watched<'w, S> {
    inner: S,
    after: AfterIteration<'w>,
    end: Option<End>,
}

impl<O, I: State, S: Solver<O, I>> Solver<O, I> for Watched<'_, S> {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn init(&mut self, problem: &mut Problem<O>, state: I) -> Result<(I, Option<KV>), Error> {
        self.inner.init(problem, state)
    }

    fn next_iter(&mut self, problem: &mut Problem<O>, state: I) -> Result<(I, Option<KV>), Error> {
        let iteration = state.get_iter() + 1;
        let next = self.inner.next_iter(problem, state)?;
        self.end = (self.after)(iteration);
        Ok(next)
    }

    fn terminate(&mut self, state: &I) -> TerminationStatus {
        match self.end {
            Some(End::Settled) => TerminationStatus::Terminated(TerminationReason::SolverConverged),
            Some(End::Spent) => TerminationStatus::Terminated(TerminationReason::MaxItersReached),
            None => self.inner.terminate(state),
        }
    }
}

/// The best point of a search, with its linearisation for whoever asks how sure it is.
fn conclude<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    objective: Objective<'_, '_, M>,
    settings: &SearchSettings,
    records: Vec<IterationRecord>,
    ended: Result<TerminationStatus, Error>,
) -> Result<Calibration, PersonalisationError> {
    let (evaluation_count, linearisation_count) = objective.counts();
    let (coordinates, evaluation) = objective.into_best();
    let spent = problem.spent();
    let converged = || {
        let touches = |index: usize| {
            let near = 1e-6 * problem.scales()[index];
            coordinates[index] - problem.lower()[index] <= near || problem.upper()[index] - coordinates[index] <= near
        };
        let test = if settings.method == SearchMethod::CmaEs { ConvergenceTest::Step } else { ConvergenceTest::Cost };
        let is_held = (0..coordinates.len()).any(touches);
        if is_held { CalibrationOutcome::OnBound(test) } else { CalibrationOutcome::Converged(test) }
    };
    let outcome = match ended {
        _ if problem.is_stopped() => CalibrationOutcome::Stopped,
        Ok(TerminationStatus::Terminated(TerminationReason::MaxItersReached)) => CalibrationOutcome::MaxIterations,
        Ok(_) => converged(),
        Err(error) => match error.downcast::<PersonalisationError>() {
            Ok(own) => return Err(own),
            // A line search that finds no descent any more, for one.
            Err(_) => CalibrationOutcome::Stalled,
        },
    };
    let linearisation = if problem.is_stopped() { None } else { problem.linearise(&coordinates, &evaluation).ok() };
    Ok(Calibration { coordinates, evaluation, linearisation, outcome, records, evaluation_count, linearisation_count, spent })
}

#[cfg(test)]
mod tests;
