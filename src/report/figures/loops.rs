//! The pressure–volume loop, in kPa and, on the right, mmHg.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::chart::{Axes, Curve, draw_curves, framed, headed, legend_of, tick};
use super::style::*;
use crate::report::ReportError;
use crate::units::KPA_PER_MMHG;

/// A named place of the loop.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopPoint {
    /// Name, such as `end of systole`.
    pub name: String,
    /// Volume.
    pub volume_ml: f64,
    /// Pressure.
    pub pressure_kpa: f64,
}

/// Loops of one ventricle.
#[derive(Debug, Clone, PartialEq)]
pub struct PressureVolumeLoop {
    /// Title.
    pub title: String,
    /// Name of the ventricle, such as `LV`.
    pub ventricle: String,
    /// Loops in mL and kPa.
    pub loops: Vec<Curve>,
    /// Places that are named.
    pub points: Vec<LoopPoint>,
}

/// Draws pressure over volume.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn pressure_volume_loop(file: &Path, figure: &PressureVolumeLoop) -> Result<(), ReportError> {
    let points = || figure.loops.iter().flat_map(|curve| curve.points.iter());
    picture(file, "the pressure–volume loop", (1150, 1000), |area| {
        let below = headed(area, &figure.title, &legend_of(&figure.loops))?;
        let axes = Axes {
            x_title: &format!("{} volume (mL)", figure.ventricle),
            y_title: &format!("{} pressure (kPa)", figure.ventricle),
            x: padded(points().map(|p| p.0), 0.12, 0.12),
            y: padded(points().map(|p| p.1).chain([0.0]), 0.03, 0.1),
        };
        let mut chart = framed(&below, &axes, 120)?;
        draw_mmhg_axis(&chart, &axes)?;
        draw_curves(&mut chart, &figure.loops)?;
        let style = anchored(text(TEXT - 2, &BLACK_INK), HPos::Left);
        for point in &figure.points {
            let place = (point.volume_ml, point.pressure_kpa);
            chart.draw_series([Circle::new(place, px(7), BLACK_INK.filled())])?;
            let label = EmptyElement::at(place) + Text::new(point.name.clone(), (ipx(14), -ipx(18)), style.clone());
            chart.draw_series([label])?;
        }
        Ok(())
    })
}

/// Ticks in mmHg on the right of the frame.
fn draw_mmhg_axis(chart: &super::chart::Chart, axes: &Axes) -> Drawn {
    let plot = chart.plotting_area();
    let (columns, rows) = plot.get_pixel_range();
    let (low, high) = (axes.y.0 / KPA_PER_MMHG, axes.y.1 / KPA_PER_MMHG);
    let step = nice_step(high - low, 6);
    let whole = plot.strip_coord_spec();
    let right = columns.end - columns.start;
    // The plotting area ends at the frame, so text right of it is drawn with places beyond its width.
    let (ink, style) = (GREY_INK.stroke_width(px(2)), anchored(text(TEXT, &BLACK_INK), HPos::Left));
    let mut number = (low / step).ceil();
    while number * step <= high {
        let value = number * step;
        let y = chart.backend_coord(&(axes.x.0, value * KPA_PER_MMHG)).1 - rows.start;
        whole.draw(&PathElement::new(vec![(right, y), (right + ipx(8), y)], ink))?;
        whole.draw_text(&tick(value), &style, (right + ipx(14), y))?;
        number += 1.0;
    }
    whole.draw(&PathElement::new(vec![(right, 0), (right, rows.end - rows.start)], ink))?;
    let turned = text(TEXT + 2, &BLACK_INK).transform(FontTransform::Rotate90);
    let turned = turned.pos(plotters::style::text_anchor::Pos::new(HPos::Center, plotters::style::text_anchor::VPos::Center));
    whole.draw_text("pressure (mmHg)", &turned, (right + ipx(92), (rows.end - rows.start) / 2))?;
    Ok(())
}

/// 1, 2 or 5 times a power of ten that cuts `span` into about `parts`.
fn nice_step(span: f64, parts: u32) -> f64 {
    let raw = (span / f64::from(parts)).max(f64::MIN_POSITIVE);
    let power = 10f64.powf(raw.log10().floor());
    let digit = [1.0, 2.0, 5.0, 10.0].into_iter().find(|digit| digit * power >= raw).unwrap_or(10.0);
    digit * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_ones_twos_and_fives() {
        assert_eq!(nice_step(120.0, 6), 20.0);
        assert_eq!(nice_step(121.0, 6), 50.0);
        assert!((nice_step(0.5, 6) - 0.1).abs() < 1e-12);
    }
}
