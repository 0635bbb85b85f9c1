//! Solves the step system: by the frozen factor where the data add no stiffness, else iteratively with a kept preconditioner.

use nalgebra::{Matrix3, Vector3};

use super::myocardium::check_size;
use super::{MechanicsError, StepOperator, StepSystem};
use crate::numerics::{
    BlockMatrix, CholeskyFactor, CholeskyWorkspace, ConjugateGradientOutcome, KrylovLimits, KrylovReport, KrylovWorkspace,
    LinearSolveError, conjugate_gradients, gmres,
};

/// Which way a system was solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolvePath {
    /// By the factor of K̃ alone: no stiffness was added.
    Direct,
    /// Conjugate gradients: every added block was symmetric.
    ConjugateGradients,
    /// GMRES: an added block was not symmetric, or the sum was not positive definite.
    Gmres,
}

/// How a step system was solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveReport {
    /// Which way.
    pub path: SolvePath,
    /// Iterations (0 when direct).
    pub iteration_count: usize,
    /// Largest relative residual of the right-hand sides; that of the position is relative to the force on the start guess.
    pub relative_residual: f64,
    /// Whether the preconditioner was factorised anew for this solve.
    pub was_refactorised: bool,
}

/// When iterative solves stop and when their preconditioner is renewed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveSettings {
    /// Residual norm over that of the right-hand side.
    pub relative_tolerance: f64,
    /// Iterations after which a solve has failed.
    pub iteration_limit: usize,
    /// Iterations of one solve above which the preconditioner is factorised anew before the next.
    pub refactor_above: usize,
}

impl Default for SolveSettings {
    fn default() -> Self {
        Self { relative_tolerance: 1e-8, iteration_limit: 400, refactor_above: 12 }
    }
}

/// Memory and preconditioner that solves of consecutive steps share; one a thread. A solution depends on the preconditioner's
/// past within the tolerance only, and never on the number of threads.
#[derive(Debug, Default)]
pub struct StepSolver {
    settings: SolveSettings,
    cholesky: CholeskyWorkspace,
    krylov: KrylovWorkspace,
    preconditioner: Option<Preconditioner>,
    columns: Vec<Vec<Vector3<f64>>>,
}

/// The factor of K̃ + sym⁺(K_img) at an earlier step.
#[derive(Debug)]
struct Preconditioner {
    matrix: BlockMatrix,
    factor: CholeskyFactor,
    is_stale: bool,
    /// h of the operator it was made for.
    step_s: f64,
}

impl StepSolver {
    /// A solver with other settings than the default ones.
    pub fn new(settings: SolveSettings) -> Self {
        Self { settings, ..Self::default() }
    }

    /// Solves $(\tilde K + K_{img})\,Y = F$ from the guess in `position_mm`, which the solution replaces, and together with it
    /// $(\tilde K + K_{img})\,R_k = G_k$ for every response G_k (mN; e.g. one ∂V/∂y a cavity), in place (mm).
    ///
    /// # Errors
    /// [`MechanicsError::Solve`] with the residual and the iteration count; position and responses are then undefined.
    pub fn solve(
        &mut self,
        operator: &StepOperator,
        system: &StepSystem,
        position_mm: &mut [Vector3<f64>],
        responses: &mut [Vec<Vector3<f64>>],
    ) -> Result<SolveReport, MechanicsError> {
        let count = operator.myocardium().vertex_count();
        check_size("positions, one a vertex", count, position_mm.len())?;
        check_size("forces, one a vertex", count, system.force_mn.len())?;
        // The correction of the guess is solved for: its residual is small from the start, and coordinates do not enter it.
        for response in responses.iter() {
            check_size("responses, one vector a vertex", count, response.len())?;
        }
        let mut columns = self.take_columns(responses);
        columns[0].resize(count, Vector3::zeros());
        apply(operator, &system.stiffness_mn_per_mm, position_mm, &mut columns[0]);
        for (residual, force) in columns[0].iter_mut().zip(&system.force_mn) {
            *residual = force - *residual;
        }
        let report = self.solve_columns(operator, &system.stiffness_mn_per_mm, &mut columns[..=responses.len()]);
        for (position, correction) in position_mm.iter_mut().zip(&columns[0]) {
            *position += correction;
        }
        for (response, column) in responses.iter_mut().zip(&columns[1..]) {
            response.copy_from_slice(column);
        }
        self.columns = columns;
        report
    }

    /// Solves $(\tilde K + K_{img})\,R_k = G_k$ for every response, in place: mN in, mm out.
    ///
    /// # Errors
    /// As [`StepSolver::solve`].
    pub fn solve_responses(
        &mut self,
        operator: &StepOperator,
        stiffness_mn_per_mm: &[Matrix3<f64>],
        responses: &mut [Vec<Vector3<f64>>],
    ) -> Result<SolveReport, MechanicsError> {
        for response in responses.iter() {
            check_size("responses, one vector a vertex", operator.myocardium().vertex_count(), response.len())?;
        }
        self.solve_columns(operator, stiffness_mn_per_mm, responses)
    }

    /// Copies the responses behind a first, free column.
    fn take_columns(&mut self, responses: &[Vec<Vector3<f64>>]) -> Vec<Vec<Vector3<f64>>> {
        let mut columns = std::mem::take(&mut self.columns);
        columns.resize_with(columns.len().max(1 + responses.len()), Vec::new);
        for (column, response) in columns[1..].iter_mut().zip(responses) {
            column.clear();
            column.extend_from_slice(response);
        }
        columns
    }

    fn solve_columns(
        &mut self,
        operator: &StepOperator,
        stiffness_mn_per_mm: &[Matrix3<f64>],
        columns: &mut [Vec<Vector3<f64>>],
    ) -> Result<SolveReport, MechanicsError> {
        check_size("stiffness blocks, one a vertex", operator.myocardium().vertex_count(), stiffness_mn_per_mm.len())?;
        if stiffness_mn_per_mm.iter().all(|block| *block == Matrix3::zeros()) {
            return self.solve_directly(operator, columns);
        }
        let was_refactorised = self.prepare_preconditioner(operator, stiffness_mn_per_mm)?;
        let limits = KrylovLimits { relative_tolerance: self.settings.relative_tolerance, iteration_limit: self.settings.iteration_limit };
        let (path, report) = self.iterate(operator, stiffness_mn_per_mm, columns, limits)?;
        if let Some(preconditioner) = &mut self.preconditioner {
            preconditioner.is_stale = report.iteration_count > self.settings.refactor_above;
        }
        let KrylovReport { iteration_count, relative_residual } = report;
        Ok(SolveReport { path, iteration_count, relative_residual, was_refactorised })
    }

    fn solve_directly(&mut self, operator: &StepOperator, columns: &mut [Vec<Vector3<f64>>]) -> Result<SolveReport, MechanicsError> {
        operator.factor().solve_in_place(columns, &mut self.cholesky)?;
        for (right_hand_side, column) in columns.iter().enumerate() {
            if !column.iter().all(|v| v.iter().all(|c| c.is_finite())) {
                return Err(LinearSolveError::NotFinite { right_hand_side }.into());
            }
        }
        Ok(SolveReport { path: SolvePath::Direct, iteration_count: 0, relative_residual: 0.0, was_refactorised: false })
    }

    fn iterate(
        &mut self,
        operator: &StepOperator,
        stiffness_mn_per_mm: &[Matrix3<f64>],
        columns: &mut [Vec<Vector3<f64>>],
        limits: KrylovLimits,
    ) -> Result<(SolvePath, KrylovReport), MechanicsError> {
        let (cholesky, krylov) = (&mut self.cholesky, &mut self.krylov);
        let factor = self.preconditioner.as_ref().map_or(operator.factor(), |kept| &kept.factor);
        let product = |x: &[Vector3<f64>], y: &mut [Vector3<f64>]| apply(operator, stiffness_mn_per_mm, x, y);
        let mut precondition = |columns: &mut [Vec<Vector3<f64>>]| factor.solve_in_place(columns, cholesky);
        if stiffness_mn_per_mm.iter().all(is_symmetric) {
            match conjugate_gradients(&product, &mut precondition, columns, limits, krylov)? {
                ConjugateGradientOutcome::Converged(report) => return Ok((SolvePath::ConjugateGradients, report)),
                ConjugateGradientOutcome::NegativeCurvature => {}
            }
        }
        let report = gmres(&product, &mut precondition, columns, limits, krylov)?;
        Ok((SolvePath::Gmres, report))
    }

    /// Factorises K̃ + sym⁺(K_img) if there is no preconditioner for this operator or the last one served badly.
    fn prepare_preconditioner(&mut self, operator: &StepOperator, stiffness_mn_per_mm: &[Matrix3<f64>]) -> Result<bool, MechanicsError> {
        let kept = self.preconditioner.take().filter(|kept| {
            kept.step_s == operator.step_s() && std::sync::Arc::ptr_eq(kept.factor.structure(), operator.factor().structure())
        });
        let mut preconditioner = match kept {
            Some(kept) if !kept.is_stale => {
                self.preconditioner = Some(kept);
                return Ok(false);
            }
            Some(kept) => kept,
            None => Preconditioner {
                matrix: operator.matrix().clone(),
                factor: operator.factor().clone(),
                is_stale: false,
                step_s: operator.step_s(),
            },
        };
        preconditioner.matrix.copy_from(operator.matrix());
        for (vertex, block) in stiffness_mn_per_mm.iter().enumerate().filter(|(_, block)| **block != Matrix3::zeros()) {
            preconditioner.matrix.add_to_diagonal(vertex, &positive_part(block));
        }
        preconditioner.factor.refactorise(&preconditioner.matrix, &mut self.cholesky)?;
        preconditioner.is_stale = false;
        self.preconditioner = Some(preconditioner);
        Ok(true)
    }
}

/// (K̃ + K_img) x.
fn apply(operator: &StepOperator, stiffness_mn_per_mm: &[Matrix3<f64>], x: &[Vector3<f64>], product: &mut [Vector3<f64>]) {
    operator.matrix().multiply(x, product);
    for ((y, block), x) in product.iter_mut().zip(stiffness_mn_per_mm).zip(x) {
        *y += block * x;
    }
}

fn is_symmetric(block: &Matrix3<f64>) -> bool {
    (block - block.transpose()).norm() <= 1e-12 * block.norm()
}

/// The symmetric part without its negative eigenvalues, so that the preconditioner stays positive definite.
fn positive_part(block: &Matrix3<f64>) -> Matrix3<f64> {
    if !block.iter().all(|entry| entry.is_finite()) {
        return Matrix3::zeros();
    }
    let symmetric = (block + block.transpose()) / 2.0;
    let mut eigen = symmetric.symmetric_eigen();
    eigen.eigenvalues.apply(|value| *value = value.max(0.0));
    eigen.recompose()
}
