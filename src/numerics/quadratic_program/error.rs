//! Why a quadratic program has no answer.

/// Why a quadratic program has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum QpError {
    /// Sizes do not match.
    #[error("quadratic program: {what} has {found} entries where {expected} are needed")]
    Shape {
        /// Which datum.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size needed.
        expected: usize,
    },
    /// A datum is NaN or infinite.
    #[error("quadratic program: {what} is not finite")]
    NonFinite {
        /// Which datum.
        what: &'static str,
    },
    /// The Hessian is not symmetric.
    #[error("quadratic program: the Hessian is not symmetric (largest difference {difference:e})")]
    Asymmetric {
        /// Largest |H − Hᵀ|.
        difference: f64,
    },
    /// The Hessian has a negative eigenvalue: the problem is not convex.
    #[error("quadratic program: the Hessian has the negative eigenvalue {eigenvalue:e}; add regularisation or a prior")]
    Indefinite {
        /// The smallest eigenvalue.
        eigenvalue: f64,
    },
    /// A lower bound lies above its upper bound.
    #[error("quadratic program: bounds of variable {variable} exclude each other ({lower} > {upper})")]
    BoundsCross {
        /// Index of the variable.
        variable: usize,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// The trust radius is not positive or a scale is negative.
    #[error(
        "quadratic program: trust region with radius {radius} and smallest scale {scale}; the radius must be positive, no scale negative"
    )]
    TrustRegion {
        /// Radius.
        radius: f64,
        /// Smallest scale.
        scale: f64,
    },
    /// No point satisfies all constraints.
    #[error("quadratic program: the constraints exclude each other")]
    Infeasible,
    /// The objective falls without end.
    #[error("quadratic program: unbounded below; add bounds, a trust region or a prior")]
    Unbounded,
    /// The interior-point iteration stopped without a solution.
    #[error("quadratic program: not converged after {iterations} iterations ({status})")]
    NotConverged {
        /// What the solver says.
        status: String,
        /// Iterations done.
        iterations: u32,
    },
}
