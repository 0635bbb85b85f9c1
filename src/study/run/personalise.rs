//! `kind = "personalise"`: track the images, take the volume curve and the boundaries, find the parameters of the free heart, rescore it
//! without image forces, say how sure that is.

use std::collections::BTreeMap;
use std::time::Instant;

use nalgebra::DVector;
use serde::Serialize;

use super::calibration::residual;
use super::clock::Clock;
use super::discrepancy::{work_magnitude_mj, write_discrepancy};
use super::error::RunError;
use super::forward::{beat, frame_volumes_lv_ml, heart_model, step_count};
use super::gains::boundary_rms_mm;
use super::leave::{BeatSummary, FrameRow, Summary, frame_rows, write_base_motion, write_beat, write_series};
use super::measured::{MeasuredVolumes, measured_volumes};
use super::montages::{ImageScene, NamedMotion, montages};
use super::page::{
    Account, Colouring, Frames, beat_section, key_figures, leave_page, misfit_figures, motion_section, personal_sections,
    prediction_section, told, tracking_section, wall_section,
};
use super::parameter_rows::{interval, parameter_rows};
use super::patient::{Patient, PatientImages};
use super::personal_tables::{verdict, write_tables};
use super::pictures;
use super::prediction::{Predictions, missing_predictions, predict};
use super::recovery::{Recovery, difference_rms, recovery};
use super::search::{Found, ProfileInterval, Task, find, journal_of};
use super::start::{StageRow, start_space};
use super::track::{Tracked, held_out_rms_mm, surface_rms_mm, track_again, track_patient, validate};
use crate::heart::{HeartModel, Parameter, Trajectory};
use crate::mesh::{MeshQuality, SurfaceTag};
use crate::personalisation::{CalibrationOutcome, Evidence, GainEvaluation, ParameterSpace};
use crate::report::figures::{CostHistory, Curve, Look, cost_over_iterations, parameter_intervals};
use crate::report::{ParameterRow, write_csv, write_json};
use crate::study::plan::PersonalisationPlan;
use crate::study::{Choice, Outcome, Plan, RunContext, Status};

/// What a calibration started from and came to.
pub(super) struct Personalised {
    pub(super) space: ParameterSpace,
    pub(super) found: Found,
    pub(super) stages: Vec<StageRow>,
    pub(super) rounds: Vec<RoundRow>,
    pub(super) model: HeartModel,
    pub(super) fitted: Trajectory,
    initial: Trajectory,
    measured: MeasuredVolumes,
    /// The images tracked once more with the heart that was found, at the gains of the first time.
    retracked: Option<Tracked>,
    predictions: Option<Predictions>,
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
    let patient = Patient::new(plan, context)?;
    let (Some(images), Some(wanted)) = (&patient.images, &plan.personalisation) else { return Err(RunError::NothingToFit) };
    let clock = patient.clock(plan.simulation.beats.count());
    let tracked = track_patient(plan, &patient, images, patient.parameters.clone(), context)?.whole()?;
    let scene = Scene { plan, wanted, patient: &patient, images, clock: &clock };
    let personalised = personalise(&scene, &tracked, context)?;
    context.progress().stage("writing results", None);
    let outcome = leave(&scene, &tracked, &personalised, started)?;
    context.progress().finish();
    Ok(outcome)
}

/// What a personalisation works on.
struct Scene<'a> {
    plan: &'a Plan,
    wanted: &'a PersonalisationPlan,
    patient: &'a Patient,
    images: &'a PatientImages,
    clock: &'a Clock,
}

fn personalise(scene: &Scene, tracked: &Tracked, context: &RunContext) -> Result<Personalised, RunError> {
    let &Scene { plan, wanted, patient, images, clock } = scene;
    let base = heart_model(&plan.model, &patient.anatomy, patient.parameters.clone())?;
    let mut measured = measured_volumes(plan, wanted, patient, clock, tracked)?;
    let (space, mut stages) = start_space(wanted, &base, clock, &measured.left_ml, context)?;
    let found_at =
        |coordinates: &DVector<f64>| -> Result<HeartModel, RunError> { Ok(base.with_parameters(space.to_parameters(coordinates)?)?) };
    let (mut rounds, mut found, mut again) = (Vec::new(), None::<Found>, None);
    for round in 1..=wanted.rounds {
        let gain_factor = wanted.gain_decay.powi(round as i32 - 1);
        let mut start = space.initial();
        if let Some(earlier) = &found {
            start = earlier.calibration.coordinates.clone();
            again = Some(track_again(plan, patient, images, found_at(&start)?.parameters(), tracked, gain_factor, context)?);
        }
        let tracked = again.as_ref().unwrap_or(tracked);
        measured = measured_volumes(plan, wanted, patient, clock, tracked)?;
        let residual = residual(&wanted.data, patient, clock, &measured, tracked)?;
        let task = Task { wanted, base: &base, space: &space, clock, residual: &residual };
        let journal = journal_of(plan, &format!("round_{round}"), &plan.provenance)?;
        let one = find(&task, wanted.solver, &start, Some(&journal), context)?;
        rounds.push(RoundRow::new(round, gain_factor, tracked, &measured, &one));
        let is_stopped = context.is_stopped();
        if !is_stopped {
            journal.discard();
        }
        found = Some(one);
        if is_stopped {
            break;
        }
    }
    let found = found.ok_or(RunError::NothingToFit)?;
    stages.extend(last_stage(&space, &found));
    context.progress().stage("rescoring without image forces", Some(step_count(clock, plan.model.step_s)));
    let model = found_at(&found.calibration.coordinates)?;
    let fitted = beat(&model, clock, &[], context)?;
    let initial = beat(&found_at(&space.initial())?, clock, &[], context)?;
    let is_retracked = wanted.retrack && !context.is_stopped();
    let retracked = is_retracked.then(|| track_again(plan, patient, images, model.parameters(), tracked, 1.0, context)).transpose()?;
    let predictions = if context.is_stopped() { None } else { predict(plan, patient, model.parameters(), context)? };
    Ok(Personalised { space, found, stages, rounds, model, fitted, initial, measured, retracked, predictions })
}

/// The rows of `stages.csv` for all parameters together.
fn last_stage(space: &ParameterSpace, found: &Found) -> Vec<StageRow> {
    let values = space.to_values(&found.calibration.coordinates);
    let row = |(parameter, value)| StageRow { stage: "all", simulations: found.calibration.spent, parameter, value };
    space.names().into_iter().zip(values).map(row).collect()
}

impl RoundRow {
    fn new(round: usize, gain_factor: f64, tracked: &Tracked, measured: &MeasuredVolumes, found: &Found) -> Self {
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

/// `summary.json` of a personalisation, beside the beat.
#[derive(Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
struct Details {
    measured_ejection_fraction_lv: f64,
    measured_end_diastolic_volume_lv_ml: f64,
    measured_end_systolic_volume_lv_ml: f64,
    volume_rms_initial_ml: f64,
    volume_rms_ml: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    volume_rms_rv_initial_ml: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    volume_rms_rv_ml: Option<f64>,
    calibration_status: &'static str,
    iterations: usize,
    simulations: f64,
    /// What a pass with all tangents took by the clock, in simulations.
    #[serde(skip_serializing_if = "Option::is_none")]
    clocked_pass_cost: Option<f64>,
    solver: &'static str,
    /// What the data say of their noise and of neighbours, relative to what the study states.
    #[serde(skip_serializing_if = "Option::is_none")]
    evidence: Option<Evidence>,
    /// Root mean square of every part of the data over its standard deviations.
    residual_rms: BTreeMap<&'static str, f64>,
    /// Bounds and constraints that hold the answer.
    active: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    profile_intervals: Vec<ProfileInterval>,
    verdict: Vec<String>,
    tracking: TrackingSummary,
    /// The same images tracked with the heart that was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    tracking_personalised: Option<TrackingSummary>,
    validation: Vec<ValidationSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    recovery: Option<Recovery>,
}

/// The tracked motion in figures.
#[derive(Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
pub(super) struct TrackingSummary {
    boundary_rms_endocardium_lv_mm: Option<f64>,
    boundary_rms_epicardium_mm: Option<f64>,
    pub(super) boundary_rms_mm: f64,
    pub(super) boundary_rms_held_out_mm: f64,
    image_gain_endocardium_lv_kpa_per_mm: f64,
    image_gain_epicardium_kpa_per_mm: f64,
    image_gain_base_kpa_per_mm: f64,
    /// Magnitudes added up over the beat; compare with the stroke work.
    pub(super) image_work_mj: f64,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    gain_factors_tried: Vec<GainEvaluation>,
}

/// A motion against labels that nothing was fitted to.
#[derive(Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
pub(super) struct ValidationSummary {
    pub(super) frame: usize,
    pub(super) dice_tracked: f64,
    pub(super) dice_no_motion: f64,
    mean_distance_tracked_mm: Option<f64>,
    mean_distance_no_motion_mm: Option<f64>,
    volume_tracked_ml: f64,
    volume_labels_ml: f64,
}

impl ValidationSummary {
    /// For whoever ran it: a line a frame, or one for all of many.
    pub(super) fn headlines(frames: &[Self]) -> Vec<String> {
        /// More frames are summed up.
        const TOLD: usize = 3;
        if frames.len() <= TOLD {
            return frames.iter().map(Self::headline).collect();
        }
        let mean = |value: fn(&Self) -> f64| frames.iter().map(value).sum::<f64>() / frames.len() as f64;
        let least = frames.iter().map(|one| one.dice_tracked).fold(f64::INFINITY, f64::min);
        let (dice, still) = (mean(|one| one.dice_tracked), mean(|one| one.dice_no_motion));
        let count = frames.len();
        vec![format!(
            "labels of {count} frames, which nothing was fitted to: Dice {dice:.3} on average, {least:.3} at least (without motion {still:.3} on average)"
        )]
    }

    fn headline(&self) -> String {
        let distance = |mm: Option<f64>| mm.map_or("none".to_owned(), |mm| format!("{mm:.2} mm"));
        format!(
            "labels of frame {}, which nothing was fitted to: Dice {:.3} (without motion {:.3}), mean distance {} (without motion {})",
            self.frame,
            self.dice_tracked,
            self.dice_no_motion,
            distance(self.mean_distance_tracked_mm),
            distance(self.mean_distance_no_motion_mm)
        )
    }
}

pub(super) fn tracking_summary(tracked: &Tracked) -> TrackingSummary {
    TrackingSummary {
        boundary_rms_endocardium_lv_mm: surface_rms_mm(&tracked.motion, SurfaceTag::EndocardiumLv),
        boundary_rms_epicardium_mm: surface_rms_mm(&tracked.motion, SurfaceTag::Epicardium),
        boundary_rms_mm: boundary_rms_mm(&tracked.motion),
        boundary_rms_held_out_mm: held_out_rms_mm(&tracked.motion),
        image_gain_endocardium_lv_kpa_per_mm: tracked.parameters[Parameter::ImageGainEndocardiumLv],
        image_gain_epicardium_kpa_per_mm: tracked.parameters[Parameter::ImageGainEpicardium],
        image_gain_base_kpa_per_mm: tracked.parameters[Parameter::ImageGainBase],
        image_work_mj: work_magnitude_mj(&tracked.motion),
        gain_factors_tried: tracked.gain_choices.iter().flat_map(|chosen| chosen.choice.evaluations.iter().copied()).collect(),
    }
}

pub(super) fn validation_summary(patient: &Patient, images: &PatientImages, tracked: &Tracked) -> Vec<ValidationSummary> {
    let found = validate(patient, images, &tracked.motion);
    let summary = |one: super::track::Validation| ValidationSummary {
        frame: one.frame,
        dice_tracked: one.tracked.dice,
        dice_no_motion: one.no_motion.dice,
        mean_distance_tracked_mm: one.tracked.mean_distance_mm,
        mean_distance_no_motion_mm: one.no_motion.mean_distance_mm,
        volume_tracked_ml: one.tracked.mesh_volume_ml,
        volume_labels_ml: one.tracked.label_volume_ml,
    };
    found.into_iter().map(summary).collect()
}

/// How far the right ventricle of a beat is from what was measured of it, mL RMS.
fn right_rms_ml(trajectory: &Trajectory, measured: &MeasuredVolumes) -> Option<f64> {
    let volumes_ml: Vec<f64> = trajectory.frames.iter().filter_map(|frame| frame.volume_ml.get(1).copied()).collect();
    Some(difference_rms(&volumes_ml, measured.right_ml.as_ref()?))
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

fn leave(scene: &Scene, tracked: &Tracked, found: &Personalised, started: Instant) -> Result<Outcome, RunError> {
    let &Scene { plan, patient, images, clock, wanted } = scene;
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
    let details = Details {
        measured_ejection_fraction_lv: measured.ejection_fraction(),
        measured_end_diastolic_volume_lv_ml: measured.largest_ml,
        measured_end_systolic_volume_lv_ml: measured.smallest_ml,
        volume_rms_initial_ml: difference_rms(&frame_volumes_lv_ml(&found.initial), &found.measured.left_ml),
        volume_rms_ml: difference_rms(&frame_volumes_lv_ml(&found.fitted), &found.measured.left_ml),
        volume_rms_rv_initial_ml: right_rms_ml(&found.initial, &found.measured),
        volume_rms_rv_ml: right_rms_ml(&found.fitted, &found.measured),
        calibration_status: calibration.outcome.status(),
        iterations: calibration.records.len().saturating_sub(1),
        simulations: calibration.spent,
        clocked_pass_cost: found.found.clocked_pass_cost,
        solver: wanted.solver.word(),
        evidence: found.found.evidence,
        residual_rms: found.found.rms_by_part.iter().copied().collect(),
        active: found.found.active.clone(),
        profile_intervals: found.found.profile_intervals.clone(),
        verdict: verdict(&found.found, &found.space),
        tracking: tracking_summary(tracked),
        tracking_personalised: found.retracked.as_ref().map(tracking_summary),
        validation: validation_summary(patient, images, tracked),
        recovery,
    };
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

/// The measured curve in three numbers.
struct Measured {
    largest_ml: f64,
    smallest_ml: f64,
}

impl Measured {
    fn of(volumes_ml: &[f64]) -> Self {
        let fold = |pick: fn(f64, f64) -> f64, from: f64| volumes_ml.iter().copied().fold(from, pick);
        Self { largest_ml: fold(f64::max, f64::NEG_INFINITY), smallest_ml: fold(f64::min, f64::INFINITY) }
    }

    fn ejection_fraction(&self) -> f64 {
        1.0 - self.smallest_ml / self.largest_ml
    }
}

fn headlines(details: &Details, parameters: &[ParameterRow]) -> Vec<String> {
    let mut lines = vec![format!(
        "LV of the images: EDV {:.1} mL, ESV {:.1} mL, EF {:.1} %; volume RMS {:.1} mL before, {:.1} mL after",
        details.measured_end_diastolic_volume_lv_ml,
        details.measured_end_systolic_volume_lv_ml,
        100.0 * details.measured_ejection_fraction_lv,
        details.volume_rms_initial_ml,
        details.volume_rms_ml
    )];
    lines.extend(parameters.iter().filter(|row| row.state != "fixed").map(|row| {
        let bound = if row.at_bound { " (on its bound)" } else { "" };
        let place = if row.region.starts_with("segment") { format!(" in {}", row.region) } else { String::new() };
        format!("{}{place} = {:.4} {}, from {:.4}{bound}", row.parameter, row.value, row.unit, row.initial)
    }));
    lines.extend(details.verdicts());
    lines
}

impl Details {
    /// How far the result can be believed, a sentence a line.
    fn verdicts(&self) -> Vec<String> {
        let mut lines = self.verdict.clone();
        lines.extend(ValidationSummary::headlines(&self.validation));
        lines.extend(self.recovery.iter().map(|recovery| {
            let verdict = match recovery.within_tolerance {
                _ if !recovery.has_tolerances() => "",
                true => "truth recovered within the stated tolerances; ",
                false => "truth recovered NOT within the stated tolerances; ",
            };
            format!("{verdict}volume of the model {:.2} mL RMS from the truth", recovery.volume_model_rms_ml)
        }));
        lines
    }
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
