//! Why no phantom could be made.

use crate::anatomy::AnatomyError;
use crate::image::ImageError;

/// A phantom that cannot be made, with the quantity and the remedy.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum PhantomError {
    /// A setting is outside its range.
    #[error("{name} is {value}; it must {expectation}")]
    Setting { name: &'static str, value: f64, expectation: &'static str },
    /// The positions of a frame do not fit the mesh.
    #[error("frame {frame} has {position_count} positions for a mesh of {vertex_count} vertices")]
    PositionCount { frame: usize, position_count: usize, vertex_count: usize },
    /// A position is NaN or infinite.
    #[error("frame {frame} puts vertex {vertex} at a position that is not finite")]
    NonFinitePosition { frame: usize, vertex: usize },
    /// The image would be empty or too large to hold.
    #[error("the image would have {shape:?} voxels of {samples_per_voxel:?} samples; change the voxel size or the margin")]
    ImageSize { shape: [usize; 3], samples_per_voxel: [usize; 3] },
    /// The image could not be put together.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The idealised anatomy could not be meshed.
    #[error(transparent)]
    Anatomy(#[from] AnatomyError),
}

/// The value if it lies between the bounds (inclusive), or an error naming it.
pub(super) fn within(name: &'static str, value: f64, [lower, upper]: [f64; 2], expectation: &'static str) -> Result<f64, PhantomError> {
    if value >= lower && value <= upper { Ok(value) } else { Err(PhantomError::Setting { name, value, expectation }) }
}
