//! CSV files as columns: numbers where every cell is one or empty, texts otherwise.

use std::path::Path;

use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::CardiotwinError;

/// The columns of a CSV file by name, in its order: float arrays (empty cells are NaN), or arrays of str.
pub(crate) fn read_columns<'py>(py: Python<'py>, path: &Path) -> PyResult<Bound<'py, PyDict>> {
    let bad = |error: csv::Error| CardiotwinError::new_err(format!("cannot read {}: {error}", path.display()));
    let mut reader = csv::Reader::from_path(path).map_err(bad)?;
    let names = reader.headers().map_err(bad)?.clone();
    let mut columns: Vec<Vec<String>> = vec![Vec::new(); names.len()];
    for record in reader.records() {
        for (column, cell) in columns.iter_mut().zip(&record.map_err(bad)?) {
            column.push(cell.to_owned());
        }
    }
    let table = PyDict::new(py);
    for (name, column) in names.iter().zip(columns) {
        let number = |cell: &String| if cell.is_empty() { Ok(f64::NAN) } else { cell.parse::<f64>() };
        match column.iter().map(number).collect::<Result<Vec<f64>, _>>() {
            Ok(numbers) => table.set_item(name, PyArray1::from_vec(py, numbers))?,
            Err(_) => table.set_item(name, py.import("numpy")?.call_method1("array", (column,))?)?,
        }
    }
    Ok(table)
}
