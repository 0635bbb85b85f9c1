//! Summary statistics that several rooms need, on finite samples.

/// Root mean square; 0 of an empty sample.
pub fn root_mean_square(sample: &[f64]) -> f64 {
    if sample.is_empty() {
        return 0.0;
    }
    (sample.iter().map(|value| value * value).sum::<f64>() / sample.len() as f64).sqrt()
}

/// Mean; 0 of an empty sample.
pub fn mean(sample: &[f64]) -> f64 {
    if sample.is_empty() { 0.0 } else { sample.iter().sum::<f64>() / sample.len() as f64 }
}

/// Standard deviation with n − 1; 0 of fewer than two values.
pub fn standard_deviation(sample: &[f64]) -> f64 {
    if sample.len() < 2 {
        return 0.0;
    }
    let centre = mean(sample);
    (sample.iter().map(|value| (value - centre).powi(2)).sum::<f64>() / (sample.len() - 1) as f64).sqrt()
}

/// The `fraction` quantile (0..1) by linear interpolation between order statistics (type 7); `None` of an empty sample.
pub fn quantile(sample: &[f64], fraction: f64) -> Option<f64> {
    let mut sorted = sample.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = fraction.clamp(0.0, 1.0) * (sorted.len().checked_sub(1)? as f64);
    let (below, weight) = (place.floor() as usize, place.fract());
    let above = (below + 1).min(sorted.len() - 1);
    Some(sorted[below] * (1.0 - weight) + sorted[above] * weight)
}

/// Median; `None` of an empty sample.
pub fn median(sample: &[f64]) -> Option<f64> {
    quantile(sample, 0.5)
}

/// 1.4826 · median |x − median|: the standard deviation of the bulk of a sample with outliers; `None` of an empty sample.
pub fn robust_standard_deviation(sample: &[f64]) -> Option<f64> {
    let centre = median(sample)?;
    let distances: Vec<f64> = sample.iter().map(|value| (value - centre).abs()).collect();
    Some(1.482_602_218_505_602 * median(&distances)?)
}

/// z with P(|N(0, 1)| ≤ z) = 0.95.
pub const NORMAL_QUANTILE_95: f64 = 1.959_963_984_540_054;

/// Quantile of χ² with `degrees` degrees of freedom at the standard normal deviate `z` (−1.96 → 2.5 %), by \[Wilson1931\]:
/// χ² ≈ ν (1 − 2/(9ν) + z √(2/(9ν)))³, within 1 % for ν ≥ 3.
pub fn chi_square_quantile(degrees: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * degrees);
    degrees * (1.0 - spread + z * spread.sqrt()).max(0.0).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_a_small_sample() {
        let sample = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(mean(&sample), 2.5);
        assert!((standard_deviation(&sample) - (5.0_f64 / 3.0).sqrt()).abs() < 1e-15);
        assert!((root_mean_square(&sample) - 7.5_f64.sqrt()).abs() < 1e-15);
        assert_eq!((mean(&[]), standard_deviation(&[1.0]), root_mean_square(&[])), (0.0, 0.0, 0.0));
    }

    #[test]
    fn quantiles_interpolate_and_ignore_order() {
        let sample = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(quantile(&sample, 0.0), Some(1.0));
        assert_eq!(median(&sample), Some(2.5));
        assert_eq!(quantile(&sample, 0.9), Some(3.7));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn one_outlier_does_not_move_the_robust_deviation() {
        let mut sample: Vec<f64> = (-50..=50).map(f64::from).collect();
        let clean = robust_standard_deviation(&sample).unwrap();
        sample.push(1e9);
        assert!((robust_standard_deviation(&sample).unwrap() - clean).abs() < 1.0);
    }

    /// Tables: χ²₁₀ at 2.5 % and 97.5 %, χ²₁₀₀ at 97.5 %.
    #[test]
    fn chi_square_quantiles_agree_with_tables() {
        for (degrees, z, table) in
            [(10.0, -NORMAL_QUANTILE_95, 3.247), (10.0, NORMAL_QUANTILE_95, 20.483), (100.0, NORMAL_QUANTILE_95, 129.561)]
        {
            let value = chi_square_quantile(degrees, z);
            assert!((value / table - 1.0).abs() < 0.01, "{value} {table}");
        }
    }
}
