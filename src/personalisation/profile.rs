//! Profile likelihood on demand: how the best cost grows as one parameter is held away from its best value.
//!
//! 2(cost(θ_i) − cost(θ̂)) is χ² with one degree of freedom: a rise by 1.92 marks the end of a 95 % interval that need not be symmetric,
//! and a profile that stays flat says that the data do not know the parameter, however small its linearised interval looks.

use nalgebra::DVector;

use super::{CalibrationOutcome, CalibrationProblem, GaussNewtonSettings, PersonalisationError, TangentModel, calibrate};

/// Half the 95 % quantile of χ² with one degree of freedom.
pub const RISE_95: f64 = 1.920_729_410_347_062;

/// The best cost with one coordinate held.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfilePoint {
    /// Where the coordinate is held.
    pub coordinate: f64,
    /// Best cost there.
    pub cost: f64,
    /// The other coordinates at that best.
    pub coordinates: DVector<f64>,
    /// How its search ended.
    pub outcome: CalibrationOutcome,
}

/// Holds coordinate `index` at every entry of `held` in turn and seeks the others, each search starting where the last one ended; `best` is
/// where the first one starts. Give `held` in an order that moves away from the best value.
///
/// # Errors
/// [`PersonalisationError`] as [`calibrate`]; points at which the start of a search cannot be simulated are left out.
pub fn profile<M: TangentModel>(
    problem: &CalibrationProblem<'_, M>,
    best: &DVector<f64>,
    index: usize,
    held: &[f64],
    settings: GaussNewtonSettings,
) -> Result<Vec<ProfilePoint>, PersonalisationError> {
    if index >= problem.dimension() {
        return Err(PersonalisationError::Shape { what: "profiled coordinate", found: index, expected: problem.dimension() });
    }
    let mut start = best.clone();
    let mut points = Vec::with_capacity(held.len());
    for &coordinate in held {
        let own = problem.with_fixed(index, coordinate);
        match calibrate(&own, &start, settings, &mut |_| ()) {
            Ok(found) => {
                start = found.coordinates.clone();
                let (coordinate, cost) = (found.coordinates[index], found.evaluation.cost());
                points.push(ProfilePoint { coordinate, cost, coordinates: found.coordinates, outcome: found.outcome });
            }
            Err(PersonalisationError::Simulation { .. } | PersonalisationError::NonFiniteResidual { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(points)
}

/// Where a profile first rises by [`RISE_95`] above `best_cost`, walking along `points` from `best_coordinate` outward, by linear
/// interpolation in √rise (exact for a parabola); `None` if it never does.
pub fn crossing_95(best_coordinate: f64, best_cost: f64, points: &[ProfilePoint]) -> Option<f64> {
    let depth = |cost: f64| (cost - best_cost).max(0.0).sqrt();
    let mut previous = (best_coordinate, 0.0);
    for point in points {
        let here = (point.coordinate, depth(point.cost));
        if here.1 >= RISE_95.sqrt() {
            let fraction = (RISE_95.sqrt() - previous.1) / (here.1 - previous.1);
            return Some(previous.0 + fraction * (here.0 - previous.0));
        }
        previous = here;
    }
    None
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::numerics::NORMAL_QUANTILE_95;
    use crate::personalisation::{DifferenceScheme, FiniteDifferenceModel, Loss, NoiseScale, PriorResidual, Residual, Uncertainty};

    struct Rows;

    impl Residual<DVector<f64>> for Rows {
        fn row_count(&self) -> usize {
            3
        }
        fn evaluate(&self, trajectory: &DVector<f64>, rows: &mut [f64]) {
            rows.copy_from_slice(trajectory.as_slice());
        }
        fn apply_tangent(&self, _: &DVector<f64>, tangent: &DVector<f64>, rows: &mut [f64]) {
            rows.copy_from_slice(tangent.as_slice());
        }
        fn write_losses(&self, losses: &mut [Loss]) {
            losses.fill(Loss::Squares);
        }
    }

    /// For linear residuals the profile is a parabola and its interval is the linearised one, correlation included.
    #[test]
    fn profile_of_a_linear_problem_gives_the_linearised_interval() {
        let linear = |theta: &DVector<f64>| {
            Ok::<_, Infallible>(DVector::from_vec(vec![theta[0] + theta[1] - 1.0, theta[0] + 1.5 * theta[1], 0.3 * theta[0] + 0.5]))
        };
        let wide = DVector::from_element(2, 50.0);
        let model = FiniteDifferenceModel::new(linear, DifferenceScheme::Central, DVector::from_element(2, 1e-3), -&wide, wide.clone());
        let problem = CalibrationProblem::in_box(&model, &Rows, PriorResidual::none(2), -&wide, wide.clone()).unwrap();
        let settings = GaussNewtonSettings { step_tolerance: 1e-8, cost_tolerance: 0.0, ..GaussNewtonSettings::default() };
        let found = calibrate(&problem, &DVector::zeros(2), settings, &mut |_| ()).unwrap();
        let sd = Uncertainty::new(&problem, &found.linearisation.unwrap(), NoiseScale::AsStated).unwrap().sd[0].unwrap();
        let best = found.coordinates[0];
        let held: Vec<f64> = (1..=5).map(|k| best + 0.6 * f64::from(k) * sd).collect();
        let points = profile(&problem, &found.coordinates, 0, &held, settings).unwrap();
        let end = crossing_95(best, found.evaluation.cost(), &points).unwrap();
        assert!((end - best - NORMAL_QUANTILE_95 * sd).abs() < 1e-4 * sd, "{} {}", end - best, NORMAL_QUANTILE_95 * sd);
        assert!(crossing_95(best, found.evaluation.cost(), &points[..2]).is_none());
    }
}
