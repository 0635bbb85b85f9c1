//! The journal of a calibration on disk: a run that was stopped, or fell, goes on from it.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::error::RunError;
use crate::personalisation::JournalEntry;
use crate::report::ReportError;
use crate::study::Provenance;

/// A journal that is being written, with what an earlier run of the same study left in it.
pub(super) struct JournalFile {
    path: PathBuf,
    file: Mutex<File>,
    entries: Vec<JournalEntry>,
}

impl JournalFile {
    /// Opens the journal; one that another study, other settings or another version of the program began is begun anew.
    pub(super) fn open(path: PathBuf, provenance: &Provenance) -> Result<Self, RunError> {
        let head = head(provenance);
        let entries = entries(&path, &head);
        let open = || -> std::io::Result<File> {
            if !entries.is_empty() {
                // What was cut off at the end is cut away.
                let text: String = entries.iter().map(|entry| format!("{entry}\n")).collect();
                std::fs::write(&path, format!("{head}\n{text}"))?;
                return OpenOptions::new().append(true).open(&path);
            }
            let mut file = File::create(&path)?;
            writeln!(file, "{head}")?;
            Ok(file)
        };
        let file = open().map_err(|source| ReportError::Write { file: path.clone(), source })?;
        Ok(Self { path, file: Mutex::new(file), entries })
    }

    /// What an earlier run computed.
    pub(super) fn entries(&self) -> &[JournalEntry] {
        &self.entries
    }

    /// Adds a line. A disk that is full costs the journal, not the run.
    pub(super) fn append(&self, entry: &JournalEntry) {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let _lost = writeln!(file, "{entry}").and_then(|()| file.flush());
    }

    /// Takes the journal away: the search is over.
    pub(super) fn discard(self) {
        let Self { path, file, .. } = self;
        drop(file);
        let _there_or_not = std::fs::remove_file(path);
    }
}

/// What must agree for an earlier journal to be of use.
fn head(provenance: &Provenance) -> String {
    let Provenance { version, study_hash, settings, .. } = provenance;
    format!("cardiotwin calibration journal, version {version}, study {study_hash}, settings {settings:?}")
}

fn entries(path: &Path, head: &str) -> Vec<JournalEntry> {
    let Ok(text) = std::fs::read_to_string(path) else { return Vec::new() };
    let mut lines = text.lines();
    if lines.next() != Some(head) {
        return Vec::new();
    }
    lines.map_while(|line| line.parse().ok()).collect()
}
