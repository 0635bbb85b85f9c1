//! Arrays as text: whole numbers of one or two bytes, little-endian, in base64.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Bytes in base64.
pub(super) fn base64(bytes: &[u8]) -> String {
    STANDARD.encode(bytes)
}

/// Values of a range in 256 steps; what is not finite becomes the least.
pub(super) fn bytes_of(values: impl Iterator<Item = f64>, (low, high): (f64, f64)) -> String {
    let byte = |value: f64| if value.is_finite() { ((value - low) / (high - low) * 255.0).round().clamp(0.0, 255.0) as u8 } else { 0 };
    base64(&values.map(byte).collect::<Vec<u8>>())
}

/// Unsigned 16-bit numbers.
pub(super) fn words_of(values: impl Iterator<Item = u16>) -> String {
    base64(&values.flat_map(u16::to_le_bytes).collect::<Vec<u8>>())
}

/// Unsigned 32-bit numbers.
pub(super) fn long_words_of(values: impl Iterator<Item = u32>) -> String {
    base64(&values.flat_map(u32::to_le_bytes).collect::<Vec<u8>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_to_half_a_step() {
        let values = [0.0, 0.1, 0.5, 1.0, f64::NAN];
        let bytes = STANDARD.decode(bytes_of(values.into_iter(), (0.0, 1.0))).unwrap();
        assert!(bytes.iter().zip(values).take(4).all(|(&byte, value)| (f64::from(byte) / 255.0 - value).abs() <= 0.5 / 255.0));
        assert_eq!(STANDARD.decode(words_of([1, 513].into_iter())).unwrap(), [1, 0, 1, 2]);
        assert_eq!(STANDARD.decode(long_words_of([258].into_iter())).unwrap(), [2, 1, 0, 0]);
    }
}
