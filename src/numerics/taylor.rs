//! Taylor tests of derivatives: the second-order remainder of a right derivative falls with the square of the step.
//!
//! $$ \lVert f(x + h d) - f(x) - h f'(x) d \rVert = O(h^2) $$

use nalgebra::DVector;

/// Remainders of a function along a direction, one a step.
#[derive(Debug, Clone, PartialEq)]
pub struct TaylorTest {
    /// Steps h, descending by halves.
    pub steps: Vec<f64>,
    /// ‖f(x + h d) − f(x) − h f'd‖ a step.
    pub remainders: Vec<f64>,
    /// ‖h f'd‖ a step, the size against which a remainder is read.
    pub sizes: Vec<f64>,
}

impl TaylorTest {
    /// Evaluates `function` at `base` and at `count` points base + h `direction`, h = `largest_step`, its half, its quarter, …;
    /// `derivative` is f'(base) · direction.
    ///
    /// # Errors
    /// The function's own.
    pub fn run<E>(
        function: impl Fn(&DVector<f64>) -> Result<DVector<f64>, E>,
        base: &DVector<f64>,
        direction: &DVector<f64>,
        derivative: &DVector<f64>,
        largest_step: f64,
        count: usize,
    ) -> Result<Self, E> {
        let here = function(base)?;
        let mut test = Self { steps: Vec::new(), remainders: Vec::new(), sizes: Vec::new() };
        for halving in 0..count {
            let step = largest_step * 0.5_f64.powi(i32::try_from(halving).unwrap_or(i32::MAX));
            let there = function(&(base + direction * step))?;
            test.steps.push(step);
            test.remainders.push((there - &here - derivative * step).norm());
            test.sizes.push(derivative.norm() * step);
        }
        Ok(test)
    }

    /// Slope of log remainder over log step by least squares: about 2 for a right derivative, 1 for a wrong one. Infinite for a linear
    /// function, whose remainders are rounding.
    pub fn order(&self) -> f64 {
        let rounding = 1e-13 * self.sizes.iter().copied().fold(0.0, f64::max);
        let points: Vec<(f64, f64)> =
            self.steps.iter().zip(&self.remainders).filter(|&(_, &rest)| rest > rounding).map(|(h, rest)| (h.ln(), rest.ln())).collect();
        if points.len() < 2 {
            return f64::INFINITY;
        }
        let count = points.len() as f64;
        let (mean_x, mean_y) = points.iter().fold((0.0, 0.0), |(x, y), point| (x + point.0 / count, y + point.1 / count));
        let covariance: f64 = points.iter().map(|point| (point.0 - mean_x) * (point.1 - mean_y)).sum();
        covariance / points.iter().map(|point| (point.0 - mean_x).powi(2)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn function(x: &DVector<f64>) -> Result<DVector<f64>, Infallible> {
        Ok(DVector::from_vec(vec![x[0].exp() * x[1], x[0].sin() - x[1].powi(3)]))
    }

    fn order_with(derivative: &DVector<f64>) -> f64 {
        let (base, direction) = (DVector::from_vec(vec![0.4, -0.7]), DVector::from_vec(vec![1.0, 2.0]));
        TaylorTest::run(function, &base, &direction, derivative, 1e-2, 6).unwrap().order()
    }

    #[test]
    fn right_derivative_has_a_second_order_remainder_and_a_wrong_one_has_not() {
        let (x, y) = (0.4_f64, -0.7_f64);
        let right = DVector::from_vec(vec![x.exp() * y + 2.0 * x.exp(), x.cos() - 6.0 * y * y]);
        assert!((order_with(&right) - 2.0).abs() < 0.02, "{}", order_with(&right));
        // Wrong by 1 % in one entry.
        let wrong = DVector::from_vec(vec![right[0] * 1.01, right[1]]);
        assert!(order_with(&wrong) < 1.7, "{}", order_with(&wrong));
    }

    #[test]
    fn linear_functions_have_no_remainder() {
        let linear = |x: &DVector<f64>| Ok::<_, Infallible>(x * 3.0);
        let direction = DVector::from_vec(vec![1.0, -1.0]);
        let test = TaylorTest::run(linear, &DVector::from_vec(vec![1.0, 2.0]), &direction, &(&direction * 3.0), 1.0, 5).unwrap();
        assert!(test.order().is_infinite());
    }
}
