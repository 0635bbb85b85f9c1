//! The cine sequence at one instant: intensities linear between frames and trilinear between voxels, [Billet2009] §4.1.

use nalgebra::{Matrix3, Vector3};

use crate::image::{CineSequence, Volume};

/// A cine sequence at one time. Frames are periodic; between two frames at $t_a \le t < t_b$ the image is
/// $I(x, t) = (1 - w) I_a(x) + w I_b(x)$ with $w = (t - t_a)/(t_b - t_a)$.
#[derive(Debug, Clone, Copy)]
pub struct CineInstant<'a> {
    earlier: &'a Volume,
    later: &'a Volume,
    weight: f64,
}

impl<'a> CineInstant<'a> {
    /// The images of `cine` at `time_s`.
    pub fn new(cine: &'a CineSequence, time_s: f64) -> Self {
        let (earlier, later, weight) = cine.frames_around(time_s);
        Self { earlier: &cine.frames()[earlier], later: &cine.frames()[later], weight }
    }

    /// One frame alone, without interpolation in time.
    pub fn of_frame(frame: &'a Volume) -> Self {
        Self { earlier: frame, later: frame, weight: 0.0 }
    }

    /// Intensity at a world position (mm), or nothing outside the voxels (a voxel reaches half its width beyond its centre).
    pub fn value(&self, position_mm: &Vector3<f64>) -> Option<f64> {
        self.value_at_voxel(&self.earlier.grid().to_voxel(position_mm))
    }

    /// Gradient of the intensity (1/mm) in world axes at a position, from differences one voxel to either side along each axis
    /// of the grid, so that it is smooth where the trilinear interpolant has kinks; nothing outside the voxels.
    ///
    /// $\nabla I = A^{-T} \nabla_{ijk} I$ with $A$ the linear part of the voxel-to-world map.
    pub fn gradient_per_mm(&self, position_mm: &Vector3<f64>) -> Option<Vector3<f64>> {
        let grid = self.earlier.grid();
        let voxel = grid.to_voxel(position_mm);
        self.value_at_voxel(&voxel)?;
        let shape = grid.shape();
        let mut slope = Vector3::zeros();
        for axis in 0..3 {
            let (mut before, mut after) = (voxel, voxel);
            let last = shape[axis] as f64 - 1.0;
            before[axis] = (voxel[axis] - 1.0).clamp(0.0, last);
            after[axis] = (voxel[axis] + 1.0).clamp(0.0, last);
            let width = after[axis] - before[axis];
            if width > 0.0 {
                slope[axis] = (self.value_at_voxel(&after)? - self.value_at_voxel(&before)?) / width;
            }
        }
        let to_voxel: Matrix3<f64> = grid.world_to_voxel_linear();
        Some(to_voxel.transpose() * slope)
    }

    /// Unit normal of the slices (the k axis of the grid's faces) and the distance between them, mm.
    pub fn slice_normal_and_spacing_mm(&self) -> (Vector3<f64>, f64) {
        let row = self.earlier.grid().world_to_voxel_linear().row(2).transpose();
        (row.normalize(), 1.0 / row.norm())
    }

    fn value_at_voxel(&self, voxel: &Vector3<f64>) -> Option<f64> {
        let stencil = Trilinear::at(self.earlier.grid().shape(), voxel)?;
        let earlier = stencil.apply(self.earlier.values());
        if self.weight == 0.0 {
            return Some(earlier);
        }
        Some(earlier + self.weight * (stencil.apply(self.later.values()) - earlier))
    }
}

/// The eight voxels around a point and their weights; constant beyond the outer voxel centres, by half a voxel.
struct Trilinear {
    corner: [[usize; 2]; 3],
    fraction: [f64; 3],
}

impl Trilinear {
    fn at(shape: [usize; 3], voxel: &Vector3<f64>) -> Option<Self> {
        let mut corner = [[0; 2]; 3];
        let mut fraction = [0.0; 3];
        for axis in 0..3 {
            let last = shape[axis] as f64 - 1.0;
            if !(-0.5..=last + 0.5).contains(&voxel[axis]) {
                return None;
            }
            let index = voxel[axis].clamp(0.0, last);
            let low = (index as usize).min(shape[axis].saturating_sub(2));
            let stride: usize = shape[..axis].iter().product();
            corner[axis] = [low * stride, (low + 1).min(shape[axis] - 1) * stride];
            fraction[axis] = index - low as f64;
        }
        Some(Self { corner, fraction })
    }

    fn apply(&self, values: &[f32]) -> f64 {
        let [[i0, i1], [j0, j1], [k0, k1]] = self.corner;
        let [u, v, w] = self.fraction;
        let along_i = |offset: usize| {
            let low = f64::from(values[i0 + offset]);
            low + u * (f64::from(values[i1 + offset]) - low)
        };
        let along_j = |offset: usize| {
            let low = along_i(j0 + offset);
            low + v * (along_i(j1 + offset) - low)
        };
        let low = along_j(k0);
        low + w * (along_j(k1) - low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Grid;
    use nalgebra::Matrix4;

    /// Trilinear interpolation is exact on affine functions, also through an oblique, anisotropic affine map, and so is time.
    #[test]
    fn affine_intensities_are_exact_in_space_and_time() {
        let rotation = Matrix4::from_euler_angles(0.3, -0.2, 0.5);
        let affine = Matrix4::new_translation(&Vector3::new(3.0, -7.0, 11.0))
            * rotation
            * Matrix4::new_nonuniform_scaling(&Vector3::new(1.3, 1.4, 9.0));
        let grid = Grid::new([8, 9, 5], affine).unwrap();
        let slope = Vector3::new(0.7, -1.1, 0.4);
        let frame = |offset: f64| {
            let at = |flat: usize| {
                let voxel = grid.voxel_of(flat).map(|n| n as f64);
                (slope.dot(&grid.to_world_mm(&Vector3::from(voxel))) + offset) as f32
            };
            Volume::new(grid.clone(), (0..grid.voxel_count()).map(at).collect()).unwrap()
        };
        let cine = CineSequence::new(vec![frame(0.0), frame(8.0)], vec![0.0, 0.4], 1.0).unwrap();
        let instant = CineInstant::new(&cine, 0.1);
        let point = grid.to_world_mm(&Vector3::new(3.3, 4.8, 2.4));
        assert!((instant.value(&point).unwrap() - slope.dot(&point) - 2.0).abs() < 1e-5);
        assert!((instant.gradient_per_mm(&point).unwrap() - slope).norm() < 1e-5);
        let (normal, spacing_mm) = instant.slice_normal_and_spacing_mm();
        assert!((spacing_mm - 9.0).abs() < 1e-12 && (normal - rotation.fixed_view::<3, 1>(0, 2)).norm() < 1e-12);
        assert!(instant.value(&grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.6))).is_none());
        assert!(instant.value(&grid.to_world_mm(&Vector3::new(3.0, 4.0, 4.4))).is_some());
    }
}
