//! Writers of what a run leaves: CSV, JSON, mesh series and figures; they compute nothing, and a file is either absent or complete, but for
//! ledgers, which grow a row at a time.

mod atomic;
mod error;
pub mod figures;
mod fingerprint;
pub mod html;
mod ledger;
mod series;
mod tables;

pub use atomic::{WritingStopped, create_folder, remove, stop_writing, write_atomically};
pub use error::ReportError;
pub use fingerprint::{FINGERPRINT_START, fingerprint, fingerprint_on};
pub use ledger::{Ledger, LedgerContents, LedgerRow};
pub use series::write_pvd;
pub use tables::{
    FoundParameter, IterationRow, ParameterRow, PathRow, read_json_numbers, read_parameters, write_csv, write_iterations, write_json,
};
