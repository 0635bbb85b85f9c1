//! Intervals by resampling whole rows of a design with replacement, \[Efron1993\]: the 2.5 and 97.5 percentiles of what the resamples give.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::numerics::quantile;

/// Resamples: the percentiles of a thousand are stable to about a tenth of the interval's width.
const RESAMPLES: usize = 1000;

/// The same resamples for all indices of a design.
pub(super) struct Bootstrap {
    resamples: Vec<Vec<u32>>,
}

impl Bootstrap {
    pub(super) fn new(row_count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let rows = u32::try_from(row_count).unwrap_or(u32::MAX);
        let mut resample = || (0..row_count).map(|_| rng.random_range(0..rows)).collect();
        Self { resamples: (0..RESAMPLES).map(|_| resample()).collect() }
    }

    /// The interval of a statistic of rows; none unless nearly all resamples have one.
    pub(super) fn interval(&self, statistic: impl Fn(&mut dyn Iterator<Item = usize>) -> f64) -> Option<(f64, f64)> {
        let of = |rows: &Vec<u32>| statistic(&mut rows.iter().map(|&row| row as usize));
        let values = super::without_gaps(self.resamples.iter().map(of));
        let known = values.len() * 10 >= RESAMPLES * 9;
        known.then(|| quantile(&values, 0.025).zip(quantile(&values, 0.975))).flatten()
    }
}
