//! Curves in time and over iterations: volumes, pressures with the phases of the beat, cost.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::chart::{Axes, Chart, Curve, Look, Margins, Tick, decorate, draw_curves, headed, legend_of, plot, ticks};
use super::style::*;
use crate::report::ReportError;
use crate::units::{KPA_PER_MMHG, MS_PER_S};

/// Any quantity over the beat.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeCurves {
    /// Title.
    pub title: String,
    /// What the ordinate is, with its unit.
    pub quantity: String,
    /// Curves over s.
    pub curves: Vec<Curve>,
}

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

/// Pressures and the volume of one ventricle over the beat.
#[derive(Debug, Clone, PartialEq)]
pub struct BeatCurves {
    /// Title.
    pub title: String,
    /// Pressures in s and kPa.
    pub pressures: Vec<Curve>,
    /// The volume in s and mL.
    pub volume: Curve,
    /// Phases, in order of time; a valve moves where one begins.
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

/// Draws a quantity over time.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn time_curves(file: &Path, figure: &TimeCurves) -> Result<(), ReportError> {
    let curves = in_ms(&figure.curves, 1.0);
    picture(file, "the curves", (1500, 950), |area| {
        let below = headed(area, &figure.title, &legend_of(&curves))?;
        let axes = Axes {
            x_title: "time after the trigger (ms)",
            y_title: &figure.quantity,
            x: padded(abscissae(&curves), 0.02, 0.02),
            y: padded(ordinates(&curves), 0.1, 0.1),
        };
        let mut chart = plot(&below, &axes, &Margins::default())?;
        decorate(area, &chart, &axes, &ticks(axes.x, 8), &ticks(axes.y, 7))?;
        draw_curves(&mut chart, &curves)
    })
}

/// Draws volumes over time.
///
/// # Errors
/// As [`time_curves`].
pub fn volume_curves(file: &Path, figure: &VolumeCurves) -> Result<(), ReportError> {
    let VolumeCurves { title, quantity, curves } = figure.clone();
    time_curves(file, &TimeCurves { title, quantity: format!("{quantity} (mL)"), curves })
}

/// Draws pressures in mmHg above the volume, both over time with the phases of the beat behind them.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn beat_curves(file: &Path, figure: &BeatCurves) -> Result<(), ReportError> {
    let pressures = in_ms(&figure.pressures, 1.0 / KPA_PER_MMHG);
    let volume = in_ms(std::slice::from_ref(&figure.volume), 1.0);
    picture(file, "the beat", (1500, 1350), |area| {
        let below = headed(area, &figure.title, &legend_of(&pressures))?;
        let height = below.dim_in_pixel().1;
        let (upper, lower) = below.split_vertically(height * 3 / 5);
        let x = padded(abscissae(&pressures), 0.0, 0.0);
        let y = padded(ordinates(&pressures).chain([0.0]), 0.03, 0.14);
        let axes = Axes { x_title: "", y_title: "pressure (mmHg)", x, y };
        draw_over_phases(area, &upper, &axes, &pressures, &figure.phases, true)?;
        let y = padded(ordinates(&volume), 0.1, 0.1);
        let axes = Axes { x_title: "time after the trigger (ms)", y_title: "volume (mL)", x, y };
        draw_over_phases(area, &lower, &axes, &volume, &figure.phases, false)
    })
}

fn draw_over_phases<'b>(whole: &Area<'b>, part: &Area<'b>, axes: &Axes, curves: &[Curve], phases: &[TimeBand], is_named: bool) -> Drawn {
    let mut chart = plot(part, axes, &Margins { bottom: if axes.x_title.is_empty() { 44 } else { 92 }, ..Margins::default() })?;
    let within = |time_s: f64| (time_s * MS_PER_S).clamp(axes.x.0, axes.x.1);
    for band in phases {
        let corners = [(within(band.from_s), axes.y.0), (within(band.to_s), axes.y.1)];
        chart.draw_series([Rectangle::new(corners, tint(&band.name).filled())])?;
    }
    decorate(whole, &chart, axes, &ticks(axes.x, 8), &ticks(axes.y, 6))?;
    for band in phases {
        let begin = within(band.from_s);
        if begin > axes.x.0 {
            let line = [(begin, axes.y.0), (begin, axes.y.1)];
            chart.draw_series(DashedLineSeries::new(line, px(6), px(6), GREY_INK.stroke_width(px(1))))?;
        }
        if is_named {
            name_band(whole, &chart, &band.name, (begin, within(band.to_s)), axes.y.1)?;
        }
    }
    draw_curves(&mut chart, curves)
}

/// A pale colour of its own for each phase.
fn tint(phase: &str) -> RGBColor {
    match phase {
        "IVC" => RGBColor(253, 226, 205),
        "ejection" => RGBColor(253, 243, 222),
        "IVR" => RGBColor(221, 236, 248),
        _ => RGBColor(241, 247, 251),
    }
}

/// Writes the name of a band at its top, upward where it is narrow.
fn name_band(area: &Area, chart: &Chart, name: &str, (from, to): (f64, f64), top: f64) -> Drawn {
    let style = text(TEXT - 3, &GREY_INK);
    let ((left, y), (right, _)) = (chart.backend_coord(&(from, top)), chart.backend_coord(&(to, top)));
    let (width, _) = area.estimate_text_size(name, &style)?;
    match right - left {
        0 => Ok(()),
        room if room > width as i32 + ipx(6) => write(area, name, &style, HPos::Center, ((left + right) / 2, y + ipx(22))),
        _ => write_upward(area, name, &style, HPos::Right, ((left + right) / 2, y + ipx(10))),
    }
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
        let (low, high) = (low.floor(), high.ceil().max(low.floor() + 1.0));
        let last = (figure.cost.len().max(2) - 1) as f64;
        let axes = Axes { x_title: "iteration", y_title: "cost", x: (-0.03 * last, last * 1.03), y: (low, high) };
        let mut chart = plot(&below, &axes, &Margins::default())?;
        let whole = ticks(axes.x, 10).into_iter().filter(|tick| tick.at.fract() == 0.0).collect::<Vec<_>>();
        decorate(area, &chart, &axes, &whole, &decades(low as i32, high as i32))?;
        draw_curves(&mut chart, &[Curve { name: String::new(), look: Look::Tracked, points }])
    })
}

/// Ticks of a logarithmic axis, whose coordinate is the decimal logarithm.
pub(super) fn decades(low: i32, high: i32) -> Vec<Tick> {
    let named = |decade: i32| Tick { at: f64::from(decade), label: power_of_ten(decade), is_faint: false };
    let between = |decade: i32, digit: i32| Tick { at: f64::from(decade) + f64::from(digit).log10(), label: String::new(), is_faint: true };
    let inner = (low..high).flat_map(|decade| (2..10).map(move |digit| between(decade, digit)));
    inner.chain((low..=high).map(named)).collect()
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
