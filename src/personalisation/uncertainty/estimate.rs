//! One row of `parameters.csv` a parameter: value, bounds, standard deviation and 95 % interval in physical units.

use nalgebra::DVector;
use serde::Serialize;

use super::Uncertainty;
use crate::numerics::NORMAL_QUANTILE_95;
use crate::personalisation::{FreeParameter, ParameterSpace};

/// Whether something holds a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BoundState {
    /// Nothing does.
    Free,
    /// Its lower bound.
    Lower,
    /// Its upper bound.
    Upper,
    /// The study, which does not seek it.
    Fixed,
}

/// A row of `parameters.csv`; physical units. What is not known is empty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// Name, with its unit last.
    pub parameter: &'static str,
    /// Unit, for people.
    pub unit: &'static str,
    /// Part of the heart.
    pub region: String,
    /// Start value.
    pub initial: f64,
    /// Value found.
    pub value: f64,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// Standard deviation (to first order through the transform).
    pub sd: Option<f64>,
    /// Lower end of the 95 % interval, mapped through the transform and cut at the bound.
    pub interval_low: Option<f64>,
    /// Upper end.
    pub interval_high: Option<f64>,
    /// What holds it.
    pub at_bound: BoundState,
}

/// The rows for all listed parameters, fixed ones too, at `coordinates`; without an `uncertainty` there are no intervals.
pub fn estimates(space: &ParameterSpace, coordinates: &DVector<f64>, uncertainty: Option<&Uncertainty>) -> Vec<ParameterEstimate> {
    let mut index = 0;
    let row = |entry: &FreeParameter| {
        if entry.fixed {
            return estimate(entry, entry.initial, None, BoundState::Fixed);
        }
        let coordinate = coordinates[index];
        let sd = uncertainty.and_then(|uncertainty| uncertainty.sd[index]).filter(|sd| sd.is_finite());
        index += 1;
        let state = if coordinate <= entry.transform.to_coordinate(entry.lower) {
            BoundState::Lower
        } else if coordinate >= entry.transform.to_coordinate(entry.upper) {
            BoundState::Upper
        } else {
            BoundState::Free
        };
        estimate(entry, entry.transform.to_value(coordinate), sd, state)
    };
    space.all().iter().map(row).collect()
}

fn estimate(entry: &FreeParameter, value: f64, sd: Option<f64>, at_bound: BoundState) -> ParameterEstimate {
    let spec = entry.parameter.parameter().spec();
    let end = |sign: f64| {
        let coordinate = entry.transform.to_coordinate(value);
        sd.map(|sd| entry.transform.to_value(coordinate + sign * NORMAL_QUANTILE_95 * sd).max(entry.lower).min(entry.upper))
    };
    ParameterEstimate {
        parameter: spec.name,
        unit: spec.unit,
        region: entry.region.clone(),
        initial: entry.initial,
        value,
        lower: entry.lower,
        upper: entry.upper,
        sd: sd.map(|sd| sd * entry.transform.slope(value)),
        interval_low: end(-1.0),
        interval_high: end(1.0),
        at_bound,
    }
}
