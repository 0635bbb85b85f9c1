//! Where a scanner would put its short-axis slices.

use nalgebra::{Matrix4, Vector3};

use super::PhantomError;
use super::error::within;
use crate::anatomy::Anatomy;
use crate::image::Grid;

/// Slices across the long axis, from beyond the apex to beyond the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShortAxisStack {
    /// Size of a voxel in the slice, mm.
    pub voxel_mm: f64,
    /// Distance between slices, mm.
    pub slice_distance_mm: f64,
    /// Space left around the heart in the slice, mm.
    pub margin_mm: f64,
    /// Space left beyond apex and base, mm.
    pub end_margin_mm: f64,
}

impl Default for ShortAxisStack {
    fn default() -> Self {
        Self { voxel_mm: 1.5, slice_distance_mm: 8.0, margin_mm: 25.0, end_margin_mm: 16.0 }
    }
}

impl ShortAxisStack {
    /// The grid around a heart at rest: k runs from apex to base, i towards the left of the septum's direction (septum at small i).
    ///
    /// # Errors
    /// [`PhantomError::Setting`] if a length is out of range, [`PhantomError::Image`] if the axes of the heart are degenerate.
    pub fn grid(&self, anatomy: &Anatomy) -> Result<Grid, PhantomError> {
        let size_range = "lie between 0.1 and 100 mm";
        within("the voxel size in mm", self.voxel_mm, [0.1, 100.0], size_range)?;
        within("the slice distance in mm", self.slice_distance_mm, [0.1, 100.0], size_range)?;
        within("the margin in mm", self.margin_mm, [0.0, 500.0], "lie between 0 and 500 mm")?;
        within("the end margin in mm", self.end_margin_mm, [0.0, 500.0], "lie between 0 and 500 mm")?;
        let along_k = anatomy.axes.long_axis;
        let along_i = -anatomy.axes.septal_direction;
        let axes = [along_i, along_k.cross(&along_i), along_k];
        let spacing_mm = [self.voxel_mm, self.voxel_mm, self.slice_distance_mm];
        let margin_mm = [self.margin_mm, self.margin_mm, self.end_margin_mm];
        let mut shape = [0; 3];
        let mut first_mm = Vector3::zeros();
        let mut affine = Matrix4::identity();
        for axis in 0..3 {
            let places = anatomy.mesh.vertices_mm().iter().map(|v| v.dot(&axes[axis]));
            let (low, high) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
            let count = ((high - low + 2.0 * margin_mm[axis]) / spacing_mm[axis]).ceil().max(0.0) + 1.0;
            shape[axis] = count as usize;
            first_mm += axes[axis] * (0.5 * (low + high) - 0.5 * (count - 1.0) * spacing_mm[axis]);
            affine.fixed_view_mut::<3, 1>(0, axis).copy_from(&(axes[axis] * spacing_mm[axis]));
        }
        affine.fixed_view_mut::<3, 1>(0, 3).copy_from(&first_mm);
        Ok(Grid::new(shape, affine)?)
    }
}
