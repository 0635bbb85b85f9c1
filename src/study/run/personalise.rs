//! `kind = "personalise"`: track the images, take the volume curve and the boundaries, find the parameters of the free heart, rescore it
//! without image forces, say how sure that is.

use std::cell::Cell;
use std::time::Instant;

use nalgebra::DVector;
use serde::Serialize;

use super::calibration::residual;
use super::discrepancy::work_magnitude_mj;
use super::error::RunError;
use super::forward::{beat, frame_volumes_lv_ml, step_count};
use super::measured::{MeasuredVolumes, measured_volumes};
use super::personal_leave::leave;
use super::prediction::{Predictions, predict};
use super::recovery::difference_rms;
use super::replica::{BiasRow, TrackingBias, replica_seed, track_replica};
use super::scene::{Beginning, Scene, tracked_at_rest};
use super::search::{Found, Task, find, journal_of};
use super::start::StageRow;
use super::track::{Tracked, held_out_rms_mm, track_again};
use crate::heart::{HeartModel, Trajectory};
use crate::personalisation::{CalibrationOutcome, ParameterSpace};
use crate::study::{Outcome, Plan, RunContext, Status};

/// What a calibration started from and came to.
pub(super) struct Personalised {
    pub(super) space: ParameterSpace,
    pub(super) found: Found,
    pub(super) stages: Vec<StageRow>,
    /// Simulations of all searches: start values, rounds and replicas.
    pub(super) simulations: f64,
    pub(super) rounds: Vec<RoundRow>,
    pub(super) model: HeartModel,
    pub(super) fitted: Trajectory,
    pub(super) initial: Trajectory,
    pub(super) measured: MeasuredVolumes,
    /// What tracking makes of the fitted heart's own images.
    pub(super) bias: Vec<BiasRow>,
    /// The images tracked once more with the heart that was found, at the gains of the first time.
    pub(super) retracked: Option<Tracked>,
    pub(super) predictions: Option<Predictions>,
}

/// A row of `rounds.csv`: images tracked, parameters found.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the columns of the file, units last")]
pub(super) struct RoundRow {
    round: usize,
    gain_factor: f64,
    image_work_mj: f64,
    boundary_rms_held_out_mm: f64,
    volume_tracked_rms_ml: f64,
    cost: f64,
    simulations: f64,
    status: &'static str,
}

/// Runs the whole thread and leaves its files.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let Some(wanted) = &plan.personalisation else { return Err(RunError::NothingToFit) };
    let (patient, tracked) = tracked_at_rest(plan, wanted, context)?;
    let clock = patient.clock(plan.simulation.beats.count());
    let scene = Scene::new(plan, wanted, &patient, &clock)?;
    let personalised = personalise(&scene, &tracked, context)?;
    context.progress().stage("writing results", None);
    let outcome = leave(&scene, &tracked, &personalised, started)?;
    context.progress().finish();
    Ok(outcome)
}

fn personalise(scene: &Scene, tracked: &Tracked, context: &RunContext) -> Result<Personalised, RunError> {
    let &Scene { plan, wanted, patient, clock, .. } = scene;
    let Beginning { base, space, mut stages, simulations, .. } = scene.begin(tracked, context)?;
    let search = Search { scene, base: &base, space: &space, spent: Cell::new(simulations), context };
    let (mut rounds, mut answer, mut again) = (Vec::new(), None::<Answer>, None);
    for round in 1..=wanted.rounds {
        let gain_factor = wanted.gain_decay.powi(round as i32 - 1);
        let mut start = space.initial();
        if let Some(earlier) = &answer {
            start = earlier.found.calibration.coordinates.clone();
            again = Some(track_again(plan, patient, scene.images, search.heart(&start)?.parameters(), tracked, gain_factor, context)?);
        }
        let tracked = again.as_ref().unwrap_or(tracked);
        let one = search.answer(&start, tracked, &TrackingBias::default(), &format!("round_{round}"))?;
        rounds.push(RoundRow::new(round, gain_factor, tracked, &one));
        answer = Some(one);
        if context.is_stopped() {
            break;
        }
    }
    let answer = answer.ok_or(RunError::NothingToFit)?;
    stages.extend(stage("all", &space, &answer.found));
    let (answer, bias) = search.without_bias(answer, again.as_ref().unwrap_or(tracked), &mut stages)?;
    context.progress().stage("rescoring without image forces", Some(step_count(clock, plan.model.step_s)));
    let model = search.heart(&answer.found.calibration.coordinates)?;
    let fitted = beat(&model, clock, &[], context)?;
    let initial = beat(&search.heart(&space.initial())?, clock, &[], context)?;
    let is_retracked = wanted.retrack && !context.is_stopped();
    let retracked =
        is_retracked.then(|| track_again(plan, patient, scene.images, model.parameters(), tracked, 1.0, context)).transpose()?;
    let predictions = if context.is_stopped() { None } else { predict(plan, patient, model.parameters(), context)? };
    let Answer { measured, found } = answer;
    let simulations = search.spent.get();
    Ok(Personalised { space, found, stages, simulations, rounds, model, fitted, initial, measured, bias, retracked, predictions })
}

/// What a search was fitted to, and what it found.
struct Answer {
    measured: MeasuredVolumes,
    found: Found,
}

/// One problem, whose data may change from search to search.
struct Search<'a> {
    scene: &'a Scene<'a>,
    base: &'a HeartModel,
    space: &'a ParameterSpace,
    /// Simulations spent so far.
    spent: Cell<f64>,
    context: &'a RunContext<'a>,
}

impl Search<'_> {
    fn heart(&self, coordinates: &DVector<f64>) -> Result<HeartModel, RunError> {
        Ok(self.base.with_parameters(self.space.to_parameters(coordinates)?)?)
    }

    /// Searches from `start` in what was tracked, less its bias; what an earlier run computed comes from the journal of that name.
    fn answer(&self, start: &DVector<f64>, tracked: &Tracked, bias: &TrackingBias, journal: &str) -> Result<Answer, RunError> {
        let &Self { scene: &Scene { plan, wanted, patient, clock, .. }, base, space, context, .. } = self;
        let measured = bias.taken_off(measured_volumes(plan, wanted, patient, clock, tracked)?);
        let residual = residual(&wanted.data, patient, clock, &measured, tracked, bias)?;
        let task = Task { wanted, base, space, clock, residual: &residual };
        let journal = journal_of(plan, journal, &plan.provenance)?;
        let found = find(&task, wanted.solver, start, Some(&journal), context)?;
        self.spent.set(self.spent.get() + found.calibration.spent);
        if !context.is_stopped() {
            journal.discard();
        }
        Ok(Answer { measured, found })
    }

    /// Searches again without what replicas show of the tracking's bias, as often as the study says.
    fn without_bias(&self, mut answer: Answer, tracked: &Tracked, stages: &mut Vec<StageRow>) -> Result<(Answer, Vec<BiasRow>), RunError> {
        let &Self { scene: &Scene { plan, wanted, patient, clock, .. }, space, context, .. } = self;
        let mut replicas = Vec::new();
        for number in (1..=wanted.bias_rounds).take_while(|_| !context.is_stopped()) {
            let model = self.heart(&answer.found.calibration.coordinates)?;
            let fitted = beat(&model, clock, &[], context)?;
            self.spent.set(self.spent.get() + 1.0);
            let replica = track_replica(plan, patient, clock, &fitted, tracked, replica_seed(wanted.seed, number), context)?;
            replicas.push(TrackingBias::new(patient, clock, &model, &fitted, &replica)?);
            let start = &answer.found.calibration.coordinates;
            answer = self.answer(start, tracked, &TrackingBias::mean(&replicas), &format!("replica_{number}"))?;
            stages.extend(stage("less_tracking_bias", space, &answer.found));
        }
        Ok((answer, TrackingBias::mean(&replicas).rows(replicas.len(), clock)))
    }
}

/// The rows of `stages.csv` for all parameters together.
fn stage(stage: &'static str, space: &ParameterSpace, found: &Found) -> Vec<StageRow> {
    let values = space.to_values(&found.calibration.coordinates);
    let row = |(parameter, value)| StageRow { stage, simulations: found.calibration.spent, parameter, value };
    space.names().into_iter().zip(values).map(row).collect()
}

impl RoundRow {
    fn new(round: usize, gain_factor: f64, tracked: &Tracked, answer: &Answer) -> Self {
        let Answer { measured, found } = answer;
        Self {
            round,
            gain_factor,
            image_work_mj: work_magnitude_mj(&tracked.motion),
            boundary_rms_held_out_mm: held_out_rms_mm(&tracked.motion),
            volume_tracked_rms_ml: difference_rms(&frame_volumes_lv_ml(&tracked.motion.trajectory), &measured.left_ml),
            cost: found.calibration.evaluation.cost(),
            simulations: found.calibration.spent,
            status: found.calibration.outcome.status(),
        }
    }
}

pub(super) fn status_of(outcome: &CalibrationOutcome) -> Status {
    match outcome {
        CalibrationOutcome::Converged(_) | CalibrationOutcome::Stalled => Status::Converged,
        CalibrationOutcome::OnBound(_) => Status::OnBound,
        CalibrationOutcome::MaxIterations => Status::IterationLimit,
        CalibrationOutcome::Stopped => Status::Stopped,
        CalibrationOutcome::Failed(_) => Status::Failed,
    }
}
