//! Solves the step system: by the frozen factor where the data add no stiffness, else iteratively with a kept preconditioner.

use nalgebra::{Matrix3, Vector3};

use super::guesses::Guesses;
use super::kinematics::MeanStiffness;
use super::myocardium::check_size;
use super::preconditioner::Preconditioner;
use super::{MechanicsError, StepOperator, StepSystem};
use crate::numerics::{
    BlockMatrix, CholeskyFactor, CholeskyWorkspace, CompactWorkspace, ConjugateGradientOutcome, KrylovLimits, KrylovReport,
    KrylovWorkspace, LinearSolveError, conjugate_gradients, gmres,
};

/// Writes the products of the system's matrix with the listed columns of the first fields to those of the second.
pub(super) type Product<'a> = dyn Fn(&[usize], &[Vec<Vector3<f64>>], &mut [Vec<Vector3<f64>>]) + 'a;

/// Solves to this tolerance or a looser one are preconditioned in 16 bits an entry; closer ones would take more iterations for it.
const ROUNDED_TOLERANCE: f64 = 1e-6;

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
    /// Largest relative residual of the right-hand sides, see [`SolveSettings::relative_tolerance`].
    pub relative_residual: f64,
    /// Whether the preconditioner was factorised anew for this solve.
    pub was_refactorised: bool,
}

/// When iterative solves stop and when their preconditioner is renewed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveSettings {
    /// Residual norm over that of the right-hand side; for the position, over that of the force on the tissue at rest.
    pub relative_tolerance: f64,
    /// The same for responses that are solved for together with a position.
    pub response_tolerance: f64,
    /// Iterations after which a solve has failed.
    pub iteration_limit: usize,
    /// The preconditioner is factorised anew once the iterations it costs beyond those it cost at first sum up to this: about the
    /// iterations that a factorisation takes the time of.
    pub excess_iterations: usize,
}

impl Default for SolveSettings {
    fn default() -> Self {
        Self { relative_tolerance: 1e-8, response_tolerance: 1e-8, iteration_limit: 400, excess_iterations: 8 }
    }
}

/// Memory, preconditioner and last solutions that solves of consecutive steps share; one a thread. An iterative solution depends
/// on what was solved before within the tolerance only, and never on the number of threads.
#[derive(Debug, Default)]
pub struct StepSolver {
    settings: SolveSettings,
    direct: CholeskyWorkspace<f64>,
    single: CholeskyWorkspace<f32>,
    compact: CompactWorkspace,
    krylov: KrylovWorkspace,
    preconditioner: Option<Preconditioner>,
    columns: Vec<Vec<Vector3<f64>>>,
    reference_norms: Vec<f64>,
    guesses: Guesses,
    /// Norm that the last position's tolerance refers to, mN: that of the force on the tissue at rest.
    position_reference_mn: f64,
    /// Norms that the last responses left of their forces, in the unit of these.
    response_residuals: Vec<f64>,
}

/// K̃ + K_img: the operator's own matrix or a tangent, and the blocks that data add to its diagonal.
#[derive(Clone, Copy)]
pub(super) struct StepMatrix<'a> {
    pub(super) operator: &'a StepOperator,
    pub(super) matrix: &'a BlockMatrix,
    mean_stiffnesses: &'a [MeanStiffness],
    /// Whether its tetrahedra's part is known to be convex.
    pub(super) is_convex: bool,
    pub(super) stiffness_mn_per_mm: &'a [Matrix3<f64>],
}

impl<'a> StepMatrix<'a> {
    /// That of a system: a corotational one must have been linearised.
    pub(super) fn of_system(operator: &'a StepOperator, system: &'a StepSystem) -> Result<Self, MechanicsError> {
        let stiffness_mn_per_mm = &system.stiffness_mn_per_mm;
        check_size("stiffness blocks, one a vertex", operator.myocardium().vertex_count(), stiffness_mn_per_mm.len())?;
        match &system.tangent {
            None => Ok(Self { operator, matrix: operator.matrix(), mean_stiffnesses: &[], is_convex: true, stiffness_mn_per_mm }),
            Some(tangent) if tangent.is_linearised() => Ok(Self {
                operator,
                matrix: tangent.matrix(),
                mean_stiffnesses: tangent.mean_stiffnesses(),
                is_convex: tangent.is_convex(),
                stiffness_mn_per_mm,
            }),
            Some(_) => Err(MechanicsError::NotLinearised),
        }
    }

    pub(super) fn is_symmetric(&self) -> bool {
        self.stiffness_mn_per_mm.iter().all(is_symmetric)
    }

    /// Whether the operator's factor is that of this matrix.
    pub(super) fn is_constant(&self) -> bool {
        std::ptr::eq(self.matrix, self.operator.matrix()) && self.stiffness_mn_per_mm.iter().all(|block| *block == Matrix3::zeros())
    }

    /// Whether it is the tangent of a round of Newton's method, which has better ways to go on than to iterate on.
    pub(super) fn is_tangent(&self) -> bool {
        !std::ptr::eq(self.matrix, self.operator.matrix())
    }

    pub(super) fn multiply(&self, x: &[Vector3<f64>], product: &mut [Vector3<f64>]) {
        self.matrix.multiply(x, product);
        self.mean_stiffnesses.iter().for_each(|stiffness| stiffness.multiply_add(x, product));
        for ((y, block), x) in product.iter_mut().zip(self.stiffness_mn_per_mm).zip(x) {
            *y += block * x;
        }
    }

    pub(super) fn multiply_columns(&self, listed: &[usize], x: &[Vec<Vector3<f64>>], products: &mut [Vec<Vector3<f64>>]) {
        self.matrix.multiply_columns(listed, x, products);
        for &listed in listed {
            let (x, product) = (&x[listed], &mut products[listed]);
            self.mean_stiffnesses.iter().for_each(|stiffness| stiffness.multiply_add(x, product));
            for ((y, block), x) in product.iter_mut().zip(self.stiffness_mn_per_mm).zip(x) {
                *y += block * x;
            }
        }
    }

    /// Writes F − A x and gives its norm.
    fn subtract(&self, force_mn: &[Vector3<f64>], x: &[Vector3<f64>], residual_mn: &mut [Vector3<f64>]) -> f64 {
        self.multiply(x, residual_mn);
        residual_mn.iter_mut().zip(force_mn).for_each(|(residual, force)| *residual = force - *residual);
        norm(residual_mn)
    }
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
        if system.tangent.is_some() {
            return Err(MechanicsError::NotLinearised);
        }
        check_size("positions, one a vertex", count, position_mm.len())?;
        check_size("forces, one a vertex", count, system.force_mn.len())?;
        check_responses(count, responses)?;
        let mut columns = self.take_columns(responses);
        columns[0].resize(count, Vector3::zeros());
        let matrix = StepMatrix::of_system(operator, system)?;
        // A direct solve has no tolerance that refers to a norm.
        self.position_reference_mn =
            if matrix.is_constant() { 0.0 } else { matrix.subtract(&system.force_mn, operator.myocardium().rest_mm(), &mut columns[0]) };
        let report = self.move_position(matrix, &system.force_mn, position_mm, &mut columns[..=responses.len()]);
        for (response, column) in responses.iter_mut().zip(&columns[1..]) {
            response.copy_from_slice(column);
        }
        self.columns = columns;
        let report = report?;
        let is_direct = report.path == SolvePath::Direct;
        self.response_residuals.clear();
        self.response_residuals.extend((1..=responses.len()).map(|column| if is_direct { 0.0 } else { self.krylov.residual_norm(column) }));
        if let Some(preconditioner) = self.preconditioner.as_mut().filter(|_| !is_direct) {
            preconditioner.served(report.iteration_count);
        }
        Ok(report)
    }

    /// Moves the position of the last [`StepSolver::solve`] on, after its force has changed, to the same tolerance.
    ///
    /// # Errors
    /// As [`StepSolver::solve`].
    pub fn settle(
        &mut self,
        operator: &StepOperator,
        system: &StepSystem,
        position_mm: &mut [Vector3<f64>],
    ) -> Result<SolveReport, MechanicsError> {
        let count = operator.myocardium().vertex_count();
        check_size("positions, one a vertex", count, position_mm.len())?;
        check_size("forces, one a vertex", count, system.force_mn.len())?;
        let mut columns = self.take_columns(&[]);
        columns[0].resize(count, Vector3::zeros());
        let report = self.move_position(StepMatrix::of_system(operator, system)?, &system.force_mn, position_mm, &mut columns[..1]);
        self.columns = columns;
        report
    }

    /// Whether the last responses, times these weights, are as good as the position has to be.
    pub fn responses_suffice(&self, weights: impl Iterator<Item = f64>) -> bool {
        let missed_mn: f64 = weights.zip(&self.response_residuals).map(|(weight, residual)| weight.abs() * residual).sum();
        missed_mn <= self.settings.relative_tolerance * self.position_reference_mn
    }

    /// Corrects a position, and solves for the responses behind the first column with it. The correction of the guess is solved for, so
    /// that coordinates far from the origin cost no digits.
    fn move_position(
        &mut self,
        matrix: StepMatrix<'_>,
        force_mn: &[Vector3<f64>],
        position_mm: &mut [Vector3<f64>],
        columns: &mut [Vec<Vector3<f64>>],
    ) -> Result<SolveReport, MechanicsError> {
        matrix.subtract(force_mn, position_mm, &mut columns[0]);
        let report = self.solve_columns(matrix, columns, Some(self.position_reference_mn), self.settings.relative_tolerance)?;
        for (position, correction) in position_mm.iter_mut().zip(&columns[0]) {
            *position += correction;
        }
        Ok(report)
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
        let count = operator.myocardium().vertex_count();
        check_responses(count, responses)?;
        check_size("stiffness blocks, one a vertex", count, stiffness_mn_per_mm.len())?;
        let matrix = StepMatrix { operator, matrix: operator.matrix(), mean_stiffnesses: &[], is_convex: true, stiffness_mn_per_mm };
        self.solve_columns(matrix, responses, None, self.settings.relative_tolerance)
    }

    /// One correction of Newton's method in corotational kinematics: solves $(K_T + K_{img})\,\delta = r$ for the residual in the first
    /// column and for the forces in the others, in place (mN in, mm out), to a tolerance of its own relative to each column.
    ///
    /// # Errors
    /// [`MechanicsError::NotLinearised`] if the system has no tangent, [`MechanicsError::NotConvex`] if all is symmetric and not positive
    /// definite, and as [`StepSolver::solve`]; the columns are then undefined.
    pub fn correct(
        &mut self,
        operator: &StepOperator,
        system: &StepSystem,
        columns: &mut [Vec<Vector3<f64>>],
        relative_tolerance: f64,
    ) -> Result<SolveReport, MechanicsError> {
        if system.tangent.is_none() {
            return Err(MechanicsError::NotLinearised);
        }
        check_responses(operator.myocardium().vertex_count(), columns)?;
        let matrix = StepMatrix::of_system(operator, system)?;
        let Some(first) = columns.first() else {
            return Ok(SolveReport { path: SolvePath::Direct, iteration_count: 0, relative_residual: 0.0, was_refactorised: false });
        };
        let reference = norm(first);
        let report = self.solve_columns(matrix, columns, Some(reference), relative_tolerance)?;
        if let Some(preconditioner) = &mut self.preconditioner {
            preconditioner.served(report.iteration_count);
        }
        Ok(report)
    }

    /// The factor that iterative solves are preconditioned with, where it is not the operator's own.
    pub(super) fn preconditioner(&self) -> Option<&CholeskyFactor<f32>> {
        self.preconditioner.as_ref().and_then(Preconditioner::factor)
    }

    pub(super) fn iteration_limit(&self) -> usize {
        self.settings.iteration_limit
    }

    /// Has the next iterative solve factorise its preconditioner anew.
    pub fn forget_preconditioner(&mut self) {
        if let Some(preconditioner) = &mut self.preconditioner {
            preconditioner.use_up(self.settings.excess_iterations);
        }
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

    /// Solves for a position's correction, if its reference norm is given, and for the responses that follow.
    fn solve_columns(
        &mut self,
        matrix: StepMatrix<'_>,
        columns: &mut [Vec<Vector3<f64>>],
        position_reference: Option<f64>,
        relative_tolerance: f64,
    ) -> Result<SolveReport, MechanicsError> {
        if matrix.is_constant() {
            return self.solve_directly(matrix.operator, columns);
        }
        let was_refactorised = self.prepare_preconditioner(matrix)?;
        let first_response = usize::from(position_reference.is_some());
        self.reference_norms.clear();
        self.reference_norms.extend(position_reference);
        // One tolerance serves all columns: a looser one of the responses scales their references.
        let looser = if first_response > 0 && !matrix.is_tangent() { self.settings.response_tolerance / relative_tolerance } else { 1.0 };
        self.reference_norms.extend(columns[first_response..].iter().map(|column| norm(column) * looser));
        let product = |listed: &[usize], x: &[Vec<Vector3<f64>>], y: &mut [Vec<Vector3<f64>>]| matrix.multiply_columns(listed, x, y);
        self.guesses.subtract(&product, &mut columns[first_response..]);
        let is_symmetric = matrix.is_symmetric();
        let (path, report) = self.iterate(matrix, &product, is_symmetric, columns, relative_tolerance)?;
        self.guesses.add_and_keep(&mut columns[first_response..]);
        let KrylovReport { iteration_count, relative_residual } = report;
        Ok(SolveReport { path, iteration_count, relative_residual, was_refactorised })
    }

    fn solve_directly(&mut self, operator: &StepOperator, columns: &mut [Vec<Vector3<f64>>]) -> Result<SolveReport, MechanicsError> {
        operator.factor().solve_in_place(columns, &mut self.direct)?;
        for (right_hand_side, column) in columns.iter().enumerate() {
            if !norm(column).is_finite() {
                return Err(LinearSolveError::NotFinite { right_hand_side }.into());
            }
        }
        Ok(SolveReport { path: SolvePath::Direct, iteration_count: 0, relative_residual: 0.0, was_refactorised: false })
    }

    fn iterate(
        &mut self,
        matrix: StepMatrix<'_>,
        product: &Product<'_>,
        is_symmetric: bool,
        columns: &mut [Vec<Vector3<f64>>],
        relative_tolerance: f64,
    ) -> Result<(SolvePath, KrylovReport), MechanicsError> {
        let limits = KrylovLimits { relative_tolerance, iteration_limit: self.settings.iteration_limit };
        let Self { direct, single, compact, preconditioner, .. } = self;
        let preconditioner = preconditioner.as_ref();
        let rounded = preconditioner.and_then(Preconditioner::compact).filter(|_| relative_tolerance >= ROUNDED_TOLERANCE);
        let factors = (rounded, preconditioner.and_then(Preconditioner::factor));
        let mut precondition = |columns: &mut [Vec<Vector3<f64>>]| match factors {
            (Some(factor), _) => factor.solve_in_place(columns, compact),
            (None, Some(factor)) => factor.solve_in_place(columns, single),
            (None, None) => matrix.operator.factor().solve_in_place(columns, direct),
        };
        if is_symmetric {
            match conjugate_gradients(product, &mut precondition, columns, &self.reference_norms, limits, &mut self.krylov)? {
                ConjugateGradientOutcome::Converged(report) => return Ok((SolvePath::ConjugateGradients, report)),
                ConjugateGradientOutcome::NegativeCurvature if matrix.is_tangent() => return Err(MechanicsError::NotConvex),
                ConjugateGradientOutcome::NegativeCurvature => {}
            }
        }
        let report = gmres(product, &mut precondition, columns, &self.reference_norms, limits, &mut self.krylov)?;
        Ok((SolvePath::Gmres, report))
    }

    /// Factorises a preconditioner if there is none for this operator or the last one served badly; whether it did.
    fn prepare_preconditioner(&mut self, step: StepMatrix<'_>) -> Result<bool, MechanicsError> {
        let kept = self.preconditioner.take().filter(|kept| kept.fits(step));
        let is_good = kept.as_ref().is_some_and(|kept| kept.excess() < self.settings.excess_iterations);
        self.preconditioner = if is_good { kept } else { Some(Preconditioner::renewed(kept, step, &mut self.single)?) };
        Ok(!is_good)
    }
}

fn check_responses(count: usize, responses: &[Vec<Vector3<f64>>]) -> Result<(), MechanicsError> {
    responses.iter().try_for_each(|response| check_size("responses, one vector a vertex", count, response.len()))
}

pub(super) fn norm(field: &[Vector3<f64>]) -> f64 {
    field.iter().map(|v| v.norm_squared()).sum::<f64>().sqrt()
}

fn is_symmetric(block: &Matrix3<f64>) -> bool {
    (block - block.transpose()).norm() <= 1e-12 * block.norm()
}
