//! Tables as CSV and records as JSON. The column names of the rows here are a contract with those who read results.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{ReportError, write_atomically};

/// A row of `parameters.csv`: one parameter that was searched, or held at its value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterRow {
    /// Name with its unit.
    pub parameter: String,
    /// Symbol in the equations.
    pub symbol: &'static str,
    /// Unit.
    pub unit: String,
    /// Region it holds for; `heart` for the whole.
    pub region: String,
    /// Start value.
    pub initial: f64,
    /// Value found.
    pub value: f64,
    /// Smallest value allowed.
    pub lower: f64,
    /// Largest value allowed.
    pub upper: f64,
    /// Standard deviation of the value found; empty where the data do not tell.
    pub sd: Option<f64>,
    /// Lower end of the 95 % interval.
    pub interval_low: Option<f64>,
    /// Upper end of the 95 % interval.
    pub interval_high: Option<f64>,
    /// Whether the value found lies on a bound.
    pub at_bound: bool,
    /// `free`, on its `lower` or `upper` bound, or `fixed` because the study does not seek it.
    pub state: &'static str,
    /// Centre of the prior; empty where there is none.
    pub prior_mean: Option<f64>,
    /// Its standard deviation, in the parameter's unit.
    pub prior_sd: Option<f64>,
}

/// A row of `iterations.csv`: one iteration of the search.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IterationRow {
    /// Number, from 0 (the start value).
    pub iteration: usize,
    /// Half the sum of squared residuals, prior included.
    pub cost: f64,
    /// Length of the step taken, relative to the bounds.
    pub step: f64,
    /// Forward simulations used so far.
    pub simulations: usize,
    /// What became of the iteration.
    pub status: String,
    /// Values of the free parameters, in columns of their own names.
    pub values: Vec<f64>,
}

/// A row of `paths.csv`: where a material point is at a frame, world RAS.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PathRow {
    /// Name of the point.
    pub point: String,
    /// Frame, from 0.
    pub frame: usize,
    /// Time after the trigger.
    pub time_s: f64,
    /// Position.
    pub x_mm: f64,
    /// Position.
    pub y_mm: f64,
    /// Position.
    pub z_mm: f64,
}

/// Writes rows as CSV, with a header of the fields' names. A table without rows would have no header either: it is left out, and what an earlier
/// run left there is taken away.
///
/// # Errors
/// [`ReportError::Write`].
pub fn write_csv<R: Serialize>(file: &Path, rows: &[R]) -> Result<(), ReportError> {
    if rows.is_empty() {
        return match std::fs::remove_file(file) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => Err(ReportError::Write { file: file.into(), source }),
            _ => Ok(()),
        };
    }
    write_atomically(file, |out| {
        let mut writer = csv::Writer::from_writer(out);
        for row in rows {
            writer.serialize(row).map_err(io::Error::other)?;
        }
        writer.flush()
    })
}

/// Writes `iterations.csv`; the values' columns have the names given.
///
/// # Errors
/// [`ReportError::Write`], also if a row has another number of values than there are names.
pub fn write_iterations(file: &Path, parameter_names: &[String], rows: &[IterationRow]) -> Result<(), ReportError> {
    write_atomically(file, |out| {
        let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(out);
        let columns = ["iteration", "cost", "step", "simulations", "status"].into_iter();
        writer.write_record(columns.chain(parameter_names.iter().map(String::as_str)))?;
        for row in rows {
            writer.serialize(row).map_err(io::Error::other)?;
        }
        writer.flush()
    })
}

/// Writes a record as JSON, indented, its keys in the order of the fields.
///
/// # Errors
/// [`ReportError::Write`].
pub fn write_json<T: Serialize>(file: &Path, record: &T) -> Result<(), ReportError> {
    write_atomically(file, |out| {
        serde_json::to_writer_pretty(&mut *out, record)?;
        out.write_all(b"\n")
    })
}

/// What a row of `parameters.csv` says was found.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct FoundParameter {
    /// Name with its unit.
    pub parameter: String,
    /// Region it holds for.
    pub region: String,
    /// Value found.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub interval_low: Option<f64>,
    /// Upper end of the 95 % interval.
    pub interval_high: Option<f64>,
    /// `fixed` if the study did not seek it.
    #[serde(default)]
    pub state: String,
}

/// Reads the `parameters.csv` that an earlier run left.
///
/// # Errors
/// [`ReportError::Read`].
pub fn read_parameters(file: &Path) -> Result<Vec<FoundParameter>, ReportError> {
    let failed = |error: csv::Error| ReportError::Read { file: file.to_path_buf(), source: io::Error::other(error) };
    csv::Reader::from_path(file).map_err(failed)?.deserialize().collect::<Result<_, _>>().map_err(failed)
}

/// Reads the numbers of a JSON record that an earlier run left; those of inner records as `outer.inner`.
///
/// # Errors
/// [`ReportError::Read`].
pub fn read_json_numbers(file: &Path) -> Result<BTreeMap<String, f64>, ReportError> {
    let failed = |source| ReportError::Read { file: file.to_path_buf(), source };
    let text = std::fs::read_to_string(file).map_err(failed)?;
    let record: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&text).map_err(|error| failed(error.into()))?;
    let mut numbers = BTreeMap::new();
    for (name, value) in &record {
        let inner = value.as_object().into_iter().flatten().map(|(inner, value)| (format!("{name}.{inner}"), value));
        numbers.extend(inner.chain([(name.clone(), value)]).filter_map(|(name, value)| Some((name, value.as_f64()?))));
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_of_parameters_are_those_of_the_contract() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("parameters.csv");
        let row = ParameterRow {
            parameter: "contraction_peak_lv_kpa".into(),
            symbol: "σ0_LV",
            unit: "kPa".into(),
            region: "heart".into(),
            initial: 90.0,
            value: 101.5,
            lower: 30.0,
            upper: 200.0,
            sd: Some(2.5),
            interval_low: Some(96.6),
            interval_high: None,
            at_bound: false,
            state: "free",
            prior_mean: None,
            prior_sd: None,
        };
        write_csv(&file, &[row]).unwrap();
        let found = &read_parameters(&file).unwrap()[0];
        assert_eq!((found.parameter.as_str(), found.region.as_str()), ("contraction_peak_lv_kpa", "heart"));
        assert_eq!((found.value, found.interval_low, found.interval_high), (101.5, Some(96.6), None));
        assert_eq!(
            std::fs::read_to_string(&file).unwrap(),
            "parameter,symbol,unit,region,initial,value,lower,upper,sd,interval_low,interval_high,at_bound,state,prior_mean,prior_sd\n\
             contraction_peak_lv_kpa,σ0_LV,kPa,heart,90.0,101.5,30.0,200.0,2.5,96.6,,false,free,,\n"
        );
    }

    #[test]
    fn a_table_without_rows_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("beats.csv");
        write_csv(&file, &[1.5]).unwrap();
        assert!(file.is_file());
        write_csv::<f64>(&file, &[]).unwrap();
        write_csv::<f64>(&file, &[]).unwrap();
        assert!(!file.exists());
    }

    #[test]
    fn numbers_of_a_record_are_read_with_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("summary.json");
        std::fs::write(&file, r#"{"a": 0.5, "b": {"c": 2, "d": "no"}, "e": null, "f": [1]}"#).unwrap();
        let numbers = read_json_numbers(&file).unwrap();
        assert_eq!(numbers.into_iter().collect::<Vec<_>>(), [("a".to_string(), 0.5), ("b.c".to_string(), 2.0)]);
        std::fs::write(&file, "{").unwrap();
        assert!(read_json_numbers(&file).unwrap_err().to_string().contains("summary.json, which an earlier run left"));
    }

    #[test]
    fn iterations_have_a_column_for_each_free_parameter() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("iterations.csv");
        let row = IterationRow { iteration: 1, cost: 2.5, step: 0.5, simulations: 4, status: "accepted".into(), values: vec![90.0, 0.3] };
        write_iterations(&file, &["sigma".into(), "apd".into()], &[row]).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        assert_eq!(text, "iteration,cost,step,simulations,status,sigma,apd\n1,2.5,0.5,4,accepted,90.0,0.3\n");
    }

    #[test]
    fn numbers_come_back_from_csv_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("paths.csv");
        let numbers = [std::f64::consts::PI, 1e-300, -0.1 - 0.2, 123_456_789.123_456_79];
        let row = |&x_mm: &f64| PathRow { point: "a, \"b\"".into(), frame: 1, time_s: 0.1, x_mm, y_mm: 0.0, z_mm: 0.0 };
        write_csv(&file, &numbers.iter().map(row).collect::<Vec<_>>()).unwrap();
        let mut reader = csv::Reader::from_path(&file).unwrap();
        for (record, number) in reader.records().zip(numbers) {
            let record = record.unwrap();
            assert_eq!(&record[0], "a, \"b\"");
            assert_eq!(record[3].parse::<f64>().unwrap().to_bits(), number.to_bits());
        }
    }
}
