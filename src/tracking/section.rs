//! Sections of surfaces with the slices of a grid: contours in world mm and the voxels inside.

use nalgebra::Vector3;

use crate::image::{Grid, LabelMap};

/// Straight pieces of a contour, ends in world mm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contour {
    segments_mm: Vec<[Vector3<f64>; 2]>,
}

impl Contour {
    /// The pieces.
    pub fn segments_mm(&self) -> &[[Vector3<f64>; 2]] {
        &self.segments_mm
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.segments_mm.is_empty()
    }

    /// The section of triangles with the slice `k` of a grid.
    pub fn of_surface(triangles: &[[usize; 3]], position_mm: &[Vector3<f64>], grid: &Grid, k: usize) -> Self {
        let segments = sections(triangles, position_mm, grid, k);
        Self { segments_mm: segments.iter().map(|ends| ends.map(|end| grid.to_world_mm(&end))).collect() }
    }

    /// The border of the voxels with a code in the slice `k`, halfway between voxel centres (marching squares).
    pub fn of_label(labels: &LabelMap, code: u8, k: usize) -> Self {
        let grid = labels.grid();
        let [ni, nj, _] = grid.shape();
        let inside = |i: isize, j: isize| {
            let within = (0..ni as isize).contains(&i) && (0..nj as isize).contains(&j);
            within && labels.at([i as usize, j as usize, k]) == code
        };
        let mut segments_mm = Vec::new();
        for j in -1..nj as isize {
            for i in -1..ni as isize {
                let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
                let middle = |n: usize| {
                    let ((a, b), (c, d)) = (corners[n], corners[(n + 1) % 4]);
                    grid.to_world_mm(&Vector3::new(0.5 * (a + c) as f64, 0.5 * (b + d) as f64, k as f64))
                };
                let is_in = corners.map(|(i, j)| inside(i, j));
                let crossed: Vec<usize> = (0..4).filter(|&n| is_in[n] != is_in[(n + 1) % 4]).collect();
                // Of a saddle each inner corner keeps its own piece.
                match (crossed.as_slice(), is_in[0]) {
                    (&[a, b], _) => segments_mm.push([middle(a), middle(b)]),
                    ([_, _, _, _], true) => segments_mm.extend([[middle(3), middle(0)], [middle(1), middle(2)]]),
                    ([_, _, _, _], false) => segments_mm.extend([[middle(0), middle(1)], [middle(2), middle(3)]]),
                    _ => {}
                }
            }
        }
        Self { segments_mm }
    }

    /// Mean distance (mm, weighted by length) from this contour to the nearest point of another; nothing if either is empty.
    pub fn mean_distance_mm(&self, other: &Self) -> Option<f64> {
        const PIECE_MM: f64 = 0.5;
        let (mut sum, mut length_mm) = (0.0, 0.0);
        for [a, b] in &self.segments_mm {
            let pieces = ((b - a).norm() / PIECE_MM).ceil().max(1.0) as usize;
            let piece_mm = (b - a).norm() / pieces as f64;
            for piece in 0..pieces {
                let point = a + (b - a) * ((piece as f64 + 0.5) / pieces as f64);
                sum += piece_mm * other.distance_mm(&point)?;
                length_mm += piece_mm;
            }
        }
        (length_mm > 0.0).then(|| sum / length_mm)
    }

    fn distance_mm(&self, point: &Vector3<f64>) -> Option<f64> {
        self.segments_mm.iter().map(|ends| distance_to_segment_mm(point, ends)).min_by(f64::total_cmp)
    }
}

fn distance_to_segment_mm(point: &Vector3<f64>, [a, b]: &[Vector3<f64>; 2]) -> f64 {
    let along = b - a;
    let share = (point - a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE);
    (a + along * share.clamp(0.0, 1.0) - point).norm()
}

/// Sections in voxel coordinates.
fn sections(triangles: &[[usize; 3]], position_mm: &[Vector3<f64>], grid: &Grid, k: usize) -> Vec<[Vector3<f64>; 2]> {
    let height = k as f64;
    let mut segments = Vec::new();
    for triangle in triangles {
        let corners = triangle.map(|vertex| grid.to_voxel(&position_mm[vertex]));
        let mut ends = Vec::with_capacity(2);
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (corners[a], corners[b]);
            if (from.z < height) != (to.z < height) {
                let mut end = from + (to - from) * ((height - from.z) / (to.z - from.z));
                end.z = height;
                ends.push(end);
            }
        }
        if let [a, b] = ends[..] {
            segments.push([a, b]);
        }
    }
    segments
}

/// Which voxels of slice `k` have their centre inside a closed surface, i fastest: parity of the crossings along i.
pub(super) fn inside_slice(closed: &[[usize; 3]], position_mm: &[Vector3<f64>], grid: &Grid, k: usize) -> Vec<bool> {
    let [ni, nj, _] = grid.shape();
    let segments = sections(closed, position_mm, grid, k);
    let mut inside = vec![false; ni * nj];
    for j in 0..nj {
        let row = j as f64;
        for [a, b] in segments.iter().filter(|[a, b]| (a.y < row) != (b.y < row)) {
            let crossing = a.x + (b.x - a.x) * (row - a.y) / (b.y - a.y);
            let first = crossing.ceil().clamp(0.0, ni as f64) as usize;
            for voxel in &mut inside[ni * j + first..ni * (j + 1)] {
                *voxel = !*voxel;
            }
        }
    }
    inside
}
