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
mod personal_leave;
mod personal_summary;
mod personal_tables;
mod personalise;
mod phantom;
mod pictures;
mod prediction;
mod recorded_base;
mod recovery;
mod replica;
mod rest_frame;
mod scene;
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

use page::{Account, leave_page};
use serde::Serialize;

use super::plan::Kind;
use super::reader::Choice;
use super::{Outcome, Plan, Provenance, RunContext, Status};
use crate::report::html::Section;
use crate::report::{create_folder, write_json};

/// Runs a plan and leaves its files in the plan's folder.
///
/// # Errors
/// [`RunError`] names the room that failed, with its reason and remedy.
pub fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    create_folder(&plan.output.directory)?;
    let outcome = run_kind(plan, context);
    if matches!(outcome, Err(RunError::Stopped)) {
        leave_stopped(plan, format!("{}; the same command begins again", RunError::Stopped), Vec::new())?;
    }
    outcome
}

fn run_kind(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
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

/// `summary.json` of a run that was stopped before it had a result; that of an earlier run would pass for its own.
#[derive(Serialize)]
struct StoppedSummary<'a> {
    kind: Kind,
    status: Status,
    warnings: [String; 1],
    provenance: &'a Provenance,
}

/// Leaves `summary.json` and the report of a run that was stopped: why, and what it has by then.
fn leave_stopped(plan: &Plan, reason: String, so_far: Vec<Section>) -> Result<(), RunError> {
    let status = Status::Stopped;
    let summary = StoppedSummary { kind: plan.kind, status, warnings: [reason], provenance: &plan.provenance };
    write_json(&plan.output.directory.join("summary.json"), &summary)?;
    let account = Account { status, headlines: &[], warnings: &summary.warnings, key_figures: Vec::new(), record: &summary };
    leave_page(plan, account, so_far, Vec::new())
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
