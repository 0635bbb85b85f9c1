//! Rounded extremes: the union and the cut of two shapes given by level sets, without a crease.

/// The larger of two numbers, rounded where they differ by less than `radius`: never less than the larger, and more by at most `radius`/4.
pub fn rounded_max(a: f64, b: f64, radius: f64) -> f64 {
    let overlap = (radius - (a - b).abs()).max(0.0);
    if overlap > 0.0 { a.max(b) + overlap * overlap / (4.0 * radius) } else { a.max(b) }
}

#[cfg(test)]
mod tests {
    use super::rounded_max;

    #[test]
    fn rounding_adds_a_quarter_of_the_radius_at_most_and_nothing_away_from_the_crease() {
        assert_eq!([rounded_max(1.0, 1.0, 2.0), rounded_max(-3.0, 1.0, 2.0), rounded_max(1.0, 3.0, 2.0)], [1.5, 1.0, 3.0]);
        assert_eq!(rounded_max(2.0, 2.0, 0.0), 2.0);
        let [below, above] = [1.999_999, 2.000_001].map(|b| rounded_max(0.0, b, 2.0));
        assert!((above - below - 2e-6).abs() < 1e-9, "no kink where the rounding begins");
    }
}
