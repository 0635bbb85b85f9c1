//! The proactive heart on a patient's images: gains as written or chosen on held-out boundary points, then the tracked beat.

use std::ops::ControlFlow;

use super::error::RunError;
use super::forward::{heart_model, step_count};
use super::gains::{ChosenGains, GAINS, Trial, choose_gains, scaled_gains};
use super::patient::{Patient, PatientImages};
use super::recorded_base::read_base_motion;
use crate::heart::{HeartModel, Parameter, Parameters};
use crate::mesh::SurfaceTag;
use crate::study::RunContext;
use crate::study::plan::{BaseMode, Plan, WallMode};
use crate::tracking::{
    self, BaseMode as TrackerBase, BlockMatchingSettings, BoundarySettings, CavityAgreement, TrackedMotion, TrackerSettings, WallSettings,
    track,
};

/// A tracked beat and the gains it was tracked with.
pub(super) struct Tracked {
    pub(super) motion: TrackedMotion,
    pub(super) parameters: Parameters,
    /// The factors on the gains that were tried, with their errors, where the study lets the data choose.
    pub(super) gain_choices: Vec<ChosenGains>,
}

impl Tracked {
    /// Itself, if it was not stopped on its way.
    pub(super) fn whole(self) -> Result<Self, RunError> {
        if self.motion.trajectory.stopped { Err(RunError::Stopped) } else { Ok(self) }
    }
}

/// Tracks a patient with the heart of `parameters`; the motion ends where it was stopped.
pub(super) fn track_patient(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    parameters: Parameters,
    context: &RunContext,
) -> Result<Tracked, RunError> {
    let model = heart_model(&plan.model, &patient.anatomy, parameters)?;
    let settings = tracker_settings(plan, patient, images)?;
    let trial = Trial { images, settings: &settings, context };
    let (model, gain_choices) = choose_gains(model, plan.tracking.gains, plan.tracking.noise_mm, &trial)?;
    context.progress().stage("tracking the images", Some(step_count(&patient.clock(1), plan.model.step_s)));
    let motion = motion_until_stopped(&model, images, &settings, context)?;
    for warning in &motion.warnings {
        context.progress().warning(warning);
    }
    Ok(Tracked { motion, parameters: model.parameters().clone(), gain_choices })
}

/// Tracks the same images with the heart of other `parameters`, at `factor` times the gains of an earlier time.
pub(super) fn track_again(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    parameters: &Parameters,
    earlier: &Tracked,
    factor: f64,
    context: &RunContext,
) -> Result<Tracked, RunError> {
    let mut parameters = parameters.clone();
    for gain in GAINS {
        parameters.set(gain, earlier.parameters[gain])?;
    }
    let model = heart_model(&plan.model, &patient.anatomy, scaled_gains(&parameters, factor)?)?;
    let settings = tracker_settings(plan, patient, images)?;
    context.progress().stage("tracking the images with the heart that was found", Some(step_count(&patient.clock(1), plan.model.step_s)));
    let motion = tracked_beat(&model, images, &settings, context)?;
    Ok(Tracked { motion, parameters: model.parameters().clone(), gain_choices: Vec::new() })
}

/// The whole tracked beat.
pub(super) fn tracked_beat(
    model: &HeartModel,
    images: &PatientImages,
    settings: &TrackerSettings,
    context: &RunContext,
) -> Result<TrackedMotion, RunError> {
    let motion = motion_until_stopped(model, images, settings, context)?;
    if motion.trajectory.stopped { Err(RunError::Stopped) } else { Ok(motion) }
}

fn motion_until_stopped(
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
    Ok(track(model, &images.cine, settings, &mut observer)?)
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
    let blocks = BlockMatchingSettings {
        similarity: plan.similarity,
        range_mm: plan.block_range_mm,
        block_radius_voxels,
        shape: plan.block_shape,
        window: plan.block_window,
        ..blocks
    };
    let base = match plan.base {
        BaseMode::Free => TrackerBase::Free,
        BaseMode::Springs => TrackerBase::Springs,
        BaseMode::Recorded => match &plan.base_motion {
            Some(file) => TrackerBase::Recorded(read_base_motion(file, &patient.anatomy, period_s)?),
            None => TrackerBase::Springs,
        },
        BaseMode::BlockMatching => TrackerBase::BlockMatching(blocks),
    };
    let wall = match plan.wall {
        WallMode::Model => None,
        WallMode::BlockMatching => Some(WallSettings { blocks, gain_kpa_per_mm2: plan.wall_gain_kpa_per_mm2 }),
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
        wall,
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
