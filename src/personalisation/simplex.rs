//! The derivative-free search that Gauss–Newton is compared with: argmin's Nelder–Mead in scaled coordinates, bounds as a wall.
//!
//! Simulations until the same minimum of a four-parameter Windkessel fit (the test below), from starts off by a factor of two:
//!
//! | search | simulations |
//! |---|---|
//! | Gauss–Newton, forward differences (4 of every 5 in parallel) | 25 |
//! | the same with Broyden's secant update between true tangents (not kept: all of them one after the other) | 23 |
//! | Nelder–Mead | 261 |

use std::cell::RefCell;

use argmin::core::{CostFunction, Error, Executor};
use argmin::solver::neldermead::NelderMead;
use argmin_math::{ArgminAdd, ArgminMul, ArgminSub};
use nalgebra::DVector;

use super::problem::Evaluation;
use super::{CalibrationProblem, PersonalisationError, TangentModel};

/// Objective of a point that may not be or could not be simulated.
const WALL: f64 = 1e100;
/// Length of the first simplex's edges, in scales.
const FIRST_EDGE: f64 = 0.25;

/// What a derivative-free search found.
#[derive(Debug, Clone, PartialEq)]
pub struct SimplexSearch<T> {
    /// Best coordinates.
    pub coordinates: DVector<f64>,
    /// The objective there.
    pub evaluation: Evaluation<T>,
    /// Simulations done.
    pub evaluation_count: usize,
}

/// A point in scaled coordinates, for argmin-math.
#[derive(Debug, Clone)]
struct Point(DVector<f64>);

impl ArgminAdd<Self, Self> for Point {
    fn add(&self, other: &Self) -> Self {
        Self(&self.0 + &other.0)
    }
}

impl ArgminSub<Self, Self> for Point {
    fn sub(&self, other: &Self) -> Self {
        Self(&self.0 - &other.0)
    }
}

impl ArgminMul<f64, Self> for Point {
    fn mul(&self, factor: &f64) -> Self {
        Self(&self.0 * *factor)
    }
}

/// A point and the objective there.
type Reached<T> = (DVector<f64>, Evaluation<T>);

/// The objective over scaled coordinates, and the best point seen.
struct Walled<'p, 'a, M: TangentModel> {
    problem: &'p CalibrationProblem<'a, M>,
    scales: DVector<f64>,
    best: RefCell<Option<Reached<M::Trajectory>>>,
    count: RefCell<usize>,
    most: usize,
}

impl<M: TangentModel> CostFunction for &Walled<'_, '_, M> {
    type Param = Point;
    type Output = f64;

    fn cost(&self, point: &Point) -> Result<f64, Error> {
        let theta = point.0.component_mul(&self.scales);
        // The solver cannot be interrupted within an iteration; it is starved instead.
        if self.problem.clamp(&theta) != theta || *self.count.borrow() >= self.most || self.problem.is_stopped() {
            return Ok(WALL);
        }
        *self.count.borrow_mut() += 1;
        let Ok(evaluation) = self.problem.evaluate(&theta) else { return Ok(WALL) };
        if evaluation.violation > 0.0 {
            return Ok(WALL);
        }
        let cost = evaluation.cost();
        let mut best = self.best.borrow_mut();
        if best.as_ref().is_none_or(|(_, known)| cost < known.cost()) {
            *best = Some((theta, evaluation));
        }
        Ok(cost)
    }
}

/// Minimises `problem` without derivatives from `start`, until the costs of the simplex agree to `cost_tolerance` or after
/// `most_evaluations` simulations.
///
/// # Errors
/// [`PersonalisationError`] if sizes differ or no point of the first simplex can be simulated.
pub fn search_simplex<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    start: &DVector<f64>,
    cost_tolerance: f64,
    most_evaluations: usize,
) -> Result<SimplexSearch<M::Trajectory>, PersonalisationError> {
    if start.len() != problem.dimension() {
        return Err(PersonalisationError::Shape { what: "start coordinates", found: start.len(), expected: problem.dimension() });
    }
    let start = problem.clamp(start);
    let scales = problem.scales();
    let corner = |index: usize| {
        let mut point = start.clone();
        let edge = FIRST_EDGE * scales[index];
        let room = problem.upper()[index] - start[index];
        point[index] += if room >= edge { edge } else { -edge };
        Point(problem.clamp(&point).component_div(&scales))
    };
    let mut simplex = vec![Point(start.component_div(&scales))];
    simplex.extend((0..problem.dimension()).map(corner));
    let walled = Walled { problem, scales: scales.clone(), best: RefCell::new(None), count: RefCell::new(0), most: most_evaluations };
    let optimiser = |error: Error| PersonalisationError::Optimiser(error.to_string());
    let solver = NelderMead::new(simplex).with_sd_tolerance(cost_tolerance).map_err(optimiser)?;
    let iterations = most_evaluations as u64;
    Executor::new(&walled, solver).configure(|state| state.max_iters(iterations)).timer(false).run().map_err(optimiser)?;
    let evaluation_count = *walled.count.borrow();
    match walled.best.into_inner() {
        Some((coordinates, evaluation)) => Ok(SimplexSearch { coordinates, evaluation, evaluation_count }),
        None if problem.is_stopped() => Err(PersonalisationError::Stopped),
        None => problem.evaluate(&start).and(Err(PersonalisationError::Optimiser("no feasible point in the first simplex".to_owned()))),
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::personalisation::{DifferenceScheme, FiniteDifferenceModel, GaussNewtonSettings, Loss, PriorResidual, Residual, calibrate};

    /// Rows are differences from the data over 0.15 kPa.
    struct Pressures(DVector<f64>);

    impl Residual<DVector<f64>> for Pressures {
        fn row_count(&self) -> usize {
            self.0.len()
        }
        fn evaluate(&self, trajectory: &DVector<f64>, rows: &mut [f64]) {
            rows.copy_from_slice(((trajectory - &self.0) / 0.15).as_slice());
        }
        fn apply_tangent(&self, _: &DVector<f64>, tangent: &DVector<f64>, rows: &mut [f64]) {
            rows.copy_from_slice((tangent / 0.15).as_slice());
        }
        fn write_losses(&self, losses: &mut [Loss]) {
            losses.fill(Loss::Squares);
        }
    }

    /// Three-element Windkessel under 0.3 s of constant ejection, then decay, in ln R, ln C, ln p₀, ln Z.
    fn pressures(theta: &DVector<f64>) -> DVector<f64> {
        let (resistance, compliance, start, impedance) = (theta[0].exp(), theta[1].exp(), theta[2].exp(), theta[3].exp());
        let after = |pressure: f64, inflow: f64, time_s: f64| {
            let decay = (-time_s / (resistance * compliance)).exp();
            pressure * decay + resistance * inflow * (1.0 - decay)
        };
        DVector::from_fn(40, |k, _| {
            let time_s = 0.02 * k as f64;
            if time_s < 0.3 { after(start, 230.0, time_s) + impedance * 230.0 } else { after(after(start, 230.0, 0.3), 0.0, time_s - 0.3) }
        })
    }

    /// Both find the same minimum; what differs is the number of simulations, which is what a beating heart pays for.
    #[test]
    fn gauss_newton_needs_far_fewer_simulations_than_nelder_mead() {
        let truth = DVector::from_vec(vec![0.13_f64.ln(), 10.0_f64.ln(), 9.0_f64.ln(), 0.008_f64.ln()]);
        let noise = DVector::from_fn(40, |k, _| 0.15 * (k as f64 * 12.9898).sin());
        let data = Pressures(pressures(&truth) + noise);
        let simulations = AtomicUsize::new(0);
        let simulate = |theta: &DVector<f64>| {
            simulations.fetch_add(1, Ordering::Relaxed);
            Ok::<_, Infallible>(pressures(theta))
        };
        let wide = DVector::from_element(4, 1.5);
        let (lower, upper) = (&truth - &wide, &truth + &wide);
        let steps = DVector::from_element(4, 1e-4);
        let model = FiniteDifferenceModel::new(simulate, DifferenceScheme::Forward, steps, lower.clone(), upper.clone());
        let problem = CalibrationProblem::in_box(&model, &data, PriorResidual::none(4), lower, upper).unwrap();
        let start = &truth + DVector::from_vec(vec![0.5, -0.6, 0.3, 0.7]);

        let found = calibrate(&problem, &start, GaussNewtonSettings::default(), &mut |_| ()).unwrap();
        assert_eq!(found.outcome.status(), "converged");
        let (cost, count) = (found.evaluation.cost(), simulations.load(Ordering::Relaxed));
        let simplex = search_simplex(&problem, &start, 1e-4, 2000).unwrap();
        assert!((simplex.evaluation.cost() / cost - 1.0).abs() < 1e-3);
        assert!(5 * count < simplex.evaluation_count, "Gauss-Newton {count}, Nelder-Mead {}", simplex.evaluation_count);
    }

    #[test]
    fn bounds_are_a_wall() {
        let model = FiniteDifferenceModel::new(
            |theta: &DVector<f64>| Ok::<_, Infallible>(DVector::from_vec(vec![theta[0] - 3.0, theta[1]])),
            DifferenceScheme::Forward,
            DVector::from_element(2, 1e-4),
            DVector::from_element(2, -1.0),
            DVector::from_element(2, 1.0),
        );
        let unit = DVector::from_element(2, 1.0);
        let data = Pressures(DVector::zeros(2));
        let problem = CalibrationProblem::in_box(&model, &data, PriorResidual::none(2), -&unit, unit.clone()).unwrap();
        let found = search_simplex(&problem, &DVector::from_vec(vec![-0.5, 0.4]), 1e-8, 500).unwrap();
        assert!(found.coordinates.amax() <= 1.0);
        assert!((found.coordinates[0] - 1.0).abs() < 1e-2 && found.coordinates[1].abs() < 0.05, "{}", found.coordinates);
    }
}
