//! Curves in a frame with axes, units and a legend that stands above the frame, where it covers nothing.

use plotters::coord::Shift;
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
    /// A further curve.
    Other,
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
            Self::Other => REDDISH_PURPLE,
        }
    }

    fn line_width(self) -> Option<u32> {
        match self {
            Self::Measured => None,
            Self::Simulated => Some(4),
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

/// A chart in pixels drawn, as plotters has it.
pub(super) type Chart<'a, 'b> =
    ChartContext<'a, BitMapBackend<'b>, Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>>;

/// Writes the title and the legend on top and returns the area below them.
pub(super) fn headed<'b>(
    area: &DrawingArea<BitMapBackend<'b>, Shift>,
    title: &str,
    legend: &[(&str, Look)],
) -> Result<DrawingArea<BitMapBackend<'b>, Shift>, Box<dyn std::error::Error + Send + Sync>> {
    let (width, _) = area.dim_in_pixel();
    let left = ipx(28);
    let mut y = ipx(36);
    area.draw_text(title, &anchored(bold(TITLE, &BLACK_INK), HPos::Left), (left, y))?;
    if !legend.is_empty() {
        y += ipx(46);
    }
    let style = anchored(text(TEXT, &BLACK_INK), HPos::Left);
    let mut x = left;
    for &(name, look) in legend {
        let (text_width, _) = area.estimate_text_size(name, &style)?;
        let entry = ipx(64 + 12) + text_width as i32;
        if x + entry > width as i32 - ipx(20) && x > left {
            x = left;
            y += ipx(38);
        }
        draw_sample(area, look, x, y)?;
        area.draw_text(name, &style, (x + ipx(64 + 12), y))?;
        x += entry + ipx(36);
    }
    let (_, below) = area.split_vertically(y + ipx(26));
    Ok(below)
}

/// A short piece of a curve for the legend.
fn draw_sample(area: &DrawingArea<BitMapBackend<'_>, Shift>, look: Look, x: i32, y: i32) -> Drawn {
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

fn draw_marker(area: &DrawingArea<BitMapBackend<'_>, Shift>, look: Look, place: (i32, i32), radius: u32) -> Drawn {
    if look == Look::Measured {
        area.draw(&Circle::new(place, px(radius), WHITE.filled()))?;
        area.draw(&Circle::new(place, px(radius), look.colour().stroke_width(px(2))))?;
    } else {
        area.draw(&Circle::new(place, px(radius), look.colour().filled()))?;
    }
    Ok(())
}

/// Draws frame, rules, ticks and axis titles.
pub(super) fn framed<'a, 'b>(
    area: &'a DrawingArea<BitMapBackend<'b>, Shift>,
    axes: &Axes,
    right_margin: u32,
) -> Result<Chart<'a, 'b>, Box<dyn std::error::Error + Send + Sync>> {
    let mut chart = ChartBuilder::on(area)
        .margin_left(px(14))
        .margin_right(px(right_margin))
        .margin_bottom(px(12))
        .margin_top(px(10))
        .x_label_area_size(px(74))
        .y_label_area_size(px(100))
        .build_cartesian_2d(axes.x.0..axes.x.1, axes.y.0..axes.y.1)?;
    chart
        .configure_mesh()
        .max_light_lines(0)
        .x_labels(9)
        .y_labels(8)
        .bold_line_style(RULE.stroke_width(px(1)))
        .axis_style(GREY_INK.stroke_width(px(2)))
        .label_style(text(TEXT, &BLACK_INK))
        .axis_desc_style(text(TEXT + 2, &BLACK_INK))
        .x_desc(axes.x_title)
        .y_desc(axes.y_title)
        .x_label_formatter(&|x| tick(*x))
        .y_label_formatter(&|y| tick(*y))
        .draw()?;
    Ok(chart)
}

/// A tick's number without noise digits.
pub(super) fn tick(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    let rounded = if rounded == 0.0 { 0.0 } else { rounded };
    if rounded != 0.0 && (rounded.abs() >= 1e5 || rounded.abs() < 1e-3) { format!("{rounded:e}") } else { format!("{rounded}") }
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
            if let Some(radius) = look.marker_radius() {
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
    fn ticks_carry_no_noise() {
        assert_eq!(tick(0.1 + 0.2), "0.3");
        assert_eq!(tick(-0.0), "0");
        assert_eq!(tick(250.0), "250");
    }
}
