//! Products and triangular solves with many columns, $A X$ and $L L^\top X = B$: those of all tangents of a step.
//!
//! A row of X, one number a right-hand side, lies in one piece, padded to full registers. Of a few rows by a few registers the sums
//! $X_i - \sum_j L_{ij} X_j$ stay in registers while a supernode's columns go by; nothing is packed or transposed in between, which is what
//! a product of small matrices spends its time on. A right-hand side comes out the same whatever stands beside it.

use nalgebra::{Matrix3, Vector3};
use pulp::{Simd, WithSimd};

use super::{BlockMatrix, CholeskyFactor, LinearSolveError};

/// Rows whose sums are in registers at a time.
const ROWS: usize = 4;

/// Columns of a supernode that go by before the next ones do: their entries of a few rows stay in the nearest memory from row to row.
const COLUMNS: usize = 24;

/// The rows of a full group, counted from its first.
const GROUP: [usize; ROWS] = [0, 1, 2, 3];

/// Goes through the registers of a row in groups of at most three: `|from, V|` is where a group begins and how many it has.
macro_rules! in_registers {
    ($width:expr, |$from:ident, $count:ident| $body:expr) => {{
        let mut $from = 0;
        macro_rules! group {
            ($size:literal) => {{
                const $count: usize = $size;
                $body;
                $from += $size;
            }};
        }
        while $from < $width {
            match $width - $from {
                1 => group!(1),
                2 | 4 => group!(2),
                _ => group!(3),
            }
        }
    }};
}

/// Scratch memory of products and solves with many columns.
#[derive(Debug, Clone, Default)]
pub struct PanelWorkspace {
    /// X row by row; in a solve by the order of the pivots.
    unknowns: Vec<f64>,
    /// Three rows of a product.
    row: Vec<f64>,
}

impl CholeskyFactor<f64> {
    /// [`CholeskyFactor::solve_in_place`] for many right-hand sides, in less time.
    ///
    /// # Errors
    /// [`LinearSolveError::Size`] if a right-hand side has not one vector a vertex.
    pub fn solve_panel(&self, right_hand_sides: &mut [Vec<Vector3<f64>>], workspace: &mut PanelWorkspace) -> Result<(), LinearSolveError> {
        let expected = self.structure().pattern().vertex_count();
        if let Some(wrong) = right_hand_sides.iter().find(|column| column.len() != expected) {
            return Err(LinearSolveError::Size { what: "vectors of a right-hand side", expected, found: wrong.len() });
        }
        if !right_hand_sides.is_empty() {
            pulp::Arch::new().dispatch(Sweeps { factor: self, right_hand_sides, unknowns: &mut workspace.unknowns });
        }
        Ok(())
    }
}

impl BlockMatrix {
    /// $Y \mathrel{+}= A X$ for several columns, each one vector a vertex: one pass over the matrix serves all of them.
    pub fn multiply_add_columns(&self, x: &[Vec<Vector3<f64>>], y: &mut [Vec<Vector3<f64>>], workspace: &mut PanelWorkspace) {
        pulp::Arch::new().dispatch(Product { matrix: self, x, y, workspace });
    }
}

/// A product, with the widest registers that the machine has.
struct Product<'a> {
    matrix: &'a BlockMatrix,
    x: &'a [Vec<Vector3<f64>>],
    y: &'a mut [Vec<Vector3<f64>>],
    workspace: &'a mut PanelWorkspace,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { matrix, x, y, workspace: PanelWorkspace { unknowns, row } } = self;
        let (pattern, length) = (matrix.pattern(), x.len().next_multiple_of(S::F64_LANES));
        let width = length / S::F64_LANES;
        unknowns.clear();
        unknowns.resize(length * 3 * pattern.vertex_count(), 0.0);
        for (unknown, row) in unknowns.chunks_exact_mut(length.max(1)).enumerate() {
            row.iter_mut().zip(x).for_each(|(entry, column)| *entry = column[unknown / 3][unknown % 3]);
        }
        row.clear();
        row.resize(3 * length, 0.0);
        for vertex in 0..pattern.vertex_count() {
            let (blocks, columns) = (&matrix.blocks()[pattern.blocks_of(vertex)], pattern.columns_of(vertex));
            let (x, products) = (S::as_simd_f64s(unknowns).0, S::as_mut_simd_f64s(row).0);
            in_registers!(width, |from, V| block_row::<S, V>(simd, blocks, columns, x, products, (from, width)));
            for (axis, products) in row.chunks_exact(length.max(1)).enumerate() {
                y.iter_mut().zip(products).for_each(|(y, product)| y[vertex][axis] += product);
            }
        }
    }
}

/// Of V registers: three rows of the product.
#[inline(always)]
fn block_row<S: Simd, const V: usize>(
    simd: S,
    blocks: &[Matrix3<f64>],
    columns: &[usize],
    x: &[S::f64s],
    products: &mut [S::f64s],
    (from, width): (usize, usize),
) {
    let mut sums = [[simd.splat_f64s(0.0); V]; 3];
    for (block, &column) in blocks.iter().zip(columns) {
        for (known, entries) in x[3 * column * width..].chunks_exact(width).zip(&block.data.0) {
            let Some(known) = known[from..].first_chunk::<V>() else { return };
            for (sums, &entry) in sums.iter_mut().zip(entries) {
                let entry = simd.splat_f64s(entry);
                for (sum, &known) in sums.iter_mut().zip(known) {
                    *sum = simd.mul_add_f64s(entry, known, *sum);
                }
            }
        }
    }
    for (products, sums) in products.chunks_exact_mut(width).zip(sums) {
        for (product, sum) in products[from..].iter_mut().zip(sums) {
            *product = sum;
        }
    }
}

/// Both substitutions, with the widest registers that the machine has.
struct Sweeps<'a> {
    factor: &'a CholeskyFactor<f64>,
    right_hand_sides: &'a mut [Vec<Vector3<f64>>],
    unknowns: &'a mut Vec<f64>,
}

impl<'a> WithSimd for Sweeps<'a> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { factor, right_hand_sides, unknowns } = self;
        let structure = factor.structure();
        let length = right_hand_sides.len().next_multiple_of(S::F64_LANES);
        unknowns.clear();
        unknowns.resize(length * 3 * structure.pattern().vertex_count(), 0.0);
        for (unknown, row) in structure.pivots().zip(unknowns.chunks_exact_mut(length)) {
            row.iter_mut().zip(&*right_hand_sides).for_each(|(entry, column)| *entry = column[unknown / 3][unknown % 3]);
        }
        let supernodes = structure.supernodes();
        let (width, (x, _)) = (length / S::F64_LANES, S::as_mut_simd_f64s(unknowns));
        let block = |&(first, count, below, first_value): &(usize, usize, &'a [usize], usize)| {
            let row_count = count + below.len();
            Block { first, count, below, row_count, entries: &factor.values()[first_value..first_value + row_count * count] }
        };
        for supernode in &supernodes {
            block(supernode).eliminate(simd, x, width);
        }
        for supernode in supernodes.iter().rev() {
            block(supernode).substitute(simd, x, width);
        }
        for (unknown, row) in structure.pivots().zip(unknowns.chunks_exact(length)) {
            right_hand_sides.iter_mut().zip(row).for_each(|(column, entry)| column[unknown / 3][unknown % 3] = *entry);
        }
    }
}

/// The columns of a supernode.
struct Block<'a> {
    first: usize,
    count: usize,
    /// The rows below their triangle.
    below: &'a [usize],
    row_count: usize,
    /// Column by column, the rows of the triangle first.
    entries: &'a [f64],
}

impl Block<'_> {
    fn entry(&self, row: usize, column: usize) -> f64 {
        self.entries[column * self.row_count + row]
    }

    /// Forward: the rows of X that are the supernode's, of $L Y = B$, and what they take from the rows below.
    #[inline(always)]
    fn eliminate<S: Simd>(&self, simd: S, x: &mut [S::f64s], width: usize) {
        let (own, later) = x[self.first * width..].split_at_mut(self.count * width);
        for first in (0..self.count).step_by(COLUMNS) {
            let last = (first + COLUMNS).min(self.count);
            let (own, others) = own[first * width..].split_at_mut((last - first) * width);
            for start in (first..last).step_by(ROWS) {
                let end = (start + ROWS).min(last);
                let (known, rows) = own.split_at_mut((start - first) * width);
                self.take_from_rows(simd, (start, first), known, rows, &GROUP[..end - start], width);
                for row in start..end {
                    let (known, target) = rows.split_at_mut((row - start) * width);
                    for (column, known) in (start..row).zip(known.chunks_exact(width)) {
                        subtract(simd, self.entry(row, column), known, &mut target[..width]);
                    }
                    divide(simd, self.entry(row, row), &mut target[..width]);
                }
            }
            for start in (last..self.count).step_by(ROWS) {
                let end = (start + ROWS).min(self.count);
                self.take_from_rows(simd, (start, first), own, &mut others[(start - last) * width..], &GROUP[..end - start], width);
            }
            for (chunk, rows) in self.below.chunks(ROWS).enumerate() {
                let mut places = [0; ROWS];
                places.iter_mut().zip(rows).for_each(|(place, row)| *place = row - self.first - self.count);
                self.take_from_rows(simd, (self.count + ROWS * chunk, first), own, later, &places[..rows.len()], width);
            }
        }
    }

    /// Subtracts from rows of `x` the products with the known rows, of the supernode's columns from a first on.
    #[inline(always)]
    fn take_from_rows<S: Simd>(
        &self,
        simd: S,
        (row, column): (usize, usize),
        known: &[S::f64s],
        x: &mut [S::f64s],
        places: &[usize],
        width: usize,
    ) {
        let entries = &self.entries[column * self.row_count + row..];
        match <[usize; ROWS]>::try_from(places) {
            Ok(places) => {
                in_registers!(width, |from, V| forward::<S, ROWS, V>(simd, entries, self.row_count, known, x, places, (from, width)))
            }
            Err(_) => {
                for (row, &place) in places.iter().enumerate() {
                    in_registers!(width, |from, V| forward::<S, 1, V>(
                        simd,
                        &entries[row..],
                        self.row_count,
                        known,
                        x,
                        [place],
                        (from, width)
                    ));
                }
            }
        }
    }

    /// Backward: the rows of X that are the supernode's, of $L^\top X = Y$, with the rows below known.
    #[inline(always)]
    fn substitute<S: Simd>(&self, simd: S, x: &mut [S::f64s], width: usize) {
        let (own, later) = x[self.first * width..].split_at_mut(self.count * width);
        for start in (0..self.count).step_by(ROWS).rev() {
            let end = (start + ROWS).min(self.count);
            let (rows, known) = own.split_at_mut(end * width);
            let rows = &mut rows[start * width..];
            if end - start == ROWS {
                in_registers!(width, |from, V| self.backward::<S, ROWS, V>(simd, start, end, (known, later), rows, (from, width)));
            } else {
                for column in start..end {
                    let rows = &mut rows[(column - start) * width..];
                    in_registers!(width, |from, V| self.backward::<S, 1, V>(simd, column, end, (known, later), rows, (from, width)));
                }
            }
            for column in (start..end).rev() {
                let (target, known) = rows[(column - start) * width..].split_at_mut(width);
                for (row, known) in (column + 1..end).zip(known.chunks_exact(width)) {
                    subtract(simd, self.entry(row, column), known, target);
                }
                divide(simd, self.entry(column, column), target);
            }
        }
    }

    /// Of R columns and V registers: subtracts the products with the rows from `end` on, those of the triangle and those below.
    #[inline(always)]
    fn backward<S: Simd, const R: usize, const V: usize>(
        &self,
        simd: S,
        first: usize,
        end: usize,
        (own, later): (&[S::f64s], &[S::f64s]),
        targets: &mut [S::f64s],
        (from, width): (usize, usize),
    ) {
        let mut sums = [[simd.splat_f64s(0.0); V]; R];
        let columns: [&[f64]; R] = std::array::from_fn(|column| &self.entries[(first + column) * self.row_count..][end..self.row_count]);
        let base = self.first + self.count;
        let below = self.below.iter().map(|row| &later[(row - base) * width..]);
        for (row, known) in own.chunks_exact(width).chain(below).enumerate() {
            let Some(known) = known[from..].first_chunk::<V>() else { return };
            for (sums, column) in sums.iter_mut().zip(columns) {
                let entry = simd.splat_f64s(column[row]);
                for (sum, &known) in sums.iter_mut().zip(known) {
                    *sum = simd.mul_add_f64s(entry, known, *sum);
                }
            }
        }
        for (target, sums) in targets.chunks_exact_mut(width).zip(sums) {
            for (target, sum) in target[from..].iter_mut().zip(sums) {
                *target = simd.sub_f64s(*target, sum);
            }
        }
    }
}

/// Of R rows and V registers: subtracts the products of a supernode's columns with their rows of X, which are known.
#[inline(always)]
fn forward<S: Simd, const R: usize, const V: usize>(
    simd: S,
    entries: &[f64],
    stride: usize,
    known: &[S::f64s],
    x: &mut [S::f64s],
    places: [usize; R],
    (from, width): (usize, usize),
) {
    let mut sums = [[simd.splat_f64s(0.0); V]; R];
    for (entries, known) in entries.chunks(stride).zip(known.chunks_exact(width)) {
        let (Some(entries), Some(known)) = (entries.first_chunk::<R>(), known[from..].first_chunk::<V>()) else { return };
        for (sums, &entry) in sums.iter_mut().zip(entries) {
            let entry = simd.splat_f64s(entry);
            for (sum, &known) in sums.iter_mut().zip(known) {
                *sum = simd.mul_add_f64s(entry, known, *sum);
            }
        }
    }
    for (place, sums) in places.into_iter().zip(sums) {
        let target = &mut x[place * width + from..];
        for (target, sum) in target.iter_mut().zip(sums) {
            *target = simd.sub_f64s(*target, sum);
        }
    }
}

#[inline(always)]
fn subtract<S: Simd>(simd: S, entry: f64, known: &[S::f64s], target: &mut [S::f64s]) {
    let entry = simd.splat_f64s(-entry);
    for (target, &known) in target.iter_mut().zip(known) {
        *target = simd.mul_add_f64s(entry, known, *target);
    }
}

#[inline(always)]
fn divide<S: Simd>(simd: S, entry: f64, target: &mut [S::f64s]) {
    let inverse = simd.splat_f64s(1.0 / entry);
    for target in target {
        *target = simd.mul_f64s(inverse, *target);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::factor::tests::grid_matrix;
    use super::super::{CholeskyStructure, CholeskyWorkspace};
    use super::*;

    fn right_hand_sides(vertex_count: usize, count: usize) -> Vec<Vec<Vector3<f64>>> {
        let side = |k: usize| (0..vertex_count).map(|v| Vector3::new((v + k) as f64, 1.0, ((k + 1) * v) as f64).map(f64::sin)).collect();
        (0..count).map(side).collect()
    }

    /// Simplicial and supernodal, with rows and columns that do not fill registers.
    #[test]
    fn solutions_are_those_of_one_after_the_other_whatever_stands_beside_them() {
        for edge in [1, 2, 3, 7] {
            let matrix = grid_matrix(edge);
            let structure = Arc::new(CholeskyStructure::new(Arc::clone(matrix.pattern())).unwrap());
            let mut memory = CholeskyWorkspace::default();
            let factor = CholeskyFactor::<f64>::new(structure, &matrix, &mut memory).unwrap();
            let mut alone = Vec::new();
            for count in [1, 2, 7, 13, 20, 33] {
                let (mut exact, mut panel) = (right_hand_sides(edge.pow(3), count), right_hand_sides(edge.pow(3), count));
                factor.solve_in_place(&mut exact, &mut memory).unwrap();
                factor.solve_panel(&mut panel, &mut PanelWorkspace::default()).unwrap();
                for (exact, solved) in exact.iter().zip(&panel) {
                    let scale = exact.iter().map(Vector3::norm).fold(0.0, f64::max);
                    assert!(exact.iter().zip(solved).all(|(e, s)| (e - s).norm() < 1e-14 * scale), "{edge} {count}");
                }
                alone.truncate(1);
                alone.push(panel[0].clone());
                assert_eq!(alone.first(), alone.last(), "{edge} {count}");
            }
        }
    }

    #[test]
    fn products_are_those_of_one_column_after_the_other() {
        let matrix = grid_matrix(3);
        for count in [0, 1, 6, 21] {
            let (x, mut products) = (right_hand_sides(27, count), right_hand_sides(27, count));
            matrix.multiply_add_columns(&x, &mut products, &mut PanelWorkspace::default());
            for (x, found) in x.iter().zip(&products) {
                let mut expected = x.clone();
                matrix.multiply_add(1.0, x, &mut expected);
                assert!(expected.iter().zip(found).all(|(e, f)| (e - f).norm() < 1e-13 * e.norm().max(1.0)), "{count}");
            }
        }
    }

    #[test]
    fn a_right_hand_side_of_the_wrong_size_is_refused() {
        let matrix = grid_matrix(2);
        let structure = Arc::new(CholeskyStructure::new(Arc::clone(matrix.pattern())).unwrap());
        let factor = CholeskyFactor::<f64>::new(structure, &matrix, &mut CholeskyWorkspace::default()).unwrap();
        let refused = factor.solve_panel(&mut [vec![Vector3::zeros(); 7]], &mut PanelWorkspace::default());
        assert_eq!(refused, Err(LinearSolveError::Size { what: "vectors of a right-hand side", expected: 8, found: 7 }));
    }
}
