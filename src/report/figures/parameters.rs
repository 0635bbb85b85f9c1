//! Parameters found, each on the scale of its own bounds, with interval, start value and, where known, truth.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::style::*;
use crate::report::ReportError;

/// A parameter that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterInterval {
    /// Name in words.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Smallest value allowed.
    pub lower: f64,
    /// Largest value allowed.
    pub upper: f64,
    /// Start value.
    pub initial: f64,
    /// Value found.
    pub value: f64,
    /// Interval.
    pub interval: Option<(f64, f64)>,
    /// True value.
    pub truth: Option<f64>,
}

const ROW: u32 = 112;
/// Length of every scale, and what stands right of it.
const SCALE: u32 = 610;
const RIGHT: u32 = 260;
/// Width of a letter, generously.
const LETTER: u32 = 15;

/// Draws one row a parameter.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn parameter_intervals(file: &Path, title: &str, rows: &[ParameterInterval]) -> Result<(), ReportError> {
    let height = 130 + ROW * rows.len().max(1) as u32;
    let letters = rows.iter().map(|row| row.name.chars().count() as u32).max().unwrap_or(0);
    let left = (LETTER * letters + 70).clamp(300, 1000);
    picture(file, "the parameters", (left + SCALE + RIGHT, height), |area| {
        write(area, title, &bold(TITLE, &BLACK_INK), HPos::Left, (ipx(28), ipx(36)))?;
        draw_key(area, rows.iter().any(|row| row.truth.is_some()), rows.iter().any(|row| row.interval.is_some()))?;
        for (number, row) in rows.iter().enumerate() {
            draw_row(area, row, left, ipx(130 + ROW * number as u32 + ROW / 2 - 12))?;
        }
        Ok(())
    })
}

/// The meaning of the marks, in one line.
fn draw_key(area: &Area, has_truth: bool, has_interval: bool) -> Drawn {
    let style = text(TEXT - 2, &BLACK_INK);
    let y = ipx(86);
    let mut x = ipx(40);
    let entries = [("found", true), ("95 % interval", has_interval), ("start value", true), ("truth", has_truth)];
    for (name, _) in entries.into_iter().filter(|&(_, is_shown)| is_shown) {
        match name {
            "found" => draw_found(area, x, y)?,
            "start value" => draw_initial(area, x, y)?,
            "truth" => draw_truth(area, x, y)?,
            _ => draw_interval(area, x - ipx(22), x + ipx(22), y)?,
        }
        let indent = if name == "95 % interval" { 34 } else { 20 };
        write(area, name, &style, HPos::Left, (x + ipx(indent), y))?;
        let (width, _) = area.estimate_text_size(name, &style)?;
        x += ipx(indent + 60) + width as i32;
    }
    Ok(())
}

fn draw_row(area: &Area, row: &ParameterInterval, left: u32, y: i32) -> Drawn {
    let span = if row.upper > row.lower { row.upper - row.lower } else { 1.0 };
    let place = |value: f64| {
        let part = ((value - row.lower) / span).clamp(0.0, 1.0);
        ipx(left) + (part * f64::from(px(SCALE))).round() as i32
    };
    write(area, &row.name, &text(TEXT, &BLACK_INK), HPos::Right, (ipx(left - 40), y))?;
    area.draw(&PathElement::new(vec![(place(row.lower), y), (place(row.upper), y)], RULE.stroke_width(px(3))))?;
    for bound in [row.lower, row.upper] {
        let x = place(bound);
        area.draw(&PathElement::new(vec![(x, y - ipx(10)), (x, y + ipx(10))], GREY_INK.stroke_width(px(2))))?;
        write(area, &short(bound), &text(TEXT - 5, &GREY_INK), HPos::Center, (x, y + ipx(30)))?;
    }
    if let Some((low, high)) = row.interval.filter(|(low, high)| low.is_finite() && high.is_finite()) {
        draw_interval(area, place(low), place(high), y)?;
    }
    draw_initial(area, place(row.initial), y)?;
    draw_found(area, place(row.value), y)?;
    if let Some(truth) = row.truth {
        draw_truth(area, place(truth), y)?;
    }
    let x = ipx(left + SCALE + 40);
    let value = format!("{} {}", short(row.value), if row.unit == "1" { "" } else { &row.unit });
    let style = text(TEXT, &BLACK_INK);
    match row.interval {
        Some((low, high)) => {
            write(area, value.trim_end(), &style, HPos::Left, (x, y - ipx(15)))?;
            let interval = format!("{} to {}", short(low), short(high));
            write(area, &interval, &text(TEXT - 4, &GREY_INK), HPos::Left, (x, y + ipx(17)))
        }
        None => write(area, value.trim_end(), &style, HPos::Left, (x, y)),
    }
}

fn draw_found(area: &Area, x: i32, y: i32) -> Drawn {
    Ok(area.draw(&Circle::new((x, y), px(10), VERMILION.filled()))?)
}

fn draw_interval(area: &Area, from: i32, to: i32, y: i32) -> Drawn {
    let band = RGBColor(242, 183, 138).filled();
    Ok(area.draw(&Rectangle::new([(from, y - ipx(7)), (to.max(from + 1), y + ipx(7))], band))?)
}

fn draw_initial(area: &Area, x: i32, y: i32) -> Drawn {
    let r = ipx(11);
    let diamond = [(x - r, y), (x, y - r), (x + r, y), (x, y + r), (x - r, y), (x, y - r)];
    Ok(area.draw(&PathElement::new(diamond, GREY_INK.stroke_width(px(2))))?)
}

fn draw_truth(area: &Area, x: i32, y: i32) -> Drawn {
    let ink = BLUISH_GREEN.stroke_width(px(4));
    Ok(area.draw(&PathElement::new(vec![(x, y - ipx(22)), (x, y + ipx(22))], ink))?)
}

/// Three or four significant digits.
fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = 3 - value.abs().log10().floor() as i32;
    let digits = digits.clamp(0, 8) as usize;
    let fixed = format!("{value:.digits$}");
    if fixed.contains('.') { fixed.trim_end_matches('0').trim_end_matches('.').to_string() } else { fixed }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!([90.0, 101.537, 0.301_24, 512.96, 3000.0, 0.0].map(short), ["90", "101.5", "0.3012", "513", "3000", "0"]);
    }
}
