//! Why a heart could not be put together, or could not go on beating.

use super::OutOfRange;
use crate::circulation::CirculationError;
use crate::electrophysiology::ActivationError;
use crate::mechanics::MechanicsError;

/// A heart that cannot be put together.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum HeartError {
    /// A parameter is out of its range.
    #[error(transparent)]
    Parameter(#[from] OutOfRange),
    /// The activation map could not be found.
    #[error("activation: {0}")]
    Activation(#[from] ActivationError),
    /// The mechanics refuse the anatomy or the properties.
    #[error("mechanics: {0}")]
    Mechanics(#[from] MechanicsError),
    /// The circulation refuses its constants.
    #[error("circulation: {0}")]
    Circulation(#[from] CirculationError),
    /// The anatomy has no cavity, or one without volume.
    #[error("the {cavity} cavity has a volume of {volume_mm3} mm³; check that the endocardium is closed towards the base")]
    Cavity { cavity: &'static str, volume_mm3: f64 },
    /// A field of the anatomy does not fit its mesh.
    #[error("the anatomy has {found} {field} where its mesh needs {expected}")]
    AnatomyField { field: &'static str, expected: usize, found: usize },
    /// A setting makes no sense.
    #[error("{setting} = {value} is not allowed; it must be {requirement}")]
    Setting { setting: &'static str, value: f64, requirement: &'static str },
    /// Extra stimuli and own beats go on disturbing each other.
    #[error(
        "the rhythm does not come to repeat itself within {beat_count} beats; give the repeating stimuli another delay_s, or a shorter \
         action potential"
    )]
    RestlessRhythm { beat_count: usize },
    /// A recorded base motion does not fit.
    #[error("recorded base motion: {reason}")]
    BaseMotion { reason: String },
}

/// A simulation whose tangents could not be taken along.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum TangentError {
    /// The simulation itself failed.
    #[error(transparent)]
    Step(#[from] StepError),
    /// A heart beside this one could not be put together.
    #[error("tangent: {0}")]
    Heart(#[from] HeartError),
    /// The trajectory has no derivative by this, or none that is known.
    #[error("no tangent for {parameter}: {reason}; use finite differences")]
    NoTangent { parameter: &'static str, reason: &'static str },
}

/// A step that could not be completed, with when, how far it came, and why.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum StepError {
    /// The mechanics could not be solved.
    #[error("at {time_s:.4} s (step {step_s} s): {source}")]
    Mechanics { time_s: f64, step_s: f64, source: MechanicsError },
    /// The valves could not be solved.
    #[error("at {time_s:.4} s (step {step_s} s): {source}")]
    Circulation { time_s: f64, step_s: f64, source: CirculationError },
    /// The volumes were not met.
    #[error(
        "at {time_s:.4} s (step {step_s} s): after {round_count} rounds the volume still differs by {volume_defect_ml:.2e} mL from what the \
         valves let through; use a smaller step, or a lower contraction or stiffer wall"
    )]
    VolumeNotMet { time_s: f64, step_s: f64, round_count: usize, volume_defect_ml: f64 },
    /// Newton's method came to a halt.
    #[error(
        "at {time_s:.4} s (step {step_s} s): the forces are left with a residual of {residual_mn:.2e} mN, {tolerance_mn:.2e} mN are allowed \
         (volume defect {volume_defect_ml:.2e} mL); use a smaller step, or a lower contraction or stiffer wall"
    )]
    NotConverged { time_s: f64, step_s: f64, residual_mn: f64, tolerance_mn: f64, volume_defect_ml: f64 },
    /// Something is no longer a number, or a vertex has left for infinity.
    #[error(
        "at {time_s:.4} s (step {step_s} s): vertex {vertex} is {distance_mm:.3e} mm from where it rested; the motion has blown up: use a \
         smaller step, weaker forces or a stiffer wall"
    )]
    BlownUp { time_s: f64, step_s: f64, vertex: usize, distance_mm: f64 },
}
