//! Trilinear values and world-space gradients of images between voxels, and of a cine sequence between frames (\[Billet2009\] §3, §4.1).
//!
//! In the cell of the voxel (i, j, k) with local coordinates u ∈ \[0, 1\]³
//!
//! $$ I(u) = \sum_{abc \in \{0,1\}} I_{i+a,j+b,k+c}\, w_a(u_1)\,w_b(u_2)\,w_c(u_3), \qquad w_0(t) = 1-t,\; w_1(t) = t $$
//!
//! and ∇ₓI = Aᵀ ∇ᵤI with A the linear part of the map from world to voxels. The gradient is that of the interpolant itself: exact within a
//! cell, discontinuous between cells. In time the interpolant is linear between the two frames around and periodic.

use nalgebra::Vector3;

use super::{CineSequence, Grid, Volume};

/// The eight voxels around a point and where the point lies between them.
#[derive(Debug, Clone, Copy)]
struct Cell {
    first: usize,
    stride: [usize; 3],
    local: [f64; 3],
}

impl Cell {
    /// `None` if the point is not within the box of the voxel centres. An axis of one voxel is hit only at its centre.
    #[inline]
    fn around(grid: &Grid, position_mm: &Vector3<f64>) -> Option<Self> {
        Self::at(grid.shape(), &grid.to_voxel(position_mm))
    }

    /// The same for a continuous voxel index in an image of a shape.
    #[inline]
    fn at(shape: [usize; 3], voxel: &Vector3<f64>) -> Option<Self> {
        let steps = [1, shape[0], shape[0] * shape[1]];
        let mut cell = Self { first: 0, stride: [0; 3], local: [0.0; 3] };
        for axis in 0..3 {
            // Rounding of the affine map must not push the outermost voxel centres out; NaN fails both comparisons.
            const ROUNDING_VOXELS: f64 = 1e-9;
            let last = shape[axis].checked_sub(1)?;
            if !(voxel[axis] >= -ROUNDING_VOXELS && voxel[axis] <= last as f64 + ROUNDING_VOXELS) {
                return None;
            }
            let lower = (voxel[axis].max(0.0) as usize).min(last.saturating_sub(1));
            cell.first += lower * steps[axis];
            cell.stride[axis] = if last == 0 { 0 } else { steps[axis] };
            cell.local[axis] = (voxel[axis] - lower as f64).clamp(0.0, 1.0);
        }
        Some(cell)
    }

    #[inline]
    fn corners(&self, values: &[f32]) -> [f64; 8] {
        let [si, sj, sk] = self.stride;
        let first = self.first;
        let at = |offset: usize| f64::from(values[first + offset]);
        [at(0), at(si), at(sj), at(si + sj), at(sk), at(si + sk), at(sj + sk), at(si + sj + sk)]
    }

    #[inline]
    fn value(&self, values: &[f32]) -> f64 {
        let [u, v, w] = self.local;
        let c = self.corners(values);
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        mix(mix(mix(c[0], c[1], u), mix(c[2], c[3], u), v), mix(mix(c[4], c[5], u), mix(c[6], c[7], u), v), w)
    }

    /// Value and gradient with respect to voxel indices.
    #[inline]
    fn value_and_index_gradient(&self, values: &[f32]) -> (f64, Vector3<f64>) {
        let [u, v, w] = self.local;
        let c = self.corners(values);
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        let along_i = [c[1] - c[0], c[3] - c[2], c[5] - c[4], c[7] - c[6]];
        let on_i = [c[0] + u * along_i[0], c[2] + u * along_i[1], c[4] + u * along_i[2], c[6] + u * along_i[3]];
        let on_j = [mix(on_i[0], on_i[1], v), mix(on_i[2], on_i[3], v)];
        let gradient = Vector3::new(
            mix(mix(along_i[0], along_i[1], v), mix(along_i[2], along_i[3], v), w),
            mix(on_i[1] - on_i[0], on_i[3] - on_i[2], w),
            on_j[1] - on_j[0],
        );
        (mix(on_j[0], on_j[1], w), gradient)
    }
}

impl Volume {
    /// Trilinear value at a world position (mm); `None` outside the box of the voxel centres.
    #[inline]
    pub fn sample(&self, position_mm: &Vector3<f64>) -> Option<f64> {
        Some(Cell::around(self.grid(), position_mm)?.value(self.values()))
    }

    /// Trilinear value at a continuous voxel index; `None` outside the box of the voxel centres. For many samples along a line, whose
    /// places in the grid are found once.
    #[inline]
    pub fn sample_at_voxel(&self, voxel: &Vector3<f64>) -> Option<f64> {
        Some(Cell::at(self.grid().shape(), voxel)?.value(self.values()))
    }

    /// Trilinear value and its gradient (per mm, world axes) at a world position (mm); `None` outside the box of the voxel centres.
    #[inline]
    pub fn sample_with_gradient(&self, position_mm: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        let (value, gradient) = Cell::around(self.grid(), position_mm)?.value_and_index_gradient(self.values());
        Some((value, self.grid().index_gradient_to_world(&gradient)))
    }
}

impl CineSequence {
    /// The image at `time_s` (s after the trigger; periodic): the two frames around it, mixed linearly voxel by voxel, so that every value
    /// between its voxels is read once and not from both frames. In single precision, as the frames themselves.
    pub fn at_time(&self, time_s: f64) -> Volume {
        let (earlier, later, later_weight) = self.frames_around(time_s);
        self.frames()[earlier].mixed_with(&self.frames()[later], later_weight as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Rotation3};

    fn oblique_grid() -> Grid {
        let rotation = Rotation3::from_euler_angles(0.3, -0.7, 1.1).to_homogeneous();
        // Left-handed on purpose: scanners write such affines.
        let scale = Matrix4::new_nonuniform_scaling(&Vector3::new(-1.2, 1.4, 8.0));
        Grid::new([9, 8, 5], Matrix4::new_translation(&Vector3::new(-30.0, 12.0, 4.0)) * rotation * scale).unwrap()
    }

    fn filled(grid: &Grid, field: impl Fn(Vector3<f64>) -> f64) -> Volume {
        let value = |flat| {
            let [i, j, k] = grid.voxel_of(flat);
            field(grid.to_world_mm(&Vector3::new(i as f64, j as f64, k as f64))) as f32
        };
        Volume::new(grid.clone(), (0..grid.voxel_count()).map(value).collect()).unwrap()
    }

    /// Points spread over the inside of the grid, none on a cell face.
    fn inner_points(grid: &Grid) -> Vec<Vector3<f64>> {
        let spread = |seed: f64, n: usize| (seed * 0.618_033_988_75).fract() * (n as f64 - 1.2) + 0.1;
        let [ni, nj, nk] = grid.shape();
        (1..60).map(f64::from).map(|s| grid.to_world_mm(&Vector3::new(spread(s, ni), spread(s * 1.7, nj), spread(s * 2.9, nk)))).collect()
    }

    #[test]
    fn linear_fields_and_their_gradients_are_exact_under_an_oblique_affine() {
        let grid = oblique_grid();
        let slope = Vector3::new(0.7, -1.3, 0.25);
        let volume = filled(&grid, |x| 5.0 + slope.dot(&x));
        for point in inner_points(&grid) {
            let (value, gradient) = volume.sample_with_gradient(&point).unwrap();
            // f32 storage of values of order 100: 1e-5 relative.
            assert!((value - 5.0 - slope.dot(&point)).abs() < 1e-4);
            assert!((gradient - slope).norm() < 1e-4);
            assert_eq!(volume.sample(&point), Some(value));
        }
    }

    #[test]
    fn gradient_is_the_derivative_of_the_value() {
        let grid = oblique_grid();
        let volume = filled(&grid, |x| 100.0 * (0.2 * x.x).sin() * (0.15 * x.y).cos() + 0.3 * x.z * x.z);
        let cine = CineSequence::new(vec![volume.clone(), filled(&grid, |x| x.norm())], vec![0.0, 0.5], 1.0).unwrap();
        let instant = cine.at_time(0.2);
        // The interpolant is trilinear within a cell, so central differences are exact up to rounding unless they leave the cell.
        let step_mm = 1e-5;
        for point in inner_points(&grid) {
            let (_, gradient) = volume.sample_with_gradient(&point).unwrap();
            let (_, cine_gradient) = instant.sample_with_gradient(&point).unwrap();
            for axis in 0..3 {
                let offset = Vector3::ith(axis, step_mm);
                let slope = |ahead: f64, behind: f64| (ahead - behind) / (2.0 * step_mm);
                let difference = slope(volume.sample(&(point + offset)).unwrap(), volume.sample(&(point - offset)).unwrap());
                assert!((difference - gradient[axis]).abs() < 1e-6 * (1.0 + gradient.norm()));
                let difference = slope(instant.sample(&(point + offset)).unwrap(), instant.sample(&(point - offset)).unwrap());
                assert!((difference - cine_gradient[axis]).abs() < 1e-6 * (1.0 + cine_gradient.norm()));
            }
        }
    }

    #[test]
    fn voxel_centres_give_their_own_values_up_to_the_border_and_nothing_beyond() {
        let grid = oblique_grid();
        let volume = filled(&grid, |x| x.x * x.y - x.z);
        let [ni, nj, nk] = grid.shape();
        for voxel in [[0, 0, 0], [ni - 1, nj - 1, nk - 1], [ni - 1, 0, 2], [3, 4, 1]] {
            let at = Vector3::from_fn(|axis, _| voxel[axis] as f64);
            let value = volume.sample(&grid.to_world_mm(&at)).unwrap();
            assert!((value - f64::from(volume.at(voxel))).abs() < 1e-3);
        }
        assert_eq!(volume.sample(&grid.to_world_mm(&Vector3::new(-0.01, 1.0, 1.0))), None);
        assert_eq!(volume.sample(&grid.to_world_mm(&Vector3::new(1.0, 1.0, nk as f64 - 0.99))), None);
        assert_eq!(volume.sample(&Vector3::new(f64::NAN, 0.0, 0.0)), None);
        assert_eq!(volume.sample(&Vector3::repeat(f64::INFINITY)), None);
    }

    #[test]
    fn time_is_linear_between_frames_and_wraps() {
        let grid = oblique_grid();
        let (first, second) = (filled(&grid, |_| 10.0), filled(&grid, |_| 30.0));
        let cine = CineSequence::new(vec![first, second], vec![0.1, 0.5], 1.0).unwrap();
        let point = inner_points(&grid)[0];
        for (time_s, expected) in [(0.1, 10.0), (0.2, 15.0), (0.5, 30.0), (0.8, 20.0), (1.2, 15.0), (-0.2, 20.0)] {
            assert!((cine.at_time(time_s).sample(&point).unwrap() - expected).abs() < 1e-9, "at {time_s} s");
        }
    }
}
