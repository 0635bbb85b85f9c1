//! Numerical ground floor: block-sparse matrices, factorisation, quadratic programs, statistics.

mod quadratic_program;

pub use quadratic_program::{QpError, QpSolution, QuadraticProgram};
