//! How stiff springs may be whose force is that of the beginning of a step: the stability bound of explicit image forces.
//!
//! Under a force $-g\,e^t$ of the step's beginning an error e along a mode of mass m, damping c and stiffness k goes on as
//!
//! $$\Big(\frac{m}{h^2} + \frac ch + k\Big)\, e^{t+h} = \Big(\frac{2m}{h^2} + \frac ch - g\Big)\, e^t - \frac{m}{h^2}\, e^{t-h},$$
//!
//! whose roots lie inside the unit circle if and only if
//!
//! $$g < \frac{4m}{h^2} + \frac{2c}{h} + k .$$
//!
//! The right side is the step matrix of half the step, $\tilde K(h/2) = \frac{M}{(h/2)^2} + \frac{C}{h/2} + K$. So springs
//! $H = \sum_i g_i\, n_i n_i^\top$ on the vertices are stable up to the factor $1/\lambda_{max}\big(\tilde K(h/2)^{-1} H\big)$: exactly so
//! where H and the tissue share their modes, and on the safe side else, for $H < \tilde K(h/2)$ is what is asked.

use std::sync::Arc;

use nalgebra::Vector3;

use super::{MechanicsError, Myocardium, SolveSettings, StepOperator, StepSolver};

/// A spring on a vertex, mN/mm, along a unit vector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExplicitSpring {
    /// The vertex.
    pub vertex: usize,
    /// Its direction.
    pub direction: Vector3<f64>,
    /// Its stiffness g: twice the gain of an image force.
    pub stiffness_mn_per_mm: f64,
}

/// Change of the bound at which the iteration ends, and rounds after which it does.
const TOLERANCE: f64 = 1e-7;
const ROUND_LIMIT: usize = 2000;

/// The factor on `springs` below which their explicit force is stable with steps of `step_s` by backward Euler in linear kinematics;
/// infinite without springs. By power iteration, which comes to the bound from above.
///
/// # Errors
/// As [`StepOperator::new`] and [`StepSolver::solve_responses`].
pub fn explicit_spring_limit(tissue: &Arc<Myocardium>, step_s: f64, springs: &[ExplicitSpring]) -> Result<f64, MechanicsError> {
    let half = StepOperator::new(Arc::clone(tissue), step_s / 2.0)?;
    let (mut solver, free) = (StepSolver::new(SolveSettings::default()), half.empty_system().stiffness_mn_per_mm);
    // A direction that no mode is likely to be orthogonal to.
    let mut error: Vec<Vector3<f64>> = vec![Vector3::zeros(); tissue.vertex_count()];
    for (number, spring) in springs.iter().enumerate() {
        error[spring.vertex] += spring.direction * (1.0 + 0.5 * (2.3 * number as f64).sin());
    }
    let mut largest = 0.0_f64;
    for _ in 0..ROUND_LIMIT {
        let mut pull = vec![Vector3::zeros(); error.len()];
        for ExplicitSpring { vertex, direction, stiffness_mn_per_mm } in springs {
            pull[*vertex] += direction * (direction.dot(&error[*vertex]) * stiffness_mn_per_mm);
        }
        let work = dot(&error, &pull);
        if work <= 0.0 {
            break;
        }
        let mut response = vec![pull.clone()];
        solver.solve_responses(&half, &free, &mut response)?;
        let Some(next) = response.pop() else { break };
        let ratio = dot(&next, &pull) / work;
        let has_settled = (ratio - largest).abs() <= TOLERANCE * ratio;
        largest = ratio;
        let size = dot(&next, &next).sqrt();
        error = next.into_iter().map(|entry| entry / size).collect();
        if has_settled {
            break;
        }
    }
    Ok(1.0 / largest)
}

fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}
