//! `[[prediction]]` and `parameters_from`: what a heart with parameters found before does under other onsets.

use std::collections::BTreeSet;
use std::path::PathBuf;

use super::model::{self, OnsetPlan};
use crate::heart::{Parameter, Parameters, Part, RegionalParameter};
use crate::report::{FoundParameter, read_parameters};
use crate::study::reader::{Choice, TableReader};

/// Name of the heart's own onset among the predicted ones.
pub const OWN_ONSET: &str = "own";

/// One onset to be predicted.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictionPlan {
    /// `name`: of the row and the figures.
    pub name: String,
    /// `onset` and `[[prediction.site]]`.
    pub onset: OnsetPlan,
}

pub(super) fn read(root: &TableReader) -> Vec<PredictionPlan> {
    let tables = root.tables("prediction");
    let plans: Vec<PredictionPlan> = tables.into_iter().map(read_one).collect();
    for (number, plan) in plans.iter().enumerate() {
        if plans[..number].iter().any(|other| other.name == plan.name) {
            root.problem("prediction", format!("has \"{}\" twice", plan.name), "give every onset a name of its own");
        }
    }
    plans
}

fn read_one(table: TableReader) -> PredictionPlan {
    let onset = model::read_onset_sites(&table);
    let name = table.text("name").unwrap_or_else(|| onset.place.word()).to_owned();
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '_' || letter == '-';
    if name.is_empty() || !name.chars().all(is_plain) {
        table.problem("name", "is no name of a file", "write letters, digits, - and _");
    }
    if name == OWN_ONSET {
        table.problem("name", "is the name of the heart's own onset", "give it another name");
    }
    table.close();
    PredictionPlan { name, onset }
}

/// Reads what an earlier personalisation found (`parameters_from`, a `parameters.csv`) over what the study writes; what it held is left
/// as the study has it.
pub(super) fn read_found(root: &TableReader, parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) -> Option<PathBuf> {
    const KEY: &str = "parameters_from";
    let file = root.result_file(KEY)?;
    if !file.is_file() {
        return Some(file);
    }
    let remedy = "name a parameters.csv that `personalise` left";
    let rows = match read_parameters(&file) {
        Ok(rows) => rows,
        Err(error) => {
            root.problem(KEY, format!("is no table of parameters: {error}"), remedy);
            return Some(file);
        }
    };
    let found: Vec<FoundParameter> = rows.into_iter().filter(|row| row.state != "fixed").collect();
    if found.is_empty() {
        root.problem(KEY, "names a table in which nothing was found", remedy);
    }
    for row in found {
        let known = Parameter::from_name(&row.parameter).map(|parameter| {
            let part = Part::from_name(&row.region).unwrap_or(Part::Whole);
            RegionalParameter::new(parameter, part).unwrap_or(parameter.into())
        });
        let Some(regional) = known else {
            root.problem(KEY, format!("names a table with \"{}\", which is no parameter", row.parameter), remedy);
            continue;
        };
        match parameters.set(regional, row.value) {
            Ok(()) => drop(written.insert(regional)),
            Err(error) => root.problem(KEY, format!("names a table with a value that cannot be: {error}"), remedy),
        }
    }
    Some(file)
}
