//! What can stop the tracker.

use crate::heart::{HeartError, StepError};
use crate::mesh::SurfaceTag;

/// Why a motion cannot be tracked, with the place, the amount and the remedy.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum TrackingError {
    /// A surface that is to be tracked has no triangle.
    #[error("the mesh has no {tag:?} to track; set its image gain to zero or tag the surface")]
    MissingSurface { tag: SurfaceTag },
    /// The image does not cover the surface.
    #[error(
        "the image covers only {covered} of {vertex_count} vertices of {tag:?}; check that mesh and images share world coordinates (RAS, mm)"
    )]
    NotCovered { tag: SurfaceTag, covered: usize, vertex_count: usize },
    /// No edge stands at the surface on the reference frame.
    #[error(
        "{tag:?} shows no contrast on the reference frame at {time_s} s (median {contrast} against noise {noise}); check the reference time and the mesh position"
    )]
    NoContrast { tag: SurfaceTag, time_s: f64, contrast: f64, noise: f64 },
    /// The boundary is lost on most of a surface.
    #[error(
        "a boundary was found on only {found} of {vertex_count} vertices of {tag:?} at {time_s} s; the frame may be corrupt or the mesh far off"
    )]
    BoundaryLost { tag: SurfaceTag, found: usize, vertex_count: usize, time_s: f64 },
    /// No block around the base lies inside the image.
    #[error("none of the {vertex_count} base vertices has its block inside the image; use smaller blocks or another base mode")]
    BaseNotCovered { vertex_count: usize },
    /// Base matches do not fit the mesh.
    #[error("the base matches cannot be used: {reason}")]
    BaseMatches { reason: String },
    /// The heart period of the model is not that of the images.
    #[error("the heart period is {model_s} s in the model but {cine_s} s in the images; set heart_period_s to the cine sequence's period")]
    PeriodMismatch { model_s: f64, cine_s: f64 },
    /// The model cannot be set up with the base mode.
    #[error(transparent)]
    Heart(#[from] HeartError),
    /// A step of the tracked heart failed.
    #[error("tracking stopped: {0}")]
    Step(#[from] StepError),
    /// A setting is outside its range.
    #[error("{name} = {value} must lie in {lower} to {upper}")]
    SettingOutOfRange { name: &'static str, value: f64, lower: f64, upper: f64 },
}

impl TrackingError {
    /// Refuses a setting that is not finite or outside `lower..=upper`.
    pub(super) fn check_setting(name: &'static str, value: f64, lower: f64, upper: f64) -> Result<(), Self> {
        if (lower..=upper).contains(&value) { Ok(()) } else { Err(Self::SettingOutOfRange { name, value, lower, upper }) }
    }
}
