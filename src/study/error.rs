//! What can be wrong with a study file, said with its place, the value found and the remedy.

use std::fmt;
use std::path::PathBuf;

/// One thing wrong in a study file.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem {
    /// Full key, `table.key`.
    pub key: String,
    /// Line of the file, counted from one; none if the key is absent or was set on the command line.
    pub line: Option<usize>,
    /// The value found, as TOML; none if the key is absent or its value is not the trouble.
    pub value: Option<String>,
    /// What is wrong.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "line {line}: {}", self.key)?,
            None => write!(f, "{}", self.key)?,
        }
        if let Some(value) = &self.value {
            write!(f, " = {value}")?;
        }
        write!(f, " {}; {}", self.what, self.remedy)
    }
}

/// Why a study file has no plan.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The study file cannot be read.
    #[error("cannot read the study file {}; give the path of a study.toml", file.display())]
    Unreadable {
        /// The study file.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The study file is not TOML.
    #[error("{} is not valid TOML:\n{message}", file.display())]
    NotToml {
        /// The study file.
        file: PathBuf,
        /// The parser's words, with line and column.
        message: String,
    },
    /// A `--set` that cannot be understood.
    #[error("--set {text}: {reason}; write --set table.key=value, for example --set mechanics.step_s=0.005")]
    BadOverride {
        /// What was typed.
        text: String,
        /// Why it cannot be used.
        reason: String,
    },
    /// Keys or values that make no plan.
    #[error("{} has {} {}:{}", file.display(), problems.len(), if problems.len() == 1 { "error" } else { "errors" }, listed(problems))]
    Invalid {
        /// The study file.
        file: PathBuf,
        /// Everything wrong with it, in the order found.
        problems: Vec<Problem>,
    },
}

fn listed(problems: &[Problem]) -> String {
    problems.iter().map(|problem| format!("\n  {problem}")).collect()
}
