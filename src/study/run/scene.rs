//! What parameters are searched on, and what every search begins with.

use super::clock::Clock;
use super::error::RunError;
use super::forward::heart_model;
use super::measured::{MeasuredVolumes, measured_volumes};
use super::patient::{Patient, PatientImages};
use super::rest_frame::carried_to;
use super::start::{StageRow, start_space};
use super::track::{Tracked, track_patient};
use crate::heart::HeartModel;
use crate::personalisation::ParameterSpace;
use crate::study::plan::PersonalisationPlan;
use crate::study::{Plan, RunContext};

/// What parameters are searched on.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) plan: &'a Plan,
    pub(super) wanted: &'a PersonalisationPlan,
    pub(super) patient: &'a Patient,
    pub(super) images: &'a PatientImages,
    pub(super) clock: &'a Clock,
}

/// What every search begins with.
pub(super) struct Beginning {
    pub(super) base: HeartModel,
    pub(super) measured: MeasuredVolumes,
    pub(super) space: ParameterSpace,
    pub(super) stages: Vec<StageRow>,
    /// Simulations that the start values took.
    pub(super) simulations: f64,
}

impl<'a> Scene<'a> {
    /// # Errors
    /// [`RunError::NothingToFit`] where the patient has no images.
    pub(super) fn new(plan: &'a Plan, wanted: &'a PersonalisationPlan, patient: &'a Patient, clock: &'a Clock) -> Result<Self, RunError> {
        let images = patient.images.as_ref().ok_or(RunError::NothingToFit)?;
        Ok(Self { plan, wanted, patient, images, clock })
    }

    /// The heart without image forces, its volumes as they were measured, and start values that follow them.
    pub(super) fn begin(&self, tracked: &Tracked, context: &RunContext) -> Result<Beginning, RunError> {
        let &Self { plan, wanted, patient, clock, .. } = self;
        let base = heart_model(&plan.model, &patient.anatomy, patient.parameters.clone())?;
        let measured = measured_volumes(plan, wanted, patient, clock, tracked)?;
        let (space, stages) = start_space(wanted, &base, clock, &measured.left_ml, context)?;
        // Every stage has a row a parameter.
        let simulations = stages.iter().step_by(wanted.parameters.len().max(1)).map(|row| row.simulations).sum();
        Ok(Beginning { base, measured, space, stages, simulations })
    }
}

/// The patient, and its images tracked, from the image on which the model rests.
pub(super) fn tracked_at_rest(plan: &Plan, wanted: &PersonalisationPlan, context: &RunContext) -> Result<(Patient, Tracked), RunError> {
    let patient = Patient::new(plan, context)?;
    let track = |patient: &Patient| {
        let Some(images) = &patient.images else { return Err(RunError::NothingToFit) };
        Ok((track_patient(plan, patient, images, patient.parameters.clone(), context)?.whole()?, images.reference_frame))
    };
    let (tracked, drawn_frame) = track(&patient)?;
    let Some(frame) = wanted.rest_frame.filter(|&frame| frame != drawn_frame) else { return Ok((patient, tracked)) };
    let patient = carried_to(patient, &tracked, frame)?;
    let (tracked, _) = track(&patient)?;
    Ok((patient, tracked))
}
