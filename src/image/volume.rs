//! One 3-D image: intensities or labels on a grid.

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

    /// Number of voxels with a code.
    pub fn count(&self, code: u8) -> usize {
        self.labels.iter().filter(|&&label| label == code).count()
    }
}

fn check_count(grid: &Grid, value_count: usize) -> Result<(), ImageError> {
    let expected = grid.voxel_count();
    if value_count == expected { Ok(()) } else { Err(ImageError::ValueCount { shape: grid.shape(), value_count, expected }) }
}
