//! Curves in time and over iterations: volumes, pressures with the phases of the beat, cost.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::chart::{Axes, Curve, Look, draw_curves, framed, headed, legend_of};
use super::style::*;
use crate::report::ReportError;
use crate::units::{KPA_PER_MMHG, MS_PER_S};

/// Volumes of one ventricle over the beat.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeCurves {
    /// Title.
    pub title: String,
    /// Name of the volume, such as `LV volume`.
    pub quantity: String,
    /// Curves in s and mL.
    pub curves: Vec<Curve>,
}

/// A part of the beat.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeBand {
    /// Name, such as `ejection`.
    pub name: String,
    /// Start.
    pub from_s: f64,
    /// End.
    pub to_s: f64,
}

/// Pressures over the beat.
#[derive(Debug, Clone, PartialEq)]
pub struct PressureCurves {
    /// Title.
    pub title: String,
    /// Curves in s and kPa.
    pub curves: Vec<Curve>,
    /// Phases, in order of time.
    pub phases: Vec<TimeBand>,
}

/// The cost of each iteration.
#[derive(Debug, Clone, PartialEq)]
pub struct CostHistory {
    /// Title.
    pub title: String,
    /// Cost an iteration, from the start value on.
    pub cost: Vec<f64>,
}

/// Draws volumes over time.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn volume_curves(file: &Path, figure: &VolumeCurves) -> Result<(), ReportError> {
    let curves = in_ms(&figure.curves, 1.0);
    picture(file, "the volume curves", (1500, 950), |area| {
        let below = headed(area, &figure.title, &legend_of(&curves))?;
        let axes = Axes {
            x_title: "time after the trigger (ms)",
            y_title: &format!("{} (mL)", figure.quantity),
            x: padded(abscissae(&curves), 0.02, 0.02),
            y: padded(ordinates(&curves), 0.1, 0.1),
        };
        let mut chart = framed(&below, &axes, 40)?;
        draw_curves(&mut chart, &curves)
    })
}

/// Draws pressures in mmHg over time, with the phases of the beat behind them.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn pressures(file: &Path, figure: &PressureCurves) -> Result<(), ReportError> {
    let curves = in_ms(&figure.curves, 1.0 / KPA_PER_MMHG);
    picture(file, "the pressures", (1500, 950), |area| {
        let below = headed(area, &figure.title, &legend_of(&curves))?;
        let (low, high) = padded(ordinates(&curves), 0.06, 0.16);
        let axes = Axes {
            x_title: "time after the trigger (ms)",
            y_title: "pressure (mmHg)",
            x: padded(abscissae(&curves), 0.0, 0.0),
            y: (low, high),
        };
        let mut chart = framed(&below, &axes, 40)?;
        let tints = [RGBColor(238, 238, 238), RGBColor(253, 238, 214), RGBColor(221, 238, 250), RGBColor(243, 228, 238)];
        let style = text(TEXT - 4, &GREY_INK);
        for (number, band) in figure.phases.iter().enumerate() {
            let (from, to) = ((band.from_s * MS_PER_S).max(axes.x.0), (band.to_s * MS_PER_S).min(axes.x.1));
            if from < to {
                chart.draw_series([Rectangle::new([(from, low), (to, high)], tints[number % tints.len()].filled())])?;
                label_band(&chart, band, (from, to), high, &style)?;
            }
        }
        draw_curves(&mut chart, &curves)
    })
}

/// Writes the name of a band at its top, upright where it fits and turned where it does not.
fn label_band(chart: &super::chart::Chart, band: &TimeBand, (from, to): (f64, f64), top: f64, style: &TextStyle<'static>) -> Drawn {
    let plot = chart.plotting_area().strip_coord_spec();
    let (columns, rows) = chart.plotting_area().get_pixel_range();
    let place = |x: f64| chart.backend_coord(&(x, top)).0 - columns.start;
    let (text_width, _) = plot.estimate_text_size(&band.name, style)?;
    let (centre, width) = ((place(from) + place(to)) / 2, place(to) - place(from));
    let _ = rows;
    if (text_width as i32) < width - ipx(8) {
        plot.draw_text(&band.name, &anchored(style.clone(), HPos::Center), (centre, ipx(22)))?;
    } else {
        let turned = style.clone().transform(FontTransform::Rotate90);
        let turned = turned.pos(plotters::style::text_anchor::Pos::new(HPos::Left, plotters::style::text_anchor::VPos::Center));
        plot.draw_text(&band.name, &turned, (centre, ipx(10)))?;
    }
    Ok(())
}

/// Draws the cost over the iterations, on a logarithmic axis.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn cost_over_iterations(file: &Path, figure: &CostHistory) -> Result<(), ReportError> {
    let logarithms = figure.cost.iter().enumerate().filter(|(_, cost)| **cost > 0.0 && cost.is_finite());
    let points: Vec<_> = logarithms.map(|(iteration, cost)| (iteration as f64, cost.log10())).collect();
    picture(file, "the cost", (1200, 800), |area| {
        let below = headed(area, &figure.title, &[])?;
        let (low, high) = padded(points.iter().map(|&(_, y)| y), 0.0, 0.0);
        let last = (figure.cost.len().max(2) - 1) as f64;
        let axes = Axes {
            x_title: "iteration",
            y_title: "cost",
            x: (-0.02 * last, last * 1.02),
            y: (low.floor(), if high.ceil() > low.floor() { high.ceil() } else { low.floor() + 1.0 }),
        };
        let mut chart = logarithmic(&below, &axes)?;
        let curve = Curve { name: String::new(), look: Look::Tracked, points };
        draw_curves(&mut chart, &[curve])
    })
}

/// A frame whose ordinate is the decimal logarithm of what is written at its ticks.
fn logarithmic<'a, 'b>(
    area: &'a DrawingArea<BitMapBackend<'b>, plotters::coord::Shift>,
    axes: &Axes,
) -> Result<super::chart::Chart<'a, 'b>, Box<dyn std::error::Error + Send + Sync>> {
    let decades = (axes.y.1 - axes.y.0).round() as usize;
    let mut chart = ChartBuilder::on(area)
        .margin_left(px(14))
        .margin_right(px(40))
        .margin_bottom(px(12))
        .margin_top(px(10))
        .x_label_area_size(px(74))
        .y_label_area_size(px(100))
        .build_cartesian_2d(axes.x.0..axes.x.1, axes.y.0..axes.y.1)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .max_light_lines(0)
        .x_labels(10)
        .y_labels(decades + 1)
        .bold_line_style(RULE.stroke_width(px(1)))
        .axis_style(GREY_INK.stroke_width(px(2)))
        .label_style(text(TEXT, &BLACK_INK))
        .axis_desc_style(text(TEXT + 2, &BLACK_INK))
        .x_desc(axes.x_title)
        .y_desc(axes.y_title)
        .x_label_formatter(&|x| if x.fract().abs() < 1e-9 { format!("{x:.0}") } else { String::new() })
        .y_label_formatter(&|y| if y.fract().abs() < 1e-9 { power_of_ten(y.round() as i32) } else { String::new() })
        .draw()?;
    for decade in (axes.y.0.round() as i32)..(axes.y.1.round() as i32) {
        for digit in 1..10 {
            let y = f64::from(decade) + f64::from(digit).log10();
            let rule = if digit == 1 { RGBColor(200, 200, 200) } else { RGBColor(236, 236, 236) };
            chart.draw_series([PathElement::new(vec![(axes.x.0, y), (axes.x.1, y)], rule.stroke_width(px(1)))])?;
        }
    }
    Ok(chart)
}

/// 10ⁿ with a raised exponent; small powers in full.
fn power_of_ten(exponent: i32) -> String {
    if (-3..=4).contains(&exponent) {
        return format!("{}", 10f64.powi(exponent));
    }
    let raised = |digit: char| match digit {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        other => char::from_u32('⁰' as u32 + other.to_digit(10).unwrap_or(0)).unwrap_or(other),
    };
    format!("10{}", exponent.to_string().chars().map(raised).collect::<String>())
}

fn in_ms(curves: &[Curve], scale: f64) -> Vec<Curve> {
    let scaled = |curve: &Curve| Curve { points: curve.points.iter().map(|&(x, y)| (x * MS_PER_S, y * scale)).collect(), ..curve.clone() };
    curves.iter().map(scaled).collect()
}

fn abscissae(curves: &[Curve]) -> impl Iterator<Item = f64> {
    curves.iter().flat_map(|curve| curve.points.iter().map(|point| point.0))
}

fn ordinates(curves: &[Curve]) -> impl Iterator<Item = f64> {
    curves.iter().flat_map(|curve| curve.points.iter().map(|point| point.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_ten_are_written_as_people_do() {
        assert_eq!([-2, 0, 3, 6, -5, 12].map(power_of_ten), ["0.01", "1", "1000", "10⁶", "10⁻⁵", "10¹²"]);
    }
}
