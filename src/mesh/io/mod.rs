//! Mesh files: VTU, legacy VTK and Gmsh in and out, plain tables in. The only place below the reports where mesh files are touched.

mod encoding;
mod gmsh_numbers;
mod gmsh_reader;
mod gmsh_writer;
mod legacy_vtk_reader;
mod legacy_vtk_writer;
mod mesh_file;
mod tables;
mod vtu_reader;
mod vtu_writer;
mod xml;

use std::path::Path;

use nalgebra::Vector3;

use super::MeshError;
pub use mesh_file::{FieldArray, MeshFile, Numbering, TagCodes};
pub use tables::{TableFiles, read_mesh_tables};
pub use vtu_writer::{NamedField, write_mesh_file, write_vtu};

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

/// Reads a mesh by the ending of its name: `.vtu`, `.vtk` (legacy) or `.msh` (Gmsh 2.2 and 4.1, text or binary).
///
/// # Errors
/// [`MeshError::Unreadable`] if the file cannot be opened, [`MeshError::Unusable`] if it is of no known kind, truncated or contradicts itself.
pub fn read_mesh_file(path: &Path) -> Result<MeshFile, MeshError> {
    let bytes = std::fs::read(path).map_err(|error| MeshError::Unreadable { path: path.into(), reason: error.to_string() })?;
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or("").to_ascii_lowercase();
    let content = match ending.as_str() {
        "vtu" => vtu_reader::read_vtu(&bytes),
        "vtk" => legacy_vtk_reader::read_legacy_vtk(&bytes),
        "msh" => gmsh_reader::read_gmsh(&bytes),
        _ => Err("the ending of its name is not .vtu, .vtk or .msh".into()),
    };
    let unusable = |reason: String| MeshError::Unusable { path: path.into(), reason };
    match content {
        Ok(file) if file.tetrahedra.is_empty() => Err(unusable("it holds no tetrahedra; is it truncated, or a surface?".into())),
        content => content.map_err(unusable),
    }
}
