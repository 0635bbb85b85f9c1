//! A study file as written, the plan it means, and what is known of a run while it runs and when it ends.

mod cine;
mod citations;
mod cohort;
mod config;
mod drawn_heart;
mod error;
mod figure;
mod follow;
mod identity;
mod init;
mod outcome;
pub mod plan;
mod progress;
mod provenance;
mod reader;
mod run;
mod shard;
mod volumes;

pub use citations::{bibliography, cited_keys};
pub use cohort::{Cohort, CohortPatient};
pub use config::{Config, Overrides};
pub use error::{Problem, StudyError};
pub use follow::{FollowError, Followed, follow};
pub use init::{Draft, DraftInputs, InitError, MaskFiles, draft_study, write_study};
pub use outcome::{Outcome, Status};
pub use plan::{Kind, Plan};
pub use progress::{Progress, RunContext, Silent};
pub use provenance::Provenance;
pub use reader::Choice;
pub use run::{MeshReport, PartVolume, RunError, SurfaceAgreement, merge, mesh_heart, run};
pub use shard::Shard;
pub use volumes::{CurveSource, measure_volumes};
