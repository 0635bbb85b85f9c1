//! A cohort: one base study for every patient of a table, side by side, each on its own: what fails is a row, and nobody else's end.

mod progress;
mod report;
mod table;

use std::collections::BTreeMap;
use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};

use progress::PatientProgress;
use table::PatientTable;

use super::identity::{document_hash, identity};
use super::reader::Reader;
use super::run::{run, side_by_side};
use super::shard::Shard;
use super::{Config, Outcome, Overrides, Plan, RunContext, RunError, Status, StudyError};
use crate::report::{Ledger, LedgerContents, LedgerRow, create_folder};

/// A cohort file as meant.
#[derive(Debug, Clone, PartialEq)]
pub struct Cohort {
    /// Name of the file.
    pub name: String,
    /// The study that all patients share.
    pub base: PathBuf,
    /// The folder of the results; every patient has its own inside.
    pub directory: PathBuf,
    /// The patients, in the order of the file.
    pub patients: Vec<CohortPatient>,
}

/// What is a patient's own.
#[derive(Debug, Clone, PartialEq)]
pub struct CohortPatient {
    /// Name, of the folder too.
    pub name: String,
    /// Folder of the data, in place of the base study's.
    pub data: Option<PathBuf>,
    /// Settings `table.key=value`, those of the cohort first.
    pub settings: Vec<String>,
}

impl Cohort {
    /// Whether a file is a cohort and not a study.
    pub fn is_one(config: &Config) -> bool {
        config.document.contains_key("base") || config.document.contains_key("patient")
    }

    /// Validates a cohort file; the patients' studies are looked at when they run.
    ///
    /// # Errors
    /// [`StudyError::Invalid`] with everything that is wrong.
    pub fn new(config: &Config) -> Result<Self, StudyError> {
        let reader = Reader::new(config);
        let root = reader.root();
        let base = root.text("base").map(|base| config.folder().join(base));
        match &base {
            None => root.missing("base", "the study file that all patients share"),
            Some(base) if !base.is_file() => {
                root.problem("base", "names no file", format!("{} does not exist", base.display()));
            }
            Some(_) => {}
        }
        let written = config.folder().join(root.text("directory").unwrap_or("results"));
        let common = root.settings("set");
        let mut patients: Vec<CohortPatient> = Vec::new();
        for table in root.tables("patient") {
            let name = table.text("name").unwrap_or_default().to_string();
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
            if name.is_empty() || name.starts_with('.') || !name.chars().all(is_plain) {
                table.problem("name", "is no name of a folder", "write letters, digits, - and _");
            } else if patients.iter().any(|other| other.name == name) {
                table.problem("name", "stands twice", "give every patient its own name");
            }
            let data = table.text("data").map(|data| config.folder().join(data));
            let settings = common.iter().cloned().chain(table.settings("set")).collect();
            table.close();
            patients.push(CohortPatient { name, data, settings });
        }
        if patients.is_empty() {
            root.missing("patient", "[[patient]] with a name, once for each");
        }
        root.close();
        let problems = reader.into_problems();
        let name = config.file().file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        match base {
            Some(base) if problems.is_empty() => {
                Ok(Self { name, base, directory: config.overrides.output.clone().unwrap_or(written), patients })
            }
            _ => Err(StudyError::Invalid { file: config.file().to_path_buf(), problems }),
        }
    }

    /// Runs the patients that are missing, have failed or have changed, or those of a shard, and writes the table and its report.
    ///
    /// # Errors
    /// [`RunError`] if the cohort's own files cannot be written; what goes wrong with a patient is a row.
    pub fn run(&self, shard: Option<Shard>, context: &RunContext) -> Result<Outcome, RunError> {
        create_folder(&self.directory)?;
        let (table, file) = (PatientTable::new(self), self.directory.join(Shard::file_name(shard, "patients")));
        let own: Vec<&CohortPatient> =
            self.numbered().filter(|(place, _)| shard.is_none_or(|shard| shard.holds(*place))).map(|(_, p)| p).collect();
        let mut rows = LedgerContents::read(&file, table.columns())?.rows;
        rows.retain(|_, row| self.is_done(&table, row));
        let pending: Vec<&CohortPatient> = own.iter().copied().filter(|patient| !rows.contains_key(&patient.name)).collect();
        let ledger = Ledger::open(&file, table.columns(), rows.values())?;
        let found = Mutex::new(rows);
        context.progress().stage("running the patients", Some(own.len() as u64));
        let done = AtomicU64::new((own.len() - pending.len()) as u64);
        context.progress().step(done.load(Ordering::Relaxed));
        side_by_side(
            &pending,
            || context.is_stopped(),
            |patient| {
                let Some(row) = self.row(&table, patient, context) else { return Ok(()) };
                ledger.append(&row)?;
                found.lock().unwrap_or_else(PoisonError::into_inner).insert(patient.name.clone(), row);
                context.progress().step(done.fetch_add(1, Ordering::Relaxed) + 1);
                Ok(())
            },
        )?;
        context.progress().stage("writing results", None);
        let rows = found.into_inner().unwrap_or_else(PoisonError::into_inner);
        let in_order = own.iter().filter_map(|patient| rows.get(&patient.name));
        Ledger::write(&file, table.columns(), in_order)?;
        let outcome = match shard {
            Some(_) => Ok(self.outcome(&table, &own, &rows, context.is_stopped())),
            None => self.leave(&table, &own, &rows, context.is_stopped()),
        };
        context.progress().finish();
        outcome
    }

    /// Gathers the rows of all shards. To do it again changes nothing.
    ///
    /// # Errors
    /// [`RunError`] if the tables cannot be read or written.
    pub fn merge(&self) -> Result<Outcome, RunError> {
        create_folder(&self.directory)?;
        let table = PatientTable::new(self);
        let all: Vec<&CohortPatient> = self.patients.iter().collect();
        let mut rows = BTreeMap::new();
        for name in std::iter::once("patients.csv".to_string()).chain(Shard::files(&self.directory, "patients")) {
            for (patient, row) in LedgerContents::read(&self.directory.join(name), table.columns())?.rows {
                // A row of a patient that succeeded stands, whatever another part says.
                if self.is_done(&table, &row) || !rows.contains_key(&patient) {
                    rows.insert(patient, row);
                }
            }
        }
        let in_order = all.iter().filter_map(|patient| rows.get(&patient.name));
        Ledger::write(&self.directory.join("patients.csv"), table.columns(), in_order)?;
        self.leave(&table, &all, &rows, false)
    }

    fn numbered(&self) -> impl Iterator<Item = (usize, &CohortPatient)> {
        self.patients.iter().enumerate()
    }

    /// The folder of a patient's results.
    fn folder(&self, patient: &CohortPatient) -> PathBuf {
        self.directory.join(&patient.name)
    }

    /// The base study with what is a patient's own.
    fn config(&self, patient: &CohortPatient) -> Result<Config, StudyError> {
        let overrides = Overrides { data: patient.data.clone(), output: Some(self.folder(patient)), settings: patient.settings.clone() };
        Config::read(&self.base, overrides)
    }

    /// Whether a row is of a patient of this cohort who came to an end and has not changed since.
    fn is_done(&self, table: &PatientTable, row: &LedgerRow) -> bool {
        let owner = || {
            let patient = self.patients.iter().find(|patient| Some(&patient.name) == row.fields.first())?;
            let config = self.config(patient).ok()?;
            identity(&Plan::new(&config).ok()?, document_hash(&config)).ok()
        };
        !table.has_failed(row) && owner() == Some(row.owner)
    }

    /// Runs a patient; none if it was stopped.
    fn row(&self, table: &PatientTable, patient: &CohortPatient, context: &RunContext) -> Option<LedgerRow> {
        let mut owner = 0;
        let attempt = || -> Result<Status, Box<dyn Error>> {
            let config = self.config(patient)?;
            let plan = Plan::new(&config)?;
            owner = identity(&plan, document_hash(&config))?;
            let progress = PatientProgress { name: &patient.name, cohort: context.progress() };
            Ok(run(&plan, &RunContext::new(&progress, context.stop()))?.status)
        };
        let end = catch_unwind(AssertUnwindSafe(attempt))
            .unwrap_or_else(|_| Err("the program met a state that it holds to be impossible".into()));
        let row = match end {
            _ if context.is_stopped() => return None,
            Ok(status) => table.row(owner, patient, status, &self.folder(patient)),
            Err(error) => Err(error),
        };
        Some(row.unwrap_or_else(|error| {
            let reason = reason(error.as_ref());
            context.progress().warning(&format!("{} failed: {reason}", patient.name));
            table.failed_row(owner, patient, &reason)
        }))
    }

    /// Writes the report of a whole cohort.
    fn leave(
        &self,
        table: &PatientTable,
        patients: &[&CohortPatient],
        rows: &BTreeMap<String, LedgerRow>,
        is_stopped: bool,
    ) -> Result<Outcome, RunError> {
        report::write(&self.directory, &self.name, table, patients, rows)?;
        Ok(self.outcome(table, patients, rows, is_stopped))
    }

    fn outcome(&self, table: &PatientTable, patients: &[&CohortPatient], rows: &BTreeMap<String, LedgerRow>, is_stopped: bool) -> Outcome {
        let line = |patient: &&CohortPatient| match rows.get(&patient.name) {
            Some(row) => format!("{}: {}", patient.name, table.words(row)),
            None => format!("{}: not run", patient.name),
        };
        let missing = patients.iter().any(|patient| !rows.contains_key(&patient.name));
        let failed = patients.iter().any(|patient| rows.get(&patient.name).is_some_and(|row| table.has_failed(row)));
        let status = match (is_stopped && missing, failed || missing) {
            (true, _) => Status::Stopped,
            (false, true) => Status::Failed,
            (false, false) => Status::Converged,
        };
        Outcome { status, directory: self.directory.clone(), headlines: patients.iter().map(line).collect() }
    }
}

/// An error with its causes in one line.
fn reason(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        if !text.contains(&inner.to_string()) {
            text = format!("{text}; because: {inner}");
        }
        cause = inner.source();
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The summary of the run in a patient's folder.
fn summary_file(folder: &Path) -> PathBuf {
    folder.join("summary.json")
}

#[cfg(test)]
mod tests;
