//! `cardiotwin run`: a study from its file to its results, which Ctrl-C ends early.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;

use super::arguments::RunArguments;
use super::exit::Exit;
use super::progress::TerminalProgress;
use super::{plan_of, print, say};
use crate::study::{Outcome, RunContext, run};

/// Runs a study and prints what it found.
pub(super) fn run_study(arguments: RunArguments) -> anyhow::Result<Exit> {
    let plan = plan_of(arguments.study)?;
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global().context("cannot start the threads")?;
    }
    let stop = stop_on_interrupt()?;
    let progress = TerminalProgress::new(arguments.quiet);
    let outcome = run(&plan, &RunContext::new(&progress, &stop))?;
    if !arguments.quiet {
        print(&result_lines(&outcome))?;
    }
    Ok(outcome.status.into())
}

fn result_lines(outcome: &Outcome) -> String {
    let headlines: String = outcome.headlines.iter().map(|line| format!("{line}\n")).collect();
    format!("{headlines}{}; results are in {}\n", outcome.status.word(), outcome.directory.display())
}

/// A flag that Ctrl-C sets; a second Ctrl-C ends the program at once.
fn stop_on_interrupt() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let pressed = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if pressed.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        say("stopping at the next step; what was found is written (Ctrl-C again ends at once)");
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(stop)
}
