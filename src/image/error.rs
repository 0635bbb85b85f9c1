//! What can be wrong with an image.

use std::path::PathBuf;

/// An image that cannot be used, with the file or place and the remedy.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum ImageError {
    /// The file does not exist or cannot be opened.
    #[error("cannot read image {path}: {reason}")]
    Unreadable { path: PathBuf, reason: String },
    /// The file was read but what it says cannot be used.
    #[error("image {path} cannot be used: {reason}")]
    Unusable { path: PathBuf, reason: String },
    /// A value of an image is NaN or infinite.
    #[error("voxel {voxel:?} of frame {frame} is not finite")]
    NonFinite { frame: usize, voxel: [usize; 3] },
    /// The number of values does not fit the shape.
    #[error("the image has {value_count} values where its shape {shape:?} asks for {expected}")]
    ValueCount { shape: [usize; 3], value_count: usize, expected: usize },
    /// The affine map from voxels to world is singular or not finite.
    #[error("the voxel-to-world matrix is singular or not finite; check the image's sform or qform")]
    SingularAffine,
    /// A grid without voxels.
    #[error("a grid of {shape:?} voxels is empty")]
    EmptyGrid { shape: [usize; 3] },
    /// Frames, times or grids of a cine sequence contradict each other.
    #[error("the cine sequence is inconsistent: {reason}")]
    InconsistentCine { reason: String },
    /// A label map does not describe a ventricle.
    #[error("the labels cannot be used: {reason}")]
    UnusableMask { reason: String },
    /// Images cannot be prepared as asked.
    #[error("the images cannot be prepared: {reason}")]
    Preprocessing { reason: String },
    /// Volumes, times or settings of a volume curve contradict each other.
    #[error("the volume curve is inconsistent: {reason}")]
    InconsistentVolumeCurve { reason: String },
}
