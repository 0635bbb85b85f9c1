//! Colour maps that are told apart without colour vision: viridis for amounts, blue to red over white for what has a sign.

use serde::Serialize;

/// What a range of values means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Scale {
    /// Amounts: viridis from the least to the greatest.
    Sequential,
    /// Signed values: white at zero.
    Diverging,
}

/// viridis (Smith and van der Walt), in nine steps.
const VIRIDIS: [[u8; 3]; 9] =
    colours([0x44_01_54, 0x47_2d_7b, 0x3b_52_8b, 0x2c_72_8e, 0x21_91_8c, 0x28_ae_80, 0x5e_c9_62, 0xad_dc_30, 0xfd_e7_25]);

/// `RdBu` of `ColorBrewer`, blue first.
const BLUE_TO_RED: [[u8; 3]; 9] =
    colours([0x21_66_ac, 0x43_93_c3, 0x92_c5_de, 0xd1_e5_f0, 0xf7_f7_f7, 0xfd_db_c7, 0xf4_a5_82, 0xd6_60_4d, 0xb2_18_2b]);

/// Colours from `0xrr_gg_bb`.
const fn colours(codes: [u32; 9]) -> [[u8; 3]; 9] {
    let mut colours = [[0; 3]; 9];
    let mut n = 0;
    while n < 9 {
        let [_, r, g, b] = codes[n].to_be_bytes();
        colours[n] = [r, g, b];
        n += 1;
    }
    colours
}

impl Scale {
    /// Its colours at even distances.
    pub(super) fn colours(self) -> &'static [[u8; 3]; 9] {
        match self {
            Self::Sequential => &VIRIDIS,
            Self::Diverging => &BLUE_TO_RED,
        }
    }

    /// The range that holds `values`, never empty; around zero where they have a sign.
    pub(super) fn range(self, values: impl Iterator<Item = f64>) -> (f64, f64) {
        let (low, high) =
            values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        match self {
            _ if low > high => (0.0, 1.0),
            Self::Sequential if high > low => (low, high),
            Self::Sequential => (low, low + low.abs().max(1.0)),
            Self::Diverging => {
                let most = low.abs().max(high.abs());
                let most = if most > 0.0 { most } else { 1.0 };
                (-most, most)
            }
        }
    }

    /// The colour of a value of a range.
    pub(super) fn colour(self, value: f64, (low, high): (f64, f64)) -> [u8; 3] {
        let place = ((value - low) / (high - low)).clamp(0.0, 1.0) * 8.0;
        let (index, part) = ((place as usize).min(7), place - (place as usize).min(7) as f64);
        let [from, to] = [self.colours()[index], self.colours()[index + 1]];
        std::array::from_fn(|n| (f64::from(from[n]) * (1.0 - part) + f64::from(to[n]) * part).round() as u8)
    }
}

/// `#rrggbb`.
pub(super) fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Black or white, whichever is read better on a colour (relative luminance of sRGB).
pub(super) fn ink_on(colour: [u8; 3]) -> &'static str {
    let linear = |channel: u8| (f64::from(channel) / 255.0).powf(2.2);
    let [r, g, b] = colour.map(linear);
    if 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.22 { "#111" } else { "#fff" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_and_middle_of_the_scales_are_their_colours() {
        assert_eq!(Scale::Sequential.colour(2.0, (2.0, 4.0)), [68, 1, 84]);
        assert_eq!(Scale::Sequential.colour(9.0, (2.0, 4.0)), [253, 231, 37]);
        assert_eq!(Scale::Diverging.colour(0.0, (-3.0, 3.0)), [247, 247, 247]);
        assert_eq!((ink_on([253, 231, 37]), ink_on([68, 1, 84])), ("#111", "#fff"));
    }

    #[test]
    fn a_signed_range_is_even_and_no_range_is_empty() {
        assert_eq!(Scale::Diverging.range([-0.2, 0.1].into_iter()), (-0.2, 0.2));
        assert_eq!(Scale::Sequential.range([3.0, 3.0, f64::NAN].into_iter()), (3.0, 6.0));
        assert_eq!(Scale::Diverging.range(std::iter::empty()), (0.0, 1.0));
    }
}
