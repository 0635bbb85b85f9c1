//! What the rows of a sensitivity study say: `indices.csv`, a figure of every output, and `summary.json`.

use std::time::Instant;

use serde::Serialize;

use super::RunError;
use super::records::Records;
use crate::numerics::mean;
use crate::report::figures::{Bar, ranking};
use crate::report::html::{Bars, Block, Scatter, Section, Table, readable};
use crate::report::{write_csv, write_json};
use crate::sensitivity::{Index, Measure};
use crate::study::figure::unit_of;
use crate::study::plan::{SensitivityMethod, SensitivityPlan};
use crate::study::run::page::{Account, leave_page};
use crate::study::{Kind, Outcome, Plan, Provenance, Status};

/// A row of `indices.csv`.
#[derive(Debug, Clone, Serialize)]
struct IndexRow<'a> {
    output: &'a str,
    measure: &'static str,
    input: String,
    partner: Option<String>,
    value: f64,
    interval_low: Option<f64>,
    interval_high: Option<f64>,
    unit: String,
    sample_count: usize,
}

#[derive(Debug, Serialize)]
struct Summary<'a> {
    kind: Kind,
    status: Status,
    method: SensitivityMethod,
    run_count: usize,
    failed_run_count: usize,
    /// The first failure in words.
    first_failure: Option<&'a str>,
    /// Outputs that no index could be read of, with the reason.
    outputs_without_indices: Vec<String>,
    /// Time of all runs added up, as far as `times.csv` knows it.
    run_time_s: f64,
    wall_time_s: f64,
    provenance: &'a Provenance,
}

/// Reads the indices of every output and leaves them.
pub(super) fn leave_indices(plan: &Plan, wanted: &SensitivityPlan, records: &Records, started: Instant) -> Result<Outcome, RunError> {
    let folder = &plan.output.directory;
    let point_count = wanted.design.points().len();
    let (mut rows, mut without, mut headlines, mut sections) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (number, output) in wanted.outputs.iter().enumerate() {
        let response = records.response(number, point_count);
        match wanted.design.indices(&response) {
            Ok(indices) => {
                sections.push(section(wanted, output, &indices, records, &response));
                rows.extend(indices.iter().map(|index| row(wanted, output, index)));
                headlines.extend(headline(wanted, output, &indices));
                if plan.output.figures {
                    draw(plan, wanted, output, &indices)?;
                }
            }
            Err(error) => without.push(format!("{output}: {error}")),
        }
    }
    write_csv(&folder.join("indices.csv"), &rows)?;
    let (failed_run_count, first_failure) = records.failures();
    if failed_run_count > 0 {
        headlines.push(format!("{failed_run_count} of {point_count} runs failed; the indices rest on the others"));
    }
    headlines.extend(without.iter().cloned());
    let status = if rows.is_empty() { Status::Failed } else { Status::Converged };
    let summary = Summary {
        kind: plan.kind,
        status,
        method: wanted.method,
        run_count: point_count,
        failed_run_count,
        first_failure,
        outputs_without_indices: without,
        run_time_s: records.wall_time_s(),
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&folder.join("summary.json"), &summary)?;
    let account =
        Account { status, headlines: &headlines, warnings: &summary.outputs_without_indices, key_figures: Vec::new(), record: &summary };
    sections.push(Section {
        title: "All indices".into(),
        blocks: vec![Block::Folded("The table of indices".into(), vec![Block::Table(Table::of_rows("indices.csv", &rows))])],
    });
    leave_page(plan, account, sections, Vec::new())?;
    Ok(Outcome { status, directory: folder.clone(), headlines })
}

/// What the runs gave that are done, of a study that was stopped: no indices, which need all of them.
pub(super) fn so_far(wanted: &SensitivityPlan, records: &Records) -> Section {
    let point_count = wanted.design.points().len();
    let row = |(number, output): (usize, &String)| {
        let values: Vec<f64> = records.response(number, point_count).into_iter().flatten().collect();
        let (least, most) = (values.iter().copied().reduce(f64::min)?, values.iter().copied().reduce(f64::max)?);
        let figures = [least, mean(&values), most].map(readable);
        Some([output.clone(), unit_of(output).to_owned(), values.len().to_string()].into_iter().chain(figures).collect())
    };
    let rows: Vec<Vec<String>> = wanted.outputs.iter().enumerate().filter_map(row).collect();
    let table = Table {
        caption: "The outputs over the runs that are done; indices need all of them".into(),
        columns: ["Output", "Unit", "Runs", "Least", "Mean", "Greatest"].map(str::to_owned).to_vec(),
        rows,
    };
    let blocks = if table.rows.is_empty() { Vec::new() } else { vec![Block::Table(table)] };
    Section { title: "So far".into(), blocks }
}

/// The word of a measure in `indices.csv`.
fn word(measure: Measure) -> &'static str {
    match measure {
        Measure::Slope => "slope",
        Measure::Elasticity => "elasticity",
        Measure::RangeEffect => "range_effect",
        Measure::MeanEffect => "mean_effect",
        Measure::MeanAbsoluteEffect => "mean_absolute_effect",
        Measure::EffectSpread => "effect_sd",
        Measure::FirstOrder => "first_order",
        Measure::SecondOrder => "second_order",
        Measure::Total => "total",
    }
}

fn row<'a>(wanted: &SensitivityPlan, output: &'a str, index: &Index) -> IndexRow<'a> {
    let parameter = |input: usize| wanted.inputs[input].parameter();
    let unit = match index.measure {
        Measure::Slope => format!("{}/({})", unit_of(output), parameter(index.input).parameter().spec().unit),
        Measure::RangeEffect | Measure::MeanEffect | Measure::MeanAbsoluteEffect | Measure::EffectSpread => unit_of(output).into(),
        Measure::Elasticity | Measure::FirstOrder | Measure::SecondOrder | Measure::Total => "1".into(),
    };
    IndexRow {
        output,
        measure: word(index.measure),
        input: parameter(index.input).name(),
        partner: index.partner.map(|partner| parameter(partner).name()),
        value: index.value,
        interval_low: index.interval.map(|(low, _)| low),
        interval_high: index.interval.map(|(_, high)| high),
        unit,
        sample_count: index.sample_count,
    }
}

/// The measure that ranks the inputs, and one that is shown beside it.
fn ranking_measures(method: SensitivityMethod) -> (Measure, &'static str, Option<(Measure, &'static str)>) {
    match method {
        SensitivityMethod::Local => (Measure::RangeEffect, "effect of the range, by the tangent", None),
        SensitivityMethod::Morris => {
            (Measure::MeanAbsoluteEffect, "mean effect of the range, by size", Some((Measure::EffectSpread, "its spread")))
        }
        SensitivityMethod::Sobol => (Measure::Total, "total share of the variance", Some((Measure::FirstOrder, "share alone"))),
    }
}

/// Inputs in the order of what they do, most first.
fn ranked(indices: &[Index], measure: Measure) -> Vec<&Index> {
    let mut ranked: Vec<&Index> = indices.iter().filter(|index| index.measure == measure).collect();
    ranked.sort_by(|a, b| b.value.abs().total_cmp(&a.value.abs()));
    ranked
}

fn headline(wanted: &SensitivityPlan, output: &str, indices: &[Index]) -> Option<String> {
    /// Inputs that are named.
    const NAMED: usize = 3;
    let (measure, words, _) = ranking_measures(wanted.method);
    let name = |index: &&Index| format!("{} {:.3}", wanted.inputs[index.input].parameter().name(), index.value);
    let most: Vec<String> = ranked(indices, measure).iter().take(NAMED).map(name).collect();
    (!most.is_empty()).then(|| format!("{output}: {} ({words})", most.join(", ")))
}

/// The inputs as a figure ranks them, with the quantity in words.
fn ranking_of(wanted: &SensitivityPlan, output: &str, indices: &[Index]) -> (Vec<Bar>, String, Option<&'static str>) {
    let (measure, words, beside) = ranking_measures(wanted.method);
    let other = |index: &Index| {
        let (measure, _) = beside?;
        indices.iter().find(|other| other.measure == measure && other.input == index.input).map(|other| other.value)
    };
    let input = |index: &&Index| Bar {
        name: wanted.inputs[index.input].parameter().name(),
        value: index.value,
        interval: index.interval,
        beside: other(index),
    };
    let inputs = ranked(indices, measure).iter().map(input).collect();
    let unit = if wanted.method == SensitivityMethod::Sobol { "1" } else { unit_of(output) };
    let quantity = if unit == "1" { words.to_string() } else { format!("{words} ({unit})") };
    (inputs, quantity, beside.map(|(_, words)| words))
}

fn draw(plan: &Plan, wanted: &SensitivityPlan, output: &str, indices: &[Index]) -> Result<(), RunError> {
    let (inputs, quantity, beside) = ranking_of(wanted, output, indices);
    let file = plan.output.directory.join(format!("sensitivity_{output}.png"));
    Ok(ranking(&file, output, &quantity, beside, &inputs)?)
}

/// An output of the report: its inputs in order, and the runs over the strongest of them.
fn section(wanted: &SensitivityPlan, output: &str, indices: &[Index], records: &Records, response: &[Option<f64>]) -> Section {
    /// Inputs that the runs are shown over.
    const SHOWN: usize = 3;
    let (bars, quantity, beside) = ranking_of(wanted, output, indices);
    let bars = Bars { title: format!("What moves {output}"), quantity, beside: beside.map(str::to_owned), bars };
    let titled = |name: &str, unit: &str| if unit == "1" { name.to_owned() } else { format!("{name} ({unit})") };
    let scatter = |index: &&Index| {
        let input = wanted.inputs[index.input].parameter();
        let values = records.input(index.input, response.len());
        Block::Scatter(Scatter {
            x_title: titled(&input.name(), input.parameter().spec().unit),
            y_title: titled(output, unit_of(output)),
            points: values.into_iter().zip(response).filter_map(|(x, y)| Some((x?, (*y)?))).collect(),
        })
    };
    let strongest = ranked(indices, ranking_measures(wanted.method).0);
    let scatters = strongest.iter().take(SHOWN).map(scatter).collect();
    Section { title: output.replace('_', " "), blocks: vec![Block::Bars(bars), Block::Beside(scatters)] }
}
