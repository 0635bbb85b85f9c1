//! The exact solve on the active set that the interior-point method found: one dense factorisation, and a secant for the trust region.

use nalgebra::{DMatrix, DVector};

use super::{PrimalDual, QuadraticProgram, Stack, TrustRegion};

/// Slack relative to the size of the problem under which a polished solution counts as feasible.
const POLISH_TOLERANCE: f64 = 1e-9;
/// Rounds of refinement with the regularised factor.
const REFINEMENTS: usize = 3;
/// Regularisation relative to the largest entry.
const REGULARISATION: f64 = 1e-11;

impl QuadraticProgram {
    /// The exact solution on the active set of `interior`; `None` where that set turns out not to be the optimal one.
    pub(super) fn polish(&self, stack: &Stack, interior: &PrimalDual) -> Option<PrimalDual> {
        let rows: Vec<usize> = (0..stack.origins.len()).filter(|&row| interior.active[row]).collect();
        match &self.trust {
            Some(trust) if interior.on_trust_boundary => {
                self.solve_on_sphere(stack, &rows, trust, interior).or_else(|| self.solve_active(stack, &rows, interior, 0.0))
            }
            _ => self.solve_active(stack, &rows, interior, 0.0),
        }
        .filter(|answer| self.is_optimal(stack, answer))
    }

    /// Solves the equality-constrained problem H + μ S², g on the active `rows` by one dense factorisation and refinement from `near`. The
    /// factor is regularised, so that directions without curvature and dependent rows keep what they have in `near`.
    fn solve_active(&self, stack: &Stack, rows: &[usize], near: &PrimalDual, trust_multiplier: f64) -> Option<PrimalDual> {
        let variable_count = self.gradient.len();
        let size = variable_count + rows.len();
        let mut kkt = DMatrix::zeros(size, size);
        let mut rhs = DVector::zeros(size);
        let scale = self.objective_scale();
        kkt.view_mut((0, 0), (variable_count, variable_count)).copy_from(&(&self.hessian / scale));
        rhs.rows_mut(0, variable_count).copy_from(&(&self.gradient / -scale));
        if let Some(trust) = &self.trust {
            for variable in 0..variable_count {
                kkt[(variable, variable)] += trust_multiplier / scale * trust.scale[variable].powi(2);
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
        let mut answer = near.x.clone().resize_vertically(size, 0.0);
        for (index, &row) in rows.iter().enumerate() {
            answer[variable_count + index] = near.multipliers[row] / scale;
        }
        let factor = regularised(&kkt, variable_count).lu();
        for _ in 0..REFINEMENTS {
            answer += factor.solve(&(&rhs - &kkt * &answer))?;
        }
        let residual = (&kkt * &answer - &rhs).amax();
        let x = answer.rows(0, variable_count).into_owned();
        let mut multipliers = DVector::zeros(stack.origins.len());
        let mut active = vec![false; stack.origins.len()];
        for (index, &row) in rows.iter().enumerate() {
            multipliers[row] = answer[variable_count + index] * scale;
            active[row] = true;
        }
        let accurate = residual <= POLISH_TOLERANCE * (self.size_at(&x) / scale).max(rhs.amax());
        accurate.then_some(PrimalDual { x, multipliers, active, trust_multiplier, on_trust_boundary: trust_multiplier > 0.0 })
    }

    /// Secant iteration for the multiplier μ with ‖S x(μ)‖ = Δ, on 1/‖S x‖, which is nearly linear in μ (\[Nocedal2006\] §4.3).
    fn solve_on_sphere(&self, stack: &Stack, rows: &[usize], trust: &TrustRegion, near: &PrimalDual) -> Option<PrimalDual> {
        let start = near.trust_multiplier;
        let excess = |answer: &PrimalDual| trust.radius / trust.scale.component_mul(&answer.x).norm() - 1.0;
        let mut previous = self.solve_active(stack, rows, near, start)?;
        let mut current = self.solve_active(stack, rows, near, start * 1.01 + f64::MIN_POSITIVE)?;
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
            let trial = self.solve_active(stack, rows, near, next)?;
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
}

/// The KKT matrix with +ε on the variables and −ε on the multipliers, which is always regular.
fn regularised(kkt: &DMatrix<f64>, variable_count: usize) -> DMatrix<f64> {
    let shift = REGULARISATION * kkt.amax().max(f64::MIN_POSITIVE);
    let mut matrix = kkt.clone();
    for index in 0..matrix.nrows() {
        matrix[(index, index)] += if index < variable_count { shift } else { -shift };
    }
    matrix
}
