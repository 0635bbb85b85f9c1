//! One 3-D image: intensities or labels on a grid.

use nalgebra::Vector3;

use super::{Grid, ImageError};

/// Intensities on a grid, i fastest. All values are finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    grid: Grid,
    values: Vec<f32>,
}

impl Volume {
    /// Keeps `values` (i fastest) on `grid`.
    ///
    /// # Errors
    /// [`ImageError::ValueCount`] or [`ImageError::NonFinite`] (frame 0).
    pub fn new(grid: Grid, values: Vec<f32>) -> Result<Self, ImageError> {
        check_count(&grid, values.len())?;
        if let Some(flat) = values.iter().position(|v| !v.is_finite()) {
            return Err(ImageError::NonFinite { frame: 0, voxel: grid.voxel_of(flat) });
        }
        Ok(Self { grid, values })
    }

    /// Where the voxels lie.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The values, i fastest.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The values alone.
    pub(super) fn into_values(self) -> Vec<f32> {
        self.values
    }

    /// The mean with another volume on the same grid, of which the other has this share.
    pub(super) fn mixed_with(&self, other: &Self, share: f32) -> Self {
        let values = self.values.iter().zip(&other.values).map(|(own, other)| (1.0 - share) * own + share * other).collect();
        Self { grid: self.grid.clone(), values }
    }

    /// The value at a voxel.
    pub fn at(&self, voxel: [usize; 3]) -> f32 {
        self.values[self.grid.flat_index(voxel)]
    }
}

/// Integer codes on a grid, i fastest; 0 is background.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelMap {
    grid: Grid,
    labels: Vec<u8>,
}

impl LabelMap {
    /// Keeps `labels` (i fastest) on `grid`.
    ///
    /// # Errors
    /// [`ImageError::ValueCount`].
    pub fn new(grid: Grid, labels: Vec<u8>) -> Result<Self, ImageError> {
        check_count(&grid, labels.len())?;
        Ok(Self { grid, labels })
    }

    /// Where the voxels lie.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The codes, i fastest.
    pub fn labels(&self) -> &[u8] {
        &self.labels
    }

    /// The code at a voxel.
    pub fn at(&self, voxel: [usize; 3]) -> u8 {
        self.labels[self.grid.flat_index(voxel)]
    }

    /// The code of the voxel around a world position (mm); `None` outside.
    pub fn at_position(&self, position_mm: &Vector3<f64>) -> Option<u8> {
        let voxel = self.grid.to_voxel(position_mm).map(f64::round);
        let inside = (0..3).all(|axis| voxel[axis] >= 0.0 && voxel[axis] < self.grid.shape()[axis] as f64);
        inside.then(|| self.at([voxel.x as usize, voxel.y as usize, voxel.z as usize]))
    }

    /// Other labels on the same grid; there are as many.
    pub(super) fn with_labels(&self, labels: Vec<u8>) -> Self {
        debug_assert_eq!(labels.len(), self.labels.len());
        Self { grid: self.grid.clone(), labels }
    }

    /// The same labels in some slices (index k) only, background elsewhere.
    pub fn slices(&self, kept: std::ops::Range<usize>) -> Self {
        let in_slice = self.grid.shape()[0] * self.grid.shape()[1];
        let label = |(flat, label): (usize, &u8)| if kept.contains(&(flat / in_slice)) { *label } else { 0 };
        self.with_labels(self.labels.iter().enumerate().map(label).collect())
    }

    /// Number of voxels with a code.
    pub fn count(&self, code: u8) -> usize {
        self.labels.iter().filter(|&&label| label == code).count()
    }
}

fn check_count(grid: &Grid, value_count: usize) -> Result<(), ImageError> {
    let expected = grid.voxel_count();
    if value_count == expected { Ok(()) } else { Err(ImageError::ValueCount { shape: grid.shape(), value_count, expected }) }
}
