//! Runs: what each kind of study does with its plan, from the files it reads to the files it leaves.

mod calibration;
mod clock;
mod compare_bases;
mod compare_schemes;
mod discrepancy;
mod each_beat;
mod error;
mod forward;
mod imaged_beat;
mod leave;
mod measured;
mod mesh_file;
mod mesh_only;
mod mesh_overlays;
mod montages;
mod parameter_rows;
mod patient;
mod personalise;
mod phantom;
mod pictures;
mod recorded_base;
mod recovery;
mod simulate;
mod slice_panels;
mod start;
mod synthetic;
mod track;
mod track_only;
mod wall;

pub use error::RunError;
pub use mesh_only::{MeshReport, PartVolume, SurfaceAgreement, mesh_heart};

use super::plan::Kind;
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
    }
}
