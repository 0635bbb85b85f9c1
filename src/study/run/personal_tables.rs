//! The tables that a personalisation leaves beside its parameters: iterations, stages, correlations, spectrum, sensitivities, profiles.

use std::path::Path;

use serde::Serialize;

use super::error::RunError;
use super::personalise::Personalised;
use super::search::Found;
use crate::personalisation::{IterationRecord, ParameterSpace};
use crate::report::{IterationRow, write_csv, write_iterations};

/// A row of `correlations.csv`: two free parameters that no bound holds.
#[derive(Debug, Clone, Serialize)]
struct CorrelationRow {
    first: String,
    second: String,
    correlation: f64,
}

/// A row of `spectrum.csv`: a parameter's part in a direction that the data know; directions in descending order.
#[derive(Debug, Clone, Serialize)]
struct SpectrumRow {
    direction: usize,
    /// How much more the data know than the prior (or a quarter of the bounds) does; below one less.
    singular_value: f64,
    parameter: String,
    component: f64,
}

/// Writes all of them.
pub(super) fn write_tables(folder: &Path, personalised: &Personalised) -> Result<(), RunError> {
    let (found, space) = (&personalised.found, &personalised.space);
    write_csv(&folder.join("stages.csv"), &personalised.stages)?;
    write_csv(&folder.join("rounds.csv"), &personalised.rounds)?;
    write_iterations(&folder.join("iterations.csv"), &space.names(), &iteration_rows(&found.calibration.records, space))?;
    write_csv(&folder.join("sensitivities.csv"), &found.sensitivities)?;
    if let Some(uncertainty) = &found.uncertainty {
        let names = space.names();
        let name = |place: usize| names[uncertainty.free[place]].clone();
        let count = uncertainty.free.len();
        let pairs = (0..count).flat_map(|first| (first + 1..count).map(move |second| (first, second)));
        let correlation = |(first, second)| CorrelationRow {
            first: name(first),
            second: name(second),
            correlation: uncertainty.correlations[(first, second)],
        };
        write_csv(&folder.join("correlations.csv"), &pairs.map(correlation).collect::<Vec<_>>())?;
        let parts = (0..count).flat_map(|direction| (0..count).map(move |place| (direction, place)));
        let part = |(direction, place): (usize, usize)| SpectrumRow {
            direction: direction + 1,
            singular_value: uncertainty.singular_values[direction],
            parameter: name(place),
            component: uncertainty.directions[(place, direction)],
        };
        write_csv(&folder.join("spectrum.csv"), &parts.map(part).collect::<Vec<_>>())?;
    }
    if !found.profiles.is_empty() {
        write_csv(&folder.join("profiles.csv"), &found.profiles)?;
    }
    Ok(())
}

/// The rows of `iterations.csv`.
pub(super) fn iteration_rows(records: &[IterationRecord], space: &ParameterSpace) -> Vec<IterationRow> {
    let row = |record: &IterationRecord| IterationRow {
        iteration: record.iteration as usize,
        cost: record.cost,
        step: record.step_norm,
        simulations: record.spent.ceil() as usize,
        status: record.status.word().into(),
        values: space.to_values(&record.coordinates),
    };
    records.iter().map(row).collect()
}

/// What the search says of itself in words: the verdict, what holds it, what it violates.
pub(super) fn verdict(found: &Found, space: &ParameterSpace) -> Vec<String> {
    let mut words = found.uncertainty.as_ref().map(|uncertainty| uncertainty.verdict(&space.names())).unwrap_or_default();
    words.extend(found.active.iter().map(|held| format!("{held}.")));
    words.extend(found.violated.iter().map(|label| {
        format!("The constraint `{label}` cannot be met together with the others and the bounds: what was found violates it; loosen one of them.")
    }));
    words
}
