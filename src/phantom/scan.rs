//! Which samples of a plane lie inside a tetrahedron or a closed surface, row by row.
//!
//! Everything is in sample coordinates: the samples of a plane z = const stand at integer x and y.

use nalgebra::Vector3;

/// Slack (samples) by which a tetrahedron is wider than it is, so that no sample on a shared triangle falls between two of them.
const SLACK: f64 = 1e-9;

/// Width and height of a plane of samples, x fastest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PlaneShape {
    pub(super) width: usize,
    pub(super) height: usize,
}

impl PlaneShape {
    pub(super) fn sample_count(self) -> usize {
        self.width * self.height
    }

    /// The whole numbers within [lower, upper] and 0..count.
    fn clip(lower: f64, upper: f64, count: usize) -> std::ops::Range<usize> {
        let first = lower.ceil().max(0.0);
        let end = (upper.floor() + 1.0).min(count as f64);
        if first < end { first as usize..end as usize } else { 0..0 }
    }
}

/// Calls `paint` with every sample of the plane `z` inside a tetrahedron and its barycentric coordinates there. A flat one is skipped.
pub(super) fn scan_tetrahedron(corners: &[Vector3<f64>; 4], z: f64, shape: PlaneShape, paint: &mut impl FnMut(usize, &[f64; 4])) {
    let Some((constants, gradients)) = barycentric(corners) else { return };
    let (lowest, highest) = range(corners, |c| c.y);
    for row in PlaneShape::clip(lowest, highest, shape.height) {
        // Along a row each barycentric coordinate is linear, c + g x, and the row is inside where all four are positive.
        let along: [f64; 4] = std::array::from_fn(|c| constants[c] + gradients[c].y * row as f64 + gradients[c].z * z);
        let (mut first, mut last) = range(corners, |c| c.x);
        for (value, gradient) in along.iter().zip(&gradients) {
            let zero = -value / gradient.x;
            if gradient.x > 0.0 {
                first = first.max(zero);
            } else if gradient.x < 0.0 {
                last = last.min(zero);
            } else if *value < 0.0 {
                last = f64::NEG_INFINITY;
            }
        }
        for column in PlaneShape::clip(first - SLACK, last + SLACK, shape.width) {
            let coordinates = std::array::from_fn(|c| along[c] + gradients[c].x * column as f64);
            paint(row * shape.width + column, &coordinates);
        }
    }
}

/// Constants and gradients of the barycentric coordinates; none for a flat tetrahedron.
fn barycentric(corners: &[Vector3<f64>; 4]) -> Option<([f64; 4], [Vector3<f64>; 4])> {
    let [a, b, c, d] = corners;
    let (u, v, w) = (b - a, c - a, d - a);
    let six_volumes = u.cross(&v).dot(&w);
    let gradients = [v.cross(&w) / six_volumes, w.cross(&u) / six_volumes, u.cross(&v) / six_volumes];
    if !gradients.iter().all(|g| g.iter().all(|x| x.is_finite())) {
        return None;
    }
    let [gb, gc, gd] = gradients;
    let ga = -(gb + gc + gd);
    Some(([1.0 - ga.dot(a), -gb.dot(a), -gc.dot(a), -gd.dot(a)], [ga, gb, gc, gd]))
}

fn range(corners: &[Vector3<f64>; 4], coordinate: impl Fn(&Vector3<f64>) -> f64) -> (f64, f64) {
    corners.iter().map(coordinate).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
}

/// Calls `paint` with every sample of the plane `z` that a closed surface winds around.
///
/// Triangles that share an edge find bit for bit the same crossing of that edge with the plane, and ends of rows are half-open, so a
/// closed surface never leaks, whatever degenerate positions it takes.
pub(super) fn scan_closed_surface(
    points: &[Vector3<f64>],
    triangles: &[[usize; 3]],
    z: f64,
    shape: PlaneShape,
    paint: &mut impl FnMut(usize),
) {
    let stride = shape.width + 1;
    let mut turns = vec![0_i32; stride * shape.height];
    let mut is_crossed = false;
    for triangle in triangles {
        let Some([start, end]) = section(points, triangle, z) else { continue };
        is_crossed = true;
        let (low, high, turn) = if start[1] <= end[1] { (start, end, 1) } else { (end, start, -1) };
        let rows = PlaneShape::clip(low[1], high[1], shape.height);
        for row in rows.filter(|&row| (row as f64) < high[1]) {
            let share = (row as f64 - low[1]) / (high[1] - low[1]);
            let x = low[0] + share * (high[0] - low[0]);
            let column = x.ceil().clamp(0.0, shape.width as f64) as usize;
            turns[row * stride + column] += turn;
        }
    }
    if !is_crossed {
        return;
    }
    for row in 0..shape.height {
        let mut winding = 0;
        for column in 0..shape.width {
            winding += turns[row * stride + column];
            if winding != 0 {
                paint(row * shape.width + column);
            }
        }
    }
}

/// Where the plane cuts a triangle, from the edge that rises through it to the edge that falls; none if it does not.
fn section(points: &[Vector3<f64>], &[a, b, c]: &[usize; 3], z: f64) -> Option<[[f64; 2]; 2]> {
    let is_above = |vertex: usize| points[vertex].z >= z;
    let (mut rising, mut falling) = (None, None);
    for (from, to) in [(a, b), (b, c), (c, a)] {
        match (is_above(from), is_above(to)) {
            (false, true) => rising = Some(crossing(points, from, to, z)),
            (true, false) => falling = Some(crossing(points, from, to, z)),
            _ => {}
        }
    }
    Some([rising?, falling?])
}

fn crossing(points: &[Vector3<f64>], from: usize, to: usize, z: f64) -> [f64; 2] {
    let (p, q) = (points[from.min(to)], points[from.max(to)]);
    let share = (z - p.z) / (q.z - p.z);
    [p.x + share * (q.x - p.x), p.y + share * (q.y - p.y)]
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: PlaneShape = PlaneShape { width: 9, height: 8 };

    /// A cube cut into six tetrahedra around its diagonal; whole-numbered, so that samples lie on triangles, edges and corners.
    fn cube(size: f64) -> (Vec<Vector3<f64>>, Vec<[usize; 4]>) {
        let points = (0..8).map(|c| Vector3::new((c & 1) as f64, (c >> 1 & 1) as f64, (c >> 2) as f64) * size).collect();
        let paths = [[1, 3], [3, 2], [2, 6], [6, 4], [4, 5], [5, 1]];
        (points, paths.map(|[a, b]| [0, a, b, 7]).to_vec())
    }

    #[test]
    fn samples_on_shared_triangles_are_never_lost() {
        let (points, tetrahedra) = cube(6.0);
        let mut count = vec![0; SHAPE.sample_count()];
        for corners in &tetrahedra {
            let corners = corners.map(|v| points[v] + Vector3::new(1.0, 1.0, 0.0));
            scan_tetrahedron(&corners, 3.0, SHAPE, &mut |sample, coordinates| {
                let point: Vector3<f64> = (0..4).map(|c| corners[c] * coordinates[c]).sum();
                assert!((point - Vector3::new((sample % 9) as f64, (sample / 9) as f64, 3.0)).norm() < 1e-12);
                count[sample] += 1;
            });
        }
        for (sample, &count) in count.iter().enumerate() {
            let is_inside = [sample % 9, sample / 9].iter().all(|c| (1..=7).contains(c));
            assert_eq!(count > 0, is_inside, "sample {sample}");
        }
    }

    #[test]
    fn a_closed_surface_does_not_leak_at_corners_and_edges() {
        let (points, _) = cube(6.0);
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles: Vec<[usize; 3]> = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        for (z, is_cut) in [(-0.1, false), (0.0, false), (0.1, true), (3.0, true), (6.0, true), (6.1, false)] {
            let mut count = 0;
            scan_closed_surface(&points, &triangles, z, SHAPE, &mut |sample| {
                assert!(sample % 9 < 6 && sample / 9 < 6, "half-open at the far ends");
                count += 1;
            });
            assert_eq!(count, if is_cut { 36 } else { 0 }, "z = {z}");
        }
    }
}
