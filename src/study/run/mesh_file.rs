//! The heart at rest from a mesh made elsewhere.

use super::error::RunError;
use crate::anatomy::{Anatomy, AnatomyError, AnatomySettings, complete_anatomy};
use crate::mesh::io::{MeshFile, TagCodes, read_mesh_file, read_mesh_tables};
use crate::study::plan::{MeshPlan, MeshSource};

/// Reads the mesh of a plan and completes its anatomy, with its own fibres where it is told to; every error names the file.
pub(super) fn anatomy_of_file(wanted: &MeshPlan, settings: &AnatomySettings) -> Result<Anatomy, RunError> {
    let file = match &wanted.source {
        MeshSource::File(path) => read_mesh_file(path)?,
        MeshSource::Tables(files) => read_mesh_tables(files)?,
    };
    anatomy_of(&file, wanted, settings).map_err(|source| RunError::UnusableMesh { path: wanted.source.path().into(), source })
}

fn anatomy_of(file: &MeshFile, wanted: &MeshPlan, settings: &AnatomySettings) -> Result<Anatomy, AnatomyError> {
    let mesh = file.to_tet_mesh(wanted.unit.mm(), wanted.numbering)?;
    let field = wanted.surface_field.as_deref().unwrap_or_else(|| file.surface_field());
    let surface = file.to_tagged_surface(&mesh, field, &TagCodes(wanted.codes.iter().copied().collect()))?;
    let anatomy = complete_anatomy(mesh, surface, settings)?;
    let Some(fibre_field) = &wanted.fibre_field else { return Ok(anatomy) };
    let fibres = file.directions(fibre_field)?;
    let sheets = wanted.sheet_field.as_deref().map(|name| file.directions(name)).transpose()?;
    anatomy.with_fibres(&fibres, sheets.as_deref())
}
