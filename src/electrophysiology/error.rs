//! Why no activation map could be found.

/// An activation that cannot be solved, with the place and the remedy.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum ActivationError {
    /// There is nowhere to start from.
    #[error("no onset site is given; name at least one vertex where the depolarisation starts")]
    NoOnset,
    /// An onset names a vertex that does not exist.
    #[error("onset {onset} names vertex {vertex}, but the mesh has only {vertex_count}")]
    OnsetOutOfRange { onset: usize, vertex: usize, vertex_count: usize },
    /// An onset time is NaN or infinite.
    #[error("the time of onset {onset} is {time_s} s; it must be finite")]
    NonFiniteOnset { onset: usize, time_s: f64 },
    /// A conduction velocity is zero, negative or not finite.
    #[error("the conduction velocity of tetrahedron {tetrahedron} is {speed_mm_per_s} mm/s; it must be positive and finite")]
    BadSpeed { tetrahedron: usize, speed_mm_per_s: f64 },
    /// The ratio of squared speeds is outside (0, 1].
    #[error("the anisotropy ratio is {ratio}; it must lie in (0, 1] (squared speed across over squared speed along the fibre)")]
    BadRatio { ratio: f64 },
    /// A fibre has no direction.
    #[error("the fibre of tetrahedron {tetrahedron} is zero or not finite")]
    BadFibre { tetrahedron: usize },
    /// Speeds, fibres and tetrahedra differ in number.
    #[error("{speed_count} speeds and {fibre_count} fibres for {tetrahedron_count} tetrahedra; one of each a tetrahedron is needed")]
    FieldCount { speed_count: usize, fibre_count: usize, tetrahedron_count: usize },
    /// Refractory times and vertices differ in number.
    #[error("{refractory_count} refractory times for {vertex_count} vertices; one a vertex is needed")]
    RefractoryCount { refractory_count: usize, vertex_count: usize },
    /// A refractory time is zero, negative or not finite.
    #[error("the refractory time of vertex {vertex} is {refractory_s} s; it must be positive and finite")]
    BadRefractoryTime { vertex: usize, refractory_s: f64 },
    /// A part of the mesh is not connected to any onset.
    #[error("{unreached_count} vertices (the first is {vertex}) are not connected to any onset; the mesh is in pieces")]
    Unreachable { vertex: usize, unreached_count: usize },
}
