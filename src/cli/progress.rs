//! A run on stderr: a bar a stage where somebody watches, a line a stage where nobody does, or JSON for other programs.

use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use serde_json::json;

use super::arguments::TalkArguments;
use super::say;
use crate::study::Progress;

/// At `--verbose` a stage says how far it is this often where nobody watches.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// JSON lines of one stage are this far apart.
const JSON_EVERY: Duration = Duration::from_millis(250);

/// Who listens on stderr.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Listener {
    /// Nobody but for warnings.
    None,
    /// A person at a terminal.
    Person,
    /// A file that a person reads later; `is_told_how_far` at `--verbose`.
    File { is_told_how_far: bool },
    /// A program.
    Program,
}

/// Shows the stages of a run on stderr.
pub(super) struct TerminalProgress {
    listener: Listener,
    is_verbose: bool,
    stage: Mutex<Option<Stage>>,
}

struct Stage {
    name: String,
    total: Option<u64>,
    started: Instant,
    last_told: Instant,
    bar: ProgressBar,
}

impl Stage {
    /// Time left at the pace so far, s.
    fn left_s(&self, done: u64) -> Option<f64> {
        let total = self.total.filter(|_| done > 0)?;
        Some(self.started.elapsed().as_secs_f64() * total.saturating_sub(done) as f64 / done as f64)
    }

    /// One line of `--json-progress`.
    fn json(&self, event: &str, done: u64) -> String {
        let Self { name, total, started, .. } = self;
        let elapsed_s = started.elapsed().as_secs_f64();
        json!({ "event": event, "stage": name, "done": done, "total": total, "elapsed_s": elapsed_s, "eta_s": self.left_s(done) })
            .to_string()
    }
}

impl TerminalProgress {
    /// Speaks as it was asked to.
    pub(super) fn new(talk: TalkArguments) -> Self {
        let listener = match talk {
            TalkArguments { json_progress: true, .. } => Listener::Program,
            TalkArguments { quiet: true, .. } => Listener::None,
            _ if std::io::stderr().is_terminal() => Listener::Person,
            TalkArguments { verbose, .. } => Listener::File { is_told_how_far: verbose },
        };
        Self { listener, is_verbose: talk.verbose, stage: Mutex::new(None) }
    }

    /// Says what will be done where `--verbose` asks for it.
    pub(super) fn preface(&self, lines: &str) {
        if self.is_verbose {
            say(lines.trim_end());
        }
    }

    /// Says something that belongs into no result.
    pub(super) fn note(&self, text: &str) {
        self.aside("note", text, text);
    }

    fn aside(&self, event: &str, text: &str, line: &str) {
        if self.listener == Listener::Program {
            say(&json!({ "event": event, "text": text }).to_string());
            return;
        }
        match self.stage.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
            Some(stage) => stage.bar.suspend(|| say(line)),
            None => say(line),
        }
    }

    /// Ends the stage that runs, with the time it took.
    fn end_stage(&self, stage: &mut Option<Stage>) {
        let Some(Stage { name, started, bar, .. }) = stage.take() else { return };
        bar.finish_and_clear();
        let took_s = started.elapsed().as_secs_f64();
        match self.listener {
            Listener::Person | Listener::File { .. } => say(&format!("{took_s:>7.1} s  {name}")),
            Listener::Program => say(&json!({ "event": "done", "stage": name, "elapsed_s": took_s }).to_string()),
            Listener::None => {}
        }
    }

    fn new_bar(&self, name: &str, total: Option<u64>) -> ProgressBar {
        if self.listener != Listener::Person {
            return ProgressBar::hidden();
        }
        let template = match total {
            Some(_) => "{spinner} {msg} [{wide_bar}] {pos}/{len}, {elapsed} so far, {left} left",
            None => "{spinner} {msg}, {elapsed} so far",
        };
        // Before the first step nothing is known of the others.
        let left = |state: &ProgressState, out: &mut dyn Write| {
            let left_s = state.eta().as_secs();
            let _ = match state.pos() {
                0 => write!(out, "?"),
                _ if left_s < 100 => write!(out, "{left_s} s"),
                _ => write!(out, "{} min", (left_s + 30) / 60),
            };
        };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()).with_key("left", left);
        let bar = total.map_or_else(ProgressBar::new_spinner, ProgressBar::new).with_style(style).with_message(name.to_owned());
        bar.enable_steady_tick(Duration::from_millis(120));
        bar
    }
}

impl Progress for TerminalProgress {
    fn stage(&self, name: &str, total: Option<u64>) {
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        self.end_stage(&mut stage);
        let now = Instant::now();
        let begun = Stage { name: name.to_owned(), total, started: now, last_told: now, bar: self.new_bar(name, total) };
        match self.listener {
            Listener::File { .. } => say(&format!("            {name} …")),
            Listener::Program => say(&begun.json("stage", 0)),
            Listener::None | Listener::Person => {}
        }
        *stage = Some(begun);
    }

    fn step(&self, done: u64) {
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(stage) = stage.as_mut() else { return };
        stage.bar.set_position(done);
        let silence = stage.last_told.elapsed();
        match self.listener {
            Listener::Program if silence >= JSON_EVERY || stage.total == Some(done) => say(&stage.json("progress", done)),
            Listener::File { is_told_how_far: true } if silence >= LINE_EVERY => {
                let total = stage.total.map_or(String::new(), |total| format!(" of {total}"));
                let left = stage.left_s(done).map_or(String::new(), |left_s| format!(", about {left_s:.0} s left"));
                say(&format!("            {}: {done}{total}{left}", stage.name));
            }
            _ => return,
        }
        stage.last_told = Instant::now();
    }

    fn finish(&self) {
        self.end_stage(&mut self.stage.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn warning(&self, text: &str) {
        self.aside("warning", text, &format!("warning: {text}"));
    }
}
