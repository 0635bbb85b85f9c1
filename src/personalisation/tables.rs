//! Tables of a calibration, ready to be written: iterations, and how strongly each parameter moves each part of the data.

use serde::Serialize;

use super::problem::Linearisation;
use super::{IterationRecord, ParameterSpace, PersonalisationError, StackedResidual};
use crate::numerics::root_mean_square;

/// A header and rows of equal length, all text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// Column names.
    pub header: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
}

/// `iterations.csv`: one row for the start and each accepted step, with the physical value of every free parameter. Indices of active
/// bounds are written as names, several of them with a `+`.
pub fn iteration_table(records: &[IterationRecord], space: &ParameterSpace, constraint_labels: &[String]) -> Table {
    let names = space.names();
    let fixed = ["iteration", "cost", "data_cost", "prior_cost", "step_norm", "trust_radius", "gain_ratio", "trials"];
    let active = ["active_lower", "active_upper", "active_constraints"];
    let header = fixed.iter().chain(&active).map(|name| (*name).to_owned()).chain(names.iter().cloned()).collect();
    let joined =
        |indices: &[usize], labels: &[String]| indices.iter().filter_map(|&index| labels.get(index).cloned()).collect::<Vec<_>>().join("+");
    let row = |record: &IterationRecord| {
        let mut row = vec![record.iteration.to_string()];
        let numbers = [record.cost, record.data_cost, record.prior_cost, record.step_norm, record.trust_radius, record.gain_ratio];
        row.extend(numbers.map(|value| format!("{value:.6e}")));
        row.push(record.trials.to_string());
        row.push(joined(&record.active_lower, &names));
        row.push(joined(&record.active_upper, &names));
        row.push(joined(&record.active_constraints, constraint_labels));
        row.extend(space.to_values(&record.coordinates).into_iter().map(|value| format!("{value:.6}")));
        row
    };
    Table { header, rows: records.iter().map(row).collect() }
}

/// How far one prior standard deviation of a parameter moves one part of the data: a row of `sensitivities.csv`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DataSensitivity {
    /// Parameter.
    pub parameter: String,
    /// Part of the residual.
    pub residual: &'static str,
    /// Root mean square of ∂r/∂θ · s over the part's rows: in standard deviations of the data. Below about 1/√rows the part says nothing.
    pub rms_per_prior_sd: f64,
    /// The row (counted within the part) that moves most.
    pub largest_row: usize,
    /// How far that row moves, with its sign.
    pub largest_per_prior_sd: f64,
}

/// Sensitivities of every part of `residual` to every coordinate; `scales` are the steps they are told for (prior standard deviations).
///
/// # Errors
/// [`PersonalisationError::Shape`] if `at` belongs to another residual or `names` or `scales` to other coordinates.
pub fn data_sensitivities<T>(
    residual: &StackedResidual<'_, T>,
    at: &Linearisation,
    scales: &nalgebra::DVector<f64>,
    names: &[String],
) -> Result<Vec<DataSensitivity>, PersonalisationError> {
    let dimension = at.jacobian.ncols();
    let parts = residual.parts();
    let expected = parts.last().map_or(0, |(_, rows)| rows.end);
    for (what, found, expected) in [
        ("rows of the Jacobian", at.jacobian.nrows(), expected),
        ("names of coordinates", names.len(), dimension),
        ("scales of coordinates", scales.len(), dimension),
    ] {
        if found != expected {
            return Err(PersonalisationError::Shape { what, found, expected });
        }
    }
    let mut sensitivities = Vec::with_capacity(dimension * parts.len());
    for (column, name) in names.iter().enumerate() {
        for (part, rows) in &parts {
            let moved: Vec<f64> = rows.clone().map(|row| at.jacobian[(row, column)] * scales[column]).collect();
            let largest_row = (0..moved.len()).max_by(|&a, &b| moved[a].abs().total_cmp(&moved[b].abs())).unwrap_or(0);
            sensitivities.push(DataSensitivity {
                parameter: name.clone(),
                residual: part,
                rms_per_prior_sd: root_mean_square(&moved),
                largest_row,
                largest_per_prior_sd: moved.get(largest_row).copied().unwrap_or(0.0),
            });
        }
    }
    Ok(sensitivities)
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::anatomy::Ventricle;
    use crate::heart::{Parameter, Parameters};
    use crate::personalisation::{FreeParameter, Loss, PriorResidual, VolumeCurveResidual};

    #[test]
    fn iterations_are_told_in_physical_values_and_names() {
        let peak = FreeParameter::new(Parameter::ContractionPeakLv).between(40.0, 250.0);
        let space = ParameterSpace::new(Parameters::default(), vec![peak]).unwrap();
        let record = IterationRecord {
            iteration: 1,
            status: crate::personalisation::RecordStatus::Accepted,
            cost: 2.5,
            data_cost: 2.0,
            prior_cost: 0.5,
            step_norm: 0.1,
            trust_radius: 1.0,
            gain_ratio: 0.9,
            trials: 2,
            spent: 3.0,
            active_lower: vec![],
            active_upper: vec![0],
            active_constraints: vec![0],
            coordinates: DVector::from_element(1, 250.0_f64.ln()),
        };
        let table = iteration_table(&[record], &space, &["rv <= lv".to_owned()]);
        assert_eq!(table.header.last().unwrap(), "contraction_peak_lv_kpa");
        assert_eq!(table.header.len(), table.rows[0].len());
        assert_eq!(
            table.rows[0],
            [
                "1",
                "2.500000e0",
                "2.000000e0",
                "5.000000e-1",
                "1.000000e-1",
                "1.000000e0",
                "9.000000e-1",
                "2",
                "",
                "contraction_peak_lv_kpa",
                "rv <= lv",
                "250.000000"
            ]
        );
    }

    #[test]
    fn sensitivities_are_columns_of_the_jacobian_part_by_part() {
        let curve = |ventricle, count| VolumeCurveResidual::new(ventricle, vec![100.0; count], 1.0).unwrap();
        let residual = StackedResidual::default().with("left", curve(Ventricle::Left, 2)).with("right", curve(Ventricle::Right, 1));
        let at = Linearisation {
            coordinates: DVector::zeros(1),
            rows: DVector::zeros(3),
            jacobian: DMatrix::from_column_slice(3, 1, &[3.0, -4.0, 1.0]),
            losses: vec![Loss::Squares; 3],
            prior: PriorResidual::none(1),
        };
        let found = data_sensitivities(&residual, &at, &DVector::from_element(1, 0.5), &["peak".to_owned()]).unwrap();
        assert_eq!(found.len(), 2);
        assert!((found[0].rms_per_prior_sd - 12.5_f64.sqrt() * 0.5).abs() < 1e-14);
        assert_eq!((found[0].largest_row, found[0].largest_per_prior_sd), (1, -2.0));
        assert_eq!((found[1].residual, found[1].rms_per_prior_sd), ("right", 0.5));
        assert!(data_sensitivities(&residual, &at, &DVector::zeros(2), &["peak".to_owned()]).is_err());
    }
}
