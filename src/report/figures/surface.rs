//! A quantity on a surface in bands of one colour each, seen from several sides: activation times with their isochrones.

use std::path::Path;

use nalgebra::Vector3;
use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::chart::tick;
use super::style::*;
use crate::report::ReportError;

/// A surface with one value a vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceMap {
    /// Title.
    pub title: String,
    /// What is shown, with its unit.
    pub quantity: String,
    /// Positions, mm.
    pub vertices_mm: Vec<Vector3<f64>>,
    /// Corners of the triangles.
    pub triangles: Vec<[usize; 3]>,
    /// The value of every vertex; one that is not finite is grey.
    pub values: Vec<f64>,
    /// Width of a band of one colour.
    pub band: f64,
    /// Sides that it is seen from, left to right.
    pub views: Vec<SurfaceView>,
}

/// A side that a surface is seen from.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceView {
    /// Name.
    pub name: String,
    /// Direction from the surface to the eye; any length.
    pub to_eye: Vector3<f64>,
    /// Direction that is up in the picture; any length, not that of the eye.
    pub up: Vector3<f64>,
}

const PANEL: (u32, u32) = (640, 700);
const HEAD: u32 = 110;
const SCALE: u32 = 190;

/// Draws the surface from every side, with a scale.
///
/// # Errors
/// [`ReportError`] if the arrays do not fit, a view has no direction, or the figure cannot be drawn or written.
pub fn surface_map(file: &Path, figure: &SurfaceMap) -> Result<(), ReportError> {
    let failed = |reason: String| ReportError::Figure { figure: "the surface map", reason };
    check(figure).map_err(failed)?;
    let bands = Bands::of(figure);
    let size = (PANEL.0 * figure.views.len() as u32 + SCALE, HEAD + PANEL.1);
    let mut canvas = Canvas { width: px(size.0) as usize, pixels: vec![255; 3 * (px(size.0) * px(size.1)) as usize] };
    let drawing_scale = 0.46 * f64::from(px(PANEL.0.min(PANEL.1))) / reach_mm(figure);
    for (number, view) in figure.views.iter().enumerate() {
        let axes = axes_of(view).ok_or_else(|| failed(format!("the view `{}` has no direction", view.name)))?;
        let panel = Panel::painted(figure, &bands, &axes, drawing_scale);
        canvas.paste(&panel, (px(PANEL.0) as usize * number, px(HEAD) as usize));
    }
    picture_on(file, "the surface map", size, canvas.pixels, |area| {
        write(area, &figure.title, &bold(TITLE, &BLACK_INK), HPos::Left, (ipx(28), ipx(36)))?;
        for (number, view) in figure.views.iter().enumerate() {
            let centre = ipx(PANEL.0) * number as i32 + ipx(PANEL.0 / 2);
            write(area, &view.name, &text(TEXT, &BLACK_INK), HPos::Center, (centre, ipx(84)))?;
        }
        draw_scale(area, &bands, &figure.quantity, ipx(PANEL.0) * figure.views.len() as i32)
    })
}

fn check(figure: &SurfaceMap) -> Result<(), String> {
    let count = figure.vertices_mm.len();
    if figure.values.len() != count {
        return Err(format!("{} values for {count} vertices", figure.values.len()));
    }
    if let Some(vertex) = figure.triangles.iter().flatten().find(|&&vertex| vertex >= count) {
        return Err(format!("a triangle uses vertex {vertex} of {count}"));
    }
    if figure.views.is_empty() || !(figure.band > 0.0 && figure.band.is_finite()) {
        return Err(format!("{} views and bands of {}", figure.views.len(), figure.band));
    }
    Ok(())
}

/// Half the extent of the surface around the middle of its box, mm.
fn reach_mm(figure: &SurfaceMap) -> f64 {
    let centre = centre_mm(figure);
    used(figure).map(|p| (p - centre).norm()).fold(f64::MIN_POSITIVE, f64::max)
}

fn centre_mm(figure: &SurfaceMap) -> Vector3<f64> {
    let low = used(figure).fold(Vector3::repeat(f64::INFINITY), |low, p| low.inf(p));
    let high = used(figure).fold(Vector3::repeat(f64::NEG_INFINITY), |high, p| high.sup(p));
    (low + high) / 2.0
}

fn used(figure: &SurfaceMap) -> impl Iterator<Item = &Vector3<f64>> {
    figure.triangles.iter().flatten().map(|&vertex| &figure.vertices_mm[vertex])
}

/// Right, up and to the eye.
fn axes_of(view: &SurfaceView) -> Option<[Vector3<f64>; 3]> {
    let eye = view.to_eye.try_normalize(1e-12)?;
    let up = (view.up - eye * eye.dot(&view.up)).try_normalize(1e-9)?;
    Some([up.cross(&eye), up, eye])
}

/// The bands of a quantity and their colours.
struct Bands {
    first: f64,
    width: f64,
    count: usize,
}

impl Bands {
    fn of(figure: &SurfaceMap) -> Self {
        let values = || figure.triangles.iter().flatten().map(|&vertex| figure.values[vertex]).filter(|value| value.is_finite());
        let (low, high) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let width = figure.band;
        if low > high {
            return Self { first: 0.0, width, count: 1 };
        }
        let first = (low / width).floor() * width;
        Self { first, width, count: ((high - first) / width).ceil().clamp(1.0, 60.0) as usize }
    }

    fn index(&self, value: f64) -> usize {
        (((value - self.first) / self.width).floor().max(0.0) as usize).min(self.count - 1)
    }

    fn colour(&self, index: usize) -> [f64; 3] {
        palette((index as f64 + 0.5) / self.count as f64)
    }
}

/// Yellow (early) over green and blue to violet (late): lightness falls evenly, so that it survives print and colour blindness.
fn palette(part: f64) -> [f64; 3] {
    const STOPS: [[f64; 3]; 6] =
        [[253.0, 231.0, 37.0], [122.0, 209.0, 81.0], [34.0, 168.0, 132.0], [42.0, 120.0, 142.0], [65.0, 68.0, 135.0], [68.0, 1.0, 84.0]];
    let place = part.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let below = (place as usize).min(STOPS.len() - 2);
    std::array::from_fn(|channel| STOPS[below][channel] + (STOPS[below + 1][channel] - STOPS[below][channel]) * (place - below as f64))
}

/// RGB pixels of the whole picture.
struct Canvas {
    width: usize,
    pixels: Vec<u8>,
}

impl Canvas {
    fn paste(&mut self, panel: &Panel, (left, top): (usize, usize)) {
        for (place, dot) in panel.dots.iter().enumerate() {
            let Some(dot) = dot else { continue };
            let at = 3 * ((top + place / panel.width) * self.width + left + place % panel.width);
            let ink = if panel.is_between_bands(place) { [45.0; 3] } else { dot.colour };
            self.pixels[at..at + 3].copy_from_slice(&ink.map(|channel| channel.round().clamp(0.0, 255.0) as u8));
        }
    }
}

/// What is seen at a pixel.
#[derive(Debug, Clone, Copy)]
struct Dot {
    /// Towards the eye, mm.
    depth_mm: f64,
    band: Option<usize>,
    colour: [f64; 3],
}

/// One view in pixels drawn.
struct Panel {
    width: usize,
    height: usize,
    dots: Vec<Option<Dot>>,
}

impl Panel {
    fn painted(figure: &SurfaceMap, bands: &Bands, axes: &[Vector3<f64>; 3], pixels_per_mm: f64) -> Self {
        let (width, height) = (px(PANEL.0) as usize, px(PANEL.1) as usize);
        let mut panel = Self { width, height, dots: vec![None; width * height] };
        let centre = centre_mm(figure);
        let seen = |p: &Vector3<f64>| {
            let offset = p - centre;
            let (x, y) = (offset.dot(&axes[0]) * pixels_per_mm, offset.dot(&axes[1]) * pixels_per_mm);
            Vector3::new(width as f64 / 2.0 + x, height as f64 / 2.0 - y, offset.dot(&axes[2]))
        };
        let places: Vec<Vector3<f64>> = figure.vertices_mm.iter().map(seen).collect();
        for corners in &figure.triangles {
            let [a, b, c] = corners.map(|vertex| figure.vertices_mm[vertex]);
            let facing = (b - a).cross(&(c - a)).try_normalize(0.0).map_or(0.0, |normal| normal.dot(&axes[2]).abs());
            panel.fill(&corners.map(|v| places[v]), &corners.map(|v| figure.values[v]), 0.55 + 0.45 * facing, bands);
        }
        panel
    }

    /// Paints a triangle where nothing nearer stands; corners are (pixel, pixel, depth).
    fn fill(&mut self, corners: &[Vector3<f64>; 3], values: &[f64; 3], light: f64, bands: &Bands) {
        let [a, b, c] = corners;
        let twice_area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
        let range = |axis: usize, limit: usize| {
            let (low, high) = corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[axis]), h.max(p[axis])));
            (low.floor().max(0.0) as usize)..(high.ceil().min(limit as f64).max(0.0) as usize)
        };
        if twice_area == 0.0 || !twice_area.is_finite() {
            return;
        }
        for row in range(1, self.height) {
            for column in range(0, self.width) {
                let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
                let share = |p: &Vector3<f64>, q: &Vector3<f64>| ((q.x - p.x) * (y - p.y) - (x - p.x) * (q.y - p.y)) / twice_area;
                let (of_a, of_b) = (share(b, c), share(c, a));
                let of_c = 1.0 - of_a - of_b;
                if of_a < 0.0 || of_b < 0.0 || of_c < 0.0 {
                    continue;
                }
                let depth_mm = of_a * a.z + of_b * b.z + of_c * c.z;
                let dot = &mut self.dots[row * self.width + column];
                if dot.is_some_and(|dot| dot.depth_mm >= depth_mm) {
                    continue;
                }
                let value = of_a * values[0] + of_b * values[1] + of_c * values[2];
                let band = value.is_finite().then(|| bands.index(value));
                let colour = band.map_or([200.0; 3], |band| bands.colour(band)).map(|channel| channel * light);
                *dot = Some(Dot { depth_mm, band, colour });
            }
        }
    }

    /// Whether a line between two bands runs here: a neighbour to the right or below is in another band of the same sheet.
    fn is_between_bands(&self, place: usize) -> bool {
        const SHEET_MM: f64 = 2.0;
        let Some(here) = self.dots[place] else { return false };
        let right = (place % self.width + 1 < self.width).then_some(place + 1);
        let below = (place / self.width + 1 < self.height).then_some(place + self.width);
        let differs = |other: usize| self.dots[other].is_some_and(|o| o.band != here.band && (o.depth_mm - here.depth_mm).abs() < SHEET_MM);
        right.is_some_and(differs) || below.is_some_and(differs)
    }
}

/// The colours of the bands with their limits, on the right.
fn draw_scale(area: &Area, bands: &Bands, quantity: &str, left: i32) -> Drawn {
    let (top, height) = (ipx(HEAD + 40), ipx(PANEL.1 - 110));
    let edge = |index: usize| top + (f64::from(height) * index as f64 / bands.count as f64).round() as i32;
    // Not more names than there is room for.
    let every = (bands.count * TEXT as usize * 2 / (PANEL.1 - 110) as usize).max(1);
    for index in 0..bands.count {
        let [r, g, b] = bands.colour(index).map(|channel| channel.round() as u8);
        area.draw(&Rectangle::new([(left, edge(index)), (left + ipx(36), edge(index + 1))], RGBColor(r, g, b).filled()))?;
    }
    for index in (0..=bands.count).step_by(every) {
        let label = tick(bands.first + bands.width * index as f64);
        write(area, &label, &text(TEXT - 2, &BLACK_INK), HPos::Left, (left + ipx(48), edge(index)))?;
    }
    write_upward(area, quantity, &text(TEXT, &BLACK_INK), HPos::Center, (left + ipx(140), top + height / 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> SurfaceMap {
        let vertices_mm = vec![Vector3::zeros(), Vector3::x() * 10.0, Vector3::new(10.0, 10.0, 0.0), Vector3::y() * 10.0];
        let view = SurfaceView { name: "above".into(), to_eye: Vector3::z(), up: Vector3::y() };
        SurfaceMap {
            title: String::new(),
            quantity: String::new(),
            vertices_mm,
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            values: vec![0.0, 10.0, 10.0, 0.0],
            band: 5.0,
            views: vec![view],
        }
    }

    #[test]
    fn a_square_is_painted_whole_in_its_bands_with_one_line_between() {
        let figure = square();
        let bands = Bands::of(&figure);
        assert_eq!(bands.count, 2);
        let panel = Panel::painted(&figure, &bands, &axes_of(&figure.views[0]).unwrap(), 10.0);
        let painted: Vec<usize> = (0..panel.dots.len()).filter(|&place| panel.dots[place].is_some()).collect();
        assert_eq!(painted.len(), 100 * 100);
        let early = painted.iter().filter(|&&place| panel.dots[place].is_some_and(|dot| dot.band == Some(0))).count();
        assert_eq!(early, 50 * 100, "half of it comes before the fifth millisecond");
        let line = painted.iter().filter(|&&place| panel.is_between_bands(place)).count();
        assert_eq!(line, 100);
    }

    #[test]
    fn what_is_nearer_hides_what_is_behind() {
        let mut figure = square();
        figure.vertices_mm.extend(figure.vertices_mm.clone().iter().map(|p| p + Vector3::z()));
        figure.triangles.extend([[4, 5, 6], [4, 6, 7]]);
        figure.values = vec![0.0, 0.0, 0.0, 0.0, 10.0, 10.0, 10.0, 10.0];
        let bands = Bands::of(&figure);
        for (to_eye, expected) in [(Vector3::z(), 1), (-Vector3::z(), 0)] {
            let axes = axes_of(&SurfaceView { name: String::new(), to_eye, up: Vector3::y() }).unwrap();
            let panel = Panel::painted(&figure, &bands, &axes, 10.0);
            assert!(panel.dots.iter().flatten().all(|dot| dot.band == Some(expected)));
        }
    }

    #[test]
    fn arrays_that_do_not_fit_are_refused() {
        assert!(check(&SurfaceMap { values: vec![1.0], ..square() }).is_err());
        assert!(check(&SurfaceMap { triangles: vec![[0, 1, 9]], ..square() }).is_err());
        assert!(check(&SurfaceMap { band: 0.0, ..square() }).is_err());
    }
}
