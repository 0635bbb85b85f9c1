//! The smooth outline of a binary slice and the exact signed distance to it.
//!
//! The staircase of pixels is smoothed by a Gaussian of one pixel; of the level sets of the result the one is taken that encloses the
//! area of the pixels, so that smoothing costs no volume. Distances are exact to its polygon (marching squares).

use nalgebra::Vector2;

/// Standard deviation of the Gaussian that smooths a slice, pixels.
const SMOOTHING_PIXELS: f64 = 1.0;

/// Numbers on the pixel centres of a slice, i fastest.
#[derive(Debug, Clone)]
pub(super) struct SliceField {
    pub(super) shape: [usize; 2],
    pub(super) values: Vec<f64>,
}

impl SliceField {
    fn at(&self, i: usize, j: usize) -> f64 {
        self.values[i + self.shape[0] * j]
    }

    /// Bilinear value at continuous pixel coordinates, held constant beyond the border.
    pub(super) fn sample(&self, pixel: Vector2<f64>) -> f64 {
        let mut lower = [0; 2];
        let mut local = [0.0; 2];
        for axis in 0..2 {
            let last = (self.shape[axis] - 1) as f64;
            let inside = pixel[axis].clamp(0.0, last);
            lower[axis] = (inside as usize).min(self.shape[axis].saturating_sub(2));
            local[axis] = inside - lower[axis] as f64;
        }
        let [i, j] = lower;
        let (next_i, next_j) = ((i + 1).min(self.shape[0] - 1), (j + 1).min(self.shape[1] - 1));
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        mix(mix(self.at(i, j), self.at(next_i, j), local[0]), mix(self.at(i, next_j), self.at(next_i, next_j), local[0]), local[1])
    }

    /// The smallest value.
    pub(super) fn min(&self) -> f64 {
        self.values.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// Signed distance (mm, negative inside) to the smooth outline of `mask` (i fastest) on pixels of `spacing_mm`. The mask holds at least
/// one pixel and none within two pixels of the border.
pub(super) fn signed_distance_mm(shape: [usize; 2], mask: &[bool], spacing_mm: Vector2<f64>) -> SliceField {
    let field = smoothed(shape, mask);
    let pixel_count = mask.iter().filter(|&&inside| inside).count() as f64;
    let level = level_enclosing(&field, pixel_count);
    let (_, segments) = contour(&field, level);
    let to_mm = |p: Vector2<f64>| p.component_mul(&spacing_mm);
    let segments: Vec<(Vector2<f64>, Vector2<f64>)> = segments.into_iter().map(|(a, b)| (to_mm(a), to_mm(b) - to_mm(a))).collect();
    let distance = |flat: usize| {
        let pixel = to_mm(Vector2::new((flat % shape[0]) as f64, (flat / shape[0]) as f64));
        let squared = segments.iter().map(|(start, edge)| squared_distance(pixel - start, edge)).fold(f64::INFINITY, f64::min);
        if field.values[flat] > level { -squared.sqrt() } else { squared.sqrt() }
    };
    SliceField { shape, values: (0..mask.len()).map(distance).collect() }
}

/// Squared distance of the point `offset` (from the edge's start) to an edge.
fn squared_distance(offset: Vector2<f64>, edge: &Vector2<f64>) -> f64 {
    let length_squared = edge.norm_squared();
    let along = if length_squared > 0.0 { (offset.dot(edge) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
    (offset - along * edge).norm_squared()
}

fn smoothed(shape: [usize; 2], mask: &[bool]) -> SliceField {
    let radius = (4.0 * SMOOTHING_PIXELS).ceil() as isize;
    let weight = |offset: isize| (-0.5 * (offset as f64 / SMOOTHING_PIXELS).powi(2)).exp();
    let total: f64 = (-radius..=radius).map(weight).sum();
    let mut field = SliceField { shape, values: mask.iter().map(|&inside| f64::from(u8::from(inside))).collect() };
    for axis in 0..2 {
        let (length, stride) = (shape[axis] as isize, if axis == 0 { 1 } else { shape[0] as isize });
        let blurred = |flat: usize| {
            let at = (flat as isize / stride) % length;
            let inside = (-radius).max(-at)..=radius.min(length - 1 - at);
            inside.map(|offset| weight(offset) * field.values[(flat as isize + offset * stride) as usize]).sum::<f64>() / total
        };
        field.values = (0..mask.len()).map(blurred).collect();
    }
    field
}

/// The level whose contour encloses `area` pixels, by bisection: the enclosed area falls as the level rises.
fn level_enclosing(field: &SliceField, area: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..50 {
        let level = 0.5 * (low + high);
        if contour(field, level).0 > area { low = level } else { high = level }
    }
    0.5 * (low + high)
}

type Segment = (Vector2<f64>, Vector2<f64>);

/// Enclosed area (pixels) and segments (pixel coordinates) of the set above `level`, by marching squares.
fn contour(field: &SliceField, level: f64) -> (f64, Vec<Segment>) {
    const CORNERS: [[usize; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];
    let mut area = 0.0;
    let mut segments = Vec::new();
    for j in 0..field.shape[1] - 1 {
        for i in 0..field.shape[0] - 1 {
            let above = CORNERS.map(|[di, dj]| field.at(i + di, j + dj) - level);
            if above.iter().all(|&v| v <= 0.0) {
                continue;
            }
            let place = |n: usize| Vector2::new((i + CORNERS[n][0]) as f64, (j + CORNERS[n][1]) as f64);
            let crossing = |n: usize, m: usize| place(n) + (place(m) - place(n)) * (above[n] / (above[n] - above[m]));
            let mut polygon: Vec<Vector2<f64>> = Vec::with_capacity(8);
            let (mut exits, mut entries) = (Vec::new(), Vec::new());
            for n in 0..4 {
                let m = (n + 1) % 4;
                if above[n] > 0.0 {
                    polygon.push(place(n));
                }
                if (above[n] > 0.0) != (above[m] > 0.0) {
                    polygon.push(crossing(n, m));
                    if above[n] > 0.0 { exits.push(crossing(n, m)) } else { entries.push(crossing(n, m)) }
                }
            }
            // Walking round the cell, an exit is followed by the entry that closes it; if an entry came first, the last exit closes with it.
            let first_is_entry = above[0] <= 0.0;
            let count = entries.len();
            segments.extend((0..count).map(|n| (exits[n], entries[if first_is_entry { (n + 1) % count } else { n }])));
            let corner = |n: usize| polygon[n % polygon.len()];
            area += 0.5 * (0..polygon.len()).map(|n| corner(n).perp(&corner(n + 1))).sum::<f64>();
        }
    }
    (area, segments)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(radius_mm: f64, spacing_mm: Vector2<f64>) -> (Vec<bool>, Vector2<f64>) {
        let centre = Vector2::new(30.3, 29.6);
        let inside = |flat: usize| {
            let pixel = Vector2::new((flat % 60) as f64, (flat / 60) as f64);
            (pixel - centre).component_mul(&spacing_mm).norm() < radius_mm
        };
        ((0..3600).map(inside).collect(), centre)
    }

    #[test]
    fn distance_to_a_disc_is_that_to_its_circle_within_a_third_of_a_pixel() {
        for (radius_mm, spacing_mm) in [(20.0, Vector2::new(1.0, 1.0)), (12.0, Vector2::new(0.8, 1.1)), (6.0, Vector2::new(1.0, 1.0))] {
            let (mask, centre) = disc(radius_mm, spacing_mm);
            let field = signed_distance_mm([60, 60], &mask, spacing_mm);
            for flat in 0..3600 {
                let pixel = Vector2::new((flat % 60) as f64, (flat / 60) as f64);
                let exact_mm = (pixel - centre).component_mul(&spacing_mm).norm() - radius_mm;
                assert!((field.values[flat] - exact_mm).abs() < 0.33 * spacing_mm.max(), "{} {exact_mm}", field.values[flat]);
            }
        }
    }

    #[test]
    fn outline_encloses_the_area_of_the_pixels_even_of_one() {
        for radius in [0.8, 3.0, 11.0] {
            let (mask, _) = disc(radius, Vector2::new(1.0, 1.0));
            let pixels = mask.iter().filter(|&&inside| inside).count() as f64;
            let field = smoothed([60, 60], &mask);
            let (area, _) = contour(&field, level_enclosing(&field, pixels));
            assert!((area - pixels).abs() < 1e-9 * pixels, "{area} {pixels}");
        }
    }

    #[test]
    fn contour_of_a_saddle_keeps_inside_and_outside_apart() {
        let field = SliceField { shape: [2, 2], values: vec![1.0, 0.0, 0.0, 1.0] };
        let (area, segments) = contour(&field, 0.5);
        assert_eq!(segments.len(), 2);
        assert!((area - 0.75).abs() < 1e-12);
        for (a, b) in segments {
            assert!(((b - a).norm() - 0.5_f64.sqrt()).abs() < 1e-12);
        }
    }
}
