//! How well the data determine the parameters: covariance, intervals, correlations, singular spectrum, and a verdict in words.
//!
//! $$ C = \Big(\tfrac{1}{s^2} J^\top W J + S^{-2}\Big)^{-1} $$
//!
//! on the coordinates that no bound holds. The singular values of W^{1/2} J S/s say, direction by direction, how much more (> 1) or less
//! (< 1) the data know than the prior.

mod clusters;
mod estimate;

pub use estimate::{BoundState, ParameterEstimate, estimates};

use nalgebra::{DMatrix, DVector};

use super::problem::Linearisation;
use super::{CalibrationProblem, PersonalisationError, TangentModel};

/// Correlation beyond which two parameters are not told apart.
const INSEPARABLE: f64 = 0.95;
/// Posterior over prior standard deviation beyond which the data say nothing of a parameter.
const UNINFORMED: f64 = 0.9;
/// Eigenvalues below this part of the largest are none.
const NULL: f64 = 1e-13;

/// Where the size of the noise comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoiseScale {
    /// The standard deviations stated with the residuals are true: s = 1.
    AsStated,
    /// s² = Σ w r²/(n − p): the residuals that remain tell the noise (and the model's discrepancy), never less than stated.
    FromResiduals,
    /// The residuals that remain tell the noise and the model's discrepancy, which make the rows of a place and those of an instant err together
    /// ([`super::Cluster`]); never less than [`NoiseScale::FromResiduals`] says.
    FromClusters,
    /// s is known, and the problem's prior is in units of the stated noise: the whole objective is over s², see [`super::Evidence`].
    OfObjective(f64),
}

/// The posterior around a minimum, in coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Coordinates that no bound holds, ascending; the others have no standard deviation.
    pub free: Vec<usize>,
    /// Covariance of the free coordinates; infinite variances are left out of it as zero rows.
    pub covariance: DMatrix<f64>,
    /// Standard deviation a coordinate: `None` where a bound holds it, infinite where neither data nor prior say anything.
    pub sd: Vec<Option<f64>>,
    /// Correlation matrix of the free coordinates.
    pub correlations: DMatrix<f64>,
    /// s.
    pub noise_scale: f64,
    /// Singular values of W^{1/2} J S/s on the free coordinates, descending.
    pub singular_values: Vec<f64>,
    /// Right singular vectors, one a column, in scaled free coordinates.
    pub directions: DMatrix<f64>,
    prior_sd: DVector<f64>,
}

impl Uncertainty {
    /// The posterior of `problem` at `at`. Coordinates on a bound of the box are taken as held by it if the objective pushes them outward.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] if the noise is to be told by residuals that are not more than the parameters.
    pub fn new<M: TangentModel>(
        problem: &CalibrationProblem<'_, M>,
        at: &Linearisation,
        noise: NoiseScale,
    ) -> Result<Self, PersonalisationError> {
        let weights = at.weights(&at.rows);
        let (_, gradient) = at.quadratic_model(&weights);
        let held = |index: usize| {
            let (lower, upper) = (problem.lower()[index], problem.upper()[index]);
            let theta = at.coordinates[index];
            lower == upper || (theta <= lower && gradient[index] > 0.0) || (theta >= upper && gradient[index] < 0.0)
        };
        let free: Vec<usize> = (0..problem.dimension()).filter(|&index| !held(index)).collect();
        let noise_scale = match noise {
            NoiseScale::AsStated => 1.0,
            NoiseScale::FromResiduals | NoiseScale::FromClusters => residual_scale(at, &weights, free.len())?,
            NoiseScale::OfObjective(scale) => scale,
        };
        let prior_scale = if matches!(noise, NoiseScale::OfObjective(_)) { noise_scale } else { 1.0 };
        let all_scales = problem.scales();
        let scales = DVector::from_iterator(free.len(), free.iter().map(|&index| all_scales[index]));
        let whitened = DMatrix::from_fn(at.rows.len(), free.len(), |row, column| {
            weights[row].sqrt() * at.jacobian[(row, free[column])] * scales[column] / noise_scale
        });
        let precision = problem.prior().precision() / prior_scale.powi(2);
        let mut information = whitened.tr_mul(&whitened);
        for (column, &index) in free.iter().enumerate() {
            for (row, &other) in free.iter().enumerate() {
                information[(row, column)] += precision[(other, index)] * scales[row] * scales[column];
            }
        }
        let (mut scaled_covariance, undetermined) = inverse(information);
        if noise == NoiseScale::FromClusters {
            // Whitened rows are over s, and so is A: A⁻¹ s_g keeps one factor s of it.
            let mut scores = whitened.clone();
            for (row, mut score) in scores.row_iter_mut().enumerate() {
                score *= weights[row].sqrt() * at.rows[row] / noise_scale;
            }
            let meat = clusters::score_covariance(&scores, &problem.clusters());
            let own =
                DMatrix::from_fn(free.len(), free.len(), |row, column| precision[(free[row], free[column])] * scales[row] * scales[column]);
            let sandwich = &scaled_covariance * (meat + own) * &scaled_covariance;
            scaled_covariance = clusters::at_least(sandwich, &scaled_covariance);
        }
        let covariance =
            DMatrix::from_fn(free.len(), free.len(), |row, column| scaled_covariance[(row, column)] * scales[row] * scales[column]);
        let mut sd = vec![None; problem.dimension()];
        for (column, &index) in free.iter().enumerate() {
            sd[index] = Some(if undetermined[column] { f64::INFINITY } else { covariance[(column, column)].sqrt() });
        }
        let deviation = |column: usize| covariance[(column, column)].sqrt().max(f64::MIN_POSITIVE);
        let correlations = DMatrix::from_fn(free.len(), free.len(), |row, column| {
            if row == column { 1.0 } else { covariance[(row, column)] / (deviation(row) * deviation(column)) }
        });
        let (singular_values, directions) = spectrum(&whitened);
        let prior_sd = problem.prior().sd() * prior_scale;
        Ok(Self { free, covariance, sd, correlations, noise_scale, singular_values, directions, prior_sd })
    }

    /// Number of directions that the data know better than the prior.
    pub fn informed_directions(&self) -> usize {
        self.singular_values.iter().filter(|&&value| value > 1.0).count()
    }

    /// What the numbers mean, a sentence a finding; `names` has one entry a coordinate.
    pub fn verdict(&self, names: &[String]) -> Vec<String> {
        let mut sentences = Vec::new();
        for (index, sd) in self.sd.iter().enumerate() {
            let (name, prior_sd) = (&names[index], self.prior_sd[index]);
            match sd {
                None => {
                    sentences.push(format!("{name} is held by its bound: the data ask for a value beyond it, and no interval is given."))
                }
                Some(sd) if sd.is_infinite() => {
                    sentences.push(format!("{name} is not determined: neither the data nor a prior say anything of it."));
                }
                Some(sd) if *sd > UNINFORMED * prior_sd => {
                    sentences.push(format!("{name} is not determined by this data: its interval is that of the prior."));
                }
                Some(_) => {}
            }
        }
        for row in 0..self.free.len() {
            for column in row + 1..self.free.len() {
                let correlation = self.correlations[(row, column)];
                if correlation.abs() > INSEPARABLE {
                    let (first, second) = (&names[self.free[row]], &names[self.free[column]]);
                    let kept = if correlation > 0.0 { "ratio" } else { "product" };
                    sentences.push(format!(
                        "{first} and {second} cannot be told apart on this data (correlation {correlation:.2}): only about their {kept} is known."
                    ));
                }
            }
        }
        if sentences.is_empty() {
            sentences.push(format!("All {} parameters are told apart by this data.", self.free.len()));
        }
        sentences
    }
}

/// √(Σ w r²/(n − p)), at least 1.
fn residual_scale(at: &Linearisation, weights: &DVector<f64>, parameter_count: usize) -> Result<f64, PersonalisationError> {
    let row_count = at.rows.len();
    if row_count <= parameter_count {
        let remedy = "the noise cannot be told from residuals that are not more than the parameters; state it instead";
        return Err(PersonalisationError::Setting { what: "residual rows", value: row_count as f64, remedy });
    }
    let sum: f64 = at.rows.iter().zip(weights).map(|(row, weight)| weight * row * row).sum();
    Ok((sum / (row_count - parameter_count) as f64).sqrt().max(1.0))
}

/// Inverse on the range, and which coordinates have a part in the null space.
fn inverse(information: DMatrix<f64>) -> (DMatrix<f64>, Vec<bool>) {
    let size = information.nrows();
    let mut covariance = DMatrix::zeros(size, size);
    let mut undetermined = vec![false; size];
    if size == 0 {
        return (covariance, undetermined);
    }
    let eigen = information.symmetric_eigen();
    let smallest = NULL * eigen.eigenvalues.amax();
    for (index, &value) in eigen.eigenvalues.iter().enumerate() {
        let vector = eigen.eigenvectors.column(index);
        if value > smallest {
            covariance += vector * vector.transpose() / value;
        } else {
            for (flag, entry) in undetermined.iter_mut().zip(vector.iter()) {
                *flag |= entry.abs() > 1e-6;
            }
        }
    }
    (covariance, undetermined)
}

/// Singular values, descending, and right singular vectors (through the Gram matrix, whose size is the parameters').
fn spectrum(whitened: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let size = whitened.ncols();
    if size == 0 {
        return (Vec::new(), DMatrix::zeros(0, 0));
    }
    let eigen = whitened.tr_mul(whitened).symmetric_eigen();
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let values = order.iter().map(|&index| eigen.eigenvalues[index].max(0.0).sqrt()).collect();
    let columns: Vec<_> = order.iter().map(|&index| eigen.eigenvectors.column(index)).collect();
    (values, DMatrix::from_columns(&columns))
}

#[cfg(test)]
mod tests;
