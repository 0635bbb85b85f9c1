//! The image at one instant as the boundary search sees it: cine values with a margin of half a voxel, and gradients over a voxel.

use nalgebra::{Matrix3, Vector3};

use crate::image::{CineInstant, CineSequence, Grid};

/// A cine sequence at one time, linear between frames and periodic, \[Billet2009\] §4.1.
#[derive(Debug, Clone, Copy)]
pub struct ImageInstant<'a> {
    cine: CineInstant<'a>,
    voxel_axes_mm: Matrix3<f64>,
    world_to_voxel: Matrix3<f64>,
}

impl<'a> ImageInstant<'a> {
    /// The images of `cine` at `time_s`.
    pub fn new(cine: &'a CineSequence, time_s: f64) -> Self {
        let grid = cine.grid();
        let voxel_axes_mm = grid.voxel_to_world().fixed_view::<3, 3>(0, 0).into_owned();
        Self { cine: cine.at_time(time_s), voxel_axes_mm, world_to_voxel: grid.world_to_voxel_linear() }
    }

    /// Intensity at a world position (mm). A voxel reaches half its width beyond its centre: within that margin the outermost
    /// value stands, which matters at the first and last of few thick slices. Nothing further out.
    pub fn value(&self, position_mm: &Vector3<f64>) -> Option<f64> {
        self.cine.sample(position_mm).or_else(|| self.cine.sample(&clamped_to_centres(self.cine.grid(), position_mm)?))
    }

    /// Gradient of the intensity (1/mm, world axes), from values one voxel to either side along each axis of the grid: smooth where
    /// the gradient of the trilinear interpolant jumps. With A the linear part of the voxel-to-world map, $\nabla I = A^{-T} \nabla_{ijk} I$.
    pub fn gradient_per_mm(&self, position_mm: &Vector3<f64>) -> Option<Vector3<f64>> {
        let middle = self.value(position_mm)?;
        let mut slope = Vector3::zeros();
        for axis in 0..3 {
            let step = self.voxel_axes_mm.column(axis);
            // At the border of the image a one-sided difference remains.
            slope[axis] = match (self.value(&(position_mm - step)), self.value(&(position_mm + step))) {
                (Some(before), Some(after)) => 0.5 * (after - before),
                (Some(before), None) => middle - before,
                (None, Some(after)) => after - middle,
                (None, None) => 0.0,
            };
        }
        Some(self.world_to_voxel.transpose() * slope)
    }

    /// Unit normal of the slices (the planes of constant k) and by how much the distance between them exceeds the voxels in them, mm.
    pub fn slice_normal_and_excess_mm(&self) -> (Vector3<f64>, f64) {
        let row = self.world_to_voxel.row(2).transpose();
        let in_slice_mm = self.voxel_axes_mm.column(0).norm().max(self.voxel_axes_mm.column(1).norm());
        (row.normalize(), (1.0 / row.norm() - in_slice_mm).max(0.0))
    }
}

/// The nearest point of the box of voxel centres, if it is no further than half a voxel along each axis.
pub(super) fn clamped_to_centres(grid: &Grid, position_mm: &Vector3<f64>) -> Option<Vector3<f64>> {
    let voxel = grid.to_voxel(position_mm);
    let last = Vector3::from(grid.shape().map(|n| n as f64 - 1.0));
    let clamped = voxel.zip_map(&last, |v, last| v.clamp(0.0, last));
    ((voxel - clamped).amax() <= 0.5).then(|| grid.to_world_mm(&clamped))
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
        let (normal, excess_mm) = instant.slice_normal_and_excess_mm();
        assert!((excess_mm - 7.6).abs() < 1e-12 && (normal - rotation.fixed_view::<3, 1>(0, 2)).norm() < 1e-12);
        assert!(instant.value(&grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.6))).is_none());
        let last = grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.0));
        let beyond = instant.value(&grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.4))).unwrap();
        assert!((beyond - slope.dot(&last)).abs() < 1e-4);
    }
}
