//! Images in world millimetres: volumes, cine sequences, label maps; knows no mesh.

mod cine;
mod error;
mod grid;
mod mask;
mod sampling;
mod volume;

pub use cine::CineSequence;
pub use error::ImageError;
pub use grid::Grid;
pub use mask::{Plane, VentricleFields};
pub use sampling::CineInstant;
pub use volume::{LabelMap, Volume};
