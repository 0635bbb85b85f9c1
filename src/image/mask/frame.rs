//! The slices' own coordinates: pixels of the region in which the heart lies, and the height along the axis of the slices.

use nalgebra::{Vector2, Vector3};

use super::slices::{LabelledSlice, SliceStack, count};
use super::{BaseCut, FieldOptions, Plane};
use crate::image::Grid;

/// Pixels of the region, and height in mm along the axis from the most apical slice to the base.
pub(super) struct SliceFrame<'a> {
    pub(super) grid: &'a Grid,
    pub(super) shape: [usize; 2],
    first_pixel: [isize; 2],
    first_index: f64,
    /// Slice indices per mm of height, signed.
    pub(super) index_per_mm: f64,
    /// Unit vector of rising height.
    pub(super) axis: Vector3<f64>,
    /// Heights of the slices, ascending.
    pub(super) heights_mm: Vec<f64>,
    pub(super) base_height_mm: f64,
}

impl<'a> SliceFrame<'a> {
    pub(super) fn new(grid: &'a Grid, stack: &SliceStack, options: &FieldOptions) -> Self {
        let indices: Vec<f64> = stack.slices.iter().map(|slice| slice.index as f64).collect();
        let direction = (indices[indices.len() - 1] - indices[0]).signum();
        let gap_mm = grid.spacing_mm().z;
        let column = grid.voxel_to_world().fixed_view::<3, 1>(0, 2).into_owned();
        let heights_mm: Vec<f64> = indices.iter().map(|index| (index - indices[0]).abs() * gap_mm).collect();
        let top_mm = heights_mm[heights_mm.len() - 1];
        let base_height_mm = match options.base {
            BaseCut::OuterFace | BaseCut::Plane(_) => top_mm + 0.5 * gap_mm,
            BaseCut::MidSlice => top_mm,
        };
        Self {
            grid,
            shape: stack.shape,
            first_pixel: stack.first_pixel,
            first_index: indices[0],
            index_per_mm: direction / gap_mm,
            axis: column * (direction / gap_mm),
            heights_mm,
            base_height_mm,
        }
    }

    pub(super) fn to_world_mm(&self, pixel: Vector2<f64>, height_mm: f64) -> Vector3<f64> {
        let [first_i, first_j] = self.first_pixel.map(|n| n as f64);
        self.grid.to_world_mm(&Vector3::new(first_i + pixel.x, first_j + pixel.y, self.first_index + self.index_per_mm * height_mm))
    }

    pub(super) fn centre_of(&self, mask: &[bool]) -> Vector2<f64> {
        let pixel = |flat: usize| Vector2::new((flat % self.shape[0]) as f64, (flat / self.shape[0]) as f64);
        let sum: Vector2<f64> = (0..mask.len()).filter(|&flat| mask[flat]).map(pixel).sum();
        sum / count(mask).max(1) as f64
    }

    /// Parallel to the slices, where they end at the base.
    pub(super) fn base_plane(&self) -> Plane {
        let column = |axis: usize| self.grid.voxel_to_world().fixed_view::<3, 1>(0, axis).into_owned();
        let across = column(0).cross(&column(1)).normalize();
        let normal = if across.dot(&self.axis) < 0.0 { -across } else { across };
        let middle = Vector2::new(0.5 * self.shape[0] as f64, 0.5 * self.shape[1] as f64);
        Plane { point_mm: self.to_world_mm(middle, self.base_height_mm), normal }
    }

    /// Volume (mL) of the labels below a plane: whole pixels, of every slice the part of its thickness that lies below.
    pub(super) fn volume_below_ml(&self, stack: &SliceStack, plane: &Plane, pixels: fn(&LabelledSlice) -> Vec<bool>) -> f64 {
        let gap_mm = self.grid.spacing_mm().z;
        let thickness_mm = plane.normal.dot(&self.axis) * gap_mm;
        let share = |flat: usize, height_mm: f64| {
            let pixel = Vector2::new((flat % self.shape[0]) as f64, (flat / self.shape[0]) as f64);
            (0.5 - plane.signed_distance_mm(&self.to_world_mm(pixel, height_mm)) / thickness_mm).clamp(0.0, 1.0)
        };
        let of_slice = |(slice, &height_mm): (&LabelledSlice, &f64)| {
            let mask = pixels(slice);
            (0..mask.len()).filter(|&flat| mask[flat]).map(|flat| share(flat, height_mm)).sum::<f64>()
        };
        let voxels: f64 = stack.slices.iter().zip(&self.heights_mm).map(of_slice).sum();
        voxels * self.grid.voxel_volume_mm3() / 1000.0
    }
}
