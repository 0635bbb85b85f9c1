//! The command line: arguments, progress, messages, exit codes.

mod arguments;
mod exit;
mod info;
mod init;
mod mesh;
mod messages;
mod progress;
mod run;
mod volumes;

use std::io::Write;
use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, Parser};
use serde_json::json;

use self::arguments::{Arguments, Command, FollowArguments, StudyArguments};
use self::exit::Exit;
use crate::study::{Config, Plan, StudyError, bibliography, follow};

/// Runs the program with the arguments of the process.
pub fn main() -> ExitCode {
    std::panic::set_hook(Box::new(|panic| {
        say(&format!("error: the program met a state that it holds to be impossible: {panic}\n  please report it with the study file"));
    }));
    let command = Arguments::parse().command;
    let is_heard_by_program = command.talk().json_progress;
    let result = match command {
        Command::Run(arguments) => run::run_study(arguments),
        Command::Cohort(arguments) => run::run_cohort(arguments),
        Command::Merge(arguments) => run::merge_parts(arguments),
        Command::Init(arguments) => init::write(arguments),
        Command::Check(arguments) => check_study(arguments),
        Command::Cite(arguments) => cite_study(arguments),
        Command::Info(arguments) => info::show(&arguments),
        Command::Mesh(arguments) => mesh::make(arguments),
        Command::Volumes(arguments) => volumes::measure(arguments),
        Command::Follow(arguments) => follow_points(&arguments),
        Command::Parameters => print(&messages::parameter_table()).map(|()| Exit::Done),
        Command::Completions { shell } => completions(shell),
    };
    let exit = result.unwrap_or_else(|error| {
        let words = messages::error_chain(error.as_ref());
        say(&if is_heard_by_program { json!({ "event": "error", "text": words }).to_string() } else { words });
        Exit::from(&error)
    });
    exit.into()
}

fn plan_of(arguments: StudyArguments) -> Result<Plan, StudyError> {
    let (file, overrides) = arguments.into_parts();
    Plan::new(&Config::read(&file, overrides)?)
}

fn check_study(arguments: StudyArguments) -> anyhow::Result<Exit> {
    print(&messages::plan_lines(&plan_of(arguments)?))?;
    Ok(Exit::Done)
}

fn cite_study(arguments: StudyArguments) -> anyhow::Result<Exit> {
    print(&bibliography(&plan_of(arguments)?))?;
    Ok(Exit::Done)
}

fn completions(shell: clap_complete::Shell) -> anyhow::Result<Exit> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "cardiotwin", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(Exit::Done)
}

fn follow_points(arguments: &FollowArguments) -> anyhow::Result<Exit> {
    let followed = follow(&arguments.folder, &arguments.points, arguments.frame)?;
    for warning in &followed.warnings {
        say(&format!("warning: {warning}"));
    }
    print(&format!("{} places; they are in {}\n", followed.paths.len(), arguments.folder.join("paths.csv").display()))?;
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
