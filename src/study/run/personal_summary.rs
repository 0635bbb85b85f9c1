//! What a personalisation says of itself: `summary.json` beside the beat, and the lines for whoever ran it.

use std::collections::BTreeMap;

use serde::Serialize;

use super::discrepancy::work_magnitude_mj;
use super::forward::frame_volumes_lv_ml;
use super::gains::boundary_rms_mm;
use super::measured::MeasuredVolumes;
use super::patient::{Patient, PatientImages};
use super::personal_tables::verdict;
use super::personalise::Personalised;
use super::recovery::{Recovery, difference_rms};
use super::scene::Scene;
use super::search::ProfileInterval;
use super::track::{Tracked, held_out_rms_mm, surface_rms_mm, validate};
use crate::heart::{Parameter, Trajectory};
use crate::mesh::SurfaceTag;
use crate::personalisation::{Evidence, GainEvaluation};
use crate::report::ParameterRow;
use crate::study::Choice;

/// `summary.json` of a personalisation, beside the beat.
#[derive(Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
pub(super) struct Details {
    pub(super) measured_ejection_fraction_lv: f64,
    pub(super) measured_end_diastolic_volume_lv_ml: f64,
    pub(super) measured_end_systolic_volume_lv_ml: f64,
    pub(super) volume_rms_initial_ml: f64,
    pub(super) volume_rms_ml: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) volume_rms_rv_initial_ml: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) volume_rms_rv_ml: Option<f64>,
    pub(super) calibration_status: &'static str,
    pub(super) iterations: usize,
    /// Of the last search.
    pub(super) simulations: f64,
    /// Of all searches: start values, rounds and replicas.
    pub(super) simulations_of_all_searches: f64,
    /// What a pass with all tangents took by the clock, in simulations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) clocked_pass_cost: Option<f64>,
    pub(super) solver: &'static str,
    /// What the data say of their noise and of neighbours, relative to what the study states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) evidence: Option<Evidence>,
    /// Root mean square of every part of the data over its standard deviations.
    pub(super) residual_rms: BTreeMap<&'static str, f64>,
    /// Bounds and constraints that hold the answer.
    pub(super) active: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) profile_intervals: Vec<ProfileInterval>,
    pub(super) verdict: Vec<String>,
    pub(super) tracking: TrackingSummary,
    /// The same images tracked with the heart that was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) tracking_personalised: Option<TrackingSummary>,
    pub(super) validation: Vec<ValidationSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) recovery: Option<Recovery>,
}

impl Details {
    /// How far the result can be believed, a sentence a line.
    pub(super) fn verdicts(&self) -> Vec<String> {
        let mut lines = self.verdict.clone();
        lines.extend(ValidationSummary::headlines(&self.validation));
        lines.extend(self.recovery.iter().map(|recovery| {
            let verdict = match recovery.within_tolerance {
                _ if !recovery.has_tolerances() => "",
                true => "Truth recovered within the stated tolerances; ",
                false => "Truth recovered NOT within the stated tolerances; ",
            };
            format!("{verdict}volume of the model {:.2} mL RMS from the truth", recovery.volume_model_rms_ml)
        }));
        lines
    }

    pub(super) fn new(scene: &Scene, tracked: &Tracked, found: &Personalised, recovery: Option<Recovery>) -> Self {
        let &Scene { patient, images, wanted, .. } = scene;
        let measured = Measured::of(&found.measured.left_ml);
        let calibration = &found.found.calibration;
        Self {
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
            simulations_of_all_searches: found.simulations,
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
        }
    }
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
            "Labels of {count} frames, which nothing was fitted to: Dice {dice:.3} on average, {least:.3} at least (without motion {still:.3} on average)"
        )]
    }

    fn headline(&self) -> String {
        let distance = |mm: Option<f64>| mm.map_or("none".to_owned(), |mm| format!("{mm:.2} mm"));
        format!(
            "Labels of frame {}, which nothing was fitted to: Dice {:.3} (without motion {:.3}), mean distance {} (without motion {})",
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

/// The measured curve in three numbers.
pub(super) struct Measured {
    pub(super) largest_ml: f64,
    pub(super) smallest_ml: f64,
}

impl Measured {
    pub(super) fn of(volumes_ml: &[f64]) -> Self {
        let fold = |pick: fn(f64, f64) -> f64, from: f64| volumes_ml.iter().copied().fold(from, pick);
        Self { largest_ml: fold(f64::max, f64::NEG_INFINITY), smallest_ml: fold(f64::min, f64::INFINITY) }
    }

    fn ejection_fraction(&self) -> f64 {
        1.0 - self.smallest_ml / self.largest_ml
    }
}

/// The lines for whoever ran it.
pub(super) fn headlines(details: &Details, parameters: &[ParameterRow]) -> Vec<String> {
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
