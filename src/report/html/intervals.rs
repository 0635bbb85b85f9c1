//! Parameters on the scale of their own bounds: value, interval, start and, where known, truth.

use std::fmt::Write;

use super::bars::shortened;
use super::escape::escaped;
use super::number::{place, readable};
use super::plot::{figure, open};
use crate::report::figures::ParameterInterval;

/// Parameters that were found.
#[derive(Debug, Clone, PartialEq)]
pub struct Intervals {
    /// What they are.
    pub title: String,
    /// One row each.
    pub rows: Vec<ParameterInterval>,
}

const WIDTH: f64 = 640.0;
const ROW: f64 = 52.0;
const TOP: f64 = 30.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 574.0;

impl Intervals {
    /// Draws the rows.
    pub(super) fn html(&self) -> String {
        let height = TOP + ROW * self.rows.len() as f64;
        let told = |row: &ParameterInterval| {
            let interval = row.interval.map(|(low, high)| format!(", 95 % between {} and {}", readable(low), readable(high)));
            format!("{} {} {}{}", row.name, readable(row.value), row.unit, interval.unwrap_or_default())
        };
        let spoken: Vec<String> = self.rows.iter().map(told).collect();
        let mut svg = open(&self.title, &spoken.join("; "), WIDTH, height);
        svg.push_str(&key(self.rows.iter().any(|row| row.truth.is_some())));
        for (number, row) in self.rows.iter().enumerate() {
            draw(&mut svg, row, TOP + ROW * number as f64);
        }
        svg.push_str("</svg>");
        figure(&self.title, &svg)
    }
}

fn key(has_truth: bool) -> String {
    let mut svg = String::from(
        "<circle class=\"found\" cx=\"72\" cy=\"12\" r=\"5\"/><text class=\"key\" x=\"84\" y=\"16\">found</text>\
         <path class=\"interval\" d=\"M136 12H170\"/><text class=\"key\" x=\"178\" y=\"16\">95 % interval</text>\
         <path class=\"start\" d=\"M282 5V19\"/><text class=\"key\" x=\"290\" y=\"16\">start</text>\
         <path class=\"rail\" d=\"M336 12H366\"/><text class=\"key\" x=\"374\" y=\"16\">bounds</text>",
    );
    if has_truth {
        svg.push_str("<path class=\"truth\" d=\"M440 12l6 -6l6 6l-6 6z\"/><text class=\"key\" x=\"458\" y=\"16\">truth</text>");
    }
    svg
}

fn draw(svg: &mut String, row: &ParameterInterval, top: f64) {
    let span = if row.upper > row.lower { row.upper - row.lower } else { 1.0 };
    let at = |value: f64| place(LEFT + ((value - row.lower) / span).clamp(0.0, 1.0) * (RIGHT - LEFT));
    let middle = top + 32.0;
    let y = place(middle);
    let name = escaped(&shortened(&row.name, 60));
    let interval = row.interval.map(|(low, high)| format!(" ({} to {})", readable(low), readable(high))).unwrap_or_default();
    let value = escaped(&format!("{} {}{interval}", readable(row.value), row.unit));
    let _ = write!(svg, "<text class=\"name\" x=\"{LEFT}\" y=\"{}\">{name}</text>", place(top + 16.0));
    let _ = write!(svg, "<text class=\"name end\" x=\"{RIGHT}\" y=\"{}\">{value}</text>", place(top + 16.0));
    let _ = write!(svg, "<path class=\"rail\" d=\"M{LEFT} {y}H{RIGHT}\"/>");
    let _ = write!(svg, "<text class=\"tick left\" x=\"{}\" y=\"{}\">{}</text>", LEFT - 6.0, place(middle + 4.0), readable(row.lower));
    let _ = write!(svg, "<text class=\"tick right\" x=\"{}\" y=\"{}\">{}</text>", RIGHT + 6.0, place(middle + 4.0), readable(row.upper));
    if let Some((low, high)) = row.interval {
        let _ = write!(svg, "<path class=\"interval\" d=\"M{} {y}H{}\"/>", at(low), at(high));
    }
    let _ = write!(svg, "<path class=\"start\" d=\"M{} {}v14\"/>", at(row.initial), place(middle - 7.0));
    if let Some(truth) = row.truth {
        let x = LEFT + ((truth - row.lower) / span).clamp(0.0, 1.0) * (RIGHT - LEFT);
        let _ = write!(svg, "<path class=\"truth\" d=\"M{} {y}l6 -6l6 6l-6 6z\"/>", place(x - 6.0));
    }
    let _ = write!(svg, "<circle class=\"found\" cx=\"{}\" cy=\"{y}\" r=\"5\"/>", at(row.value));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_on_its_bound_stands_at_the_end_of_its_rail() {
        let row = ParameterInterval {
            name: "speed".into(),
            unit: "mm/s".into(),
            lower: 100.0,
            upper: 300.0,
            initial: 200.0,
            value: 300.0,
            interval: Some((250.0, 400.0)),
            truth: None,
        };
        let html = Intervals { title: "found".into(), rows: vec![row] }.html();
        assert!(html.contains("class=\"found\" cx=\"574\"") && html.contains("M447 62H574"), "{html}");
    }
}
