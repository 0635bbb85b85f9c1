//! What can be wrong with a mesh.

use std::path::PathBuf;

use super::SurfaceTag;

/// A mesh that cannot be used, with the place and the amount.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum MeshError {
    /// The mesh has no vertices or no tetrahedra.
    #[error("the mesh is empty ({vertex_count} vertices, {tetrahedron_count} tetrahedra)")]
    Empty { vertex_count: usize, tetrahedron_count: usize },
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} has a coordinate that is not finite")]
    NonFiniteVertex { vertex: usize },
    /// A tetrahedron names a vertex that does not exist.
    #[error("tetrahedron {tetrahedron} names vertex {vertex}, but there are only {vertex_count}")]
    VertexOutOfRange { tetrahedron: usize, vertex: usize, vertex_count: usize },
    /// A tetrahedron is flat or inside out.
    #[error("tetrahedron {tetrahedron} is flat or inverted (signed volume {volume_mm3} mm³); reorder its vertices or remesh")]
    InvertedTetrahedron { tetrahedron: usize, volume_mm3: f64 },
    /// A vertex belongs to no tetrahedron.
    #[error("vertex {vertex} belongs to no tetrahedron; remove unused vertices")]
    UnreferencedVertex { vertex: usize },
    /// Two tetrahedra have the same four vertices.
    #[error("tetrahedra {first} and {second} have the same vertices")]
    DuplicateTetrahedron { first: usize, second: usize },
    /// A triangle is shared by more than two tetrahedra.
    #[error("the triangle of vertices {vertices:?} is shared by more than two tetrahedra")]
    NonManifoldTriangle { vertices: [usize; 3] },
    /// The boundary triangles and their tags disagree in number.
    #[error("{triangle_count} boundary triangles but {tag_count} tags")]
    TagCount { triangle_count: usize, tag_count: usize },
    /// A surface that is needed has no triangle.
    #[error("no triangle is tagged {tag:?}; check the surface tags of the mesh")]
    MissingSurface { tag: SurfaceTag },
    /// The rim of an endocardium is not one closed loop, so the cavity cannot be closed by a lid.
    #[error("the rim of {tag:?} is not one closed loop ({loop_count} loops found); the endocardium has a hole or is in pieces")]
    OpenEndocardium { tag: SurfaceTag, loop_count: usize },
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
}
