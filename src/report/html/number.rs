//! Numbers as people read them.

/// Four significant digits, without zeros that say nothing; very large and very small ones as powers of ten.
pub fn readable(value: f64) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let size = value.abs().log10().floor() as i32;
    let text = match size {
        6.. | ..=-5 => return powered(value, size),
        _ => format!("{value:.*}", (3 - size).clamp(0, 8) as usize),
    };
    let trimmed = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    trimmed.replace('-', "−")
}

fn powered(value: f64, size: i32) -> String {
    let mantissa = format!("{:.2}", value / 10f64.powi(size)).replace('-', "−");
    let raised = |digit: char| digit.to_digit(10).map_or('⁻', |digit| ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][digit as usize]);
    let exponent: String = size.to_string().chars().map(raised).collect();
    format!("{}·10{exponent}", mantissa.trim_end_matches('0').trim_end_matches('.'))
}

/// A coordinate of a drawing, to a tenth of a unit.
pub(super) fn place(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
}

/// Round values that cover a range, about `count` of them.
pub(super) fn ticks((low, high): (f64, f64), count: usize) -> Vec<f64> {
    let span = high - low;
    if !(span.is_finite() && span > 0.0) {
        return vec![low];
    }
    let rough = span / count.max(1) as f64;
    let decade = 10f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 2.5, 5.0, 10.0].map(|part| part * decade).into_iter().find(|step| *step >= rough * 0.999).unwrap_or(10.0 * decade);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|n| n as f64 * step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits_and_a_true_minus() {
        let shown = [0.241_173, 186.666, 1201.4, -0.020_704, 90.0, 123_456.0, 1.5e7, -2e-9].map(readable);
        assert_eq!(shown, ["0.2412", "186.7", "1201", "−0.0207", "90", "123456", "1.5·10⁷", "−2·10⁻⁹"]);
        assert_eq!([f64::NAN, 0.0].map(readable), ["–", "0"]);
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks((-3.0, 104.0), 5), [0.0, 25.0, 50.0, 75.0, 100.0]);
        assert_eq!(ticks((0.0, 0.8), 4), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8]);
        assert_eq!(ticks((1.0, 1.0), 4), [1.0]);
    }
}
