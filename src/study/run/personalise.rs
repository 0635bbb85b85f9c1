//! `kind = "personalise"`: track the images, take the volume curve and the boundaries, find the parameters of the free heart, rescore it
//! without image forces, say how sure that is.

use std::time::Instant;

use nalgebra::DVector;
use serde::Serialize;

use super::calibration::{calibration_trajectory, residual, simulate_at};
use super::clock::Clock;
use super::discrepancy::{work_magnitude_mj, write_discrepancy};
use super::error::RunError;
use super::forward::{beat, frame_volumes_lv_ml, heart_model, step_count};
use super::leave::{BeatSummary, FrameRow, Summary, frame_rows, write_base_motion, write_beat, write_series};
use super::measured::{MeasuredVolumes, measured_volumes};
use super::montages::{NamedMotion, montages};
use super::parameter_rows::{interval, parameter_rows};
use super::patient::{Patient, PatientImages};
use super::pictures;
use super::recovery::{Recovery, difference_rms, recovery};
use super::start::start_space;
use super::track::{Tracked, held_out_rms_mm, surface_rms_mm, track_patient, validate};
use crate::heart::{HeartModel, Parameter, Trajectory};
use crate::mesh::{MeshQuality, SurfaceTag};
use crate::personalisation::{
    Calibration, CalibrationOutcome, CalibrationProblem, CalibrationTrajectory, DifferenceScheme, FiniteDifferenceModel, FreeParameter,
    GainEvaluation, GaussNewtonSettings, NoiseScale, ParameterSpace, StackedResidual, Uncertainty, calibrate,
};
use crate::report::figures::{CostHistory, Curve, Look, cost_over_iterations, parameter_intervals};
use crate::report::{IterationRow, ParameterRow, write_csv, write_iterations, write_json};
use crate::study::plan::PersonalisationPlan;
use crate::study::{Outcome, Plan, RunContext, Status};

/// Relative step of the finite differences, in the coordinates (a logarithm where the parameter is positive).
const DIFFERENCE_STEP: f64 = 2e-3;

/// What a calibration started from and came to.
pub(super) struct Personalised {
    pub(super) space: ParameterSpace,
    pub(super) calibration: Calibration<CalibrationTrajectory>,
    pub(super) uncertainty: Option<Uncertainty>,
    pub(super) model: HeartModel,
    pub(super) fitted: Trajectory,
    initial: Trajectory,
    measured: MeasuredVolumes,
}

/// Runs the whole thread and leaves its files.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let patient = Patient::new(plan, context)?;
    let (Some(images), Some(wanted)) = (&patient.images, &plan.personalisation) else { return Err(RunError::NothingToFit) };
    let clock = patient.clock(plan.simulation.beats.count());
    let tracked = track_patient(plan, &patient, images, patient.parameters.clone(), context)?;
    let personalised = personalise(plan, wanted, &patient, &clock, &tracked, context)?;
    context.progress().stage("writing results", None);
    let outcome = leave(plan, &patient, images, &clock, &tracked, &personalised, started)?;
    context.progress().finish();
    Ok(outcome)
}

fn personalise(
    plan: &Plan,
    wanted: &PersonalisationPlan,
    patient: &Patient,
    clock: &Clock,
    tracked: &Tracked,
    context: &RunContext,
) -> Result<Personalised, RunError> {
    let measured = measured_volumes(plan, wanted, &patient.anatomy, clock, tracked)?;
    let residual = residual(wanted, &patient.anatomy, &measured, tracked)?;
    let base = heart_model(&plan.model, &patient.anatomy, patient.parameters.clone())?;
    let space = start_space(wanted, &base, clock, &measured.left_ml, context)?;

    let (calibration, uncertainty) = search(wanted, &base, &space, clock, &residual, context)?;

    context.progress().stage("rescoring without image forces", Some(step_count(clock, plan.model.step_s)));
    let model = base.with_parameters(space.to_parameters(&calibration.coordinates)?)?;
    let fitted = beat(&model, clock, &[], context)?;
    let initial = beat(&base.with_parameters(space.to_parameters(&space.initial())?)?, clock, &[], context)?;
    Ok(Personalised { space, calibration, uncertainty, model, fitted, initial, measured })
}

/// Gauss–Newton from the start of `space`.
fn search(
    wanted: &PersonalisationPlan,
    base: &HeartModel,
    space: &ParameterSpace,
    clock: &Clock,
    residual: &StackedResidual<CalibrationTrajectory>,
    context: &RunContext,
) -> Result<(Calibration<CalibrationTrajectory>, Option<Uncertainty>), RunError> {
    let is_stopped = || context.is_stopped();
    let simulate = |coordinates: &DVector<f64>| {
        simulate_at(base, space, clock, coordinates, &is_stopped).map(|trajectory| calibration_trajectory(&trajectory))
    };
    let steps = DVector::from_iterator(space.dimension(), space.free().map(difference_step));
    let model = FiniteDifferenceModel::new(simulate, DifferenceScheme::Forward, steps, space.lower(), space.upper());
    let problem = CalibrationProblem::new(&model, residual, space)?.with_stop_flag(context.stop());
    let settings = GaussNewtonSettings {
        max_iterations: wanted.max_iterations as u64,
        step_tolerance: wanted.tolerance,
        ..GaussNewtonSettings::default()
    };
    context.progress().stage("finding the parameters", Some(wanted.max_iterations as u64));
    let calibration = calibrate(&problem, &space.initial(), settings, &mut |record| context.progress().step(record.iteration))?;
    let uncertainty = calibration.linearisation.as_ref().map(|at| Uncertainty::new(&problem, at, NoiseScale::FromResiduals)).transpose()?;
    Ok((calibration, uncertainty))
}

/// A step that is relative in a logarithm, and a small part of the bounds otherwise.
fn difference_step(free: &FreeParameter) -> f64 {
    let width = free.transform.to_coordinate(free.upper) - free.transform.to_coordinate(free.lower);
    DIFFERENCE_STEP * width.min(1.0)
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
    simulations: u64,
    verdict: Vec<String>,
    tracking: TrackingSummary,
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
    boundary_rms_held_out_mm: f64,
    image_gain_endocardium_lv_kpa_per_mm: f64,
    image_gain_epicardium_kpa_per_mm: f64,
    image_gain_base_kpa_per_mm: f64,
    /// Magnitudes added up over the beat; compare with the stroke work.
    image_work_mj: f64,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    gain_factors_tried: Vec<GainEvaluation>,
}

/// A motion against labels that nothing was fitted to.
#[derive(Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
pub(super) struct ValidationSummary {
    frame: usize,
    dice_tracked: f64,
    dice_no_motion: f64,
    mean_distance_tracked_mm: Option<f64>,
    mean_distance_no_motion_mm: Option<f64>,
    volume_tracked_ml: f64,
    volume_labels_ml: f64,
}

impl ValidationSummary {
    /// For whoever ran it.
    pub(super) fn headline(&self) -> String {
        let distance = |mm: Option<f64>| mm.map_or("none".to_owned(), |mm| format!("{mm:.2} mm"));
        format!(
            "expert labels of frame {}: Dice {:.3} (no motion {:.3}), mean distance {} (no motion {})",
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
        boundary_rms_held_out_mm: held_out_rms_mm(&tracked.motion),
        image_gain_endocardium_lv_kpa_per_mm: tracked.parameters[Parameter::ImageGainEndocardiumLv],
        image_gain_epicardium_kpa_per_mm: tracked.parameters[Parameter::ImageGainEpicardium],
        image_gain_base_kpa_per_mm: tracked.parameters[Parameter::ImageGainBase],
        image_work_mj: work_magnitude_mj(&tracked.motion),
        gain_factors_tried: tracked.gain_choice.iter().flat_map(|choice| choice.evaluations.iter().copied()).collect(),
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

fn status_of(outcome: &CalibrationOutcome) -> Status {
    match outcome {
        CalibrationOutcome::Converged(_) | CalibrationOutcome::Stalled => Status::Converged,
        CalibrationOutcome::OnBound(_) => Status::OnBound,
        CalibrationOutcome::MaxIterations => Status::IterationLimit,
        CalibrationOutcome::Stopped => Status::Stopped,
        CalibrationOutcome::Failed(_) => Status::Failed,
    }
}

fn leave(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    clock: &Clock,
    tracked: &Tracked,
    found: &Personalised,
    started: Instant,
) -> Result<Outcome, RunError> {
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
    write_iterations(&folder.join("iterations.csv"), &found.space.names(), &iteration_rows(found))?;
    let recovery = recovery(plan, patient, tracked, found);
    if plan.output.figures {
        draw(plan, patient, images, clock, tracked, found, recovery.as_ref())?;
    }
    let measured = Measured::of(&found.measured.left_ml);
    let status = status_of(&found.calibration.outcome);
    let details = Details {
        measured_ejection_fraction_lv: measured.ejection_fraction(),
        measured_end_diastolic_volume_lv_ml: measured.largest_ml,
        measured_end_systolic_volume_lv_ml: measured.smallest_ml,
        volume_rms_initial_ml: difference_rms(&frame_volumes_lv_ml(&found.initial), &found.measured.left_ml),
        volume_rms_ml: difference_rms(&frame_volumes_lv_ml(&found.fitted), &found.measured.left_ml),
        volume_rms_rv_initial_ml: right_rms_ml(&found.initial, &found.measured),
        volume_rms_rv_ml: right_rms_ml(&found.fitted, &found.measured),
        calibration_status: found.calibration.outcome.status(),
        iterations: found.calibration.records.len().saturating_sub(1),
        simulations: found.calibration.evaluation_count + found.calibration.linearisation_count * found.space.dimension() as u64,
        verdict: found.uncertainty.as_ref().map(|uncertainty| uncertainty.verdict(&found.space.names())).unwrap_or_default(),
        tracking: tracking_summary(tracked),
        validation: validation_summary(patient, images, tracked),
        recovery,
    };
    let headlines = headlines(&details, &parameters);
    let summary = Summary {
        kind: plan.kind,
        status,
        beat: BeatSummary::new(&found.model, &found.fitted, clock),
        details,
        mesh: MeshQuality::of(&patient.anatomy.mesh),
        warnings: &patient.warnings.iter().chain(&tracked.motion.warnings).chain(&found.measured.warnings).cloned().collect::<Vec<_>>(),
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&folder.join("summary.json"), &summary)?;
    Ok(Outcome { status, directory: folder.clone(), headlines })
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
    lines.extend(details.verdict.iter().cloned());
    lines.extend(details.validation.iter().map(ValidationSummary::headline));
    lines.extend(details.recovery.iter().map(|recovery| {
        let verdict = if recovery.within_tolerance { "within" } else { "NOT within" };
        format!(
            "truth recovered {verdict} the stated tolerances; volume of the model {:.2} mL RMS from the truth",
            recovery.volume_model_rms_ml
        )
    }));
    lines
}

fn iteration_rows(found: &Personalised) -> Vec<IterationRow> {
    let mut simulations = 0;
    let dimension = found.space.dimension();
    let row = |record: &crate::personalisation::IterationRecord| {
        simulations += record.trials as usize + dimension;
        IterationRow {
            iteration: record.iteration as usize,
            cost: record.cost,
            step: record.step_norm,
            simulations,
            status: if record.iteration == 0 { "start".into() } else { "accepted".into() },
            values: found.space.to_values(&record.coordinates),
        }
    };
    found.calibration.records.iter().map(row).collect()
}

fn draw(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    clock: &Clock,
    tracked: &Tracked,
    found: &Personalised,
    recovery: Option<&Recovery>,
) -> Result<(), RunError> {
    let folder = &plan.output.directory;
    let tracked_ml = frame_volumes_lv_ml(&tracked.motion.trajectory);
    let mut further = vec![
        Curve::new("model at its start", Look::Initial, &clock.times_s, &frame_volumes_lv_ml(&found.initial)),
        Curve::new("tracked", Look::Tracked, &clock.times_s, &tracked_ml),
        Curve::new("measured", Look::Measured, &clock.times_s, &found.measured.left_ml),
    ];
    further.extend(patient.truth.as_ref().map(|truth| Curve::new("truth", Look::Truth, &clock.times_s, &truth.volumes_lv_ml)));
    pictures::beat(plan, clock, &found.fitted, &further)?;
    let motions = [
        NamedMotion { name: "tracked", frames: &tracked.motion.trajectory.frames },
        NamedMotion { name: "personalised model, no image forces", frames: &found.fitted.frames },
    ];
    montages(plan, patient, images, clock, &motions)?;
    let cost = found.calibration.records.iter().map(|record| record.cost).collect();
    cost_over_iterations(&folder.join("cost.png"), &CostHistory { title: "Cost of the calibration".into(), cost })?;
    let sought = parameter_rows(found, tracked, &patient.parameters).into_iter().filter(|row| row.state != "fixed");
    let intervals: Vec<_> = sought.map(|row| interval(row, recovery)).collect();
    Ok(parameter_intervals(&folder.join("parameters.png"), "Parameters found", &intervals)?)
}
