//! Small dense convex quadratic programs with bounds and a trust region: a conic solve, then an exact solve on its active set.
//!
//! $$ \min_x \tfrac12 x^\top H x + g^\top x \quad\text{s.t.}\quad A x = b,\; G x \le h,\; l \le x \le u,\; \lVert S x\rVert \le \Delta $$
//!
//! The interior-point method of \[Goulart2024\] finds the active set; where the trust region is not active, the equality-constrained
//! problem on that set is solved by one dense factorisation, so that multipliers and steps are exact to rounding (the "polish" of
//! \[Stellato2020\] §4).

mod error;
mod interior;
mod polish;

pub use error::QpError;

use nalgebra::{DMatrix, DVector};

/// Smallest eigenvalue relative to the largest entry under which a Hessian counts as indefinite.
const INDEFINITE: f64 = 1e-9;

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

    /// Largest entry of the objective, by which it is divided before any solve.
    fn objective_scale(&self) -> f64 {
        self.hessian.amax().max(self.gradient.amax()).max(f64::MIN_POSITIVE)
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

#[cfg(test)]
mod tests;
