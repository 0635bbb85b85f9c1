//! What a run left, read back: tables as columns, the beating mesh as arrays.

use std::path::{Path, PathBuf};

use cardiotwin::mesh::io::{FieldArray, MeshFile, read_mesh_file};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::tables::read_columns;
use crate::{CardiotwinError, python_error};

/// The folder of a finished run.
///
/// Results(path) opens what an earlier run left.
#[pyclass(frozen, module = "cardiotwin")]
pub(crate) struct Results {
    folder: PathBuf,
}

#[pymethods]
impl Results {
    #[new]
    pub(crate) fn new(path: PathBuf) -> PyResult<Self> {
        if !path.join("summary.json").is_file() {
            let text = format!("{} has no summary.json: it is no folder of results, or the run did not end", path.display());
            return Err(CardiotwinError::new_err(text));
        }
        Ok(Self { folder: path })
    }

    /// The folder.
    #[getter]
    fn directory(&self) -> PathBuf {
        self.folder.clone()
    }

    /// `summary.json` as a dict: status, ejection fractions, volumes, pressures, warnings, provenance.
    #[getter]
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let text = std::fs::read_to_string(self.folder.join("summary.json"))?;
        Ok(py.import("json")?.call_method1("loads", (text,))?.cast_into::<PyDict>()?)
    }

    /// How the run ended: "converged", "on_bound", "iteration_limit", "stopped" or "failed".
    #[getter]
    fn status(&self, py: Python<'_>) -> PyResult<String> {
        self.summary(py)?.as_any().get_item("status")?.extract()
    }

    /// Names of the tables (CSV files), without their ending.
    #[getter]
    fn tables(&self) -> PyResult<Vec<String>> {
        let mut names = Vec::new();
        for entry in std::fs::read_dir(&self.folder)? {
            let path = entry?.path();
            if path.extension().is_some_and(|ending| ending == "csv") {
                names.extend(path.file_stem().map(|name| name.to_string_lossy().into_owned()));
            }
        }
        names.sort();
        Ok(names)
    }

    /// A table as a dict of numpy arrays by column, ready for pandas.DataFrame.
    fn table<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyDict>> {
        let path = self.folder.join(format!("{name}.csv"));
        if !path.is_file() {
            return Err(CardiotwinError::new_err(format!("there is no table {name:?}; there are {}", self.tables()?.join(", "))));
        }
        read_columns(py, &path)
    }

    /// `curves.csv`: volumes, pressures and phases at every step.
    #[getter]
    fn curves<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.table(py, "curves")
    }

    /// `frames.csv`: the same at the images' times.
    #[getter]
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.table(py, "frames")
    }

    /// `parameters.csv`: parameters found with bounds and intervals, and those that were held.
    #[getter]
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.table(py, "parameters")
    }

    /// Times of the beating mesh, s; empty where the run wrote no meshes.
    #[pyo3(signature = (series="heart"))]
    fn mesh_times_s<'py>(&self, py: Python<'py>, series: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(PyArray1::from_vec(py, self.series(series)?.into_iter().map(|(time_s, _)| time_s).collect()))
    }

    /// The mesh at one of these times, by its place in them; a negative one counts from the end.
    #[pyo3(signature = (frame, series="heart"))]
    fn mesh(&self, py: Python<'_>, frame: isize, series: &str) -> PyResult<Mesh> {
        let listed = self.series(series)?;
        let place = if frame < 0 { listed.len().checked_add_signed(frame) } else { usize::try_from(frame).ok() };
        let Some((time_s, file)) = place.and_then(|place| listed.get(place)) else {
            return Err(PyIndexError::new_err(format!("frame {frame} of {} meshes in series {series:?}", listed.len())));
        };
        let file = read_mesh_file(file).map_err(|error| python_error(&error))?;
        Mesh::new(py, *time_s, &file)
    }

    fn __repr__(&self) -> String {
        format!("<cardiotwin.Results {:?}>", self.folder.display().to_string())
    }
}

impl Results {
    /// Times and files of a series of meshes, as its `.pvd` lists them.
    fn series(&self, name: &str) -> PyResult<Vec<(f64, PathBuf)>> {
        let file = self.folder.join(format!("{name}.pvd"));
        if !file.is_file() {
            return Ok(Vec::new());
        }
        let text = std::fs::read_to_string(&file)?;
        let attribute = |line: &str, name: &str| {
            let rest = line.split_once(&format!(" {name}=\""))?.1;
            rest.split_once('"').map(|(value, _)| value.to_owned())
        };
        let entry = |line: &str| {
            let (time_s, file) = (attribute(line, "timestep")?.parse().ok()?, attribute(line, "file")?);
            Some((time_s, self.folder.join(Path::new(&file))))
        };
        Ok(text.lines().filter_map(entry).collect())
    }
}

/// A heart at one time. Lengths are mm in world coordinates (RAS).
#[pyclass(frozen, get_all, module = "cardiotwin")]
pub(crate) struct Mesh {
    /// Time, s.
    time_s: f64,
    /// Positions, float64 of shape (vertices, 3).
    points: Py<PyArray2<f64>>,
    /// Corners, int64 of shape (tetrahedra, 4), counted from 0.
    tetrahedra: Py<PyArray2<i64>>,
    /// Fields of the points by name: float64 of shape (vertices,) or (vertices, components).
    point_fields: Py<PyDict>,
    /// Fields of the tetrahedra by name.
    tetrahedron_fields: Py<PyDict>,
}

#[pymethods]
impl Mesh {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let count = |array: &Bound<'_, PyAny>| array.len();
        let (points, tetrahedra) = (count(self.points.bind(py).as_any())?, count(self.tetrahedra.bind(py).as_any())?);
        Ok(format!("<cardiotwin.Mesh at {} s: {points} points, {tetrahedra} tetrahedra>", self.time_s))
    }
}

impl Mesh {
    fn new(py: Python<'_>, time_s: f64, file: &MeshFile) -> PyResult<Self> {
        let point = |n: usize, axis: usize| file.points[n][axis];
        let points = Array2::from_shape_fn((file.points.len(), 3), |(n, axis)| point(n, axis));
        let tetrahedra = Array2::from_shape_fn((file.tetrahedra.len(), 4), |(n, corner)| file.tetrahedra[n][corner] as i64);
        Ok(Self {
            time_s,
            points: points.into_pyarray(py).unbind(),
            tetrahedra: tetrahedra.into_pyarray(py).unbind(),
            point_fields: fields(py, &file.point_fields)?,
            tetrahedron_fields: fields(py, &file.tetrahedron_fields)?,
        })
    }
}

fn fields(py: Python<'_>, fields: &std::collections::BTreeMap<String, FieldArray>) -> PyResult<Py<PyDict>> {
    let by_name = PyDict::new(py);
    for (name, field) in fields {
        let values = PyArray1::from_slice(py, &field.values);
        if field.components == 1 {
            by_name.set_item(name, values)?;
        } else {
            by_name.set_item(name, values.call_method1("reshape", (-1, field.components))?)?;
        }
    }
    Ok(by_name.unbind())
}
