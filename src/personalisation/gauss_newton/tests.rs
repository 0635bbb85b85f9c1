//! Gauss–Newton against known minima: Rosenbrock with and without bounds, robust fits, failures, stops and constraints.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::*;
use crate::numerics::QuadraticProgram;
use crate::personalisation::{DifferenceScheme, FiniteDifferenceModel, LinearConstraint, Loss, PriorResidual, Residual, WithTangents};

#[derive(Debug, thiserror::Error)]
#[error("outside the domain")]
struct OutOfDomain;

/// A map θ → rows with its exact Jacobian.
struct Map<F, J> {
    rows: F,
    jacobian: J,
    calls: AtomicUsize,
}

impl<F, J> Map<F, J>
where
    F: Fn(&DVector<f64>) -> Result<DVector<f64>, OutOfDomain> + Sync,
    J: Fn(&DVector<f64>) -> DMatrix<f64> + Sync,
{
    fn new(rows: F, jacobian: J) -> Self {
        Self { rows, jacobian, calls: AtomicUsize::new(0) }
    }
}

impl<F, J> TangentModel for Map<F, J>
where
    F: Fn(&DVector<f64>) -> Result<DVector<f64>, OutOfDomain> + Sync,
    J: Fn(&DVector<f64>) -> DMatrix<f64> + Sync,
{
    type Trajectory = DVector<f64>;
    type Error = OutOfDomain;

    fn simulate(&self, theta: &DVector<f64>) -> Result<DVector<f64>, OutOfDomain> {
        self.calls.fetch_add(1, Ordering::Relaxed);
        (self.rows)(theta)
    }

    fn simulate_with_tangents(&self, theta: &DVector<f64>) -> WithTangents<DVector<f64>, OutOfDomain> {
        let jacobian = (self.jacobian)(theta);
        Ok(((self.rows)(theta)?, jacobian.column_iter().map(|column| column.into_owned()).collect()))
    }

    fn tangent_cost(&self, _: usize) -> f64 {
        1.0
    }
}

/// The trajectory is the residual.
struct Rows(usize, Loss);

impl Residual<DVector<f64>> for Rows {
    fn row_count(&self) -> usize {
        self.0
    }
    fn evaluate(&self, trajectory: &DVector<f64>, rows: &mut [f64]) {
        rows.copy_from_slice(trajectory.as_slice());
    }
    fn apply_tangent(&self, _: &DVector<f64>, tangent: &DVector<f64>, rows: &mut [f64]) {
        rows.copy_from_slice(tangent.as_slice());
    }
    fn write_losses(&self, losses: &mut [Loss]) {
        losses.fill(self.1);
    }
}

const SQUARES: Rows = Rows(2, Loss::Squares);

/// r = (10 (y − x²), 1 − x): Rosenbrock's valley, minimum 0 at (1, 1).
fn valley(theta: &DVector<f64>) -> Result<DVector<f64>, OutOfDomain> {
    Ok(DVector::from_vec(vec![10.0 * (theta[1] - theta[0] * theta[0]), 1.0 - theta[0]]))
}

fn valley_jacobian(theta: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_row_slice(2, 2, &[-20.0 * theta[0], 10.0, -1.0, 0.0])
}

fn bounds(lower: [f64; 2], upper: [f64; 2]) -> (DVector<f64>, DVector<f64>) {
    (DVector::from_column_slice(&lower), DVector::from_column_slice(&upper))
}

fn problem_in<'a, M: TangentModel<Trajectory = DVector<f64>>>(
    model: &'a M,
    residual: &'a dyn Residual<DVector<f64>>,
    lower: [f64; 2],
    upper: [f64; 2],
) -> CalibrationProblem<'a, M> {
    let (lower, upper) = bounds(lower, upper);
    CalibrationProblem::in_box(model, residual, PriorResidual::none(2), lower, upper).unwrap()
}

fn search<M: TangentModel<Trajectory = DVector<f64>>>(problem: CalibrationProblem<'_, M>, start: [f64; 2]) -> Calibration {
    calibrate(&problem, &DVector::from_column_slice(&start), GaussNewtonSettings::default(), &mut |_| ()).unwrap()
}

#[test]
fn the_valley_is_followed_to_its_minimum_inside_the_box() {
    let model = Map::new(valley, valley_jacobian);
    let found = search(problem_in(&model, &SQUARES, [-3.0, -3.0], [3.0, 3.0]), [-1.2, 1.0]);
    assert!((found.coordinates - DVector::from_element(2, 1.0)).amax() < 1e-6, "{:?}", found.outcome);
    assert_eq!(found.outcome.status(), "converged");
    assert!(found.records.windows(2).all(|pair| pair[1].cost < pair[0].cost), "the cost of accepted steps falls");
    assert_eq!(found.evaluation_count as usize, model.calls.load(Ordering::Relaxed));
}

/// With x ≤ 0.8 the minimum lies at (0.8, 0.64): there the rest of the gradient is one multiplier, 1 − x = 0.2.
#[test]
fn an_active_bound_is_found_and_reported() {
    let model = Map::new(valley, valley_jacobian);
    for shape in [TrustShape::Ball, TrustShape::Box] {
        let settings = GaussNewtonSettings { trust_shape: shape, ..GaussNewtonSettings::default() };
        let start = DVector::from_vec(vec![-1.2, 1.0]);
        let found = calibrate(&problem_in(&model, &SQUARES, [-3.0, -3.0], [0.8, 3.0]), &start, settings, &mut |_| ()).unwrap();
        assert!((found.coordinates - DVector::from_vec(vec![0.8, 0.64])).amax() < 1e-6, "{shape:?}");
        assert_eq!(found.outcome.status(), "on_bound");
        assert_eq!(found.records.last().unwrap().active_upper, [0]);
        let gradient = found.linearisation.unwrap().gradient();
        assert!((gradient[0] + 0.2).abs() < 1e-5 && gradient[1].abs() < 1e-5, "{gradient}");
    }
}

/// On linear residuals one full step is the constrained least-squares solution itself.
#[test]
fn linear_residuals_with_bounds_prior_and_constraint_agree_with_one_quadratic_program() {
    let matrix = DMatrix::from_row_slice(4, 2, &[1.0, 2.0, -1.0, 0.5, 3.0, 1.0, 0.2, -2.0]);
    let data = DVector::from_vec(vec![3.0, -1.0, 2.0, -4.0]);
    let model = Map::new(|theta: &DVector<f64>| Ok(&matrix * theta - &data), |_: &DVector<f64>| matrix.clone());
    let (mean, sd) = (DVector::from_vec(vec![0.5, 0.5]), DVector::from_vec(vec![0.7, 2.0]));
    let (lower, upper) = bounds([-1.0, -1.0], [0.4, 5.0]);
    let coefficients = DVector::from_vec(vec![1.0, 1.0]);
    let prior = PriorResidual::new(mean.clone(), sd.clone()).unwrap();
    let problem = CalibrationProblem::in_box(&model, &Rows(4, Loss::Squares), prior, lower.clone(), upper.clone())
        .unwrap()
        .with_constraint(LinearConstraint::new("sum", coefficients.clone(), 1.5).unwrap());
    let found = search(problem, [-0.9, -0.9]);

    let precision = sd.map(|sd| 1.0 / (sd * sd));
    let hessian = matrix.tr_mul(&matrix) + DMatrix::from_diagonal(&precision);
    let gradient = -matrix.tr_mul(&data) - precision.component_mul(&mean);
    let exact = QuadraticProgram::new(hessian, gradient)
        .and_then(|qp| qp.with_bounds(lower, upper))
        .and_then(|qp| qp.with_inequalities(DMatrix::from_row_slice(1, 2, coefficients.as_slice()), DVector::from_element(1, 1.5)))
        .and_then(|qp| qp.solve())
        .unwrap();
    assert!((found.coordinates - exact.x).amax() < 1e-9);
    assert_eq!(found.outcome.status(), "on_bound");
    assert_eq!(found.records.last().unwrap().active_constraints, exact.active_inequalities);
}

/// A start that violates a constraint is led back to it.
#[test]
fn constraints_are_recovered_from_outside() {
    let model = Map::new(valley, valley_jacobian);
    let constraint = LinearConstraint::new("x + y <= 0", DVector::from_element(2, 1.0), 0.0).unwrap();
    let found = search(problem_in(&model, &SQUARES, [-3.0, -3.0], [3.0, 3.0]).with_constraint(constraint), [2.0, 2.5]);
    assert!(found.evaluation.violation < 1e-6);
    // On y = −x the cost is 50 (x + x²)² + (1 − x)²/2; its minimum solves 100 (x + x²)(1 + 2x) = 1 − x.
    let x = found.coordinates[0];
    assert!((100.0 * (x + x * x) * (1.0 + 2.0 * x) - (1.0 - x)).abs() < 1e-2, "{x}");
}

/// A simulation that fails beyond x = 1.1 shrinks the step; the search goes on to the minimum on the good side.
#[test]
fn failed_simulations_shrink_the_step_instead_of_ending_the_search() {
    let guarded = |theta: &DVector<f64>| if theta[0] > 1.1 { Err(OutOfDomain) } else { valley(theta) };
    let model = Map::new(guarded, valley_jacobian);
    let settings = GaussNewtonSettings { initial_radius: 50.0, ..GaussNewtonSettings::default() };
    let start = DVector::from_vec(vec![-1.2, 1.0]);
    let found = calibrate(&problem_in(&model, &SQUARES, [-3.0, -3.0], [3.0, 3.0]), &start, settings, &mut |_| ()).unwrap();
    assert!((found.coordinates - DVector::from_element(2, 1.0)).amax() < 1e-6, "{:?}", found.outcome);
    // Full steps of arctan x = ½ from −3 overshoot far into the failing half-plane.
    let overshooting = Map::new(
        |theta: &DVector<f64>| {
            if theta[0] > 1.5 { Err(OutOfDomain) } else { Ok(DVector::from_vec(vec![theta[0].atan() - 0.5, theta[1]])) }
        },
        |theta: &DVector<f64>| DMatrix::from_row_slice(2, 2, &[1.0 / (1.0 + theta[0] * theta[0]), 0.0, 0.0, 1.0]),
    );
    let found = calibrate(
        &problem_in(&overshooting, &SQUARES, [-30.0, -3.0], [30.0, 3.0]),
        &DVector::from_vec(vec![-3.0, 1.0]),
        settings,
        &mut |_| (),
    )
    .unwrap();
    assert!((found.coordinates[0] - 0.5_f64.tan()).abs() < 1e-6, "{:?}", found.outcome);
    assert!(found.records.iter().any(|record| record.trials > 1), "some trial must have failed");
}

#[test]
fn a_start_that_cannot_be_simulated_is_an_error() {
    let model = Map::new(|_: &DVector<f64>| Err(OutOfDomain), valley_jacobian);
    let problem = problem_in(&model, &SQUARES, [-3.0, -3.0], [3.0, 3.0]);
    let error = calibrate(&problem, &DVector::zeros(2), GaussNewtonSettings::default(), &mut |_| ()).unwrap_err();
    assert!(matches!(error, PersonalisationError::Simulation { .. }), "{error}");
    let poisoned = Map::new(|_: &DVector<f64>| Ok(DVector::from_vec(vec![0.0, f64::NAN])), valley_jacobian);
    let problem = problem_in(&poisoned, &SQUARES, [-3.0, -3.0], [3.0, 3.0]);
    let error = calibrate(&problem, &DVector::zeros(2), GaussNewtonSettings::default(), &mut |_| ()).unwrap_err();
    assert!(matches!(error, PersonalisationError::NonFiniteResidual { row: 1, .. }), "{error}");
}

/// The flag is raised by the observer of the second step, as Ctrl-C would.
#[test]
fn a_stop_keeps_the_best_point_so_far() {
    let model = Map::new(valley, valley_jacobian);
    let flag = AtomicBool::new(false);
    let problem = problem_in(&model, &SQUARES, [-3.0, -3.0], [3.0, 3.0]).with_stop_flag(&flag);
    let mut observer = |record: &IterationRecord| flag.store(record.iteration == 2, Ordering::SeqCst);
    let start = DVector::from_vec(vec![-1.2, 1.0]);
    let found = calibrate(&problem, &start, GaussNewtonSettings::default(), &mut observer).unwrap();
    assert_eq!(found.outcome, CalibrationOutcome::Stopped);
    assert_eq!(found.records.len(), 3);
    assert_eq!(found.coordinates, found.records[2].coordinates);
}

#[test]
fn too_few_iterations_are_an_outcome() {
    let model = Map::new(valley, valley_jacobian);
    let settings = GaussNewtonSettings { max_iterations: 1, ..GaussNewtonSettings::default() };
    let problem = problem_in(&model, &SQUARES, [-3.0, -3.0], [3.0, 3.0]);
    let found = calibrate(&problem, &DVector::from_vec(vec![-1.2, 1.0]), settings, &mut |_| ()).unwrap();
    assert_eq!(found.outcome, CalibrationOutcome::MaxIterations);
    assert_eq!(found.records.len(), 2);
}

/// Straight line through ten points, one of them 50 off: least squares is dragged away, Huber's fit is not, and it is the minimum of
/// Huber's objective: Σ w r ∂r = 0.
#[test]
fn huber_loss_holds_against_an_outlier() {
    let line = |theta: &DVector<f64>| {
        let row = |k: usize| theta[0] + theta[1] * k as f64 - (1.0 + 0.5 * k as f64) + 0.1 * (k as f64 * 2.4).sin();
        Ok(DVector::from_fn(10, |k, _| if k == 8 { row(k) + 50.0 } else { row(k) }))
    };
    let jacobian = |_: &DVector<f64>| DMatrix::from_fn(10, 2, |k, column| if column == 0 { 1.0 } else { k as f64 });
    let model = Map::new(line, jacobian);
    let robust_rows = Rows(10, Loss::Huber { threshold: 1.0 });
    let robust = search(problem_in(&model, &robust_rows, [-20.0; 2], [20.0; 2]), [0.0, 0.0]);
    let plain = search(problem_in(&model, &Rows(10, Loss::Squares), [-20.0; 2], [20.0; 2]), [0.0, 0.0]);
    let truth = DVector::from_vec(vec![1.0, 0.5]);
    assert!((&robust.coordinates - &truth).amax() < 0.4, "{}", robust.coordinates);
    assert!((&plain.coordinates - &truth).amax() > 2.0, "{}", plain.coordinates);
    let gradient = robust.linearisation.unwrap().gradient();
    assert!(gradient.amax() < 1e-3, "{gradient}");
}

/// The whole search does the same with one thread and with four, through the parallel finite differences.
#[test]
fn the_search_does_not_depend_on_the_number_of_threads() {
    let with = |threads: usize| {
        let wide = DVector::from_element(2, 3.0);
        let model = FiniteDifferenceModel::new(valley, DifferenceScheme::Forward, DVector::from_element(2, 1e-6), -&wide, wide.clone());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| search(problem_in(&model, &SQUARES, [-3.0; 2], [3.0; 2]), [-1.2, 1.0]))
    };
    assert_eq!(with(1), with(4));
}
