//! Rows of bars: what ranks inputs, directions or parts of the wall, with an interval and a second measure where there is one.

use std::fmt::Write;

use super::escape::escaped;
use super::number::{place, readable, ticks};
use super::plot::{figure, open};
use crate::report::figures::Bar;

/// Bars, one below the other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Bars {
    /// What they show.
    pub title: String,
    /// The quantity, with its unit.
    pub quantity: String,
    /// What the second measure is, drawn as a diamond.
    pub beside: Option<String>,
    /// The bars, first on top.
    pub bars: Vec<Bar>,
}

const WIDTH: f64 = 640.0;
const ROW: f64 = 22.0;
const TOP: f64 = 8.0;
const FOOT: f64 = 42.0;

impl Bars {
    /// Draws the bars.
    pub(super) fn html(&self) -> String {
        let height = TOP + ROW * self.bars.len() as f64 + FOOT;
        let letters = self.bars.iter().map(|bar| bar.name.chars().count()).max().unwrap_or(0);
        let left = (14.0 + 7.4 * letters as f64).min(330.0);
        let right = WIDTH - 76.0;
        let ends = self.bars.iter().flat_map(|bar| {
            [Some(0.0), Some(bar.value), bar.beside, bar.interval.map(|i| i.0), bar.interval.map(|i| i.1)].into_iter().flatten()
        });
        let (low, high) = ends.filter(|end| end.is_finite()).fold((0.0f64, 0.0f64), |(low, high), end| (low.min(end), high.max(end)));
        let room = if low < 0.0 { 0.03 * (high - low) } else { 0.0 };
        let low = low - room;
        let span = if high > low { high - low } else { 1.0 };
        let at = |value: f64| left + (value - low) / span * (right - left);
        let spoken: Vec<String> = self.bars.iter().map(|bar| format!("{} {}", bar.name, readable(bar.value))).collect();
        let mut svg = open(&self.title, &format!("{}: {}", self.quantity, spoken.join("; ")), WIDTH, height);
        let bottom = TOP + ROW * self.bars.len() as f64;
        for tick in ticks((low, low + span), 6) {
            let x = place(at(tick));
            let _ = write!(svg, "<path class=\"rule\" d=\"M{x} {TOP}V{}\"/>", place(bottom));
            let _ = write!(svg, "<text class=\"tick\" x=\"{x}\" y=\"{}\">{}</text>", place(bottom + 15.0), readable(tick));
        }
        for (row, bar) in self.bars.iter().enumerate() {
            draw_bar(&mut svg, bar, TOP + ROW * (row as f64 + 0.5), left, right, &at);
        }
        let beside = self.beside.as_ref().map(|beside| format!("; ◆ {beside}")).unwrap_or_default();
        let words = escaped(&format!("{}{beside}", self.quantity));
        let _ =
            write!(svg, "<text class=\"axis\" x=\"{}\" y=\"{}\">{words}</text></svg>", place(0.5 * (left + right)), place(height - 8.0));
        figure(&self.title, &svg)
    }
}

fn draw_bar(svg: &mut String, bar: &Bar, middle: f64, left: f64, right: f64, at: &dyn Fn(f64) -> f64) {
    let name = shortened(&bar.name, 44);
    let _ = write!(svg, "<text class=\"tick left\" x=\"{}\" y=\"{}\">{}</text>", place(left - 6.0), place(middle + 4.0), escaped(&name));
    let (zero, end) = (at(0.0), at(if bar.value.is_finite() { bar.value } else { 0.0 }));
    let (x, width) = (zero.min(end), (end - zero).abs());
    let _ = write!(
        svg,
        "<rect class=\"bar\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"13\"/>",
        place(x),
        place(middle - 6.5),
        place(width.max(0.5))
    );
    if let Some((low, high)) = bar.interval {
        let (low, high, y) = (place(at(low)), place(at(high)), place(middle));
        let _ = write!(
            svg,
            "<path class=\"whisker\" d=\"M{low} {y}H{high}M{low} {0}V{1}M{high} {0}V{1}\"/>",
            place(middle - 4.0),
            place(middle + 4.0)
        );
    }
    if let Some(beside) = bar.beside {
        let (x, y) = (at(beside), middle);
        let _ = write!(svg, "<path class=\"diamond\" d=\"M{} {1}l5 -5l5 5l-5 5z\"/>", place(x - 5.0), place(y));
    }
    let _ =
        write!(svg, "<text class=\"tick right\" x=\"{}\" y=\"{}\">{}</text>", place(right + 8.0), place(middle + 4.0), readable(bar.value));
}

/// A name that fits.
pub(super) fn shortened(name: &str, letters: usize) -> String {
    if name.chars().count() <= letters { name.to_owned() } else { name.chars().take(letters - 1).chain(['…']).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_to_both_sides_start_at_zero() {
        let bar = |name: &str, value| Bar { name: name.into(), value, ..Bar::default() };
        let html = Bars { bars: vec![bar("a", 1.0), bar("b", -1.0)], ..Bars::default() }.html();
        let edges: Vec<(f64, f64)> = html
            .split("class=\"bar\" x=\"")
            .skip(1)
            .map(|rest| {
                let mut numbers = rest.split('"').step_by(2).filter_map(|text| text.parse::<f64>().ok());
                let x = numbers.next().unwrap();
                let _y = numbers.next();
                (x, numbers.next().unwrap())
            })
            .collect();
        assert!((edges[1].0 + edges[1].1 - edges[0].0).abs() < 0.2, "{edges:?}");
    }
}
