//! `kind = "sensitivity"`: the heart at every point of a design, a row each, and the indices that the rows give.
//!
//! `runs.csv` is its own checkpoint: a row is written when its run ends, and rows that are there, sealed by this study, are not run again.

mod evaluate;
mod figures;
mod indices;
mod records;
mod recovered;

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use evaluate::Evaluator;
use indices::{leave_indices, so_far};
use records::Records;

use super::error::RunError;
use super::leave_stopped;
use super::side_by_side::side_by_side;
use crate::report::{Ledger, LedgerRow};
use crate::study::identity::identity;
use crate::study::plan::SensitivityPlan;
use crate::study::shard::Shard;
use crate::study::{Outcome, Plan, RunContext, Status};

/// Runs what is missing of a plan's design, or of its shard, and reads the indices off the whole.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let wanted = plan.sensitivity.as_ref().ok_or(RunError::NothingToFit)?;
    let (folder, owner) = (&plan.output.directory, identity(plan, wanted.document_hash)?);
    let of_shard = |table| folder.join(Shard::file_name(wanted.shard, table));
    let mut known = Records::read(&of_shard("runs"), &of_shard("times"), wanted, owner)?;
    for text in known.warnings() {
        context.progress().warning(&text);
    }
    let own: Vec<usize> = (0..wanted.design.points().len()).filter(|&run| wanted.shard.is_none_or(|shard| shard.holds(run))).collect();
    let pending: Vec<usize> = own.iter().copied().filter(|&run| !known.has(run)).collect();
    if !pending.is_empty() {
        let evaluator = Evaluator::new(plan, wanted, context)?;
        known.keep()?;
        evaluate_all(&evaluator, &known, &pending, own.len(), owner, context)?;
        known = Records::read(&of_shard("runs"), &of_shard("times"), wanted, owner)?;
    }
    context.progress().stage("writing results", None);
    known.keep()?;
    let missing = own.iter().filter(|&&run| !known.has(run)).count();
    let outcome = if context.is_stopped() && missing > 0 {
        let line = format!("{} of {} runs are done; run it again to go on", own.len() - missing, own.len());
        leave_stopped(plan, format!("stopped: {line}"), vec![so_far(wanted, &known)])?;
        Ok(Outcome { status: Status::Stopped, directory: folder.clone(), headlines: vec![line] })
    } else if let Some(shard) = wanted.shard {
        let line = format!("all {} runs of part {shard} are done; merge the parts with `cardiotwin merge`", own.len());
        Ok(Outcome { status: Status::Converged, directory: folder.clone(), headlines: vec![line] })
    } else {
        leave_indices(plan, wanted, &known, started)
    };
    context.progress().finish();
    outcome
}

/// Gathers the rows of all shards into `runs.csv` and reads the indices off them. To do it again changes nothing.
pub(super) fn merge(plan: &Plan, wanted: &SensitivityPlan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let (folder, owner) = (&plan.output.directory, identity(plan, wanted.document_hash)?);
    let mut all = Records::read(&folder.join("runs.csv"), &folder.join("times.csv"), wanted, owner)?;
    for name in Shard::files(folder, "runs") {
        let times = folder.join(name.replacen("runs", "times", 1));
        all.take_in(Records::read(&folder.join(&name), &times, wanted, owner)?);
    }
    for text in all.warnings() {
        context.progress().warning(&text);
    }
    all.keep()?;
    let run_count = wanted.design.points().len();
    let missing = (0..run_count).filter(|&run| !all.has(run)).count();
    if missing > 0 {
        let line = format!("{missing} of {run_count} runs are missing; run the other parts, or run the study to fill them in");
        return Ok(Outcome { status: Status::Failed, directory: folder.clone(), headlines: vec![line] });
    }
    leave_indices(plan, wanted, &all, started)
}

fn evaluate_all(
    evaluator: &Evaluator,
    known: &Records,
    pending: &[usize],
    own_count: usize,
    owner: u64,
    context: &RunContext,
) -> Result<(), RunError> {
    let (runs, times) = known.open()?;
    context.progress().stage("running the heart", Some(own_count as u64));
    let done = AtomicU64::new((own_count - pending.len()) as u64);
    context.progress().step(done.load(Ordering::Relaxed));
    let one = |&run: &usize| {
        let started = Instant::now();
        // A run that Ctrl-C ends leaves no row: it is begun anew.
        let Some(fields) = evaluator.fields(run, context.stop()) else { return Ok(()) };
        let wall_time_s = started.elapsed().as_secs_f64();
        append(&times, owner, vec![run.to_string(), format!("{wall_time_s:.3}")])?;
        append(&runs, owner, fields)?;
        context.progress().step(done.fetch_add(1, Ordering::Relaxed) + 1);
        Ok(())
    };
    side_by_side(pending, || context.is_stopped(), one)
}

fn append(ledger: &Ledger, owner: u64, fields: Vec<String>) -> Result<(), RunError> {
    Ok(ledger.append(&LedgerRow { owner, fields })?)
}
