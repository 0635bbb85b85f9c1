//! The rows of `runs.csv` and `times.csv`: what they are called, whose they are, and what was left by earlier runs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::RunError;
use crate::report::{Ledger, LedgerContents, LedgerRow};
use crate::study::plan::SensitivityPlan;

/// Columns behind inputs and outputs.
const OUTCOME_COLUMNS: &[&str] = &["status", "phase_reached", "time_reached_s", "iterations", "residual_ml", "reason"];

/// Rows of a study by run.
pub(super) struct Records {
    runs_file: PathBuf,
    times_file: PathBuf,
    run_columns: Vec<String>,
    runs: BTreeMap<usize, LedgerRow>,
    times: BTreeMap<usize, LedgerRow>,
    damaged_count: usize,
    output_place: usize,
}

impl Records {
    /// What two tables hold of a study; nothing of tables that are not there.
    ///
    /// # Errors
    /// [`RunError::ForeignRuns`] if the table is another study's.
    pub(super) fn read(runs_file: &Path, times_file: &Path, wanted: &SensitivityPlan, owner: u64) -> Result<Self, RunError> {
        let run_columns = columns(wanted);
        let contents = LedgerContents::read(runs_file, &run_columns)?;
        let foreign = || RunError::ForeignRuns { file: runs_file.to_path_buf() };
        if contents.has_other_columns || contents.rows.values().any(|row| row.owner != owner) {
            return Err(foreign());
        }
        let times = LedgerContents::read(times_file, &time_columns())?;
        let point_count = wanted.design.points().len();
        let by_run = |contents: LedgerContents| -> BTreeMap<usize, LedgerRow> {
            let rows = contents.rows.into_iter().filter(|(_, row)| row.owner == owner);
            rows.filter_map(|(key, row)| Some((key.parse().ok()?, row))).filter(|(run, _)| *run < point_count).collect()
        };
        Ok(Self {
            runs_file: runs_file.to_path_buf(),
            times_file: times_file.to_path_buf(),
            damaged_count: contents.damaged_count,
            output_place: 1 + wanted.inputs.len(),
            runs: by_run(contents),
            times: by_run(times),
            run_columns,
        })
    }

    /// Whether a run is done.
    pub(super) fn has(&self, run: usize) -> bool {
        self.runs.contains_key(&run)
    }

    /// Adds the rows of another part.
    pub(super) fn take_in(&mut self, other: Self) {
        self.runs.extend(other.runs);
        self.times.extend(other.times);
        self.damaged_count += other.damaged_count;
    }

    /// What is to be said of the tables.
    pub(super) fn warnings(&self) -> Vec<String> {
        let said = |count| format!("{}: {count} rows were cut off or garbled; they are run again", self.runs_file.display());
        Some(self.damaged_count).filter(|&count| count > 0).map(said).into_iter().collect()
    }

    /// Writes the good rows in the order of the runs.
    pub(super) fn keep(&self) -> Result<(), RunError> {
        Ledger::write(&self.runs_file, &self.run_columns, self.runs.values())?;
        Ok(Ledger::write(&self.times_file, &time_columns(), self.times.values())?)
    }

    /// Both tables with their good rows, to be added to.
    pub(super) fn open(&self) -> Result<(Ledger, Ledger), RunError> {
        let runs = Ledger::open(&self.runs_file, &self.run_columns, self.runs.values())?;
        Ok((runs, Ledger::open(&self.times_file, &time_columns(), self.times.values())?))
    }

    /// An output at every point of the design.
    pub(super) fn response(&self, output: usize, point_count: usize) -> Vec<Option<f64>> {
        self.column(self.output_place + output, point_count)
    }

    /// An input at every point of the design.
    pub(super) fn input(&self, input: usize, point_count: usize) -> Vec<Option<f64>> {
        self.column(1 + input, point_count)
    }

    fn column(&self, place: usize, point_count: usize) -> Vec<Option<f64>> {
        let value = |run| self.runs.get(&run)?.fields.get(place)?.parse().ok();
        (0..point_count).map(value).collect()
    }

    /// Runs that failed, with the first one's reason.
    pub(super) fn failures(&self) -> (usize, Option<&str>) {
        let place = self.run_columns.len() - OUTCOME_COLUMNS.len();
        let failed = || self.runs.values().filter(|row| row.fields.get(place).is_some_and(|status| status == "failed"));
        (failed().count(), failed().next().and_then(|row| row.fields.last()).map(String::as_str))
    }

    /// Time that all runs took together, s, as far as it is known.
    pub(super) fn wall_time_s(&self) -> f64 {
        self.times.values().filter_map(|row| row.fields.get(1)?.parse::<f64>().ok()).sum()
    }
}

fn columns(wanted: &SensitivityPlan) -> Vec<String> {
    let inputs = wanted.inputs.iter().map(|input| input.parameter().name());
    let outcome = OUTCOME_COLUMNS.iter().map(ToString::to_string);
    std::iter::once("run".to_string()).chain(inputs).chain(wanted.outputs.iter().cloned()).chain(outcome).collect()
}

fn time_columns() -> Vec<String> {
    ["run", "wall_time_s"].map(str::to_string).to_vec()
}
