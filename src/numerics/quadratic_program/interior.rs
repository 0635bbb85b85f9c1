//! The conic solve: clarabel's interior-point method finds a point close to the minimiser, and the active set.

use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::{NonnegativeConeT, SecondOrderConeT, ZeroConeT};
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus};
use nalgebra::{DMatrix, DVector};

use super::{PrimalDual, QpError, QuadraticProgram, Stack, TrustRegion};

/// Relative distance to the trust boundary under which the trust region counts as active.
const TRUST_ACTIVE: f64 = 1e-6;

impl QuadraticProgram {
    /// The interior-point solve; the objective is scaled to unit size so that its tolerances are relative.
    pub(super) fn solve_interior(&self, stack: &Stack) -> Result<(PrimalDual, u32), QpError> {
        let variable_count = self.gradient.len();
        let linear_count = stack.origins.len();
        let objective_scale = self.objective_scale();
        let hessian = upper_triangle(&(&self.hessian / objective_scale));
        let gradient: Vec<f64> = self.gradient.iter().map(|entry| entry / objective_scale).collect();
        let mut constraints = stack.rows.matrix.clone();
        let mut rhs: Vec<f64> = stack.rows.rhs.iter().copied().collect();
        let mut cones = vec![ZeroConeT(stack.equality_count), NonnegativeConeT(linear_count - stack.equality_count)];
        if let Some(TrustRegion { scale, radius }) = &self.trust {
            // (Δ, S x) in the second-order cone: rows b − A x with A = (0; −S).
            constraints = constraints.resize_vertically(linear_count + variable_count + 1, 0.0);
            for variable in 0..variable_count {
                constraints[(linear_count + 1 + variable, variable)] = -scale[variable];
            }
            rhs.push(*radius);
            rhs.extend(std::iter::repeat_n(0.0, variable_count));
            cones.push(SecondOrderConeT(variable_count + 1));
        }
        let settings = DefaultSettings { verbose: false, max_threads: 1, ..DefaultSettings::default() };
        let not_converged = |status: String| QpError::NotConverged { status, iterations: 0 };
        let mut solver = DefaultSolver::new(&hessian, &gradient, &sparse(&constraints), &rhs, &cones, settings)
            .map_err(|error| not_converged(error.to_string()))?;
        solver.solve();
        let answer = &solver.solution;
        match answer.status {
            SolverStatus::Solved => {}
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => return Err(QpError::Infeasible),
            SolverStatus::DualInfeasible | SolverStatus::AlmostDualInfeasible => return Err(QpError::Unbounded),
            status => return Err(QpError::NotConverged { status: status.to_string(), iterations: answer.iterations }),
        }

        let x = DVector::from_column_slice(&answer.x);
        let scaled_multipliers = DVector::from_column_slice(&answer.z[..linear_count]);
        let active = (0..linear_count).map(|row| row < stack.equality_count || answer.z[row] > answer.s[row]).collect();
        let norm = |trust: &TrustRegion| trust.scale.component_mul(&x).norm();
        // The cone's dual is (z₀, −z₀ S x/Δ): S x is pulled back by z₀/Δ.
        let trust_multiplier = self.trust.as_ref().map_or(0.0, |trust| objective_scale * answer.z[linear_count] / trust.radius);
        let on_trust_boundary = self.trust.as_ref().is_some_and(|trust| norm(trust) > trust.radius * (1.0 - TRUST_ACTIVE));
        let multipliers = scaled_multipliers * objective_scale;
        Ok((PrimalDual { x, multipliers, active, trust_multiplier, on_trust_boundary }, answer.iterations))
    }
}

fn sparse(matrix: &DMatrix<f64>) -> CscMatrix<f64> {
    columns(matrix, |_, _| true)
}

fn upper_triangle(matrix: &DMatrix<f64>) -> CscMatrix<f64> {
    columns(matrix, |row, column| row <= column)
}

/// Compressed columns of the non-zero entries that `keep(row, column)` admits.
fn columns(matrix: &DMatrix<f64>, keep: impl Fn(usize, usize) -> bool) -> CscMatrix<f64> {
    let (mut starts, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
    for column in 0..matrix.ncols() {
        for row in 0..matrix.nrows() {
            if keep(row, column) && matrix[(row, column)] != 0.0 {
                rows.push(row);
                values.push(matrix[(row, column)]);
            }
        }
        starts.push(rows.len());
    }
    CscMatrix::new(matrix.nrows(), matrix.ncols(), starts, rows, values)
}
