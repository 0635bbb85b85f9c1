//! The heart as the calibration sees it: simulated beats at the frames, residuals against tracked volumes and boundaries.

use std::ops::ControlFlow;

use nalgebra::DVector;

use super::clock::Clock;
use super::error::RunError;
use super::measured::MeasuredVolumes;
use super::track::Tracked;
use crate::anatomy::{Anatomy, Ventricle};
use crate::heart::{HeartModel, Parameters, SimulationPlan, StepError, Trajectory, simulate};
use crate::mesh::SurfaceTag;
use crate::personalisation::{
    BoundaryResidual, CalibrationFrame, CalibrationTrajectory, Loss, ParameterSpace, PersonalisationError, StackedResidual, SurfaceTarget,
    VolumeCurveResidual,
};
use crate::study::plan::PersonalisationPlan;

/// Rows beyond this many standard deviations count linearly.
const HUBER_THRESHOLD: f64 = 1.345;

/// Why a simulation at some coordinates failed.
#[derive(Debug, thiserror::Error)]
pub(super) enum SimulationFailure {
    #[error(transparent)]
    Coordinates(#[from] PersonalisationError),
    #[error(transparent)]
    Heart(#[from] crate::heart::HeartError),
    #[error(transparent)]
    Step(#[from] StepError),
    #[error("stopped")]
    Stopped,
}

/// The free heart at coordinates, at the frames of a clock.
pub(super) fn simulate_at(
    base: &HeartModel,
    space: &ParameterSpace,
    clock: &Clock,
    coordinates: &DVector<f64>,
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<Trajectory, SimulationFailure> {
    simulate_parameters(base, space.to_parameters(coordinates)?, clock, is_stopped)
}

/// The free heart with other parameters, at the frames of a clock.
pub(super) fn simulate_parameters(
    base: &HeartModel,
    parameters: Parameters,
    clock: &Clock,
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<Trajectory, SimulationFailure> {
    let model = base.with_parameters(parameters)?;
    let plan = SimulationPlan { start_time_s: clock.start_s, end_time_s: clock.end_s, frame_times_s: clock.times_s.clone() };
    let mut observer = |_: &_, _: &_| if is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let trajectory = simulate(&model, &plan, &[], &mut observer)?;
    if trajectory.stopped { Err(SimulationFailure::Stopped) } else { Ok(trajectory) }
}

/// What the residuals look at.
pub(super) fn calibration_trajectory(trajectory: &Trajectory) -> CalibrationTrajectory {
    let frame = |state: &crate::heart::FrameState| CalibrationFrame {
        volume_ml: state.volume_ml.clone(),
        pressure_kpa: state.pressure_kpa.clone(),
        position_mm: state.position_mm.clone(),
    };
    CalibrationTrajectory { frames: trajectory.frames.iter().map(frame).collect() }
}

/// Volume curves and boundary distances as one residual.
pub(super) fn residual<'a>(
    plan: &PersonalisationPlan,
    anatomy: &Anatomy,
    measured: &MeasuredVolumes,
    tracked: &Tracked,
) -> Result<StackedResidual<'a, CalibrationTrajectory>, RunError> {
    let volume = VolumeCurveResidual::new(Ventricle::Left, measured.left_ml.clone(), plan.sigma_volume_ml)?;
    let boundary = BoundaryResidual::new(&surface_targets(anatomy, tracked), plan.sigma_boundary_mm)?
        .with_loss(Loss::Huber { threshold: HUBER_THRESHOLD });
    let stack = StackedResidual::default().with("volume_lv", volume);
    let stack = match &measured.right_ml {
        Some(right_ml) => stack.with("volume_rv", VolumeCurveResidual::new(Ventricle::Right, right_ml.clone(), plan.sigma_volume_ml)?),
        None => stack,
    };
    Ok(stack.with("boundary", boundary))
}

/// The boundary points of all frames, grouped by surface and AHA segment.
fn surface_targets(anatomy: &Anatomy, tracked: &Tracked) -> Vec<SurfaceTarget> {
    let segments = vertex_segments(anatomy);
    let mut targets = Vec::new();
    // The first frame is the mesh at rest, which no parameter moves.
    for (place, frame) in tracked.motion.frames.iter().enumerate().skip(1) {
        for surface in &frame.targets {
            let group = |vertex: usize| surface_number(surface.tag) * 100 + u32::from(segments[vertex]);
            targets.extend(surface.targets.iter().filter(|target| target.confidence > 0.0).map(|target| SurfaceTarget {
                frame: place,
                vertex: target.vertex,
                point_mm: target.point_mm,
                normal: target.image_normal,
                confidence: target.confidence * target.area_mm2,
                group: group(target.vertex),
            }));
        }
    }
    targets
}

fn surface_number(tag: SurfaceTag) -> u32 {
    match tag {
        SurfaceTag::EndocardiumLv => 1,
        SurfaceTag::EndocardiumRv => 2,
        SurfaceTag::Epicardium => 3,
        SurfaceTag::Base => 4,
    }
}

/// The AHA segment of every vertex: that of its first tetrahedron.
fn vertex_segments(anatomy: &Anatomy) -> Vec<u8> {
    let mut segments = vec![0; anatomy.mesh.vertex_count()];
    for (corners, &segment) in anatomy.mesh.tetrahedra().iter().zip(&anatomy.aha_segments).rev() {
        for &vertex in corners {
            segments[vertex] = segment;
        }
    }
    segments
}
