//! What can be wrong with an anatomy.

use nalgebra::Vector3;

use crate::mesh::MeshError;

/// An anatomy that cannot be built, with the place, the amount and the remedy.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum AnatomyError {
    /// A length or an angle that was asked for makes no sense.
    #[error("{name} is {value}, but it must {expectation}")]
    Setting { name: &'static str, value: f64, expectation: &'static str },
    /// The implicit function gives NaN or infinity.
    #[error("the level set is not finite at ({:.1}, {:.1}, {:.1}) mm", position_mm.x, position_mm.y, position_mm.z)]
    NonFiniteLevel { position_mm: Vector3<f64> },
    /// The box that was given asks for too many lattice points.
    #[error("a lattice of {vertex_count} points is needed, more than {limit}; use a longer edge or a smaller box")]
    TooFine { vertex_count: usize, limit: usize },
    /// Nothing lies inside the implicit function.
    #[error("no lattice point lies inside the wall at an edge length of {edge_length_mm} mm; use a shorter edge or check the masks")]
    NothingInside { edge_length_mm: f64 },
    /// Endocardium and epicardium meet: the wall is thinner than the lattice can show.
    #[error(
        "the surface of {triangle_count} triangles near ({:.1}, {:.1}, {:.1}) mm has {endocardial} endocardial and {epicardial} epicardial ones: \
         the wall is perforated there; use a shorter edge or a larger minimum wall",
        position_mm.x, position_mm.y, position_mm.z
    )]
    PerforatedWall { triangle_count: usize, endocardial: usize, epicardial: usize, position_mm: Vector3<f64> },
    /// A surface that must be one piece is none or several.
    #[error("the {surface} is in {piece_count} pieces, one is needed; use a shorter edge or check the masks")]
    SurfacePieces { surface: &'static str, piece_count: usize },
    /// A surface is pinched: more than two of its triangles meet at an edge, or its triangles fall apart around a vertex.
    #[error(
        "the surface is pinched at vertex {vertex}, ({:.1}, {:.1}, {:.1}) mm; use a shorter edge or a larger minimum wall",
        position_mm.x, position_mm.y, position_mm.z
    )]
    PinchedSurface { vertex: usize, position_mm: Vector3<f64> },
    /// The right ventricle does not face the left.
    #[error("no part of the right endocardium faces the left ventricle; check the surface tags")]
    NoSeptum,
    /// A field does not have one entry a tetrahedron.
    #[error("{length} {name} are given for {expected} tetrahedra")]
    FieldLength { name: &'static str, length: usize, expected: usize },
    /// A fibre has no direction.
    #[error("the fibre of tetrahedron {tetrahedron} has no direction, or its sheet lies along it")]
    FibreDirection { tetrahedron: usize },
    /// A solver did not reach its tolerance.
    #[error("the transmural Laplace solve stopped after {iterations} iterations at a relative residual of {residual:e}")]
    LaplaceStalled { iterations: usize, residual: f64 },
    /// The mesh breaks one of its invariants.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}
