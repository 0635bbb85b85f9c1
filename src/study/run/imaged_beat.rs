//! A beat of a heart whose truth is known, and the images that a scanner would take of it, \[Billet2009\] §6.1.

use std::sync::Arc;

use super::clock::Clock;
use super::error::RunError;
use super::forward::{beat, heart_model, step_count};
use super::patient::idealised_shape;
use crate::anatomy::Anatomy;
use crate::heart::{FrameState, HeartModel, Parameter, Parameters, Trajectory};
use crate::phantom::{
    PrescribedContraction, ShortAxisStack, SyntheticCine, SyntheticCineSettings, VoxelSampling, breath_hold_shifts_mm, synthetic_cine,
};
use crate::study::RunContext;
use crate::study::plan::{AnatomySource, ContractionPlan, PhantomPlan, Plan};
use crate::units::ml_from_mm3;

/// What was imaged, and the images.
pub(super) struct ImagedBeat {
    /// True parameters.
    pub(super) parameters: Parameters,
    /// The clock of the true beat; the images are its frames, and the first again at its end.
    pub(super) clock: Clock,
    /// The heart at those frames.
    pub(super) frames: Vec<FrameState>,
    /// The model and its beat; none where the motion is prescribed.
    pub(super) model: Option<(HeartModel, Trajectory)>,
    /// How it was imaged.
    pub(super) imaging: SyntheticCineSettings,
    /// The images with the truth in their voxels.
    pub(super) imaged: SyntheticCine,
}

/// Beats the heart of a plan, which has the shape of `anatomy` at `reference_s`, with its true parameters, and images the last beat.
pub(super) fn imaged_beat(
    plan: &Plan,
    phantom: &PhantomPlan,
    anatomy: &Arc<Anatomy>,
    reference_s: f64,
    context: &RunContext,
) -> Result<ImagedBeat, RunError> {
    let mut parameters = plan.parameters.clone();
    for (&parameter, &value) in &phantom.truth {
        parameters.set(parameter, value)?;
    }
    let period_s = parameters[Parameter::HeartPeriod];
    let times_s: Vec<f64> = (0..phantom.frames).map(|frame| reference_s + period_s * frame as f64 / phantom.frames as f64).collect();
    let clock = Clock::new(0, &times_s, period_s, plan.simulation.beats.count());
    let (model, frames) = match (&phantom.contraction, &plan.anatomy.source) {
        (Some(contraction), AnatomySource::IdealisedLv(shape)) => {
            (None, contracted(anatomy, &idealised_shape(shape), contraction, &clock.times_s, period_s))
        }
        _ => {
            let model = heart_model(&plan.model, anatomy, parameters.clone())?;
            context.progress().stage("beating the true heart", Some(step_count(&clock, plan.model.step_s)));
            let trajectory = beat(&model, &clock, &[], context)?;
            if trajectory.stopped {
                return Err(RunError::Stopped);
            }
            let frames = trajectory.frames.clone();
            (Some((model, trajectory)), frames)
        }
    };
    context.progress().stage("imaging the true heart", None);
    let stack =
        ShortAxisStack { voxel_mm: phantom.voxel_size_mm, slice_distance_mm: phantom.slice_distance_mm, ..ShortAxisStack::default() };
    let grid = stack.grid(anatomy)?;
    let imaging = imaging(phantom, grid.shape()[2]);
    let positions: Vec<_> = frames[..phantom.frames].iter().map(|frame| frame.position_mm.clone()).collect();
    let imaged = synthetic_cine(anatomy, &positions, &times_s, period_s, &grid, &imaging)?;
    Ok(ImagedBeat { parameters, clock, frames, model, imaging, imaged })
}

/// The heart at the times of a prescribed contraction; no pressures are known of it.
fn contracted(
    anatomy: &Anatomy,
    shape: &crate::phantom::IdealisedLv,
    plan: &ContractionPlan,
    times_s: &[f64],
    period_s: f64,
) -> Vec<FrameState> {
    let motion = PrescribedContraction {
        ejection_fraction: plan.ejection_fraction,
        shortening: plan.shortening,
        twist_rad: plan.twist_deg.to_radians(),
    };
    let frame = |&time_s: &f64| {
        let share = PrescribedContraction::share_at(time_s, plan.systole_s, period_s);
        let position_mm = motion.positions_mm(shape, anatomy.mesh.vertices_mm(), share);
        let volume_ml = anatomy.cavities.iter().map(|(_, cavity)| ml_from_mm3(cavity.volume_mm3(&position_mm))).collect();
        FrameState { time_s, position_mm, volume_ml, pressure_kpa: Vec::new() }
    };
    times_s.iter().map(frame).collect()
}

/// How slices average that are as thick and as far apart as this.
pub(super) fn slice_sampling(thickness_mm: f64, distance_mm: f64) -> VoxelSampling {
    /// Samples along a slice are no farther apart than this, mm.
    const SAMPLE_MM: f64 = 4.0;
    let planes = (thickness_mm / SAMPLE_MM).ceil().max(2.0) as usize;
    VoxelSampling { samples_per_voxel: [2, 2, planes], thickness_share: thickness_mm / distance_mm }
}

/// How a phantom is imaged.
pub(super) fn imaging(phantom: &PhantomPlan, slice_count: usize) -> SyntheticCineSettings {
    let default = SyntheticCineSettings::default();
    SyntheticCineSettings {
        sampling: slice_sampling(phantom.slice_thickness_mm, phantom.slice_distance_mm),
        blood: phantom.blood,
        wall: phantom.wall,
        background: phantom.background,
        wall_texture: phantom.texture,
        wall_texture_length_mm: phantom.texture_length_mm,
        noise: phantom.noise * phantom.blood,
        bias: phantom.bias,
        slice_shifts_mm: if phantom.slice_shift_sd_mm > 0.0 {
            breath_hold_shifts_mm(slice_count, phantom.slice_shift_sd_mm, phantom.seed)
        } else {
            Vec::new()
        },
        seed: phantom.seed,
        ..default
    }
}
