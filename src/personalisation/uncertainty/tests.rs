//! Uncertainty against closed forms, and intervals that cover over repeats.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::*;
use crate::heart::{Parameter, Parameters};
use crate::numerics::{NORMAL_QUANTILE_95, chi_square_quantile};
use crate::personalisation::{
    Cluster, DifferenceScheme, FiniteDifferenceModel, FreeParameter, GaussNewtonSettings, Loss, ParameterSpace, PriorResidual, Residual,
    calibrate,
};

/// Data d, constant standard deviation: r = (trajectory − d)/σ.
struct Samples {
    data: Vec<f64>,
    sd: f64,
}

impl Residual<DVector<f64>> for Samples {
    fn row_count(&self) -> usize {
        self.data.len()
    }
    fn evaluate(&self, trajectory: &DVector<f64>, rows: &mut [f64]) {
        for ((row, value), data) in rows.iter_mut().zip(trajectory).zip(&self.data) {
            *row = (value - data) / self.sd;
        }
    }
    fn apply_tangent(&self, _: &DVector<f64>, tangent: &DVector<f64>, rows: &mut [f64]) {
        for (row, value) in rows.iter_mut().zip(tangent) {
            *row = value / self.sd;
        }
    }
    fn write_losses(&self, losses: &mut [Loss]) {
        losses.fill(Loss::Squares);
    }
}

type Simulated = Result<DVector<f64>, std::convert::Infallible>;

fn model<F: Fn(&DVector<f64>) -> Simulated + Sync>(simulate: F, dimension: usize) -> FiniteDifferenceModel<F, DVector<f64>> {
    let wide = DVector::from_element(dimension, 100.0);
    FiniteDifferenceModel::new(simulate, DifferenceScheme::Central, DVector::from_element(dimension, 1e-4), -&wide, wide)
}

fn posterior<F: Fn(&DVector<f64>) -> Simulated + Sync>(
    simulate: F,
    samples: &Samples,
    prior: PriorResidual,
    bounds: f64,
    noise: NoiseScale,
) -> (DVector<f64>, Uncertainty) {
    let dimension = prior.mean().len();
    let model = model(simulate, dimension);
    let limit = DVector::from_element(dimension, bounds);
    let problem = CalibrationProblem::in_box(&model, samples, prior, -&limit, limit).unwrap();
    let found = calibrate(&problem, &DVector::zeros(dimension), GaussNewtonSettings::default(), &mut |_| ()).unwrap();
    let linearisation = found.linearisation.unwrap();
    (found.coordinates, Uncertainty::new(&problem, &linearisation, noise).unwrap())
}

/// Mean of n values with prior N(0, s₀²): variance 1/(n/σ² + 1/s₀²).
#[test]
fn a_mean_with_a_prior_has_the_conjugate_variance() {
    let samples = Samples { data: vec![1.0, 2.0, 3.0, 2.5], sd: 0.5 };
    let prior = PriorResidual::new(DVector::zeros(1), DVector::from_element(1, 2.0)).unwrap();
    let constant = |theta: &DVector<f64>| Ok(DVector::from_element(4, theta[0]));
    let (mean, posterior) = posterior(constant, &samples, prior, 50.0, NoiseScale::AsStated);
    let precision = 4.0 / 0.25 + 0.25;
    assert!((posterior.sd[0].unwrap() - 1.0 / f64::sqrt(precision)).abs() < 1e-9);
    assert!((mean[0] - 8.5 / 0.25 / precision).abs() < 1e-6);
    // √n s₀/σ = 8: the data know this eight times better than the prior.
    assert!((posterior.singular_values[0] - 8.0).abs() < 1e-7);
    assert_eq!(posterior.verdict(&["mean".to_owned()]), ["All 1 parameters are told apart by this data."]);
}

/// Two parameters of which the data see the sum alone.
#[test]
fn a_sum_does_not_tell_its_terms_apart() {
    let samples = Samples { data: vec![1.0, 1.1, 0.9], sd: 0.01 };
    let prior = PriorResidual::new(DVector::zeros(2), DVector::from_element(2, 1.0)).unwrap();
    let sum = |theta: &DVector<f64>| Ok(DVector::from_element(3, theta[0] + theta[1]));
    let (_, posterior) = posterior(sum, &samples, prior, 50.0, NoiseScale::AsStated);
    assert!(posterior.correlations[(0, 1)] < -0.999);
    assert_eq!(posterior.informed_directions(), 1);
    let verdict = posterior.verdict(&["action_potential_duration_s".to_owned(), "relaxation_rate_per_s".to_owned()]);
    assert_eq!(
        verdict,
        ["action_potential_duration_s and relaxation_rate_per_s cannot be told apart on this data (correlation -1.00): \
          only about their product is known."]
    );
}

#[test]
fn what_neither_data_nor_prior_see_is_infinite_and_what_a_bound_holds_has_no_interval() {
    let samples = Samples { data: vec![30.0, 30.0], sd: 1.0 };
    let simulate = |theta: &DVector<f64>| Ok(DVector::from_element(2, theta[0] + 0.0 * theta[1]));
    let (found, unseen) = posterior(simulate, &samples, PriorResidual::none(2), 20.0, NoiseScale::AsStated);
    assert_eq!(found[0], 20.0);
    assert_eq!(unseen.sd, [None, Some(f64::INFINITY)]);
    let verdict = unseen.verdict(&["a".to_owned(), "b".to_owned()]);
    assert!(verdict[0].starts_with("a is held by its bound") && verdict[1].starts_with("b is not determined"), "{verdict:?}");
    let prior = PriorResidual::new(DVector::zeros(2), DVector::from_vec(vec![f64::INFINITY, 0.3])).unwrap();
    let (_, prior_only) = posterior(simulate, &samples, prior, 50.0, NoiseScale::AsStated);
    assert!((prior_only.sd[1].unwrap() - 0.3).abs() < 1e-12);
    assert!(prior_only.verdict(&["a".to_owned(), "b".to_owned()])[0].contains("interval is that of the prior"));
}

/// Stated noise too small by ten: the residuals say so, and the standard deviation is that of the right statement.
#[test]
fn residuals_correct_a_noise_stated_too_small() {
    let data: Vec<f64> = (0..400).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
    let constant = |theta: &DVector<f64>| Ok(DVector::from_element(400, theta[0]));
    let told = posterior(constant, &Samples { data, sd: 0.1 }, PriorResidual::none(1), 50.0, NoiseScale::FromResiduals).1;
    assert!((told.noise_scale - 10.0 * (400.0_f64 / 399.0).sqrt()).abs() < 1e-6);
    assert!((told.sd[0].unwrap() - 1.0 / 20.0).abs() < 1e-3);
}

/// Damped oscillation x(t) = a e^{−δt} cos(ωt) in logarithmic coordinates.
fn oscillator(theta: &DVector<f64>) -> Simulated {
    let (amplitude, damping, frequency) = (theta[0].exp(), theta[1].exp(), theta[2].exp());
    Ok(DVector::from_fn(40, |k, _| {
        let time = 0.05 * k as f64;
        amplitude * (-damping * time).exp() * (frequency * time).cos()
    }))
}

/// Two-element Windkessel after a constant inflow q = 100 mL/s: p(t) = p₀ e^{−t/RC} + R q (1 − e^{−t/RC}), in log R, log C, log p₀.
fn windkessel(theta: &DVector<f64>) -> Simulated {
    let (resistance, compliance, initial) = (theta[0].exp(), theta[1].exp(), theta[2].exp());
    Ok(DVector::from_fn(40, |k, _| {
        let decay = (-0.05 * k as f64 / (resistance * compliance)).exp();
        initial * decay + resistance * 100.0 * (1.0 - decay)
    }))
}

/// A simulation, its true parameters and the standard deviation of its noise.
type Case = (fn(&DVector<f64>) -> Simulated, [f64; 3], f64);

/// Truth, noise, estimate, many times: the mean NEES (θ̂ − θ)ᵀ C⁻¹ (θ̂ − θ) lies within the χ² band of its 3 × 120 degrees of freedom, and
/// 95 % intervals hold the truth about as often as they say. A failure means that intervals printed for patients are wrong.
#[test]
fn intervals_cover_and_nees_is_consistent_over_repeats() {
    const REPEATS: usize = 120;
    let cases: [Case; 2] = [(oscillator, [2.0, 0.5, 6.0], 0.1), (windkessel, [0.13, 10.0, 8.0], 0.15)];
    for (case, (simulate, truth, sd)) in cases.into_iter().enumerate() {
        let truth = DVector::from_column_slice(&truth).map(f64::ln);
        let clean = simulate(&truth).unwrap();
        let (mut nees, mut covered) = (0.0, 0);
        for seed in 0..REPEATS {
            let mut rng = ChaCha8Rng::seed_from_u64(1000 * case as u64 + seed as u64);
            let noise = Normal::new(0.0, sd).unwrap();
            let samples = Samples { data: clean.iter().map(|value| value + noise.sample(&mut rng)).collect(), sd };
            let model = model(simulate, 3);
            let spread = DVector::from_element(3, 1.0);
            let problem =
                CalibrationProblem::in_box(&model, &samples, PriorResidual::none(3), &truth - &spread * 2.0, &truth + &spread * 2.0)
                    .unwrap();
            let start = &truth + DVector::from_vec(vec![0.3, -0.3, 0.1]);
            let found = calibrate(&problem, &start, GaussNewtonSettings::default(), &mut |_| ()).unwrap();
            assert_eq!(found.outcome.status(), "converged", "case {case} seed {seed}");
            let posterior = Uncertainty::new(&problem, &found.linearisation.unwrap(), NoiseScale::AsStated).unwrap();
            let error = &found.coordinates - &truth;
            nees += error.dot(&posterior.covariance.clone().cholesky().unwrap().solve(&error));
            covered += (0..3).filter(|&k| error[k].abs() <= NORMAL_QUANTILE_95 * posterior.sd[k].unwrap()).count();
        }
        let degrees = (3 * REPEATS) as f64;
        let band = chi_square_quantile(degrees, -2.576)..chi_square_quantile(degrees, 2.576);
        assert!(band.contains(&nees), "case {case}: NEES {nees} outside {band:?}");
        let coverage = covered as f64 / degrees;
        assert!((0.92..0.98).contains(&coverage), "case {case}: coverage {coverage}");
    }
}

/// The rows of `parameters.csv`: intervals through the logarithm, cut at bounds; fixed parameters without interval.
#[test]
fn estimates_are_mapped_back_to_physical_units() {
    let peak = FreeParameter::new(Parameter::ContractionPeakLv).between(40.0, 105.0);
    let rate = FreeParameter { fixed: true, ..FreeParameter::new(Parameter::ContractionRate) };
    let onset = FreeParameter::new(Parameter::OnsetTime).between(-0.1, 0.2);
    let space = ParameterSpace::new(Parameters::default(), vec![peak, rate, onset]).unwrap();
    let coordinates = DVector::from_vec(vec![100.0_f64.ln(), 0.2]);
    let uncertainty = Uncertainty {
        free: vec![0],
        covariance: DMatrix::from_element(1, 1, 0.01),
        sd: vec![Some(0.1), None],
        correlations: DMatrix::identity(1, 1),
        noise_scale: 1.0,
        singular_values: vec![10.0],
        directions: DMatrix::identity(1, 1),
        prior_sd: DVector::from_element(2, 1.0),
    };
    let rows = estimates(&space, &coordinates, Some(&uncertainty));
    assert_eq!(rows.iter().map(|row| row.at_bound).collect::<Vec<_>>(), [BoundState::Free, BoundState::Fixed, BoundState::Upper]);
    assert!((rows[0].sd.unwrap() - 10.0).abs() < 1e-9);
    assert!((rows[0].interval_low.unwrap() - 100.0 * (-0.195_996_4_f64).exp()).abs() < 1e-4);
    assert_eq!(rows[0].interval_high, Some(105.0));
    assert_eq!((rows[1].sd, rows[2].sd, rows[2].interval_high), (None, None, None));
}

/// Values on a grid of places and instants.
struct Gridded {
    samples: Samples,
    instants: usize,
}

impl Residual<DVector<f64>> for Gridded {
    fn row_count(&self) -> usize {
        self.samples.row_count()
    }
    fn evaluate(&self, trajectory: &DVector<f64>, rows: &mut [f64]) {
        self.samples.evaluate(trajectory, rows);
    }
    fn apply_tangent(&self, at: &DVector<f64>, tangent: &DVector<f64>, rows: &mut [f64]) {
        self.samples.apply_tangent(at, tangent, rows);
    }
    fn write_losses(&self, losses: &mut [Loss]) {
        losses.fill(Loss::Squares);
    }
    fn write_clusters(&self, clusters: &mut [Cluster]) {
        for (row, cluster) in clusters.iter_mut().enumerate() {
            *cluster = Cluster { place: (row / self.instants) as u32, instant: (row % self.instants) as u32 };
        }
    }
}

/// The mean of `values` and its standard deviations by clusters and by rows.
fn gridded_mean(values: Vec<f64>, instants: usize) -> (f64, [f64; 2]) {
    let count = values.len();
    let constant = move |theta: &DVector<f64>| -> Simulated { Ok(DVector::from_element(count, theta[0])) };
    let residual = Gridded { samples: Samples { data: values, sd: 0.01 }, instants };
    let (model, limit) = (model(constant, 1), DVector::from_element(1, 50.0));
    let problem = CalibrationProblem::in_box(&model, &residual, PriorResidual::none(1), -&limit, limit).unwrap();
    let found = calibrate(&problem, &DVector::zeros(1), GaussNewtonSettings::default(), &mut |_| ()).unwrap();
    let at = found.linearisation.unwrap();
    let sd = |noise| Uncertainty::new(&problem, &at, noise).unwrap().sd[0].unwrap();
    (found.coordinates[0], [sd(NoiseScale::FromClusters), sd(NoiseScale::FromResiduals)])
}

/// Rows that are copies of each other are no more data than one of them: the deviation of the mean is that of the mean of the places.
#[test]
fn copies_of_a_row_are_not_counted_as_data() {
    let of_places: [f64; 5] = [1.0, 2.0, 4.0, 3.0, 0.5];
    let (mean, [clustered, by_rows]) = gridded_mean(of_places.iter().flat_map(|&value| [value; 8]).collect(), 8);
    let spread: f64 = of_places.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 4.0;
    // Instants alike in every place add nothing; what place and instant both count is taken off, 1/n of it.
    let both = of_places.iter().map(|value| (value - mean).powi(2)).sum::<f64>() * 8.0 / 1600.0 * 40.0 / 39.0;
    let expected = (spread / 5.0 - both).sqrt();
    assert!((clustered / expected - 1.0).abs() < 1e-6, "{clustered} {expected}");
    assert!(by_rows < 0.4 * clustered, "{by_rows}");
}

/// Errors of places that last and of instants that all places share: 95 % intervals by clusters cover, those by rows promise three times too much.
#[test]
fn intervals_by_clusters_cover_where_rows_err_together() {
    let (places, instants, repeats) = (20, 20, 300);
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let normal = Normal::new(0.0, 1.0).unwrap();
    let mut covered = [0; 2];
    for _ in 0..repeats {
        let mut draw = |count: usize, sd: f64| -> Vec<f64> { (0..count).map(|_| sd * normal.sample(&mut random)).collect() };
        let (of_places, of_instants, own) = (draw(places, 1.0), draw(instants, 0.7), draw(places * instants, 1.0));
        let value = |row: usize| of_places[row / instants] + of_instants[row % instants] + own[row];
        let (mean, sds) = gridded_mean((0..places * instants).map(value).collect(), instants);
        for (count, sd) in covered.iter_mut().zip(sds) {
            *count += usize::from(mean.abs() <= NORMAL_QUANTILE_95 * sd);
        }
    }
    // Of 300: 285 in the mean; four standard errors of the count are 15, and few clusters promise a little too much.
    assert!(covered[0] >= 265, "{covered:?}");
    assert!(covered[1] <= 200, "{covered:?}");
}
