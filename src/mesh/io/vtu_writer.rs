//! Writes a tetrahedral mesh with its fields as a VTU file (VTK XML, compressed, readable by ParaView, pyvista and meshio).

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::FieldValues;
use super::encoding::encode_compressed;
use super::gmsh_writer::gmsh_document;
use super::legacy_vtk_writer::legacy_vtk_document;
use crate::mesh::{MeshError, SurfaceTag, TaggedSurface, TetMesh};

/// VTK's numbers of the cell types.
const VTK_TRIANGLE: u8 = 5;
const VTK_TETRAHEDRON: u8 = 10;

/// A field with its name.
pub type NamedField<'a> = (&'a str, FieldValues<'a>);

/// Writes a mesh at the given positions (one a vertex, mm) with fields of points (one entry a vertex) and cells (one a tetrahedron).
///
/// The file appears whole or not at all: it is written beside its place and renamed.
///
/// # Errors
/// [`MeshError::FieldLength`] if a field has the wrong number of entries, [`MeshError::Unwritable`] if the file cannot be written.
pub fn write_vtu(
    path: &Path,
    mesh: &TetMesh,
    position_mm: &[Vector3<f64>],
    point_fields: &[NamedField],
    cell_fields: &[NamedField],
) -> Result<(), MeshError> {
    let document = document(mesh, &[], position_mm, point_fields, cell_fields)?;
    write_whole(path, document.as_bytes())
}

/// Writes a mesh at rest with its tagged surface, to be read again, in the format that the ending of the name asks for: `.vtu`, `.vtk`
/// (legacy, binary) or `.msh` (Gmsh 2.2, text).
///
/// The boundary triangles follow the tetrahedra as cells. In VTK's formats the cell field `surface_tag` holds 0 for tetrahedra and
/// [`SurfaceTag::code`] for triangles, and other cell fields (one entry a tetrahedron) are filled up with zeros; in Gmsh's the codes are
/// physical groups. The file appears whole or not at all.
///
/// # Errors
/// [`MeshError::FieldLength`] if a field has the wrong number of entries, [`MeshError::Unwritable`] if the file cannot be written or the
/// ending is another.
pub fn write_mesh_file(
    path: &Path,
    mesh: &TetMesh,
    surface: &TaggedSurface,
    point_fields: &[NamedField],
    cell_fields: &[NamedField],
) -> Result<(), MeshError> {
    for (fields, expected) in [(point_fields, mesh.vertex_count()), (cell_fields, mesh.tetrahedron_count())] {
        if let Some((name, values)) = fields.iter().find(|(_, values)| values.len() != expected) {
            return Err(MeshError::FieldLength { name: name.to_string(), length: values.len(), expected });
        }
    }
    let unwritable = |reason: &str| MeshError::Unwritable { path: path.into(), reason: reason.into() };
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or("").to_ascii_lowercase();
    if ending == "msh" {
        let text = gmsh_document(mesh, surface, point_fields, cell_fields).map_err(|error| unwritable(&error.to_string()))?;
        return write_whole(path, text.as_bytes());
    }
    let tags: Vec<i32> =
        std::iter::repeat_n(0, mesh.tetrahedron_count()).chain(surface.tags().iter().copied().map(SurfaceTag::code)).collect();
    let triangles = surface.triangles();
    let padded: Vec<(&str, Padded)> = cell_fields.iter().map(|&(name, values)| (name, Padded::new(values, triangles.len()))).collect();
    let mut fields: Vec<NamedField> = padded.iter().map(|(name, values)| (*name, values.as_field())).collect();
    fields.push(("surface_tag", FieldValues::Labels(&tags)));
    match ending.as_str() {
        "vtu" => write_whole(path, document(mesh, triangles, mesh.vertices_mm(), point_fields, &fields)?.as_bytes()),
        "vtk" => {
            let tetrahedra = mesh.tetrahedra().iter().map(|corners| (VTK_TETRAHEDRON, &corners[..]));
            let cells: Vec<(u8, &[usize])> = tetrahedra.chain(triangles.iter().map(|corners| (VTK_TRIANGLE, &corners[..]))).collect();
            write_whole(path, &legacy_vtk_document(mesh.vertices_mm(), &cells, point_fields, &fields))
        }
        _ => Err(unwritable("the ending of its name is not .vtu, .vtk or .msh")),
    }
}

/// A cell field with zeros for the triangles.
enum Padded {
    Scalars(Vec<f64>),
    Vectors(Vec<Vector3<f64>>),
    Labels(Vec<i32>),
}

impl Padded {
    fn new(values: FieldValues, more: usize) -> Self {
        match values {
            FieldValues::Scalars(v) => Self::Scalars(v.iter().copied().chain(std::iter::repeat_n(0.0, more)).collect()),
            FieldValues::Vectors(v) => Self::Vectors(v.iter().copied().chain(std::iter::repeat_n(Vector3::zeros(), more)).collect()),
            FieldValues::Labels(v) => Self::Labels(v.iter().copied().chain(std::iter::repeat_n(0, more)).collect()),
        }
    }

    fn as_field(&self) -> FieldValues<'_> {
        match self {
            Self::Scalars(v) => FieldValues::Scalars(v),
            Self::Vectors(v) => FieldValues::Vectors(v),
            Self::Labels(v) => FieldValues::Labels(v),
        }
    }
}

fn document(
    mesh: &TetMesh,
    triangles: &[[usize; 3]],
    position_mm: &[Vector3<f64>],
    point_fields: &[NamedField],
    cell_fields: &[NamedField],
) -> Result<String, MeshError> {
    let (points, cells) = (mesh.vertex_count(), mesh.tetrahedron_count() + triangles.len());
    let mut text = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\" \
         compressor=\"vtkZLibDataCompressor\">\n<UnstructuredGrid>\n<Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{cells}\">\n"
    );
    text.push_str("<PointData>\n");
    push_fields(&mut text, point_fields, points)?;
    text.push_str("</PointData>\n<CellData>\n");
    push_fields(&mut text, cell_fields, cells)?;
    text.push_str("</CellData>\n<Points>\n");
    push_fields(&mut text, &[("Points", FieldValues::Vectors(position_mm))], points)?;
    text.push_str("</Points>\n<Cells>\n");
    let connectivity = mesh.tetrahedra().iter().flatten().chain(triangles.iter().flatten());
    push_array(&mut text, "Int64", "connectivity", 1, &connectivity.flat_map(|&v| (v as i64).to_le_bytes()).collect::<Vec<u8>>())?;
    let corner_counts = std::iter::repeat_n(4_i64, mesh.tetrahedron_count()).chain(std::iter::repeat_n(3, triangles.len()));
    let offsets = corner_counts.scan(0_i64, |end, count| {
        *end += count;
        Some(*end)
    });
    push_array(&mut text, "Int64", "offsets", 1, &offsets.flat_map(i64::to_le_bytes).collect::<Vec<u8>>())?;
    let types = std::iter::repeat_n(VTK_TETRAHEDRON, mesh.tetrahedron_count()).chain(std::iter::repeat_n(VTK_TRIANGLE, triangles.len()));
    push_array(&mut text, "UInt8", "types", 1, &types.collect::<Vec<u8>>())?;
    text.push_str("</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n");
    Ok(text)
}

fn push_fields(text: &mut String, fields: &[NamedField], expected: usize) -> Result<(), MeshError> {
    for &(name, values) in fields {
        if values.len() != expected {
            return Err(MeshError::FieldLength { name: name.into(), length: values.len(), expected });
        }
        match values {
            FieldValues::Scalars(v) => push_array(text, "Float64", name, 1, &v.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()),
            FieldValues::Vectors(v) => {
                push_array(text, "Float64", name, 3, &v.iter().flatten().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())
            }
            FieldValues::Labels(v) => push_array(text, "Int32", name, 1, &v.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()),
        }?;
    }
    Ok(())
}

fn push_array(text: &mut String, kind: &str, name: &str, components: usize, bytes: &[u8]) -> Result<(), MeshError> {
    let unwritable = |reason: String| MeshError::Unwritable { path: PathBuf::from(name), reason };
    let name = name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    let encoded = encode_compressed(bytes).map_err(|error| unwritable(error.to_string()))?;
    writeln!(
        text,
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"binary\">\n{encoded}\n</DataArray>"
    )
    .map_err(|error| unwritable(error.to_string()))
}

/// Writes a file beside its place and renames it.
fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), MeshError> {
    let unwritable = |error: std::io::Error| MeshError::Unwritable { path: path.into(), reason: error.to_string() };
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    fs::write(&partial, bytes).map_err(unwritable)?;
    fs::rename(&partial, path).map_err(unwritable)
}
