//! The proactive heart on a patient's images: gains as written or chosen on held-out boundary points, then the tracked beat.

use std::ops::ControlFlow;

use super::error::RunError;
use super::forward::{heart_model, step_count};
use super::patient::{Patient, PatientImages};
use super::recorded_base::read_base_motion;
use crate::heart::{HeartModel, Parameter, Parameters};
use crate::mesh::SurfaceTag;
use crate::personalisation::{self, GainSearch};
use crate::study::RunContext;
use crate::study::plan::{BaseMode, GainChoice, Plan};
use crate::tracking::{
    self, BaseMode as TrackerBase, BlockMatchingSettings, BoundarySettings, CavityAgreement, TrackedMotion, TrackerSettings, track,
};

/// A tracked beat and the gains it was tracked with.
pub(super) struct Tracked {
    pub(super) motion: TrackedMotion,
    pub(super) parameters: Parameters,
    /// The factors on the gains that were tried, with the error at the held-out points, where the study lets the data choose.
    pub(super) gain_choice: Option<personalisation::GainChoice>,
}

/// Tracks a patient with the heart of `parameters`.
pub(super) fn track_patient(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    parameters: Parameters,
    context: &RunContext,
) -> Result<Tracked, RunError> {
    let model = heart_model(&plan.model, &patient.anatomy, parameters)?;
    let settings = tracker_settings(plan, patient, images)?;
    let gain_choice = match plan.tracking.gains {
        GainChoice::Written => None,
        GainChoice::HeldOut => Some(choose_gains(&model, images, &settings, context)?),
    };
    let factor = gain_choice.as_ref().map_or(1.0, |choice| choice.gain);
    let model = model.with_parameters(scaled_gains(model.parameters(), factor)?)?;
    context.progress().stage("tracking the images", Some(steps(plan, patient)));
    let motion = tracked_beat(&model, images, &settings, context)?;
    for warning in &motion.warnings {
        context.progress().warning(warning);
    }
    Ok(Tracked { motion, parameters: model.parameters().clone(), gain_choice })
}

fn steps(plan: &Plan, patient: &Patient) -> u64 {
    step_count(&patient.clock(1), plan.model.step_s)
}

fn tracked_beat(
    model: &HeartModel,
    images: &PatientImages,
    settings: &TrackerSettings,
    context: &RunContext,
) -> Result<TrackedMotion, RunError> {
    let mut done = 0;
    let mut observer = |_: &_, _: &_| {
        context.progress().step(done);
        done += 1;
        if context.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let motion = track(model, &images.cine, settings, &mut observer)?;
    if motion.trajectory.stopped { Err(RunError::Stopped) } else { Ok(motion) }
}

/// Factors on the written gains between which the data choose.
pub(super) const GAIN_FACTORS: GainSearch = GainSearch { lower: 0.25, upper: 4.0, scan_count: 3, tolerance_decades: 0.6 };
/// The held-out error may be this much larger than the least for a smaller gain, which leaves more to the model.
const HELD_OUT_SLACK: f64 = 1.1;

/// One factor on all image gains: the smallest that meets the boundary points that pull on nothing nearly as well as the best one.
fn choose_gains(
    model: &HeartModel,
    images: &PatientImages,
    settings: &TrackerSettings,
    context: &RunContext,
) -> Result<personalisation::GainChoice, RunError> {
    context.progress().stage("choosing the image gains", None);
    let mut stopped = false;
    let held_out = |factor: f64| {
        let attempt = || -> Result<f64, RunError> {
            let model = model.with_parameters(scaled_gains(model.parameters(), factor)?)?;
            Ok(held_out_rms_mm(&tracked_beat(&model, images, settings, context)?))
        };
        let found = attempt();
        stopped |= matches!(found, Err(RunError::Stopped));
        found.ok()
    };
    let choice = GAIN_FACTORS.by_held_out(held_out);
    if stopped {
        return Err(RunError::Stopped);
    }
    let mut choice = choice?;
    let good_enough = choice.evaluations.iter().filter(|tried| tried.residual_rms <= HELD_OUT_SLACK * choice.residual_rms);
    if let Some(smallest) = good_enough.min_by(|a, b| a.gain.total_cmp(&b.gain)).copied() {
        let is_end = |end: f64| (smallest.gain / end).ln().abs() < 1e-9;
        (choice.gain, choice.residual_rms) = (smallest.gain, smallest.residual_rms);
        choice.at_edge = is_end(GAIN_FACTORS.lower) || is_end(GAIN_FACTORS.upper);
    }
    Ok(choice)
}

/// All image gains of endocardia and epicardium times `factor`.
pub(super) fn scaled_gains(parameters: &Parameters, factor: f64) -> Result<Parameters, RunError> {
    let gains = [Parameter::ImageGainEndocardiumLv, Parameter::ImageGainEndocardiumRv, Parameter::ImageGainEpicardium];
    let mut scaled = parameters.clone();
    for gain in gains {
        scaled.set(gain, parameters[gain] * factor)?;
    }
    Ok(scaled)
}

/// Root mean square distance of the held-out points of all surfaces over all frames, mm.
pub(super) fn held_out_rms_mm(motion: &TrackedMotion) -> f64 {
    let values: Vec<f64> = motion.frames.iter().flat_map(|frame| frame.residuals.iter().filter_map(|r| r.held_out_rms_mm)).collect();
    crate::numerics::root_mean_square(&values)
}

/// Root mean square distance of one surface over all frames, mm.
pub(super) fn surface_rms_mm(motion: &TrackedMotion, tag: SurfaceTag) -> Option<f64> {
    let of_tag = |frame: &tracking::TrackedFrame| frame.residuals.iter().find(|r| r.tag == tag).map(|r| r.rms_mm);
    let values: Vec<f64> = motion.frames.iter().filter_map(of_tag).collect();
    (!values.is_empty()).then(|| crate::numerics::root_mean_square(&values))
}

pub(super) fn tracker_settings(plan: &Plan, patient: &Patient, images: &PatientImages) -> Result<TrackerSettings, RunError> {
    let period_s = patient.parameters[Parameter::HeartPeriod];
    let plan = &plan.tracking;
    let blocks = BlockMatchingSettings::default();
    let block_radius_voxels = (0.5 * (plan.block_size_mm / blocks.voxel_mm - 1.0)).round().max(1.0) as usize;
    let base = match plan.base {
        BaseMode::Free => TrackerBase::Free,
        BaseMode::Springs => TrackerBase::Springs,
        BaseMode::Recorded => match &plan.base_motion {
            Some(file) => TrackerBase::Recorded(read_base_motion(file, &patient.anatomy, period_s)?),
            None => TrackerBase::Springs,
        },
        BaseMode::BlockMatching => TrackerBase::BlockMatching(BlockMatchingSettings {
            similarity: plan.similarity,
            range_mm: plan.block_range_mm,
            block_radius_voxels,
            ..blocks
        }),
    };
    let boundary = BoundarySettings {
        range_mm: plan.search_range_mm,
        sample_mm: plan.search_step_mm,
        angle_none_deg: plan.max_angle_deg,
        slice_distance_mm: Some(images.slice_distance_mm),
        ..BoundarySettings::default()
    };
    Ok(TrackerSettings {
        reference_frame: images.reference_frame,
        scheme: plan.scheme,
        boundary,
        base,
        base_projection: plan.base_projection,
        held_out_share: plan.held_out_fraction,
        held_out_seed: plan.seed,
        ..TrackerSettings::default()
    })
}

/// A motion against labels that nothing was fitted to, one frame; `None` positions mean the mesh at rest.
pub(super) struct Validation {
    pub(super) frame: usize,
    pub(super) tracked: CavityAgreement,
    pub(super) no_motion: CavityAgreement,
}

/// Compares positions at the frames of a clock with the labels of the images.
pub(super) fn validate(patient: &Patient, images: &PatientImages, motion: &TrackedMotion) -> Vec<Validation> {
    let clock = patient.clock(1);
    let cavity = &patient.anatomy.cavities[0].1;
    let compare = |(frame, labels, code): &(usize, crate::image::LabelMap, u8)| {
        let place = clock.position_of(*frame)?;
        let state = motion.trajectory.frames.get(place)?;
        let against = |position_mm: &[_]| CavityAgreement::new(cavity, position_mm, labels, *code);
        Some(Validation { frame: *frame, tracked: against(&state.position_mm), no_motion: against(patient.anatomy.mesh.vertices_mm()) })
    };
    images.validation.iter().filter_map(compare).collect()
}
