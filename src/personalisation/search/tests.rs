//! Five solvers on problems whose minima are known: a Windkessel with noise, a bound, a hole in the domain, and a search that is taken up again.

use std::convert::Infallible;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use nalgebra::DVector;

use super::*;
use crate::personalisation::{DifferenceScheme, FiniteDifferenceModel, Journal, JournalEntry, Loss, PriorResidual, Residual};

const METHODS: [SearchMethod; 5] =
    [SearchMethod::GaussNewton, SearchMethod::NelderMead, SearchMethod::Lbfgs, SearchMethod::ParticleSwarm, SearchMethod::CmaEs];

fn settings(method: SearchMethod, most_simulations: f64) -> SearchSettings {
    let limits = GaussNewtonSettings { max_iterations: 2000, ..GaussNewtonSettings::default() };
    SearchSettings { method, limits, most_simulations, seed: 1 }
}

/// Rows are differences from the data over 0.15.
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

/// Truth, noisy data, and a start that is off by a factor of up to two.
fn windkessel() -> (DVector<f64>, Pressures, DVector<f64>) {
    let truth = DVector::from_vec(vec![0.13_f64.ln(), 10.0_f64.ln(), 9.0_f64.ln(), 0.008_f64.ln()]);
    let noise = DVector::from_fn(40, |k, _| 0.15 * (k as f64 * 12.9898).sin());
    let start = &truth + DVector::from_vec(vec![0.5, -0.6, 0.3, 0.7]);
    (truth.clone(), Pressures(pressures(&truth) + noise), start)
}

/// All find the same minimum; what differs is the number of simulations, which is what a beating heart pays for.
#[test]
fn all_solvers_agree_and_gauss_newton_needs_far_fewer_simulations() {
    let (truth, data, start) = windkessel();
    let wide = DVector::from_element(4, 1.5);
    let (lower, upper) = (&truth - &wide, &truth + &wide);
    let simulations = AtomicUsize::new(0);
    let simulate = |theta: &DVector<f64>| {
        simulations.fetch_add(1, Ordering::Relaxed);
        Ok::<_, Infallible>(pressures(theta))
    };
    let steps = DVector::from_element(4, 1e-4);
    let mut spent = Vec::new();
    let mut costs = Vec::new();
    for method in METHODS {
        simulations.store(0, Ordering::Relaxed);
        let model = FiniteDifferenceModel::new(simulate, DifferenceScheme::Forward, steps.clone(), lower.clone(), upper.clone());
        let problem = CalibrationProblem::in_box(&model, &data, PriorResidual::none(4), lower.clone(), upper.clone()).unwrap();
        let found = search(&problem, &start, settings(method, 5000.0), &mut |_| ()).unwrap();
        assert_eq!(found.outcome.status(), "converged", "{method:?}");
        assert!(found.records.windows(2).all(|pair| pair[1].cost <= pair[0].cost && pair[1].spent >= pair[0].spent), "{method:?}");
        // The linearisation at the end, and its base, are for the uncertainty and not charged to the search.
        let extra = if method == SearchMethod::GaussNewton { 0.0 } else { 5.0 };
        let counted = simulations.load(Ordering::Relaxed) as f64;
        assert!((counted - extra..=counted).contains(&found.spent), "{method:?}: {} of {counted} simulations", found.spent);
        spent.push(found.spent);
        costs.push(found.evaluation.cost());
    }
    for (method, cost) in METHODS.iter().zip(&costs) {
        assert!((cost / costs[0] - 1.0).abs() < 1e-2, "{method:?}: {cost} where Gauss-Newton has {}", costs[0]);
    }
    assert!(spent[1..].iter().all(|&other| other > 3.0 * spent[0]), "{spent:?}");
}

#[test]
fn a_minimum_beyond_the_box_is_found_on_its_bound_by_every_solver() {
    let lower = DVector::from_element(2, -1.0);
    let upper = DVector::from_element(2, 1.0);
    let simulate = |theta: &DVector<f64>| Ok::<_, Infallible>(DVector::from_vec(vec![theta[0] - 3.0, theta[1] - 0.2]));
    let steps = DVector::from_element(2, 1e-4);
    let model = FiniteDifferenceModel::new(simulate, DifferenceScheme::Central, steps, lower.clone(), upper.clone());
    let data = Pressures(DVector::zeros(2));
    for method in METHODS {
        let problem = CalibrationProblem::in_box(&model, &data, PriorResidual::none(2), lower.clone(), upper.clone()).unwrap();
        let found = search(&problem, &DVector::from_vec(vec![-0.5, 0.4]), settings(method, 2000.0), &mut |_| ()).unwrap();
        assert!(found.coordinates.amax() <= 1.0);
        assert!((found.coordinates - DVector::from_vec(vec![1.0, 0.2])).amax() < 2e-3, "{method:?}: {:?}", found.outcome);
        assert_eq!(found.outcome.status(), "on_bound", "{method:?}");
    }
}

#[derive(Debug, thiserror::Error)]
#[error("outside the domain")]
struct OutOfDomain;

/// Beyond x = 0.5 there is no simulation; the minimum lies at 0.3, the start and the first steps near the edge.
#[test]
fn simulations_that_fail_are_gone_around() {
    let simulate = |theta: &DVector<f64>| {
        if theta[0] > 0.5 { Err(OutOfDomain) } else { Ok(DVector::from_vec(vec![theta[0] - 0.3, 2.0 * theta[1] + theta[0]])) }
    };
    let wide = DVector::from_element(2, 2.0);
    let steps = DVector::from_element(2, 1e-4);
    let model = FiniteDifferenceModel::new(simulate, DifferenceScheme::Forward, steps, -&wide, wide.clone());
    let data = Pressures(DVector::zeros(2));
    for method in METHODS {
        let problem = CalibrationProblem::in_box(&model, &data, PriorResidual::none(2), -&wide, wide.clone()).unwrap();
        let found = search(&problem, &DVector::from_vec(vec![0.45, 0.9]), settings(method, 3000.0), &mut |_| ()).unwrap();
        assert!(
            (&found.coordinates - DVector::from_vec(vec![0.3, -0.15])).amax() < 2e-2,
            "{method:?}: {:?} at {}",
            found.outcome,
            found.coordinates
        );
    }
}

/// What is interrupted and taken up again from its journal ends with the very numbers of a search that was left alone, and simulates
/// nothing twice.
#[test]
fn an_interrupted_search_goes_on_where_it_was() {
    let (truth, data, start) = windkessel();
    let wide = DVector::from_element(4, 1.5);
    let (lower, upper) = (&truth - &wide, &truth + &wide);
    let simulations = AtomicUsize::new(0);
    let stop = AtomicBool::new(false);
    let stop_at = AtomicUsize::new(usize::MAX);
    let simulate = |theta: &DVector<f64>| {
        if simulations.fetch_add(1, Ordering::Relaxed) + 1 >= stop_at.load(Ordering::Relaxed) {
            stop.store(true, Ordering::Relaxed);
        }
        Ok::<_, Infallible>(pressures(theta))
    };
    let searched = |method, entries: Vec<JournalEntry>, sink: &(dyn Fn(&JournalEntry) + Sync)| {
        let steps = DVector::from_element(4, 1e-4);
        let model = FiniteDifferenceModel::new(simulate, DifferenceScheme::Forward, steps, lower.clone(), upper.clone());
        let problem = CalibrationProblem::in_box(&model, &data, PriorResidual::none(4), lower.clone(), upper.clone())
            .unwrap()
            .with_stop_flag(&stop)
            .with_journal(Journal::new(entries, sink));
        search(&problem, &start, settings(method, 400.0), &mut |_| ()).unwrap()
    };
    for method in METHODS {
        simulations.store(0, Ordering::Relaxed);
        stop_at.store(usize::MAX, Ordering::Relaxed);
        let alone = searched(method, Vec::new(), &|_| ());
        let whole = simulations.swap(0, Ordering::Relaxed);
        stop_at.store(17, Ordering::Relaxed);
        let journal = Mutex::new(Vec::new());
        let keep = |entry: &JournalEntry| journal.lock().unwrap().push(entry.to_string());
        let interrupted = searched(method, Vec::new(), &keep);
        assert_eq!(interrupted.outcome.status(), "stopped", "{method:?}");
        let before = simulations.swap(0, Ordering::Relaxed);
        stop.store(false, Ordering::Relaxed);
        stop_at.store(usize::MAX, Ordering::Relaxed);
        let entries = journal.lock().unwrap().iter().map(|line| line.parse().unwrap()).collect();
        let resumed = searched(method, entries, &|_| ());
        assert_eq!(resumed.coordinates, alone.coordinates, "{method:?}");
        assert_eq!((&resumed.records, resumed.spent), (&alone.records, alone.spent), "{method:?}");
        // At most the linearisation that was cut short is done again, and its base.
        let twice = before + simulations.load(Ordering::Relaxed) - whole;
        assert!(twice <= 6, "{method:?}: {before} before, {whole} in all, {twice} twice");
    }
}

/// Rosenbrock's valley and an ill-scaled ellipsoid: what a covariance is adapted for.
#[test]
fn covariance_adapts_to_valleys_and_scales() {
    struct Function(fn(&DVector<f64>) -> f64);
    impl argmin::core::CostFunction for Function {
        type Param = DVector<f64>;
        type Output = f64;
        fn cost(&self, x: &DVector<f64>) -> Result<f64, Error> {
            Ok((self.0)(x))
        }
    }
    let valley = |x: &DVector<f64>| (0..x.len() - 1).map(|i| 100.0 * (x[i + 1] - x[i] * x[i]).powi(2) + (1.0 - x[i]).powi(2)).sum();
    let ellipsoid = |x: &DVector<f64>| x.iter().enumerate().map(|(i, x)| 10.0_f64.powi(i as i32) * (x - 1.0) * (x - 1.0)).sum();
    for (name, function, most) in [("valley", valley as fn(&DVector<f64>) -> f64, 400), ("ellipsoid", ellipsoid, 400)] {
        let solver = CmaEs::new(DVector::from_element(5, -0.5), 0.5, 1e-9, 3);
        let configure = |state: PointState<()>| state.max_iters(most);
        let result = Executor::new(Function(function), solver).configure(configure).timer(false).run().unwrap();
        let found = result.state.best_param.unwrap();
        assert!((&found - DVector::from_element(5, 1.0)).amax() < 1e-6, "{name}: {found}");
    }
}
