//! Writers of what a run leaves: CSV, JSON, mesh series and figures; they compute nothing, and a file is either absent or complete.

mod atomic;
mod error;
pub mod figures;
mod series;
mod tables;

pub use atomic::{create_folder, write_atomically};
pub use error::ReportError;
pub use series::write_pvd;
pub use tables::{IterationRow, ParameterRow, PathRow, write_csv, write_iterations, write_json};
