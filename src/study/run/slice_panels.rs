//! Slices of an image as panels of a montage, and the sections of surfaces with them.

use nalgebra::Vector3;

use crate::anatomy::Anatomy;
use crate::image::{CineSequence, Grid, LabelMap};
use crate::report::figures::MontagePanel;
use crate::tracking::Contour;

/// The voxels shown: first and last along i and j.
pub(super) type Window = [[usize; 2]; 2];

/// The heart with 20 mm around it.
pub(super) fn window_around(anatomy: &Anatomy, grid: &Grid) -> Window {
    const MARGIN_MM: f64 = 20.0;
    let mut window = [[0; 2]; 2];
    for (axis, bounds) in window.iter_mut().enumerate() {
        let places = anatomy.mesh.vertices_mm().iter().map(|v| grid.to_voxel(v)[axis]);
        let (low, high) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let margin = MARGIN_MM / grid.spacing_mm()[axis];
        let last = grid.shape()[axis].saturating_sub(1) as f64;
        *bounds = [(low - margin).floor().clamp(0.0, last) as usize, (high + margin).ceil().clamp(0.0, last) as usize];
    }
    window
}

/// A slice of a frame without contours.
pub(super) fn panel(cine: &CineSequence, frame: usize, k: usize, [[i0, i1], [j0, j1]]: Window) -> MontagePanel {
    let spacing = cine.grid().spacing_mm();
    let frame = &cine.frames()[frame];
    let intensity = (j0..=j1).flat_map(|j| (i0..=i1).map(move |i| f64::from(frame.at([i, j, k])))).collect();
    MontagePanel {
        columns: i1 - i0 + 1,
        rows: j1 - j0 + 1,
        intensity,
        origin_mm: [i0 as f64 * spacing.x, j0 as f64 * spacing.y],
        spacing_mm: [spacing.x, spacing.y],
        contours: Vec::new(),
    }
}

/// A line of a panel: points in the slice's coordinates, mm.
pub(super) type Line = Vec<[f64; 2]>;

/// The section of triangles with the slice `k`.
pub(super) fn section(triangles: &[[usize; 3]], position_mm: &[Vector3<f64>], grid: &Grid, k: usize) -> Vec<Line> {
    lines(&Contour::of_surface(triangles, position_mm, grid, k), grid)
}

/// The borders of the voxels with each of some codes in the slice `k` of the image that they were drawn on.
pub(super) fn label_borders(labels: &LabelMap, codes: &[u8], k: usize) -> Vec<Line> {
    codes.iter().flat_map(|&code| lines(&Contour::of_label(labels, code, k), labels.grid())).collect()
}

fn lines(contour: &Contour, grid: &Grid) -> Vec<Line> {
    contour.segments_mm().iter().map(|ends| in_slice(grid, ends)).collect()
}

/// The ends of a piece of a contour, as a line of a panel.
pub(super) fn in_slice(grid: &Grid, ends: &[Vector3<f64>]) -> Line {
    let spacing = grid.spacing_mm();
    let at = |end| {
        let voxel = grid.to_voxel(end);
        [voxel.x * spacing.x, voxel.y * spacing.y]
    };
    ends.iter().map(at).collect()
}

/// First and last slice that the heart reaches, as far as the image goes.
pub(super) fn slices_of(anatomy: &Anatomy, grid: &Grid) -> Option<[usize; 2]> {
    let heights = anatomy.mesh.vertices_mm().iter().map(|v| grid.to_voxel(v).z);
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    let last = grid.shape()[2] as f64 - 1.0;
    let (first, last) = (low.ceil().max(0.0), high.floor().min(last));
    (first <= last).then_some([first as usize, last as usize])
}
