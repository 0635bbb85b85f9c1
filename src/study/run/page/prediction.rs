//! What the heart would do if it were depolarised from elsewhere: a table beside its own beat and, of a phantom, beside the truth; curves.

use crate::report::figures::Bar;
use crate::report::html::{Bars, Block, BullsEye, Plot, Scale, Section, Table};
use crate::study::plan::OWN_ONSET;
use crate::study::run::prediction::{PredictionRow, Predictions, onset_in_words};
use crate::units::MS_PER_S;

use super::wall::by_segment;

/// The predictions; empty where there are none.
pub(in crate::study::run) fn prediction_section(predictions: Option<&Predictions>) -> Section {
    Section { title: "Predictions".into(), blocks: predictions.map(blocks).unwrap_or_default() }
}

fn blocks(predictions: &Predictions) -> Vec<Block> {
    let about = "What the model says this heart would do if its depolarisation began elsewhere, for example under pacing: the same heart with the \
                 same parameters, beaten anew from each onset. Nothing was fitted to these beats.";
    let judged = if predictions.truth.is_empty() {
        "No recording of these beats was at hand to judge them by: read them as what follows from the model, and the changes rather than the values."
    } else {
        "The true heart of this phantom was depolarised from the same places: what it does stands behind each prediction, and shows what that is worth."
    };
    let eyes = predictions.beaten.iter().map(|one| BullsEye {
        title: format!("Activation, {}", onset_in_words(&one.name)),
        unit: "ms".into(),
        values: by_segment(one.segments().iter().map(|row| (row.segment, MS_PER_S * row.activation_time_s))),
        scale: Scale::Sequential,
    });
    let eyes: Vec<BullsEye> = eyes.filter(|eye| eye.values.iter().any(Option::is_some)).collect();
    let curves = vec![Block::Plot(Plot::from(&predictions.pressures())), Block::Plot(Plot::from(&predictions.volumes()))];
    let mut blocks = vec![
        Block::Text(about.into()),
        Block::Text(judged.into()),
        Block::Table(table(predictions)),
        Block::Beside(vec![Block::Bars(changes(predictions))]),
        Block::Beside(curves),
    ];
    if !eyes.is_empty() {
        blocks.push(Block::BullsEyes(eyes));
    }
    blocks
}

/// A figure of a row, in the unit it is shown in.
type Figure = fn(&PredictionRow) -> Option<f64>;

const FIGURES: [(&str, Figure, usize); 8] = [
    ("Activation, ms", |row| Some(row.total_activation_time_ms), 0),
    ("… of the LV, ms", |row| Some(row.activation_time_lv_ms), 0),
    ("dP/dt max, mmHg/s", |row| row.pressure_rate_max_lv_mmhg_per_s, 0),
    ("change, %", change, 1),
    ("EF, %", |row| row.ejection_fraction_lv.map(|fraction| 100.0 * fraction), 1),
    ("Stroke volume, mL", |row| row.stroke_volume_lv_ml, 1),
    ("Peak pressure, mmHg", |row| row.pressure_peak_lv_mmhg, 0),
    ("Dispersion, ms", |row| row.mechanical_dispersion_ms, 0),
];

/// Of dP/dt max against the own onset, which has none.
fn change(row: &PredictionRow) -> Option<f64> {
    row.pressure_rate_change_percent.filter(|_| row.onset != OWN_ONSET)
}

fn table(predictions: &Predictions) -> Table {
    let rounded = |value: f64, decimals: usize| format!("{value:.decimals$}").replace('-', "−");
    let line = |row: &PredictionRow| {
        let truth = predictions.truth.iter().find(|truth| truth.onset == row.onset);
        let cell = |&(_, value, decimals): &(&str, Figure, usize)| match (value(row), truth.and_then(value)) {
            (Some(found), Some(real)) => format!("{} (true\u{a0}{})", rounded(found, decimals), rounded(real, decimals)),
            (Some(found), None) => rounded(found, decimals),
            _ => String::new(),
        };
        std::iter::once(onset_in_words(&row.onset)).chain(FIGURES.iter().map(cell)).collect()
    };
    Table {
        caption:
            "The left ventricle under each onset; dispersion is the standard deviation of the instants at which the segments are shortest"
                .into(),
        columns: std::iter::once("Onset").chain(FIGURES.map(|(name, ..)| name)).map(str::to_owned).collect(),
        rows: predictions.rows.iter().map(line).collect(),
    }
}

/// How far each onset changes dP/dt max, by which pacing is judged.
fn changes(predictions: &Predictions) -> Bars {
    let bar = |row: &PredictionRow| {
        let truth = predictions.truth.iter().find(|truth| truth.onset == row.onset);
        Some(Bar { name: onset_in_words(&row.onset), value: change(row)?, beside: truth.and_then(change), ..Bar::default() })
    };
    Bars {
        title: "Change of LV dP/dt max against the own onset".into(),
        quantity: "change (%)".into(),
        beside: (!predictions.truth.is_empty()).then(|| "truth".into()),
        bars: predictions.rows.iter().filter_map(bar).collect(),
    }
}
