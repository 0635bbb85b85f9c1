//! What a personalisation found: parameters with intervals and bounds, how well the data tell them apart, and how the search went.

use crate::heart::Parameter;
use crate::personalisation::{ParameterSpace, Uncertainty};
use crate::report::ParameterRow;
use crate::report::figures::{Bar, Curve, Look};
use crate::report::html::{Bars, Block, CorrelationMatrix, Intervals, Plot, Section, Table, readable};
use crate::study::run::parameter_rows::interval;
use crate::study::run::personal_tables::{iteration_rows, verdict};
use crate::study::run::personalise::Personalised;
use crate::study::run::prediction::Predictions;
use crate::study::run::recovery::Recovery;

/// Parameters, identifiability, convergence.
pub(in crate::study::run) fn personal_sections(found: &Personalised, rows: &[ParameterRow], recovery: Option<&Recovery>) -> [Section; 3] {
    [parameters(rows, recovery), identifiability(found), convergence(found)]
}

fn parameters(rows: &[ParameterRow], recovery: Option<&Recovery>) -> Section {
    let sought: Vec<ParameterRow> = rows.iter().filter(|row| row.state != "fixed").cloned().collect();
    let fixed: Vec<&ParameterRow> = rows.iter().filter(|row| row.state == "fixed").collect();
    let on_bound: Vec<String> = sought
        .iter()
        .filter(|row| row.at_bound)
        .map(|row| {
            format!(
                "{} ({}) lies on its {} bound: it says “at least” or “at most”, and has no interval of its own.",
                row.parameter, row.region, row.state
            )
        })
        .collect();
    let intervals = sought.iter().map(|row| interval(row.clone(), recovery)).collect();
    let mut blocks = vec![Block::Intervals(Intervals { title: "Parameters found, on the scale of their bounds".into(), rows: intervals })];
    if !on_bound.is_empty() {
        blocks.push(Block::Warnings(on_bound));
    }
    blocks.push(Block::Table(table_of(&sought)));
    blocks.extend(recovery.map(|recovery| Block::Table(Table::of_rows("Found and true", &recovery.parameters))));
    blocks.push(Block::Folded("Parameters that were held".into(), vec![Block::Table(Table::of_rows("Held at their values", &fixed))]));
    Section { title: "Parameters".into(), blocks }
}

/// What was found in plain words: parameters of the heart, how far they can be believed, predictions. Gains of the images are not of the heart.
pub(in crate::study::run) fn told(verdicts: &[String], rows: &[ParameterRow], predictions: Option<&Predictions>) -> Vec<String> {
    /// More parameters, as of segments, are in the table alone.
    const TOLD: usize = 8;
    let of_heart: Vec<&ParameterRow> = rows.iter().filter(|row| row.state != "fixed" && !row.parameter.starts_with("image_gain")).collect();
    let mut lines: Vec<String> = of_heart.iter().take(TOLD).map(|row| sentence(row)).collect();
    if of_heart.len() > TOLD {
        lines.push(format!("… and {} more parameters, below.", of_heart.len() - TOLD));
    }
    lines.extend(verdicts.iter().cloned());
    lines.extend(predictions.map(Predictions::headlines).unwrap_or_default());
    lines
}

fn sentence(row: &ParameterRow) -> String {
    let meaning = meaning(&row.parameter).trim_end_matches('.');
    let place = if row.region.starts_with("segment") { format!(" in {}", place(&row.region)) } else { String::new() };
    let interval = row.interval_low.zip(row.interval_high);
    let interval = interval.map(|(low, high)| format!(", with 95 % between {} and {}", readable(low), readable(high)));
    let bound = if row.at_bound { ", which is its bound: at least or at most that" } else { "" };
    let sure = interval.unwrap_or_default();
    format!("{meaning}{place}: {} {}{sure}{bound}; the search started at {}.", readable(row.value), row.unit, readable(row.initial))
}

fn meaning(name: &str) -> &'static str {
    Parameter::ALL.iter().map(|parameter| parameter.spec()).find(|spec| spec.name == name).map_or("", |spec| spec.meaning)
}

/// A region as it is said.
fn place(region: &str) -> String {
    match region {
        "global" => "whole heart".into(),
        "lv" => "left ventricle".into(),
        "rv" => "right ventricle".into(),
        other => other.replace('_', " ").replace("endocardium lv", "LV endocardium").replace("endocardium rv", "RV endocardium"),
    }
}

/// The parameters in the words of a reader.
fn table_of(rows: &[ParameterRow]) -> Table {
    let columns = ["Parameter", "What it is", "Where", "Start", "Found", "95 % interval", "Bounds", "Prior", "State"];
    let pair = |ends: Option<(f64, f64)>, between: &str| {
        ends.map_or_else(String::new, |(low, high)| format!("{}{between}{}", readable(low), readable(high)))
    };
    let row = |row: &ParameterRow| {
        vec![
            row.parameter.clone(),
            meaning(&row.parameter).to_owned(),
            place(&row.region),
            readable(row.initial),
            format!("{} {}", readable(row.value), row.unit),
            pair(row.interval_low.zip(row.interval_high), " to "),
            pair(Some((row.lower, row.upper)), " to "),
            pair(row.prior_mean.zip(row.prior_sd), " ± "),
            if row.at_bound { format!("on its {} bound", row.state) } else { row.state.to_owned() },
        ]
    };
    Table { caption: "Parameters found".into(), columns: columns.map(str::to_owned).to_vec(), rows: rows.iter().map(row).collect() }
}

fn identifiability(found: &Personalised) -> Section {
    let mut blocks = vec![Block::List(verdict(&found.found, &found.space))];
    if let Some(uncertainty) = &found.found.uncertainty {
        let names: Vec<String> = uncertainty.free.iter().map(|&place| found.space.names()[place].clone()).collect();
        let mut figures = Vec::new();
        if names.len() > 1 {
            figures.push(Block::Correlations(correlations(uncertainty, names)));
        }
        figures.push(Block::Bars(spectrum(uncertainty, &found.space)));
        blocks.push(Block::Beside(figures));
    }
    blocks.push(Block::Folded(
        "Which data tell of which parameter".into(),
        vec![Block::Table(Table::of_rows(
            "Change of the residuals, in standard deviations of the data, for a change of a parameter by the width of its prior",
            &found.found.sensitivities,
        ))],
    ));
    if !found.found.profiles.is_empty() {
        blocks.push(Block::Folded(
            "Profiles".into(),
            vec![Block::Table(Table::of_rows("Rise of the best cost; 1.92 marks a 95 % interval", &found.found.profiles))],
        ));
    }
    Section { title: "What the data tell".into(), blocks }
}

fn correlations(uncertainty: &Uncertainty, names: Vec<String>) -> CorrelationMatrix {
    let row = |n: usize| (0..names.len()).map(|m| uncertainty.correlations[(n, m)]).collect();
    CorrelationMatrix { title: "Correlations of what was found".into(), values: (0..names.len()).map(row).collect(), names }
}

/// The directions of the parameters by what the data know of them, each named by its largest part.
fn spectrum(uncertainty: &Uncertainty, space: &ParameterSpace) -> Bars {
    let names = space.names();
    let largest = |direction: usize| {
        let parts = uncertainty.directions.column(direction);
        let place = (0..parts.len()).max_by(|&a, &b| parts[a].abs().total_cmp(&parts[b].abs())).unwrap_or(0);
        format!("{}: mostly {}", direction + 1, names[uncertainty.free[place]])
    };
    let bar = |(direction, &value): (usize, &f64)| Bar { name: largest(direction), value: value.log10(), ..Bar::default() };
    Bars {
        title: "What the data know beyond the prior, by direction".into(),
        quantity: "log₁₀ of the singular value (below 0: the prior knows more)".into(),
        beside: None,
        bars: uncertainty.singular_values.iter().enumerate().map(bar).filter(|bar| bar.value.is_finite()).collect(),
    }
}

fn convergence(found: &Personalised) -> Section {
    let records = &found.found.calibration.records;
    let points = records.iter().filter(|record| record.cost > 0.0 && record.cost.is_finite());
    let points: Vec<(f64, f64)> = points.map(|record| (record.iteration as f64, record.cost)).collect();
    let cost = Plot {
        title: "Cost of the last search".into(),
        x_title: "iteration".into(),
        y_title: "cost (half the sum of squared residuals)".into(),
        curves: vec![Curve { name: String::new(), look: Look::Tracked, points }],
        is_logarithmic: [false, true],
        ..Plot::default()
    };
    let names = found.space.names();
    let mut table = Table::of_rows("Iterations", &iteration_rows(records, &found.space));
    table.columns.truncate(5);
    table.columns.extend(names);
    let rows = vec![Block::Table(table), Block::Table(Table::of_rows("Rounds of tracking and search", &found.rounds))];
    Section {
        title: "Convergence".into(),
        blocks: vec![Block::Beside(vec![Block::Plot(cost)]), Block::Folded("Iterations in figures".into(), rows)],
    }
}
