//! Numerical ground floor: block-sparse matrices, factorisation, quadratic programs, statistics.

mod compact_factor;
mod error;
mod factor;
mod krylov;
mod panels;
mod quadratic_program;
mod rounding;
mod sparse;
mod statistics;
mod taylor;

pub use compact_factor::{CompactFactor, CompactWorkspace};
pub use error::LinearSolveError;
pub use factor::{CholeskyFactor, CholeskyStructure, CholeskyWorkspace, FactorScalar};
pub use krylov::{ConjugateGradientOutcome, KrylovLimits, KrylovReport, KrylovWorkspace, conjugate_gradients, gmres};
pub use panels::PanelWorkspace;
pub use quadratic_program::{QpError, QpSolution, QuadraticProgram};
pub use rounding::rounded_max;
pub use sparse::{BlockMatrix, BlockPattern};
pub use statistics::{
    NORMAL_QUANTILE_95, chi_square_quantile, mean, median, quantile, robust_standard_deviation, root_mean_square, standard_deviation,
};
pub use taylor::TaylorTest;
