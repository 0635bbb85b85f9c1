//! Curves in a frame with axes, units and a legend that stands above the frame, where it covers nothing.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::style::*;

/// What a curve is, which decides how it looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Measured points: circles.
    Measured,
    /// Motion that follows the images: a line with dots.
    Tracked,
    /// The model: a line.
    Simulated,
    /// The model before it was personalised: a dashed line.
    Initial,
    /// The known truth: a dashed line.
    Truth,
    /// The artery behind the ventricle: a line.
    Artery,
    /// A further line.
    Other,
    /// The septum: a thin line.
    Septum,
    /// The anterior wall: a thin line.
    Anterior,
    /// The lateral wall: a thin line.
    Lateral,
    /// The inferior wall: a thin line.
    Inferior,
}

/// A curve with its name in the legend.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Name.
    pub name: String,
    /// Look.
    pub look: Look,
    /// Points, abscissa ascending for curves in time.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// A curve of two arrays of one length; what is longer is cut.
    pub fn new(name: impl Into<String>, look: Look, abscissa: &[f64], ordinate: &[f64]) -> Self {
        Self { name: name.into(), look, points: abscissa.iter().copied().zip(ordinate.iter().copied()).collect() }
    }

    /// Its runs of finite points; a gap ends a line.
    fn runs(&self) -> impl Iterator<Item = &[(f64, f64)]> {
        self.points.split(|(x, y)| !(x.is_finite() && y.is_finite())).filter(|run| !run.is_empty())
    }
}

impl Look {
    pub(super) fn colour(self) -> RGBColor {
        match self {
            Self::Measured => BLACK_INK,
            Self::Tracked => BLUE_INK,
            Self::Simulated => VERMILION,
            Self::Initial => GREY_INK,
            Self::Truth => BLUISH_GREEN,
            Self::Artery => BLUE_INK,
            Self::Other => REDDISH_PURPLE,
            Self::Septum => VERMILION,
            Self::Anterior => BLUISH_GREEN,
            Self::Lateral => BLUE_INK,
            Self::Inferior => ORANGE,
        }
    }

    fn line_width(self) -> Option<u32> {
        match self {
            Self::Measured => None,
            Self::Simulated => Some(4),
            Self::Septum | Self::Anterior | Self::Lateral | Self::Inferior => Some(2),
            _ => Some(3),
        }
    }

    fn is_dashed(self) -> bool {
        matches!(self, Self::Initial | Self::Truth)
    }

    fn marker_radius(self) -> Option<u32> {
        match self {
            Self::Measured => Some(7),
            Self::Tracked => Some(5),
            _ => None,
        }
    }
}

/// Axis titles and ranges of a chart.
pub(super) struct Axes<'a> {
    pub(super) x_title: &'a str,
    pub(super) y_title: &'a str,
    pub(super) x: (f64, f64),
    pub(super) y: (f64, f64),
}

/// Runs of more points have no markers, which would hide the line.
const MOST_MARKERS: usize = 100;

/// A chart in pixels drawn, as plotters has it.
pub(super) type Chart<'a, 'b> = ChartContext<'a, BitMapBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Writes the title and the legend on top and returns the area below them.
pub(super) fn headed<'b>(area: &Area<'b>, title: &str, legend: &[(&str, Look)]) -> Result<Area<'b>, DrawError> {
    let (width, _) = area.dim_in_pixel();
    let left = ipx(28);
    let mut y = ipx(36);
    write(area, title, &bold(TITLE, &BLACK_INK), HPos::Left, (left, y))?;
    if !legend.is_empty() {
        y += ipx(46);
    }
    let style = text(TEXT, &BLACK_INK);
    let mut x = left;
    for &(name, look) in legend {
        let (text_width, _) = area.estimate_text_size(name, &style)?;
        let entry = ipx(64 + 12) + text_width as i32;
        if x + entry > width as i32 - ipx(20) && x > left {
            x = left;
            y += ipx(38);
        }
        draw_sample(area, look, x, y)?;
        write(area, name, &style, HPos::Left, (x + ipx(64 + 12), y))?;
        x += entry + ipx(36);
    }
    let (_, below) = area.split_vertically(y + ipx(26));
    Ok(below)
}

/// A short piece of a curve for the legend.
fn draw_sample(area: &Area, look: Look, x: i32, y: i32) -> Drawn {
    let colour = look.colour();
    if let Some(width) = look.line_width() {
        let style = colour.stroke_width(px(width));
        let pieces: &[(u32, u32)] = if look.is_dashed() { &[(0, 17), (26, 43), (52, 64)] } else { &[(0, 64)] };
        for &(from, to) in pieces {
            area.draw(&PathElement::new(vec![(x + ipx(from), y), (x + ipx(to), y)], style))?;
        }
    }
    if let Some(radius) = look.marker_radius() {
        draw_marker(area, look, (x + ipx(32), y), radius)?;
    }
    Ok(())
}

fn draw_marker(area: &Area, look: Look, place: (i32, i32), radius: u32) -> Drawn {
    if look == Look::Measured {
        area.draw(&Circle::new(place, px(radius), WHITE.filled()))?;
        area.draw(&Circle::new(place, px(radius), look.colour().stroke_width(px(2))))?;
    } else {
        area.draw(&Circle::new(place, px(radius), look.colour().filled()))?;
    }
    Ok(())
}

/// The margins of a plot within the area below its head, in pixels shown.
pub(super) struct Margins {
    pub(super) left: u32,
    pub(super) right: u32,
    pub(super) top: u32,
    pub(super) bottom: u32,
}

impl Default for Margins {
    fn default() -> Self {
        Self { left: 118, right: 40, top: 12, bottom: 92 }
    }
}

/// A plot of these ranges, with nothing drawn yet.
pub(super) fn plot<'a, 'b>(area: &'a Area<'b>, axes: &Axes, margins: &Margins) -> Result<Chart<'a, 'b>, DrawError> {
    let Margins { left, right, top, bottom } = *margins;
    let mut builder = ChartBuilder::on(area);
    builder.margin_left(px(left)).margin_right(px(right)).margin_top(px(top)).margin_bottom(px(bottom));
    Ok(builder.build_cartesian_2d(axes.x.0..axes.x.1, axes.y.0..axes.y.1)?)
}

/// Draws rules, ticks, frame and axis titles around a plot.
pub(super) fn decorate(whole: &Area, chart: &Chart, axes: &Axes, x_ticks: &[Tick], y_ticks: &[Tick]) -> Drawn {
    let (columns, rows) = chart.plotting_area().get_pixel_range();
    let (frame, number) = (GREY_INK.stroke_width(px(2)), text(TEXT, &BLACK_INK));
    for tick in x_ticks.iter().filter(|tick| (axes.x.0..=axes.x.1).contains(&tick.at)) {
        let x = chart.backend_coord(&(tick.at, axes.y.0)).0;
        whole.draw(&PathElement::new(vec![(x, rows.start), (x, rows.end)], tick.rule()))?;
        if !tick.label.is_empty() {
            whole.draw(&PathElement::new(vec![(x, rows.end), (x, rows.end + ipx(8))], frame))?;
            write(whole, &tick.label, &number, HPos::Center, (x, rows.end + ipx(26)))?;
        }
    }
    for tick in y_ticks.iter().filter(|tick| (axes.y.0..=axes.y.1).contains(&tick.at)) {
        let y = chart.backend_coord(&(axes.x.0, tick.at)).1;
        whole.draw(&PathElement::new(vec![(columns.start, y), (columns.end, y)], tick.rule()))?;
        if !tick.label.is_empty() {
            whole.draw(&PathElement::new(vec![(columns.start - ipx(8), y), (columns.start, y)], frame))?;
            write(whole, &tick.label, &number, HPos::Right, (columns.start - ipx(14), y))?;
        }
    }
    let corner = (columns.start, rows.end);
    whole.draw(&PathElement::new(vec![(columns.start, rows.start), corner, (columns.end, rows.end)], frame))?;
    let title = text(TEXT + 2, &BLACK_INK);
    write(whole, axes.x_title, &title, HPos::Center, ((columns.start + columns.end) / 2, rows.end + ipx(70)))?;
    write_upward(whole, axes.y_title, &title, HPos::Center, (columns.start - ipx(92), (rows.start + rows.end) / 2))
}

/// A tick and its rule across the plot.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub(super) at: f64,
    /// What is written; nothing for a rule between ticks.
    pub(super) label: String,
    pub(super) is_faint: bool,
}

impl Tick {
    fn rule(&self) -> ShapeStyle {
        if self.is_faint { RGBColor(238, 238, 238).stroke_width(px(1)) } else { RULE.stroke_width(px(1)) }
    }
}

/// About `parts` ticks at round numbers.
pub(super) fn ticks((low, high): (f64, f64), parts: u32) -> Vec<Tick> {
    let step = nice_step(high - low, parts);
    let (first, last) = ((low / step).ceil(), (high / step).floor());
    if !(first.is_finite() && last.is_finite() && last - first < 100.0) {
        return Vec::new();
    }
    let at = |n: i32| (first + f64::from(n)) * step;
    (0..=(last - first).max(-1.0) as i32).map(|n| Tick { at: at(n), label: tick(at(n)), is_faint: false }).collect()
}

/// 1, 2 or 5 times a power of ten that cuts `span` into about `parts`.
fn nice_step(span: f64, parts: u32) -> f64 {
    let raw = (span / f64::from(parts)).max(f64::MIN_POSITIVE);
    let power = 10f64.powf(raw.log10().floor());
    let digit = [1.0, 2.0, 5.0, 10.0].into_iter().find(|digit| digit * power >= raw * 0.999).unwrap_or(10.0);
    digit * power
}

/// A tick's number without noise digits.
pub(super) fn tick(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    let rounded = if rounded == 0.0 { 0.0 } else { rounded };
    let text = if rounded != 0.0 && !(1e-3..1e5).contains(&rounded.abs()) { format!("{rounded:e}") } else { format!("{rounded}") };
    text.replace('-', "−")
}

/// Draws curves in their looks.
pub(super) fn draw_curves(chart: &mut Chart, curves: &[Curve]) -> Drawn {
    for curve in curves {
        let (look, colour) = (curve.look, curve.look.colour());
        for run in curve.runs() {
            if let Some(width) = look.line_width() {
                let style = colour.stroke_width(px(width));
                let points = run.iter().copied();
                if look.is_dashed() {
                    chart.draw_series(DashedLineSeries::new(points, px(16), px(10), style))?;
                } else {
                    chart.draw_series(LineSeries::new(points, style))?;
                }
            }
            if let Some(radius) = look.marker_radius().filter(|_| run.len() <= MOST_MARKERS) {
                for point in run {
                    let place = chart.backend_coord(point);
                    draw_marker(&chart.plotting_area().strip_coord_spec(), look, local(chart, place), radius)?;
                }
            }
        }
    }
    Ok(())
}

/// A place of the whole picture in pixels of the chart's own area.
fn local(chart: &Chart, (x, y): (i32, i32)) -> (i32, i32) {
    let (columns, rows) = chart.plotting_area().get_pixel_range();
    (x - columns.start, y - rows.start)
}

/// The legend of curves.
pub(super) fn legend_of(curves: &[Curve]) -> Vec<(&str, Look)> {
    curves.iter().filter(|curve| !curve.points.is_empty()).map(|curve| (curve.name.as_str(), curve.look)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_ends_a_line() {
        let curve = Curve::new("a", Look::Tracked, &[0.0, 1.0, 2.0, 3.0], &[1.0, f64::NAN, 2.0, 3.0]);
        assert_eq!(curve.runs().map(<[_]>::len).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn ticks_stand_at_ones_twos_and_fives() {
        assert_eq!(nice_step(120.0, 6), 20.0);
        assert_eq!(nice_step(121.0, 6), 50.0);
        assert!((nice_step(0.5, 6) - 0.1).abs() < 1e-12);
        assert_eq!(ticks((-0.1, 1.05), 5).iter().map(|t| t.label.as_str()).collect::<Vec<_>>(), ["0", "0.5", "1"]);
        assert!(ticks((f64::NAN, 1.0), 5).is_empty());
    }

    #[test]
    fn ticks_carry_no_noise() {
        assert_eq!(tick(0.1 + 0.2), "0.3");
        assert_eq!(tick(-0.0), "0");
        assert_eq!(tick(-20.0), "−20");
        assert_eq!(tick(250.0), "250");
    }
}
