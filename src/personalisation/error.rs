//! What can go wrong while parameters are sought, and what to do about it.

use crate::heart::OutOfRange;
use crate::numerics::QpError;

/// An error and its causes in one line.
pub(super) fn chain(error: &dyn std::error::Error) -> String {
    let mut words = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let more = inner.to_string();
        // Transparent errors repeat their cause's words.
        if !words.contains(&more) {
            words = format!("{words}: {more}");
        }
        cause = inner.source();
    }
    words
}

/// Why a personalisation cannot go on. A search that ends without converging is an outcome, not an error.
#[derive(Debug, thiserror::Error)]
pub enum PersonalisationError {
    /// A value outside the physical range of its parameter.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// A free parameter is described inconsistently.
    #[error("parameter {name} ({region}): {reason}")]
    FreeParameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its region.
        region: String,
        /// What is wrong, with the numbers.
        reason: String,
    },
    /// Two data that belong together differ in size.
    #[error("{what}: {found} where {expected} are needed")]
    Shape {
        /// What is compared.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size needed.
        expected: usize,
    },
    /// A setting or a datum outside its meaning.
    #[error("{what} = {value}; {remedy}")]
    Setting {
        /// Which setting.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        remedy: &'static str,
    },
    /// The model could not be simulated.
    #[error("simulation failed at coordinates {coordinates:?}: {source}")]
    Simulation {
        /// The transformed parameters.
        coordinates: Vec<f64>,
        /// The model's own error.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A residual row is NaN or infinite.
    #[error("residual row {row} is {value} at coordinates {coordinates:?}")]
    NonFiniteResidual {
        /// The row.
        row: usize,
        /// Its value.
        value: f64,
        /// The transformed parameters.
        coordinates: Vec<f64>,
    },
    /// The quadratic program of a step has no answer.
    #[error("Gauss-Newton step: {0}")]
    Step(#[from] QpError),
    /// Someone asked to stop before there was anything to return.
    #[error("stopped on request before the first evaluation was complete")]
    Stopped,
    /// The optimisation library refused to run.
    #[error("optimiser: {0}")]
    Optimiser(String),
}
