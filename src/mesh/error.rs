//! What can be wrong with a mesh.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::SurfaceTag;

/// A mesh that cannot be used, with the place and the amount.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum MeshError {
    /// The mesh has no vertices or no tetrahedra.
    #[error("the mesh is empty ({vertex_count} vertices, {tetrahedron_count} tetrahedra); is the file truncated, or a surface?")]
    Empty { vertex_count: usize, tetrahedron_count: usize },
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} has a coordinate that is not a finite number; export the mesh anew")]
    NonFiniteVertex { vertex: usize },
    /// A tetrahedron names a vertex that does not exist.
    #[error(
        "tetrahedron {tetrahedron} names vertex {vertex}, but there are only {vertex_count}, counted from 0; is the file truncated, or does it \
         count from 1?"
    )]
    VertexOutOfRange { tetrahedron: usize, vertex: usize, vertex_count: usize },
    /// A tetrahedron is flat or inside out.
    #[error(
        "tetrahedron {tetrahedron} at ({:.1}, {:.1}, {:.1}) mm is flat or inverted (signed volume {volume_mm3:.3e} mm³); remesh there, or, if \
         the order of its corners means nothing in this file, read it with free numbering",
        centre_mm.x, centre_mm.y, centre_mm.z
    )]
    InvertedTetrahedron { tetrahedron: usize, volume_mm3: f64, centre_mm: Vector3<f64> },
    /// A vertex belongs to no tetrahedron.
    #[error(
        "vertex {vertex} at ({:.1}, {:.1}, {:.1}) mm belongs to no tetrahedron; remove unused vertices",
        position_mm.x, position_mm.y, position_mm.z
    )]
    UnreferencedVertex { vertex: usize, position_mm: Vector3<f64> },
    /// Two tetrahedra have the same four vertices.
    #[error("tetrahedra {first} and {second} have the same vertices; remove one of them")]
    DuplicateTetrahedron { first: usize, second: usize },
    /// A triangle is shared by more than two tetrahedra.
    #[error(
        "the triangle of vertices {vertices:?} is shared by more than two tetrahedra; parts of the mesh lie upon each other, remesh there"
    )]
    NonManifoldTriangle { vertices: [usize; 3] },
    /// Two tetrahedra lie on the same side of the triangle that they share.
    #[error("tetrahedra {first} and {second} overlap: both lie on one side of their triangle {vertices:?}; one is inverted, remesh there")]
    OverlappingTetrahedra { first: usize, second: usize, vertices: [usize; 3] },
    /// The boundary triangles and their tags disagree in number.
    #[error("{triangle_count} boundary triangles but {tag_count} tags")]
    TagCount { triangle_count: usize, tag_count: usize },
    /// A surface that is needed has no triangle.
    #[error("no triangle is tagged {tag:?}; check the surface tags of the mesh")]
    MissingSurface { tag: SurfaceTag },
    /// The rim of an endocardium is not one closed loop, so the cavity cannot be closed by a lid.
    #[error(
        "the rim of {tag:?} is not one closed loop but {loop_count}, one through vertex {vertex}: the surface has a hole or is in pieces there; \
         close the hole, or mend the surface tags"
    )]
    OpenEndocardium { tag: SurfaceTag, loop_count: usize, vertex: usize },
    /// An endocardium is closed by itself.
    #[error("{tag:?} has no rim, so there is no base to close it at; tag the triangles of the base as such")]
    ClosedEndocardium { tag: SurfaceTag },
    /// A mesh file cannot be opened or read.
    #[error("cannot read mesh {path}: {reason}")]
    Unreadable { path: PathBuf, reason: String },
    /// A mesh file was read but what it says cannot be used.
    #[error("mesh {path} cannot be used: {reason}")]
    Unusable { path: PathBuf, reason: String },
    /// A mesh file cannot be written.
    #[error("cannot write mesh {path}: {reason}")]
    Unwritable { path: PathBuf, reason: String },
    /// A field does not fit its mesh.
    #[error("field {name:?} has {length} entries where the mesh asks for {expected}")]
    FieldLength { name: String, length: usize, expected: usize },
    /// A mesh is far too small or too large for a heart in mm.
    #[error("the mesh is {extent_mm} mm long; a heart is 10 to 1000 mm: is the file in metres? give its unit of length")]
    ImplausibleSize { extent_mm: f64 },
    /// A field that is needed is not in the file.
    #[error("the {subject} have no field {name:?} of {components} component(s); there are {available:?}: name one of them")]
    MissingField { subject: &'static str, name: String, components: usize, available: Vec<String> },
    /// A surface code stands for nothing.
    #[error(
        "surface code {code} of the boundary triangle at ({:.1}, {:.1}, {:.1}) mm stands for no surface; known are {known:?}: say which surface \
         has it",
        centre_mm.x, centre_mm.y, centre_mm.z
    )]
    UnknownTag { code: i64, known: Vec<i64>, centre_mm: Vector3<f64> },
    /// A file has no triangles.
    #[error("the file has no triangles, so nothing says which surface is which; export the tagged boundary together with the tetrahedra")]
    NoSurface,
    /// A boundary triangle has no tag.
    #[error(
        "the boundary triangle of vertices {vertices:?} at ({:.1}, {:.1}, {:.1}) mm is not among the tagged triangles of the file; tag \
         the whole boundary",
        centre_mm.x, centre_mm.y, centre_mm.z
    )]
    UntaggedTriangle { vertices: [usize; 3], centre_mm: Vector3<f64> },
}
