//! What can go wrong when a linear system is solved.

/// A system that could not be factorised or solved, with the place and the amount.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum LinearSolveError {
    /// A pivot of the Cholesky factorisation is not positive (or not a number).
    #[error("the matrix is not positive definite: the pivot at vertex {vertex} is not positive; check stiffness, springs and loads there")]
    NotPositiveDefinite { vertex: usize },
    /// The vertex graph could not be ordered.
    #[error("the vertex graph ({vertex_count} vertices) could not be ordered: {reason}")]
    Ordering { vertex_count: usize, reason: String },
    /// The factor does not fit in memory or in the index type.
    #[error("the factor of a system of {vertex_count} vertices does not fit in memory")]
    OutOfMemory { vertex_count: usize },
    /// Two things that belong together have different sizes.
    #[error("{what}: {found} entries where {expected} are needed")]
    Size { what: &'static str, expected: usize, found: usize },
    /// An iterative solve did not reach its tolerance.
    #[error(
        "right-hand side {right_hand_side}: relative residual {relative_residual:.3e} after {iteration_count} iterations, \
         tolerance {tolerance:.1e}; lower the gains or the step"
    )]
    NotConverged { right_hand_side: usize, relative_residual: f64, iteration_count: usize, tolerance: f64 },
    /// A right-hand side or a residual is NaN or infinite.
    #[error("right-hand side {right_hand_side} is not finite")]
    NotFinite { right_hand_side: usize },
}
