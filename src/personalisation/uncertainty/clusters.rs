//! The covariance of an estimate whose rows err together, \[Huber1967\], \[White1980\], in clusters that cross, \[Cameron2011\].
//!
//! $$ C = A^{-1} B A^{-1}, \quad A = J^\top W J + S^{-2}, \quad
//! B = \sum_{c} \tfrac{n_c}{n_c - 1} \, (\pm) \sum_{g \in c} s_g s_g^\top + S^{-2}, \quad s_g = \sum_{i \in g} J_i w_i r_i $$
//!
//! What a model cannot do, a tracking that lags, or a base that was cut too high make rows err alike: those of one segment through the beat, those of all
//! segments at one instant. Residuals that count as so many independent ones promise too much. Their scores are therefore added up within a place and within
//! an instant before they are squared; what both count is taken off once.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::personalisation::Cluster;

/// Σ over places, plus over instants, less over the rows within both; never indefinite.
///
/// `scores` has a row a data row: its part of the gradient.
pub(super) fn score_covariance(scores: &DMatrix<f64>, clusters: &[Cluster]) -> DMatrix<f64> {
    let by = |key: &dyn Fn(&Cluster) -> (u32, u32)| summed_squares(scores, clusters.iter().map(key));
    let crossed = by(&|cluster| (cluster.place, 0)) + by(&|cluster| (0, cluster.instant)) - by(&|cluster| (cluster.place, cluster.instant));
    if crossed.is_empty() {
        return crossed;
    }
    let mut eigen = crossed.symmetric_eigen();
    eigen.eigenvalues.iter_mut().for_each(|value| *value = value.max(0.0));
    eigen.recompose()
}

/// n/(n − 1) Σ_g s_g s_gᵀ of n clusters; zero of one alone, whose scores add up to nothing.
fn summed_squares(scores: &DMatrix<f64>, keys: impl Iterator<Item = (u32, u32)>) -> DMatrix<f64> {
    let size = scores.ncols();
    let mut sums: BTreeMap<(u32, u32), DVector<f64>> = BTreeMap::new();
    for (row, key) in keys.enumerate() {
        let sum = sums.entry(key).or_insert_with(|| DVector::zeros(size));
        *sum += scores.row(row).transpose();
    }
    let count = sums.len() as f64;
    if sums.len() < 2 {
        return DMatrix::zeros(size, size);
    }
    sums.values().fold(DMatrix::zeros(size, size), |total, sum| total + sum * sum.transpose()) * (count / (count - 1.0))
}

/// The covariance with every standard deviation at least that of another one.
pub(super) fn at_least(covariance: DMatrix<f64>, floor: &DMatrix<f64>) -> DMatrix<f64> {
    let factor = |n: usize| {
        let (own, least) = (covariance[(n, n)], floor[(n, n)]);
        if own > 0.0 { (least / own).sqrt().max(1.0) } else { 1.0 }
    };
    let factors: Vec<f64> = (0..covariance.nrows()).map(factor).collect();
    DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |row, column| match covariance[(row, row)] > 0.0 || row != column {
        true => covariance[(row, column)] * factors[row] * factors[column],
        false => floor[(row, row)],
    })
}
