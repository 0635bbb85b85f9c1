//! `patients.csv`: one row a patient, read from what its run left.

use std::error::Error;
use std::path::Path;

use super::{Cohort, CohortPatient, summary_file};
use crate::heart::Part;
use crate::report::{FoundParameter, LedgerRow, read_json_numbers, read_parameters};
use crate::study::Status;

/// Figures by their place in `summary.json`; the last part of it is the column.
const FIGURES: &[&str] = &[
    "ejection_fraction_lv",
    "end_diastolic_volume_lv_ml",
    "end_systolic_volume_lv_ml",
    "pressure_peak_lv_mmhg",
    "volume_rms_ml",
    "tracking.boundary_rms_endocardium_lv_mm",
    "tracking.boundary_rms_epicardium_mm",
];

/// The columns of a cohort's table.
pub(super) struct PatientTable {
    columns: Vec<String>,
    parameters: Vec<FreeColumn>,
}

/// A parameter that a patient's study leaves free, in the whole heart or in a part of it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct FreeColumn {
    parameter: String,
    /// As in the column `region` of `parameters.csv`; whatever it is where none.
    part: Option<&'static str>,
}

impl FreeColumn {
    /// As a parameter of a part is named elsewhere: `contraction_peak_lv_kpa.segment_7`.
    fn name(&self) -> String {
        self.part.map_or_else(|| self.parameter.clone(), |part| format!("{}.{part}", self.parameter))
    }

    /// The columns of an entry of `[[personalisation.parameter]]`.
    fn of_entry(entry: &toml::Value) -> Vec<Self> {
        let text = |key: &str| entry.get(key).and_then(toml::Value::as_str);
        let Some(parameter) = text("name") else { return Vec::new() };
        let column = |part| Self { parameter: parameter.to_string(), part };
        let is_in = |part: &Part| match text("regions") {
            Some("aha_segments") => matches!(part, Part::Segment(_)),
            Some("ventricles") => matches!(part, Part::LeftVentricle | Part::RightVentricle | Part::Scar),
            _ => false,
        };
        let parts: Vec<Self> = Part::all().filter(is_in).map(|part| column(Some(part.name()))).collect();
        if parts.is_empty() { vec![column(None)] } else { parts }
    }
}

impl PatientTable {
    pub(super) fn new(cohort: &Cohort) -> Self {
        let mut parameters: Vec<FreeColumn> = Vec::new();
        for config in cohort.patients.iter().filter_map(|patient| cohort.config(patient).ok()) {
            let entries = config.document.get("personalisation").and_then(|table| table.get("parameter")?.as_array());
            for column in entries.into_iter().flatten().flat_map(FreeColumn::of_entry) {
                if !parameters.contains(&column) {
                    parameters.push(column);
                }
            }
        }
        let figures = FIGURES.iter().map(|figure| column_of(figure).to_string());
        let names = parameters.iter().map(FreeColumn::name);
        let values = names.flat_map(|name| [String::new(), "_low".into(), "_high".into()].map(|end| format!("{name}{end}")));
        let columns = ["patient", "status"].map(str::to_string).into_iter().chain(figures).chain(values).chain(["reason".to_string()]);
        Self { columns: columns.collect(), parameters }
    }

    pub(super) fn columns(&self) -> &[String] {
        &self.columns
    }

    /// A field of a row; nothing where it is empty.
    pub(super) fn field<'r>(&self, row: &'r LedgerRow, column: &str) -> Option<&'r str> {
        let place = self.columns.iter().position(|name| name == column)?;
        row.fields.get(place).map(String::as_str).filter(|field| !field.is_empty())
    }

    /// The figures' columns.
    pub(super) fn figures() -> impl Iterator<Item = &'static str> {
        FIGURES.iter().map(|figure| column_of(figure))
    }

    /// The parameters' columns.
    pub(super) fn parameters(&self) -> Vec<String> {
        self.parameters.iter().map(FreeColumn::name).collect()
    }

    pub(super) fn has_failed(&self, row: &LedgerRow) -> bool {
        self.field(row, "status").is_none_or(|status| status == Status::Failed.word())
    }

    /// Status, and what there is to say in a few words.
    pub(super) fn words(&self, row: &LedgerRow) -> String {
        let status = self.field(row, "status").unwrap_or_default();
        let fraction = self.field(row, "ejection_fraction_lv").and_then(|field| field.parse::<f64>().ok());
        let more = self.field(row, "reason").map(str::to_string).or(fraction.map(|share| format!("EF {:.1} %", 100.0 * share)));
        more.map_or_else(|| status.to_string(), |more| format!("{status}, {more}"))
    }

    /// The row of a patient whose run came to an end.
    pub(super) fn row(&self, owner: u64, patient: &CohortPatient, status: Status, folder: &Path) -> Result<LedgerRow, Box<dyn Error>> {
        let figures = read_json_numbers(&summary_file(folder))?;
        let file = folder.join("parameters.csv");
        let found: Vec<FoundParameter> = if file.is_file() { read_parameters(&file)? } else { Vec::new() };
        let number = |value: Option<f64>| value.map(|value| format!("{value:?}")).unwrap_or_default();
        let mut fields = vec![patient.name.clone(), status.word().to_string()];
        fields.extend(FIGURES.iter().map(|figure| number(figures.get(*figure).copied())));
        for column in &self.parameters {
            let is_it = |row: &&FoundParameter| row.parameter == column.parameter && column.part.is_none_or(|part| row.region == part);
            let row = found.iter().find(is_it);
            let values = row.map_or([None; 3], |row| [Some(row.value), row.interval_low, row.interval_high]);
            fields.extend(values.map(number));
        }
        fields.push(if status == Status::Failed {
            format!("see {}", summary_file(Path::new(&patient.name)).display())
        } else {
            String::new()
        });
        Ok(LedgerRow { owner, fields })
    }

    /// The row of a patient that could not be run.
    pub(super) fn failed_row(&self, owner: u64, patient: &CohortPatient, reason: &str) -> LedgerRow {
        let mut fields = vec![patient.name.clone(), Status::Failed.word().to_string()];
        fields.resize(self.columns.len() - 1, String::new());
        fields.push(reason.to_string());
        LedgerRow { owner, fields }
    }
}

fn column_of(figure: &str) -> &str {
    figure.rsplit('.').next().unwrap_or(figure)
}
