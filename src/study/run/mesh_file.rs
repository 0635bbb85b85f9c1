//! The heart at rest from a mesh made elsewhere.

use nalgebra::Vector3;

use super::error::RunError;
use crate::anatomy::{Anatomy, AnatomySettings, complete_anatomy, directions_at_tetrahedra};
use crate::mesh::MeshError;
use crate::mesh::io::{FieldArray, Numbering, TagCodes, read_mesh_file};
use crate::study::plan::{FibreSource, MeshPlan};

/// Reads the mesh of a plan and completes its anatomy, with its own fibres where it is told to.
pub(super) fn anatomy_of_file(wanted: &MeshPlan, settings: &AnatomySettings) -> Result<Anatomy, RunError> {
    let file = read_mesh_file(&wanted.path)?;
    let mesh = file.to_tet_mesh(wanted.mm_per_unit, Numbering::Free)?;
    let surface = file.to_tagged_surface(&mesh, &wanted.surface_field, &TagCodes(wanted.codes.iter().copied().collect()))?;
    let anatomy = complete_anatomy(mesh, surface, settings)?;
    let fields = match wanted.fibres {
        FibreSource::Rule => return Ok(anatomy),
        FibreSource::Vertices => &file.point_fields,
        FibreSource::Tetrahedra => &file.tetrahedron_fields,
    };
    let directions = |name: &String| -> Result<Vec<Vector3<f64>>, MeshError> {
        let missing = || MeshError::MissingField { name: name.clone(), available: fields.keys().cloned().collect() };
        let field = fields.get(name).and_then(FieldArray::vectors).ok_or_else(missing)?;
        let is_at_vertices = wanted.fibres == FibreSource::Vertices;
        Ok(if is_at_vertices { directions_at_tetrahedra(&anatomy.mesh, &field) } else { field })
    };
    let fibres = directions(&wanted.fibre_field)?;
    let sheets = wanted.sheet_field.as_ref().map(directions).transpose()?;
    Ok(anatomy.with_fibres(&fibres, sheets.as_deref())?)
}
