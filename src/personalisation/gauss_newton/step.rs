//! The quadratic program of one Gauss–Newton step, in scaled coordinates δ = S z.
//!
//! With Huber's loss the linearised objective Σ ρ(r + Jδ) is minimised exactly, by reweighting the program until its own weights agree.

use nalgebra::{DMatrix, DVector};

use super::TrustShape;
use crate::numerics::{QpError, QpSolution, QuadraticProgram};
use crate::personalisation::TangentModel;
use crate::personalisation::problem::{CalibrationProblem, Linearisation};

/// Scaled multiplier, relative to the gradient, above which a bound pushes.
const PUSHES: f64 = 1e-9;
/// Most programs for one robust step.
const REWEIGHTINGS: usize = 60;
/// Change of the scaled step under which reweighting has settled.
const REWEIGHTED: f64 = 1e-9;

/// A step that the quadratic program proposes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Proposal {
    /// δ.
    pub(super) step: DVector<f64>,
    /// ‖z‖.
    pub(super) norm: f64,
    /// Decrease of the objective with linearised residuals.
    pub(super) predicted_decrease: f64,
    /// Σ max(0, c + ∇cᵀδ).
    pub(super) linear_violation: f64,
    /// Penalty on a violation that outweighs the objective.
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

/// Box, trust region and linearised constraints in scaled coordinates: l ≤ z ≤ u, G z ≤ h.
struct Region {
    shape: TrustShape,
    radius: f64,
    scales: DVector<f64>,
    lower: DVector<f64>,
    upper: DVector<f64>,
    gradients: DMatrix<f64>,
    room: DVector<f64>,
}

/// ‖clamp(θ − S²g) − θ‖ in scaled coordinates: zero at a minimum of the box.
pub(super) fn projected_gradient<M: TangentModel>(problem: &CalibrationProblem<'_, M>, at: &Linearisation) -> f64 {
    let scales = problem.scales();
    let descent = &at.coordinates - at.gradient().component_mul(&scales).component_mul(&scales);
    (problem.clamp(&descent) - &at.coordinates).component_div(&scales).norm()
}

/// Whether a coordinate lies on a bound of its box.
pub(super) fn touches_bound<M: TangentModel>(problem: &CalibrationProblem<'_, M>, coordinates: &DVector<f64>) -> bool {
    (0..coordinates.len()).any(|index| coordinates[index] <= problem.lower()[index] || coordinates[index] >= problem.upper()[index])
}

/// Minimises the linearised objective around `at` within `radius`. Constraints that cannot be met within the trust region are met as far
/// as possible, through an exact penalty.
///
/// # Errors
/// [`QpError`].
pub(super) fn propose<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    at: &Linearisation,
    shape: TrustShape,
    radius: f64,
) -> Result<Proposal, QpError> {
    let region = Region::around(problem, &at.coordinates, shape, radius);
    let (solution, penalty) = region.minimise_robust(at)?;
    let z = solution.x.rows(0, region.scales.len()).into_owned();
    let step = z.component_mul(&region.scales);

    let smallest = PUSHES * at.gradient().component_mul(&region.scales).amax();
    let beyond_trust = |index: usize| shape == TrustShape::Box && z[index].abs() >= radius * (1.0 - 1e-9);
    let pushed = |index: usize| solution.lower_multipliers[index].max(solution.upper_multipliers[index]) > smallest;
    let at_bound = |indices: &[usize], multipliers: &DVector<f64>| -> Vec<usize> {
        let holds = |index: &usize| *index < z.len() && !beyond_trust(*index) && multipliers[*index] > smallest;
        indices.iter().copied().filter(holds).collect()
    };
    let violation = (&region.gradients * &z - &region.room).sup(&DVector::zeros(region.room.len())).sum();
    Ok(Proposal {
        norm: z.norm(),
        predicted_decrease: if at.is_robust() || penalty > 0.0 {
            at.model_cost(&DVector::zeros(step.len())) - at.model_cost(&step)
        } else {
            -solution.objective
        },
        linear_violation: violation,
        largest_multiplier: solution.inequality_multipliers.iter().copied().fold(penalty, f64::max),
        on_trust_boundary: solution.on_trust_boundary || (0..z.len()).any(|index| beyond_trust(index) && pushed(index)),
        active_lower: at_bound(&solution.active_lower, &solution.lower_multipliers),
        active_upper: at_bound(&solution.active_upper, &solution.upper_multipliers),
        active_constraints: solution.active_inequalities,
        step,
    })
}

impl Region {
    fn around<M: TangentModel>(problem: &CalibrationProblem<'_, M>, theta: &DVector<f64>, shape: TrustShape, radius: f64) -> Self {
        let scales = problem.scales();
        let count = problem.constraints().len();
        let room = -DVector::from_iterator(count, problem.constraints().map(|constraint| constraint.value(theta)));
        let mut gradients = DMatrix::zeros(count, scales.len());
        for (row, constraint) in problem.constraints().enumerate() {
            gradients.set_row(row, &constraint.gradient(theta).component_mul(&scales).transpose());
        }
        let mut lower = (problem.lower() - theta).component_div(&scales);
        let mut upper = (problem.upper() - theta).component_div(&scales);
        if shape == TrustShape::Box {
            lower.apply(|bound| *bound = bound.max(-radius));
            upper.apply(|bound| *bound = bound.min(radius));
        }
        Self { shape, radius, scales, lower, upper, gradients, room }
    }

    /// The minimiser and the penalty that was needed (0 where the constraints can be met).
    fn minimise_robust(&self, at: &Linearisation) -> Result<(QpSolution, f64), QpError> {
        let mut weights = at.weights(&at.rows);
        let mut found = self.minimise(&at.quadratic_model(&weights))?;
        if at.is_robust() {
            for _ in 0..REWEIGHTINGS {
                let step = found.0.x.rows(0, self.scales.len()).component_mul(&self.scales);
                weights = at.weights(&(&at.rows + &at.jacobian * step));
                let next = self.minimise(&at.quadratic_model(&weights))?;
                let change = (&next.0.x - &found.0.x).amax();
                found = next;
                if change < REWEIGHTED {
                    break;
                }
            }
        }
        Ok(found)
    }

    fn minimise(&self, (hessian, gradient): &(DMatrix<f64>, DVector<f64>)) -> Result<(QpSolution, f64), QpError> {
        let dimension = self.scales.len();
        let hessian = DMatrix::from_fn(dimension, dimension, |row, column| hessian[(row, column)] * self.scales[row] * self.scales[column]);
        let gradient = gradient.component_mul(&self.scales);
        match self.solve(hessian.clone(), gradient.clone(), None) {
            Err(QpError::Infeasible) => {
                // Steeper than the objective anywhere within the trust region.
                let slope = gradient.norm() + hessian.norm() * self.radius;
                let reach = self.gradients.row_iter().map(|row| row.norm()).filter(|norm| *norm > 0.0).fold(f64::INFINITY, f64::min);
                let penalty = 10.0 * slope / reach;
                self.solve(hessian, gradient, Some(penalty)).map(|solution| (solution, penalty))
            }
            other => other.map(|solution| (solution, 0.0)),
        }
    }

    /// With a `penalty` π the variables are (z, t) and G z − t ≤ h, t ≥ 0 costs π Σ t.
    fn solve(&self, hessian: DMatrix<f64>, gradient: DVector<f64>, penalty: Option<f64>) -> Result<QpSolution, QpError> {
        let (dimension, count) = (self.scales.len(), self.room.len());
        let slack_count = if penalty.is_some() { count } else { 0 };
        let size = dimension + slack_count;
        let hessian = hessian.resize(size, size, 0.0);
        let gradient = gradient.resize_vertically(size, penalty.unwrap_or(0.0));
        let lower = self.lower.clone().resize_vertically(size, 0.0);
        let upper = self.upper.clone().resize_vertically(size, f64::INFINITY);
        let mut program = QuadraticProgram::new(hessian, gradient)?.with_bounds(lower, upper)?;
        if count > 0 {
            let mut matrix = self.gradients.clone().resize_horizontally(size, 0.0);
            for slack in 0..slack_count {
                matrix[(slack, dimension + slack)] = -1.0;
            }
            program = program.with_inequalities(matrix, self.room.clone())?;
        }
        if self.shape == TrustShape::Ball {
            let scale = DVector::from_element(dimension, 1.0).resize_vertically(size, 0.0);
            program = program.with_trust_region(scale, self.radius)?;
        }
        program.solve()
    }
}
