//! What can be wrong with a design, or with what is to be read by it.

/// Why a design cannot be made or read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SensitivityError {
    /// A setting outside its meaning.
    #[error("{what} = {value}; {remedy}")]
    Setting {
        /// Which setting.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        remedy: &'static str,
    },
    /// Values that are not those of the design.
    #[error("{found} values where the design has {expected} points")]
    Shape {
        /// Values given.
        found: usize,
        /// Points of the design.
        expected: usize,
    },
    /// The model failed at every point.
    #[error("there is no value at any of the {point_count} points of the design; narrow the ranges")]
    NothingEvaluated {
        /// Points of the design.
        point_count: usize,
    },
    /// Too little is left after failures.
    #[error("{found} rows are left after failures, and {expected} are needed; narrow the ranges or take more rows")]
    FewRows {
        /// Rows left.
        found: usize,
        /// Rows needed.
        expected: usize,
    },
    /// An output that does not vary, so that no share of its variance can be told.
    #[error("it is the same at all points of the design")]
    Constant,
}
