//! A run on a thread of its own, so that Python hears how far it is, and Ctrl-C is heard.

use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use cardiotwin::study::{Outcome, Plan, Progress, RunContext, run};
use pyo3::exceptions::{PyRuntimeError, PyUserWarning};
use pyo3::prelude::*;

use crate::python_error;

/// Signals are looked for this often.
const PATIENCE: Duration = Duration::from_millis(50);

/// What a run tells.
enum Told {
    Step { stage: String, done: u64, total: Option<u64> },
    Warning(String),
}

/// Sends what a run tells to the thread of Python.
struct Messenger {
    sender: Mutex<Sender<Told>>,
    stage: Mutex<(String, Option<u64>)>,
}

impl Messenger {
    fn send(&self, told: Told) {
        // Nobody listens any more where Python raised an error: the run is about to stop.
        let _ = self.sender.lock().unwrap_or_else(PoisonError::into_inner).send(told);
    }
}

impl Progress for Messenger {
    fn stage(&self, name: &str, total: Option<u64>) {
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner) = (name.to_owned(), total);
        self.send(Told::Step { stage: name.to_owned(), done: 0, total });
    }

    fn step(&self, done: u64) {
        let (stage, total) = self.stage.lock().unwrap_or_else(PoisonError::into_inner).clone();
        self.send(Told::Step { stage, done, total });
    }

    fn finish(&self) {}

    fn warning(&self, text: &str) {
        self.send(Told::Warning(text.to_owned()));
    }
}

/// Runs a plan while Python stays awake. An exception of `progress`, and Ctrl-C, stop the run and are raised when it has written what it has.
pub(crate) fn run_on_a_thread(py: Python<'_>, plan: &Plan, progress: Option<&Py<PyAny>>) -> PyResult<Outcome> {
    let stop = AtomicBool::new(false);
    let (ended, raised) = py.detach(|| {
        let (sender, receiver) = channel();
        let (messenger, stop) = (Messenger { sender: Mutex::new(sender), stage: Mutex::default() }, &stop);
        std::thread::scope(|scope| {
            // The messenger moves there: the channel closes when the run ends.
            let worker = scope.spawn(move || run(plan, &RunContext::new(&messenger, stop)));
            let raised = listen(&receiver, progress, stop);
            (worker.join(), raised)
        })
    });
    match (raised, ended) {
        (Some(error), _) => Err(error),
        (None, Ok(Ok(outcome))) => Ok(outcome),
        (None, Ok(Err(error))) => Err(python_error(&error)),
        (None, Err(_)) => {
            Err(PyRuntimeError::new_err("the run met a state that it holds to be impossible; please report it with the study file"))
        }
    }
}

/// Passes on what the run tells until it ends; the first exception stops it.
fn listen(receiver: &Receiver<Told>, progress: Option<&Py<PyAny>>, stop: &AtomicBool) -> Option<PyErr> {
    let mut raised = None;
    loop {
        let told = match receiver.recv_timeout(PATIENCE) {
            Ok(told) => Some(told),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return raised,
        };
        if raised.is_some() {
            continue;
        }
        // Python may be slower than the run: of steps that wait, the last one counts.
        let mut waiting: Vec<Told> = told.into_iter().chain(receiver.try_iter()).collect();
        let is_overtaken = |pair: &[Told]| matches!(pair, [Told::Step { stage: a, .. }, Told::Step { stage: b, .. }] if a == b);
        let overtaken: Vec<bool> = waiting.windows(2).map(is_overtaken).chain([false]).collect();
        let mut overtaken = overtaken.into_iter();
        waiting.retain(|_| !overtaken.next().unwrap_or(false));
        let heard = Python::attach(|py| {
            py.check_signals()?;
            waiting.iter().try_for_each(|told| pass_on(py, told, progress))
        });
        if let Err(error) = heard {
            stop.store(true, Ordering::Relaxed);
            raised = Some(error);
        }
    }
}

fn pass_on(py: Python<'_>, told: &Told, progress: Option<&Py<PyAny>>) -> PyResult<()> {
    match told {
        Told::Step { stage, done, total } => match progress {
            Some(progress) => progress.call1(py, (stage, done, total)).map(drop),
            None => Ok(()),
        },
        Told::Warning(text) => {
            let text = CString::new(text.replace('\0', " "))?;
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
        }
    }
}
