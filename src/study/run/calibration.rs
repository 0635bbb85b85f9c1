//! The heart as the calibration sees it: simulated beats at the frames, and residuals against what is known of the real one.

use std::ops::ControlFlow;

use nalgebra::{DVector, Vector3};

use super::clock::Clock;
use super::data_table::{activation_times, pressures};
use super::error::RunError;
use super::measured::MeasuredVolumes;
use super::patient::Patient;
use super::replica::TrackingBias;
use super::synthetic::Truth;
use super::track::Tracked;
use crate::anatomy::{Anatomy, Ventricle};
use crate::heart::{HeartModel, Parameters, SimulationPlan, StepError, TangentError, Trajectory, simulate};
use crate::mesh::SurfaceTag;
use crate::personalisation::{
    ActivationResidual, BoundaryResidual, CalibrationFrame, CalibrationTrajectory, Loss, ParameterSpace, PersonalisationError,
    PressureResidual, StackedResidual, SurfaceTarget, VolumeCurveResidual,
};
use crate::study::plan::{BoundaryData, DataPlan, VolumeData};

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
    #[error(transparent)]
    Tangent(#[from] TangentError),
    #[error("stopped")]
    Stopped,
}

/// The free heart at coordinates, as residuals look at it.
pub(super) fn simulate_at(
    base: &HeartModel,
    space: &ParameterSpace,
    clock: &Clock,
    coordinates: &DVector<f64>,
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<CalibrationTrajectory, SimulationFailure> {
    let (model, trajectory) = simulate_parameters(base, space.to_parameters(coordinates)?, clock, is_stopped)?;
    Ok(calibration_trajectory(&model, &trajectory))
}

/// The free heart with other parameters, at the frames of a clock.
pub(super) fn simulate_parameters(
    base: &HeartModel,
    parameters: Parameters,
    clock: &Clock,
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<(HeartModel, Trajectory), SimulationFailure> {
    let model = base.with_parameters(parameters)?;
    let mut observer = |_: &_, _: &_| if is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let trajectory = simulate(&model, &simulation_plan(clock), &[], &mut observer)?;
    if trajectory.stopped { Err(SimulationFailure::Stopped) } else { Ok((model, trajectory)) }
}

/// The run of a clock.
pub(super) fn simulation_plan(clock: &Clock) -> SimulationPlan {
    SimulationPlan { start_time_s: clock.start_s, end_time_s: clock.end_s, frame_times_s: clock.times_s.clone() }
}

/// What the residuals look at.
pub(super) fn calibration_trajectory(model: &HeartModel, trajectory: &Trajectory) -> CalibrationTrajectory {
    let frame = |state: &crate::heart::FrameState| CalibrationFrame {
        volume_ml: state.volume_ml.clone(),
        pressure_kpa: state.pressure_kpa.clone(),
        position_mm: state.position_mm.clone(),
    };
    CalibrationTrajectory { frames: trajectory.frames.iter().map(frame).collect(), activation_s: model.activation().times_s().to_vec() }
}

/// Everything that the study wants the parameters to explain, part by part, where boundaries and base are tracked with a `bias`.
pub(super) fn residual<'a>(
    data: &DataPlan,
    patient: &Patient,
    clock: &Clock,
    measured: &MeasuredVolumes,
    tracked: &Tracked,
    bias: &TrackingBias,
) -> Result<StackedResidual<'a, CalibrationTrajectory>, RunError> {
    let mut stack = StackedResidual::default();
    if data.volumes != Some(VolumeData::None) {
        stack = stack.with("volume_lv", VolumeCurveResidual::new(Ventricle::Left, measured.left_ml.clone(), data.sigma_volume_ml)?);
        if let (Some(right_ml), Some(sigma_ml)) = (&measured.right_ml, right_sigma_ml(data, measured)) {
            stack = stack.with("volume_rv", VolumeCurveResidual::new(Ventricle::Right, right_ml.clone(), sigma_ml)?);
        }
    }
    let anatomy = &patient.anatomy;
    let targets = match (data.boundary, &patient.truth) {
        (BoundaryData::None, _) => Vec::new(),
        (BoundaryData::Truth, Some(truth)) => true_targets(anatomy, truth),
        (BoundaryData::Tracked | BoundaryData::Truth, _) => tracked_targets(anatomy, tracked),
    };
    if !targets.is_empty() {
        let mut boundary = BoundaryResidual::new(&targets, data.sigma_boundary_mm)?.with_loss(Loss::Huber { threshold: HUBER_THRESHOLD });
        if data.boundary == BoundaryData::Tracked {
            boundary = boundary.less_bias(&bias.boundary_mm);
        }
        stack = stack.with("boundary", boundary);
    }
    if let Some(sigma_mm) = data.sigma_base_mm {
        let base = BoundaryResidual::new(&base_targets(anatomy, clock, tracked), sigma_mm)?.less_bias(&bias.base_mm);
        stack = stack.with("base", base);
    }
    if let Some(file) = &data.pressures {
        for (ventricle, measured) in pressures(file, clock)? {
            let name = if ventricle == Ventricle::Left { "pressure_lv" } else { "pressure_rv" };
            stack = stack.with(name, PressureResidual::new(ventricle, measured, data.sigma_pressure_kpa)?);
        }
    }
    if let Some(file) = &data.activation_times {
        stack = stack.with("activation", ActivationResidual::new(activation_times(file, anatomy)?, data.sigma_activation_s)?);
    }
    Ok(stack)
}

/// The right ventricle counts where the study says so, or where it was measured beside the left one.
fn right_sigma_ml(data: &DataPlan, measured: &MeasuredVolumes) -> Option<f64> {
    data.sigma_volume_rv_ml.or(measured.is_measured.then_some(data.sigma_volume_ml))
}

/// The boundary points of all frames, grouped by surface and AHA segment.
pub(super) fn tracked_targets(anatomy: &Anatomy, tracked: &Tracked) -> Vec<SurfaceTarget> {
    let segments = vertex_segments(anatomy);
    let mut targets = Vec::new();
    // The first frame is the mesh as it was drawn, which hardly any parameter moves.
    for (place, frame) in tracked.motion.frames.iter().enumerate().skip(1) {
        for surface in &frame.targets {
            targets.extend(surface.targets.iter().filter(|target| target.confidence > 0.0).map(|target| SurfaceTarget {
                frame: place,
                vertex: target.vertex,
                point_mm: target.point_mm,
                normal: target.image_normal,
                confidence: target.confidence * target.area_mm2,
                group: group(surface.tag, segments[target.vertex]),
            }));
        }
    }
    targets
}

/// The surfaces of a phantom's true heart, point for point those of the model.
fn true_targets(anatomy: &Anatomy, truth: &Truth) -> Vec<SurfaceTarget> {
    let segments = vertex_segments(anatomy);
    let mut targets = Vec::new();
    for (frame, state) in truth.frames.iter().enumerate().skip(1) {
        for &tag in [SurfaceTag::EndocardiumLv, SurfaceTag::EndocardiumRv, SurfaceTag::Epicardium].iter() {
            let areas = anatomy.surface.vertex_area_vectors_mm2(tag, &state.position_mm);
            targets.extend(anatomy.surface.vertices_with(tag).into_iter().filter(|&vertex| areas[vertex].norm() > 0.0).map(|vertex| {
                let (point_mm, normal) = (state.position_mm[vertex], areas[vertex]);
                SurfaceTarget { frame, vertex, point_mm, normal, confidence: normal.norm(), group: group(tag, segments[vertex]) }
            }));
        }
    }
    targets
}

/// Where block matching has found the base: its mean along each axis of the heart, a frame.
pub(super) fn base_targets(anatomy: &Anatomy, clock: &Clock, tracked: &Tracked) -> Vec<SurfaceTarget> {
    let Some(matches) = &tracked.motion.base else { return Vec::new() };
    let long = anatomy.axes.long_axis;
    let axes: [Vector3<f64>; 3] = [long, anatomy.axes.septal_direction, long.cross(&anatomy.axes.septal_direction)];
    let mut targets = Vec::new();
    for (frame, &time_s) in clock.times_s.iter().enumerate().skip(1) {
        for (place, &vertex) in matches.vertices().iter().enumerate() {
            let (displacement_mm, confidence) = matches.at(place, time_s);
            let point_mm = anatomy.mesh.vertices_mm()[vertex] + displacement_mm;
            targets.extend(axes.iter().enumerate().map(|(axis, &normal)| {
                let group = surface_number(SurfaceTag::Base) * 100 + axis as u32;
                SurfaceTarget { frame, vertex, point_mm, normal, confidence, group }
            }));
        }
    }
    targets
}

fn group(tag: SurfaceTag, segment: u8) -> u32 {
    surface_number(tag) * 100 + u32::from(segment)
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
