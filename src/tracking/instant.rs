//! The image at one instant as the boundary search sees it: cine values with a margin of half a voxel, and gradients over a voxel.

use nalgebra::{Matrix3, Vector3};

use crate::image::{CineSequence, Grid, Volume};

/// A cine sequence at one time, linear between frames and periodic, \[Billet2009\] §4.1.
#[derive(Debug, Clone)]
pub struct ImageInstant {
    image: Volume,
    voxel_axes_mm: Matrix3<f64>,
    world_to_voxel: Matrix3<f64>,
}

impl ImageInstant {
    /// The images of `cine` at `time_s`.
    pub fn new(cine: &CineSequence, time_s: f64) -> Self {
        let grid = cine.grid();
        let voxel_axes_mm = grid.voxel_to_world().fixed_view::<3, 3>(0, 0).into_owned();
        Self { image: cine.at_time(time_s), voxel_axes_mm, world_to_voxel: grid.world_to_voxel_linear() }
    }

    /// Intensity at a world position (mm). A voxel reaches half its width beyond its centre: within that margin the outermost
    /// value stands, which matters at the first and last of few thick slices. Nothing further out.
    #[inline]
    pub fn value(&self, position_mm: &Vector3<f64>) -> Option<f64> {
        self.value_at_voxel(&self.image.grid().to_voxel(position_mm))
    }

    #[inline]
    fn value_at_voxel(&self, voxel: &Vector3<f64>) -> Option<f64> {
        self.image.sample_at_voxel(voxel).or_else(|| self.image.sample_at_voxel(&within_centres(self.image.grid(), voxel)?))
    }

    /// The intensities along a line through a point (mm).
    pub(super) fn line(&self, origin_mm: &Vector3<f64>, direction: &Vector3<f64>) -> ImageLine<'_> {
        ImageLine { instant: self, origin: self.image.grid().to_voxel(origin_mm), per_mm: self.world_to_voxel * direction }
    }

    /// Gradient of the intensity (1/mm, world axes), from values one voxel to either side along each axis of the grid: smooth where
    /// the gradient of the trilinear interpolant jumps. With A the linear part of the voxel-to-world map, $\nabla I = A^{-T} \nabla_{ijk} I$.
    pub fn gradient_per_mm(&self, position_mm: &Vector3<f64>) -> Option<Vector3<f64>> {
        let voxel = self.image.grid().to_voxel(position_mm);
        let middle = self.value_at_voxel(&voxel)?;
        let mut slope = Vector3::zeros();
        for axis in 0..3 {
            let step = Vector3::ith(axis, 1.0);
            // At the border of the image a one-sided difference remains.
            slope[axis] = match (self.value_at_voxel(&(voxel - step)), self.value_at_voxel(&(voxel + step))) {
                (Some(before), Some(after)) => 0.5 * (after - before),
                (Some(before), None) => middle - before,
                (None, Some(after)) => after - middle,
                (None, None) => 0.0,
            };
        }
        Some(self.world_to_voxel.transpose() * slope)
    }

    /// How the image resolves edges across planes, when it was acquired in slices `slice_distance_mm` apart along the grid's k axis
    /// (the grid's own distance if nothing is said; resampling hides the slices but does not sharpen them).
    pub fn resolution(&self, slice_distance_mm: Option<f64>) -> SliceResolution {
        let row = self.world_to_voxel.row(2).transpose();
        let pixel_mm = self.voxel_axes_mm.column(0).norm().max(self.voxel_axes_mm.column(1).norm());
        SliceResolution { normal: row.normalize(), distance_mm: slice_distance_mm.unwrap_or(1.0 / row.norm()).max(pixel_mm), pixel_mm }
    }
}

/// A line through an image: its place in the grid is found once for all its points.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImageLine<'a> {
    instant: &'a ImageInstant,
    origin: Vector3<f64>,
    per_mm: Vector3<f64>,
}

impl ImageLine<'_> {
    /// [`ImageInstant::value`] at a distance from the line's origin, mm.
    #[inline]
    pub(super) fn value(&self, distance_mm: f64) -> Option<f64> {
        self.instant.value_at_voxel(&(self.origin + self.per_mm * distance_mm))
    }
}

/// The slices that an image was acquired in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SliceResolution {
    /// Unit normal of the slices.
    pub normal: Vector3<f64>,
    /// Distance between slices, mm; at least a pixel.
    pub distance_mm: f64,
    /// Size of a pixel in the slice, mm.
    pub pixel_mm: f64,
}

impl SliceResolution {
    /// How sharp an edge across `normal` can be, relative to one in the slice: the pixel over the width of a voxel along the normal,
    /// $d_\text{pixel}/\sqrt{(d_\text{pixel}\cos\varphi)^2 + (d\sin\varphi)^2}$, φ the angle of the normal out of the slice.
    pub fn sharpness(&self, normal: &Vector3<f64>) -> f64 {
        let across = normal.dot(&self.normal).abs().min(1.0);
        self.pixel_mm / (self.pixel_mm.powi(2) * (1.0 - across * across) + (self.distance_mm * across).powi(2)).sqrt()
    }

    /// Error along `normal` of a boundary between thick slices, mm. The trilinear image shows there the boundaries of both slices
    /// blended, not the one between them. From slice to slice, $d$ apart, the boundary moves by $d \tan\varphi$ in the slice, which
    /// is $d \sin\varphi$ along the normal; the blend errs by about a quarter of that (the largest product of its weights), and
    /// voxels of the size of the pixels blur as much anyway: $e = \tfrac14 (d - d_\text{pixel}) |\sin\varphi|$.
    pub fn blend_error_mm(&self, normal: &Vector3<f64>) -> f64 {
        0.25 * (self.distance_mm - self.pixel_mm) * normal.dot(&self.normal).abs()
    }
}

/// The nearest point of the box of voxel centres, if it is no further than half a voxel along each axis.
pub(super) fn clamped_to_centres(grid: &Grid, position_mm: &Vector3<f64>) -> Option<Vector3<f64>> {
    within_centres(grid, &grid.to_voxel(position_mm)).map(|voxel| grid.to_world_mm(&voxel))
}

/// The same in continuous voxel indices.
fn within_centres(grid: &Grid, voxel: &Vector3<f64>) -> Option<Vector3<f64>> {
    let last = Vector3::from(grid.shape().map(|n| n as f64 - 1.0));
    let clamped = voxel.zip_map(&last, |v, last| v.clamp(0.0, last));
    ((voxel - clamped).amax() <= 0.5).then_some(clamped)
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::still;
    use super::*;
    use crate::image::Volume;
    use nalgebra::Matrix4;

    /// Affine intensities have exact gradients through an oblique, anisotropic affine map, and half a slice of margin.
    #[test]
    fn gradients_of_affine_intensities_are_exact_and_slices_reach_half_their_thickness_out() {
        let rotation = Matrix4::from_euler_angles(0.3, -0.2, 0.5);
        let scale = Matrix4::new_nonuniform_scaling(&Vector3::new(1.3, 1.4, 9.0));
        let grid = Grid::new([8, 9, 5], Matrix4::new_translation(&Vector3::new(3.0, -7.0, 11.0)) * rotation * scale).unwrap();
        let slope = Vector3::new(0.7, -1.1, 0.4);
        let at = |flat: usize| slope.dot(&grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|n| n as f64)))) as f32;
        let cine = still(Volume::new(grid.clone(), (0..grid.voxel_count()).map(at).collect()).unwrap());
        let instant = ImageInstant::new(&cine, 0.1);
        let point = grid.to_world_mm(&Vector3::new(3.3, 4.8, 2.4));
        assert!((instant.value(&point).unwrap() - slope.dot(&point)).abs() < 1e-4);
        assert!((instant.gradient_per_mm(&point).unwrap() - slope).norm() < 1e-4);
        let slices = instant.resolution(None);
        assert!((slices.distance_mm - 9.0).abs() < 1e-12 && (slices.normal - rotation.fixed_view::<3, 1>(0, 2)).norm() < 1e-12);
        assert!((slices.sharpness(&slices.normal) - 1.4 / 9.0).abs() < 1e-12);
        assert!((slices.blend_error_mm(&slices.normal) - 1.9).abs() < 1e-12);
        assert!(instant.value(&grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.6))).is_none());
        let last = grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.0));
        let beyond = instant.value(&grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.4))).unwrap();
        assert!((beyond - slope.dot(&last)).abs() < 1e-4);
    }
}
