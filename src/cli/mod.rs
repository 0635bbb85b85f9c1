//! The command line: arguments, progress, messages, exit codes.

mod arguments;
mod exit;
mod messages;
mod progress;

use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::Parser;

use self::arguments::{Arguments, Command, RunArguments, StudyArguments};
use self::exit::Exit;
use self::progress::TerminalProgress;
use crate::study::{Config, Plan, RunContext, RunError, Status, StudyError, run};

/// Runs the program with the arguments of the process.
pub fn main() -> ExitCode {
    std::panic::set_hook(Box::new(|panic| {
        say(&format!("error: the program met a state that it holds to be impossible: {panic}\n  please report it with the study file"));
    }));
    let result = match Arguments::parse().command {
        Command::Run(arguments) => run_study(arguments),
        Command::Check(arguments) => check_study(arguments),
        Command::Parameters => print(&messages::parameter_table()).map(|()| Exit::Done),
    };
    let exit = result.unwrap_or_else(|error| {
        say(&messages::error_chain(error.as_ref()));
        exit_of(&error)
    });
    exit.into()
}

fn plan_of(arguments: StudyArguments) -> Result<Plan, StudyError> {
    let (file, overrides) = arguments.into_parts();
    Plan::new(&Config::read(&file, overrides)?)
}

fn exit_of(error: &anyhow::Error) -> Exit {
    match error.downcast_ref::<RunError>() {
        Some(RunError::Stopped) => Exit::Interrupted,
        Some(RunError::Image(_) | RunError::FrameOutOfRange { .. } | RunError::NothingToFit) => Exit::BadInput,
        Some(_) => Exit::Failed,
        None if error.is::<StudyError>() => Exit::BadInput,
        None => Exit::Failed,
    }
}

fn run_study(arguments: RunArguments) -> anyhow::Result<Exit> {
    let plan = plan_of(arguments.study)?;
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global().context("cannot start the threads")?;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let pressed = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if pressed.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        say("stopping at the next step; press Ctrl-C again to stop at once");
    })
    .context("cannot listen to Ctrl-C")?;
    let progress = TerminalProgress::new(arguments.quiet);
    let outcome = run(&plan, &RunContext::new(&progress, &stop))?;
    let mut text: String = outcome.headlines.iter().map(|line| format!("{line}\n")).collect();
    text.push_str(&format!("results are in {}\n", outcome.directory.display()));
    print(&text)?;
    Ok(match outcome.status {
        Status::Stopped => Exit::Interrupted,
        Status::Failed => Exit::Failed,
        Status::Converged | Status::OnBound | Status::IterationLimit => Exit::Done,
    })
}

fn check_study(arguments: StudyArguments) -> anyhow::Result<Exit> {
    print(&messages::plan_lines(&plan_of(arguments)?))?;
    Ok(Exit::Done)
}

/// Prints to stdout; a reader that has gone away, as `head` does, is no error.
fn print(text: &str) -> anyhow::Result<()> {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to stdout"),
    }
}

/// A line on stderr; when nobody can read it, nothing is lost.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
