//! The quadratic program of one Gauss–Newton step, in scaled coordinates δ = S z.

use nalgebra::{DMatrix, DVector};

use super::TrustShape;
use crate::numerics::{QpError, QpSolution, QuadraticProgram};
use crate::personalisation::TangentModel;
use crate::personalisation::problem::{CalibrationProblem, Linearisation};

/// Scaled multiplier, relative to the gradient, above which a bound pushes.
const PUSHES: f64 = 1e-9;

/// A step that the quadratic program proposes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Proposal {
    /// δ.
    pub(super) step: DVector<f64>,
    /// ‖z‖.
    pub(super) norm: f64,
    /// −(½ δᵀHδ + gᵀδ).
    pub(super) predicted_decrease: f64,
    /// Σ max(0, c + ∇cᵀδ).
    pub(super) linear_violation: f64,
    /// Largest multiplier of a constraint c.
    pub(super) largest_multiplier: f64,
    /// The trust region shortens the step.
    pub(super) on_trust_boundary: bool,
    /// Coordinates that the step leaves at their lower bound.
    pub(super) active_lower: Vec<usize>,
    /// Coordinates that the step leaves at their upper bound.
    pub(super) active_upper: Vec<usize>,
    /// Constraints that hold with equality after the step.
    pub(super) active_constraints: Vec<usize>,
}

impl Proposal {
    /// Whether a bound or a constraint holds the step back.
    pub(super) fn holds(&self) -> bool {
        !(self.active_lower.is_empty() && self.active_upper.is_empty() && self.active_constraints.is_empty())
    }
}

/// Scale a coordinate: the prior's standard deviation, else a quarter of the box, else one.
fn scales<M: TangentModel>(problem: &CalibrationProblem<'_, M>) -> DVector<f64> {
    DVector::from_fn(problem.dimension(), |index, _| {
        let width = problem.upper()[index] - problem.lower()[index];
        let candidates = [problem.prior().sd()[index], width / 4.0];
        candidates.into_iter().find(|scale| scale.is_finite() && *scale > 0.0).unwrap_or(1.0)
    })
}

/// ‖clamp(θ − S²g) − θ‖ in scaled coordinates: zero at a minimum of the box.
pub(super) fn projected_gradient<M: TangentModel>(problem: &CalibrationProblem<'_, M>, at: &Linearisation) -> f64 {
    let scales = scales(problem);
    let descent = &at.coordinates - at.gradient.component_mul(&scales).component_mul(&scales);
    (problem.clamp(&descent) - &at.coordinates).component_div(&scales).norm()
}

/// Whether a coordinate lies on a bound of its box.
pub(super) fn touches_bound<M: TangentModel>(problem: &CalibrationProblem<'_, M>, coordinates: &DVector<f64>) -> bool {
    (0..coordinates.len()).any(|index| coordinates[index] <= problem.lower()[index] || coordinates[index] >= problem.upper()[index])
}

/// Solves the quadratic program around `at` within `radius`.
///
/// # Errors
/// [`QpError`]; constraints that exclude each other within the trust region are relaxed to "not worse than now" first.
pub(super) fn propose<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    at: &Linearisation,
    shape: TrustShape,
    radius: f64,
) -> Result<Proposal, QpError> {
    let scales = scales(problem);
    let values = DVector::from_iterator(problem.constraints().len(), problem.constraints().map(|c| c.value(&at.coordinates)));
    let mut gradients = DMatrix::zeros(values.len(), problem.dimension());
    for (row, constraint) in problem.constraints().enumerate() {
        gradients.set_row(row, &constraint.gradient(&at.coordinates).transpose());
    }
    let solve = |room: DVector<f64>| solve_scaled(problem, at, shape, radius, &scales, &gradients, room);
    let solution = match solve(-&values) {
        Err(QpError::Infeasible) => solve((-&values).sup(&DVector::zeros(values.len())))?,
        other => other?,
    };

    let step = solution.x.component_mul(&scales);
    let after = &values + &gradients * &step;
    let pushes = |multiplier: f64| multiplier > PUSHES * at.gradient.component_mul(&scales).amax();
    let beyond_trust = |index: usize| shape == TrustShape::Box && solution.x[index].abs() >= radius * (1.0 - 1e-9);
    let on_box_side = (0..step.len())
        .any(|index| beyond_trust(index) && pushes(solution.lower_multipliers[index].max(solution.upper_multipliers[index])));
    let at_bound = |indices: &[usize], multipliers: &DVector<f64>| -> Vec<usize> {
        indices.iter().copied().filter(|&index| !beyond_trust(index) && pushes(multipliers[index])).collect()
    };
    Ok(Proposal {
        norm: solution.x.norm(),
        predicted_decrease: -solution.objective,
        linear_violation: after.iter().map(|value| value.max(0.0)).sum(),
        largest_multiplier: solution.inequality_multipliers.iter().copied().fold(0.0, f64::max),
        on_trust_boundary: solution.on_trust_boundary || on_box_side,
        active_lower: at_bound(&solution.active_lower, &solution.lower_multipliers),
        active_upper: at_bound(&solution.active_upper, &solution.upper_multipliers),
        active_constraints: solution.active_inequalities,
        step,
    })
}

/// The program in z = S⁻¹δ; `room` is the right-hand side of ∇cᵀδ ≤ room.
fn solve_scaled<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    at: &Linearisation,
    shape: TrustShape,
    radius: f64,
    scales: &DVector<f64>,
    gradients: &DMatrix<f64>,
    room: DVector<f64>,
) -> Result<QpSolution, QpError> {
    let dimension = scales.len();
    let scaled = |matrix: &DMatrix<f64>| matrix * DMatrix::from_diagonal(scales);
    let hessian = DMatrix::from_fn(dimension, dimension, |row, column| at.hessian[(row, column)] * scales[row] * scales[column]);
    let mut lower = (problem.lower() - &at.coordinates).component_div(scales);
    let mut upper = (problem.upper() - &at.coordinates).component_div(scales);
    if shape == TrustShape::Box {
        lower.apply(|bound| *bound = bound.max(-radius));
        upper.apply(|bound| *bound = bound.min(radius));
    }
    let mut program = QuadraticProgram::new(hessian, at.gradient.component_mul(scales))?.with_bounds(lower, upper)?;
    if !room.is_empty() {
        program = program.with_inequalities(scaled(gradients), room)?;
    }
    if shape == TrustShape::Ball {
        program = program.with_trust_region(DVector::from_element(dimension, 1.0), radius)?;
    }
    program.solve()
}
