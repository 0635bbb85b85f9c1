//! Mesh files: VTU out, VTU, legacy VTK and Gmsh in; the only place below the reports where files are touched.

mod encoding;
mod vtu_writer;

use nalgebra::Vector3;

pub use vtu_writer::{NamedField, write_tagged_vtu, write_vtu};

/// Values to be written, one entry a point or a cell.
#[derive(Debug, Clone, Copy)]
pub enum FieldValues<'a> {
    /// One number each.
    Scalars(&'a [f64]),
    /// One vector each.
    Vectors(&'a [Vector3<f64>]),
    /// One integer each.
    Labels(&'a [i32]),
}

impl FieldValues<'_> {
    /// Number of entries.
    pub fn len(&self) -> usize {
        match self {
            Self::Scalars(values) => values.len(),
            Self::Vectors(values) => values.len(),
            Self::Labels(values) => values.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
