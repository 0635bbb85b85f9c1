//! Which parameters matter: tangents, Morris screening and Sobol' indices of whatever model.
//!
//! A [`Design`] says where in the unit cube of the inputs to evaluate; whoever holds the model does so, in any order, and the design reads one
//! output at a time. Points at which the model failed are gaps: they are left out, and every [`Index`] counts what it rests on.

mod bootstrap;
mod error;
mod input;
mod local;
mod morris;
mod sobol;

pub use error::SensitivityError;
pub use input::{ScreeningInput, Spacing, to_parameters};
pub use local::LocalDesign;
pub use morris::MorrisDesign;
pub use sobol::SobolDesign;

/// What an index measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// ∂y/∂x, in the output's unit over the input's.
    Slope,
    /// (x/y) ∂y/∂x.
    Elasticity,
    /// ∂y/∂x times the width of the input's range, in the output's unit.
    RangeEffect,
    /// Mean μ of the elementary effects, in the output's unit for the whole range.
    MeanEffect,
    /// Mean μ* of their sizes.
    MeanAbsoluteEffect,
    /// Their standard deviation σ: interaction or curvature.
    EffectSpread,
    /// Share S of the output's variance that the input explains alone.
    FirstOrder,
    /// Share that two inputs explain together beyond what each does alone.
    SecondOrder,
    /// Share T in which the input takes part, alone or with others.
    Total,
}

/// One number on how an input, or a pair of them, moves an output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Index {
    /// What it measures.
    pub measure: Measure,
    /// Index of the input.
    pub input: usize,
    /// The other input of [`Measure::SecondOrder`].
    pub partner: Option<usize>,
    /// Its value.
    pub value: f64,
    /// An interval for it: 95 % by bootstrap; of tangents the slopes to either side. `None` where too little is known.
    pub interval: Option<(f64, f64)>,
    /// Differences (local, Morris) or rows (Sobol') that it rests on.
    pub sample_count: usize,
}

/// Points in the unit cube of the inputs, and how to read what a model gives there.
#[derive(Debug, Clone, PartialEq)]
pub enum Design {
    /// Central differences about one point.
    Local(LocalDesign),
    /// Random one-at-a-time paths.
    Morris(MorrisDesign),
    /// Shares of variance.
    Sobol(SobolDesign),
}

impl Design {
    /// Where to evaluate the model.
    pub fn points(&self) -> &[Vec<f64>] {
        match self {
            Self::Local(design) => design.points(),
            Self::Morris(design) => design.points(),
            Self::Sobol(design) => design.points(),
        }
    }

    /// The indices of every input for one output, given its value at each point; `None`, or a value that is not finite, is a gap.
    ///
    /// # Errors
    /// [`SensitivityError`] if the values are not those of this design, nothing can be read from what is there, or the output is constant.
    pub fn indices(&self, response: &[Option<f64>]) -> Result<Vec<Index>, SensitivityError> {
        let values = with_gaps(response, self.points().len())?;
        match self {
            Self::Local(design) => Ok(design.indices(&values)),
            Self::Morris(design) => Ok(design.indices(&values)),
            Self::Sobol(design) => design.indices(&values),
        }
    }
}

/// Gaps as NaN, which no sum below takes in.
fn with_gaps(response: &[Option<f64>], point_count: usize) -> Result<Vec<f64>, SensitivityError> {
    if response.len() != point_count {
        return Err(SensitivityError::Shape { found: response.len(), expected: point_count });
    }
    let values: Vec<f64> = response.iter().map(|value| value.filter(|value| value.is_finite()).unwrap_or(f64::NAN)).collect();
    if values.iter().all(|value| value.is_nan()) {
        return Err(SensitivityError::NothingEvaluated { point_count });
    }
    Ok(values)
}

/// The values of a sample that are no gaps.
fn without_gaps(sample: impl IntoIterator<Item = f64>) -> Vec<f64> {
    sample.into_iter().filter(|value| value.is_finite()).collect()
}
