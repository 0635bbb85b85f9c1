//! A Cholesky factor in 16 bits an entry, to precondition with: a solve waits for the factor to be read, and this one is half as long.
//!
//! The entries of $L$ keep eight bits of their mantissa (the upper half of single precision); the diagonal and what is next to it keep all.
//! So $\hat L = L + E$ with $|E_{ij}| \le 2^{-8} |L_{ij}|$, and $\hat L \hat L^\top$ is positive definite whatever the rounding: a
//! preconditioner that costs conjugate gradients hardly an iteration more.
//!
//! The columns of a supernode, which have the rows below their triangle in common, are gone through in pairs: the two entries of a row
//! share a word of 32 bits, and words lie row by row, one stream of memory.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Vector3;
use pulp::{Simd, WithSimd};

use super::{CholeskyFactor, CholeskyStructure, LinearSolveError};

/// Rows below a pair are padded with zeros to a multiple of this, so that registers are full.
const PADDING: usize = 8;

/// The upper half of a word, in which the second column's entry stands.
const SECOND: u32 = 0xffff_0000;

/// The first two rows of a pair of columns: the inverse diagonal, and the entry below it.
#[derive(Debug, Clone, Copy)]
struct Corner {
    inverse_diagonal: [f32; 2],
    below: f32,
}

impl Corner {
    /// That of no columns: what it is applied to stays.
    const IDENTITY: Self = Self { inverse_diagonal: [1.0; 2], below: 0.0 };
}

/// Consecutive columns with the same rows below their triangle.
#[derive(Debug, Clone)]
struct Supernode {
    first_column: usize,
    column_count: usize,
    /// Where its rows below the triangle stand in `rows`.
    rows: Range<usize>,
    first_corner: usize,
    first_word: usize,
    /// Where its columns, each as long as the first, stand among the values of an exact factor.
    first_value: usize,
}

impl Supernode {
    fn row_count(&self) -> usize {
        self.column_count + self.rows.len()
    }

    fn pair_count(&self) -> usize {
        self.column_count.div_ceil(2)
    }

    /// Words of a pair.
    fn word_count(&self, pair: usize) -> usize {
        self.row_count().saturating_sub(2 * (pair + 1)).next_multiple_of(PADDING)
    }

    /// Words of all its pairs.
    fn all_word_count(&self) -> usize {
        (0..self.pair_count()).map(|pair| self.word_count(pair)).sum()
    }
}

/// The factor of one matrix, rounded.
#[derive(Debug, Clone)]
pub struct CompactFactor {
    structure: Arc<CholeskyStructure>,
    supernodes: Vec<Supernode>,
    rows: Vec<usize>,
    corners: Vec<Corner>,
    /// For every row below a pair its two entries, the first column's in the lower half.
    words: Vec<u32>,
}

/// Scratch memory of solves with a [`CompactFactor`].
#[derive(Debug, Clone, Default)]
pub struct CompactWorkspace {
    /// The right-hand sides in the order of the pivots.
    unknowns: Vec<f32>,
    /// Of a supernode the unknowns of its columns, then what its rows below gain or hold, then zeros that fill the last register.
    panel: Vec<f32>,
}

impl CompactFactor {
    /// A factor, rounded.
    pub fn new(factor: &CholeskyFactor<f32>) -> Self {
        let structure = Arc::clone(factor.structure());
        let (mut supernodes, mut rows) = (Vec::<Supernode>::new(), Vec::new());
        let (mut first_corner, mut first_word) = (0, 0);
        for (first_column, column_count, below, first_value) in structure.supernodes() {
            let first_row = rows.len();
            rows.extend_from_slice(below);
            let supernode = Supernode { first_column, column_count, rows: first_row..rows.len(), first_corner, first_word, first_value };
            first_corner += supernode.pair_count();
            first_word += supernode.all_word_count();
            supernodes.push(supernode);
        }
        let (corners, words) = (vec![Corner::IDENTITY; first_corner], vec![0; first_word]);
        let mut rounded = Self { structure, supernodes, rows, corners, words };
        rounded.take_over(factor.values());
        rounded
    }

    /// Takes over another factor of the same structure, in place.
    ///
    /// # Errors
    /// [`LinearSolveError::Size`] if the structure is another.
    pub fn renew(&mut self, factor: &CholeskyFactor<f32>) -> Result<(), LinearSolveError> {
        if !Arc::ptr_eq(&self.structure, factor.structure()) {
            let (expected, found) = (self.structure.stored_count(), factor.structure().stored_count());
            return Err(LinearSolveError::Size { what: "entries of a factor of the same structure", expected, found });
        }
        self.take_over(factor.values());
        Ok(())
    }

    fn take_over(&mut self, values: &[f32]) {
        for supernode in &self.supernodes {
            let row_count = supernode.row_count();
            let columns = &values[supernode.first_value..supernode.first_value + row_count * supernode.column_count];
            let mut words = &mut self.words[supernode.first_word..];
            let pairs = columns.chunks(2 * row_count).zip(&mut self.corners[supernode.first_corner..]);
            for (pair, (columns, corner)) in pairs.enumerate() {
                let (own, others) = words.split_at_mut(supernode.word_count(pair));
                *corner = take_over_pair(columns, row_count, 2 * pair, own);
                words = others;
            }
        }
    }

    /// Solves $\hat L \hat L^\top x = b$ for several right-hand sides in place, one vector a vertex each.
    ///
    /// # Errors
    /// [`LinearSolveError::Size`] if a right-hand side has not one vector a vertex.
    pub fn solve_in_place(
        &self,
        right_hand_sides: &mut [Vec<Vector3<f64>>],
        workspace: &mut CompactWorkspace,
    ) -> Result<(), LinearSolveError> {
        let expected = self.structure.pattern().vertex_count();
        if let Some(wrong) = right_hand_sides.iter().find(|column| column.len() != expected) {
            return Err(LinearSolveError::Size { what: "vectors of a right-hand side", expected, found: wrong.len() });
        }
        if expected == 0 {
            return Ok(());
        }
        let CompactWorkspace { unknowns, panel } = workspace;
        let in_order = |column: &Vec<Vector3<f64>>, unknown: usize| column[unknown / 3][unknown % 3] as f32;
        unknowns.clear();
        for column in &*right_hand_sides {
            unknowns.extend(self.structure.pivots().map(|unknown| in_order(column, unknown)));
        }
        pulp::Arch::new().dispatch(Sweeps { factor: self, unknowns, panel });
        for (column, solved) in right_hand_sides.iter_mut().zip(unknowns.chunks_exact(3 * expected)) {
            for (unknown, value) in self.structure.pivots().zip(solved) {
                column[unknown / 3][unknown % 3] = f64::from(*value);
            }
        }
        Ok(())
    }
}

/// Both substitutions, with the widest registers that the machine has; one pass over the factor each serves all right-hand sides.
struct Sweeps<'a> {
    factor: &'a CompactFactor,
    unknowns: &'a mut [f32],
    panel: &'a mut Vec<f32>,
}

impl WithSimd for Sweeps<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { factor, unknowns, panel } = self;
        let unknown_count = 3 * factor.structure.pattern().vertex_count();
        for supernode in &factor.supernodes {
            unknowns.chunks_exact_mut(unknown_count).for_each(|unknowns| eliminate(simd, factor, supernode, unknowns, panel));
        }
        for supernode in factor.supernodes.iter().rev() {
            unknowns.chunks_exact_mut(unknown_count).for_each(|unknowns| substitute(simd, factor, supernode, unknowns, panel));
        }
    }
}

/// Forward: the unknowns of the supernode's columns of $\hat L y = b$, and what they take from the rows below.
#[inline(always)]
fn eliminate<S: Simd>(simd: S, factor: &CompactFactor, supernode: &Supernode, unknowns: &mut [f32], panel: &mut Vec<f32>) {
    let columns = supernode.first_column..supernode.first_column + supernode.column_count;
    panel.clear();
    panel.extend_from_slice(&unknowns[columns.clone()]);
    panel.resize(supernode.row_count() + 2 + PADDING, 0.0);
    let mut words = &factor.words[supernode.first_word..];
    let corners = &factor.corners[supernode.first_corner..supernode.first_corner + supernode.pair_count()];
    for (pair, Corner { inverse_diagonal, below }) in corners.iter().enumerate() {
        let (own, rows) = panel[2 * pair..].split_at_mut(2);
        let (of_pair, others) = words.split_at(supernode.word_count(pair));
        own[0] *= inverse_diagonal[0];
        own[1] = (own[1] - below * own[0]) * inverse_diagonal[1];
        subtract_products(simd, of_pair, [own[0], own[1]], &mut rows[..of_pair.len()]);
        words = others;
    }
    for (&row, taken) in factor.rows[supernode.rows.clone()].iter().zip(&panel[columns.len()..]) {
        unknowns[row] += taken;
    }
    unknowns[columns.clone()].copy_from_slice(&panel[..columns.len()]);
}

/// Backward: the unknowns of the supernode's columns of $\hat L^\top x = y$, with those of its rows below known.
#[inline(always)]
fn substitute<S: Simd>(simd: S, factor: &CompactFactor, supernode: &Supernode, unknowns: &mut [f32], panel: &mut Vec<f32>) {
    let columns = supernode.first_column..supernode.first_column + supernode.column_count;
    panel.clear();
    panel.extend_from_slice(&unknowns[columns.clone()]);
    panel.extend(factor.rows[supernode.rows.clone()].iter().map(|&row| unknowns[row]));
    panel.resize(supernode.row_count() + 2 + PADDING, 0.0);
    let mut words = &factor.words[..supernode.first_word + supernode.all_word_count()];
    let corners = &factor.corners[supernode.first_corner..supernode.first_corner + supernode.pair_count()];
    for (pair, Corner { inverse_diagonal, below }) in corners.iter().enumerate().rev() {
        let (own, rows) = panel[2 * pair..].split_at_mut(2);
        let (others, of_pair) = words.split_at(words.len() - supernode.word_count(pair));
        let products = products(simd, of_pair, &rows[..of_pair.len()]);
        own[1] = (own[1] - products[1]) * inverse_diagonal[1];
        own[0] = (own[0] - products[0] - below * own[1]) * inverse_diagonal[0];
        words = others;
    }
    unknowns[columns.clone()].copy_from_slice(&panel[..columns.len()]);
}

/// Rounds the two columns of a pair that begins at row `first`. The column that a last pair may lack is that of the identity: its place in
/// the panel is the first row below, which the first column reaches by the corner.
fn take_over_pair(columns: &[f32], row_count: usize, first: usize, words: &mut [u32]) -> Corner {
    let (one, two) = columns.split_at(row_count);
    let mut corner = Corner { inverse_diagonal: [1.0 / one[first], 1.0], below: one.get(first + 1).copied().unwrap_or(0.0) };
    if let Some(diagonal) = two.get(first + 1) {
        corner.inverse_diagonal[1] = 1.0 / diagonal;
    }
    for (row, word) in (first + 2..).zip(words) {
        let entry = |column: &[f32]| column.get(row).map_or(0, |value| value.to_bits().wrapping_add(0x8000) & SECOND);
        *word = entry(one) >> 16 | entry(two);
    }
    corner
}

/// Subtracts the columns times their unknowns from the rows.
#[inline(always)]
fn subtract_products<S: Simd>(simd: S, words: &[u32], known: [f32; 2], rows: &mut [f32]) {
    let (words, last_words) = S::as_simd_u32s(words);
    let (rows, last_rows) = S::as_mut_simd_f32s(rows);
    let [first, second] = known.map(|known| simd.splat_f32s(-known));
    for (row, &word) in rows.iter_mut().zip(words) {
        let [one, two] = halves(simd, word);
        *row = simd.mul_add_f32s(two, second, simd.mul_add_f32s(one, first, *row));
    }
    for (row, &word) in last_rows.iter_mut().zip(last_words) {
        *row -= f32::from_bits(word << 16) * known[0] + f32::from_bits(word & SECOND) * known[1];
    }
}

/// The products of the columns with the rows.
#[inline(always)]
fn products<S: Simd>(simd: S, words: &[u32], rows: &[f32]) -> [f32; 2] {
    let (words, last_words) = S::as_simd_u32s(words);
    let (rows, last_rows) = S::as_simd_f32s(rows);
    let mut sums = [simd.splat_f32s(0.0); 2];
    for (&row, &word) in rows.iter().zip(words) {
        let [one, two] = halves(simd, word);
        sums = [simd.mul_add_f32s(one, row, sums[0]), simd.mul_add_f32s(two, row, sums[1])];
    }
    let mut sums = sums.map(|sum| simd.reduce_sum_f32s(sum));
    for (row, &word) in last_rows.iter().zip(last_words) {
        sums[0] += f32::from_bits(word << 16) * row;
        sums[1] += f32::from_bits(word & SECOND) * row;
    }
    sums
}

/// The entries of both columns.
#[inline(always)]
fn halves<S: Simd>(simd: S, word: S::u32s) -> [S::f32s; 2] {
    let first = simd.wrapping_dyn_shl_u32s(word, simd.splat_u32s(16));
    let second = simd.and_u32s(word, simd.splat_u32s(SECOND));
    [simd.transmute_f32s_u32s(first), simd.transmute_f32s_u32s(second)]
}

#[cfg(test)]
mod tests {
    use super::super::factor::tests::grid_matrix;
    use super::super::krylov::Precondition;
    use super::super::{CholeskyWorkspace, ConjugateGradientOutcome, KrylovLimits, KrylovWorkspace, LinearSolveError, conjugate_gradients};
    use super::*;

    fn factors(edge: usize) -> (crate::numerics::BlockMatrix, CholeskyFactor<f32>, CholeskyWorkspace<f32>) {
        let matrix = grid_matrix(edge);
        let structure = Arc::new(CholeskyStructure::new(Arc::clone(matrix.pattern())).unwrap());
        let mut workspace = CholeskyWorkspace::default();
        let factor = CholeskyFactor::new(structure, &matrix, &mut workspace).unwrap();
        (matrix, factor, workspace)
    }

    fn right_hand_sides(edge: usize) -> Vec<Vec<Vector3<f64>>> {
        let side = |k: usize| (0..edge.pow(3)).map(|v| Vector3::new((v + k) as f64, 1.0, ((k + 1) * v) as f64).map(f64::sin)).collect();
        (0..3).map(side).collect()
    }

    /// Simplicial and supernodal, with groups of columns that are not full: every right-hand side is solved to the rounding of the entries,
    /// 2⁻⁹ each, times a small condition number; where that matters, not much better.
    #[test]
    fn solutions_are_those_of_the_exact_factor_up_to_eight_bits() {
        for edge in [1, 2, 3, 7] {
            let (_, factor, mut workspace) = factors(edge);
            let (mut exact, mut rounded) = (right_hand_sides(edge), right_hand_sides(edge));
            factor.solve_in_place(&mut exact, &mut workspace).unwrap();
            CompactFactor::new(&factor).solve_in_place(&mut rounded, &mut CompactWorkspace::default()).unwrap();
            for (exact, rounded) in exact.iter().zip(&rounded) {
                let scale = exact.iter().map(Vector3::norm).fold(0.0, f64::max);
                let error = exact.iter().zip(rounded).map(|(e, r)| (e - r).norm()).fold(0.0, f64::max) / scale;
                assert!(error < 0.01 && (edge < 7 || error > 1e-5), "{edge}: {error}");
            }
        }
    }

    /// It is what it is for: conjugate gradients with it end after as few iterations as with a factor of 24 bits, or one or two more.
    #[test]
    fn it_preconditions_as_well_as_it_has_to() {
        let (matrix, factor, mut workspace) = factors(6);
        let mut compact = CompactFactor::new(&factor);
        compact.renew(&factor).unwrap();
        let apply = |listed: &[usize], x: &[Vec<Vector3<f64>>], y: &mut [Vec<Vector3<f64>>]| matrix.multiply_columns(listed, x, y);
        let limits = KrylovLimits { relative_tolerance: 1e-6, iteration_limit: 20 };
        let iterations = |precondition: &mut Precondition<'_>| {
            let mut columns = right_hand_sides(6);
            let norms: Vec<f64> = columns.iter().map(|c| c.iter().map(Vector3::norm_squared).sum::<f64>().sqrt()).collect();
            let mut work = KrylovWorkspace::default();
            match conjugate_gradients(&apply, precondition, &mut columns, &norms, limits, &mut work).unwrap() {
                ConjugateGradientOutcome::Converged(report) => report.iteration_count,
                ConjugateGradientOutcome::NegativeCurvature => usize::MAX,
            }
        };
        let exact = iterations(&mut |columns| factor.solve_in_place(columns, &mut workspace));
        let mut memory = CompactWorkspace::default();
        let rounded = iterations(&mut |columns| compact.solve_in_place(columns, &mut memory));
        assert!(exact == 1 && (2..=3).contains(&rounded), "{exact} and {rounded}");
    }

    #[test]
    fn another_structure_and_a_wrong_size_are_refused() {
        let (_, factor, _) = factors(2);
        let (_, other, _) = factors(2);
        let mut compact = CompactFactor::new(&factor);
        assert!(matches!(compact.renew(&other), Err(LinearSolveError::Size { .. })));
        let short = &mut [vec![Vector3::zeros(); 7]];
        assert!(matches!(compact.solve_in_place(short, &mut CompactWorkspace::default()), Err(LinearSolveError::Size { .. })));
    }
}
