//! `[comparison]`: the time steps and gains at which force schemes are compared, \[Billet2009\] §6.1.

use crate::study::reader::TableReader;

/// Which cases are run, beside the case of `mechanics.step_s` and the gains as written.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparisonPlan {
    /// `steps_s`: time steps.
    pub steps_s: Vec<f64>,
    /// `gain_factors`: factors on the gains of `[tracking]`.
    pub gain_factors: Vec<f64>,
}

pub(super) fn read(table: TableReader) -> Option<ComparisonPlan> {
    let list = |key, (lower, upper): (f64, f64)| {
        let values = table.numbers(key).unwrap_or_default();
        if values.iter().any(|value| !(lower..=upper).contains(value)) {
            table.problem(key, "is out of range", format!("choose values from {lower} to {upper}"));
        }
        values
    };
    let plan = table
        .is_written()
        .then(|| ComparisonPlan { steps_s: list("steps_s", (1e-5, 0.05)), gain_factors: list("gain_factors", (1e-3, 1e3)) });
    table.close();
    plan
}
