//! What a personalisation leaves: curves, tables, figures, meshes, the report.

use std::time::Instant;

use super::discrepancy::write_discrepancy;
use super::error::RunError;
use super::forward::frame_volumes_lv_ml;
use super::leave::{BeatSummary, FrameRow, Summary, frame_rows, write_base_motion, write_beat, write_series};
use super::montages::{ImageScene, NamedMotion, montages};
use super::page::{
    Account, Colouring, Frames, beat_section, key_figures, leave_page, misfit_figures, motion_section, personal_sections,
    prediction_section, told, tracking_section, wall_section,
};
use super::parameter_rows::{interval, parameter_rows};
use super::personal_summary::{Details, Measured, headlines};
use super::personal_tables::write_tables;
use super::personalise::{Personalised, status_of};
use super::pictures;
use super::prediction::missing_predictions;
use super::recovery::{Recovery, recovery};
use super::scene::Scene;
use super::track::Tracked;
use crate::mesh::MeshQuality;
use crate::report::figures::{CostHistory, Curve, Look, cost_over_iterations, parameter_intervals};
use crate::report::{ParameterRow, write_csv, write_json};
use crate::study::{Outcome, Status};

/// Writes what a personalisation leaves.
pub(super) fn leave(scene: &Scene, tracked: &Tracked, found: &Personalised, started: Instant) -> Result<Outcome, RunError> {
    let &Scene { plan, patient, clock, .. } = scene;
    let folder = &plan.output.directory;
    let truth_ml: &[f64] = patient.truth.as_ref().map_or(&[], |truth| &truth.volumes_lv_ml);
    let rows: Vec<FrameRow> = frame_rows(clock, &found.fitted, Some(tracked), &found.measured.left_ml, truth_ml);
    write_beat(plan, &found.model, &found.fitted, clock, &rows)?;
    write_csv(&folder.join("tracked_curves.csv"), &tracked.motion.trajectory.curves)?;
    if plan.output.meshes {
        write_series(folder, "tracked", &found.model, &tracked.motion.trajectory, clock)?;
    }
    write_discrepancy(folder, &patient.anatomy, &tracked.motion)?;
    write_base_motion(folder, clock, &found.model, &tracked.motion.trajectory)?;
    let parameters = parameter_rows(found, tracked, &patient.parameters);
    write_csv(&folder.join("parameters.csv"), &parameters)?;
    write_tables(folder, found)?;
    if !found.bias.is_empty() {
        write_csv(&folder.join("tracking_bias.csv"), &found.bias)?;
    }
    let recovery = recovery(plan, patient, tracked, found);
    if plan.output.figures {
        draw(scene, tracked, found, recovery.as_ref())?;
    }
    let measured = Measured::of(&found.measured.left_ml);
    let calibration = &found.found.calibration;
    let mut status = if found.found.violated.is_empty() { status_of(&calibration.outcome) } else { Status::Failed };
    let mut warnings: Vec<String> =
        patient.warnings.iter().chain(&tracked.motion.warnings).chain(&found.measured.warnings).cloned().collect();
    if let Some(text) = missing_predictions(plan, found.predictions.as_ref()) {
        status = Status::Stopped;
        warnings.push(text);
    }
    let details = Details::new(scene, tracked, found, recovery);
    let mut headlines = headlines(&details, &parameters);
    if let Some(predictions) = &found.predictions {
        predictions.leave(plan)?;
        headlines.extend(predictions.headlines());
    }
    let summary = Summary {
        kind: plan.kind,
        status,
        beat: BeatSummary::new(&found.model, &found.fitted, clock),
        details,
        mesh: MeshQuality::of(&patient.anatomy.mesh),
        warnings: &warnings,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&folder.join("summary.json"), &summary)?;
    let details = &summary.details;
    let mut key_figures = key_figures(&summary.beat, Some((measured.largest_ml, measured.smallest_ml)));
    key_figures.extend(misfit_figures([details.volume_rms_initial_ml, details.volume_rms_ml], &details.tracking, clock, &found.fitted));
    let in_words = told(&details.verdicts(), &parameters, found.predictions.as_ref());
    let account = Account { status, headlines: &in_words, warnings: summary.warnings, key_figures, record: &summary };
    leave_report(scene, tracked, found, &parameters, account)?;
    Ok(Outcome { status, directory: folder.clone(), headlines })
}

fn leave_report(
    scene: &Scene,
    tracked: &Tracked,
    found: &Personalised,
    parameters: &[ParameterRow],
    account: Account<Summary<Details>>,
) -> Result<(), RunError> {
    let &Scene { plan, patient, images, clock, .. } = scene;
    let anatomy = &patient.anatomy;
    let frames = Frames::of(clock, &found.fitted.frames);
    let motions = motions(tracked, found);
    let shown = ImageScene { plan, patient, images, clock, motions: &motions };
    let colouring = Colouring { anatomy, frames: &found.fitted.frames, model: Some((&found.model, &found.fitted)) };
    let details = &account.record.details;
    let [parameters, identifiability, convergence] = personal_sections(found, parameters, details.recovery.as_ref());
    let sections = vec![
        parameters,
        beat_section(clock, &found.fitted, [&further_volumes(scene, tracked, found), &right_volumes(scene, found)]),
        motion_section(clock, &frames, Some(&shown), &colouring)?,
        wall_section(&found.model, clock, &found.fitted),
        prediction_section(found.predictions.as_ref()),
        tracking_section(anatomy, clock, tracked, &details.tracking, &details.validation),
        identifiability,
        convergence,
    ];
    leave_page(plan, account, sections, frames.times_s)
}

/// The motions that are shown on the images.
fn motions<'a>(tracked: &'a Tracked, found: &'a Personalised) -> [NamedMotion<'a>; 2] {
    [
        NamedMotion { name: "tracked", frames: &tracked.motion.trajectory.frames },
        NamedMotion { name: "personalised model, no image forces", frames: &found.fitted.frames },
    ]
}

/// The volumes that stand beside the model's.
fn further_volumes(scene: &Scene, tracked: &Tracked, found: &Personalised) -> Vec<Curve> {
    let times_s = &scene.clock.times_s;
    let truth = scene.patient.truth.as_ref();
    let mut further = vec![
        Curve::new("model at its start", Look::Initial, times_s, &frame_volumes_lv_ml(&found.initial)),
        Curve::new("tracked", Look::Tracked, times_s, &frame_volumes_lv_ml(&tracked.motion.trajectory)),
        Curve::new("measured", Look::Measured, times_s, &found.measured.left_ml),
    ];
    further.extend(truth.map(|truth| Curve::new("truth", Look::Truth, times_s, &truth.volumes_lv_ml)));
    further
}

/// The measured volumes of the right ventricle, where there are any.
fn right_volumes(scene: &Scene, found: &Personalised) -> Vec<Curve> {
    let measured = found.measured.right_ml.iter();
    measured.map(|volumes_ml| Curve::new("measured", Look::Measured, &scene.clock.times_s, volumes_ml)).collect()
}

fn draw(scene: &Scene, tracked: &Tracked, found: &Personalised, recovery: Option<&Recovery>) -> Result<(), RunError> {
    let &Scene { plan, patient, images, clock, .. } = scene;
    let folder = &plan.output.directory;
    pictures::beat(plan, clock, &found.fitted, &further_volumes(scene, tracked, found))?;
    montages(&ImageScene { plan, patient, images, clock, motions: &motions(tracked, found) })?;
    let cost = found.found.calibration.records.iter().map(|record| record.cost).filter(|cost| cost.is_finite()).collect();
    cost_over_iterations(&folder.join("cost.png"), &CostHistory { title: "Cost of the calibration".into(), cost })?;
    let sought = parameter_rows(found, tracked, &patient.parameters).into_iter().filter(|row| row.state != "fixed");
    let intervals: Vec<_> = sought.map(|row| interval(row, recovery)).collect();
    Ok(parameter_intervals(&folder.join("parameters.png"), "Parameters found", &intervals)?)
}
