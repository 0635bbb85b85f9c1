//! Quadratic programs against their optimality conditions and closed forms.

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
        let stationarity =
            &hessian * x + &gradient + a.transpose() * &solution.equality_multipliers + g.transpose() * &solution.inequality_multipliers
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

/// A variable without curvature and a constraint written twice do not spoil the exactness of the rest.
#[test]
fn flat_directions_and_repeated_rows_leave_the_rest_exact() {
    let hessian = DMatrix::from_diagonal(&DVector::from_vec(vec![2.0, 0.0]));
    let rows = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 1.0, 0.0]);
    let solution = QuadraticProgram::new(hessian, DVector::from_vec(vec![-60.0, 0.0]))
        .and_then(|qp| qp.with_bounds(DVector::from_element(2, -25.0), DVector::from_element(2, 25.0)))
        .and_then(|qp| qp.with_inequalities(rows, DVector::from_element(2, 20.0)))
        .and_then(|qp| qp.solve())
        .unwrap();
    assert!((solution.x[0] - 20.0).abs() < 1e-12, "{}", solution.x[0]);
    assert!((solution.inequality_multipliers.sum() - 20.0).abs() < 1e-9);
}
