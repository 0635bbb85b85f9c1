//! Block-sparse matrices on a vertex graph: one 3 × 3 block a pair of neighbouring vertices, compressed by rows.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

/// Which pairs of vertices have a block. Symmetric, the diagonal included, columns ascending within a row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockPattern {
    row_starts: Vec<usize>,
    columns: Vec<usize>,
    diagonals: Vec<usize>,
}

impl BlockPattern {
    /// The pattern of a vertex graph: for every vertex its neighbours in any order, itself optional. An edge named by one of its
    /// ends only is stored both ways.
    ///
    /// # Panics
    /// Never for neighbours below `neighbours.len()`; others are ignored.
    pub fn from_neighbours(neighbours: &[Vec<usize>]) -> Self {
        let vertex_count = neighbours.len();
        let mut rows: Vec<Vec<usize>> = (0..vertex_count).map(|vertex| vec![vertex]).collect();
        for (vertex, list) in neighbours.iter().enumerate() {
            for &other in list.iter().filter(|&&other| other < vertex_count) {
                rows[vertex].push(other);
                rows[other].push(vertex);
            }
        }
        let mut pattern = Self { row_starts: vec![0], columns: Vec::new(), diagonals: Vec::with_capacity(vertex_count) };
        for (vertex, mut row) in rows.into_iter().enumerate() {
            row.sort_unstable();
            row.dedup();
            let before_diagonal = row.partition_point(|&column| column < vertex);
            pattern.diagonals.push(pattern.columns.len() + before_diagonal);
            pattern.columns.extend(row);
            pattern.row_starts.push(pattern.columns.len());
        }
        pattern
    }

    /// Number of vertices (block rows).
    pub fn vertex_count(&self) -> usize {
        self.diagonals.len()
    }

    /// Number of stored blocks, both triangles and the diagonal.
    pub fn block_count(&self) -> usize {
        self.columns.len()
    }

    /// Columns of a block row, ascending.
    pub fn columns_of(&self, row: usize) -> &[usize] {
        &self.columns[self.row_starts[row]..self.row_starts[row + 1]]
    }

    /// Where the block (row, column) is stored, if it is.
    pub fn position(&self, row: usize, column: usize) -> Option<usize> {
        self.columns_of(row).binary_search(&column).ok().map(|offset| self.row_starts[row] + offset)
    }

    pub(super) fn blocks_of(&self, row: usize) -> std::ops::Range<usize> {
        self.row_starts[row]..self.row_starts[row + 1]
    }
}

/// A matrix of 3 × 3 blocks; both triangles are stored. It is called symmetric where its users keep it so:
/// $A_{ij} = A_{ji}^\top$ is what [`super::CholeskyFactor`] relies on.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockMatrix {
    pattern: Arc<BlockPattern>,
    blocks: Vec<Matrix3<f64>>,
}

impl BlockMatrix {
    /// The zero matrix of a pattern.
    pub fn zeros(pattern: Arc<BlockPattern>) -> Self {
        let blocks = vec![Matrix3::zeros(); pattern.block_count()];
        Self { pattern, blocks }
    }

    /// Its pattern.
    pub fn pattern(&self) -> &Arc<BlockPattern> {
        &self.pattern
    }

    /// Blocks in the order of the pattern, row after row.
    pub fn blocks(&self) -> &[Matrix3<f64>] {
        &self.blocks
    }

    /// Sets every block to zero.
    pub fn clear(&mut self) {
        self.blocks.fill(Matrix3::zeros());
    }

    /// Copies the blocks of a matrix that has the same pattern.
    pub fn copy_from(&mut self, other: &Self) {
        self.blocks.copy_from_slice(&other.blocks);
    }

    /// Adds a block. Returns whether the pattern has it; if not, nothing is added.
    #[must_use = "a block outside the pattern is not added"]
    pub fn add_block(&mut self, row: usize, column: usize, block: &Matrix3<f64>) -> bool {
        match self.pattern.position(row, column) {
            Some(position) => {
                self.blocks[position] += block;
                true
            }
            None => false,
        }
    }

    /// Adds a block at a position that [`BlockPattern::position`] gave.
    pub fn add_block_at(&mut self, position: usize, block: &Matrix3<f64>) {
        self.blocks[position] += block;
    }

    /// Adds a block to the diagonal.
    pub fn add_to_diagonal(&mut self, vertex: usize, block: &Matrix3<f64>) {
        self.blocks[self.pattern.diagonals[vertex]] += block;
    }

    /// A block of the diagonal.
    pub fn diagonal(&self, vertex: usize) -> &Matrix3<f64> {
        &self.blocks[self.pattern.diagonals[vertex]]
    }

    /// Adds `factor` times a matrix that has the same pattern.
    pub fn add_scaled(&mut self, factor: f64, other: &Self) {
        for (block, add) in self.blocks.iter_mut().zip(&other.blocks) {
            *block += add * factor;
        }
    }

    /// $y \mathrel{+}= \mathrm{factor}\,A x$, one vector a vertex.
    pub fn multiply_add(&self, factor: f64, x: &[Vector3<f64>], y: &mut [Vector3<f64>]) {
        for (row, sum) in y.iter_mut().enumerate() {
            *sum += self.row_times(row, x) * factor;
        }
    }

    /// $y = A x$, one vector a vertex.
    pub fn multiply(&self, x: &[Vector3<f64>], y: &mut [Vector3<f64>]) {
        for (row, product) in y.iter_mut().enumerate() {
            *product = self.row_times(row, x);
        }
    }

    /// $y_c = A x_c$ for the columns that are listed, each one vector a vertex: one pass over the matrix serves all of them.
    pub fn multiply_columns(&self, listed: &[usize], x: &[Vec<Vector3<f64>>], y: &mut [Vec<Vector3<f64>>]) {
        for (row, range) in self.pattern.row_starts.windows(2).map(|row| row[0]..row[1]).enumerate() {
            let (blocks, columns) = (&self.blocks[range.clone()], &self.pattern.columns[range]);
            for &listed in listed {
                y[listed][row] = row_times(blocks, columns, &x[listed]);
            }
        }
    }

    fn row_times(&self, row: usize, x: &[Vector3<f64>]) -> Vector3<f64> {
        let range = self.pattern.blocks_of(row);
        row_times(&self.blocks[range.clone()], &self.pattern.columns[range], x)
    }
}

#[inline]
fn row_times(blocks: &[Matrix3<f64>], columns: &[usize], x: &[Vector3<f64>]) -> Vector3<f64> {
    blocks.iter().zip(columns).fold(Vector3::zeros(), |sum, (block, &column)| sum + block * x[column])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path_of_three() -> Arc<BlockPattern> {
        Arc::new(BlockPattern::from_neighbours(&[vec![1], vec![2], vec![]]))
    }

    #[test]
    fn a_pattern_is_symmetric_and_holds_its_diagonal() {
        let pattern = path_of_three();
        assert_eq!(pattern.block_count(), 7);
        for row in 0..3 {
            for column in 0..3 {
                assert_eq!(pattern.position(row, column).is_some(), row.abs_diff(column) <= 1);
            }
        }
    }

    #[test]
    fn the_product_is_that_of_the_dense_matrix() {
        let mut matrix = BlockMatrix::zeros(path_of_three());
        let mut dense = nalgebra::DMatrix::<f64>::zeros(9, 9);
        for row in 0..3 {
            for column in 0..3 {
                let block = Matrix3::from_fn(|i, j| ((1 + 7 * row + 3 * column + 2 * i + 5 * j) as f64).sin());
                let is_stored = matrix.add_block(row, column, &block);
                assert_eq!(is_stored, row.abs_diff(column) <= 1);
                if is_stored {
                    dense.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&block);
                }
            }
        }
        let x: Vec<Vector3<f64>> = (0..3).map(|v| Vector3::new(v as f64, 1.0, -2.0 * v as f64)).collect();
        let flat = nalgebra::DVector::from_iterator(9, x.iter().flat_map(|v| v.iter().copied()));
        let expected = dense * flat;
        let mut product = vec![Vector3::zeros(); 3];
        matrix.multiply(&x, &mut product);
        for (vertex, value) in product.iter().enumerate() {
            assert!((value - expected.fixed_rows::<3>(3 * vertex)).norm() < 1e-13);
        }
    }
}
