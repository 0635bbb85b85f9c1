//! Images in world millimetres: volumes, cine sequences, label maps; knows no mesh.

mod cine;
mod error;
mod grid;
mod volume;

pub use cine::CineSequence;
pub use error::ImageError;
pub use grid::Grid;
pub use volume::{LabelMap, Volume};
