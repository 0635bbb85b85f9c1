//! Tangent-linear derivatives of a whole simulation by many parameters, taken along with it in one pass.
//!
//! A step solves $(\tilde K + K_{img})\,Y = F + \sum_k p_k L_k$ with the valves' conditions on the pressures. Where a parameter changes,
//!
//! $$(\tilde K + K_{img})\,dY = dF - (d\tilde K + dK_{img})\,Y + \sum_k dp_k\,L_k, \qquad dY = dy_0 + \sum_k dp_k\,W_k,$$
//!
//! where dF has what the last step's derivatives leave on the right and what the parameter itself changes. The cavities' volumes change by
//! $\partial_y V_k(Y) \cdot dY$, and the valves that are open make the dp a system of one or two unknowns
//! ([`ValveRates`](crate::circulation::ValveRates)). All parameters share the factor: one pass of triangular solves with many columns.
//!
//! In corotational kinematics the tangent of the step that has been taken stands in the place of $\tilde K$, and the internal forces change
//! with the state that the step began with, see `internal_force`. Loads of data have derivatives of their own
//! ([`LoadTangent`](crate::mechanics::LoadTangent)).
//!
//! The derivatives are those of the discrete simulation, exact but for rounding, the tolerance of iterative solves and, in passive properties
//! and internal forces, central differences of what is assembled (1e-9). They are one-sided where a valve opens or shuts, or a vertex is
//! depolarised or repolarised, just at the end of a step, and where two fronts meet.

mod internal_force;
mod linearised;
mod rates;
mod step;
#[cfg(test)]
mod tests;

use std::ops::ControlFlow;

use step::TangentColumns;

use super::lead_in::LeadIn;
use super::simulate::{Recording, step_count};
use super::{CurveRow, HeartModel, HeartState, RegionalParameter, SimulationPlan, StepOutcome, TangentError, Trajectory};
use crate::mechanics::StepLoad;

/// [`simulate`](super::simulate) with the derivatives of its trajectory by `parameters`, one trajectory each: every number is the
/// derivative of the one in its place, in its unit per unit of the parameter, but times and phases, which are those of the simulation.
/// The simulation is bitwise that of [`simulate`](super::simulate), and nothing depends on the number of threads. `observer` sees the
/// simulation only.
///
/// # Errors
/// [`TangentError::NoTangent`] for a parameter or a model without tangent, else as [`simulate`](super::simulate).
pub fn simulate_with_tangents(
    model: &HeartModel,
    plan: &SimulationPlan,
    loads: &[&dyn StepLoad],
    parameters: &[RegionalParameter],
    observer: &mut dyn FnMut(&HeartState, &CurveRow) -> ControlFlow<()>,
) -> Result<(Trajectory, Vec<Trajectory>), TangentError> {
    let step_s = model.settings().step_s;
    let lead_in = LeadIn::new(model, plan.start_time_s);
    let mut columns = TangentColumns::new(model, &lead_in, !loads.is_empty(), parameters)?;
    let start = lead_in.run::<TangentError>(model, &mut model.workspace(), |before, outcome, workspace| {
        check_whole(outcome)?;
        columns.step(model, &[], before, &outcome.state, workspace)?;
        columns.hold_arteries();
        Ok(())
    })?;
    let mut workspace = model.workspace();
    let step_count = step_count(&start, plan, step_s);
    let mut recordings: Vec<Recording<'_>> = columns.rates().map(|(_, rate)| Recording::new(rate, plan, step_s)).collect();
    let (mut recording, mut last) = (Recording::new(&start, plan, step_s), start);
    let mut is_stopped = recording.show(&last, observer);
    for _ in 0..step_count {
        if is_stopped {
            break;
        }
        let outcome = model.step(&last, loads, &mut workspace)?;
        check_whole(&outcome)?;
        columns.step(model, loads, &last, &outcome.state, &workspace)?;
        for (recording, (before, after)) in recordings.iter_mut().zip(columns.rates()) {
            recording.add(before, after);
        }
        recording.count(&outcome);
        recording.add(&last, &outcome.state);
        last = outcome.state;
        is_stopped = recording.show(&last, observer);
    }
    let tangents = recordings.into_iter().zip(columns.into_rates());
    let tangents = tangents.map(|(recording, rate)| recording.into_trajectory(rate, is_stopped)).collect();
    Ok((recording.into_trajectory(last, is_stopped), tangents))
}

fn check_whole(outcome: &StepOutcome) -> Result<(), TangentError> {
    let reason = "a step did not converge as a whole and was taken in halves";
    if outcome.substep_count > 1 { Err(TangentError::NoTangent { parameter: "step_s", reason }) } else { Ok(()) }
}
