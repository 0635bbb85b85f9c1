//! Sobol' indices: the shares of an output's variance that inputs explain alone, in pairs, and with all their interactions, \[Sobol2001\].
//!
//! $$ S_i = \frac{\overline{f(B)\,(f(A_B^i) - f(A))}}{V},\qquad T_i = \frac{\overline{(f(A) - f(A_B^i))^2}}{2V},\qquad
//!    S_{ij} = \frac{\overline{f(B_A^i) f(A_B^j) - f(A) f(B)}}{V} - S_i - S_j $$
//!
//! Estimators of \[Saltelli2010\] (first order), \[Jansen1999\] (total) and \[Saltelli2002\] (second order). A and B are the two halves of an
//! Owen-scrambled Sobol' sequence in 2k dimensions; A_B^i is A with column i of B. n (k + 2) evaluations for n rows in k inputs, n (2k + 2)
//! with pairs. A row stands together: A, A_B^0 …, with pairs B_A^0 …, B: the order that SALib expects.

use rayon::prelude::*;

use super::bootstrap::Bootstrap;
use super::{Index, Measure, SensitivityError};

/// Rows that must be left after failures.
const FEWEST_ROWS: usize = 8;
/// The sequence is no longer than this, and has no more dimensions.
const MOST_ROWS: usize = 1 << 16;
const MOST_INPUTS: usize = sobol_burley::NUM_DIMENSIONS as usize / 2;

/// Rows of A, A_B^i, with pairs B_A^i, and B.
#[derive(Debug, Clone, PartialEq)]
pub struct SobolDesign {
    points: Vec<Vec<f64>>,
    input_count: usize,
    row_count: usize,
    pairs: bool,
    seed: u64,
}

impl SobolDesign {
    /// `row_count` rows (a power of two: only then is the sequence balanced) in `input_count` inputs, with second-order indices if `pairs`.
    ///
    /// # Errors
    /// [`SensitivityError::Setting`] for no or more than 128 inputs, or a number of rows that is no power of two from 8 to 65536.
    pub fn new(input_count: usize, row_count: usize, pairs: bool, seed: u64) -> Result<Self, SensitivityError> {
        let refuse = |what, value: usize, remedy| Err(SensitivityError::Setting { what, value: value as f64, remedy });
        if !(1..=MOST_INPUTS).contains(&input_count) {
            return refuse("number of inputs", input_count, "must be from 1 to 128");
        }
        if !row_count.is_power_of_two() || !(FEWEST_ROWS..=MOST_ROWS).contains(&row_count) {
            return refuse("number of rows", row_count, "must be a power of two from 8 to 65536");
        }
        // The generator takes 32 bits of seed.
        let scramble = (seed ^ (seed >> 32)) as u32;
        let drawn = |row: usize, dimension: usize| f64::from(sobol_burley::sample(row as u32, dimension as u32, scramble));
        let mut points = Vec::with_capacity(row_count * width(input_count, pairs));
        for row in 0..row_count {
            let a: Vec<f64> = (0..input_count).map(|input| drawn(row, input)).collect();
            let b: Vec<f64> = (0..input_count).map(|input| drawn(row, input_count + input)).collect();
            let mixed = |of: &[f64], from: &[f64], input: usize| {
                let mut point = of.to_vec();
                point[input] = from[input];
                point
            };
            points.push(a.clone());
            points.extend((0..input_count).map(|input| mixed(&a, &b, input)));
            if pairs {
                points.extend((0..input_count).map(|input| mixed(&b, &a, input)));
            }
            points.push(b);
        }
        Ok(Self { points, input_count, row_count, pairs, seed })
    }

    /// Where to evaluate the model, in the unit cube.
    pub fn points(&self) -> &[Vec<f64>] {
        &self.points
    }

    /// An index rests on the rows of which it needs no gap.
    pub(super) fn indices(&self, values: &[f64]) -> Result<Vec<Index>, SensitivityError> {
        let known = super::without_gaps(values.iter().copied());
        if known.iter().all(|value| *value == known[0]) {
            return Err(SensitivityError::Constant);
        }
        let sample = Sample::new(self, values);
        let found = (0..self.row_count).filter(|&row| (sample.a(row) + sample.b(row)).is_finite()).count();
        if found < FEWEST_ROWS {
            return Err(SensitivityError::FewRows { found, expected: FEWEST_ROWS });
        }
        let bootstrap = Bootstrap::new(self.row_count, self.seed);
        let index = |&(measure, input, partner): &(Measure, usize, Option<usize>)| {
            let share = |rows: &mut dyn Iterator<Item = usize>| sample.share(measure, input, partner, rows);
            let (value, sample_count) = share(&mut (0..self.row_count));
            let interval = bootstrap.interval(|rows| share(rows).0);
            value.is_finite().then_some(Index { measure, input, partner, value, interval, sample_count })
        };
        Ok(self.measures().par_iter().map(index).collect::<Vec<_>>().into_iter().flatten().collect())
    }

    fn measures(&self) -> Vec<(Measure, usize, Option<usize>)> {
        let inputs = 0..self.input_count;
        let mut measures: Vec<_> =
            inputs.clone().flat_map(|input| [(Measure::FirstOrder, input, None), (Measure::Total, input, None)]).collect();
        if self.pairs {
            let count = self.input_count;
            measures.extend(inputs.flat_map(|i| (i + 1..count).map(move |j| (Measure::SecondOrder, i, Some(j)))));
        }
        measures
    }
}

/// Points of a row.
fn width(input_count: usize, pairs: bool) -> usize {
    if pairs { 2 * input_count + 2 } else { input_count + 2 }
}

/// The values of one output, about their mean: it takes the variance of that mean out of the estimates.
struct Sample {
    values: Vec<f64>,
    input_count: usize,
    width: usize,
}

impl Sample {
    fn new(design: &SobolDesign, values: &[f64]) -> Self {
        let centre = crate::numerics::mean(&super::without_gaps(values.iter().copied()));
        let values = values.iter().map(|value| value - centre).collect();
        Self { values, input_count: design.input_count, width: width(design.input_count, design.pairs) }
    }

    fn a(&self, row: usize) -> f64 {
        self.values[row * self.width]
    }

    fn b(&self, row: usize) -> f64 {
        self.values[(row + 1) * self.width - 1]
    }

    /// A with column `input` of B.
    fn ab(&self, row: usize, input: usize) -> f64 {
        self.values[row * self.width + 1 + input]
    }

    /// B with column `input` of A; of designs with pairs.
    fn ba(&self, row: usize, input: usize) -> f64 {
        self.values[row * self.width + 1 + self.input_count + input]
    }

    /// An index on `rows`, and how many of them have no gap.
    fn share(&self, measure: Measure, i: usize, partner: Option<usize>, rows: &mut dyn Iterator<Item = usize>) -> (f64, usize) {
        let (mut sum, mut count) = (0.0, 0);
        let (mut first, mut second) = (0.0, 0.0);
        for row in rows {
            let (a, b) = (self.a(row), self.b(row));
            let alone = |input: usize| b * (self.ab(row, input) - a);
            let term = match (measure, partner) {
                (Measure::SecondOrder, Some(j)) => self.ba(row, i) * self.ab(row, j) - a * b - alone(i) - alone(j),
                (Measure::Total, _) => 0.5 * (a - self.ab(row, i)).powi(2),
                _ => alone(i),
            };
            if (term + a + b).is_finite() {
                (sum, count) = (sum + term, count + 1);
                (first, second) = (first + a + b, second + a * a + b * b);
            }
        }
        let both = 2.0 * count as f64;
        let variance = second / both - (first / both).powi(2);
        (sum / count as f64 / variance, count)
    }
}

#[cfg(test)]
mod tests;
