//! A run on the terminal: a bar a stage where somebody watches, a line a stage where nobody does.

use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::say;
use crate::study::Progress;

/// Shows the stages of a run on stderr.
pub(super) struct TerminalProgress {
    watched: bool,
    quiet: bool,
    stage: Mutex<Option<Stage>>,
}

struct Stage {
    name: String,
    started: Instant,
    bar: ProgressBar,
}

impl TerminalProgress {
    /// Says nothing but warnings if `quiet`.
    pub(super) fn new(quiet: bool) -> Self {
        Self { watched: !quiet && std::io::stderr().is_terminal(), quiet, stage: Mutex::new(None) }
    }

    /// Ends the stage that runs, with the time it took.
    fn end_stage(&self, stage: &mut Option<Stage>) {
        if let Some(Stage { name, started, bar }) = stage.take() {
            bar.finish_and_clear();
            if !self.quiet {
                say(&format!("{:>7.1} s  {name}", started.elapsed().as_secs_f64()));
            }
        }
    }

    fn new_bar(&self, name: &str, total: Option<u64>) -> ProgressBar {
        if !self.watched {
            return ProgressBar::hidden();
        }
        let template = match total {
            Some(_) => "{spinner} {msg} [{wide_bar}] {pos}/{len}, {eta} left",
            None => "{spinner} {msg} {elapsed}",
        };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = total.map_or_else(ProgressBar::new_spinner, ProgressBar::new).with_style(style).with_message(name.to_owned());
        bar.enable_steady_tick(Duration::from_millis(120));
        bar
    }
}

impl Progress for TerminalProgress {
    fn stage(&self, name: &str, total: Option<u64>) {
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        self.end_stage(&mut stage);
        if !self.watched && !self.quiet {
            say(&format!("            {name} …"));
        }
        *stage = Some(Stage { name: name.to_owned(), started: Instant::now(), bar: self.new_bar(name, total) });
    }

    fn step(&self, done: u64) {
        if let Some(stage) = self.stage.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
            stage.bar.set_position(done);
        }
    }

    fn finish(&self) {
        self.end_stage(&mut self.stage.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn warning(&self, text: &str) {
        let warn = || say(&format!("warning: {text}"));
        match self.stage.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
            Some(stage) => stage.bar.suspend(warn),
            None => warn(),
        }
    }
}
