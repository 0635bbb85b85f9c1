//! Small dense convex quadratic programs with bounds and a trust region: a conic solve, then an exact solve on its active set.
//!
//! $$ \min_x \tfrac12 x^\top H x + g^\top x \quad\text{s.t.}\quad A x = b,\; G x \le h,\; l \le x \le u,\; \lVert S x\rVert \le \Delta $$
//!
//! The interior-point method of [Goulart2024] finds the active set; where the trust region is not active, the equality-constrained
//! problem on that set is solved by one dense factorisation, so that multipliers and steps are exact to rounding (the "polish" of
//! [Stellato2020] §4).

use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::{NonnegativeConeT, SecondOrderConeT, ZeroConeT};
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus};
use nalgebra::{DMatrix, DVector};

/// Slack relative to the size of the problem under which a polished solution counts as feasible.
const POLISH_TOLERANCE: f64 = 1e-9;
/// Relative distance to the trust boundary under which the trust region counts as active.
const TRUST_ACTIVE: f64 = 1e-6;
/// Smallest eigenvalue relative to the largest entry under which a Hessian counts as indefinite.
const INDEFINITE: f64 = 1e-9;

/// Why a quadratic program has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum QpError {
    /// Sizes do not match.
    #[error("quadratic program: {what} has {found} entries where {expected} are needed")]
    Shape {
        /// Which datum.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size needed.
        expected: usize,
    },
    /// A datum is NaN or infinite.
    #[error("quadratic program: {what} is not finite")]
    NonFinite {
        /// Which datum.
        what: &'static str,
    },
    /// The Hessian is not symmetric.
    #[error("quadratic program: the Hessian is not symmetric (largest difference {difference:e})")]
    Asymmetric {
        /// Largest |H − Hᵀ|.
        difference: f64,
    },
    /// The Hessian has a negative eigenvalue: the problem is not convex.
    #[error("quadratic program: the Hessian has the negative eigenvalue {eigenvalue:e}; add regularisation or a prior")]
    Indefinite {
        /// The smallest eigenvalue.
        eigenvalue: f64,
    },
    /// A lower bound lies above its upper bound.
    #[error("quadratic program: bounds of variable {variable} exclude each other ({lower} > {upper})")]
    BoundsCross {
        /// Index of the variable.
        variable: usize,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// The trust radius is not positive or a scale is negative.
    #[error(
        "quadratic program: trust region with radius {radius} and smallest scale {scale}; the radius must be positive, no scale negative"
    )]
    TrustRegion {
        /// Radius.
        radius: f64,
        /// Smallest scale.
        scale: f64,
    },
    /// No point satisfies all constraints.
    #[error("quadratic program: the constraints exclude each other")]
    Infeasible,
    /// The objective falls without end.
    #[error("quadratic program: unbounded below; add bounds, a trust region or a prior")]
    Unbounded,
    /// The interior-point iteration stopped without a solution.
    #[error("quadratic program: not converged after {iterations} iterations ({status})")]
    NotConverged {
        /// What the solver says.
        status: String,
        /// Iterations done.
        iterations: u32,
    },
}

/// Rows `matrix` · x compared with `rhs`.
#[derive(Debug, Clone, PartialEq)]
struct Rows {
    matrix: DMatrix<f64>,
    rhs: DVector<f64>,
}

/// An ellipsoid ‖diag(scale) x‖ ≤ radius.
#[derive(Debug, Clone, PartialEq)]
struct TrustRegion {
    scale: DVector<f64>,
    radius: f64,
}

/// A checked convex quadratic program in n variables.
#[derive(Debug, Clone, PartialEq)]
pub struct QuadraticProgram {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    equalities: Rows,
    inequalities: Rows,
    lower: DVector<f64>,
    upper: DVector<f64>,
    trust: Option<TrustRegion>,
}

/// A minimiser with its multipliers: H x + g + Aᵀλ + Gᵀμ − μ_l + μ_u + μ_Δ S²x = 0.
#[derive(Debug, Clone, PartialEq)]
pub struct QpSolution {
    /// The minimiser, n.
    pub x: DVector<f64>,
    /// ½ xᵀ H x + gᵀ x.
    pub objective: f64,
    /// Multipliers λ of A x = b.
    pub equality_multipliers: DVector<f64>,
    /// Multipliers μ ≥ 0 of G x ≤ h.
    pub inequality_multipliers: DVector<f64>,
    /// Multipliers μ_l ≥ 0 of l ≤ x, n.
    pub lower_multipliers: DVector<f64>,
    /// Multipliers μ_u ≥ 0 of x ≤ u, n.
    pub upper_multipliers: DVector<f64>,
    /// Multiplier μ_Δ ≥ 0 of the trust region, in units of H over S².
    pub trust_multiplier: f64,
    /// Rows of G x ≤ h that hold with equality, ascending.
    pub active_inequalities: Vec<usize>,
    /// Variables at their lower bound, ascending.
    pub active_lower: Vec<usize>,
    /// Variables at their upper bound, ascending.
    pub active_upper: Vec<usize>,
    /// Whether the trust region holds the step back.
    pub on_trust_boundary: bool,
    /// Interior-point iterations.
    pub iterations: u32,
}

/// Where a row of the stacked constraints comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RowOrigin {
    Equality(usize),
    Fixed(usize),
    Inequality(usize),
    Lower(usize),
    Upper(usize),
}

/// All linear constraints in one matrix: equalities first, then inequalities.
struct Stack {
    rows: Rows,
    origins: Vec<RowOrigin>,
    equality_count: usize,
}

/// A primal-dual pair of the stacked problem.
struct PrimalDual {
    x: DVector<f64>,
    multipliers: DVector<f64>,
    active: Vec<bool>,
    trust_multiplier: f64,
    on_trust_boundary: bool,
}

impl QuadraticProgram {
    /// The unconstrained problem of a symmetric positive semi-definite `hessian` (n × n) and a `gradient` (n).
    ///
    /// # Errors
    /// [`QpError`] if sizes differ, an entry is not finite, or the Hessian is asymmetric or indefinite.
    pub fn new(hessian: DMatrix<f64>, gradient: DVector<f64>) -> Result<Self, QpError> {
        let size = gradient.len();
        check_shape("the Hessian's rows", hessian.nrows(), size)?;
        check_shape("the Hessian's columns", hessian.ncols(), size)?;
        check_finite("the Hessian", hessian.as_slice())?;
        check_finite("the gradient", gradient.as_slice())?;
        let scale = hessian.amax();
        let difference = (&hessian - hessian.transpose()).amax();
        if difference > 1e-10 * scale {
            return Err(QpError::Asymmetric { difference });
        }
        if size > 0 {
            let eigenvalue = hessian.symmetric_eigenvalues().min();
            if eigenvalue < -INDEFINITE * scale {
                return Err(QpError::Indefinite { eigenvalue });
            }
        }
        let none = || Rows { matrix: DMatrix::zeros(0, size), rhs: DVector::zeros(0) };
        Ok(Self {
            hessian,
            gradient,
            equalities: none(),
            inequalities: none(),
            lower: DVector::from_element(size, f64::NEG_INFINITY),
            upper: DVector::from_element(size, f64::INFINITY),
            trust: None,
        })
    }

    /// Adds A x = b.
    ///
    /// # Errors
    /// [`QpError`] if sizes differ or an entry is not finite.
    pub fn with_equalities(mut self, matrix: DMatrix<f64>, rhs: DVector<f64>) -> Result<Self, QpError> {
        self.equalities = self.checked_rows("the equalities", matrix, rhs)?;
        Ok(self)
    }

    /// Adds G x ≤ h.
    ///
    /// # Errors
    /// [`QpError`] if sizes differ or an entry is not finite.
    pub fn with_inequalities(mut self, matrix: DMatrix<f64>, rhs: DVector<f64>) -> Result<Self, QpError> {
        self.inequalities = self.checked_rows("the inequalities", matrix, rhs)?;
        Ok(self)
    }

    /// Adds l ≤ x ≤ u; infinite bounds mean none, equal bounds fix the variable.
    ///
    /// # Errors
    /// [`QpError`] if sizes differ, a bound is NaN or bounds cross.
    pub fn with_bounds(mut self, lower: DVector<f64>, upper: DVector<f64>) -> Result<Self, QpError> {
        check_shape("the lower bounds", lower.len(), self.gradient.len())?;
        check_shape("the upper bounds", upper.len(), self.gradient.len())?;
        for (variable, (&lower, &upper)) in lower.iter().zip(&upper).enumerate() {
            if lower.is_nan() || upper.is_nan() || lower == f64::INFINITY || upper == f64::NEG_INFINITY {
                return Err(QpError::NonFinite { what: "a bound" });
            }
            if lower > upper {
                return Err(QpError::BoundsCross { variable, lower, upper });
            }
        }
        self.lower = lower;
        self.upper = upper;
        Ok(self)
    }

    /// Adds the trust region ‖diag(`scale`) x‖ ≤ `radius`; a scale of zero leaves a variable free of it.
    ///
    /// # Errors
    /// [`QpError`] if sizes differ, the radius is not positive, a scale is negative, or one of them is not finite.
    pub fn with_trust_region(mut self, scale: DVector<f64>, radius: f64) -> Result<Self, QpError> {
        check_shape("the trust region's scale", scale.len(), self.gradient.len())?;
        check_finite("the trust region's scale", scale.as_slice())?;
        check_finite("the trust radius", &[radius])?;
        let smallest = scale.iter().copied().fold(f64::INFINITY, f64::min);
        if radius <= 0.0 || smallest < 0.0 {
            return Err(QpError::TrustRegion { radius, scale: smallest });
        }
        self.trust = Some(TrustRegion { scale, radius });
        Ok(self)
    }

    /// The minimiser.
    ///
    /// # Errors
    /// [`QpError::Infeasible`], [`QpError::Unbounded`] or [`QpError::NotConverged`].
    pub fn solve(&self) -> Result<QpSolution, QpError> {
        let stack = self.stack();
        let (interior, iterations) = self.solve_interior(&stack)?;
        let answer = self.polish(&stack, &interior).unwrap_or(interior);
        Ok(self.solution(&stack, answer, iterations))
    }

    /// ½ xᵀ H x + gᵀ x.
    pub fn objective(&self, x: &DVector<f64>) -> f64 {
        0.5 * x.dot(&(&self.hessian * x)) + self.gradient.dot(x)
    }

    fn checked_rows(&self, what: &'static str, matrix: DMatrix<f64>, rhs: DVector<f64>) -> Result<Rows, QpError> {
        check_shape(what, matrix.ncols(), self.gradient.len())?;
        check_shape(what, matrix.nrows(), rhs.len())?;
        check_finite(what, matrix.as_slice())?;
        check_finite(what, rhs.as_slice())?;
        Ok(Rows { matrix, rhs })
    }

    fn stack(&self) -> Stack {
        let variable_count = self.gradient.len();
        let fixed = |variable: usize| self.lower[variable] == self.upper[variable];
        let mut origins: Vec<RowOrigin> = (0..self.equalities.rhs.len()).map(RowOrigin::Equality).collect();
        origins.extend((0..variable_count).filter(|&variable| fixed(variable)).map(RowOrigin::Fixed));
        let equality_count = origins.len();
        origins.extend((0..self.inequalities.rhs.len()).map(RowOrigin::Inequality));
        let free = |variable: &usize| !fixed(*variable);
        origins.extend((0..variable_count).filter(free).filter(|&v| self.lower[v].is_finite()).map(RowOrigin::Lower));
        origins.extend((0..variable_count).filter(free).filter(|&v| self.upper[v].is_finite()).map(RowOrigin::Upper));

        let mut matrix = DMatrix::zeros(origins.len(), variable_count);
        let mut rhs = DVector::zeros(origins.len());
        for (row, &origin) in origins.iter().enumerate() {
            match origin {
                RowOrigin::Equality(index) => {
                    matrix.set_row(row, &self.equalities.matrix.row(index));
                    rhs[row] = self.equalities.rhs[index];
                }
                RowOrigin::Inequality(index) => {
                    matrix.set_row(row, &self.inequalities.matrix.row(index));
                    rhs[row] = self.inequalities.rhs[index];
                }
                RowOrigin::Fixed(variable) | RowOrigin::Upper(variable) => {
                    matrix[(row, variable)] = 1.0;
                    rhs[row] = self.upper[variable];
                }
                RowOrigin::Lower(variable) => {
                    matrix[(row, variable)] = -1.0;
                    rhs[row] = -self.lower[variable];
                }
            }
        }
        Stack { rows: Rows { matrix, rhs }, origins, equality_count }
    }

    /// The interior-point solve; the objective is scaled to unit size so that its tolerances are relative.
    fn solve_interior(&self, stack: &Stack) -> Result<(PrimalDual, u32), QpError> {
        let variable_count = self.gradient.len();
        let linear_count = stack.origins.len();
        let objective_scale = self.hessian.amax().max(self.gradient.amax()).max(f64::MIN_POSITIVE);
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

    /// The exact solution on the active set of `interior`; `None` where that set turns out not to be the optimal one.
    fn polish(&self, stack: &Stack, interior: &PrimalDual) -> Option<PrimalDual> {
        let rows: Vec<usize> = (0..stack.origins.len()).filter(|&row| interior.active[row]).collect();
        match &self.trust {
            Some(trust) if interior.on_trust_boundary => {
                self.solve_on_sphere(stack, &rows, trust, interior.trust_multiplier).or_else(|| self.solve_active(stack, &rows, 0.0))
            }
            _ => self.solve_active(stack, &rows, 0.0),
        }
        .filter(|answer| self.is_optimal(stack, answer))
    }

    /// Solves the equality-constrained problem H + μ S², g on the active `rows` by one dense factorisation.
    fn solve_active(&self, stack: &Stack, rows: &[usize], trust_multiplier: f64) -> Option<PrimalDual> {
        let variable_count = self.gradient.len();
        let size = variable_count + rows.len();
        let mut kkt = DMatrix::zeros(size, size);
        let mut rhs = DVector::zeros(size);
        kkt.view_mut((0, 0), (variable_count, variable_count)).copy_from(&self.hessian);
        rhs.rows_mut(0, variable_count).copy_from(&-&self.gradient);
        if let Some(trust) = &self.trust {
            for variable in 0..variable_count {
                kkt[(variable, variable)] += trust_multiplier * trust.scale[variable].powi(2);
            }
        }
        for (index, &row) in rows.iter().enumerate() {
            for variable in 0..variable_count {
                let entry = stack.rows.matrix[(row, variable)];
                kkt[(variable_count + index, variable)] = entry;
                kkt[(variable, variable_count + index)] = entry;
            }
            rhs[variable_count + index] = stack.rows.rhs[row];
        }
        let answer = kkt.clone().lu().solve(&rhs)?;
        let residual = (&kkt * &answer - &rhs).amax();
        let x = answer.rows(0, variable_count).into_owned();
        let mut multipliers = DVector::zeros(stack.origins.len());
        let mut active = vec![false; stack.origins.len()];
        for (index, &row) in rows.iter().enumerate() {
            multipliers[row] = answer[variable_count + index];
            active[row] = true;
        }
        let accurate = residual <= POLISH_TOLERANCE * self.size_at(&x).max(rhs.amax());
        accurate.then_some(PrimalDual { x, multipliers, active, trust_multiplier, on_trust_boundary: trust_multiplier > 0.0 })
    }

    /// Secant iteration for the multiplier μ with ‖S x(μ)‖ = Δ, on 1/‖S x‖, which is nearly linear in μ ([Nocedal2006] §4.3).
    fn solve_on_sphere(&self, stack: &Stack, rows: &[usize], trust: &TrustRegion, start: f64) -> Option<PrimalDual> {
        let excess = |answer: &PrimalDual| trust.radius / trust.scale.component_mul(&answer.x).norm() - 1.0;
        let mut previous = self.solve_active(stack, rows, start)?;
        let mut current = self.solve_active(stack, rows, start * 1.01 + f64::MIN_POSITIVE)?;
        for _ in 0..30 {
            let (last, now) = (excess(&previous), excess(&current));
            if now.abs() < 1e-12 {
                return (current.trust_multiplier > 0.0).then_some(current);
            }
            let slope = (now - last) / (current.trust_multiplier - previous.trust_multiplier);
            let next = current.trust_multiplier - now / slope;
            if !next.is_finite() || next < 0.0 {
                return None;
            }
            let trial = self.solve_active(stack, rows, next)?;
            previous = std::mem::replace(&mut current, trial);
        }
        None
    }

    /// Feasible, with multipliers of the right sign.
    fn is_optimal(&self, stack: &Stack, answer: &PrimalDual) -> bool {
        let size = self.size_at(&answer.x);
        let trusted =
            self.trust.as_ref().is_none_or(|trust| trust.scale.component_mul(&answer.x).norm() <= trust.radius * (1.0 + POLISH_TOLERANCE));
        trusted
            && (0..stack.origins.len()).all(|row| {
                let (mut value, mut reach) = (-stack.rows.rhs[row], 1.0 + stack.rows.rhs[row].abs());
                for (a, x) in stack.rows.matrix.row(row).iter().zip(&answer.x) {
                    value += a * x;
                    reach += (a * x).abs();
                }
                let pushes = row < stack.equality_count || answer.multipliers[row] >= -POLISH_TOLERANCE * size;
                value <= POLISH_TOLERANCE * reach && pushes
            })
    }

    /// Size of the terms of the stationarity condition at `x`.
    fn size_at(&self, x: &DVector<f64>) -> f64 {
        self.gradient.amax().max(self.hessian.amax() * x.amax()).max(f64::MIN_POSITIVE)
    }

    fn solution(&self, stack: &Stack, answer: PrimalDual, iterations: u32) -> QpSolution {
        let variable_count = self.gradient.len();
        let mut solution = QpSolution {
            objective: self.objective(&answer.x),
            x: answer.x,
            equality_multipliers: DVector::zeros(self.equalities.rhs.len()),
            inequality_multipliers: DVector::zeros(self.inequalities.rhs.len()),
            lower_multipliers: DVector::zeros(variable_count),
            upper_multipliers: DVector::zeros(variable_count),
            trust_multiplier: answer.trust_multiplier,
            active_inequalities: Vec::new(),
            active_lower: Vec::new(),
            active_upper: Vec::new(),
            on_trust_boundary: answer.on_trust_boundary,
            iterations,
        };
        for (row, &origin) in stack.origins.iter().enumerate() {
            let multiplier = answer.multipliers[row];
            match origin {
                RowOrigin::Equality(index) => solution.equality_multipliers[index] = multiplier,
                RowOrigin::Fixed(variable) => {
                    solution.lower_multipliers[variable] = (-multiplier).max(0.0);
                    solution.upper_multipliers[variable] = multiplier.max(0.0);
                    if multiplier < 0.0 { &mut solution.active_lower } else { &mut solution.active_upper }.push(variable);
                }
                RowOrigin::Inequality(index) => {
                    solution.inequality_multipliers[index] = multiplier.max(0.0);
                    solution.active_inequalities.extend(answer.active[row].then_some(index));
                }
                RowOrigin::Lower(variable) => {
                    solution.lower_multipliers[variable] = multiplier.max(0.0);
                    solution.active_lower.extend(answer.active[row].then_some(variable));
                }
                RowOrigin::Upper(variable) => {
                    solution.upper_multipliers[variable] = multiplier.max(0.0);
                    solution.active_upper.extend(answer.active[row].then_some(variable));
                }
            }
        }
        solution.active_lower.sort_unstable();
        solution.active_upper.sort_unstable();
        for variable in 0..variable_count {
            // NaN-free by construction: bounds that cross were refused.
            solution.x[variable] = solution.x[variable].clamp(self.lower[variable], self.upper[variable]);
        }
        solution
    }
}

fn check_shape(what: &'static str, found: usize, expected: usize) -> Result<(), QpError> {
    if found == expected { Ok(()) } else { Err(QpError::Shape { what, found, expected }) }
}

fn check_finite(what: &'static str, entries: &[f64]) -> Result<(), QpError> {
    if entries.iter().all(|entry| entry.is_finite()) { Ok(()) } else { Err(QpError::NonFinite { what }) }
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

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random_matrix(rng: &mut ChaCha8Rng, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0))
    }

    fn random_vector(rng: &mut ChaCha8Rng, size: usize) -> DVector<f64> {
        DVector::from_fn(size, |_, _| rng.random_range(-1.0..1.0))
    }

    fn strictly_convex(rng: &mut ChaCha8Rng, size: usize) -> (DMatrix<f64>, DVector<f64>) {
        let factor = random_matrix(rng, size, size);
        (factor.transpose() * &factor + DMatrix::identity(size, size) * 0.05, random_vector(rng, size) * 3.0)
    }

    /// Stationarity, feasibility and complementarity characterise the one minimiser of a strictly convex problem.
    #[test]
    fn kkt_conditions_hold_on_random_strictly_convex_problems() {
        for seed in 0..40 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (size, rows) = (rng.random_range(2..9), rng.random_range(1..7));
            let (hessian, gradient) = strictly_convex(&mut rng, size);
            let a = random_matrix(&mut rng, 1, size);
            let g = random_matrix(&mut rng, rows, size);
            // h > 0 and b = 0 keep the origin feasible.
            let h = random_vector(&mut rng, rows).abs() * 0.3;
            let bound = random_vector(&mut rng, size).abs().add_scalar(0.05);
            let solution = QuadraticProgram::new(hessian.clone(), gradient.clone())
                .and_then(|qp| qp.with_equalities(a.clone(), DVector::zeros(1)))
                .and_then(|qp| qp.with_inequalities(g.clone(), h.clone()))
                .and_then(|qp| qp.with_bounds(-&bound, bound.clone()))
                .and_then(|qp| qp.solve())
                .unwrap();
            let x = &solution.x;
            let stationarity = &hessian * x
                + &gradient
                + a.transpose() * &solution.equality_multipliers
                + g.transpose() * &solution.inequality_multipliers
                - &solution.lower_multipliers
                + &solution.upper_multipliers;
            assert!(stationarity.amax() < 1e-8, "seed {seed}: {:e}", stationarity.amax());
            assert!((a * x).amax() < 1e-9);
            let slack = &h - g * x;
            assert!(slack.min() > -1e-9, "seed {seed}");
            assert!(solution.inequality_multipliers.component_mul(&slack).amax() < 1e-8, "seed {seed}");
            assert!(solution.lower_multipliers.component_mul(&(x + &bound)).amax() < 1e-8, "seed {seed}");
            assert!(solution.upper_multipliers.component_mul(&(&bound - x)).amax() < 1e-8, "seed {seed}");
        }
    }

    #[test]
    fn projection_on_a_box_clamps_every_coordinate() {
        let target = DVector::from_vec(vec![3.0, -0.25, -7.0, 0.5]);
        let (lower, upper) = (DVector::from_vec(vec![-1.0, -1.0, -2.0, 0.5]), DVector::from_vec(vec![1.0, 1.0, f64::INFINITY, 0.5]));
        let solution = QuadraticProgram::new(DMatrix::identity(4, 4), -&target)
            .and_then(|qp| qp.with_bounds(lower, upper))
            .and_then(|qp| qp.solve())
            .unwrap();
        assert!((solution.x - DVector::from_vec(vec![1.0, -0.25, -2.0, 0.5])).amax() < 1e-14);
        assert_eq!(solution.active_lower, [2]);
        assert_eq!(solution.active_upper, [0, 3]);
        assert!((solution.upper_multipliers[0] - 2.0).abs() < 1e-12);
        assert!((solution.lower_multipliers[2] - 5.0).abs() < 1e-12);
    }

    #[test]
    fn without_constraints_it_is_a_linear_solve() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (hessian, gradient) = strictly_convex(&mut rng, 6);
        let expected = hessian.clone().cholesky().unwrap().solve(&-&gradient);
        let solution = QuadraticProgram::new(hessian, gradient).and_then(|qp| qp.solve()).unwrap();
        assert!((solution.x - &expected).amax() < 1e-10 * expected.amax());
    }

    /// ‖x‖ ≤ Δ with H = I: the projection of −g on the ball, with multiplier ‖g‖/Δ − 1.
    #[test]
    fn trust_region_projects_on_the_ball_with_its_multiplier() {
        let gradient = DVector::from_vec(vec![-3.0, 4.0]);
        let solution = QuadraticProgram::new(DMatrix::identity(2, 2), gradient)
            .and_then(|qp| qp.with_trust_region(DVector::from_element(2, 1.0), 2.0))
            .and_then(|qp| qp.solve())
            .unwrap();
        assert!((solution.x - DVector::from_vec(vec![1.2, -1.6])).amax() < 1e-11);
        assert!((solution.trust_multiplier - 1.5).abs() < 1e-10, "{}", solution.trust_multiplier);
        assert!(solution.on_trust_boundary);
    }

    /// An ellipsoid is a ball in scaled coordinates, and a large one changes nothing.
    #[test]
    fn trust_region_scales_and_lets_go() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (hessian, gradient) = strictly_convex(&mut rng, 4);
        let scale = DVector::from_vec(vec![0.5, 2.0, 1.0, 10.0]);
        let held = QuadraticProgram::new(hessian.clone(), gradient.clone())
            .and_then(|qp| qp.with_trust_region(scale.clone(), 0.3))
            .and_then(|qp| qp.solve())
            .unwrap();
        let squared = DMatrix::from_diagonal(&scale.component_mul(&scale));
        let stationarity = (&hessian + squared * held.trust_multiplier) * &held.x + &gradient;
        assert!(stationarity.amax() < 1e-9, "{:e}", stationarity.amax());
        assert!((scale.component_mul(&held.x).norm() - 0.3).abs() < 1e-11);
        let free = QuadraticProgram::new(hessian.clone(), gradient.clone())
            .and_then(|qp| qp.with_trust_region(scale, 1e4))
            .and_then(|qp| qp.solve())
            .unwrap();
        assert!((&hessian * &free.x + &gradient).amax() < 1e-9);
        assert!(!free.on_trust_boundary);
    }

    /// A Hessian of 1e8 (residuals over small standard deviations) is solved as well as one of 1.
    #[test]
    fn the_answer_does_not_depend_on_the_scale_of_the_objective() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let (hessian, gradient) = strictly_convex(&mut rng, 5);
        let bound = DVector::from_element(5, 0.4);
        let solve = |factor: f64| {
            QuadraticProgram::new(&hessian * factor, &gradient * factor)
                .and_then(|qp| qp.with_bounds(-&bound, bound.clone()))
                .and_then(|qp| qp.solve())
                .unwrap()
        };
        let reference = solve(1.0);
        for factor in [1e8, 1e-8] {
            let other = solve(factor);
            assert!((other.x - &reference.x).amax() < 1e-9);
            assert_eq!((&other.active_lower, &other.active_upper), (&reference.active_lower, &reference.active_upper));
        }
    }

    #[test]
    fn impossible_and_bad_problems_are_refused_by_name() {
        let plain = || QuadraticProgram::new(DMatrix::identity(2, 2), DVector::zeros(2)).unwrap();
        let crossed = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, -1.0, 0.0]);
        let infeasible = plain().with_inequalities(crossed, DVector::from_vec(vec![-1.0, -1.0])).and_then(|qp| qp.solve());
        assert_eq!(infeasible.unwrap_err(), QpError::Infeasible);
        let flat = QuadraticProgram::new(DMatrix::zeros(1, 1), DVector::from_element(1, 1.0))
            .and_then(|qp| qp.with_bounds(DVector::from_element(1, f64::NEG_INFINITY), DVector::from_element(1, 1.0)));
        assert_eq!(flat.and_then(|qp| qp.solve()).unwrap_err(), QpError::Unbounded);
        let indefinite = QuadraticProgram::new(DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]), DVector::zeros(2));
        assert!(matches!(indefinite, Err(QpError::Indefinite { eigenvalue }) if (eigenvalue + 1.0).abs() < 1e-12));
        let poisoned = QuadraticProgram::new(DMatrix::identity(2, 2), DVector::from_vec(vec![0.0, f64::NAN]));
        assert!(matches!(poisoned, Err(QpError::NonFinite { what: "the gradient" })));
        let crossing = plain().with_bounds(DVector::from_element(2, 1.0), DVector::from_element(2, 0.0));
        assert!(matches!(crossing, Err(QpError::BoundsCross { variable: 0, .. })));
        assert!(matches!(plain().with_trust_region(DVector::from_element(2, 1.0), 0.0), Err(QpError::TrustRegion { .. })));
        let shape = plain().with_equalities(DMatrix::zeros(1, 3), DVector::zeros(1));
        assert!(matches!(shape, Err(QpError::Shape { found: 3, expected: 2, .. })));
    }
}
