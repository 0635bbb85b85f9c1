//! Strain curves by part of the wall, one panel a direction.

use std::path::Path;

use super::chart::{Axes, Curve, Margins, decorate, draw_curves, headed, plot, ticks};
use super::style::*;
use crate::report::ReportError;
use crate::units::MS_PER_S;

/// Strains over the beat.
#[derive(Debug, Clone, PartialEq)]
pub struct StrainCurves {
    /// Title.
    pub title: String,
    /// Panels from top to bottom.
    pub panels: Vec<StrainPanel>,
}

/// The strains in one direction.
#[derive(Debug, Clone, PartialEq)]
pub struct StrainPanel {
    /// Direction, such as `circumferential`.
    pub direction: String,
    /// Curves in s and relative strain; those of one look share its name in the legend.
    pub curves: Vec<Curve>,
}

/// Draws strains in % over time.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn strain_curves(file: &Path, figure: &StrainCurves) -> Result<(), ReportError> {
    const PANEL_HEIGHT: u32 = 420;
    let count = figure.panels.len().max(1) as u32;
    picture(file, "the strains", (1300, 150 + PANEL_HEIGHT * count), |area| {
        let mut legend: Vec<_> = Vec::new();
        for curve in figure.panels.iter().flat_map(|panel| &panel.curves) {
            if legend.iter().all(|&(_, look)| look != curve.look) {
                legend.push((curve.name.as_str(), curve.look));
            }
        }
        let below = headed(area, &figure.title, &legend)?;
        for (part, panel) in below.split_evenly((count as usize, 1)).iter().zip(&figure.panels) {
            let percent = |curve: &Curve| Curve {
                points: curve.points.iter().map(|&(time_s, strain)| (time_s * MS_PER_S, 100.0 * strain)).collect(),
                ..curve.clone()
            };
            let curves: Vec<Curve> = panel.curves.iter().map(percent).collect();
            let points = || curves.iter().flat_map(|curve| curve.points.iter());
            let axes = Axes {
                x_title: "time after the trigger (ms)",
                y_title: &format!("{} (%)", panel.direction),
                x: padded(points().map(|p| p.0), 0.0, 0.0),
                y: padded(points().map(|p| p.1).chain([0.0]), 0.06, 0.06),
            };
            let mut chart = plot(part, &axes, &Margins { top: 16, ..Margins::default() })?;
            decorate(area, &chart, &axes, &ticks(axes.x, 8), &ticks(axes.y, 5))?;
            draw_curves(&mut chart, &curves)?;
        }
        Ok(())
    })
}
