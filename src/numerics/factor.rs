//! Sparse Cholesky factorisation $A = L L^\top$ of symmetric positive definite block matrices, ordered by nested dissection.
//!
//! The vertex graph is ordered, not the unknowns, once a pattern; every matrix of that pattern is factorised into it. All
//! arithmetic is sequential: parallelism belongs to the outermost loop, so no result depends on the number of threads.

use std::fmt;
use std::sync::Arc;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::traits::RealField;
use faer::{Conj, MatMut, Par, Side, Spec};
use nalgebra::Vector3;

use super::LinearSolveError;
use super::sparse::{BlockMatrix, BlockPattern};

const SEQUENTIAL: Par = Par::Seq;

/// The ordering and the shape of the factor of every matrix of one pattern.
pub struct CholeskyStructure {
    pattern: Arc<BlockPattern>,
    lower: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
}

impl CholeskyStructure {
    /// Orders the vertex graph by nested dissection and analyses the factor.
    ///
    /// # Errors
    /// [`LinearSolveError::Ordering`] or [`LinearSolveError::OutOfMemory`].
    pub fn new(pattern: Arc<BlockPattern>) -> Result<Self, LinearSolveError> {
        let vertex_count = pattern.vertex_count();
        let forward: Vec<usize> =
            nested_dissection(&pattern)?.into_iter().flat_map(|vertex| (0..3).map(move |axis| 3 * vertex + axis)).collect();
        let mut inverse = vec![0; forward.len()];
        for (new, &old) in forward.iter().enumerate() {
            inverse[old] = new;
        }
        let lower = lower_pattern(&pattern);
        let permutation = faer::perm::PermRef::new_checked(&forward, &inverse, 3 * vertex_count);
        let ordering = SymmetricOrdering::Custom(permutation);
        let symbolic = factorize_symbolic_cholesky(lower.as_ref(), Side::Lower, ordering, CholeskySymbolicParams::default())
            .map_err(|_| LinearSolveError::OutOfMemory { vertex_count })?;
        Ok(Self { pattern, lower, symbolic })
    }

    /// The pattern this belongs to.
    pub fn pattern(&self) -> &Arc<BlockPattern> {
        &self.pattern
    }

    /// Number of stored entries of a factor.
    pub fn stored_count(&self) -> usize {
        self.symbolic.len_val()
    }

    /// The unknowns in the order of the pivots: component a of vertex v is 3 v + a.
    pub(super) fn pivots(&self) -> impl Iterator<Item = usize> + '_ {
        let forward = self.symbolic.perm().map_or(&[][..], |permutation| permutation.arrays().0);
        forward.iter().copied()
    }

    /// Every supernode: its first column, the number of its columns, the rows below their triangle, and where its columns begin among the
    /// values of a factor.
    pub(super) fn supernodes(&self) -> Vec<(usize, usize, &[usize], usize)> {
        match self.symbolic.raw() {
            SymbolicCholeskyRaw::Supernodal(supernodal) => (0..supernodal.n_supernodes())
                .map(|place| {
                    let (first, end) = (supernodal.supernode_begin()[place], supernodal.supernode_end()[place]);
                    (first, end - first, supernodal.supernode(place).pattern(), supernodal.col_ptr_for_val()[place])
                })
                .collect(),
            SymbolicCholeskyRaw::Simplicial(simplicial) => (0..simplicial.ncols())
                .map(|column| {
                    let values = simplicial.col_ptr()[column]..simplicial.col_ptr()[column + 1];
                    (column, 1, &simplicial.row_idx()[values.start + 1..values.end], values.start)
                })
                .collect(),
        }
    }

    fn vertex_of_pivot(&self, index: usize) -> usize {
        let unknown = index.saturating_sub(1).min(self.symbolic.nrows().saturating_sub(1));
        self.symbolic.perm().map_or(unknown, |permutation| permutation.arrays().0[unknown]) / 3
    }
}

impl fmt::Debug for CholeskyStructure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("CholeskyStructure")
            .field("vertex_count", &self.pattern.vertex_count())
            .field("stored_count", &self.stored_count())
            .finish()
    }
}

/// The precision of a factor: `f64`, or `f32` for preconditioners, which halves the time of a solve.
pub trait FactorScalar: RealField + Copy {
    /// Rounds.
    fn from_double(value: f64) -> Self;
    /// Widens.
    fn to_double(self) -> f64;
}

impl FactorScalar for f64 {
    fn from_double(value: f64) -> Self {
        value
    }

    fn to_double(self) -> f64 {
        self
    }
}

impl FactorScalar for f32 {
    fn from_double(value: f64) -> Self {
        value as f32
    }

    fn to_double(self) -> f64 {
        f64::from(self)
    }
}

/// Scratch memory of factorisations and solves; grows to the largest use and is then kept.
pub struct CholeskyWorkspace<T = f64> {
    memory: MemBuffer,
    lower_values: Vec<T>,
    columns: Vec<T>,
}

impl<T> Default for CholeskyWorkspace<T> {
    fn default() -> Self {
        Self { memory: MemBuffer::new(faer::dyn_stack::StackReq::EMPTY), lower_values: Vec::new(), columns: Vec::new() }
    }
}

impl<T> fmt::Debug for CholeskyWorkspace<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("CholeskyWorkspace").field("bytes", &self.memory.len()).finish()
    }
}

/// The factor of one matrix.
#[derive(Debug, Clone)]
pub struct CholeskyFactor<T = f64> {
    structure: Arc<CholeskyStructure>,
    values: Vec<T>,
}

impl<T: FactorScalar> CholeskyFactor<T> {
    /// Factorises a symmetric positive definite matrix; its lower triangle is read.
    ///
    /// # Errors
    /// [`LinearSolveError::NotPositiveDefinite`] names a vertex at which the factorisation broke down.
    pub fn new(
        structure: Arc<CholeskyStructure>,
        matrix: &BlockMatrix,
        workspace: &mut CholeskyWorkspace<T>,
    ) -> Result<Self, LinearSolveError> {
        let values = vec![T::from_double(0.0); structure.stored_count()];
        let mut factor = Self { structure, values };
        factor.refactorise(matrix, workspace)?;
        Ok(factor)
    }

    /// The entries of L, supernode by supernode, column by column.
    pub(super) fn values(&self) -> &[T] {
        &self.values
    }

    /// The structure shared by all factors of a pattern.
    pub fn structure(&self) -> &Arc<CholeskyStructure> {
        &self.structure
    }

    /// Factorises another matrix of the same pattern in place. After an error the factor must not be used for solves.
    ///
    /// # Errors
    /// As [`CholeskyFactor::new`].
    pub fn refactorise(&mut self, matrix: &BlockMatrix, workspace: &mut CholeskyWorkspace<T>) -> Result<(), LinearSolveError> {
        let structure = &*self.structure;
        let expected = structure.pattern.block_count();
        let found = matrix.blocks().len();
        if found != expected {
            return Err(LinearSolveError::Size { what: "blocks of the matrix to factorise", expected, found });
        }
        fill_lower(matrix, &mut workspace.lower_values);
        let params = Spec::default();
        let request = structure.symbolic.factorize_numeric_llt_scratch::<T>(SEQUENTIAL, params);
        let memory = grown(&mut workspace.memory, request);
        let lower = SparseColMatRef::new(structure.lower.as_ref(), &workspace.lower_values);
        structure
            .symbolic
            .factorize_numeric_llt(&mut self.values, lower, Side::Lower, LltRegularization::default(), SEQUENTIAL, memory, params)
            .map(|_| ())
            .map_err(|LltError::NonPositivePivot { index }| LinearSolveError::NotPositiveDefinite {
                vertex: structure.vertex_of_pivot(index),
            })
    }

    /// Solves $A x = b$ for several right-hand sides at once, in place, one vector a vertex each. One pass over the factor
    /// serves all of them, so many cost little more than one.
    ///
    /// # Errors
    /// [`LinearSolveError::Size`] if a right-hand side has not one vector a vertex.
    pub fn solve_in_place(
        &self,
        right_hand_sides: &mut [Vec<Vector3<f64>>],
        workspace: &mut CholeskyWorkspace<T>,
    ) -> Result<(), LinearSolveError> {
        let unknown_count = self.structure.symbolic.nrows();
        let column_count = right_hand_sides.len();
        let expected = self.structure.pattern.vertex_count();
        if let Some(wrong) = right_hand_sides.iter().find(|column| column.len() != expected) {
            return Err(LinearSolveError::Size { what: "vectors of a right-hand side", expected, found: wrong.len() });
        }
        if column_count == 0 || unknown_count == 0 {
            return Ok(());
        }
        let columns = &mut workspace.columns;
        columns.clear();
        columns.extend(right_hand_sides.iter().flat_map(|column| column.iter().flat_map(|v| [v.x, v.y, v.z].map(T::from_double))));
        let request = self.structure.symbolic.solve_in_place_scratch::<T>(column_count, SEQUENTIAL);
        let memory = grown(&mut workspace.memory, request);
        let view = MatMut::from_column_major_slice_mut(columns, unknown_count, column_count);
        LltRef::new(&self.structure.symbolic, &self.values).solve_in_place_with_conj(Conj::No, view, SEQUENTIAL, memory);
        let solved = columns.chunks_exact(3).map(|c| Vector3::new(c[0].to_double(), c[1].to_double(), c[2].to_double()));
        for (target, value) in right_hand_sides.iter_mut().flat_map(|column| column.iter_mut()).zip(solved) {
            *target = value;
        }
        Ok(())
    }
}

fn grown(memory: &mut MemBuffer, request: faer::dyn_stack::StackReq) -> &mut MemStack {
    if memory.len() < request.unaligned_bytes_required() {
        *memory = MemBuffer::new(request);
    }
    MemStack::new(memory)
}

/// New-to-old order of the vertices.
fn nested_dissection(pattern: &BlockPattern) -> Result<Vec<usize>, LinearSolveError> {
    let vertex_count = pattern.vertex_count();
    let failed = |reason: String| LinearSolveError::Ordering { vertex_count, reason };
    let index = |value: usize| i32::try_from(value).map_err(|_| failed(format!("{value} exceeds 32 bits")));
    let mut starts = vec![0];
    let mut rows = Vec::with_capacity(pattern.block_count());
    for vertex in 0..vertex_count {
        for &other in pattern.columns_of(vertex).iter().filter(|&&other| other != vertex) {
            rows.push(index(other)?);
        }
        starts.push(index(rows.len())?);
    }
    let graph = feral_metis::CscPattern::new(vertex_count, &starts, &rows).ok_or_else(|| failed("malformed graph".to_owned()))?;
    let order = feral_metis::metis_order(&graph).map_err(|error| failed(format!("{error:?}")))?;
    let order: Vec<usize> = order.into_iter().filter_map(|vertex| usize::try_from(vertex).ok()).collect();
    let mut sorted = order.clone();
    sorted.sort_unstable();
    if sorted.iter().copied().eq(0..vertex_count) { Ok(order) } else { Err(failed("not a permutation".to_owned())) }
}

/// Scalar pattern of the lower triangle, by columns; the order of [`fill_lower`].
fn lower_pattern(pattern: &BlockPattern) -> SymbolicSparseColMat<usize> {
    let size = 3 * pattern.vertex_count();
    let mut starts = Vec::with_capacity(size + 1);
    let mut rows = Vec::new();
    starts.push(0);
    for vertex in 0..pattern.vertex_count() {
        for axis in 0..3 {
            rows.extend(lower_unknowns(pattern, vertex, axis));
            starts.push(rows.len());
        }
    }
    SymbolicSparseColMat::new_checked(size, size, starts, None, rows)
}

fn lower_unknowns(pattern: &BlockPattern, vertex: usize, axis: usize) -> impl Iterator<Item = usize> + '_ {
    let unknown = 3 * vertex + axis;
    pattern.columns_of(vertex).iter().flat_map(|&other| 3 * other..3 * other + 3).filter(move |&row| row >= unknown)
}

/// Values of the lower triangle by columns. Symmetry turns column (vertex, axis) into row `axis` of the blocks of block row `vertex`.
fn fill_lower<T: FactorScalar>(matrix: &BlockMatrix, values: &mut Vec<T>) {
    values.clear();
    let pattern = matrix.pattern();
    let mut first = 0;
    for vertex in 0..pattern.vertex_count() {
        let columns = pattern.columns_of(vertex);
        let blocks = &matrix.blocks()[first..first + columns.len()];
        first += columns.len();
        for axis in 0..3 {
            for (&other, block) in columns.iter().zip(blocks) {
                let start = if other < vertex {
                    3
                } else if other == vertex {
                    axis
                } else {
                    0
                };
                values.extend((start..3).map(|row_axis| T::from_double(block[(axis, row_axis)])));
            }
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector, Matrix3};

    /// A grid of vertices joined along its axes and diagonals, with diagonally dominant pseudo-random blocks.
    pub(in super::super) fn grid_matrix(edge: usize) -> BlockMatrix {
        let index = |i: usize, j: usize, k: usize| (i * edge + j) * edge + k;
        let mut neighbours = vec![vec![]; edge.pow(3)];
        for i in 0..edge {
            for j in 0..edge {
                for k in 0..edge {
                    for (di, dj, dk) in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 1, 1)] {
                        if i + di < edge && j + dj < edge && k + dk < edge {
                            neighbours[index(i, j, k)].push(index(i + di, j + dj, k + dk));
                        }
                    }
                }
            }
        }
        let pattern = Arc::new(BlockPattern::from_neighbours(&neighbours));
        let mut matrix = BlockMatrix::zeros(Arc::clone(&pattern));
        for row in 0..pattern.vertex_count() {
            for &column in pattern.columns_of(row).iter().filter(|&&column| column > row) {
                let block = Matrix3::from_fn(|a, b| ((row + 3 * column + 5 * a + 7 * b) as f64).sin());
                assert!(matrix.add_block(row, column, &block) && matrix.add_block(column, row, &block.transpose()));
            }
            let coupling = Matrix3::new(0.0, 1.0, 0.5, 1.0, 0.0, 0.2, 0.5, 0.2, 0.0);
            matrix.add_to_diagonal(row, &(Matrix3::identity() * 40.0 + coupling));
        }
        matrix
    }

    fn dense(matrix: &BlockMatrix) -> DMatrix<f64> {
        let count = matrix.pattern().vertex_count();
        let mut dense = DMatrix::zeros(3 * count, 3 * count);
        for row in 0..count {
            for &column in matrix.pattern().columns_of(row) {
                let position = matrix.pattern().position(row, column).unwrap();
                dense.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&matrix.blocks()[position]);
            }
        }
        dense
    }

    #[test]
    fn solutions_are_those_of_dense_lu_for_small_and_supernodal_systems() {
        for edge in [1, 2, 6] {
            let matrix = grid_matrix(edge);
            let count = edge.pow(3);
            let structure = Arc::new(CholeskyStructure::new(Arc::clone(matrix.pattern())).unwrap());
            let mut workspace = CholeskyWorkspace::<f64>::default();
            let factor = CholeskyFactor::new(structure, &matrix, &mut workspace).unwrap();
            let first: Vec<Vector3<f64>> = (0..count).map(|v| Vector3::new(v as f64, 1.0, (v as f64).cos())).collect();
            let second: Vec<Vector3<f64>> = (0..count).map(|v| Vector3::new(-1.0, (v as f64).sin(), 0.1)).collect();
            let lu = dense(&matrix).lu();
            let expected: Vec<DVector<f64>> = [&first, &second]
                .map(|b| lu.solve(&DVector::from_iterator(3 * count, b.iter().flat_map(|v| v.iter().copied()))).unwrap())
                .to_vec();
            let mut columns = [first, second];
            factor.solve_in_place(&mut columns, &mut workspace).unwrap();
            for (solution, expected) in columns.iter().zip(&expected) {
                for (vertex, value) in solution.iter().enumerate() {
                    assert!((value - expected.fixed_rows::<3>(3 * vertex)).norm() < 1e-12 * expected.norm());
                }
            }
        }
    }

    /// Single precision leaves an error of its rounding, times a small condition number: a preconditioner, not a solver.
    #[test]
    fn a_factor_in_single_precision_solves_to_its_rounding() {
        let matrix = grid_matrix(5);
        let structure = Arc::new(CholeskyStructure::new(Arc::clone(matrix.pattern())).unwrap());
        let rhs: Vec<Vector3<f64>> = (0..125).map(|v| Vector3::new(v as f64, 1.0, (v as f64).cos())).collect();
        let (mut single, mut double) = ([rhs.clone()], [rhs]);
        let mut workspace = CholeskyWorkspace::<f32>::default();
        CholeskyFactor::new(Arc::clone(&structure), &matrix, &mut workspace).unwrap().solve_in_place(&mut single, &mut workspace).unwrap();
        let mut workspace = CholeskyWorkspace::<f64>::default();
        CholeskyFactor::new(structure, &matrix, &mut workspace).unwrap().solve_in_place(&mut double, &mut workspace).unwrap();
        let scale = double[0].iter().map(Vector3::norm).fold(0.0, f64::max);
        let error = single[0].iter().zip(&double[0]).map(|(s, d)| (s - d).norm()).fold(0.0, f64::max) / scale;
        assert!(error > 1e-9 && error < 1e-5, "{error}");
    }

    #[test]
    fn an_indefinite_matrix_is_refused_with_the_guilty_vertex() {
        for edge in [2, 6] {
            let mut matrix = grid_matrix(edge);
            let guilty = edge.pow(3) / 2;
            matrix.add_to_diagonal(guilty, &(Matrix3::identity() * -1e4));
            let structure = Arc::new(CholeskyStructure::new(Arc::clone(matrix.pattern())).unwrap());
            let error = CholeskyFactor::<f64>::new(structure, &matrix, &mut CholeskyWorkspace::default()).unwrap_err();
            assert_eq!(error, LinearSolveError::NotPositiveDefinite { vertex: guilty });
        }
    }
}
