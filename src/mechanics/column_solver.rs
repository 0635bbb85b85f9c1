//! Solves the step system for many columns at once, as tangents need it: the matrix is that of a step which has been taken.

use nalgebra::Vector3;

use super::myocardium::check_size;
use super::solver::StepMatrix;
use super::{MechanicsError, StepOperator, StepSolver, StepSystem};
use crate::numerics::{
    CholeskyWorkspace, ConjugateGradientOutcome, KrylovLimits, KrylovWorkspace, LinearSolveError, PanelWorkspace, conjugate_gradients,
    gmres,
};

/// Memory of one thread that solves many columns.
#[derive(Debug, Default)]
pub struct ColumnSolver {
    direct: CholeskyWorkspace<f64>,
    panel: PanelWorkspace,
    single: CholeskyWorkspace<f32>,
    krylov: KrylovWorkspace,
    product: Vec<Vector3<f64>>,
}

impl ColumnSolver {
    /// Solves $(\tilde K + K_{img})\,X = G$ (or with the tangent of a corotational system in place of $\tilde K$) for every column, in
    /// place: mN in, mm out. By the factor of $\tilde K$ where that is the matrix; else iteratively, with the preconditioner that `solver`
    /// has for the system, from the guesses (mm), to `relative_tolerance` of each column's norm. `solver` and the steps it takes are left
    /// as they are.
    ///
    /// # Errors
    /// [`MechanicsError::Solve`] with the residual and the iteration count, [`MechanicsError::FieldSize`] for a field of the wrong size,
    /// [`MechanicsError::NotLinearised`] for a corotational system without a tangent; the columns are then undefined.
    pub fn solve(
        &mut self,
        solver: &StepSolver,
        operator: &StepOperator,
        system: &StepSystem,
        columns: &mut [Vec<Vector3<f64>>],
        guesses: &[&[Vector3<f64>]],
        relative_tolerance: f64,
    ) -> Result<(), MechanicsError> {
        let count = operator.myocardium().vertex_count();
        check_size("guesses, one a column", columns.len(), guesses.len())?;
        for (column, guess) in columns.iter().zip(guesses) {
            check_size("forces, one a vertex", count, column.len())?;
            check_size("guesses, one a vertex", count, guess.len())?;
        }
        let matrix = StepMatrix::of_system(operator, system)?;
        if matrix.is_constant() {
            operator.factor().solve_panel(columns, &mut self.panel)?;
        } else {
            self.iterate(solver, matrix, columns, guesses, relative_tolerance)?;
        }
        match columns.iter().position(|column| !super::solver::norm(column).is_finite()) {
            Some(right_hand_side) => Err(LinearSolveError::NotFinite { right_hand_side }.into()),
            None => Ok(()),
        }
    }

    fn iterate(
        &mut self,
        solver: &StepSolver,
        matrix: StepMatrix<'_>,
        columns: &mut [Vec<Vector3<f64>>],
        guesses: &[&[Vector3<f64>]],
        relative_tolerance: f64,
    ) -> Result<(), MechanicsError> {
        let Self { direct, single, krylov, product, .. } = self;
        let references: Vec<f64> = columns.iter().map(|column| super::solver::norm(column)).collect();
        for (column, guess) in columns.iter_mut().zip(guesses) {
            product.resize(column.len(), Vector3::zeros());
            matrix.multiply(guess, product);
            column.iter_mut().zip(&*product).for_each(|(column, product)| *column -= product);
        }
        let apply = |listed: &[usize], x: &[Vec<Vector3<f64>>], y: &mut [Vec<Vector3<f64>>]| matrix.multiply_columns(listed, x, y);
        let mut precondition = |columns: &mut [Vec<Vector3<f64>>]| match solver.preconditioner() {
            Some(factor) => factor.solve_in_place(columns, single),
            None => matrix.operator.factor().solve_in_place(columns, direct),
        };
        let limits = KrylovLimits { relative_tolerance, iteration_limit: solver.iteration_limit() };
        let is_done = matrix.is_symmetric()
            && matches!(
                conjugate_gradients(&apply, &mut precondition, columns, &references, limits, krylov)?,
                ConjugateGradientOutcome::Converged(_)
            );
        if !is_done {
            gmres(&apply, &mut precondition, columns, &references, limits, krylov)?;
        }
        for (column, guess) in columns.iter_mut().zip(guesses) {
            column.iter_mut().zip(*guess).for_each(|(column, guess)| *column += guess);
        }
        Ok(())
    }
}
