//! Time schemes of one template: backward Euler (\[Billet2009\]) and generalised-α by its spectral radius.

use nalgebra::Vector3;

use super::{MechanicsError, MotionState};

/// How time is discretised.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum TimeScheme {
    /// First order; damps a mode of frequency ω by 1/√(1 + (ωh)²) a step.
    #[default]
    BackwardEuler,
    /// Second order, unconditionally stable \[ChungHulbert1993\], in the form of \[ArnoldBruels2007\] that meets the balance of
    /// forces at the step's end, so that loads enter it as they enter backward Euler. Its accelerations answer to loads that
    /// jump; the smaller ρ∞, the sooner that fades.
    GeneralisedAlpha {
        /// ρ∞ in [0, 1]: what a step leaves of the fastest modes. 1 is the trapezoidal rule and conserves energy.
        spectral_radius: f64,
    },
}

/// The template both schemes are cases of, from a state (y, v, a, ÿ) with step h:
///
/// $$a^+ = \frac{y^+ - y^*}{\beta h^2}, \quad v^+ = v^* + \gamma h a^+, \quad \ddot y^+ = r a^+ + s a - w \ddot y,$$
/// $$y^* = y + h v + b h^2 a, \quad v^* = v + g h a, \quad M \ddot y^+ + C v^+ + K(y^+ - x) = F^+ .$$
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Coefficients {
    step_s: f64,
    beta: f64,
    gamma: f64,
    position_history: f64,
    velocity_history: f64,
    inertia: f64,
    inertia_algorithmic: f64,
    inertia_history: f64,
}

impl TimeScheme {
    pub(super) fn coefficients(self, step_s: f64) -> Result<Coefficients, MechanicsError> {
        if !(step_s.is_finite() && step_s > 0.0) {
            return Err(MechanicsError::Property { property: "step_s", value: step_s, requirement: "finite and positive" });
        }
        match self {
            Self::BackwardEuler => Ok(Coefficients {
                step_s,
                beta: 1.0,
                gamma: 1.0,
                position_history: 0.0,
                velocity_history: 0.0,
                inertia: 1.0,
                inertia_algorithmic: 0.0,
                inertia_history: 0.0,
            }),
            Self::GeneralisedAlpha { spectral_radius } => {
                if !(0.0..=1.0).contains(&spectral_radius) {
                    let property = "spectral_radius";
                    return Err(MechanicsError::Property { property, value: spectral_radius, requirement: "between 0 and 1" });
                }
                let alpha_mass = (2.0 * spectral_radius - 1.0) / (spectral_radius + 1.0);
                let alpha_force = spectral_radius / (spectral_radius + 1.0);
                let gamma = 0.5 + alpha_force - alpha_mass;
                let beta = (gamma + 0.5).powi(2) / 4.0;
                Ok(Coefficients {
                    step_s,
                    beta,
                    gamma,
                    position_history: 0.5 - beta,
                    velocity_history: 1.0 - gamma,
                    inertia: (1.0 - alpha_mass) / (1.0 - alpha_force),
                    inertia_algorithmic: alpha_mass / (1.0 - alpha_force),
                    inertia_history: alpha_force / (1.0 - alpha_force),
                })
            }
        }
    }
}

impl Coefficients {
    /// ∂ÿ⁺/∂y⁺, 1/s²: the factor of M in K̃.
    pub(super) fn mass_factor(&self) -> f64 {
        self.inertia / (self.beta * self.step_s * self.step_s)
    }

    /// ∂v⁺/∂y⁺, 1/s: the factor of C in K̃.
    pub(super) fn damping_factor(&self) -> f64 {
        self.gamma / (self.beta * self.step_s)
    }

    /// −ÿ⁺ at y⁺ = 0, mm/s²: what M multiplies on the right.
    #[inline]
    pub(super) fn inertia_on_the_right(&self, state: &MotionState, vertex: usize) -> Vector3<f64> {
        self.predicted_position(state, vertex) * self.mass_factor()
            - state.algorithmic_acceleration_mm_per_s2[vertex] * self.inertia_algorithmic
            + state.acceleration_mm_per_s2[vertex] * self.inertia_history
    }

    /// −v⁺ at y⁺ = 0, mm/s: what C multiplies on the right.
    #[inline]
    pub(super) fn damping_on_the_right(&self, state: &MotionState, vertex: usize) -> Vector3<f64> {
        self.predicted_position(state, vertex) * self.damping_factor() - self.predicted_velocity(state, vertex)
    }

    /// Where a vertex may be at the step's end, and the velocity that the scheme then gives it: what damping that is not linear in
    /// the position is linearised about. Extrapolated in the second-order scheme, to keep its order; for backward Euler where the
    /// vertex is, at rest.
    pub(super) fn extrapolated(&self, state: &MotionState, vertex: usize) -> (Vector3<f64>, Vector3<f64>) {
        if self.is_first_order() {
            return (state.position_mm[vertex], Vector3::zeros());
        }
        let (y, v, a) = (state.position_mm[vertex], state.velocity_mm_per_s[vertex], state.acceleration_mm_per_s2[vertex]);
        let position_mm = y + v * self.step_s + a * (self.step_s * self.step_s / 2.0);
        (position_mm, position_mm * self.damping_factor() - self.damping_on_the_right(state, vertex))
    }

    fn is_first_order(&self) -> bool {
        self.beta == 1.0
    }

    /// The state whose positions are `position_mm`.
    pub(super) fn advance(&self, state: &MotionState, position_mm: Vec<Vector3<f64>>) -> MotionState {
        let count = position_mm.len();
        let mut next = MotionState {
            position_mm,
            velocity_mm_per_s: Vec::with_capacity(count),
            acceleration_mm_per_s2: Vec::with_capacity(count),
            algorithmic_acceleration_mm_per_s2: Vec::with_capacity(count),
        };
        self.complete(state, &mut next);
        next
    }

    /// Writes the velocities and accelerations of the state whose positions `next` has.
    pub(super) fn complete(&self, state: &MotionState, next: &mut MotionState) {
        let count = next.position_mm.len();
        let MotionState {
            position_mm,
            velocity_mm_per_s: velocity,
            acceleration_mm_per_s2: acceleration,
            algorithmic_acceleration_mm_per_s2: algorithmic,
        } = next;
        for field in [&mut *velocity, &mut *acceleration, &mut *algorithmic] {
            field.resize(count, Vector3::zeros());
        }
        let fields = position_mm.iter().zip(velocity).zip(acceleration).zip(algorithmic);
        for (vertex, (((position_mm, velocity), acceleration), algorithmic)) in fields.enumerate() {
            let moved = position_mm - self.predicted_position(state, vertex);
            *algorithmic = moved / (self.beta * self.step_s * self.step_s);
            *velocity = self.predicted_velocity(state, vertex) + *algorithmic * (self.gamma * self.step_s);
            *acceleration = *algorithmic * self.inertia + state.algorithmic_acceleration_mm_per_s2[vertex] * self.inertia_algorithmic
                - state.acceleration_mm_per_s2[vertex] * self.inertia_history;
        }
    }

    #[inline]
    fn predicted_position(&self, state: &MotionState, vertex: usize) -> Vector3<f64> {
        state.position_mm[vertex]
            + state.velocity_mm_per_s[vertex] * self.step_s
            + state.algorithmic_acceleration_mm_per_s2[vertex] * (self.position_history * self.step_s * self.step_s)
    }

    #[inline]
    fn predicted_velocity(&self, state: &MotionState, vertex: usize) -> Vector3<f64> {
        state.velocity_mm_per_s[vertex] + state.algorithmic_acceleration_mm_per_s2[vertex] * (self.velocity_history * self.step_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One free oscillator of frequency ω and damping 2ζω, unit mass, driven through the template.
    fn oscillate(scheme: TimeScheme, omega: f64, zeta: f64, duration_s: f64, step_count: usize) -> MotionState {
        let coefficients = scheme.coefficients(duration_s / step_count as f64).unwrap();
        let mut state = MotionState::at_rest(vec![Vector3::x()]);
        state.acceleration_mm_per_s2[0] = -Vector3::x() * omega * omega;
        state.algorithmic_acceleration_mm_per_s2[0] = state.acceleration_mm_per_s2[0];
        let damping = 2.0 * zeta * omega;
        for _ in 0..step_count {
            let stiffness = coefficients.mass_factor() + damping * coefficients.damping_factor() + omega * omega;
            let force = coefficients.inertia_on_the_right(&state, 0) + coefficients.damping_on_the_right(&state, 0) * damping;
            state = coefficients.advance(&state, vec![force / stiffness]);
        }
        state
    }

    #[test]
    fn generalised_alpha_is_of_second_order_and_backward_euler_of_first() {
        let (omega, zeta, duration_s) = (7.0, 0.1, 1.3);
        let damped = omega * (1.0f64 - zeta * zeta).sqrt();
        let exact =
            (-zeta * omega * duration_s).exp() * ((damped * duration_s).cos() + zeta * omega / damped * (damped * duration_s).sin());
        let order = |scheme| {
            let error = |count| (oscillate(scheme, omega, zeta, duration_s, count).position_mm[0].x - exact).abs();
            (error(3000) / error(6000)).log2()
        };
        assert!((order(TimeScheme::BackwardEuler) - 1.0).abs() < 0.05);
        for spectral_radius in [0.0, 0.5, 0.8, 1.0] {
            let measured = order(TimeScheme::GeneralisedAlpha { spectral_radius });
            assert!((measured - 2.0).abs() < 0.05, "ρ∞ {spectral_radius}: order {measured}");
        }
    }

    #[test]
    fn the_trapezoidal_rule_conserves_the_energy_of_a_mode() {
        let (omega, duration_s) = (50.0, 3.0);
        let state = oscillate(TimeScheme::GeneralisedAlpha { spectral_radius: 1.0 }, omega, 0.0, duration_s, 300);
        let norm = (omega * state.position_mm[0].x).hypot(state.velocity_mm_per_s[0].x);
        assert!((norm / omega - 1.0).abs() < 1e-10, "{norm}");
    }

    /// Far above the step's reach a mode shrinks by ρ∞ a step (with a factor that is linear in the step, its double root).
    #[test]
    fn the_fastest_modes_shrink_by_the_spectral_radius() {
        let spectral_radius = 0.6;
        let norm = |count: usize| {
            let state = oscillate(TimeScheme::GeneralisedAlpha { spectral_radius }, 1e7, 0.0, 0.01 * count as f64, count);
            state.position_mm[0].norm()
        };
        let factor = (norm(120) / norm(60)).powf(1.0 / 60.0);
        assert!((factor - spectral_radius).abs() < 0.015, "{factor}");
    }

    #[test]
    fn a_spectral_radius_outside_its_range_is_refused() {
        for spectral_radius in [-0.1, 1.1, f64::NAN] {
            assert!(TimeScheme::GeneralisedAlpha { spectral_radius }.coefficients(0.01).is_err());
        }
    }
}
