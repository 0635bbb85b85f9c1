//! `kind = "track"`: the proactive heart with fixed parameters follows the images.

use std::time::Instant;

use serde::Serialize;

use super::discrepancy::write_discrepancy;
use super::error::RunError;
use super::forward::heart_model;
use super::leave::{BeatSummary, Summary, frame_rows, write_base_motion, write_beat};
use super::montages::{NamedMotion, montages};
use super::patient::{Patient, PatientImages};
use super::personalise::{TrackingSummary, ValidationSummary, tracking_summary, validation_summary};
use super::pictures;
use super::track::{Tracked, track_patient};
use crate::mesh::MeshQuality;
use crate::report::write_json;
use crate::study::{Outcome, Plan, RunContext, Status};

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
    if plan.output.figures {
        pictures::beat(plan, &clock, trajectory, &[])?;
        let motions = [NamedMotion { name: "tracked", frames: &trajectory.frames }];
        montages(plan, patient, images, &clock, &motions)?;
    }
    let details = Details { tracking: tracking_summary(tracked), validation: validation_summary(patient, images, tracked) };
    let headlines = details.validation.iter().map(ValidationSummary::headline).collect();
    let status = Status::Converged;
    let summary = Summary {
        kind: plan.kind,
        status,
        beat: BeatSummary::new(&model, trajectory, &clock),
        details,
        mesh: MeshQuality::of(&patient.anatomy.mesh),
        warnings: &patient.warnings.iter().chain(&tracked.motion.warnings).cloned().collect::<Vec<_>>(),
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&plan.output.directory.join("summary.json"), &summary)?;
    Ok(Outcome { status, directory: plan.output.directory.clone(), headlines })
}
