//! `cardiotwin run`: a study from its file to its results, which Ctrl-C ends early.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;

use super::arguments::{CohortArguments, RunArguments, StudyArguments, TalkArguments};
use super::exit::Exit;
use super::messages::plan_lines;
use super::progress::TerminalProgress;
use super::{plan_of, print};
use crate::report::stop_writing;
use crate::study::Choice;
use crate::study::{Cohort, Config, Outcome, Overrides, Plan, RunContext, RunError, merge, run};

/// Runs a study and prints what it found.
pub(super) fn run_study(arguments: RunArguments) -> anyhow::Result<Exit> {
    let mut plan = plan_of(arguments.study)?;
    match (&mut plan.sensitivity, arguments.shard) {
        (Some(sensitivity), shard) => sensitivity.shard = shard,
        (None, Some(_)) => return Err(RunError::NothingToMerge { kind: plan.kind.word() }.into()),
        (None, None) => {}
    }
    use_threads(arguments.threads)?;
    let progress = Arc::new(TerminalProgress::new(arguments.talk));
    let stop = stop_on_interrupt(Arc::clone(&progress))?;
    progress.preface(&plan_lines(&plan));
    let outcome = run(&plan, &RunContext::new(progress.as_ref(), &stop))?;
    if !arguments.talk.quiet {
        print(&result_lines(&outcome))?;
    }
    Ok(outcome.status.into())
}

/// Runs a cohort and prints what became of each patient.
pub(super) fn run_cohort(arguments: CohortArguments) -> anyhow::Result<Exit> {
    let CohortArguments { file, output, threads, shard, talk } = arguments;
    let cohort = Cohort::new(&Config::read(&file, Overrides { output, ..Overrides::default() })?)?;
    use_threads(threads)?;
    let progress = Arc::new(TerminalProgress::new(talk));
    let stop = stop_on_interrupt(Arc::clone(&progress))?;
    let outcome = cohort.run(shard, &RunContext::new(progress.as_ref(), &stop))?;
    if !talk.quiet {
        print(&result_lines(&outcome))?;
    }
    Ok(outcome.status.into())
}

/// Merges the parts of a study or a cohort and prints what it found.
pub(super) fn merge_parts(arguments: StudyArguments) -> anyhow::Result<Exit> {
    let (file, overrides) = arguments.into_parts();
    let config = Config::read(&file, overrides)?;
    let outcome = if Cohort::is_one(&config) {
        Cohort::new(&config)?.merge()?
    } else {
        merge(&Plan::new(&config)?, &RunContext::new(&TerminalProgress::new(TalkArguments::default()), &AtomicBool::new(false)))?
    };
    print(&result_lines(&outcome))?;
    Ok(outcome.status.into())
}

/// Starts as many threads as were asked for; all cores where none were.
fn use_threads(threads: Option<u16>) -> anyhow::Result<()> {
    let Some(threads) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global().context("cannot start the threads")
}

fn result_lines(outcome: &Outcome) -> String {
    let headlines: String = outcome.headlines.iter().map(|line| format!("{line}\n")).collect();
    format!("{headlines}{}; results are in {}\n", outcome.status.word(), outcome.directory.display())
}

/// A flag that Ctrl-C sets; a second Ctrl-C ends the program at once, without anything half-written.
fn stop_on_interrupt(progress: Arc<TerminalProgress>) -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let pressed = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if pressed.swap(true, Ordering::Relaxed) {
            let _writing = stop_writing();
            std::process::exit(130);
        }
        progress.note("stopping at the next step; what was found is written (Ctrl-C again ends at once)");
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(stop)
}
