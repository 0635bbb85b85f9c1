//! Local sensitivity: central differences about one point, in the parameters' own units and without them.
//!
//! $$ \frac{\partial y}{\partial x_i} \approx \frac{y(x + h e_i) - y(x - h e_i)}{2h},\qquad \frac{x_i}{y}\frac{\partial y}{\partial x_i} $$
//!
//! 2k + 1 evaluations for k inputs. The slopes to either side bracket the central one: where they differ, the tangent tells little.

use super::{Index, Measure, ScreeningInput, SensitivityError};

/// The base point, then for every input the point below and the point above.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalDesign {
    inputs: Vec<ScreeningInput>,
    points: Vec<Vec<f64>>,
}

impl LocalDesign {
    /// Differences of `step` (a share of each input's range) about the values `base`; shorter where the range ends.
    ///
    /// # Errors
    /// [`SensitivityError::Setting`] for no inputs, a step outside of (0, 0.5], or a value outside of its input's range.
    pub fn new(inputs: &[ScreeningInput], base: &[f64], step: f64) -> Result<Self, SensitivityError> {
        let refuse = |what, value, remedy| Err(SensitivityError::Setting { what, value, remedy });
        if inputs.is_empty() || inputs.len() != base.len() {
            return refuse("number of inputs", inputs.len() as f64, "must be at least one, each with its value");
        }
        if !(step > 0.0 && step <= 0.5) {
            return refuse("step", step, "must be a share of the range, above 0 and at most 0.5");
        }
        let mut centre = Vec::with_capacity(inputs.len());
        for (input, &value) in inputs.iter().zip(base) {
            match input.place(value) {
                Some(place) => centre.push(place),
                None => return refuse(input.parameter().parameter().spec().name, value, "the study's value must lie in the input's range"),
            }
        }
        let mut points = vec![centre.clone()];
        for input in 0..inputs.len() {
            for sign in [-1.0, 1.0] {
                let mut point = centre.clone();
                point[input] = (centre[input] + sign * step).clamp(0.0, 1.0);
                points.push(point);
            }
        }
        Ok(Self { inputs: inputs.to_vec(), points })
    }

    /// Where to evaluate, in the unit cube.
    pub fn points(&self) -> &[Vec<f64>] {
        &self.points
    }

    pub(super) fn indices(&self, values: &[f64]) -> Vec<Index> {
        let inputs = self.inputs.iter().enumerate();
        inputs
            .filter_map(|(number, input)| Some(self.read(number, input, &self.tangent(number, input, values)?, values[0])))
            .flatten()
            .collect()
    }

    fn tangent(&self, number: usize, input: &ScreeningInput, values: &[f64]) -> Option<Tangent> {
        let at = |point: usize| (input.value(self.points[point][number]), values[point]);
        let slope = |(x0, y0): (f64, f64), (x1, y1): (f64, f64)| Some((y1 - y0) / (x1 - x0)).filter(|slope| slope.is_finite());
        let (base, below, above) = (at(0), at(1 + 2 * number), at(2 + 2 * number));
        let sides = [slope(below, base), slope(base, above)];
        let either = sides[0].zip(sides[1]).map(|(a, b)| (a.min(b), a.max(b)));
        let slope = slope(below, above).or(sides[0]).or(sides[1])?;
        Some(Tangent { slope, either, count: sides.iter().flatten().count().max(1) })
    }

    fn read(&self, number: usize, input: &ScreeningInput, tangent: &Tangent, base: f64) -> Vec<Index> {
        let scaled = |measure, factor: f64| Index {
            measure,
            input: number,
            partner: None,
            value: tangent.slope * factor,
            interval: tangent.either.map(|(low, high)| (low * factor, high * factor)).map(|(a, b)| (a.min(b), a.max(b))),
            sample_count: tangent.count,
        };
        let elasticity = input.value(self.points[0][number]) / base;
        let mut indices = vec![scaled(Measure::Slope, 1.0), scaled(Measure::RangeEffect, input.value(1.0) - input.value(0.0))];
        indices.extend(elasticity.is_finite().then(|| scaled(Measure::Elasticity, elasticity)));
        indices
    }
}

/// How an output changes with one input, in their units.
struct Tangent {
    /// Central slope, or the one that is known.
    slope: f64,
    /// The slopes to either side, the lower one first.
    either: Option<(f64, f64)>,
    /// How many of these are known.
    count: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heart::Parameter;
    use crate::sensitivity::{Design, Spacing};

    const BASE: [f64; 2] = [120.0, 0.3];

    fn design(step: f64) -> Design {
        let peak = ScreeningInput::new(Parameter::ContractionPeakLv, 60.0, 240.0, Spacing::Logarithmic).unwrap();
        let duration = ScreeningInput::new(Parameter::ActionPotentialDuration, 0.2, 0.3, Spacing::Linear).unwrap();
        Design::Local(LocalDesign::new(&[peak, duration], &BASE, step).unwrap())
    }

    fn values(design: &Design, model: impl Fn(f64, f64) -> f64) -> Vec<Option<f64>> {
        let value = |place: &Vec<f64>| Some(model(60.0 * 4.0_f64.powf(place[0]), 0.2 + 0.1 * place[1]));
        design.points().iter().map(value).collect()
    }

    fn find(indices: &[Index], measure: Measure, input: usize) -> Index {
        *indices.iter().find(|index| index.measure == measure && index.input == input).unwrap()
    }

    /// y = x² z: slopes 2xz and x², elasticities 2 and 1, whatever the spacing; the second input stands at the end of its range.
    #[test]
    fn slopes_and_elasticities_of_a_monomial_are_its_exponents() {
        let design = design(1e-4);
        let indices = design.indices(&values(&design, |x, z| x * x * z)).unwrap();
        let expected = [
            (Measure::Slope, 0, 2.0 * 120.0 * 0.3),
            (Measure::Slope, 1, 120.0_f64.powi(2)),
            (Measure::Elasticity, 0, 2.0),
            (Measure::Elasticity, 1, 1.0),
            (Measure::RangeEffect, 0, 2.0 * 120.0 * 0.3 * 180.0),
        ];
        for (measure, input, truth) in expected {
            let found = find(&indices, measure, input);
            assert!((found.value / truth - 1.0).abs() < 1e-7, "{found:?} {truth}");
        }
        assert_eq!(find(&indices, Measure::Slope, 0).sample_count, 2);
        assert_eq!((find(&indices, Measure::Slope, 1).sample_count, find(&indices, Measure::Slope, 1).interval), (1, None));
    }

    #[test]
    fn a_bent_response_shows_in_the_slopes_to_either_side_and_a_gap_leaves_one() {
        let design = design(0.1);
        let bent = values(&design, |x, _| (x - 120.0).abs());
        let slope = find(&design.indices(&bent).unwrap(), Measure::Slope, 0);
        let (low, high) = slope.interval.unwrap();
        assert!((low + 1.0).abs() < 1e-9 && (high - 1.0).abs() < 1e-9, "{slope:?}");
        let mut gap = values(&design, |x, _| 3.0 * x);
        gap[2] = None;
        let slope = find(&design.indices(&gap).unwrap(), Measure::Slope, 0);
        assert!((slope.value - 3.0).abs() < 1e-9 && slope.interval.is_none() && slope.sample_count == 1, "{slope:?}");
    }

    #[test]
    fn a_value_outside_of_its_range_is_refused() {
        let peak = ScreeningInput::new(Parameter::ContractionPeakLv, 60.0, 100.0, Spacing::Linear).unwrap();
        assert!(LocalDesign::new(&[peak], &[120.0], 0.1).is_err());
        assert!(LocalDesign::new(&[peak], &[80.0], 0.7).is_err() && LocalDesign::new(&[], &[], 0.1).is_err());
    }
}
