//! The contours of a resting heart on the slices that it was drawn on, and on every further view.

use std::path::Path;

use super::error::RunError;
use super::mesh_only::RestingHeart;
use super::slice_panels::{Line, label_borders, panel, section, slices_of, window_around};
use crate::image::{CineReading, CineSequence};
use crate::mesh::SurfaceTag;
use crate::numerics::quantile;
use crate::report::figures::{Contour, Montage, slice_montage};
use crate::study::plan::ImagesPlan;

/// Slices in a row, and rows at most.
const COLUMNS: usize = 4;
const ROWS_MAX: usize = 3;

/// The brightest share of the pixels is shown white.
const WHITE_SHARE: f64 = 0.005;

/// The surfaces shown, with their names.
const SURFACES: [(SurfaceTag, &str); 4] = [
    (SurfaceTag::EndocardiumLv, "LV endocardium"),
    (SurfaceTag::EndocardiumRv, "RV endocardium"),
    (SurfaceTag::Epicardium, "epicardium"),
    (SurfaceTag::Base, "base"),
];

/// The contours on the slices of the labels' frame and on every further view, with what is odd about the views, in words.
#[derive(Default)]
pub(super) struct Overlays {
    /// By the names of their files.
    montages: Vec<(String, Montage)>,
    pub(super) warnings: Vec<String>,
}

impl Overlays {
    /// The overlays of a heart that was drawn on images; none of any other.
    pub(super) fn new(images: &ImagesPlan, heart: &RestingHeart) -> Result<Self, RunError> {
        let Some((study, frame)) = &heart.study else { return Ok(Self::default()) };
        let (mut montages, mut warnings) = (Vec::new(), Vec::new());
        let time_s = study.cine.times_s().get(*frame).copied().unwrap_or_default();
        montages.extend(overlay("Short axis, frame of the labels", &study.cine, *frame, heart, true).map(|one| ("slices.png".into(), one)));
        for (number, CineReading { cine, warnings: odd }) in study.read_long_axis(images)?.into_iter().enumerate() {
            warnings.extend(odd);
            let name = if number == 0 { "long_axis.png".to_string() } else { format!("long_axis_{}.png", number + 1) };
            let (earlier, later, weight) = cine.frames_around(time_s);
            let frame = if weight < 0.5 { earlier } else { later };
            montages.extend(overlay("Long axis, same phase", &cine, frame, heart, false).map(|one| (name, one)));
        }
        Ok(Self { montages, warnings })
    }

    /// The slices of the short axis, one a row, as a page shows them.
    pub(super) fn for_page(self) -> Option<Montage> {
        let (_, montage) = self.montages.into_iter().next()?;
        let row_titles = (1..=montage.panels.len()).map(|n| format!("Short axis, {n} of {}", montage.panels.len())).collect();
        Some(Montage { row_titles, column_titles: vec![String::new()], ..montage })
    }
}

/// Draws `slices.png` and, of further views, `long_axis.png`, `long_axis_2.png`, ….
pub(super) fn draw_overlays(folder: &Path, overlays: &Overlays) -> Result<(), RunError> {
    overlays.montages.iter().try_for_each(|(name, montage)| Ok(slice_montage(&folder.join(name), montage)?))
}

fn overlay(title: &str, cine: &CineSequence, frame: usize, heart: &RestingHeart, has_labels: bool) -> Option<Montage> {
    let (anatomy, grid) = (&heart.anatomy, cine.grid());
    let [first, last] = slices_of(anatomy, grid)?;
    let count = last - first + 1;
    let columns = COLUMNS.min(count);
    let rows = (count / columns).clamp(1, ROWS_MAX);
    let chosen: Vec<usize> = (0..rows * columns).map(|n| first + (2 * n + 1) * count / (2 * rows * columns)).collect();
    let window = window_around(anatomy, grid);
    let lines_of = |tag: SurfaceTag, k: usize| {
        let triangles: Vec<_> = anatomy.surface.triangles_with(tag).collect();
        section(&triangles, anatomy.mesh.vertices_mm(), grid, k)
    };
    let labels = heart.drawn.as_ref().filter(|_| has_labels).map(|(drawn, _)| drawn);
    let borders_of = |k: usize| labels.map_or(Vec::new(), |drawn| label_borders(&drawn.labels, &drawn.codes.all(), k));
    let mut layers: Vec<(&str, Vec<Vec<Line>>)> =
        SURFACES.iter().map(|&(tag, name)| (name, chosen.iter().map(|&k| lines_of(tag, k)).collect())).collect();
    layers.push(("labels", chosen.iter().map(|&k| borders_of(k)).collect()));
    layers.retain(|(_, slices)| slices.iter().any(|lines| !lines.is_empty()));
    let mut panels: Vec<_> = chosen.iter().map(|&k| panel(cine, frame, k, window)).collect();
    // The labels first: the mesh is drawn over them.
    for (surface, (_, slices)) in layers.iter().enumerate().rev() {
        for (panel, lines) in panels.iter_mut().zip(slices) {
            panel.contours.extend(lines.iter().map(|line| Contour { surface, points_mm: line.clone() }));
        }
    }
    let shown: Vec<f64> = panels.iter().flat_map(|panel| panel.intensity.iter().copied()).collect();
    let (black, white) = (quantile(&shown, 0.0).unwrap_or(0.0), quantile(&shown, 1.0 - WHITE_SHARE).unwrap_or(1.0));
    Some(Montage {
        title: title.to_owned(),
        surfaces: layers.iter().map(|(name, _)| name.to_string()).collect(),
        column_titles: vec![String::new(); columns],
        row_titles: chosen.chunks(columns).map(|row| format!("slices {} to {}", row[0], row[row.len() - 1])).collect(),
        panels,
        window: (black, white.max(black + 1.0)),
    })
}
