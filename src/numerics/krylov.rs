//! Preconditioned conjugate gradients and GMRES for several right-hand sides in lockstep, so that one pass over the
//! preconditioner's factor serves all of them \[Saad2003\].

use nalgebra::Vector3;

use super::LinearSolveError;

/// One vector a vertex.
type Field = Vec<Vector3<f64>>;
/// Writes A times the listed columns of the first fields to the same columns of the second.
pub(super) type Apply<'a> = dyn Fn(&[usize], &[Field], &mut [Field]) + 'a;
/// Replaces every right-hand side by its preconditioned self.
pub(super) type Precondition<'a> = dyn FnMut(&mut [Vec<Vector3<f64>>]) -> Result<(), LinearSolveError> + 'a;

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KrylovLimits {
    /// A column has converged when its residual norm is below this fraction of its reference norm.
    pub relative_tolerance: f64,
    /// Iterations of any column.
    pub iteration_limit: usize,
}

/// How an iterative solve went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KrylovReport {
    /// Iterations of the slowest column.
    pub iteration_count: usize,
    /// Largest residual norm over reference norm.
    pub relative_residual: f64,
}

/// What conjugate gradients found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ConjugateGradientOutcome {
    /// Every column converged.
    Converged(KrylovReport),
    /// A direction of negative curvature: the matrix is not positive definite. The right-hand sides are untouched.
    NegativeCurvature,
}

/// Kept memory of the iterative solvers: one set of vectors a column.
#[derive(Debug, Clone, Default)]
pub struct KrylovWorkspace {
    solution: Vec<Field>,
    residual: Vec<Field>,
    direction: Vec<Field>,
    preconditioned: Vec<Field>,
    product: Vec<Field>,
    columns: Vec<ColumnState>,
    open: Vec<usize>,
    arnoldi: Vec<Arnoldi>,
}

#[derive(Debug, Clone, Copy, Default)]
struct ColumnState {
    reference_norm: f64,
    residual_norm: f64,
    rho: f64,
    is_done: bool,
}

/// Solves A x = b in place for symmetric positive definite A and preconditioner. A column has converged when its residual is
/// below `relative_tolerance` times its entry of `reference_norms`; a reference that is not the norm of b itself serves
/// corrections of a guess.
///
/// # Errors
/// [`LinearSolveError::NotConverged`] and [`LinearSolveError::NotFinite`]; the right-hand sides are then untouched.
pub fn conjugate_gradients(
    apply: &Apply<'_>,
    precondition: &mut Precondition<'_>,
    right_hand_sides: &mut [Field],
    reference_norms: &[f64],
    limits: KrylovLimits,
    work: &mut KrylovWorkspace,
) -> Result<ConjugateGradientOutcome, LinearSolveError> {
    work.start(right_hand_sides, reference_norms, limits)?;
    let count = right_hand_sides.len();
    let mut iteration_count = 0;
    while work.columns[..count].iter().any(|column| !column.is_done) {
        if iteration_count == limits.iteration_limit {
            return Err(work.not_converged(count, iteration_count, limits));
        }
        iteration_count += 1;
        work.precondition_residuals(count, precondition)?;
        work.turn_directions(iteration_count == 1);
        apply(&work.open, &work.direction, &mut work.product);
        for slot in 0..work.open.len() {
            let column = work.open[slot];
            if !work.conjugate_step(column) {
                return Ok(ConjugateGradientOutcome::NegativeCurvature);
            }
            let state = &mut work.columns[column];
            if !state.residual_norm.is_finite() {
                return Err(LinearSolveError::NotFinite { right_hand_side: column });
            }
            state.is_done = state.residual_norm <= limits.relative_tolerance * state.reference_norm;
        }
    }
    let report = work.finish(right_hand_sides, iteration_count);
    Ok(ConjugateGradientOutcome::Converged(report))
}

/// Directions kept before GMRES restarts.
const RESTART: usize = 40;

/// One column's Krylov basis and its small least-squares problem, kept triangular by Givens rotations.
#[derive(Debug, Clone, Default)]
struct Arnoldi {
    basis: Vec<Field>,
    triangle: Vec<[f64; RESTART + 1]>,
    rotations: Vec<(f64, f64)>,
    rhs: Vec<f64>,
    step_count: usize,
}

/// Solves A x = b in place for any nonsingular A, preconditioned from the right, restarted every 40 directions; converged as in
/// [`conjugate_gradients`].
///
/// # Errors
/// [`LinearSolveError::NotConverged`] and [`LinearSolveError::NotFinite`]; the right-hand sides are then untouched.
pub fn gmres(
    apply: &Apply<'_>,
    precondition: &mut Precondition<'_>,
    right_hand_sides: &mut [Field],
    reference_norms: &[f64],
    limits: KrylovLimits,
    work: &mut KrylovWorkspace,
) -> Result<KrylovReport, LinearSolveError> {
    work.start(right_hand_sides, reference_norms, limits)?;
    let count = right_hand_sides.len();
    work.arnoldi.resize_with(count.max(work.arnoldi.len()), Arnoldi::default);
    let mut iteration_count = 0;
    while work.columns[..count].iter().any(|column| !column.is_done) {
        for column in 0..count {
            work.arnoldi[column].begin(&work.residual[column], work.columns[column].residual_norm);
        }
        let mut is_open: Vec<bool> = work.columns[..count].iter().map(|column| !column.is_done).collect();
        for _ in 0..RESTART {
            if iteration_count == limits.iteration_limit || is_open.iter().all(|&open| !open) {
                break;
            }
            iteration_count += 1;
            work.arnoldi_step(&mut is_open, precondition, apply, limits)?;
        }
        work.correct(right_hand_sides, precondition, apply)?;
        for column in 0..count {
            let state = &mut work.columns[column];
            if !state.residual_norm.is_finite() {
                return Err(LinearSolveError::NotFinite { right_hand_side: column });
            }
            state.is_done = state.residual_norm <= limits.relative_tolerance * state.reference_norm;
        }
        if iteration_count == limits.iteration_limit && work.columns[..count].iter().any(|column| !column.is_done) {
            return Err(work.not_converged(count, iteration_count, limits));
        }
    }
    Ok(work.finish(right_hand_sides, iteration_count))
}

impl KrylovWorkspace {
    /// Norm of the residual that the last solve left in a column; 0 for a column that it did not have.
    pub fn residual_norm(&self, column: usize) -> f64 {
        self.columns.get(column).map_or(0.0, |column| column.residual_norm)
    }

    fn start(&mut self, right_hand_sides: &[Field], reference_norms: &[f64], limits: KrylovLimits) -> Result<(), LinearSolveError> {
        let count = right_hand_sides.len();
        if reference_norms.len() != count {
            return Err(LinearSolveError::Size { what: "reference norms", expected: count, found: reference_norms.len() });
        }
        for fields in [&mut self.solution, &mut self.residual, &mut self.direction, &mut self.preconditioned, &mut self.product] {
            fields.resize_with(count.max(fields.len()), Vec::new);
        }
        self.columns.resize(count.max(self.columns.len()), ColumnState::default());
        for (column, (rhs, &reference_norm)) in right_hand_sides.iter().zip(reference_norms).enumerate() {
            self.product[column].resize(rhs.len(), Vector3::zeros());
            self.solution[column].clear();
            self.solution[column].resize(rhs.len(), Vector3::zeros());
            self.direction[column].resize(rhs.len(), Vector3::zeros());
            self.preconditioned[column].resize(rhs.len(), Vector3::zeros());
            self.residual[column].clear();
            self.residual[column].extend_from_slice(rhs);
            let residual_norm = norm(rhs);
            if !(residual_norm.is_finite() && reference_norm.is_finite()) {
                return Err(LinearSolveError::NotFinite { right_hand_side: column });
            }
            let is_done = residual_norm <= limits.relative_tolerance * reference_norm;
            self.columns[column] = ColumnState { reference_norm, residual_norm, rho: 0.0, is_done };
        }
        Ok(())
    }

    /// Lists the unfinished columns and preconditions their residuals into the first slots of `preconditioned`, in this order.
    fn precondition_residuals(&mut self, count: usize, precondition: &mut Precondition<'_>) -> Result<(), LinearSolveError> {
        self.open.clear();
        self.open.extend((0..count).filter(|&column| !self.columns[column].is_done));
        for (slot, &column) in self.open.iter().enumerate() {
            self.preconditioned[slot].copy_from_slice(&self.residual[column]);
        }
        precondition(&mut self.preconditioned[..self.open.len()])
    }

    /// The next direction of every open column, conjugate to the ones before.
    fn turn_directions(&mut self, is_first: bool) {
        for (slot, &column) in self.open.iter().enumerate() {
            let (z, p, state) = (&self.preconditioned[slot], &mut self.direction[column], &mut self.columns[column]);
            let rho = dot(&self.residual[column], z);
            let beta = if is_first { 0.0 } else { rho / state.rho };
            state.rho = rho;
            for (p, z) in p.iter_mut().zip(z) {
                *p = if is_first { *z } else { z + *p * beta };
            }
        }
    }

    /// Goes along a column's direction, whose product is known; false at a direction of negative curvature.
    fn conjugate_step(&mut self, column: usize) -> bool {
        let (state, p, product) = (&mut self.columns[column], &self.direction[column], &self.product[column]);
        let curvature = dot(p, product);
        if curvature <= 0.0 || state.rho <= 0.0 {
            return false;
        }
        let alpha = state.rho / curvature;
        add_scaled(&mut self.solution[column], alpha, p);
        add_scaled(&mut self.residual[column], -alpha, product);
        state.residual_norm = norm(&self.residual[column]);
        true
    }

    /// One direction more for every open column, which closes when its residual estimate is small enough.
    fn arnoldi_step(
        &mut self,
        is_open: &mut [bool],
        precondition: &mut Precondition<'_>,
        apply: &Apply<'_>,
        limits: KrylovLimits,
    ) -> Result<(), LinearSolveError> {
        self.open.clear();
        self.open.extend((0..is_open.len()).filter(|&column| is_open[column]));
        for (slot, &column) in self.open.iter().enumerate() {
            let arnoldi = &self.arnoldi[column];
            self.preconditioned[slot].copy_from_slice(&arnoldi.basis[arnoldi.step_count]);
        }
        precondition(&mut self.preconditioned[..self.open.len()])?;
        for (slot, &column) in self.open.iter().enumerate() {
            apply(&[slot], &self.preconditioned, &mut self.product);
            let residual_norm = self.arnoldi[column].extend(&mut self.product[slot]);
            // A NaN closes the column too; it is found when the true residual is formed.
            is_open[column] = residual_norm > 0.5 * limits.relative_tolerance * self.columns[column].reference_norm;
        }
        Ok(())
    }

    /// x += P⁻¹ V y and the true residual, for the columns that took steps.
    fn correct(
        &mut self,
        right_hand_sides: &[Field],
        precondition: &mut Precondition<'_>,
        apply: &Apply<'_>,
    ) -> Result<(), LinearSolveError> {
        let count = right_hand_sides.len();
        let stepped: Vec<usize> =
            (0..count).filter(|&column| !self.columns[column].is_done && self.arnoldi[column].step_count > 0).collect();
        for (slot, &column) in stepped.iter().enumerate() {
            self.arnoldi[column].combine(&mut self.preconditioned[slot]);
        }
        precondition(&mut self.preconditioned[..stepped.len()])?;
        for (slot, &column) in stepped.iter().enumerate() {
            add_scaled(&mut self.solution[column], 1.0, &self.preconditioned[slot]);
            apply(&[column], &self.solution, &mut self.product);
            for ((r, b), ax) in self.residual[column].iter_mut().zip(&right_hand_sides[column]).zip(&self.product[column]) {
                *r = b - ax;
            }
            self.columns[column].residual_norm = norm(&self.residual[column]);
        }
        Ok(())
    }

    fn not_converged(&self, count: usize, iteration_count: usize, limits: KrylovLimits) -> LinearSolveError {
        let relative = |column: &ColumnState| column.residual_norm / column.reference_norm.max(f64::MIN_POSITIVE);
        let (right_hand_side, relative_residual) = self.columns[..count]
            .iter()
            .map(relative)
            .enumerate()
            .fold((0, 0.0), |worst, next| if next.1 > worst.1 { next } else { worst });
        let tolerance = limits.relative_tolerance;
        LinearSolveError::NotConverged { right_hand_side, relative_residual, iteration_count, tolerance }
    }

    fn finish(&self, right_hand_sides: &mut [Field], iteration_count: usize) -> KrylovReport {
        let mut relative_residual: f64 = 0.0;
        for (column, rhs) in right_hand_sides.iter_mut().enumerate() {
            rhs.copy_from_slice(&self.solution[column]);
            let state = self.columns[column];
            if state.reference_norm > 0.0 {
                relative_residual = relative_residual.max(state.residual_norm / state.reference_norm);
            }
        }
        KrylovReport { iteration_count, relative_residual }
    }
}

impl Arnoldi {
    fn begin(&mut self, residual: &[Vector3<f64>], norm: f64) {
        self.step_count = 0;
        self.triangle.clear();
        self.rotations.clear();
        self.rhs.clear();
        self.rhs.push(norm);
        self.keep(0, residual, if norm > 0.0 { 1.0 / norm } else { 0.0 });
    }

    fn keep(&mut self, index: usize, vector: &[Vector3<f64>], scale: f64) {
        if self.basis.len() == index {
            self.basis.push(Vec::new());
        }
        self.basis[index].clear();
        self.basis[index].extend(vector.iter().map(|v| v * scale));
    }

    /// Orthogonalises A P⁻¹ v against the basis (modified Gram–Schmidt) and gives the new residual norm.
    fn extend(&mut self, product: &mut [Vector3<f64>]) -> f64 {
        let step = self.step_count;
        let mut column = [0.0; RESTART + 1];
        for (entry, vector) in column.iter_mut().zip(&self.basis[..=step]) {
            *entry = dot(product, vector);
            add_scaled(product, -*entry, vector);
        }
        let norm = norm(product);
        for (row, &(cosine, sine)) in self.rotations.iter().enumerate() {
            let (upper, lower) = (column[row], column[row + 1]);
            column[row] = cosine * upper + sine * lower;
            column[row + 1] = cosine * lower - sine * upper;
        }
        let radius = column[step].hypot(norm);
        let (cosine, sine) = if radius > 0.0 { (column[step] / radius, norm / radius) } else { (1.0, 0.0) };
        column[step] = radius;
        self.rotations.push((cosine, sine));
        self.triangle.push(column);
        let carried = self.rhs[step];
        self.rhs[step] = cosine * carried;
        self.rhs.push(-sine * carried);
        self.keep(step + 1, product, if norm > 0.0 { 1.0 / norm } else { 0.0 });
        self.step_count += 1;
        self.rhs[step + 1].abs()
    }

    /// Σ yᵢ vᵢ with the least-squares y.
    fn combine(&self, sum: &mut [Vector3<f64>]) {
        sum.fill(Vector3::zeros());
        let mut weights = [0.0; RESTART];
        for row in (0..self.step_count).rev() {
            let known: f64 = (row + 1..self.step_count).map(|column| self.triangle[column][row] * weights[column]).sum();
            let pivot = self.triangle[row][row];
            weights[row] = if pivot == 0.0 { 0.0 } else { (self.rhs[row] - known) / pivot };
        }
        for (weight, vector) in weights.iter().zip(&self.basis[..self.step_count]) {
            add_scaled(sum, *weight, vector);
        }
    }
}

fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

fn norm(a: &[Vector3<f64>]) -> f64 {
    dot(a, a).sqrt()
}

fn add_scaled(sum: &mut [Vector3<f64>], factor: f64, add: &[Vector3<f64>]) {
    for (sum, add) in sum.iter_mut().zip(add) {
        *sum += add * factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNT: usize = 30;
    const LIMITS: KrylovLimits = KrylovLimits { relative_tolerance: 1e-10, iteration_limit: 500 };

    fn diagonal(vertex: usize) -> f64 {
        1.0 + vertex as f64
    }

    /// Tridiagonal by vertices; `skew` makes it nonsymmetric.
    fn apply(skew: f64, x: &[Vector3<f64>], y: &mut [Vector3<f64>]) {
        for vertex in 0..COUNT {
            let before = if vertex > 0 { x[vertex - 1] } else { Vector3::zeros() };
            let after = if vertex + 1 < COUNT { x[vertex + 1] } else { Vector3::zeros() };
            y[vertex] = x[vertex] * (1.0 + diagonal(vertex)) - before * (1.0 + skew) - after * (1.0 - skew);
        }
    }

    fn listed(product: impl Fn(&[Vector3<f64>], &mut [Vector3<f64>])) -> impl Fn(&[usize], &[Field], &mut [Field]) {
        move |listed, x, y| listed.iter().for_each(|&column| product(&x[column], &mut y[column]))
    }

    fn columns() -> Vec<Field> {
        let field = |seed: f64| (0..COUNT).map(|v| Vector3::new((seed * v as f64).sin(), seed, (v as f64).cos())).collect();
        vec![field(0.3), vec![Vector3::zeros(); COUNT], field(1.1)]
    }

    fn norms() -> Vec<f64> {
        columns().iter().map(|column| norm(column)).collect()
    }

    fn residual(skew: f64, solution: &[Vector3<f64>], rhs: &[Vector3<f64>]) -> f64 {
        let mut product = vec![Vector3::zeros(); COUNT];
        apply(skew, solution, &mut product);
        product.iter().zip(rhs).map(|(p, b)| (p - b).norm_squared()).sum::<f64>().sqrt()
    }

    #[test]
    fn lockstep_columns_converge_each_on_its_own_and_zero_stays_zero() {
        let mut work = KrylovWorkspace::default();
        for skew in [0.0, 0.9] {
            let mut solved = columns();
            let mut precondition = |columns: &mut [Field]| {
                columns.iter_mut().for_each(|c| c.iter_mut().enumerate().for_each(|(vertex, v)| *v /= diagonal(vertex)));
                Ok(())
            };
            let product = listed(move |x, y| apply(skew, x, y));
            if skew == 0.0 {
                let outcome = conjugate_gradients(&product, &mut precondition, &mut solved, &norms(), LIMITS, &mut work).unwrap();
                assert!(matches!(outcome, ConjugateGradientOutcome::Converged(_)));
            } else {
                gmres(&product, &mut precondition, &mut solved, &norms(), LIMITS, &mut work).unwrap();
            }
            assert!(solved[1].iter().all(|v| *v == Vector3::zeros()));
            for (solution, rhs) in solved.iter().zip(&columns()) {
                assert!(residual(skew, solution, rhs) <= 2e-10 * norm(rhs));
            }
        }
    }

    /// A cyclic shift needs every direction of its space: 30 vertices × 1 component = 30 steps, more than a short cycle has; with
    /// an uneven diagonal added the restart must still converge.
    #[test]
    fn gmres_converges_through_restarts() {
        let product = |x: &[Vector3<f64>], y: &mut [Vector3<f64>]| {
            for vertex in 0..COUNT {
                let axes = Vector3::new(1.0, 2.3, 3.1);
                y[vertex] = x[vertex].component_mul(&(axes * (2.0 + diagonal(vertex)))) - x[(vertex + 1) % COUNT] * 4.0;
            }
        };
        let mut solved = columns();
        let report = gmres(&listed(product), &mut |_| Ok(()), &mut solved, &norms(), LIMITS, &mut KrylovWorkspace::default()).unwrap();
        assert!(report.iteration_count > RESTART, "no restart: {report:?}");
        for (solution, rhs) in solved.iter().zip(&columns()) {
            let mut applied = vec![Vector3::zeros(); COUNT];
            product(solution, &mut applied);
            let error = applied.iter().zip(rhs).map(|(p, b)| (p - b).norm_squared()).sum::<f64>().sqrt();
            assert!(error <= 2e-10 * norm(rhs));
        }
    }

    #[test]
    fn conjugate_gradients_tell_negative_curvature_and_leave_the_right_hand_sides() {
        let product = |x: &[Vector3<f64>], y: &mut [Vector3<f64>]| {
            y.iter_mut().zip(x).enumerate().for_each(|(vertex, (y, x))| *y = x * (diagonal(vertex) - 10.5));
        };
        let mut solved = columns();
        let outcome =
            conjugate_gradients(&listed(product), &mut |_| Ok(()), &mut solved, &norms(), LIMITS, &mut KrylovWorkspace::default());
        assert_eq!(outcome, Ok(ConjugateGradientOutcome::NegativeCurvature));
        assert_eq!(solved, columns());
    }
}
