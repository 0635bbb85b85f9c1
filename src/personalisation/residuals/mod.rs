//! What is compared: volume and pressure curves, boundary distances and depolarisation times over their standard deviations, the prior, and how outliers are weighed.

mod activation;
mod boundary;
mod loss;
mod pressure;
mod trajectory;
mod volume;

pub use activation::ActivationResidual;
pub use boundary::{BoundaryResidual, GroupDistances, SurfaceTarget};
pub use loss::Loss;
pub use pressure::PressureResidual;
pub use trajectory::{CalibrationFrame, CalibrationTrajectory};
pub use volume::VolumeCurveResidual;

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::{Cluster, PersonalisationError, Residual};

/// Several residuals one under the other.
pub struct StackedResidual<'a, T> {
    parts: Vec<(&'static str, Box<dyn Residual<T> + 'a>)>,
}

impl<T> Default for StackedResidual<'_, T> {
    fn default() -> Self {
        Self { parts: Vec::new() }
    }
}

impl<'a, T> StackedResidual<'a, T> {
    /// Adds a named part below the others.
    #[must_use]
    pub fn with(mut self, name: &'static str, part: impl Residual<T> + 'a) -> Self {
        self.parts.push((name, Box::new(part)));
        self
    }

    /// Name and rows of every part.
    pub fn parts(&self) -> Vec<(&'static str, Range<usize>)> {
        let mut start = 0;
        let mut range = |count: usize| {
            start += count;
            start - count..start
        };
        self.parts.iter().map(|(name, part)| (*name, range(part.row_count()))).collect()
    }

    /// Root mean square of the rows of every part, by name (1 means: as good as the stated standard deviations).
    ///
    /// # Errors
    /// [`PersonalisationError::Shape`] if `rows` has another length than this residual.
    pub fn rms_by_part(&self, rows: &DVector<f64>) -> Result<Vec<(&'static str, f64)>, PersonalisationError> {
        let expected = self.row_count();
        if rows.len() != expected {
            return Err(PersonalisationError::Shape { what: "residual rows", found: rows.len(), expected });
        }
        let rms = |range: Range<usize>| crate::numerics::root_mean_square(&rows.as_slice()[range]);
        Ok(self.parts().into_iter().map(|(name, range)| (name, rms(range))).collect())
    }

    /// Calls `visit` with every part and its own rows.
    fn split<R>(&self, rows: &mut [R], visit: impl Fn(&dyn Residual<T>, &mut [R])) {
        let mut rest = rows;
        for (_, part) in &self.parts {
            let (own, below) = rest.split_at_mut(part.row_count());
            visit(part.as_ref(), own);
            rest = below;
        }
    }
}

impl<T> Residual<T> for StackedResidual<'_, T> {
    fn row_count(&self) -> usize {
        self.parts.iter().map(|(_, part)| part.row_count()).sum()
    }

    fn evaluate(&self, trajectory: &T, rows: &mut [f64]) {
        self.split(rows, |part, own| part.evaluate(trajectory, own));
    }

    fn apply_tangent(&self, trajectory: &T, tangent: &T, rows: &mut [f64]) {
        self.split(rows, |part, own| part.apply_tangent(trajectory, tangent, own));
    }

    fn write_losses(&self, losses: &mut [Loss]) {
        self.split(losses, |part, own| part.write_losses(own));
    }

    /// Parts share instants, but no places.
    fn write_clusters(&self, clusters: &mut [Cluster]) {
        self.split(clusters, |part, own| part.write_clusters(own));
        let mut first_place = 0;
        for (_, rows) in self.parts() {
            let own = &mut clusters[rows];
            own.iter_mut().for_each(|cluster| cluster.place += first_place);
            first_place = own.iter().map(|cluster| cluster.place + 1).max().unwrap_or(first_place);
        }
    }
}

/// Two coordinates that are expected to be alike, as those of neighbouring segments: the difference is zero to within `sd`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tie {
    /// A coordinate.
    pub first: usize,
    /// Another one.
    pub second: usize,
    /// Standard deviation of their difference.
    pub sd: f64,
}

/// (θ − μ)/s, then (θ_a − θ_b)/s_ab: what is known of the parameters before the data; coordinates with infinite s pull nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct PriorResidual {
    mean: DVector<f64>,
    sd: DVector<f64>,
    ties: Vec<Tie>,
}

impl PriorResidual {
    /// A prior with mean μ and standard deviation s, both p, in coordinates.
    ///
    /// # Errors
    /// [`PersonalisationError`] if sizes differ, a mean is not finite or a standard deviation not positive.
    pub fn new(mean: DVector<f64>, sd: DVector<f64>) -> Result<Self, PersonalisationError> {
        if mean.len() != sd.len() {
            return Err(PersonalisationError::Shape { what: "prior standard deviations", found: sd.len(), expected: mean.len() });
        }
        if let Some(&value) = sd.iter().find(|&&sd| sd.is_nan() || sd <= 0.0) {
            let remedy = "must be positive (infinite for none)";
            return Err(PersonalisationError::Setting { what: "prior standard deviation", value, remedy });
        }
        if let Some(&value) = mean.iter().find(|mean| !mean.is_finite()) {
            return Err(PersonalisationError::Setting { what: "prior mean", value, remedy: "must be finite" });
        }
        Ok(Self { mean, sd, ties: Vec::new() })
    }

    /// No prior on p coordinates.
    pub fn none(dimension: usize) -> Self {
        Self { mean: DVector::zeros(dimension), sd: DVector::from_element(dimension, f64::INFINITY), ties: Vec::new() }
    }

    /// The same with coordinates tied to each other.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] if a standard deviation is not positive, [`PersonalisationError::Shape`] for a coordinate that
    /// is none.
    pub fn with_ties(mut self, ties: Vec<Tie>) -> Result<Self, PersonalisationError> {
        for tie in &ties {
            let (expected, found) = (self.mean.len(), tie.first.max(tie.second));
            if found >= expected {
                return Err(PersonalisationError::Shape {
                    what: "coordinates, for a tie between them",
                    found: expected,
                    expected: found + 1,
                });
            }
            if tie.sd.is_nan() || tie.sd <= 0.0 {
                let remedy = "must be positive (infinite for none)";
                return Err(PersonalisationError::Setting { what: "standard deviation between neighbours", value: tie.sd, remedy });
            }
        }
        self.ties = ties;
        Ok(self)
    }

    /// Rows at `coordinates`, one a coordinate (zero where there is no prior) and one a tie.
    pub fn evaluate(&self, coordinates: &DVector<f64>) -> DVector<f64> {
        let own = (coordinates - &self.mean).component_div(&self.sd);
        let tied = self.ties.iter().map(|tie| (coordinates[tie.first] - coordinates[tie.second]) / tie.sd);
        DVector::from_iterator(own.len() + self.ties.len(), own.iter().copied().chain(tied))
    }

    /// The Hessian of half the squared rows.
    pub fn precision(&self) -> DMatrix<f64> {
        let mut precision = DMatrix::from_diagonal(&self.sd.map(|sd| 1.0 / (sd * sd)));
        for tie in &self.ties {
            let weight = 1.0 / (tie.sd * tie.sd);
            for (row, column, sign) in
                [(tie.first, tie.first, 1.0), (tie.second, tie.second, 1.0), (tie.first, tie.second, -1.0), (tie.second, tie.first, -1.0)]
            {
                precision[(row, column)] += sign * weight;
            }
        }
        precision
    }

    /// Standard deviations s.
    pub fn sd(&self) -> &DVector<f64> {
        &self.sd
    }

    /// Means μ.
    pub fn mean(&self) -> &DVector<f64> {
        &self.mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of a plain vector, scaled.
    struct Scaled(f64, usize, Loss);

    impl Residual<Vec<f64>> for Scaled {
        fn row_count(&self) -> usize {
            self.1
        }
        fn evaluate(&self, trajectory: &Vec<f64>, rows: &mut [f64]) {
            for (row, value) in rows.iter_mut().zip(trajectory) {
                *row = self.0 * value;
            }
        }
        fn apply_tangent(&self, _: &Vec<f64>, tangent: &Vec<f64>, rows: &mut [f64]) {
            self.evaluate(tangent, rows);
        }
        fn write_losses(&self, losses: &mut [Loss]) {
            losses.fill(self.2);
        }
    }

    #[test]
    fn stacked_parts_keep_their_rows_losses_and_names() {
        let huber = Loss::Huber { threshold: 1.5 };
        let stack = StackedResidual::default().with("first", Scaled(1.0, 2, Loss::Squares)).with("second", Scaled(-2.0, 1, huber));
        let mut rows = [0.0; 3];
        stack.evaluate(&vec![3.0, 4.0], &mut rows);
        assert_eq!(rows, [3.0, 4.0, -6.0]);
        let mut losses = [Loss::Squares; 3];
        stack.write_losses(&mut losses);
        assert_eq!(losses, [Loss::Squares, Loss::Squares, huber]);
        let rms = stack.rms_by_part(&DVector::from_column_slice(&rows)).unwrap();
        assert_eq!(rms, [("first", 12.5_f64.sqrt()), ("second", 6.0)]);
        assert!(stack.rms_by_part(&DVector::zeros(2)).is_err());
    }

    #[test]
    fn a_prior_without_standard_deviation_pulls_nothing() {
        let prior = PriorResidual::new(DVector::from_vec(vec![1.0, 5.0]), DVector::from_vec(vec![0.5, f64::INFINITY])).unwrap();
        assert_eq!(prior.evaluate(&DVector::from_vec(vec![2.0, 9.0])).as_slice(), [2.0, 0.0]);
        assert_eq!(prior.precision().as_slice(), [4.0, 0.0, 0.0, 0.0]);
        assert!(PriorResidual::new(DVector::zeros(1), DVector::zeros(1)).is_err());
    }

    /// ½ ‖rows‖² is the quadratic form of the precision about the means: ties pull on differences alone.
    #[test]
    fn ties_add_their_own_rows_and_curvature() {
        let sd = DVector::from_vec(vec![0.5, f64::INFINITY, f64::INFINITY]);
        let ties = vec![Tie { first: 0, second: 1, sd: 0.2 }, Tie { first: 1, second: 2, sd: 0.1 }];
        let prior = PriorResidual::new(DVector::zeros(3), sd).unwrap().with_ties(ties).unwrap();
        let theta = DVector::from_vec(vec![0.3, -0.1, 0.2]);
        assert_eq!(prior.evaluate(&theta).len(), 5);
        assert!((prior.evaluate(&theta).norm_squared() - (theta.transpose() * prior.precision() * &theta)[(0, 0)]).abs() < 1e-12);
        let uniform = DVector::from_element(3, 0.7);
        assert!((prior.evaluate(&uniform).norm() - 1.4).abs() < 1e-12, "what is alike costs nothing");
        let bad = |tie| PriorResidual::none(2).with_ties(vec![tie]).is_err();
        assert!(bad(Tie { first: 0, second: 2, sd: 1.0 }) && bad(Tie { first: 0, second: 1, sd: 0.0 }));
    }
}
