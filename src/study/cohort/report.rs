//! `cohort.md`: the table of a cohort for reading, in Markdown.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use super::CohortPatient;
use super::table::PatientTable;
use crate::report::{LedgerRow, ReportError, write_atomically};

/// Writes the report of `patients`; those without a row were not run.
pub(super) fn write(
    file: &Path,
    name: &str,
    table: &PatientTable,
    patients: &[&CohortPatient],
    rows: &BTreeMap<String, LedgerRow>,
) -> Result<(), ReportError> {
    let text = text(name, table, patients, rows);
    write_atomically(file, |out| out.write_all(text.as_bytes()))
}

fn text(name: &str, table: &PatientTable, patients: &[&CohortPatient], rows: &BTreeMap<String, LedgerRow>) -> String {
    let failed = patients.iter().filter_map(|patient| rows.get(&patient.name)).filter(|row| table.has_failed(row)).count();
    let missing = patients.iter().filter(|patient| !rows.contains_key(&patient.name)).count();
    let mut text = format!("# {name}\n\n{} patients: {failed} failed, {missing} not run.\n", patients.len());
    // Figures that nobody has are left out.
    let any = |column: &&str| rows.values().any(|row| table.field(row, column).is_some());
    let figures: Vec<&str> = PatientTable::figures().filter(any).collect();
    let parameters = table.parameters();
    let columns: Vec<&str> =
        ["patient", "status"].into_iter().chain(figures.iter().copied()).chain(parameters.iter().map(String::as_str)).collect();
    let _ = write!(text, "\n| {} |\n|{}\n", columns.join(" | "), "---|".repeat(columns.len()));
    for patient in patients {
        let cells = match rows.get(&patient.name) {
            Some(row) => cells(table, row, &figures),
            None => vec!["not run".into()],
        };
        let _ = writeln!(text, "| {} | {} |", patient.name, cells.join(" | "));
    }
    let reasons: Vec<String> = patients
        .iter()
        .filter_map(|patient| Some(format!("- {}: {}", patient.name, table.field(rows.get(&patient.name)?, "reason")?)))
        .collect();
    if !reasons.is_empty() {
        let _ = write!(text, "\n## What failed\n\n{}\n", reasons.join("\n"));
    }
    text
}

/// Status, figures, and parameters with their intervals.
fn cells(table: &PatientTable, row: &LedgerRow, figures: &[&str]) -> Vec<String> {
    let short = |column: &str| table.field(row, column).and_then(|field| field.parse::<f64>().ok()).map(four_digits);
    let mut cells = vec![table.field(row, "status").unwrap_or_default().to_string()];
    cells.extend(figures.iter().map(|figure| short(figure).unwrap_or_default()));
    cells.extend(table.parameters().iter().map(|name| {
        let ends = short(&format!("{name}_low")).zip(short(&format!("{name}_high")));
        let interval = ends.map(|(low, high)| format!(" ({low} to {high})")).unwrap_or_default();
        short(name).map(|value| format!("{value}{interval}")).unwrap_or_default()
    }));
    cells
}

/// Four significant digits.
fn four_digits(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (3 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_digits_of_small_and_large_numbers() {
        assert_eq!([0.24117, 186.666, 1201.03, 0.0, -0.020704].map(four_digits), ["0.2412", "186.7", "1201", "0", "-0.02070"]);
    }
}
