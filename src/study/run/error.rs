//! Why a run could not be completed: the room it failed in, in that room's own words.

use std::path::PathBuf;

use crate::anatomy::AnatomyError;
use crate::heart::{HeartError, OutOfRange, StepError};
use crate::image::ImageError;
use crate::mechanics::MechanicsError;
use crate::mesh::MeshError;
use crate::personalisation::PersonalisationError;
use crate::phantom::PhantomError;
use crate::report::ReportError;
use crate::tracking::TrackingError;

/// Why a run could not be completed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum RunError {
    /// An image or label map.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A frame named in the study file that the cine does not have.
    #[error("{key} = {frame}, but the cine has {frame_count} frames (counted from 0); correct the study file")]
    FrameOutOfRange { key: &'static str, frame: usize, frame_count: usize },
    /// Images of another place than the heart.
    #[error(
        "{percent:.0} % of the heart's mesh lie outside of the images: are labels and cine of one examination, with the same world coordinates?"
    )]
    OutsideImages { percent: f64 },
    /// The heart at rest.
    #[error("the anatomy cannot be built: {0}")]
    Anatomy(#[from] AnatomyError),
    /// A mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A mesh made elsewhere that is no heart.
    #[error("mesh {path} cannot be used: {source}")]
    UnusableMesh { path: PathBuf, source: AnatomyError },
    /// The synthetic patient.
    #[error("the phantom cannot be made: {0}")]
    Phantom(#[from] PhantomError),
    /// The model.
    #[error("the heart cannot be put together: {0}")]
    Heart(#[from] HeartError),
    /// The tissue.
    #[error("the bound of the image gains cannot be found: {0}")]
    Mechanics(#[from] MechanicsError),
    /// A step of the simulation.
    #[error("the simulation failed: {0}")]
    Step(#[from] StepError),
    /// Tracking.
    #[error("tracking failed: {0}")]
    Tracking(#[from] TrackingError),
    /// Personalisation.
    #[error("personalisation failed: {0}")]
    Personalisation(#[from] PersonalisationError),
    /// A parameter value.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// A recorded motion of the base that cannot be used.
    #[error("the base motion {} cannot be used: {reason}", file.display())]
    BaseMotion { file: std::path::PathBuf, reason: String },
    /// A table of measurements that cannot be used.
    #[error("the measurements {} cannot be used: {reason}", path.display())]
    DataTable { path: PathBuf, reason: String },
    /// A file that could not be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A personalisation without images or free parameters.
    #[error("there is nothing to fit: the study needs images and free parameters")]
    NothingToFit,
    /// A file that the study reads.
    #[error("cannot read {}, which the study names", file.display())]
    Input { file: PathBuf, source: std::io::Error },
    /// Runs of another study where those of this one should stand.
    #[error(
        "{} holds the runs of another study, or of this one before it was changed; move it away, or choose another folder with -o DIR",
        file.display()
    )]
    ForeignRuns { file: PathBuf },
    /// Parts of a study that has none.
    #[error("a study of kind \"{kind}\" is not run in parts; only \"sensitivity\" is")]
    NothingToMerge { kind: &'static str },
    /// Threads that the system does not give.
    #[error("cannot start threads: {reason}; give fewer with --threads N")]
    Threads { reason: String },
    /// The run was stopped before it had anything to write.
    #[error("stopped before there was a result to write")]
    Stopped,
}
