//! The volume curve, and the contours it was followed with on slices through the beat.

use std::path::Path;

use crate::image::{CavityContours, CavitySlice, CineSequence, VolumeCurve};
use crate::report::ReportError;
use crate::report::figures::{Contour, Curve, Look, Montage, MontagePanel, VolumeCurves, slice_montage, volume_curves};
use crate::units::MS_PER_S;

/// Slices and times of the montage.
const ROWS: usize = 5;
const COLUMNS: usize = 6;

/// Shown around the cavity, mm.
const MARGIN_MM: f64 = 25.0;

/// The brightest share of the pixels is shown white.
const WHITE_SHARE: f64 = 0.005;

/// Draws the measured instants and the smooth curve.
pub(super) fn curve(file: &Path, measured: &VolumeCurve, smooth: &VolumeCurve) -> Result<(), ReportError> {
    let curves = vec![
        Curve::new("smooth", Look::Simulated, smooth.times_s(), smooth.volumes_ml()),
        Curve::new("measured", Look::Measured, measured.times_s(), measured.volumes_ml()),
    ];
    volume_curves(file, &VolumeCurves { title: "LV volume over the beat".into(), quantity: "LV volume".into(), curves })
}

/// Draws the contours on slices from one end of the cavity to the other, from end-diastole on.
pub(super) fn contours(file: &Path, cine: &CineSequence, contours: &CavityContours, curve: &VolumeCurve) -> Result<(), ReportError> {
    let frame_count = cine.frames().len();
    let columns = COLUMNS.min(frame_count);
    let (first, last) = (curve.end_diastole().frame, curve.end_systole().frame);
    let mut frames: Vec<usize> = (0..columns).map(|n| (first + n * frame_count / columns) % frame_count).collect();
    if let Some(nearest) = frames.iter_mut().skip(1).min_by_key(|frame| frame.abs_diff(last)) {
        *nearest = last;
    }
    let rows = ROWS.min(contours.slices.len());
    let chosen: Vec<&CavitySlice> = (0..rows).map(|n| &contours.slices[(2 * n + 1) * contours.slices.len() / (2 * rows)]).collect();
    let panels: Vec<MontagePanel> = chosen.iter().flat_map(|slice| frames.iter().map(|&frame| panel(cine, slice, frame))).collect();
    let mut shown: Vec<f64> = panels.iter().flat_map(|panel| panel.intensity.iter().copied()).collect();
    shown.sort_by(f64::total_cmp);
    let white = shown[((1.0 - WHITE_SHARE) * (shown.len() - 1) as f64) as usize];
    let time = |frame: &usize| {
        let name = if *frame == first {
            " (ED)"
        } else if *frame == last {
            " (ES)"
        } else {
            ""
        };
        format!("{:.0} ms{name}", cine.times_s()[*frame] * MS_PER_S)
    };
    let figure = Montage {
        title: "Cavity followed on the images".into(),
        surfaces: vec!["cavity".into()],
        column_titles: frames.iter().map(time).collect(),
        row_titles: chosen.iter().map(|slice| format!("slice {}", slice.slice)).collect(),
        panels,
        window: (shown[0], white.max(shown[0] + 1.0)),
    };
    slice_montage(file, &figure)
}

fn panel(cine: &CineSequence, slice: &CavitySlice, frame: usize) -> MontagePanel {
    let grid = cine.grid();
    let spacing = grid.spacing_mm();
    let largest_mm = slice.radii_mm.iter().flatten().copied().fold(0.0, f64::max) + MARGIN_MM;
    let range = |axis: usize| {
        let last = (grid.shape()[axis] - 1) as f64;
        let voxel = |mm: f64| (mm / spacing[axis]).clamp(0.0, last) as usize;
        (voxel(slice.centre_mm[axis] - largest_mm), voxel(slice.centre_mm[axis] + largest_mm))
    };
    let ((i0, i1), (j0, j1)) = (range(0), range(1));
    let image = &cine.frames()[frame];
    MontagePanel {
        columns: i1 - i0 + 1,
        rows: j1 - j0 + 1,
        intensity: (j0..=j1).flat_map(|j| (i0..=i1).map(move |i| f64::from(image.at([i, j, slice.slice])))).collect(),
        origin_mm: [i0 as f64 * spacing.x, j0 as f64 * spacing.y],
        spacing_mm: [spacing.x, spacing.y],
        contours: vec![Contour { surface: 0, points_mm: slice.outline_mm(frame) }],
    }
}
