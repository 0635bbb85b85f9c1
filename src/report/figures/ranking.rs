//! Inputs in the order of what they do to one output: a bar each, with its interval and a second measure beside it.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::style::*;
use crate::report::ReportError;

/// A bar of a ranking.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Bar {
    /// Its name.
    pub name: String,
    /// Its length.
    pub value: f64,
    /// Interval of that.
    pub interval: Option<(f64, f64)>,
    /// A second measure, drawn as a diamond.
    pub beside: Option<f64>,
}

const ROW: u32 = 46;
const HEAD: u32 = 110;
const FOOT: u32 = 90;
/// Length of the scale, and what stands right of it.
const SCALE: u32 = 760;
const RIGHT: u32 = 60;
/// Width of a letter, generously.
const LETTER: u32 = 14;

/// Draws one bar an input, in the order given.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn ranking(file: &Path, title: &str, quantity: &str, beside: Option<&str>, inputs: &[Bar]) -> Result<(), ReportError> {
    let letters = inputs.iter().map(|input| input.name.chars().count() as u32).max().unwrap_or(0);
    let left = LETTER * letters + 60;
    let bottom = HEAD + ROW * inputs.len().max(1) as u32;
    let ends = |input: &Bar| {
        let (low, high) = input.interval.unwrap_or((input.value, input.value));
        [0.0, input.value, low, high, input.beside.unwrap_or(0.0)]
    };
    let (low, high) = padded(inputs.iter().flat_map(ends), 0.02, 0.04);
    let place = |value: f64| ipx(left) + ((value.clamp(low, high) - low) / (high - low) * f64::from(px(SCALE))).round() as i32;
    picture(file, "the ranking", (left + SCALE + RIGHT, bottom + FOOT), |area| {
        write(area, title, &bold(TITLE, &BLACK_INK), HPos::Left, (ipx(28), ipx(36)))?;
        if let Some(words) = beside {
            draw_diamond(area, ipx(left + 12), ipx(78))?;
            write(area, words, &text(TEXT - 4, &GREY_INK), HPos::Left, (ipx(left + 34), ipx(78)))?;
        }
        for tick in ticks(low, high) {
            let x = place(tick);
            area.draw(&PathElement::new(vec![(x, ipx(HEAD - 8)), (x, ipx(bottom))], RULE.stroke_width(px(2))))?;
            write(area, &format!("{tick}"), &text(TEXT - 4, &GREY_INK), HPos::Center, (x, ipx(bottom + 22)))?;
        }
        write(area, quantity, &text(TEXT - 2, &BLACK_INK), HPos::Center, (ipx(left + SCALE / 2), ipx(bottom + 60)))?;
        for (number, input) in inputs.iter().enumerate() {
            let y = ipx(HEAD + ROW * number as u32 + ROW / 2);
            write(area, &input.name, &text(TEXT - 2, &BLACK_INK), HPos::Right, (ipx(left - 20), y))?;
            let (zero, end) = (place(0.0), place(input.value));
            area.draw(&Rectangle::new([(zero.min(end), y - ipx(11)), (zero.max(end), y + ipx(11))], SKY_BLUE.filled()))?;
            if let Some((from, to)) = input.interval {
                let (from, to) = (place(from), place(to));
                area.draw(&PathElement::new(vec![(from, y), (to, y)], BLACK_INK.stroke_width(px(2))))?;
                for x in [from, to] {
                    area.draw(&PathElement::new(vec![(x, y - ipx(6)), (x, y + ipx(6))], BLACK_INK.stroke_width(px(2))))?;
                }
            }
            if let Some(value) = input.beside {
                draw_diamond(area, place(value), y)?;
            }
        }
        Ok(())
    })
}

fn draw_diamond(area: &Area, x: i32, y: i32) -> Drawn {
    let r = ipx(8);
    Ok(area.draw(&Polygon::new(vec![(x - r, y), (x, y - r), (x + r, y), (x, y + r)], VERMILION.filled()))?)
}

/// Round numbers, four to nine of them.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let magnitude = 10.0_f64.powf(((high - low) / 4.0).log10().floor());
    let step = [5.0, 2.0, 1.0].into_iter().map(|factor| factor * magnitude).find(|step| (high - low) / step >= 4.0).unwrap_or(magnitude);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    // Dividing by a power of ten keeps 0.3 from being 0.30000000000000004.
    let scale = (-step.log10().floor()).max(0.0);
    let rounded = |value: f64| (value * 10.0_f64.powf(scale)).round() / 10.0_f64.powf(scale);
    (first..=last).map(|number| rounded(number as f64 * step)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(ticks(-0.02, 1.04), [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]);
        assert_eq!(ticks(0.0, 42.0), [0.0, 10.0, 20.0, 30.0, 40.0]);
        for exponent in -6..6 {
            let count = ticks(0.0, 3.7 * 10.0_f64.powi(exponent)).len();
            assert!((4..=10).contains(&count), "{count}");
        }
    }
}
