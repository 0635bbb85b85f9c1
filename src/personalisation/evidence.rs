//! How large the noise is and how alike neighbours are, told by the data: the evidence of both, \[MacKay1992\].
//!
//! With H = JᵀWJ of the data as stated, P of the prior and T of the ties as written, the noise s and the ties' factor t have the posterior
//!
//! $$ A = \frac{H}{s^2} + P + \frac{T}{t^2}, \qquad C = A^{-1}, $$
//!
//! and the evidence of the linearised problem grows with every step of expectation and maximisation
//!
//! $$ s^2 \leftarrow \frac{\sum w r^2 + \operatorname{tr} CH}{n}, \qquad t^2 \leftarrow \frac{\theta^\top T \theta + \operatorname{tr} CT}{\operatorname{rank} T}. $$
//!
//! So ties are as strong as the differences that the data show, and data that fit better than stated are trusted more.

use nalgebra::{Cholesky, DMatrix};

use super::{Linearisation, ParameterSpace, PersonalisationError, PriorResidual};

/// Steps after which the evidence is taken for settled, and the relative change at which it is.
const STEP_LIMIT: usize = 5000;
const SETTLED: f64 = 1e-6;
/// Least noise and least difference, of what is stated.
const LEAST: f64 = 1e-3;

/// The strengths of data and ties, relative to what the study states.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Evidence {
    /// s: factor on all standard deviations of the data.
    pub noise_scale: f64,
    /// t: factor on the standard deviations between neighbours.
    pub neighbour_scale: f64,
}

impl Evidence {
    /// As the study states.
    pub const STATED: Self = Self { noise_scale: 1.0, neighbour_scale: 1.0 };

    /// The strengths that the data have most evidence for around `at`, a minimum of a problem in `space`; from `self`.
    ///
    /// # Errors
    /// [`PersonalisationError`] for a prior that is none.
    pub fn improved(self, at: &Linearisation, space: &ParameterSpace) -> Result<Self, PersonalisationError> {
        let own = PriorResidual::new(space.prior_mean(), space.prior_sd())?;
        let prior = own.precision();
        let tied = own.clone().with_ties(space.ties().to_vec())?.precision() - &prior;
        let rank = rank(&tied);
        if rank == 0 {
            return Ok(self);
        }
        let weights = at.weights(&at.rows);
        let mut weighted = at.jacobian.clone();
        weighted.row_iter_mut().zip(&weights).for_each(|(mut row, &weight)| row *= weight);
        let data = at.jacobian.tr_mul(&weighted);
        let (pull, square) = (weighted.tr_mul(&at.rows), at.rows.component_mul(&weights).dot(&at.rows));
        let (row_count, start) = (at.rows.len() as f64, &at.coordinates);
        let (mut noise, mut tie) = (self.noise_scale.powi(2), self.neighbour_scale.powi(2));
        for _ in 0..STEP_LIMIT {
            let Some(factor) = Cholesky::new(&data / noise + &prior + &tied / tie) else { break };
            let gradient = &pull / noise + &prior * (start - own.mean()) + &tied * start / tie;
            let step = -factor.solve(&gradient);
            let covariance = factor.inverse();
            let there = start + &step;
            let residual = square + 2.0 * pull.dot(&step) + (&data * &step).dot(&step);
            let better = |sum: f64, count: f64| (sum / count).max(LEAST * LEAST);
            let next = (
                better(residual.max(0.0) + trace_of_product(&covariance, &data), row_count),
                better((&tied * &there).dot(&there) + trace_of_product(&covariance, &tied), rank as f64),
            );
            let change = (next.0 / noise).ln().abs().max((next.1 / tie).ln().abs());
            (noise, tie) = next;
            if change < SETTLED {
                break;
            }
        }
        Ok(Self { noise_scale: noise.sqrt(), neighbour_scale: tie.sqrt() })
    }

    /// The space whose problem has the same minimum in units of the stated noise: s² (P + T/t²) in place of P + T.
    #[must_use]
    pub fn applied_to(self, space: &ParameterSpace) -> ParameterSpace {
        space.with_prior_scaled(1.0 / self.noise_scale, self.neighbour_scale / self.noise_scale)
    }
}

fn trace_of_product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    a.component_mul(&b.transpose()).sum()
}

fn rank(matrix: &DMatrix<f64>) -> usize {
    let values = matrix.clone().symmetric_eigen().eigenvalues;
    values.iter().filter(|&&value| value > 1e-9 * values.amax()).count()
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::anatomy::AhaSegment;
    use crate::heart::{Parameter, Parameters, Part, RegionalParameter};
    use crate::personalisation::{FreeParameter, Loss};

    /// All segments free, tied by 0.5 of the logarithm, no prior of their own.
    fn space() -> ParameterSpace {
        let entry = |number| {
            let regional = RegionalParameter::new(Parameter::ContractionPeakLv, Part::Segment(AhaSegment::new(number)?))?;
            let entry = FreeParameter::new(regional).between(1.0, 900.0);
            Some(entry.starting_at(100.0).with_prior(100.0, f64::INFINITY))
        };
        ParameterSpace::new(Parameters::default(), (1..=17).filter_map(entry).collect())
            .unwrap()
            .with_alike_segments(Parameter::ContractionPeakLv, 0.5)
    }

    /// Every segment seen forty times with a standard deviation of `noise`, stated as 1, from `start`.
    fn seen(truth: &DVector<f64>, noise: f64, start: &DVector<f64>) -> Linearisation {
        const TIMES: usize = 40;
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let normal = Normal::new(0.0, 1.0).unwrap();
        let count = truth.len() * TIMES;
        let rows = DVector::from_fn(count, |row, _| start[row / TIMES] - truth[row / TIMES] - noise * normal.sample(&mut rng));
        let jacobian = DMatrix::from_fn(count, truth.len(), |row, column| f64::from(u8::from(row / TIMES == column)));
        let prior = PriorResidual::none(truth.len());
        Linearisation { coordinates: start.clone(), rows, jacobian, losses: vec![Loss::Squares; count], prior }
    }

    /// Noise and differences between neighbours come back from data made with them, whatever was stated: nearly exactly where the noise of a
    /// segment's mean is far below the differences, else to two standard errors of 16 differences, 2/√32 of the logarithm.
    #[test]
    fn noise_and_ties_are_told_by_data_that_have_them() {
        let space = space();
        let start = space.initial();
        for (noise, rough, tolerance) in [(0.1, 0.4, 0.05), (2.0, 1.0, 0.35), (0.02, 0.1, 0.05)] {
            let truth = DVector::from_fn(17, |segment, _| start[segment] + rough * (1.9 * segment as f64).sin());
            let found = Evidence::STATED.improved(&seen(&truth, noise, &start), &space).unwrap();
            assert!((found.noise_scale / noise).ln().abs() < 0.1, "{found:?} for noise {noise}");
            let ties = space.ties();
            let square = ties.iter().map(|tie| ((truth[tie.first] - truth[tie.second]) / tie.sd).powi(2)).sum::<f64>();
            let expected = (square / 16.0).sqrt();
            assert!((found.neighbour_scale / expected).ln().abs() < tolerance, "{found:?}, expected {expected}");
        }
    }

    /// What the ties were for: one weak segment is shrunk towards its neighbours by ties as stated, and left where data of small noise say.
    #[test]
    fn a_scar_is_not_smoothed_away_where_the_data_are_good() {
        let space = space();
        let start = space.initial();
        let mut truth = start.clone();
        truth[9] -= 1.1;
        let at = seen(&truth, 0.01, &start);
        let minimum = |evidence: Evidence| {
            let space = evidence.applied_to(&space);
            let prior = PriorResidual::new(space.prior_mean(), space.prior_sd()).unwrap().with_ties(space.ties().to_vec()).unwrap();
            let (hessian, gradient) = Linearisation { prior, ..at.clone() }.quadratic_model(&DVector::from_element(at.rows.len(), 1.0));
            &start - hessian.lu().solve(&gradient).unwrap()
        };
        let stated = (minimum(Evidence::STATED) - &truth)[9];
        let told = (minimum(Evidence::STATED.improved(&at, &space).unwrap()) - &truth)[9];
        assert!(stated > 0.05 && told.abs() < 0.01, "{stated} {told}");
    }
}
