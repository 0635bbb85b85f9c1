//! Numerical ground floor: block-sparse matrices, factorisation, quadratic programs, statistics.

mod error;
mod factor;
mod krylov;
mod quadratic_program;
mod sparse;

pub use error::LinearSolveError;
pub use factor::{CholeskyFactor, CholeskyStructure, CholeskyWorkspace};
pub use krylov::{ConjugateGradientOutcome, KrylovLimits, KrylovReport, KrylovWorkspace, conjugate_gradients, gmres};
pub use quadratic_program::{QpError, QpSolution, QuadraticProgram};
pub use sparse::{BlockMatrix, BlockPattern};
