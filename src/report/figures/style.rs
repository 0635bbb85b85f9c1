//! The canvas that all figures share: font, palette, and a picture drawn at twice its size and averaged, so that edges are smooth.

use std::path::Path;
use std::sync::OnceLock;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::report::{ReportError, write_atomically};

/// Drawing area of all figures.
pub(super) type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

/// What drawing may fail with.
pub(super) type DrawError = Box<dyn std::error::Error + Send + Sync>;

/// Whether something was drawn.
pub(super) type Drawn = Result<(), DrawError>;

/// Pixels drawn for one pixel shown, each way.
pub(super) const OVERSAMPLING: u32 = 2;

pub(super) const BLACK_INK: RGBColor = RGBColor(25, 25, 25);
pub(super) const GREY_INK: RGBColor = RGBColor(95, 95, 95);
pub(super) const RULE: RGBColor = RGBColor(222, 222, 222);
pub(super) const BLUE_INK: RGBColor = RGBColor(0, 114, 178);
pub(super) const VERMILION: RGBColor = RGBColor(213, 94, 0);
pub(super) const BLUISH_GREEN: RGBColor = RGBColor(0, 158, 115);
pub(super) const ORANGE: RGBColor = RGBColor(230, 159, 0);
pub(super) const SKY_BLUE: RGBColor = RGBColor(86, 180, 233);
pub(super) const REDDISH_PURPLE: RGBColor = RGBColor(204, 121, 167);

/// Height of ordinary text and of titles, in pixels shown.
pub(super) const TEXT: u32 = 24;
pub(super) const TITLE: u32 = 30;

/// Pixels drawn for a length in pixels shown.
pub(super) fn px(length: u32) -> u32 {
    length * OVERSAMPLING
}

/// The same, for coordinates.
pub(super) fn ipx(length: u32) -> i32 {
    (length * OVERSAMPLING) as i32
}

/// A text style of the embedded font, size in pixels shown.
pub(super) fn text(size: u32, colour: &RGBColor) -> TextStyle<'static> {
    ("sans-serif", px(size)).into_font().color(colour)
}

/// The same in bold.
pub(super) fn bold(size: u32, colour: &RGBColor) -> TextStyle<'static> {
    FontDesc::new(FontFamily::SansSerif, f64::from(px(size)), FontStyle::Bold).color(colour)
}

/// Writes a line of text whose left end, centre or right end is at a place, at the middle of its height.
pub(super) fn write(area: &Area, words: &str, style: &TextStyle, horizontal: HPos, (x, y): (i32, i32)) -> Drawn {
    // The font's box has more room above its letters than below.
    let lower = (style.font.get_size() * 0.13).round() as i32;
    Ok(area.draw_text(words, &style.pos(Pos::new(horizontal, VPos::Center)), (x, y + lower))?)
}

/// The same, read from below to above.
pub(super) fn write_upward(area: &Area, words: &str, style: &TextStyle, horizontal: HPos, place: (i32, i32)) -> Drawn {
    let turned = style.transform(FontTransform::Rotate270).pos(Pos::new(horizontal, VPos::Center));
    Ok(area.draw_text(words, &turned, place)?)
}

/// Draws a picture of `width` × `height` pixels and writes it as PNG.
pub(super) fn picture(
    file: &Path,
    figure: &'static str,
    (width, height): (u32, u32),
    paint: impl FnOnce(&Area) -> Drawn,
) -> Result<(), ReportError> {
    let white = vec![255; 3 * (px(width) * px(height)) as usize];
    picture_on(file, figure, (width, height), white, paint)
}

/// The same on RGB pixels that are already there, `OVERSAMPLING` times as many each way.
pub(super) fn picture_on(
    file: &Path,
    figure: &'static str,
    (width, height): (u32, u32),
    mut pixels: Vec<u8>,
    paint: impl FnOnce(&Area) -> Drawn,
) -> Result<(), ReportError> {
    let failed = |reason: String| ReportError::Figure { figure, reason };
    embed_fonts().map_err(|reason| failed(reason.to_string()))?;
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (px(width), px(height))).into_drawing_area();
        paint(&area).and_then(|()| area.present().map_err(Into::into)).map_err(|error| failed(error.to_string()))?;
    }
    let shown = averaged(&pixels, width as usize, height as usize);
    write_atomically(file, |out| {
        use image::ImageEncoder;
        use image::codecs::png::{CompressionType, FilterType, PngEncoder};
        let encoder = PngEncoder::new_with_quality(out, CompressionType::Best, FilterType::Adaptive);
        encoder.write_image(&shown, width, height, image::ColorType::Rgb8).map_err(std::io::Error::other)
    })
}

/// Registers the embedded DejaVu Sans as the sans-serif font, once.
fn embed_fonts() -> Result<(), &'static str> {
    static EMBEDDED: OnceLock<bool> = OnceLock::new();
    let is_embedded = *EMBEDDED.get_or_init(|| {
        let fonts = [(FontStyle::Normal, dejavu::sans::regular()), (FontStyle::Bold, dejavu::sans::bold())];
        fonts.into_iter().all(|(style, bytes)| register_font("sans-serif", style, bytes).is_ok())
    });
    if is_embedded { Ok(()) } else { Err("the embedded font cannot be read") }
}

/// The mean of each block of `OVERSAMPLING` × `OVERSAMPLING` pixels.
fn averaged(pixels: &[u8], width: usize, height: usize) -> Vec<u8> {
    let factor = OVERSAMPLING as usize;
    let mut shown = Vec::with_capacity(3 * width * height);
    for row in 0..height {
        for column in 0..width {
            for channel in 0..3 {
                let mut sum = 0usize;
                for y in row * factor..(row + 1) * factor {
                    for x in column * factor..(column + 1) * factor {
                        sum += usize::from(pixels[3 * (y * width * factor + x) + channel]);
                    }
                }
                shown.push(((sum + factor * factor / 2) / (factor * factor)) as u8);
            }
        }
    }
    shown
}

/// A range with room at both ends, that never is empty and takes numbers that are finite only.
pub(super) fn padded(values: impl Iterator<Item = f64>, low: f64, high: f64) -> (f64, f64) {
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values.filter(|value| value.is_finite()) {
        least = least.min(value);
        most = most.max(value);
    }
    if least > most {
        return (0.0, 1.0);
    }
    let span = if most > least { most - least } else { most.abs().max(1.0) };
    (least - low * span, most + high * span)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_have_room_and_are_never_empty() {
        assert_eq!(padded([1.0, f64::NAN, 3.0].into_iter(), 0.1, 0.5), (0.8, 4.0));
        assert_eq!(padded([2.0].into_iter(), 0.5, 0.5), (1.0, 3.0));
        assert_eq!(padded([f64::NAN].into_iter(), 0.5, 0.5), (0.0, 1.0));
    }

    #[test]
    fn pixels_shown_are_means_of_those_drawn() {
        let drawn = [0, 0, 0, 100, 0, 4, 100, 0, 4, 200, 0, 4];
        assert_eq!(averaged(&drawn, 1, 1), [100, 0, 3]);
    }
}
