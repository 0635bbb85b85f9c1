//! How much a residual row counts: squares, or Huber's loss, which grows linearly for outliers.

/// The loss ρ of one residual row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// ρ(r) = r²/2.
    Squares,
    /// ρ(r) = r²/2 for |r| ≤ k, k|r| − k²/2 beyond, \[Huber1964\].
    Huber {
        /// k, in standard deviations; 1.345 keeps 95 % of the efficiency on normal data.
        threshold: f64,
    },
}

impl Loss {
    /// ρ(r).
    pub fn value(self, row: f64) -> f64 {
        match self {
            Self::Huber { threshold } if row.abs() > threshold => threshold * (row.abs() - 0.5 * threshold),
            _ => 0.5 * row * row,
        }
    }

    /// The weight w = ρ'(r)/r of iteratively reweighted least squares: wr is the exact gradient, and w r²/2 + const majorises ρ.
    pub fn weight(self, row: f64) -> f64 {
        match self {
            Self::Huber { threshold } if row.abs() > threshold => threshold / row.abs(),
            _ => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ρ' = w r by central differences, on both sides of the threshold.
    #[test]
    fn weight_times_row_is_the_gradient_of_the_loss() {
        for loss in [Loss::Squares, Loss::Huber { threshold: 1.345 }] {
            for row in [-5.0, -1.0, 0.3, 1.3, 1.4, 40.0] {
                let step = 1e-4;
                let slope = (loss.value(row + step) - loss.value(row - step)) / (2.0 * step);
                assert!((slope - loss.weight(row) * row).abs() < 1e-8, "{loss:?} at {row}");
            }
        }
    }

    /// The reason why reweighting descends: the weighted square touches ρ at r and lies above it elsewhere.
    #[test]
    fn weighted_square_majorises_the_loss() {
        let loss = Loss::Huber { threshold: 1.0 };
        for at in [0.2, 3.0] {
            let constant = loss.value(at) - 0.5 * loss.weight(at) * at * at;
            for row in (-50..=50).map(|k| f64::from(k) * 0.1) {
                assert!(0.5 * loss.weight(at) * row * row + constant >= loss.value(row) - 1e-12);
            }
        }
    }
}
