//! How a run ended, in the words of `summary.json`.

use std::path::PathBuf;

use serde::Serialize;

/// How a run ended; not to converge is an outcome, not an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// It went to its end (a search: its steps became small).
    Converged,
    /// It converged with a parameter on its bound.
    OnBound,
    /// Its iterations were used up before it converged.
    IterationLimit,
    /// It was asked to stop; what it had by then is written.
    Stopped,
    /// It could not be completed; what it had by then is written.
    Failed,
}

impl Status {
    /// The word of `summary.json`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::OnBound => "on_bound",
            Self::IterationLimit => "iteration_limit",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
        }
    }
}

impl Serialize for Status {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.word())
    }
}

/// What a run left.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// How it ended.
    pub status: Status,
    /// The folder of its files.
    pub directory: PathBuf,
    /// A few lines for whoever ran it: what was found, in plain words.
    pub headlines: Vec<String>,
}
