//! What a calibration leaves: outcome, record of its steps, best point and the linearisation there.

use nalgebra::DVector;

use crate::personalisation::problem::{Evaluation, Linearisation};

/// Which test ended a search that converged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ConvergenceTest {
    /// The projected gradient vanishes.
    Gradient,
    /// The next step is negligible.
    Step,
    /// The next decrease is negligible.
    Cost,
}

/// How a search ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CalibrationOutcome {
    /// At a minimum inside all bounds.
    Converged(ConvergenceTest),
    /// At a minimum that bounds or constraints hold.
    OnBound(ConvergenceTest),
    /// Not there yet.
    MaxIterations,
    /// Steps no longer decrease the cost, as when tangents are less accurate than the tolerances ask.
    Stalled,
    /// Stopped on request.
    Stopped,
    /// Tangents could not be had at a point already reached.
    Failed(String),
}

impl CalibrationOutcome {
    /// One word for `summary.json`.
    pub fn status(&self) -> &'static str {
        match self {
            Self::Converged(_) => "converged",
            Self::OnBound(_) => "on_bound",
            Self::MaxIterations => "max_iterations",
            Self::Stalled => "stalled",
            Self::Stopped => "stopped",
            Self::Failed(_) => "failed",
        }
    }
}

/// What became of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordStatus {
    /// The point the search began with.
    Start,
    /// A step that was taken.
    Accepted,
    /// A step whose simulation failed; a shorter one was tried next.
    Failed,
}

impl RecordStatus {
    /// The word of `iterations.csv`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Accepted => "accepted",
            Self::Failed => "failed",
        }
    }
}

/// The start, an accepted step, or one that failed.
#[derive(Debug, Clone, PartialEq)]
pub struct IterationRecord {
    /// 0 at the start.
    pub iteration: u64,
    /// What became of it.
    pub status: RecordStatus,
    /// Objective after the step; infinite where it failed.
    pub cost: f64,
    /// Its data part.
    pub data_cost: f64,
    /// Its prior part.
    pub prior_cost: f64,
    /// ‖z‖ of the step, in scales.
    pub step_norm: f64,
    /// Trust radius Δ that the step obeyed.
    pub trust_radius: f64,
    /// Actual over predicted decrease.
    pub gain_ratio: f64,
    /// Simulations tried for this step (failed ones too), without tangents.
    pub trials: u64,
    /// Simulations spent so far, tangents included at their cost.
    pub spent: f64,
    /// Coordinates at their lower bound.
    pub active_lower: Vec<usize>,
    /// Coordinates at their upper bound.
    pub active_upper: Vec<usize>,
    /// Constraints that hold with equality.
    pub active_constraints: Vec<usize>,
    /// θ after the step.
    pub coordinates: DVector<f64>,
}

impl IterationRecord {
    pub(in crate::personalisation) fn at_start(coordinates: &DVector<f64>, evaluation: &Evaluation, trust_radius: f64, spent: f64) -> Self {
        Self {
            iteration: 0,
            status: RecordStatus::Start,
            cost: evaluation.cost(),
            data_cost: evaluation.data_cost,
            prior_cost: evaluation.prior_cost,
            step_norm: 0.0,
            trust_radius,
            gain_ratio: 1.0,
            trials: 1,
            spent,
            active_lower: Vec::new(),
            active_upper: Vec::new(),
            active_constraints: Vec::new(),
            coordinates: coordinates.clone(),
        }
    }
}

/// What a calibration found.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Best coordinates.
    pub coordinates: DVector<f64>,
    /// The objective there.
    pub evaluation: Evaluation,
    /// The last linearisation: at `coordinates` if converged, at the point before if interrupted; `None` if there was no time for any.
    pub linearisation: Option<Linearisation>,
    /// How it ended.
    pub outcome: CalibrationOutcome,
    /// Start and every accepted step.
    pub records: Vec<IterationRecord>,
    /// Evaluations of the objective (one simulation each), without tangents.
    pub evaluation_count: u64,
    /// Linearisations (p or 2p simulations each by finite differences).
    pub linearisation_count: u64,
    /// All of it in simulations.
    pub spent: f64,
}

impl Calibration {
    /// This search and the one that went on from where it ended, as one.
    #[must_use]
    pub fn followed_by(mut self, further: Self) -> Self {
        let (last, spent) = (self.records.last().map_or(0, |record| record.iteration), self.spent);
        let going_on = further.records.into_iter().skip(1);
        self.records.extend(going_on.map(|record| IterationRecord {
            iteration: record.iteration + last,
            spent: record.spent.max(spent),
            ..record
        }));
        Self {
            records: self.records,
            evaluation_count: self.evaluation_count + further.evaluation_count,
            linearisation_count: self.linearisation_count + further.linearisation_count,
            spent: further.spent.max(spent),
            ..further
        }
    }
}
