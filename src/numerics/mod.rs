//! Numerical ground floor: block-sparse matrices, factorisation, quadratic programs, statistics.
