//! What was found against the truth of a phantom.

use nalgebra::Vector3;
use serde::Serialize;

use super::forward::frame_volumes_lv_ml;
use super::patient::Patient;
use super::personalise::Personalised;
use super::track::Tracked;
use crate::heart::{FrameState, Parameters, RegionalParameter};
use crate::numerics::root_mean_square;
use crate::study::Plan;
use crate::study::plan::{ImageSource, PhantomPlan};

/// How far the values found lie from the truth of a phantom.
#[derive(Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
pub(super) struct Recovery {
    pub(super) within_tolerance: bool,
    volume_tracked_rms_ml: f64,
    pub(super) volume_model_rms_ml: f64,
    /// Where the model has the true mesh.
    position_tracked_rmse_mm: Option<f64>,
    position_model_rmse_mm: Option<f64>,
    position_no_motion_rmse_mm: Option<f64>,
    pub(super) parameters: Vec<RecoveredParameter>,
}

#[derive(Serialize)]
pub(super) struct RecoveredParameter {
    pub(super) parameter: String,
    pub(super) truth: f64,
    value: f64,
    error: f64,
    tolerance: Option<f64>,
}

impl Recovery {
    /// Whether the study says how near the truth a value must come.
    pub(super) fn has_tolerances(&self) -> bool {
        self.parameters.iter().any(|one| one.tolerance.is_some())
    }
}

pub(super) fn recovery<'a>(plan: &Plan, patient: &'a Patient, tracked: &'a Tracked, found: &'a Personalised) -> Option<Recovery> {
    let (truth, Some(ImageSource::Phantom(phantom))) = (patient.truth.as_ref()?, &plan.images) else { return None };
    let parameters: Vec<_> = found.space.free().map(|free| recovered(free.parameter, &truth.parameters, found, phantom)).collect();
    let tracked_ml = frame_volumes_lv_ml(&tracked.motion.trajectory);
    // The same vertices of the same tissue, whatever instant they were drawn on.
    let same_mesh = truth.anatomy.mesh.tetrahedra() == patient.anatomy.mesh.tetrahedra();
    let rest_mm = patient.anatomy.mesh.vertices_mm();
    let rmse = |position_of: &dyn Fn(usize) -> Option<&'a [Vector3<f64>]>| same_mesh.then(|| position_rmse_mm(&truth.frames, position_of));
    Some(Recovery {
        within_tolerance: parameters.iter().all(|one| one.tolerance.is_none_or(|tolerance| one.error.abs() <= tolerance)),
        volume_tracked_rms_ml: difference_rms(&tracked_ml, &truth.volumes_lv_ml),
        volume_model_rms_ml: difference_rms(&frame_volumes_lv_ml(&found.fitted), &truth.volumes_lv_ml),
        position_tracked_rmse_mm: rmse(&|frame| Some(&tracked.motion.trajectory.frames.get(frame)?.position_mm)),
        position_model_rmse_mm: rmse(&|frame| Some(&found.fitted.frames.get(frame)?.position_mm)),
        position_no_motion_rmse_mm: rmse(&|_| Some(rest_mm)),
        parameters,
    })
}

/// Root mean square distance of all vertices over all frames.
fn position_rmse_mm<'a>(truth: &[FrameState], position_of: &dyn Fn(usize) -> Option<&'a [Vector3<f64>]>) -> f64 {
    let distances = truth.iter().enumerate().flat_map(|(frame, state)| {
        let found = position_of(frame).unwrap_or_default();
        state.position_mm.iter().zip(found).map(|(a, b)| (a - b).norm())
    });
    root_mean_square(&distances.collect::<Vec<_>>())
}

fn recovered(parameter: RegionalParameter, truth: &Parameters, found: &Personalised, phantom: &PhantomPlan) -> RecoveredParameter {
    let (truth, value) = (truth[parameter], found.model.parameters()[parameter]);
    let tolerance = phantom.tolerances.get(&parameter.parameter()).copied();
    RecoveredParameter { parameter: parameter.name(), truth, value, error: value - truth, tolerance }
}

/// Root mean square of the differences of two curves.
pub(super) fn difference_rms(a: &[f64], b: &[f64]) -> f64 {
    root_mean_square(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>())
}
