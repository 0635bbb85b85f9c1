//! `report.html`: what a run was asked and what it found, as one page that a browser opens from disk without a network.
//!
//! Charts are SVG written here, so that they print, scale and can be read without a script; the script moves the slices and the mesh
//! through the beat. Whatever comes from outside (names of files, labels, reasons) is escaped where it enters the page.

mod bars;
mod bulls_eye;
mod colour;
mod escape;
mod heading;
mod heart;
mod intervals;
mod matrix;
mod number;
mod pack;
mod page;
mod plot;
mod slices;
mod table;

pub use bars::Bars;
pub use bulls_eye::BullsEye;
pub use colour::Scale;
pub use heading::heading;
pub use heart::{BeatingHeart, SurfaceField, SurfaceValues};
pub use intervals::Intervals;
pub use matrix::CorrelationMatrix;
pub use number::readable;
pub use page::{Block, KeyFigure, Page, Section, write_page};
pub use plot::{Plot, Scatter};
pub use slices::Slices;
pub use table::Table;
