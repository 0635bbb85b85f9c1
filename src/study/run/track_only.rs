//! `kind = "track"`: the proactive heart with fixed parameters follows the images.

use std::time::Instant;

use serde::Serialize;

use super::discrepancy::write_discrepancy;
use super::error::RunError;
use super::forward::heart_model;
use super::leave::{BeatSummary, Summary, frame_rows, write_base_motion, write_beat};
use super::montages::{ImageScene, NamedMotion, montages};
use super::page::{Account, Colouring, Frames, beat_section, key_figures, leave_page, motion_section, tracking_section, wall_section};
use super::patient::{Patient, PatientImages};
use super::personal_summary::{TrackingSummary, ValidationSummary, tracking_summary, validation_summary};
use super::pictures;
use super::track::{Tracked, track_patient};
use crate::mesh::MeshQuality;
use crate::report::figures::{Curve, Look};
use crate::report::write_json;
use crate::study::{Outcome, Plan, RunContext, Status};
use crate::units::MS_PER_S;

#[derive(Serialize)]
struct Details {
    tracking: TrackingSummary,
    validation: Vec<ValidationSummary>,
}

/// Tracks the plan's images and leaves the motion.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let patient = Patient::new(plan, context)?;
    let Some(images) = &patient.images else { return Err(RunError::NothingToFit) };
    let tracked = track_patient(plan, &patient, images, patient.parameters.clone(), context)?;
    if tracked.motion.trajectory.stopped && tracked.motion.trajectory.frames.len() < 2 {
        return Err(RunError::Stopped);
    }
    context.progress().stage("writing results", None);
    let outcome = leave(plan, &patient, images, &tracked, started)?;
    context.progress().finish();
    Ok(outcome)
}

/// Writes the files of a tracked beat into the plan's folder.
pub(super) fn leave(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    tracked: &Tracked,
    started: Instant,
) -> Result<Outcome, RunError> {
    let clock = patient.clock(1);
    let trajectory = &tracked.motion.trajectory;
    let model = heart_model(&plan.model, &patient.anatomy, tracked.parameters.clone())?;
    let truth_ml: &[f64] = patient.truth.as_ref().map_or(&[], |truth| &truth.volumes_lv_ml);
    write_beat(plan, &model, trajectory, &clock, &frame_rows(&clock, trajectory, Some(tracked), &[], truth_ml))?;
    write_discrepancy(&plan.output.directory, &patient.anatomy, &tracked.motion)?;
    write_base_motion(&plan.output.directory, &clock, &model, trajectory)?;
    let motions = [NamedMotion { name: "tracked", frames: &trajectory.frames }];
    let shown = ImageScene { plan, patient, images, clock: &clock, motions: &motions };
    if plan.output.figures {
        pictures::beat(plan, &clock, trajectory, &[])?;
        montages(&shown)?;
    }
    let details = Details { tracking: tracking_summary(tracked), validation: validation_summary(patient, images, tracked) };
    let headlines = ValidationSummary::headlines(&details.validation);
    let mut warnings: Vec<String> = patient.warnings.iter().chain(&tracked.motion.warnings).cloned().collect();
    let status = if trajectory.stopped { Status::Stopped } else { Status::Converged };
    if trajectory.stopped {
        let reached_s = trajectory.curves.last().map_or(clock.start_s, |row| row.time_s);
        warnings.push(format!(
            "stopped after {:.0} of {:.0} ms of the beat: all figures are of that part alone; the same command begins again",
            MS_PER_S * (reached_s - clock.start_s),
            MS_PER_S * clock.period_s
        ));
    }
    let summary = Summary {
        kind: plan.kind,
        status,
        beat: BeatSummary::new(&model, trajectory, &clock),
        details,
        mesh: MeshQuality::of(&patient.anatomy.mesh),
        warnings: &warnings,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&plan.output.directory.join("summary.json"), &summary)?;
    let frames = Frames::of(&clock, &trajectory.frames);
    let colouring = Colouring { anatomy: &patient.anatomy, frames: &trajectory.frames, model: Some((&model, trajectory)) };
    let truth = Curve::new("truth", Look::Truth, &clock.times_s, truth_ml);
    let further = if truth_ml.is_empty() { Vec::new() } else { vec![truth] };
    let sections = vec![
        beat_section(&clock, trajectory, [&further, &[]]),
        motion_section(&clock, &frames, Some(&shown), &colouring)?,
        tracking_section(&patient.anatomy, &clock, tracked, &summary.details.tracking, &summary.details.validation),
        wall_section(&model, &clock, trajectory),
    ];
    let account = Account {
        status,
        headlines: &headlines,
        warnings: summary.warnings,
        // An ejection fraction of a part of a beat would be taken for one.
        key_figures: if trajectory.stopped { Vec::new() } else { key_figures(&summary.beat, None) },
        record: &summary,
    };
    leave_page(plan, account, sections, frames.times_s)?;
    Ok(Outcome { status, directory: plan.output.directory.clone(), headlines })
}
