//! Slices of the images through time with the contours of the model on them, as in \[Billet2009\] fig. 3.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::style::*;
use crate::report::ReportError;

/// A line on a slice.
#[derive(Debug, Clone, PartialEq)]
pub struct Contour {
    /// Which surface of [`Montage::surfaces`].
    pub surface: usize,
    /// Points in the slice's coordinates, mm.
    pub points_mm: Vec<[f64; 2]>,
}

/// One slice at one time. The first coordinate grows to the right, the second downward.
#[derive(Debug, Clone, PartialEq)]
pub struct MontagePanel {
    /// Pixels in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Intensities, row by row from the top.
    pub intensity: Vec<f64>,
    /// Centre of the first pixel, mm.
    pub origin_mm: [f64; 2],
    /// Edge of a pixel, mm.
    pub spacing_mm: [f64; 2],
    /// Lines on it, drawn in this order.
    pub contours: Vec<Contour>,
}

/// Slices by row, times by column.
#[derive(Debug, Clone, PartialEq)]
pub struct Montage {
    /// Title.
    pub title: String,
    /// Names of the surfaces.
    pub surfaces: Vec<String>,
    /// Heading of each column, such as `120 ms`; may all be empty.
    pub column_titles: Vec<String>,
    /// Heading of each row, such as `slice 4`.
    pub row_titles: Vec<String>,
    /// Panels row by row, one for each row and column.
    pub panels: Vec<MontagePanel>,
    /// Intensities shown black and white.
    pub window: (f64, f64),
}

const GAP: u32 = 6;
const LEFT: u32 = 56;
const SIZE: u32 = 270;
/// Steps of grey that are shown; more are hardly seen and make the file three times as large, as noise does not compress.
const GREYS: f64 = 85.0;
const PALETTE: [RGBColor; 5] = [ORANGE, SKY_BLUE, BLUISH_GREEN, REDDISH_PURPLE, VERMILION];

/// Draws all panels.
///
/// # Errors
/// [`ReportError`] if the numbers of panels and titles, or of pixels, do not fit, or the figure cannot be written.
pub fn slice_montage(file: &Path, figure: &Montage) -> Result<(), ReportError> {
    const NAME: &str = "the slice montage";
    check(figure).map_err(|reason| ReportError::Figure { figure: NAME, reason })?;
    let aspect = |panel: &MontagePanel| panel.rows as f64 * panel.spacing_mm[1] / (panel.columns as f64 * panel.spacing_mm[0]);
    let tallest = figure.panels.iter().map(aspect).fold(0.2, f64::max).min(3.0);
    let titles = if figure.column_titles.iter().all(String::is_empty) { 0 } else { 40 };
    let legend = if figure.surfaces.is_empty() { 0 } else { 40 };
    let layout = Layout { top: 68 + legend + titles, panel: (SIZE, (f64::from(SIZE) * tallest) as u32) };
    let (columns, rows) = (figure.column_titles.len() as u32, figure.row_titles.len() as u32);
    // The head stays whole even over one narrow column.
    let width = (LEFT + columns * (layout.panel.0 + GAP) + GAP).max(760);
    let height = layout.top + rows * (layout.panel.1 + GAP) + GAP;
    let mut pixels = vec![255; 3 * (px(width) * px(height)) as usize];
    for (number, panel) in figure.panels.iter().enumerate() {
        paint_greys(&mut pixels, px(width) as usize, layout.corner(number as u32, columns), layout.drawn(), panel, figure.window);
    }
    picture_on(file, NAME, (width, height), pixels, |area| {
        draw_head(area, figure, &layout)?;
        for (number, panel) in figure.panels.iter().enumerate() {
            let (corner, size) = (layout.corner(number as u32, columns), layout.drawn());
            for contour in &panel.contours {
                draw_contour(area, contour, &Frame::of(panel, size), corner, size)?;
            }
        }
        Ok(())
    })
}

fn check(figure: &Montage) -> Result<(), String> {
    let expected = figure.column_titles.len() * figure.row_titles.len();
    if figure.panels.len() != expected || expected == 0 {
        return Err(format!(
            "{} panels for {} rows and {} columns",
            figure.panels.len(),
            figure.row_titles.len(),
            figure.column_titles.len()
        ));
    }
    for panel in &figure.panels {
        let spacing = panel.spacing_mm;
        if panel.columns == 0 || panel.intensity.len() != panel.columns * panel.rows || !(spacing[0] > 0.0 && spacing[1] > 0.0) {
            return Err(format!("a panel of {} × {} pixels has {} intensities", panel.columns, panel.rows, panel.intensity.len()));
        }
    }
    Ok(())
}

struct Layout {
    top: u32,
    panel: (u32, u32),
}

impl Layout {
    /// Upper left corner of a panel in pixels drawn.
    fn corner(&self, number: u32, columns: u32) -> (i32, i32) {
        let (row, column) = (number / columns, number % columns);
        (ipx(LEFT + column * (self.panel.0 + GAP)), ipx(self.top + row * (self.panel.1 + GAP)))
    }

    /// Size of a panel in pixels drawn.
    fn drawn(&self) -> (u32, u32) {
        (px(self.panel.0), px(self.panel.1))
    }
}

/// Where mm lie in a panel: the image fills it and keeps its proportions.
struct Frame {
    corner_mm: [f64; 2],
    px_per_mm: f64,
    inset: [f64; 2],
}

impl Frame {
    fn of(panel: &MontagePanel, (width, height): (u32, u32)) -> Self {
        let size_mm = [panel.columns as f64 * panel.spacing_mm[0], panel.rows as f64 * panel.spacing_mm[1]];
        let px_per_mm = (f64::from(width) / size_mm[0]).min(f64::from(height) / size_mm[1]);
        let corner_mm = [panel.origin_mm[0] - panel.spacing_mm[0] / 2.0, panel.origin_mm[1] - panel.spacing_mm[1] / 2.0];
        let inset = [(f64::from(width) - size_mm[0] * px_per_mm) / 2.0, (f64::from(height) - size_mm[1] * px_per_mm) / 2.0];
        Self { corner_mm, px_per_mm, inset }
    }

    fn to_px(&self, point_mm: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| (point_mm[axis] - self.corner_mm[axis]) * self.px_per_mm + self.inset[axis])
    }

    fn to_mm(&self, x: f64, y: f64) -> [f64; 2] {
        [(x - self.inset[0]) / self.px_per_mm + self.corner_mm[0], (y - self.inset[1]) / self.px_per_mm + self.corner_mm[1]]
    }
}

fn draw_head(area: &Area, figure: &Montage, layout: &Layout) -> Drawn {
    write(area, &figure.title, &bold(TITLE, &BLACK_INK), HPos::Left, (ipx(LEFT), ipx(34)))?;
    let style = text(TEXT, &BLACK_INK);
    let mut x = ipx(LEFT);
    for (number, name) in figure.surfaces.iter().enumerate() {
        let ink = PALETTE[number % PALETTE.len()].stroke_width(px(6));
        area.draw(&PathElement::new(vec![(x, ipx(80)), (x + ipx(44), ipx(80))], ink))?;
        write(area, name, &style, HPos::Left, (x + ipx(54), ipx(80)))?;
        x += ipx(54 + 40) + area.estimate_text_size(name, &style)?.0 as i32;
    }
    for (number, title) in figure.column_titles.iter().enumerate() {
        let (left, top) = layout.corner(number as u32, u32::MAX);
        let place = (left + ipx(layout.panel.0 / 2), top - ipx(20));
        write(area, title, &style, HPos::Center, place)?;
    }
    let columns = figure.column_titles.len() as u32;
    for (number, title) in figure.row_titles.iter().enumerate() {
        let (_, top) = layout.corner(number as u32 * columns, columns);
        write_upward(area, title, &style, HPos::Center, (ipx(LEFT / 2), top + ipx(layout.panel.1 / 2)))?;
    }
    Ok(())
}

/// Draws a contour, cut where it leaves its panel.
fn draw_contour(area: &Area, contour: &Contour, frame: &Frame, corner: (i32, i32), size: (u32, u32)) -> Drawn {
    // Where two contours lie on each other, the first still shows on both sides of the second.
    let width = if contour.surface == 0 { px(4) - 1 } else { px(2) };
    let ink = PALETTE[contour.surface % PALETTE.len()].stroke_width(width);
    let limits = [f64::from(size.0), f64::from(size.1)];
    let points: Vec<[f64; 2]> = contour.points_mm.iter().map(|&point| frame.to_px(point)).collect();
    for piece in inside_pieces(&points, limits) {
        let place = |p: &[f64; 2]| (corner.0 + p[0].round() as i32, corner.1 + p[1].round() as i32);
        area.draw(&PathElement::new(piece.iter().map(place).collect::<Vec<_>>(), ink))?;
    }
    Ok(())
}

/// The pieces of a line within the rectangle from (0, 0) to `limits`; a point that is not finite ends a piece.
fn inside_pieces(points: &[[f64; 2]], limits: [f64; 2]) -> Vec<Vec<[f64; 2]>> {
    let mut pieces: Vec<Vec<[f64; 2]>> = Vec::new();
    let mut is_joined = false;
    for pair in points.windows(2) {
        let Some((from, to)) = clipped(pair[0], pair[1], limits) else {
            is_joined = false;
            continue;
        };
        match pieces.last_mut() {
            Some(piece) if is_joined && from == pair[0] => piece.push(to),
            _ => pieces.push(vec![from, to]),
        }
        is_joined = to == pair[1];
    }
    pieces
}

/// The part of a segment within the rectangle from (0, 0) to `limits` (Liang and Barsky).
fn clipped(a: [f64; 2], b: [f64; 2], limits: [f64; 2]) -> Option<([f64; 2], [f64; 2])> {
    if !a.iter().chain(&b).all(|x| x.is_finite()) {
        return None;
    }
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for axis in 0..2 {
        let way = b[axis] - a[axis];
        for (run, room) in [(-way, a[axis]), (way, limits[axis] - a[axis])] {
            if run == 0.0 && room < 0.0 {
                return None;
            } else if run < 0.0 {
                enter = enter.max(room / run);
            } else if run > 0.0 {
                leave = leave.min(room / run);
            }
        }
    }
    let at = |t: f64| [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
    (enter < leave).then(|| (if enter > 0.0 { at(enter) } else { a }, if leave < 1.0 { at(leave) } else { b }))
}

/// Paints the smoothly interpolated image of a panel straight into the picture.
fn paint_greys(pixels: &mut [u8], width: usize, corner: (i32, i32), size: (u32, u32), panel: &MontagePanel, window: (f64, f64)) {
    let frame = Frame::of(panel, size);
    let span = if window.1 > window.0 { window.1 - window.0 } else { 1.0 };
    for row in 0..size.1 as usize {
        for column in 0..size.0 as usize {
            let mm = frame.to_mm(column as f64 + 0.5, row as f64 + 0.5);
            let u = (mm[0] - panel.origin_mm[0]) / panel.spacing_mm[0];
            let v = (mm[1] - panel.origin_mm[1]) / panel.spacing_mm[1];
            let grey = match bicubic(panel, u, v) {
                Some(value) => (GREYS * (value - window.0) / span).round().clamp(0.0, GREYS) as u8 * (255 / GREYS as u8),
                None => 0,
            };
            let at = 3 * ((corner.1 as usize + row) * width + corner.0 as usize + column);
            pixels[at..at + 3].fill(grey);
        }
    }
}

/// Catmull–Rom interpolation at pixel coordinates; none outside the image, and its border is repeated.
fn bicubic(panel: &MontagePanel, u: f64, v: f64) -> Option<f64> {
    let inside = |x: f64, count: usize| x >= -0.5 && x <= count as f64 - 0.5;
    if !(inside(u, panel.columns) && inside(v, panel.rows)) {
        return None;
    }
    let weights = |t: f64| {
        let (t2, t3) = (t * t, t * t * t);
        [(-t + 2.0 * t2 - t3) / 2.0, (2.0 - 5.0 * t2 + 3.0 * t3) / 2.0, (t + 4.0 * t2 - 3.0 * t3) / 2.0, (t3 - t2) / 2.0]
    };
    let near = |base: f64, offset: usize, count: usize| (base as i64 + offset as i64 - 1).clamp(0, count as i64 - 1) as usize;
    let (wu, wv) = (weights(u - u.floor()), weights(v - v.floor()));
    let mut sum = 0.0;
    for (j, &weight_v) in wv.iter().enumerate() {
        let row = near(v.floor(), j, panel.rows) * panel.columns;
        for (i, &weight_u) in wu.iter().enumerate() {
            sum += weight_v * weight_u * panel.intensity[row + near(u.floor(), i, panel.columns)];
        }
    }
    sum.is_finite().then_some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> MontagePanel {
        let intensity = (0..20).map(|n| 2.0 * f64::from(n % 5) + 10.0 * f64::from(n / 5)).collect();
        MontagePanel { columns: 5, rows: 4, intensity, origin_mm: [10.0, -3.0], spacing_mm: [2.0, 1.0], contours: Vec::new() }
    }

    #[test]
    fn interpolation_is_exact_at_pixels_and_for_planes_inside() {
        let panel = ramp();
        assert!((bicubic(&panel, 3.0, 2.0).unwrap() - 26.0).abs() < 1e-12);
        assert!((bicubic(&panel, 1.25, 1.5).unwrap() - 17.5).abs() < 1e-12);
        assert_eq!(bicubic(&panel, -0.6, 1.0), None);
    }

    #[test]
    fn mm_and_pixels_are_inverse_and_proportions_are_kept() {
        let frame = Frame::of(&ramp(), (200, 200));
        assert_eq!(frame.to_px([9.0, -3.5]), [0.0, 60.0]);
        assert_eq!(frame.to_px([19.0, 0.5]), [200.0, 140.0]);
        assert_eq!(frame.to_px(frame.to_mm(50.0, 100.0)), [50.0, 100.0]);
    }

    #[test]
    fn a_line_that_leaves_its_panel_and_comes_back_is_cut_into_pieces() {
        let line = [[1.0, 1.0], [1.0, 3.0], [3.0, 3.0], [3.0, 1.0], [f64::NAN, 0.0], [0.5, 0.5], [1.5, 0.5]];
        let pieces = inside_pieces(&line, [4.0, 2.0]);
        assert_eq!(pieces, [[[1.0, 1.0], [1.0, 2.0]], [[3.0, 2.0], [3.0, 1.0]], [[0.5, 0.5], [1.5, 0.5]]]);
        assert_eq!(inside_pieces(&line[..2], [4.0, 4.0]), [[[1.0, 1.0], [1.0, 3.0]]]);
    }

    #[test]
    fn panels_that_do_not_fit_are_refused() {
        let montage = Montage {
            title: String::new(),
            surfaces: vec![],
            column_titles: vec!["0 ms".into(); 2],
            row_titles: vec!["slice".into()],
            panels: vec![ramp()],
            window: (0.0, 1.0),
        };
        assert!(check(&montage).unwrap_err().contains("1 panels for 1 rows and 2 columns"));
        let mut short = ramp();
        short.intensity.pop();
        assert!(check(&Montage { panels: vec![ramp(), short], ..montage }).unwrap_err().contains("19 intensities"));
    }
}
