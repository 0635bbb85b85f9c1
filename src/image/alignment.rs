//! Slices that lie beside their neighbours because the breath was held differently: estimated, reported, and on request corrected.
//!
//! Known shifts, put on a phantom's or a patient's slices, come back within a voxel (`tests/slice_shifts.rs`). What cannot be told is said so. Yet an
//! estimate knows the heart by its neighbouring slices only: where the heart itself bends, it is taken for displaced. Hence nothing is corrected
//! unless asked for.

mod estimate;

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::{CineSequence, Grid, ImageError, LabelMap, Volume};

pub use estimate::estimate_slice_shifts;

/// In-plane shift of every slice, mm along the image's i and j axes: how far the slice's content lies from where its neighbours suggest.
#[derive(Debug, Clone, PartialEq)]
pub struct SliceShifts {
    /// One shift a slice (index k); none where it is not estimable.
    pub shift_mm: Vec<Option<Vector2<f64>>>,
}

impl SliceShifts {
    /// The largest shift found, mm.
    pub fn greatest_mm(&self) -> f64 {
        self.shift_mm.iter().flatten().map(|shift| shift.norm()).fold(0.0, f64::max)
    }

    /// Slices of which nothing is known.
    pub fn not_estimable(&self) -> Vec<usize> {
        (0..self.shift_mm.len()).filter(|&slice| self.shift_mm[slice].is_none()).collect()
    }

    /// Slices shifted by more than `limit_mm`, in words.
    pub fn warnings(&self, limit_mm: f64) -> Vec<String> {
        let known = self.shift_mm.iter().enumerate().filter_map(|(slice, shift)| Some((slice, (*shift)?)));
        let words = |(slice, shift): (usize, Vector2<f64>)| {
            format!(
                "slice {slice} lies {:.1} mm beside its neighbours ({:+.1}, {:+.1} mm along i, j): breath-hold shift?",
                shift.norm(),
                shift.x,
                shift.y
            )
        };
        known.filter(|(_, shift)| shift.norm() > limit_mm).map(words).collect()
    }
}

/// The sequence with every slice moved back by its shift, where that is known (bilinear; pixels that come from outside take the border's value).
///
/// # Errors
/// [`ImageError::InconsistentCine`] if the number of shifts is not that of the slices or one is not finite.
pub fn correct_slice_shifts(cine: &CineSequence, shifts: &SliceShifts) -> Result<CineSequence, ImageError> {
    let grid = cine.grid();
    if shifts.shift_mm.len() != grid.shape()[2] || !shifts.shift_mm.iter().flatten().all(|shift| shift.iter().all(|mm| mm.is_finite())) {
        let reason = format!("{} finite slice shifts are needed for its {} slices", grid.shape()[2], grid.shape()[2]);
        return Err(ImageError::InconsistentCine { reason });
    }
    let moved = |frame: &Volume| {
        let plane =
            |slice: usize| shifted_slice(frame, slice, shifts.shift_mm[slice].unwrap_or_default().component_div(&grid.spacing_mm().xy()));
        Volume::new(grid.clone(), (0..grid.shape()[2]).flat_map(plane).collect())
    };
    let frames = cine.frames().par_iter().map(moved).collect::<Result<Vec<_>, _>>()?;
    CineSequence::new(frames, cine.times_s().to_vec(), cine.period_s())
}

/// Labels drawn on displaced slices, moved with them; `grid` is that of the images, the labels may lie on another one.
pub fn correct_label_shifts(labels: &LabelMap, grid: &Grid, shifts: &SliceShifts) -> LabelMap {
    let along = |axis: usize| grid.voxel_to_world().fixed_view::<3, 1>(0, axis).normalize();
    let (along_i, along_j) = (along(0), along(1));
    let label = |flat: usize| {
        let position_mm = labels.grid().to_world_mm(&Vector3::from(labels.grid().voxel_of(flat).map(|n| n as f64)));
        let slice = grid.to_voxel(&position_mm).z.round();
        let shift_mm = if slice >= 0.0 { shifts.shift_mm.get(slice as usize).copied().flatten() } else { None }.unwrap_or_default();
        labels.at_position(&(position_mm + along_i * shift_mm.x + along_j * shift_mm.y)).unwrap_or(0)
    };
    labels.with_labels((0..labels.grid().voxel_count()).map(label).collect())
}

fn shifted_slice(frame: &Volume, slice: usize, shift_pixels: Vector2<f64>) -> Vec<f32> {
    let grid: &Grid = frame.grid();
    let [ni, nj, _] = grid.shape();
    let value = |flat: usize| {
        let at = Vector2::new((flat % ni) as f64, (flat / ni) as f64) + shift_pixels;
        let (x, y) = (at.x.clamp(0.0, (ni - 1) as f64), at.y.clamp(0.0, (nj - 1) as f64));
        let (i, j) = (x as usize, y as usize);
        let (next_i, next_j) = ((i + 1).min(ni - 1), (j + 1).min(nj - 1));
        let (u, v) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let row = |j: usize| frame.at([i, j, slice]) + u * (frame.at([next_i, j, slice]) - frame.at([i, j, slice]));
        row(j) + v * (row(next_j) - row(j))
    };
    (0..ni * nj).map(value).collect()
}

#[cfg(test)]
mod tests;
