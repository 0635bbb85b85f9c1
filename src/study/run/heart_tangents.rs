//! The heart as a model with tangents: all of them in one pass beside the simulation, or by finite differences where the study or the
//! model wants that.

use std::ops::ControlFlow;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use nalgebra::DVector;

use super::calibration::{SimulationFailure, calibration_trajectory, simulate_at, simulation_plan};
use super::clock::Clock;
use crate::heart::{HeartModel, Parameter, RegionalParameter, TangentError, simulate_with_tangents};
use crate::personalisation::{
    CalibrationFrame, CalibrationTrajectory, DifferenceScheme, FiniteDifferenceModel, FreeParameter, ParameterSpace, TangentModel,
    WithTangents,
};
use crate::study::plan::Tangents;

/// Relative step of the finite differences, in the coordinates (a logarithm where the parameter is positive).
const DIFFERENCE_STEP: f64 = 2e-3;
/// Step of differences of depolarisation times, which are smooth.
const ACTIVATION_STEP: f64 = 1e-5;
/// Simulations that a pass with tangents counts as, and what each parameter adds: 20 parameters in 4, 40 in 7 free beats. That is a convention, so
/// that a search and its tables are the same on every machine; what passes took by the clock is reported beside it.
const PASS_COST: f64 = 1.0;
const PARAMETER_COST: f64 = 0.15;

/// Whoever asks whether to stop.
type Stop<'a> = &'a (dyn Fn() -> bool + Sync);
type Differences<'a> = FiniteDifferenceModel<
    Box<dyn Fn(&DVector<f64>) -> Result<CalibrationTrajectory, SimulationFailure> + Sync + 'a>,
    CalibrationTrajectory,
>;

/// The free heart over the coordinates of a space.
pub(super) struct HeartTangents<'a> {
    base: &'a HeartModel,
    space: &'a ParameterSpace,
    clock: &'a Clock,
    is_stopped: Stop<'a>,
    tangents: Tangents,
    differences: Differences<'a>,
    clocked: Mutex<Clocked>,
}

/// Seconds that simulations and passes with tangents have taken.
#[derive(Debug, Clone, Copy, Default)]
struct Clocked {
    simulations: (f64, u32),
    passes: (f64, u32),
}

impl<'a> HeartTangents<'a> {
    /// A model; where the heart has no tangents, as where a step was taken in halves, there are differences whatever the study says.
    pub(super) fn new(base: &'a HeartModel, space: &'a ParameterSpace, clock: &'a Clock, tangents: Tangents, is_stopped: Stop<'a>) -> Self {
        let simulate = move |coordinates: &DVector<f64>| simulate_at(base, space, clock, coordinates, is_stopped);
        let steps = DVector::from_iterator(space.dimension(), space.free().map(difference_step));
        let differences =
            FiniteDifferenceModel::new(Box::new(simulate) as Box<_>, DifferenceScheme::Forward, steps, space.lower(), space.upper());
        Self { base, space, clock, is_stopped, tangents, differences, clocked: Mutex::default() }
    }

    /// What a pass with tangents took by the clock, in simulations; none before there was one of each. The searches count what is the same in
    /// every run, [`TangentModel::tangent_cost`].
    pub(super) fn clocked_pass_cost(&self) -> Option<f64> {
        let Clocked { simulations, passes } = *self.clocked.lock().unwrap_or_else(PoisonError::into_inner);
        let mean = |(seconds, count): (f64, u32)| (count > 0).then(|| seconds / f64::from(count));
        Some(mean(passes)? / mean(simulations)?)
    }

    /// The trajectory with its tangents in one pass.
    fn in_one_pass(&self, coordinates: &DVector<f64>) -> WithTangents<CalibrationTrajectory, SimulationFailure> {
        let parameters = self.space.to_parameters(coordinates)?;
        let slopes: Vec<f64> = self.space.free().map(|entry| entry.transform.slope(parameters[entry.parameter])).collect();
        let model = self.base.with_parameters(parameters)?;
        let free: Vec<RegionalParameter> = self.space.free().map(|entry| entry.parameter).collect();
        let mut observer = |_: &_, _: &_| if (self.is_stopped)() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let (trajectory, tangents) = simulate_with_tangents(&model, &simulation_plan(self.clock), &[], &free, &mut observer)?;
        if trajectory.stopped {
            return Err(SimulationFailure::Stopped);
        }
        let here = calibration_trajectory(&model, &trajectory);
        let tangent = |(index, (tangent, &slope)): (usize, (&_, &f64))| -> Result<CalibrationTrajectory, SimulationFailure> {
            let activation_s = self.activation_tangent_s(&model, coordinates, index)?;
            Ok(CalibrationTrajectory { activation_s, ..scaled(calibration_trajectory(&model, tangent), slope) })
        };
        let tangents: Result<Vec<_>, _> = tangents.iter().zip(&slopes).enumerate().map(tangent).collect();
        Ok((here, tangents?))
    }

    /// dtd/dθ by a difference of two activation maps, which cost next to nothing.
    fn activation_tangent_s(&self, model: &HeartModel, coordinates: &DVector<f64>, index: usize) -> Result<Vec<f64>, SimulationFailure> {
        use Parameter::{AnisotropyRatio, ConductionVelocity, EndocardialSpeedFactor, OnsetTime};
        let here_s = model.activation().times_s();
        let moves = self.space.free().nth(index).map(|entry| entry.parameter.parameter());
        if !matches!(moves, Some(AnisotropyRatio | ConductionVelocity | EndocardialSpeedFactor | OnsetTime)) {
            return Ok(vec![0.0; here_s.len()]);
        }
        let step = if coordinates[index] + ACTIVATION_STEP > self.space.upper()[index] { -ACTIVATION_STEP } else { ACTIVATION_STEP };
        let mut there = coordinates.clone();
        there[index] += step;
        let there = model.with_parameters(self.space.to_parameters(&there)?)?;
        Ok(there.activation().times_s().iter().zip(here_s).map(|(there, here)| (there - here) / step).collect())
    }
}

impl TangentModel for HeartTangents<'_> {
    type Trajectory = CalibrationTrajectory;
    type Error = SimulationFailure;

    fn simulate(&self, coordinates: &DVector<f64>) -> Result<CalibrationTrajectory, SimulationFailure> {
        let begun = Instant::now();
        let simulated = self.differences.simulate(coordinates);
        if simulated.is_ok() {
            add(&mut self.clocked.lock().unwrap_or_else(PoisonError::into_inner).simulations, begun);
        }
        simulated
    }

    fn simulate_with_tangents(&self, coordinates: &DVector<f64>) -> WithTangents<CalibrationTrajectory, SimulationFailure> {
        let begun = Instant::now();
        let passed = match self.tangents {
            Tangents::FiniteDifferences => self.differences.simulate_with_tangents(coordinates),
            Tangents::Analytic => match self.in_one_pass(coordinates) {
                Err(SimulationFailure::Tangent(TangentError::NoTangent { .. })) => self.differences.simulate_with_tangents(coordinates),
                other => other,
            },
        };
        if passed.is_ok() {
            add(&mut self.clocked.lock().unwrap_or_else(PoisonError::into_inner).passes, begun);
        }
        passed
    }

    fn tangent_cost(&self, dimension: usize) -> f64 {
        match self.tangents {
            Tangents::FiniteDifferences => self.differences.tangent_cost(dimension),
            Tangents::Analytic => PASS_COST + PARAMETER_COST * dimension as f64,
        }
    }
}

fn add(to: &mut (f64, u32), begun: Instant) {
    *to = (to.0 + begun.elapsed().as_secs_f64(), to.1 + 1);
}

/// A step that is relative in a logarithm, and a small part of the bounds otherwise.
fn difference_step(free: &FreeParameter) -> f64 {
    let width = free.transform.to_coordinate(free.upper) - free.transform.to_coordinate(free.lower);
    DIFFERENCE_STEP * width.min(1.0)
}

/// dp/dθ times a tangent by p.
fn scaled(tangent: CalibrationTrajectory, slope: f64) -> CalibrationTrajectory {
    let frame = |frame: CalibrationFrame| CalibrationFrame {
        volume_ml: frame.volume_ml.into_iter().map(|volume| volume * slope).collect(),
        pressure_kpa: frame.pressure_kpa.into_iter().map(|pressure| pressure * slope).collect(),
        position_mm: frame.position_mm.into_iter().map(|position| position * slope).collect(),
    };
    CalibrationTrajectory { frames: tangent.frames.into_iter().map(frame).collect(), activation_s: tangent.activation_s }
}
