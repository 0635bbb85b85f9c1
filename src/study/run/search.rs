//! One search for the parameters: the problem put together, solved by the solver of the study, and asked how sure its answer is.

use nalgebra::DVector;
use serde::Serialize;

use super::clock::Clock;
use super::error::RunError;
use super::heart_tangents::HeartTangents;
use super::journal::JournalFile;
use crate::heart::HeartModel;
use crate::personalisation::{
    Calibration, CalibrationProblem, CalibrationTrajectory, DataSensitivity, Evidence, GaussNewtonSettings, IterationRecord, Journal,
    LinearConstraint, NoiseScale, ParameterSpace, RepolarisedBeforeNextBeat, SearchMethod, SearchSettings, StackedResidual, TangentModel,
    Uncertainty, crossing_95, data_sensitivities, profile, search,
};
use crate::study::plan::{Intervals, PersonalisationPlan, Plan, Ties};
use crate::study::{Provenance, RunContext};

/// Where a profile holds its parameter, in standard deviations of the linearised posterior.
const PROFILE_STEPS: [f64; 5] = [0.5, 1.0, 1.5, 2.0, 3.0];
/// Violation of a constraint that is reported.
const VIOLATED: f64 = 1e-4;

/// What a search looks at.
pub(super) struct Task<'a> {
    pub(super) wanted: &'a PersonalisationPlan,
    pub(super) base: &'a HeartModel,
    pub(super) space: &'a ParameterSpace,
    pub(super) clock: &'a Clock,
    pub(super) residual: &'a StackedResidual<'a, CalibrationTrajectory>,
}

/// What a search found, and how sure that is.
pub(super) struct Found {
    pub(super) calibration: Calibration,
    pub(super) uncertainty: Option<Uncertainty>,
    pub(super) sensitivities: Vec<DataSensitivity>,
    pub(super) profiles: Vec<ProfileRow>,
    pub(super) profile_intervals: Vec<ProfileInterval>,
    /// Root mean square of the rows of every part of the data.
    pub(super) rms_by_part: Vec<(&'static str, f64)>,
    /// Bounds and constraints that hold the answer, in words.
    pub(super) active: Vec<String>,
    /// Constraints that the answer violates: they contradict each other or the bounds.
    pub(super) violated: Vec<String>,
    /// The strengths of data and ties that the data tell, where the study asks for them.
    pub(super) evidence: Option<Evidence>,
    /// What a pass with tangents took by the clock, in simulations.
    pub(super) clocked_pass_cost: Option<f64>,
}

/// A row of `profiles.csv`.
#[derive(Debug, Clone, Serialize)]
pub(super) struct ProfileRow {
    parameter: String,
    value: f64,
    /// Rise of the best cost over its minimum; 1.92 marks the end of a 95 % interval.
    cost_rise: f64,
    status: &'static str,
}

/// The interval that a profile marks; an end that it does not reach is empty.
#[derive(Debug, Clone, Serialize)]
pub(super) struct ProfileInterval {
    parameter: String,
    low: Option<f64>,
    high: Option<f64>,
}

/// Searches from `start`; what an earlier run computed comes from the journal.
pub(super) fn find(
    task: &Task,
    method: SearchMethod,
    start: &DVector<f64>,
    journal: Option<&JournalFile>,
    context: &RunContext,
) -> Result<Found, RunError> {
    let Task { wanted, base, space, clock, residual } = *task;
    let is_stopped = || context.is_stopped();
    let model = HeartTangents::new(base, space, clock, wanted.tangents, &is_stopped);
    let sink = |entry: &_| journal.into_iter().for_each(|journal| journal.append(entry));
    let entries = journal.map_or(&[][..], JournalFile::entries);
    let problem = CalibrationProblem::new(&model, residual, space)?
        .with_stop_flag(context.stop())
        .with_journal(Journal::new(entries.iter().cloned(), &sink));
    let mut problem = constrained(problem, task)?;
    let limits = GaussNewtonSettings {
        max_iterations: wanted.max_iterations as u64,
        step_tolerance: wanted.tolerance,
        ..GaussNewtonSettings::default()
    };
    let settings = SearchSettings { method, limits, most_simulations: wanted.max_simulations as f64, seed: wanted.seed };
    context.progress().stage("finding the parameters", Some(wanted.max_iterations as u64));
    let mut calibration = search(&problem, start, settings, &mut |record| context.progress().step(record.iteration))?;
    let mut evidence = None;
    for _ in 0..evidence_rounds(task) {
        let Some(at) = calibration.linearisation.as_ref().filter(|_| !context.is_stopped()) else { break };
        let told = evidence.unwrap_or(Evidence::STATED).improved(at, space)?;
        evidence = Some(told);
        problem = constrained(problem.with_prior_of(&told.applied_to(space))?, task)?;
        context.progress().stage("finding the parameters under the evidence of their ties", Some(wanted.max_iterations as u64));
        let further = search(&problem, &calibration.coordinates, settings, &mut |record| context.progress().step(record.iteration))?;
        calibration = calibration.followed_by(further);
    }
    let (mut uncertainty, mut sensitivities) = (None, Vec::new());
    if let Some(at) = &calibration.linearisation {
        let noise = evidence.map_or(noise_scale(at.rows.len(), task), |told: Evidence| NoiseScale::OfObjective(told.noise_scale));
        uncertainty = Some(Uncertainty::new(&problem, at, noise)?);
        sensitivities = data_sensitivities(residual, at, &problem.scales(), &space.names())?;
    }
    let (profiles, profile_intervals) = profiles(task, &problem, &calibration, uncertainty.as_ref(), limits, context)?;
    let names = space.names();
    let labels: Vec<String> = problem.constraints().map(|constraint| constraint.label().to_owned()).collect();
    let broken = problem.constraints().filter(|constraint| constraint.value(&calibration.coordinates) > VIOLATED);
    let violated = broken.map(|constraint| constraint.label().to_owned()).collect();
    let rms_by_part = residual.rms_by_part(&calibration.evaluation.rows)?;
    let active = active(&calibration, space, &names, &labels);
    let clocked_pass_cost = model.clocked_pass_cost();
    Ok(Found {
        evidence,
        clocked_pass_cost,
        uncertainty,
        sensitivities,
        profiles,
        profile_intervals,
        rms_by_part,
        active,
        violated,
        calibration,
    })
}

/// How often ties and noise are told anew by their evidence, and the parameters found again with them.
fn evidence_rounds(task: &Task) -> usize {
    const ROUNDS: usize = 3;
    if task.wanted.ties == Ties::Evidence && !task.space.ties().is_empty() { ROUNDS } else { 0 }
}

/// The journal of a search, in the folder of the results.
pub(super) fn journal_of(plan: &Plan, name: &str, provenance: &Provenance) -> Result<JournalFile, RunError> {
    JournalFile::open(plan.output.directory.join(format!("{name}.journal")), provenance)
}

/// The noise is told by the residuals where they are more than the parameters.
fn noise_scale(row_count: usize, task: &Task) -> NoiseScale {
    match task.wanted.intervals {
        _ if row_count <= task.space.dimension() => NoiseScale::AsStated,
        Intervals::Clusters => NoiseScale::FromClusters,
        Intervals::Residuals => NoiseScale::FromResiduals,
    }
}

/// The problem with the orders and the repolarisation that the study asks for.
fn constrained<'a, M: TangentModel>(mut problem: CalibrationProblem<'a, M>, task: &Task) -> Result<CalibrationProblem<'a, M>, RunError> {
    for order in &task.wanted.orders {
        problem = problem.with_constraint(LinearConstraint::ordered(task.space, order.smaller, order.larger)?);
    }
    if let Some(margin_s) = task.wanted.repolarised_margin_s {
        let (first_s, last_s) = task.base.activation().span_s();
        let parameters = task.base.parameters();
        problem = problem.with_constraint(RepolarisedBeforeNextBeat::new(task.space.clone(), parameters, last_s - first_s, margin_s));
    }
    Ok(problem)
}

/// What holds the answer, in words.
fn active(calibration: &Calibration, space: &ParameterSpace, names: &[String], labels: &[String]) -> Vec<String> {
    let scale = |index: usize| 1e-6 * (space.upper()[index] - space.lower()[index]);
    let at = |bound: &DVector<f64>, index: usize| (calibration.coordinates[index] - bound[index]).abs() <= scale(index);
    let mut words = Vec::new();
    for (index, name) in names.iter().enumerate() {
        for (side, bound) in [("lower", space.lower()), ("upper", space.upper())] {
            if at(&bound, index) {
                words.push(format!("{name} is on its {side} bound"));
            }
        }
    }
    let last: Option<&IterationRecord> = calibration.records.iter().rfind(|record| record.cost.is_finite());
    let held = last.into_iter().flat_map(|record| record.active_constraints.iter().filter_map(|&index| labels.get(index)));
    words.extend(held.map(|label| format!("{label} holds with equality")));
    words
}

/// The profiles that the study asks for, outward on either side, while the search is not stopped.
fn profiles<M: TangentModel>(
    task: &Task,
    problem: &CalibrationProblem<'_, M>,
    calibration: &Calibration,
    uncertainty: Option<&Uncertainty>,
    limits: GaussNewtonSettings,
    context: &RunContext,
) -> Result<(Vec<ProfileRow>, Vec<ProfileInterval>), RunError> {
    let (mut rows, mut intervals) = (Vec::new(), Vec::new());
    let (Some(uncertainty), false) = (uncertainty, context.is_stopped()) else { return Ok((rows, intervals)) };
    let best_cost = calibration.evaluation.cost();
    for (index, entry) in task.space.free().enumerate() {
        let is_wanted = task.wanted.profile.contains(&entry.parameter.parameter());
        let Some(sd) = uncertainty.sd[index].filter(|sd| is_wanted && sd.is_finite()) else { continue };
        context.progress().stage(&format!("profile of {}", entry.parameter.name()), None);
        let best = calibration.coordinates[index];
        let mut end = |sign: f64| -> Result<Option<f64>, RunError> {
            let held: Vec<f64> = PROFILE_STEPS.iter().map(|step| best + sign * step * sd).collect();
            let points = profile(problem, &calibration.coordinates, index, &held, limits)?;
            // The noise of the data is that which their residuals tell.
            let scale = uncertainty.noise_scale.powi(2);
            rows.extend(points.iter().map(|point| ProfileRow {
                parameter: entry.parameter.name(),
                value: entry.transform.to_value(point.coordinate),
                cost_rise: (point.cost - best_cost) / scale,
                status: point.outcome.status(),
            }));
            let scaled = points.into_iter().map(|mut point| {
                point.cost = (point.cost - best_cost) / scale;
                point
            });
            let scaled: Vec<_> = scaled.collect();
            Ok(crossing_95(best, 0.0, &scaled).map(|coordinate| entry.transform.to_value(coordinate)))
        };
        let (low, high) = (end(-1.0)?, end(1.0)?);
        intervals.push(ProfileInterval { parameter: entry.parameter.name(), low, high });
    }
    Ok((rows, intervals))
}
