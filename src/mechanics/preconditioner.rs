//! The factor that iterative solves of consecutive steps are preconditioned with: kept while it serves, then made anew.

use std::sync::Arc;

use nalgebra::Matrix3;

use super::MechanicsError;
use super::solver::StepMatrix;
use crate::numerics::{BlockMatrix, CholeskyFactor, CholeskyWorkspace, CompactFactor, LinearSolveError};

/// The factor of K̃ + sym⁺(K_img) at an earlier step, in single precision.
#[derive(Debug)]
pub(super) struct Preconditioner {
    matrix: BlockMatrix,
    factor: Option<CholeskyFactor<f32>>,
    /// The same in half the memory, for the loose tolerances and the few columns of a step of linear kinematics.
    compact: Option<CompactFactor>,
    /// Fewest iterations of a solve that did not follow its factorisation.
    kept_floor: Option<usize>,
    excess: usize,
    /// h of the operator it was made for.
    step_s: f64,
    is_fresh: bool,
}

impl Preconditioner {
    /// None where single precision found the matrix not positive definite: then the operator's own factor serves.
    pub(super) fn factor(&self) -> Option<&CholeskyFactor<f32>> {
        self.factor.as_ref()
    }

    /// The factor rounded to 16 bits an entry; none for a tangent, whose rounds are solved closely.
    pub(super) fn compact(&self) -> Option<&CompactFactor> {
        self.compact.as_ref()
    }

    /// Iterations that it has cost beyond those it cost at first.
    pub(super) fn excess(&self) -> usize {
        self.excess
    }

    /// Counts a solve that took this many iterations.
    pub(super) fn served(&mut self, iteration_count: usize) {
        if std::mem::take(&mut self.is_fresh) {
            return;
        }
        let floor = self.kept_floor.map_or(iteration_count, |floor| floor.min(iteration_count));
        self.kept_floor = Some(floor);
        self.excess += iteration_count - floor;
    }

    /// Has the next solve find it used up.
    pub(super) fn use_up(&mut self, excess_limit: usize) {
        self.excess = excess_limit;
    }

    /// Whether it was made for the step and the pattern of a matrix.
    pub(super) fn fits(&self, step: StepMatrix<'_>) -> bool {
        self.step_s == step.operator.step_s() && Arc::ptr_eq(self.matrix.pattern(), step.operator.matrix().pattern())
    }

    /// Factorises K̃ + sym⁺(K_img), in the memory of an earlier one that fits.
    pub(super) fn renewed(
        earlier: Option<Self>,
        step: StepMatrix<'_>,
        workspace: &mut CholeskyWorkspace<f32>,
    ) -> Result<Self, MechanicsError> {
        let (mut matrix, factor, compact) =
            earlier.map_or_else(|| (step.matrix.clone(), None, None), |earlier| (earlier.matrix, earlier.factor, earlier.compact));
        matrix.copy_from(step.matrix);
        for (vertex, block) in step.stiffness_mn_per_mm.iter().enumerate().filter(|(_, block)| **block != Matrix3::zeros()) {
            matrix.add_to_diagonal(vertex, &positive_part(block));
        }
        let factorised = match factor {
            Some(mut factor) => factor.refactorise(&matrix, workspace).map(|()| factor),
            None => CholeskyFactor::new(Arc::clone(step.operator.factor().structure()), &matrix, workspace),
        };
        let factor = match factorised {
            Ok(factor) => Some(factor),
            Err(LinearSolveError::NotPositiveDefinite { .. }) if step.is_tangent() && !step.is_convex => {
                return Err(MechanicsError::NotConvex);
            }
            Err(LinearSolveError::NotPositiveDefinite { .. }) => None,
            Err(error) => return Err(error.into()),
        };
        let compact = match (&factor, compact) {
            (Some(factor), Some(mut compact)) if !step.is_tangent() => compact.renew(factor).map(|()| Some(compact))?,
            (Some(factor), None) if !step.is_tangent() => Some(CompactFactor::new(factor)),
            _ => None,
        };
        Ok(Self { matrix, factor, compact, kept_floor: None, excess: 0, step_s: step.operator.step_s(), is_fresh: true })
    }
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
