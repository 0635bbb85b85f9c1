//! A study: its file read and checked, ready to run.

use std::path::PathBuf;

use cardiotwin::study::{Choice, Config, Overrides, Plan, bibliography};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::python_error;
use crate::results::Results;
use crate::runner::run_on_a_thread;

/// A study file, read and checked.
///
/// Study(path, data=None, output=None, settings=None): `data` and `output` replace the folders of the data and of the results; `settings` sets
/// keys of the file, such as {"mechanics.step_s": 0.01}. Raises CardiotwinError with everything that is wrong.
#[pyclass(frozen, module = "cardiotwin")]
pub(crate) struct Study {
    plan: Plan,
}

#[pymethods]
impl Study {
    #[new]
    #[pyo3(signature = (path, data=None, output=None, settings=None))]
    fn new(path: PathBuf, data: Option<PathBuf>, output: Option<PathBuf>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let settings = settings.map(settings_of).transpose()?.unwrap_or_default();
        let config = Config::read(&path, Overrides { data, output, settings }).map_err(|error| python_error(&error))?;
        Ok(Self { plan: Plan::new(&config).map_err(|error| python_error(&error))? })
    }

    /// What the study does: "simulate", "track", "personalise", …
    #[getter]
    fn kind(&self) -> &'static str {
        self.plan.kind.word()
    }

    /// The folder of the results.
    #[getter]
    fn output(&self) -> PathBuf {
        self.plan.output.directory.clone()
    }

    /// The references of what the study uses, as BibTeX.
    fn cite(&self) -> String {
        bibliography(&self.plan)
    }

    /// Runs the study and leaves its files in `output`.
    ///
    /// `progress(stage, done, total)` is called as the run goes on; `total` is None where the number of steps is not known. Ctrl-C ends the run
    /// at its next step, with what was found by then written, and raises KeyboardInterrupt. Other threads of Python go on meanwhile.
    #[pyo3(signature = (progress=None))]
    fn run(&self, py: Python<'_>, progress: Option<Py<PyAny>>) -> PyResult<Results> {
        run_on_a_thread(py, &self.plan, progress.as_ref())?;
        Results::new(self.plan.output.directory.clone())
    }

    fn __repr__(&self) -> String {
        format!("<cardiotwin.Study {:?}, {}>", self.plan.provenance.study_file, self.plan.kind.word())
    }
}

/// `table.key=value` of a dictionary; what JSON writes of numbers, texts and lists is TOML.
fn settings_of(settings: &Bound<'_, PyDict>) -> PyResult<Vec<String>> {
    let json = settings.py().import("json")?;
    let setting = |(key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
        let value: String = json.call_method1("dumps", (value,))?.extract()?;
        Ok(format!("{}={value}", key.extract::<String>()?))
    };
    settings.iter().map(setting).collect()
}
