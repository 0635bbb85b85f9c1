//! `parameters.csv` and its figure: what was found, the gains that were chosen, and everything that was held.

use super::gains::{ChosenGains, GAIN_FACTORS};
use super::personalise::Personalised;
use super::recovery::Recovery;
use super::track::Tracked;
use crate::heart::{Parameter, Parameters, Part, RegionalParameter};
use crate::personalisation::{BoundState, FreeParameter, ParameterEstimate, estimates};
use crate::report::ParameterRow;
use crate::report::figures::ParameterInterval;

/// The parameters found, then the gains that the images were tracked with, then all that the study does not seek.
pub(super) fn parameter_rows(found: &Personalised, tracked: &Tracked, written: &Parameters) -> Vec<ParameterRow> {
    let listed = found.space.all();
    let estimates = estimates(&found.space, &found.found.calibration.coordinates, found.found.uncertainty.as_ref());
    let mut rows: Vec<ParameterRow> = estimates.into_iter().zip(listed).map(|(one, entry)| estimated(one, entry)).collect();
    let gains: Vec<_> = tracked.gain_choices.iter().flat_map(|chosen| gain_rows(chosen, tracked, written)).collect();
    let is_listed = |regional: RegionalParameter| {
        listed.iter().any(|entry| entry.parameter == regional) || gains.iter().any(|row| row.parameter == regional.name())
    };
    let model = found.model.parameters();
    let fixed: Vec<_> =
        model.all_values().filter(|&(regional, _)| !is_listed(regional)).map(|(regional, value)| held(regional, value)).collect();
    rows.extend(gains);
    rows.extend(fixed);
    rows
}

fn estimated(one: ParameterEstimate, entry: &FreeParameter) -> ParameterRow {
    // A search that ends on a bound may stop short of it by rounding.
    let near = |bound: f64| (one.value - bound).abs() <= 1e-6 * (one.upper - one.lower);
    let state = match one.at_bound {
        BoundState::Fixed => "fixed",
        _ if near(one.lower) => "lower",
        _ if near(one.upper) => "upper",
        _ => "free",
    };
    let has_prior = entry.prior_sd.is_finite() && state != "fixed";
    ParameterRow {
        parameter: one.parameter.into(),
        symbol: entry.parameter.parameter().spec().symbol,
        unit: one.unit.into(),
        region: one.region,
        initial: one.initial,
        value: one.value,
        lower: one.lower,
        upper: one.upper,
        sd: one.sd,
        interval_low: one.interval_low,
        interval_high: one.interval_high,
        at_bound: matches!(state, "lower" | "upper"),
        state,
        prior_mean: has_prior.then_some(entry.prior_mean),
        prior_sd: has_prior.then(|| entry.prior_sd * entry.transform.slope(entry.prior_mean)),
    }
}

/// A parameter at a value that nothing moved.
fn held(regional: RegionalParameter, value: f64) -> ParameterRow {
    let spec = regional.parameter().spec();
    let region = if regional.part() == Part::Whole { FreeParameter::new(regional).region } else { regional.part().name().into() };
    ParameterRow {
        parameter: spec.name.into(),
        symbol: spec.symbol,
        unit: spec.unit.into(),
        region,
        initial: value,
        value,
        lower: spec.lower,
        upper: spec.upper,
        sd: None,
        interval_low: None,
        interval_high: None,
        at_bound: false,
        state: "fixed",
        prior_mean: None,
        prior_sd: None,
    }
}

/// The gains chosen from the images.
fn gain_rows(chosen: &ChosenGains, tracked: &Tracked, written: &Parameters) -> Vec<ParameterRow> {
    let at_bound = chosen.choice.at_edge;
    let row = |&gain: &Parameter| {
        let region = match gain {
            Parameter::ImageGainEndocardiumLv => "endocardium_lv",
            Parameter::ImageGainEndocardiumRv => "endocardium_rv",
            _ => "epicardium",
        };
        let (lower, upper) = (written[gain] * GAIN_FACTORS.lower, written[gain] * GAIN_FACTORS.upper);
        let value = tracked.parameters[gain];
        let state = match at_bound {
            true if value <= written[gain] => "lower",
            true => "upper",
            false => "free",
        };
        ParameterRow { region: region.into(), initial: written[gain], lower, upper, at_bound, state, ..held(gain.into(), value) }
    };
    chosen.gains.iter().map(row).collect()
}

/// The row as the figure shows it.
pub(super) fn interval(row: ParameterRow, recovery: Option<&Recovery>) -> ParameterInterval {
    let name = if row.region.starts_with("segment") { format!("{}.{}", row.parameter, row.region) } else { row.parameter };
    let truth = recovery.and_then(|recovery| recovery.parameters.iter().find(|one| one.parameter == name)).map(|one| one.truth);
    ParameterInterval {
        name,
        unit: row.unit,
        lower: row.lower,
        upper: row.upper,
        initial: row.initial,
        value: row.value,
        interval: row.interval_low.zip(row.interval_high),
        truth,
    }
}
