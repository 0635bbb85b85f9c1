//! Charts of curves and of points: axes with units, a legend above the frame, the phases of the beat behind it.

mod from_figures;

use std::fmt::Write;

use super::escape::escaped;
use super::number::{place, readable, ticks};
use crate::report::figures::{Curve, Look, TimeBand};
use crate::units::MS_PER_S;

/// A chart of curves.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// What the abscissa is, with its unit.
    pub x_title: String,
    /// What the ordinate is, with its unit.
    pub y_title: String,
    /// A second ordinate on the right: its title, and how many of its units one of the left is.
    pub right: Option<(String, f64)>,
    /// Curves.
    pub curves: Vec<Curve>,
    /// Parts of the abscissa with their names: from, to.
    pub bands: Vec<(String, f64, f64)>,
    /// Places with their names.
    pub points: Vec<(String, f64, f64)>,
    /// Whether the abscissa is time in ms, where the page shows the instant it is at.
    pub is_over_time: bool,
    /// Whether both axes are the decimal logarithms of what they show.
    pub is_logarithmic: [bool; 2],
}

/// Points of one sample each, an input against an output.
#[derive(Debug, Clone, PartialEq)]
pub struct Scatter {
    /// What the abscissa is, with its unit.
    pub x_title: String,
    /// What the ordinate is, with its unit.
    pub y_title: String,
    /// Points.
    pub points: Vec<(f64, f64)>,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 380.0;
const LEFT: f64 = 62.0;
const BOTTOM: f64 = 46.0;

fn in_ms(curves: &[Curve], scale: f64) -> Vec<Curve> {
    let scaled = |curve: &Curve| Curve { points: curve.points.iter().map(|&(x, y)| (x * MS_PER_S, y * scale)).collect(), ..curve.clone() };
    curves.iter().map(scaled).collect()
}

impl Plot {
    /// A quantity over time, s.
    pub fn over_time(title: impl Into<String>, quantity: impl Into<String>, curves: &[Curve]) -> Self {
        Self {
            title: title.into(),
            x_title: "time after the trigger (ms)".into(),
            y_title: quantity.into(),
            curves: in_ms(curves, 1.0),
            is_over_time: true,
            ..Self::default()
        }
    }

    /// With the phases of the beat behind the curves.
    #[must_use]
    pub fn with_phases(mut self, phases: &[TimeBand]) -> Self {
        self.bands = phases.iter().map(|band| (band.name.clone(), band.from_s * MS_PER_S, band.to_s * MS_PER_S)).collect();
        self
    }
}

/// The frame of a chart: ranges of the axes, and where they are drawn.
pub(super) struct Frame {
    x: (f64, f64),
    y: (f64, f64),
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Frame {
    fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let across = (x - self.x.0) / (self.x.1 - self.x.0);
        let up = (y - self.y.0) / (self.y.1 - self.y.0);
        (self.left + across * (self.right - self.left), self.bottom - up * (self.bottom - self.top))
    }
}

/// A range with a little room, never empty.
fn padded(values: impl Iterator<Item = f64>, room: f64) -> (f64, f64) {
    let (low, high) = values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let span = if high > low { high - low } else { high.abs().max(1.0) };
    (low - room * span, high + room * span)
}

impl Plot {
    /// Draws the chart.
    pub(super) fn html(&self) -> String {
        let curves: Vec<Curve> = self.curves.iter().map(|curve| self.on_axes(curve)).collect();
        let names = legend(&curves);
        let (rows, legend) = legend_svg(&names);
        let top = 14.0 + 20.0 * rows as f64;
        let right = if self.right.is_some() { WIDTH - 52.0 } else { WIDTH - 16.0 };
        let values = |pick: fn(&(f64, f64)) -> f64| curves.iter().flat_map(|curve| &curve.points).map(pick).collect::<Vec<f64>>();
        let x_room = if self.is_over_time { 0.0 } else { 0.06 };
        let frame = Frame {
            x: padded(values(|p| p.0).into_iter(), x_room),
            y: padded(values(|p| p.1).into_iter(), 0.07),
            left: LEFT,
            right,
            top: top + if self.bands.is_empty() { 0.0 } else { 18.0 },
            bottom: HEIGHT - BOTTOM,
        };
        let mut svg = open(&self.title, &self.spoken(), WIDTH, HEIGHT);
        svg.push_str(&legend);
        self.draw_bands(&mut svg, &frame);
        self.draw_axes(&mut svg, &frame);
        curves.iter().for_each(|curve| draw_curve(&mut svg, &frame, curve));
        self.draw_points(&mut svg, &frame, &curves);
        if self.is_over_time {
            let _ = write!(
                svg,
                "<line class=\"cursor\" x1=\"{0}\" x2=\"{0}\" y1=\"{1}\" y2=\"{2}\" data-left=\"{0}\" data-right=\"{3}\" data-from=\"{4}\" data-to=\"{5}\"/>",
                place(frame.left),
                place(frame.top),
                place(frame.bottom),
                place(frame.right),
                frame.x.0,
                frame.x.1
            );
        }
        svg.push_str("</svg>");
        figure(&self.title, &svg)
    }

    fn on_axes(&self, curve: &Curve) -> Curve {
        let map = |value: f64, is_logarithmic: bool| if is_logarithmic { value.log10() } else { value };
        let points = curve.points.iter().map(|&(x, y)| (map(x, self.is_logarithmic[0]), map(y, self.is_logarithmic[1]))).collect();
        Curve { points, ..curve.clone() }
    }

    /// The chart in a sentence, for whoever does not see it.
    fn spoken(&self) -> String {
        let of = |curve: &Curve| {
            let (low, high) = padded(curve.points.iter().map(|p| p.1), 0.0);
            format!("{}: {} to {}", curve.name, readable(low), readable(high))
        };
        let mut told: Vec<String> = Vec::new();
        for text in self.curves.iter().map(of) {
            if told.len() < 8 {
                told.push(text);
            }
        }
        format!("{} over {}. {}", self.y_title, self.x_title, told.join("; "))
    }

    fn draw_bands(&self, svg: &mut String, frame: &Frame) {
        for (name, from, to) in &self.bands {
            let (left, _) = frame.at((from.max(frame.x.0), frame.y.0));
            let (right, _) = frame.at((to.min(frame.x.1), frame.y.0));
            if right - left < 0.5 {
                continue;
            }
            let (width, height) = (right - left, frame.bottom - frame.top);
            let fill = match name.as_str() {
                "IVC" => "#fde2cd",
                "ejection" => "#fdf3de",
                "IVR" => "#ddecf8",
                _ => "#f4f8fb",
            };
            let _ = write!(
                svg,
                "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{fill}\"/>",
                place(left),
                place(frame.top),
                place(width),
                place(height)
            );
            let (x, y) = (place(0.5 * (left + right)), place(frame.top - 6.0));
            let _ = match width > 6.5 * name.chars().count() as f64 {
                true => write!(svg, "<text class=\"band\" x=\"{x}\" y=\"{y}\">{}</text>", escaped(name)),
                false => {
                    let y = place(frame.top + 6.0);
                    write!(
                        svg,
                        "<text class=\"band narrow\" x=\"{x}\" y=\"{y}\" transform=\"rotate(-90 {x} {y})\">{}</text>",
                        escaped(name)
                    )
                }
            };
        }
    }

    fn draw_axes(&self, svg: &mut String, frame: &Frame) {
        let (left, right, top, bottom) = (place(frame.left), place(frame.right), place(frame.top), place(frame.bottom));
        for (value, label) in labelled(frame.x, 8, self.is_logarithmic[0]) {
            let x = place(frame.at((value, frame.y.0)).0);
            let _ = write!(svg, "<path class=\"rule\" d=\"M{x} {top}V{bottom}\"/>");
            let _ = write!(svg, "<text class=\"tick\" x=\"{x}\" y=\"{}\">{label}</text>", place(frame.bottom + 16.0));
        }
        for (value, label) in labelled(frame.y, 6, self.is_logarithmic[1]) {
            let y = frame.at((frame.x.0, value)).1;
            let class = if value == 0.0 { "rule zero" } else { "rule" };
            let _ = write!(svg, "<path class=\"{class}\" d=\"M{left} {0}H{right}\"/>", place(y));
            let _ = write!(svg, "<text class=\"tick left\" x=\"{}\" y=\"{}\">{label}</text>", place(frame.left - 6.0), place(y + 4.0));
        }
        if let Some((title, factor)) = &self.right {
            for (value, label) in labelled((frame.y.0 * factor, frame.y.1 * factor), 6, false) {
                let y = place(frame.at((frame.x.0, value / factor)).1 + 4.0);
                let _ = write!(svg, "<text class=\"tick right\" x=\"{}\" y=\"{y}\">{label}</text>", place(frame.right + 6.0));
            }
            let (x, y) = (WIDTH - 8.0, 0.5 * (frame.top + frame.bottom));
            let _ = write!(
                svg,
                "<text class=\"axis\" x=\"{x}\" y=\"{0}\" transform=\"rotate(90 {x} {0})\">{1}</text>",
                place(y),
                escaped(title)
            );
        }
        let _ = write!(svg, "<path class=\"frame\" d=\"M{left} {top}V{bottom}H{right}\"/>");
        let (x, y) = (0.5 * (frame.left + frame.right), HEIGHT - 8.0);
        let _ = write!(svg, "<text class=\"axis\" x=\"{}\" y=\"{y}\">{}</text>", place(x), escaped(&self.x_title));
        let y = place(0.5 * (frame.top + frame.bottom));
        let _ = write!(svg, "<text class=\"axis\" x=\"14\" y=\"{y}\" transform=\"rotate(-90 14 {y})\">{}</text>", escaped(&self.y_title));
    }

    fn draw_points(&self, svg: &mut String, frame: &Frame, curves: &[Curve]) {
        let (low, high) = padded(curves.iter().flat_map(|curve| &curve.points).map(|p| p.0), 0.0);
        for (name, x, y) in &self.points {
            let (px, py) = frame.at((*x, *y));
            let is_left = *x > 0.5 * (low + high);
            let (text_x, class) = if is_left { (px - 9.0, "name end") } else { (px + 9.0, "name") };
            // Towards the middle, where a loop has room.
            let text_y = if *y > 0.5 * (frame.y.0 + frame.y.1) { py + 18.0 } else { py - 9.0 };
            let _ = write!(svg, "<circle class=\"named\" cx=\"{}\" cy=\"{}\" r=\"4\"/>", place(px), place(py));
            let _ = write!(svg, "<text class=\"{class}\" x=\"{}\" y=\"{}\">{}</text>", place(text_x), place(text_y), escaped(name));
        }
    }
}

impl Scatter {
    /// Draws the points.
    pub(super) fn html(&self) -> String {
        let curve = Curve { name: String::new(), look: Look::Measured, points: self.points.clone() };
        let plot = Plot { title: format!("{} against {}", self.y_title, self.x_title), ..Plot::default() };
        let plot = Plot { x_title: self.x_title.clone(), y_title: self.y_title.clone(), curves: vec![curve], ..plot };
        let frame = Frame {
            x: padded(self.points.iter().map(|p| p.0), 0.04),
            y: padded(self.points.iter().map(|p| p.1), 0.06),
            left: LEFT,
            right: WIDTH - 16.0,
            top: 12.0,
            bottom: HEIGHT - BOTTOM,
        };
        let mut svg = open(&plot.title, &format!("{} points", self.points.len()), WIDTH, HEIGHT);
        plot.draw_axes(&mut svg, &frame);
        for &point in &self.points {
            let (x, y) = frame.at(point);
            let _ = write!(svg, "<circle class=\"sample\" cx=\"{}\" cy=\"{}\" r=\"3\"/>", place(x), place(y));
        }
        svg.push_str("</svg>");
        format!("<figure class=\"scatter\">{svg}</figure>")
    }
}

/// Opens a drawing with its name and what it says in words.
pub(super) fn open(title: &str, spoken: &str, width: f64, height: f64) -> String {
    open_at(title, spoken, [0.0, 0.0, width, height])
}

/// The same with the corner of the drawing before its size.
pub(super) fn open_at(title: &str, spoken: &str, [left, top, width, height]: [f64; 4]) -> String {
    let label = escaped(&format!("{title}. {spoken}"));
    format!("<svg viewBox=\"{left} {top} {width} {height}\" role=\"img\" aria-label=\"{label}\">")
}

/// A drawing under its title.
pub(super) fn figure(title: &str, svg: &str) -> String {
    format!("<figure><figcaption>{}</figcaption>{svg}</figure>", escaped(title))
}

/// Ticks with their labels; of a logarithmic axis the whole decades, or more where there are few.
fn labelled(range: (f64, f64), count: usize, is_logarithmic: bool) -> Vec<(f64, String)> {
    if !is_logarithmic {
        return ticks(range, count).into_iter().map(|value| (value, readable(value))).collect();
    }
    let parts: &[f64] = if range.1 - range.0 < 2.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let decades = (range.0.floor() as i32)..=(range.1.ceil() as i32);
    let values = decades.flat_map(|decade| parts.iter().map(move |part| part * 10f64.powi(decade)));
    values.map(|value| (value.log10(), readable(value))).filter(|(place, _)| (range.0..=range.1).contains(place)).collect()
}

/// The names of the curves, each look once.
fn legend(curves: &[Curve]) -> Vec<(&str, Look)> {
    let mut names: Vec<(&str, Look)> = Vec::new();
    for curve in curves.iter().filter(|curve| !curve.name.is_empty()) {
        if !names.contains(&(curve.name.as_str(), curve.look)) {
            names.push((&curve.name, curve.look));
        }
    }
    names
}

/// The legend with its count of rows.
fn legend_svg(names: &[(&str, Look)]) -> (usize, String) {
    let (mut svg, mut x, mut row) = (String::new(), LEFT, 0);
    for &(name, look) in names {
        let width = 44.0 + 6.8 * name.chars().count() as f64;
        if x + width > WIDTH && x > LEFT {
            (x, row) = (LEFT, row + 1);
        }
        let y = 12.0 + 20.0 * row as f64;
        let sample = Curve { name: String::new(), look, points: vec![(x, y), (x + 26.0, y)] };
        let frame = Frame { x: (0.0, 1.0), y: (0.0, 1.0), left: 0.0, right: 1.0, top: 0.0, bottom: 1.0 };
        let sample = Curve { points: sample.points.iter().map(|&(x, y)| (x, 1.0 - y)).collect(), ..sample };
        draw_curve(&mut svg, &frame, &sample);
        let _ = write!(svg, "<text class=\"key\" x=\"{}\" y=\"{}\">{}</text>", place(x + 32.0), place(y + 4.0), escaped(name));
        x += width + 10.0;
    }
    (if names.is_empty() { 0 } else { row + 1 }, svg)
}

/// Colour, width of the line (none: points only), dashes, radius of the points.
fn style(look: Look) -> (&'static str, f64, &'static str, f64) {
    match look {
        Look::Measured => ("#191919", 0.0, "", 3.4),
        Look::Tracked => ("#0072b2", 1.6, "", 2.4),
        Look::Simulated => ("#d55e00", 2.6, "", 0.0),
        Look::Initial => ("#5f5f5f", 1.8, "6 4", 0.0),
        Look::Truth => ("#009e73", 1.8, "6 4", 0.0),
        Look::Artery => ("#0072b2", 1.8, "", 0.0),
        Look::Other => ("#b0578d", 1.8, "2 3", 0.0),
        Look::Septum => ("#d55e00", 1.3, "", 0.0),
        Look::Anterior => ("#009e73", 1.3, "7 3", 0.0),
        Look::Lateral => ("#0072b2", 1.3, "2 2", 0.0),
        Look::Inferior => ("#e69f00", 1.3, "9 3 2 3", 0.0),
    }
}

/// Runs of more points have no markers, which would hide the line.
const MOST_MARKERS: usize = 120;

fn draw_curve(svg: &mut String, frame: &Frame, curve: &Curve) {
    let (colour, width, dashes, radius) = style(curve.look);
    let finite = |&(x, y): &(f64, f64)| x.is_finite() && y.is_finite();
    if width > 0.0 {
        let mut path = String::new();
        for run in curve.points.split(|point| !finite(point)).filter(|run| run.len() > 1) {
            for (n, &point) in run.iter().enumerate() {
                let (x, y) = frame.at(point);
                let _ = write!(path, "{}{} {}", if n == 0 { "M" } else { "L" }, place(x), place(y));
            }
        }
        let _ =
            write!(svg, "<path class=\"curve\" d=\"{path}\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-dasharray=\"{dashes}\"/>");
    }
    if radius > 0.0 && (curve.points.len() <= MOST_MARKERS || width == 0.0) {
        for &point in curve.points.iter().filter(|point| finite(point)) {
            let (x, y) = frame.at(point);
            let _ = write!(svg, "<circle cx=\"{}\" cy=\"{}\" r=\"{radius}\" fill=\"{colour}\"/>", place(x), place(y));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_ends_where_it_is_not_a_number_and_its_name_is_escaped() {
        let curve = Curve::new("<model>", Look::Simulated, &[0.0, 0.1, 0.2, 0.3, 0.4], &[1.0, 2.0, f64::NAN, 2.0, 1.0]);
        let html = Plot::over_time("Volume", "mL", &[curve]).html();
        let curves: Vec<&str> = html.matches("class=\"curve\"").collect();
        assert_eq!(curves.len(), 2, "the legend's sample and the curve");
        let path = html.rsplit("class=\"curve\" d=\"").next().unwrap().split('"').next().unwrap();
        assert_eq!(path.matches('M').count(), 2);
        assert!(!html.contains("<model>") && html.contains("&lt;model&gt;") && !html.contains("NaN"));
    }

    #[test]
    fn without_points_a_chart_is_still_one() {
        assert!(!Plot::default().html().contains("NaN"));
    }
}
