//! What can go wrong while results are written.

use std::path::PathBuf;

/// Why a file could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The folder cannot be made.
    #[error("cannot make the folder {}; choose another with -o DIR or output.directory", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file cannot be written; what stood there before stands there still.
    #[error("cannot write {}; see that its folder is writable and the disk is not full", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file that an earlier run left cannot be read.
    #[error("cannot read {}, which an earlier run left; make it readable, or choose another folder with -o DIR", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A figure cannot be drawn.
    #[error("cannot draw {figure}: {reason}")]
    Figure {
        /// Which figure.
        figure: &'static str,
        /// Why.
        reason: String,
    },
}
