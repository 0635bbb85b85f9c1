//! What a patient's run tells, among those of others: its warnings under its name, and nothing else.

use crate::study::Progress;

/// Listens to one patient for whoever listens to the cohort.
pub(super) struct PatientProgress<'a> {
    pub(super) name: &'a str,
    pub(super) cohort: &'a dyn Progress,
}

impl Progress for PatientProgress<'_> {
    fn stage(&self, _: &str, _: Option<u64>) {}
    fn step(&self, _: u64) {}
    fn finish(&self) {}
    fn warning(&self, text: &str) {
        self.cohort.warning(&format!("{}: {text}", self.name));
    }
}
