//! Where the voxels of an image lie in the world.

use nalgebra::{Matrix4, Vector3, Vector4};

use super::ImageError;

/// A regular grid of voxels and its affine map to world coordinates (RAS, mm). Voxel centres have integer indices.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    shape: [usize; 3],
    voxel_to_world: Matrix4<f64>,
    world_to_voxel: Matrix4<f64>,
}

impl Grid {
    /// A grid of `shape` voxels (i, j, k) with the affine `voxel_to_world` (index → mm, last row 0 0 0 1).
    ///
    /// # Errors
    /// [`ImageError::SingularAffine`] if the map cannot be inverted, [`ImageError::EmptyGrid`] if a side has no voxels.
    pub fn new(shape: [usize; 3], voxel_to_world: Matrix4<f64>) -> Result<Self, ImageError> {
        if shape.contains(&0) {
            return Err(ImageError::EmptyGrid { shape });
        }
        let world_to_voxel = voxel_to_world.try_inverse().ok_or(ImageError::SingularAffine)?;
        if !voxel_to_world.iter().chain(world_to_voxel.iter()).all(|x| x.is_finite()) {
            return Err(ImageError::SingularAffine);
        }
        Ok(Self { shape, voxel_to_world, world_to_voxel })
    }

    /// An axis-aligned grid with its first voxel's centre at `origin_mm`.
    ///
    /// # Errors
    /// [`ImageError::SingularAffine`] if a spacing is zero or not finite.
    pub fn axis_aligned(shape: [usize; 3], origin_mm: Vector3<f64>, spacing_mm: Vector3<f64>) -> Result<Self, ImageError> {
        let scale = Matrix4::new_nonuniform_scaling(&spacing_mm);
        Self::new(shape, Matrix4::new_translation(&origin_mm) * scale)
    }

    /// Voxels along i, j, k.
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Number of voxels.
    pub fn voxel_count(&self) -> usize {
        self.shape.iter().product()
    }

    /// The affine map from voxel index to world mm.
    pub fn voxel_to_world(&self) -> &Matrix4<f64> {
        &self.voxel_to_world
    }

    /// Distance between voxel centres along i, j, k, mm.
    pub fn spacing_mm(&self) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| self.voxel_to_world.fixed_view::<3, 1>(0, axis).norm())
    }

    /// Volume of a voxel, mm³.
    pub fn voxel_volume_mm3(&self) -> f64 {
        self.voxel_to_world.fixed_view::<3, 3>(0, 0).determinant().abs()
    }

    /// World position (mm) of a continuous voxel index.
    pub fn to_world_mm(&self, voxel: &Vector3<f64>) -> Vector3<f64> {
        (self.voxel_to_world * Vector4::new(voxel.x, voxel.y, voxel.z, 1.0)).xyz()
    }

    /// Continuous voxel index of a world position (mm).
    #[inline]
    pub fn to_voxel(&self, position_mm: &Vector3<f64>) -> Vector3<f64> {
        let (m, p) = (&self.world_to_voxel, position_mm);
        let row = |r: usize| m[(r, 0)] * p.x + m[(r, 1)] * p.y + m[(r, 2)] * p.z + m[(r, 3)];
        Vector3::new(row(0), row(1), row(2))
    }

    /// Gradient per mm in world axes of a gradient per voxel index: Aᵀ g with A the linear part of the map from world to voxels.
    #[inline]
    pub fn index_gradient_to_world(&self, gradient: &Vector3<f64>) -> Vector3<f64> {
        let (m, g) = (&self.world_to_voxel, gradient);
        let column = |c: usize| m[(0, c)] * g.x + m[(1, c)] * g.y + m[(2, c)] * g.z;
        Vector3::new(column(0), column(1), column(2))
    }

    /// The linear part of the map from world to voxels (3 × 3, 1/mm): gradients in world = its transpose times gradients in voxels.
    pub fn world_to_voxel_linear(&self) -> nalgebra::Matrix3<f64> {
        self.world_to_voxel.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// Position of voxel (i, j, k) in the flat array: i fastest.
    pub fn flat_index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.shape[0] * (j + self.shape[1] * k)
    }

    /// Voxel (i, j, k) of a position in the flat array.
    pub fn voxel_of(&self, flat: usize) -> [usize; 3] {
        let [ni, nj, _] = self.shape;
        [flat % ni, flat / ni % nj, flat / (ni * nj)]
    }
}
