//! `kind = "simulate"`: the free heart.

use std::ops::ControlFlow;
use std::time::Instant;

use serde::Serialize;

use super::clock::Clock;
use super::each_beat::{beat_rows, write_each_beat};
use super::error::RunError;
use super::forward::{beat, blocked_stimuli, heart_model, observables, step_count};
use super::leave::{BeatSummary, Summary, frame_rows, write_beat};
use super::page::{
    Account, Colouring, Frames, beat_section, key_figures, leave_page, motion_section, prediction_section, table_section, wall_section,
};
use super::patient::Patient;
use super::pictures;
use super::prediction::{Predictions, missing_predictions, predict};
use super::recorded_base::with_recorded_base;
use crate::heart::{HeartModel, Periodicity, Trajectory, simulate_until_periodic};
use crate::mesh::MeshQuality;
use crate::report::write_json;
use crate::study::plan::Beats;
use crate::study::{Outcome, Plan, RunContext, Status};

#[derive(Serialize)]
struct Details {
    /// Beats simulated; the figures are of the last one.
    beat_count: usize,
    /// Largest difference of a cavity volume between the last two beats; known where beats go on until they repeat.
    periodic_change_ml: Option<f64>,
}

/// A simulation with the clock of its last beat.
struct Beaten {
    trajectory: Trajectory,
    clock: Clock,
    status: Status,
    details: Details,
}

/// Beats the plan's heart and leaves its files.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let mut patient = Patient::new(plan, context)?;
    context.progress().stage("activating and assembling", None);
    let model = with_recorded_base(plan, heart_model(&plan.model, &patient.anatomy, patient.parameters.clone())?)?;
    for text in blocked_stimuli(&model) {
        context.progress().warning(&text);
        patient.warnings.push(text);
    }
    let Beaten { trajectory, clock, mut status, details } = match plan.simulation.beats {
        Beats::Count(count) => count_beats(&model, patient.clock(count), count, context)?,
        Beats::Periodic(periodicity) => beat_until_periodic(&model, &patient, periodicity, context)?,
    };
    if status == Status::IterationLimit {
        let change_ml = details.periodic_change_ml.unwrap_or(f64::INFINITY);
        let text = format!("after {} beats the volumes still change by {change_ml:.3} mL a beat", details.beat_count);
        context.progress().warning(&text);
        patient.warnings.push(text);
    }
    let predictions = if status == Status::Stopped { None } else { predict(plan, &patient, &patient.parameters, context)? };
    if let Some(text) = missing_predictions(plan, predictions.as_ref()) {
        status = Status::Stopped;
        patient.warnings.push(text);
    }

    context.progress().stage("writing results", None);
    write_beat(plan, &model, &trajectory, &clock, &frame_rows(&clock, &trajectory, None, &[], &[]))?;
    write_each_beat(&plan.output.directory, &model, &trajectory)?;
    if plan.output.figures {
        pictures::beat(plan, &clock, &trajectory, &[])?;
        if !model.rhythm().is_regular() {
            pictures::all_beats(plan, &trajectory)?;
        }
        pictures::wall(plan, &model, &clock, &trajectory)?;
    }
    let summary = Summary {
        kind: plan.kind,
        status,
        beat: BeatSummary::new(&model, &trajectory, &clock),
        details,
        mesh: MeshQuality::of(&model.anatomy().mesh),
        warnings: &patient.warnings,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&plan.output.directory.join("summary.json"), &summary)?;
    let mut headlines = headlines(&trajectory, &clock);
    if let Some(predictions) = &predictions {
        predictions.leave(plan)?;
        headlines.extend(predictions.headlines());
    }
    let account = Account {
        status,
        headlines: &headlines,
        warnings: &patient.warnings,
        key_figures: key_figures(&summary.beat, None),
        record: &summary,
    };
    leave_report(plan, &Beating { model: &model, clock: &clock, trajectory: &trajectory }, predictions.as_ref(), account)?;
    context.progress().finish();
    Ok(Outcome { status, directory: plan.output.directory.clone(), headlines })
}

/// A heart as it beats.
struct Beating<'a> {
    model: &'a HeartModel,
    clock: &'a Clock,
    trajectory: &'a Trajectory,
}

fn leave_report(
    plan: &Plan,
    &Beating { model, clock, trajectory }: &Beating,
    predictions: Option<&Predictions>,
    account: Account<Summary<Details>>,
) -> Result<(), RunError> {
    let frames = Frames::of(clock, &trajectory.frames);
    let colouring = Colouring { anatomy: model.anatomy(), frames: &trajectory.frames, model: Some((model, trajectory)) };
    let rows = beat_rows(model, trajectory);
    let beats = if rows.len() > 1 { rows } else { Vec::new() };
    let sections = vec![
        beat_section(clock, trajectory, [&[], &[]]),
        motion_section(clock, &frames, None, &colouring)?,
        wall_section(model, clock, trajectory),
        prediction_section(predictions),
        table_section("Beat by beat", "Every beat, own and extra ones", &beats),
    ];
    leave_page(plan, account, sections, frames.times_s)
}

fn count_beats(model: &HeartModel, clock: Clock, beat_count: usize, context: &RunContext) -> Result<Beaten, RunError> {
    context.progress().stage("beating", Some(step_count(&clock, model.settings().step_s)));
    let trajectory = beat(model, &clock, &[], context)?;
    let status = if trajectory.stopped { Status::Stopped } else { Status::Converged };
    Ok(Beaten { trajectory, clock, status, details: Details { beat_count, periodic_change_ml: None } })
}

fn beat_until_periodic(model: &HeartModel, patient: &Patient, periodicity: Periodicity, context: &RunContext) -> Result<Beaten, RunError> {
    context.progress().stage("beating until beats repeat", None);
    let first = patient.clock(1);
    let frame_times_s: Vec<f64> = first.times_s.iter().map(|time_s| time_s - first.start_s).collect();
    let mut done = 0;
    let mut observer = |_: &_, _: &_| {
        context.progress().step(done);
        done += 1;
        if context.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let outcome = simulate_until_periodic(model, first.start_s, &frame_times_s, periodicity, &[], &mut observer)?;
    let status = match (outcome.last_beat.stopped, outcome.is_periodic) {
        (true, _) => Status::Stopped,
        (false, true) => Status::Converged,
        (false, false) => Status::IterationLimit,
    };
    let details =
        Details { beat_count: outcome.beat_count, periodic_change_ml: Some(outcome.change_ml).filter(|change| change.is_finite()) };
    let trajectory = Trajectory { curves: outcome.curves, ..outcome.last_beat };
    Ok(Beaten { trajectory, clock: patient.clock(outcome.beat_count), status, details })
}

fn headlines(trajectory: &Trajectory, clock: &Clock) -> Vec<String> {
    let headline = |(ventricle, o): (crate::anatomy::Ventricle, crate::heart::BeatObservables)| {
        format!(
            "{ventricle:?} ventricle: EDV {:.1} mL, ESV {:.1} mL, EF {:.1} %, peak {:.0} mmHg",
            o.end_diastolic_volume_ml,
            o.end_systolic_volume_ml,
            100.0 * o.ejection_fraction,
            o.pressure_peak_mmhg
        )
    };
    observables(trajectory, clock).into_iter().map(headline).collect()
}
