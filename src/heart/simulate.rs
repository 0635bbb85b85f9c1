//! Beats: steps from a start to an end, the curves they leave and the frames at the times of the images.

use std::ops::ControlFlow;

use nalgebra::Vector3;

use super::{CurveRow, HeartModel, HeartState, StepError, StepOutcome};
use crate::mechanics::StepLoad;
use crate::units::ml_from_mm3;

/// From when to when a heart beats, and at which instants it is looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationPlan {
    /// Start, s; the mesh rests there, or at the first depolarisation if that comes before, see
    /// [`state_at_start`](HeartModel::state_at_start).
    pub start_time_s: f64,
    /// End, s; the last step reaches or passes it.
    pub end_time_s: f64,
    /// Instants of the frames, s, ascending; those outside the simulation give no frame.
    pub frame_times_s: Vec<f64>,
}

/// The heart at the time of an image, interpolated linearly between two steps.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameState {
    /// Time, s.
    pub time_s: f64,
    /// Position of every vertex, mm.
    pub position_mm: Vec<Vector3<f64>>,
    /// Cavity volumes, mL, left first.
    pub volume_ml: Vec<f64>,
    /// Cavity pressures, kPa, left first.
    pub pressure_kpa: Vec<f64>,
}

/// What a simulation leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// One row a step, the start first.
    pub curves: Vec<CurveRow>,
    /// One a frame time within the simulation.
    pub frames: Vec<FrameState>,
    /// Steps that were taken in parts because the whole did not converge.
    pub divided_step_count: usize,
    /// Rounds of the volume linearisation in all steps together; zero in a tangent.
    pub round_count: usize,
    /// Largest difference that a step left between a cavity's volume and what its valves let through, mL; likewise.
    pub volume_defect_ml: f64,
    /// Where it ended.
    pub last: HeartState,
    /// Whether the observer stopped it before its end.
    pub stopped: bool,
}

/// Beats a heart under the loads of data (none for the free heart) from the start of the plan, see
/// [`state_at_start`](HeartModel::state_at_start). `observer` sees the start and every step and may stop.
///
/// # Errors
/// The [`StepError`] of the first step that fails.
pub fn simulate(
    model: &HeartModel,
    plan: &SimulationPlan,
    loads: &[&dyn StepLoad],
    observer: &mut dyn FnMut(&HeartState, &CurveRow) -> ControlFlow<()>,
) -> Result<Trajectory, StepError> {
    let start = model.state_at_start(plan.start_time_s, &mut model.workspace())?;
    simulate_from(model, start, plan, loads, observer)
}

/// Beats a heart on from any state; the plan's start time is that of the state.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_from(
    model: &HeartModel,
    start: HeartState,
    plan: &SimulationPlan,
    loads: &[&dyn StepLoad],
    observer: &mut dyn FnMut(&HeartState, &CurveRow) -> ControlFlow<()>,
) -> Result<Trajectory, StepError> {
    let mut workspace = model.workspace();
    let step_count = step_count(&start, plan, model.settings().step_s);
    let (mut recording, mut last) = (Recording::new(&start, plan, model.settings().step_s), start);
    let mut is_stopped = recording.show(&last, observer);
    for _ in 0..step_count {
        if is_stopped {
            break;
        }
        let outcome = model.step(&last, loads, &mut workspace)?;
        recording.count(&outcome);
        recording.add(&last, &outcome.state);
        last = outcome.state;
        is_stopped = recording.show(&last, observer);
    }
    Ok(recording.into_trajectory(last, is_stopped))
}

/// Steps from a state to the end of a plan.
pub(super) fn step_count(start: &HeartState, plan: &SimulationPlan, step_s: f64) -> usize {
    ((plan.end_time_s - start.time_s) / step_s - 1e-9).ceil().max(0.0) as usize
}

/// A trajectory that grows step by step; its frames are taken while it does.
pub(super) struct Recording<'a> {
    curves: Vec<CurveRow>,
    frames: Vec<FrameState>,
    divided_step_count: usize,
    round_count: usize,
    volume_defect_ml: f64,
    coming_frames_s: &'a [f64],
    tolerance_s: f64,
}

impl<'a> Recording<'a> {
    pub(super) fn new(start: &HeartState, plan: &'a SimulationPlan, step_s: f64) -> Self {
        let tolerance_s = 1e-9 * step_s;
        let first = plan.frame_times_s.partition_point(|&t| t < start.time_s - tolerance_s);
        Self {
            curves: vec![start.curve_row()],
            frames: Vec::new(),
            divided_step_count: 0,
            round_count: 0,
            volume_defect_ml: 0.0,
            coming_frames_s: &plan.frame_times_s[first..],
            tolerance_s,
        }
    }

    /// Adds a step.
    pub(super) fn add(&mut self, before: &HeartState, after: &HeartState) {
        let reached_s = after.time_s + self.tolerance_s;
        while let Some((&time_s, later)) = self.coming_frames_s.split_first().filter(|(time_s, _)| **time_s <= reached_s) {
            self.frames.push(FrameState::between(before, after, time_s));
            self.coming_frames_s = later;
        }
        self.curves.push(after.curve_row());
    }

    /// Counts what a step took and left.
    pub(super) fn count(&mut self, step: &StepOutcome) {
        self.divided_step_count += usize::from(step.substep_count > 1);
        self.round_count += step.round_count;
        self.volume_defect_ml = self.volume_defect_ml.max(step.volume_defect_ml);
    }

    /// Shows the last state to an observer, and says whether it wants to stop.
    pub(super) fn show(&self, last: &HeartState, observer: &mut dyn FnMut(&HeartState, &CurveRow) -> ControlFlow<()>) -> bool {
        self.curves.last().is_some_and(|row| observer(last, row).is_break())
    }

    pub(super) fn into_trajectory(self, last: HeartState, stopped: bool) -> Trajectory {
        let Self { curves, frames, divided_step_count, round_count, volume_defect_ml, .. } = self;
        Trajectory { curves, frames, divided_step_count, round_count, volume_defect_ml, last, stopped }
    }
}

impl FrameState {
    /// The heart between two states.
    fn between(before: &HeartState, after: &HeartState, time_s: f64) -> Self {
        let weight = ((time_s - before.time_s) / (after.time_s - before.time_s)).clamp(0.0, 1.0);
        let pairs = before.motion.position_mm.iter().zip(&after.motion.position_mm);
        let mixed = |value: fn(&super::VentricleState) -> f64| {
            before.ventricles.iter().zip(&after.ventricles).map(|(b, a)| value(b) + (value(a) - value(b)) * weight).collect()
        };
        Self {
            time_s,
            position_mm: pairs.map(|(b, a)| b + (a - b) * weight).collect(),
            volume_ml: mixed(|state| ml_from_mm3(state.volume_mm3)),
            pressure_kpa: mixed(|state| state.pressure_kpa),
        }
    }
}
