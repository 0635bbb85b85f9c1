//! Coordinates without bounds for solvers that know none: $\theta = m + h \sin(\varphi + a u)$ within a box, a straight line where there is none.

use nalgebra::DVector;

use crate::personalisation::{CalibrationProblem, TangentModel};

/// The farthest that a start counts from the middle of its box, in φ: on a bound itself the sine has no slope.
const FARTHEST_START: f64 = 1.3;
/// Longest step in φ that one unit of u makes.
const LONGEST_PHASE: f64 = 0.8;

/// One map a coordinate.
#[derive(Debug, Clone)]
pub(super) struct Chart {
    maps: Vec<Map>,
}

#[derive(Debug, Clone, Copy)]
enum Map {
    /// θ = start + slope u.
    Line { start: f64, slope: f64 },
    /// θ = middle + half sin(phase + rate u).
    Sine { middle: f64, half: f64, phase: f64, rate: f64 },
}

impl Chart {
    /// θ = u.
    pub(super) fn identity(dimension: usize) -> Self {
        Self { maps: vec![Map::Line { start: 0.0, slope: 1.0 }; dimension] }
    }

    /// u = 0 at `start` (a little inside the box if that is on a bound), and one unit of u the scale of the problem there.
    pub(super) fn around<M: TangentModel>(problem: &CalibrationProblem<'_, M>, start: &DVector<f64>) -> Self {
        let scales = problem.scales();
        let map = |index: usize| {
            let (lower, upper, scale) = (problem.lower()[index], problem.upper()[index], scales[index]);
            let (middle, half) = (0.5 * (lower + upper), 0.5 * (upper - lower));
            if !half.is_finite() {
                return Map::Line { start: start[index], slope: scale };
            }
            if half == 0.0 {
                return Map::Line { start: start[index], slope: 0.0 };
            }
            let phase = ((start[index] - middle) / half).clamp(-1.0, 1.0).asin().clamp(-FARTHEST_START, FARTHEST_START);
            Map::Sine { middle, half, phase, rate: (scale / (half * phase.cos())).min(LONGEST_PHASE) }
        };
        Self { maps: (0..start.len()).map(map).collect() }
    }

    /// θ of u.
    pub(super) fn to_theta(&self, free: &DVector<f64>) -> DVector<f64> {
        let value = |(map, &u): (&Map, &f64)| match *map {
            Map::Line { start, slope } => start + slope * u,
            Map::Sine { middle, half, phase, rate } => middle + half * (phase + rate * u).sin(),
        };
        DVector::from_iterator(free.len(), self.maps.iter().zip(free).map(value))
    }

    /// dθ/du.
    pub(super) fn slopes(&self, free: &DVector<f64>) -> DVector<f64> {
        let slope = |(map, &u): (&Map, &f64)| match *map {
            Map::Line { slope, .. } => slope,
            Map::Sine { half, phase, rate, .. } => half * rate * (phase + rate * u).cos(),
        };
        DVector::from_iterator(free.len(), self.maps.iter().zip(free).map(slope))
    }
}
