//! What a personalisation finds on the images that a run has tracked: the outputs `recovered_<parameter>`.

use std::sync::atomic::AtomicBool;

use super::RunError;
use crate::heart::HeartModel;
use crate::personalisation::CalibrationOutcome;
use crate::study::figure::RECOVERED;
use crate::study::plan::PersonalisationPlan;
use crate::study::progress::Silent;
use crate::study::run::calibration::residual;
use crate::study::run::measured::measured_volumes;
use crate::study::run::patient::Patient;
use crate::study::run::replica::TrackingBias;
use crate::study::run::search::{Task, find};
use crate::study::run::start::start_space;
use crate::study::run::track::Tracked;
use crate::study::{Plan, RunContext, Status};

/// The parameters found, by their outputs' names, and how the search ended.
pub(super) struct Recovered {
    pub(super) values: Vec<(String, f64)>,
    pub(super) status: Status,
}

/// Searches the free parameters with `model`, the heart of this run, for all that is held.
pub(super) fn recovered(
    plan: &Plan,
    wanted: &PersonalisationPlan,
    patient: &Patient,
    model: &HeartModel,
    tracked: &Tracked,
    stop: &AtomicBool,
) -> Result<Recovered, RunError> {
    let context = RunContext::new(&Silent, stop);
    let clock = patient.clock(1);
    let measured = measured_volumes(plan, wanted, patient, &clock, tracked)?;
    let (space, _) = start_space(wanted, model, &clock, &measured.left_ml, &context)?;
    let residual = residual(&wanted.data, patient, &clock, &measured, tracked, &TrackingBias::default())?;
    let task = Task { wanted, base: model, space: &space, clock: &clock, residual: &residual };
    let calibration = find(&task, wanted.solver, &space.initial(), None, &context)?.calibration;
    let names = space.names().into_iter().map(|name| format!("{RECOVERED}{name}"));
    let status = match calibration.outcome {
        CalibrationOutcome::MaxIterations => Status::IterationLimit,
        CalibrationOutcome::OnBound(_) => Status::OnBound,
        _ => Status::Converged,
    };
    Ok(Recovered { values: names.zip(space.to_values(&calibration.coordinates)).collect(), status })
}
