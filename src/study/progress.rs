//! What a run tells while it runs, and how it is asked to stop; whoever shows it is not known here.

use std::sync::atomic::{AtomicBool, Ordering};

/// Listens to a run. Stages follow one another; a stage that begins ends the one before.
pub trait Progress: Sync {
    /// A stage begins; `total` steps will follow, or an unknown number where it is none.
    fn stage(&self, name: &str, total: Option<u64>);
    /// `done` steps of the stage are behind us.
    fn step(&self, done: u64);
    /// The last stage is over.
    fn finish(&self);
    /// Something the reader of the results should know; also kept in `summary.json`.
    fn warning(&self, text: &str);
}

/// Listens to nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn stage(&self, _: &str, _: Option<u64>) {}
    fn step(&self, _: u64) {}
    fn finish(&self) {}
    fn warning(&self, _: &str) {}
}

/// Who listens to a run, and whether it should stop.
#[derive(Clone, Copy)]
pub struct RunContext<'a> {
    progress: &'a dyn Progress,
    stop: &'a AtomicBool,
}

impl<'a> RunContext<'a> {
    /// A run that tells `progress` what it does and ends at the next step once `stop` is set.
    pub fn new(progress: &'a dyn Progress, stop: &'a AtomicBool) -> Self {
        Self { progress, stop }
    }

    /// Whoever listens.
    pub fn progress(&self) -> &'a dyn Progress {
        self.progress
    }

    /// The switch that stops it.
    pub fn stop(&self) -> &'a AtomicBool {
        self.stop
    }

    /// Whether the run should write what it has and end with [`super::Status::Stopped`].
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}
