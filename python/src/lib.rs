//! The Python door: a study file in, numpy arrays out.

#![forbid(unsafe_code)]

mod results;
mod runner;
mod study;
mod tables;

use cardiotwin::heart::{Parameter, ParameterSpec};
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::types::PyDict;

pyo3::create_exception!(
    cardiotwin,
    CardiotwinError,
    PyException,
    "A study file, a file that it names or a run is wrong; the text says what, where and what to do."
);

/// An error with its causes, a line each.
fn python_error(error: &dyn std::error::Error) -> PyErr {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let words = inner.to_string();
        if !text.ends_with(&words) {
            text.push_str("\nbecause: ");
            text.push_str(&words);
        }
        cause = inner.source();
    }
    CardiotwinError::new_err(text)
}

/// Every parameter of the model: name, unit, default, lower, upper, meaning, source.
#[pyfunction]
fn parameters(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let row = |parameter: &Parameter| {
        let ParameterSpec { name, unit, default, lower, upper, meaning, source, .. } = parameter.spec();
        let row = PyDict::new(py);
        row.set_item("name", name)?;
        row.set_item("unit", unit)?;
        row.set_item("default", default)?;
        row.set_item("lower", lower)?;
        row.set_item("upper", upper)?;
        row.set_item("meaning", meaning)?;
        row.set_item("source", source)?;
        Ok(row)
    };
    Parameter::ALL.iter().map(row).collect()
}

/// From cine MRI to a personalised, beating heart: load a study, run it, get curves, parameters and meshes as numpy arrays.
#[pymodule(name = "cardiotwin")]
fn door(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("CardiotwinError", module.py().get_type::<CardiotwinError>())?;
    module.add_class::<study::Study>()?;
    module.add_class::<results::Results>()?;
    module.add_class::<results::Mesh>()?;
    module.add_function(wrap_pyfunction!(parameters, module)?)
}
