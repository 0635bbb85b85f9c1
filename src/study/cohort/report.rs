//! `cohort.md` and `report.html`: the table of a cohort for reading, in Markdown and as a page that leads to those of the patients.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use super::CohortPatient;
use super::table::PatientTable;
use crate::report::figures::Bar;
use crate::report::html::{Bars, Block, Page, Section, Table, heading, write_page};
use crate::report::{LedgerRow, ReportError, write_atomically};

/// Writes `cohort.md` and `report.html` of `patients` into a folder; those without a row were not run.
pub(super) fn write(
    folder: &Path,
    name: &str,
    table: &PatientTable,
    patients: &[&CohortPatient],
    rows: &BTreeMap<String, LedgerRow>,
) -> Result<(), ReportError> {
    let text = text(name, table, patients, rows);
    write_atomically(&folder.join("cohort.md"), |out| out.write_all(text.as_bytes()))?;
    write_page(&folder.join("report.html"), &page(name, table, patients, rows))
}

/// The page of `patients`, with a link to the report of every one that has been run.
fn page(name: &str, table: &PatientTable, patients: &[&CohortPatient], rows: &BTreeMap<String, LedgerRow>) -> Page {
    let run: Vec<(&CohortPatient, &LedgerRow)> = patients.iter().filter_map(|patient| Some((*patient, rows.get(&patient.name)?))).collect();
    let failed = run.iter().filter(|(_, row)| table.has_failed(row)).count();
    let missing = patients.len() - run.len();
    let figures = known_figures(table, rows);
    let parameters = table.parameters();
    let line =
        |(patient, row): &(&CohortPatient, &LedgerRow)| std::iter::once(patient.name.clone()).chain(cells(table, row, &figures)).collect();
    let named = ["patient", "status"].into_iter().chain(figures.iter().copied());
    let of_patients = Table {
        caption: "The patients; parameters with their 95 % intervals".into(),
        columns: named.map(heading).chain(parameters.iter().cloned()).collect(),
        rows: run.iter().map(line).collect(),
    };
    let reasons: Vec<String> =
        run.iter().filter_map(|(patient, row)| Some(format!("{}: {}", patient.name, table.field(row, "reason")?))).collect();
    let link = |(patient, _): &(&CohortPatient, &LedgerRow)| (patient.name.clone(), format!("{}/report.html", patient.name));
    let links = run.iter().filter(|(_, row)| !table.has_failed(row)).map(link).collect();
    let mut blocks = vec![Block::Table(of_patients)];
    if !reasons.is_empty() {
        blocks.extend([Block::Text("What failed:".into()), Block::Warnings(reasons)]);
    }
    let bars = figures.iter().map(|figure| Block::Bars(of_figure(table, figure, &run))).collect();
    Page {
        title: name.trim_end_matches(".toml").replace('_', " "),
        question: "The same study for every patient of a cohort.".into(),
        status: (format!("{} patients: {failed} failed, {missing} not run.", patients.len()), failed + missing == 0),
        sections: vec![
            Section { title: "Patients".into(), blocks },
            Section { title: "Reports of the patients".into(), blocks: vec![Block::Links(links)] },
            Section { title: "Side by side".into(), blocks: vec![Block::Beside(bars)] },
        ],
        ..Page::default()
    }
}

/// A figure of all patients.
fn of_figure(table: &PatientTable, figure: &str, run: &[(&CohortPatient, &LedgerRow)]) -> Bars {
    let value = |row: &LedgerRow| table.field(row, figure).and_then(|field| field.parse::<f64>().ok());
    let bar =
        |(patient, row): &(&CohortPatient, &LedgerRow)| Some(Bar { name: patient.name.clone(), value: value(row)?, ..Bar::default() });
    Bars { title: heading(figure), bars: run.iter().filter_map(bar).collect(), ..Bars::default() }
}

/// Figures that somebody has.
fn known_figures(table: &PatientTable, rows: &BTreeMap<String, LedgerRow>) -> Vec<&'static str> {
    let any = |column: &&str| rows.values().any(|row| table.field(row, column).is_some());
    PatientTable::figures().filter(any).collect()
}

fn text(name: &str, table: &PatientTable, patients: &[&CohortPatient], rows: &BTreeMap<String, LedgerRow>) -> String {
    let failed = patients.iter().filter_map(|patient| rows.get(&patient.name)).filter(|row| table.has_failed(row)).count();
    let missing = patients.iter().filter(|patient| !rows.contains_key(&patient.name)).count();
    let mut text = format!("# {name}\n\n{} patients: {failed} failed, {missing} not run.\n", patients.len());
    let figures = known_figures(table, rows);
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
