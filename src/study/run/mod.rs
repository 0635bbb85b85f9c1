//! Runs: what each kind of study does with its plan, from the files it reads to the files it leaves.

mod calibration;
mod clock;
mod compare_bases;
mod compare_schemes;
mod compare_solvers;
mod data_table;
mod discrepancy;
mod each_beat;
mod error;
mod forward;
mod gains;
mod heart_tangents;
mod imaged_beat;
mod journal;
mod leave;
mod measured;
mod mesh_file;
mod mesh_only;
mod mesh_overlays;
mod montages;
mod page;
mod parameter_rows;
mod patient;
mod personal_tables;
mod personalise;
mod phantom;
mod pictures;
mod prediction;
mod recorded_base;
mod recovery;
mod search;
mod sensitivity;
mod side_by_side;
mod simulate;
mod slice_panels;
mod start;
mod synthetic;
mod track;
mod track_only;
mod wall;

pub use error::RunError;
pub use mesh_only::{MeshReport, PartVolume, SurfaceAgreement, mesh_heart};
pub(super) use side_by_side::side_by_side;

use super::plan::Kind;
use super::reader::Choice;
use super::{Outcome, Plan, RunContext};
use crate::report::create_folder;

/// Runs a plan and leaves its files in the plan's folder.
///
/// # Errors
/// [`RunError`] names the room that failed, with its reason and remedy.
pub fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    create_folder(&plan.output.directory)?;
    match plan.kind {
        Kind::Mesh => mesh_only::run(plan, context),
        Kind::Simulate => simulate::run(plan, context),
        Kind::Phantom => phantom::run(plan, context),
        Kind::Track => track_only::run(plan, context),
        Kind::CompareBases => compare_bases::run(plan, context),
        Kind::CompareSchemes => compare_schemes::run(plan, context),
        Kind::Personalise => personalise::run(plan, context),
        Kind::Sensitivity => sensitivity::run(plan, context),
        Kind::CompareSolvers => compare_solvers::run(plan, context),
    }
}

/// Gathers what the parts of a study left, and reads the whole.
///
/// # Errors
/// [`RunError::NothingToMerge`] for a study that is not run in parts; otherwise as [`run`].
pub fn merge(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let wanted = plan.sensitivity.as_ref().ok_or(RunError::NothingToMerge { kind: plan.kind.word() })?;
    create_folder(&plan.output.directory)?;
    sensitivity::merge(plan, wanted, context)
}
