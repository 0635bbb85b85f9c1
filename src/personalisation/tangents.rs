//! Tangents of any simulation by finite differences, one simulation (or two) a parameter, in parallel over the parameters.

use std::sync::{Mutex, PoisonError};

use nalgebra::{DVector, Vector3};
use rayon::prelude::*;

use super::{TangentModel, WithTangents};

/// A trajectory that can be subtracted and divided.
pub trait LinearTrajectory: Clone + Send + Sync {
    /// (self − base)/step, entry by entry.
    #[must_use]
    fn difference_quotient(&self, base: &Self, step: f64) -> Self;
}

impl LinearTrajectory for DVector<f64> {
    fn difference_quotient(&self, base: &Self, step: f64) -> Self {
        (self - base) / step
    }
}

impl LinearTrajectory for Vec<f64> {
    fn difference_quotient(&self, base: &Self, step: f64) -> Self {
        self.iter().zip(base).map(|(there, here)| (there - here) / step).collect()
    }
}

impl LinearTrajectory for Vec<Vector3<f64>> {
    fn difference_quotient(&self, base: &Self, step: f64) -> Self {
        self.iter().zip(base).map(|(there, here)| (there - here) / step).collect()
    }
}

/// Which difference quotient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DifferenceScheme {
    /// (f(θ + h) − f(θ))/h: one simulation a parameter, error O(h).
    Forward,
    /// (f(θ + h) − f(θ − h))/2h: two simulations a parameter, error O(h²).
    Central,
}

/// A simulation with finite-difference tangents.
///
/// At a bound the differences are one-sided and point inward; where a shifted simulation fails the other side is tried. The result does
/// not depend on the number of threads. The last trajectory is remembered, so that tangents at a point just simulated do not repeat it.
pub struct FiniteDifferenceModel<F, T> {
    simulate: F,
    scheme: DifferenceScheme,
    steps: DVector<f64>,
    lower: DVector<f64>,
    upper: DVector<f64>,
    last: Mutex<Option<(DVector<f64>, T)>>,
}

impl<F, T, E> FiniteDifferenceModel<F, T>
where
    F: Fn(&DVector<f64>) -> Result<T, E> + Sync,
    T: LinearTrajectory,
    E: std::error::Error + Send + Sync + 'static,
{
    /// Differences of `simulate` with one step a coordinate, within `lower` and `upper`; shapes p. A good step is the square root (forward)
    /// or cube root (central) of the simulation's relative accuracy in units of the coordinate: 1e-3 in a logarithm is 0.1 %.
    pub fn new(simulate: F, scheme: DifferenceScheme, steps: DVector<f64>, lower: DVector<f64>, upper: DVector<f64>) -> Self {
        Self { simulate, scheme, steps, lower, upper, last: Mutex::new(None) }
    }

    fn simulate_once(&self, parameters: &DVector<f64>) -> Result<T, E> {
        if let Some((at, trajectory)) = self.last.lock().unwrap_or_else(PoisonError::into_inner).as_ref()
            && at == parameters
        {
            return Ok(trajectory.clone());
        }
        let trajectory = (self.simulate)(parameters)?;
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some((parameters.clone(), trajectory.clone()));
        Ok(trajectory)
    }

    /// The trajectory at θ + `shift` e_i.
    fn shifted(&self, parameters: &DVector<f64>, index: usize, shift: f64) -> Result<T, E> {
        let mut there = parameters.clone();
        there[index] += shift;
        (self.simulate)(&there)
    }

    fn tangent(&self, parameters: &DVector<f64>, base: &T, index: usize) -> Result<T, E> {
        let step = self.steps[index];
        let (room_above, room_below) = (self.upper[index] - parameters[index], parameters[index] - self.lower[index]);
        let one_sided = |shift: f64| {
            // The difference of the rounded coordinates, not the step asked for, divides.
            let taken = (parameters[index] + shift) - parameters[index];
            self.shifted(parameters, index, shift).map(|there| there.difference_quotient(base, taken))
        };
        if self.scheme == DifferenceScheme::Central
            && room_above >= step
            && room_below >= step
            && let (Ok(above), Ok(below)) = (self.shifted(parameters, index, step), self.shifted(parameters, index, -step))
        {
            let taken = (parameters[index] + step) - (parameters[index] - step);
            return Ok(above.difference_quotient(&below, taken));
        }
        let first = if room_above >= step || room_above >= room_below { step.min(room_above) } else { -step.min(room_below) };
        one_sided(first).or_else(|error| {
            let room = if first > 0.0 { room_below } else { room_above };
            if room > 0.0 { one_sided(-first.signum() * step.min(room)) } else { Err(error) }
        })
    }
}

impl<F, T, E> TangentModel for FiniteDifferenceModel<F, T>
where
    F: Fn(&DVector<f64>) -> Result<T, E> + Sync,
    T: LinearTrajectory,
    E: std::error::Error + Send + Sync + 'static,
{
    type Trajectory = T;
    type Error = E;

    fn simulate(&self, parameters: &DVector<f64>) -> Result<T, E> {
        self.simulate_once(parameters)
    }

    fn simulate_with_tangents(&self, parameters: &DVector<f64>) -> WithTangents<T, E> {
        let base = self.simulate_once(parameters)?;
        let tangents: Result<Vec<T>, E> =
            (0..parameters.len()).into_par_iter().map(|index| self.tangent(parameters, &base, index)).collect();
        Ok((base, tangents?))
    }

    fn tangent_cost(&self, dimension: usize) -> f64 {
        match self.scheme {
            DifferenceScheme::Forward => dimension as f64,
            DifferenceScheme::Central => 2.0 * dimension as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("left the domain")]
    struct OutOfDomain;

    /// f(θ) = (e^{θ₀} sin θ₁, θ₁³), fails for θ₁ > 1.
    fn simulate(theta: &DVector<f64>) -> Result<DVector<f64>, OutOfDomain> {
        if theta[1] > 1.0 {
            return Err(OutOfDomain);
        }
        Ok(DVector::from_vec(vec![theta[0].exp() * theta[1].sin(), theta[1].powi(3)]))
    }

    fn model(scheme: DifferenceScheme, step: f64) -> impl TangentModel<Trajectory = DVector<f64>, Error = OutOfDomain> {
        let wide = DVector::from_element(2, 10.0);
        FiniteDifferenceModel::new(simulate, scheme, DVector::from_element(2, step), -&wide, wide)
    }

    fn error_at(theta: &DVector<f64>, scheme: DifferenceScheme, step: f64) -> f64 {
        let (_, tangents) = model(scheme, step).simulate_with_tangents(theta).unwrap();
        let exact = [
            DVector::from_vec(vec![theta[0].exp() * theta[1].sin(), 0.0]),
            DVector::from_vec(vec![theta[0].exp() * theta[1].cos(), 3.0 * theta[1].powi(2)]),
        ];
        tangents.iter().zip(exact).map(|(tangent, exact)| (tangent - exact).amax()).fold(0.0, f64::max)
    }

    #[test]
    fn forward_differences_are_first_order_and_central_ones_second() {
        let theta = DVector::from_vec(vec![0.3, 0.6]);
        for (scheme, order) in [(DifferenceScheme::Forward, 1.0), (DifferenceScheme::Central, 2.0)] {
            let measured = (error_at(&theta, scheme, 1e-2) / error_at(&theta, scheme, 5e-3)).log2();
            assert!((measured - order).abs() < 0.05, "{scheme:?}: order {measured}");
        }
    }

    #[test]
    fn differences_turn_around_where_the_simulation_fails_or_a_bound_stands() {
        let at_edge = DVector::from_vec(vec![0.3, 1.0]);
        assert!(error_at(&at_edge, DifferenceScheme::Forward, 1e-5) < 1e-4);
        assert!(error_at(&at_edge, DifferenceScheme::Central, 1e-5) < 1e-4);
        let bounded = FiniteDifferenceModel::new(
            |theta: &DVector<f64>| if theta[0] > 0.5 { Err(OutOfDomain) } else { Ok(theta * 2.0) },
            DifferenceScheme::Central,
            DVector::from_element(1, 1e-3),
            DVector::from_element(1, 0.0),
            DVector::from_element(1, 0.5),
        );
        let (_, tangents) = bounded.simulate_with_tangents(&DVector::from_element(1, 0.5)).unwrap();
        assert!((tangents[0][0] - 2.0).abs() < 1e-9);
    }

    #[test]
    fn results_do_not_depend_on_the_number_of_threads() {
        let theta = DVector::from_vec(vec![0.3, 0.6]);
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| model(DifferenceScheme::Central, 1e-4).simulate_with_tangents(&theta).unwrap())
        };
        assert_eq!(with(1), with(4));
    }

    #[test]
    fn a_point_just_simulated_is_not_simulated_again() {
        let count = AtomicUsize::new(0);
        let counted = |theta: &DVector<f64>| {
            count.fetch_add(1, Ordering::Relaxed);
            simulate(theta)
        };
        let wide = DVector::from_element(2, 10.0);
        let model = FiniteDifferenceModel::new(counted, DifferenceScheme::Forward, DVector::from_element(2, 1e-4), -&wide, wide.clone());
        let theta = DVector::from_vec(vec![0.3, 0.6]);
        model.simulate(&theta).unwrap();
        model.simulate_with_tangents(&theta).unwrap();
        assert_eq!(count.load(Ordering::Relaxed), 3, "one base and two shifted simulations");
    }
}
