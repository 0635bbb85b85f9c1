//! The pressure–volume loop, in kPa and, on the right, mmHg.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::chart::{Axes, Chart, Curve, Margins, decorate, draw_curves, headed, legend_of, plot, ticks};
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
        let mut chart = plot(&below, &axes, &Margins { right: 118, ..Margins::default() })?;
        decorate(area, &chart, &axes, &ticks(axes.x, 6), &ticks(axes.y, 7))?;
        draw_mmhg_axis(area, &chart, &axes)?;
        draw_curves(&mut chart, &figure.loops)?;
        let middle_ml = (axes.x.0 + axes.x.1) / 2.0;
        for point in &figure.points {
            // Names stand inside the loop, where there is room.
            let (side, align) = if point.volume_ml > middle_ml { (-1, HPos::Right) } else { (1, HPos::Left) };
            let (x, y) = chart.backend_coord(&(point.volume_ml, point.pressure_kpa));
            area.draw(&Circle::new((x, y), px(8), BLACK_INK.filled()))?;
            write(area, &point.name, &text(TEXT - 2, &BLACK_INK), align, (x + side * ipx(22), y))?;
        }
        Ok(())
    })
}

/// Ticks in mmHg on the right of the frame.
fn draw_mmhg_axis(area: &Area, chart: &Chart, axes: &Axes) -> Drawn {
    let (columns, rows) = chart.plotting_area().get_pixel_range();
    let ink = GREY_INK.stroke_width(px(2));
    for tick in ticks((axes.y.0 / KPA_PER_MMHG, axes.y.1 / KPA_PER_MMHG), 7) {
        let y = chart.backend_coord(&(axes.x.0, tick.at * KPA_PER_MMHG)).1;
        area.draw(&PathElement::new(vec![(columns.end, y), (columns.end + ipx(8), y)], ink))?;
        write(area, &tick.label, &text(TEXT, &BLACK_INK), HPos::Left, (columns.end + ipx(14), y))?;
    }
    area.draw(&PathElement::new(vec![(columns.end, rows.start), (columns.end, rows.end)], ink))?;
    write_upward(area, "pressure (mmHg)", &text(TEXT + 2, &BLACK_INK), HPos::Center, (columns.end + ipx(88), (rows.start + rows.end) / 2))
}
