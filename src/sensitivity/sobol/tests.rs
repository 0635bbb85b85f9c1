//! Sobol' indices against functions whose shares of variance are known in closed form.

use std::f64::consts::PI;

use super::*;
use crate::sensitivity::Design;

/// Ishigami's function, a = 7, b = 0.1, \[Ishigami1990\].
fn ishigami(x: &[f64]) -> f64 {
    let angle = |place: f64| PI * (2.0 * place - 1.0);
    let (x1, x2, x3) = (angle(x[0]), angle(x[1]), angle(x[2]));
    x1.sin() + 7.0 * x2.sin().powi(2) + 0.1 * x3.powi(4) * x1.sin()
}

/// Its first-order, total and second-order shares.
fn ishigami_shares() -> Vec<(Measure, usize, Option<usize>, f64)> {
    let (a, b) = (7.0_f64, 0.1_f64);
    let v1 = 0.5 * (1.0 + b * PI.powi(4) / 5.0).powi(2);
    let v2 = a * a / 8.0;
    let v13 = b * b * PI.powi(8) * (1.0 / 18.0 - 1.0 / 50.0);
    let v = v1 + v2 + v13;
    let firsts = [v1, v2, 0.0].into_iter().enumerate().map(|(input, part)| (Measure::FirstOrder, input, None, part / v));
    let totals = [v1 + v13, v2, v13].into_iter().enumerate().map(|(input, part)| (Measure::Total, input, None, part / v));
    let pairs = [(0, 1, 0.0), (0, 2, v13), (1, 2, 0.0)].map(|(i, j, part)| (Measure::SecondOrder, i, Some(j), part / v));
    firsts.chain(totals).chain(pairs).collect()
}

const G_COEFFICIENTS: [f64; 6] = [0.0, 0.5, 3.0, 9.0, 99.0, 99.0];

/// Sobol's g-function, \[Saltelli2010\].
fn sobol_g(x: &[f64]) -> f64 {
    x.iter().zip(G_COEFFICIENTS).map(|(x, a)| ((4.0 * x - 2.0).abs() + a) / (1.0 + a)).product()
}

fn sobol_g_shares() -> Vec<(Measure, usize, Option<usize>, f64)> {
    let parts = G_COEFFICIENTS.map(|a| 1.0 / (3.0 * (1.0 + a).powi(2)));
    let product: f64 = parts.iter().map(|part| 1.0 + part).product();
    let of = |(input, part): (usize, f64)| {
        [
            (Measure::FirstOrder, input, None, part / (product - 1.0)),
            (Measure::Total, input, None, part * product / (1.0 + part) / (product - 1.0)),
        ]
    };
    parts.into_iter().enumerate().flat_map(of).collect()
}

fn indices(design: &SobolDesign, model: impl Fn(&[f64]) -> Option<f64>) -> Result<Vec<Index>, SensitivityError> {
    let response: Vec<_> = design.points().iter().map(|point| model(point)).collect();
    Design::Sobol(design.clone()).indices(&response)
}

/// Every index is close to its exact value, and its interval holds it; a bootstrap that takes no account of the sequence's balance is wide.
fn agrees(input_count: usize, pairs: bool, model: fn(&[f64]) -> f64, shares: &[(Measure, usize, Option<usize>, f64)], tolerance: f64) {
    for seed in 1..=3 {
        let design = SobolDesign::new(input_count, 4096, pairs, seed).unwrap();
        let found = indices(&design, |x| Some(model(x))).unwrap();
        assert_eq!(found.len(), shares.len());
        for &(measure, input, partner, exact) in shares {
            let index = found.iter().find(|one| (one.measure, one.input, one.partner) == (measure, input, partner)).unwrap();
            let (low, high) = index.interval.unwrap();
            // A share of exactly nothing has an interval of no width about it.
            assert!(low <= exact + 1e-4 && exact - 1e-4 <= high, "seed {seed}: {exact} is outside of {index:?}");
            assert!((index.value - exact).abs() < tolerance, "seed {seed}: {exact} {index:?}");
        }
    }
}

#[test]
fn indices_of_ishigami_hold_the_closed_form_in_their_intervals() {
    agrees(3, true, ishigami, &ishigami_shares(), 0.02);
}

#[test]
fn indices_of_the_g_function_hold_the_closed_form_in_their_intervals() {
    agrees(6, false, sobol_g, &sobol_g_shares(), 0.015);
}

/// The error of a low-discrepancy sequence falls faster than the 1/√n of random points: by more than 4 where n grows 16 times.
#[test]
fn the_sequence_converges_faster_than_random_points() {
    let error = |rows: usize| {
        let of = |seed| {
            let design = SobolDesign::new(3, rows, false, seed).unwrap();
            let found = indices(&design, |x| Some(ishigami(x))).unwrap();
            let exact = ishigami_shares()[3].3;
            (found.iter().find(|one| one.measure == Measure::Total && one.input == 0).unwrap().value - exact).powi(2)
        };
        (1..=6).map(of).sum::<f64>().sqrt()
    };
    let (coarse, fine) = (error(128), error(2048));
    assert!(coarse / fine > 4.0, "{coarse} {fine}");
}

#[test]
fn indices_do_not_depend_on_the_number_of_threads() {
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let design = SobolDesign::new(3, 64, true, 9).unwrap();
        pool.install(|| indices(&design, |x| Some(ishigami(x))).unwrap())
    };
    assert_eq!(with(1), with(4));
}

/// x₀ + x₁ has two equal shares; a tenth of the points missing at random leaves them, on fewer rows.
#[test]
fn gaps_are_left_out_and_counted() {
    let design = SobolDesign::new(2, 1024, false, 5).unwrap();
    let count = std::cell::Cell::new(0_u32);
    let sum = |x: &[f64]| {
        count.set(count.get() + 1);
        (!(count.get() * 7).is_multiple_of(10)).then_some(x[0] + x[1])
    };
    let found = indices(&design, sum).unwrap();
    for index in &found {
        assert!(index.sample_count < 900 && index.sample_count > 600, "{index:?}");
        assert!((index.value - 0.5).abs() < 0.05, "{index:?}");
    }
}

#[test]
fn designs_and_outputs_without_sense_are_told() {
    let design = SobolDesign::new(2, 64, false, 5).unwrap();
    assert_eq!(indices(&design, |_| Some(1.0)), Err(SensitivityError::Constant));
    assert_eq!(indices(&design, |x| (x[0] < 0.02).then_some(x[0])), Err(SensitivityError::FewRows { found: 0, expected: FEWEST_ROWS }));
    assert_eq!(Design::Sobol(design).indices(&[]), Err(SensitivityError::Shape { found: 0, expected: 256 }));
    assert!(SobolDesign::new(2, 100, false, 5).is_err() && SobolDesign::new(0, 64, false, 5).is_err());
    assert!(SobolDesign::new(200, 64, false, 5).is_err() && SobolDesign::new(2, 4, false, 5).is_err());
}
