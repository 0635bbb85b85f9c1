//! Bull's-eye plots of the 17 segments of the American Heart Association, \[Cerqueira2002\]: base outside, apex in the middle, anterior on top,
//! septum on the left.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt::Write;

use super::colour::{Scale, hex, ink_on};
use super::escape::escaped;
use super::number::{place, readable};
use super::plot::open_at;

/// One quantity by segment.
#[derive(Debug, Clone, PartialEq)]
pub struct BullsEye {
    /// What it shows.
    pub title: String,
    /// Unit.
    pub unit: String,
    /// Values of the segments 1 to 17; what the heart does not have is none.
    pub values: [Option<f64>; 17],
    /// Colours.
    pub scale: Scale,
}

const CENTRE: (f64, f64) = (150.0, 150.0);
/// Radii of the rings from the middle outward: segment 17, 13–16, 7–12, 1–6.
const RADII: [f64; 5] = [0.0, 36.0, 72.0, 108.0, 144.0];

/// Inner and outer radius of a segment, and the angles it lies between, from the right anticlockwise.
fn extent(segment: usize) -> (f64, f64, f64, f64) {
    let ring = |ring: usize, place: usize, count: usize| {
        let width = TAU / count as f64;
        // The first segment of a ring lies around the top; the next ones follow anticlockwise.
        let from = FRAC_PI_2 - 0.5 * width + place as f64 * width;
        (RADII[ring], RADII[ring + 1], from, from + width)
    };
    match segment {
        1..=6 => ring(3, segment - 1, 6),
        7..=12 => ring(2, segment - 7, 6),
        13..=16 => ring(1, segment - 13, 4),
        _ => (0.0, RADII[1], 0.0, TAU),
    }
}

impl BullsEye {
    /// Draws the plot.
    pub(super) fn html(&self) -> String {
        // The apical cap is small, and its strains are those of a point: it would wash out all others.
        let wall = self.values[..16].iter().flatten().copied();
        let range =
            if wall.clone().next().is_some() { self.scale.range(wall) } else { self.scale.range(self.values.into_iter().flatten()) };
        let told: Vec<String> =
            (1..).zip(&self.values).filter_map(|(n, value)| Some(format!("segment {n}: {}", readable((*value)?)))).collect();
        let spoken = format!("By segment of the American Heart Association, in {}. {}", self.unit, told.join("; "));
        let mut svg = open_at(&self.title, &spoken, [-14.0, -14.0, 328.0, 364.0]);
        for (place_of, value) in self.values.iter().enumerate() {
            self.draw_segment(&mut svg, place_of + 1, *value, range);
        }
        for (name, x, y) in [("anterior", 150.0, 1.0), ("inferior", 150.0, 308.0)] {
            let _ = write!(svg, "<text class=\"wall\" x=\"{x}\" y=\"{y}\">{name}</text>");
        }
        for (name, x, angle) in [("septal", 0.0, -90), ("lateral", 300.0, 90)] {
            let _ = write!(svg, "<text class=\"wall\" x=\"{x}\" y=\"150\" transform=\"rotate({angle} {x} 150)\">{name}</text>");
        }
        self.draw_scale(&mut svg, range);
        svg.push_str("</svg>");
        let unit = if self.unit.is_empty() { String::new() } else { format!(" ({})", self.unit) };
        format!("<figure class=\"eye\"><figcaption>{}</figcaption>{svg}</figure>", escaped(&format!("{}{unit}", self.title)))
    }

    fn draw_segment(&self, svg: &mut String, segment: usize, value: Option<f64>, range: (f64, f64)) {
        let (inner, outer, from, to) = extent(segment);
        let colour = value.map(|value| self.scale.colour(value, range));
        let fill = colour.map_or("#e4e4e4".to_owned(), hex);
        let at = |radius: f64, angle: f64| (CENTRE.0 + radius * angle.cos(), CENTRE.1 - radius * angle.sin());
        if inner == 0.0 {
            let _ = write!(svg, "<circle class=\"segment\" cx=\"150\" cy=\"150\" r=\"{outer}\" fill=\"{fill}\"/>");
        } else {
            let point = |radius, angle| {
                let (x, y) = at(radius, angle);
                format!("{} {}", place(x), place(y))
            };
            let (a, b, c, d) = (point(outer, from), point(outer, to), point(inner, to), point(inner, from));
            let _ = write!(
                svg,
                "<path class=\"segment\" d=\"M{a}A{outer} {outer} 0 0 0 {b}L{c}A{inner} {inner} 0 0 1 {d}Z\" fill=\"{fill}\"/>"
            );
        }
        let (x, y) = if inner == 0.0 { CENTRE } else { at(0.5 * (inner + outer), 0.5 * (from + to)) };
        let text = value.map_or("–".to_owned(), three_digits);
        let ink = colour.map_or("#555", ink_on);
        let _ = write!(svg, "<text class=\"cell\" x=\"{}\" y=\"{}\" fill=\"{ink}\">{text}</text>", place(x), place(y + 4.0));
    }

    fn draw_scale(&self, svg: &mut String, range: (f64, f64)) {
        for (n, &colour) in self.scale.colours().iter().enumerate() {
            let _ = write!(svg, "<rect x=\"{}\" y=\"318\" width=\"21\" height=\"10\" fill=\"{}\"/>", 60 + 20 * n, hex(colour));
        }
        for (x, value) in [(60.0, range.0), (150.0, 0.5 * (range.0 + range.1)), (241.0, range.1)] {
            let _ = write!(svg, "<text class=\"tick\" x=\"{x}\" y=\"344\">{}</text>", three_digits(value));
        }
    }
}

/// Three significant digits, which a segment has room for.
fn three_digits(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (2 - value.abs().log10().floor() as i32).clamp(0, 3) as usize;
    format!("{value:.decimals$}").replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Anterior segments on top, septal ones on the left, inferior below: as every clinician expects them.
    #[test]
    fn segments_lie_where_clinicians_look_for_them() {
        let middle = |segment| {
            let (inner, outer, from, to) = extent(segment);
            let (radius, angle) = (0.5 * (inner + outer), 0.5 * (from + to));
            (radius * angle.cos(), radius * angle.sin())
        };
        assert!([1, 7, 13].iter().all(|&anterior| middle(anterior).1 > 40.0));
        assert!([2, 3, 8, 9, 14].iter().all(|&septal| middle(septal).0 < -30.0));
        assert!([4, 10, 15].iter().all(|&inferior| middle(inferior).1 < -40.0));
        assert!([5, 6, 11, 12, 16].iter().all(|&lateral| middle(lateral).0 > 30.0));
        assert!(middle(2).1 > 0.0 && middle(3).1 < 0.0, "the anteroseptal segment lies above the inferoseptal one");
    }

    #[test]
    fn what_a_heart_does_not_have_is_grey() {
        let mut values = [Some(1.5); 17];
        values[16] = None;
        let html = BullsEye { title: "a".into(), unit: "mm".into(), values, scale: Scale::Sequential }.html();
        assert_eq!(html.matches("class=\"segment\"").count(), 17);
        assert!(html.contains("fill=\"#e4e4e4\"") && html.contains(">–<"));
    }
}
