//! Exit codes, all in one place.

use std::process::ExitCode;

use crate::image::ImageError;
use crate::study::{FollowError, InitError, RunError, Status, StudyError};

/// How the program ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Exit {
    /// All went to its end.
    Done,
    /// A run failed.
    Failed,
    /// A study file, an argument or a file that they name is wrong.
    BadInput,
    /// Stopped by Ctrl-C, as shells count it (128 + SIGINT).
    Interrupted,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(match exit {
            Exit::Done => 0,
            Exit::Failed => 1,
            Exit::BadInput => 2,
            Exit::Interrupted => 130,
        })
    }
}

impl From<Status> for Exit {
    fn from(status: Status) -> Self {
        match status {
            Status::Converged | Status::OnBound | Status::IterationLimit => Self::Done,
            Status::Stopped => Self::Interrupted,
            Status::Failed => Self::Failed,
        }
    }
}

impl From<&anyhow::Error> for Exit {
    fn from(error: &anyhow::Error) -> Self {
        match error.downcast_ref::<RunError>() {
            Some(RunError::Stopped) => Self::Interrupted,
            Some(
                RunError::Image(_)
                | RunError::FrameOutOfRange { .. }
                | RunError::BaseMotion { .. }
                | RunError::NothingToFit
                | RunError::NothingToMerge { .. }
                | RunError::ForeignRuns { .. }
                | RunError::Input { .. },
            ) => Self::BadInput,
            Some(_) => Self::Failed,
            None if matches!(error.downcast_ref(), Some(InitError::Report(_))) => Self::Failed,
            None if error.is::<InitError>() || error.is::<StudyError>() || error.is::<ImageError>() || error.is::<FollowError>() => {
                Self::BadInput
            }
            None => Self::Failed,
        }
    }
}
