//! Closed surfaces, and which points of a regular lattice they enclose.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::{Cavity, SurfaceTag, TaggedSurface};

/// Triangles without a rim, oriented outward.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedSurface {
    points_mm: Vec<Vector3<f64>>,
    triangles: Vec<[usize; 3]>,
}

/// Points $o + i\,s_0 + j\,s_1 + k\,s_2$ in world mm, i fastest; the voxel centres of an image, say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointLattice {
    /// The point (0, 0, 0).
    pub origin_mm: Vector3<f64>,
    /// Columns are the three steps.
    pub steps_mm: Matrix3<f64>,
    /// Points along i, j, k.
    pub counts: [usize; 3],
}

impl ClosedSurface {
    /// The blood of a cavity: its endocardium and the lid.
    pub fn of_cavity(cavity: &Cavity, position_mm: &[Vector3<f64>]) -> Self {
        let mut closed = Self { points_mm: position_mm.to_vec(), triangles: cavity.endocardium().to_vec() };
        closed.add_lid(cavity, position_mm);
        closed
    }

    /// The wall itself: the whole boundary of the mesh.
    pub fn of_wall(surface: &TaggedSurface, position_mm: &[Vector3<f64>]) -> Self {
        Self { points_mm: position_mm.to_vec(), triangles: surface.triangles().to_vec() }
    }

    /// Wall and blood together: epicardium, base, and the lids of all cavities.
    pub fn of_hull(surface: &TaggedSurface, cavities: &[&Cavity], position_mm: &[Vector3<f64>]) -> Self {
        let outer = surface.triangles_with(SurfaceTag::Epicardium).chain(surface.triangles_with(SurfaceTag::Base));
        let mut closed = Self { points_mm: position_mm.to_vec(), triangles: outer.collect() };
        for cavity in cavities {
            closed.add_lid(cavity, position_mm);
        }
        closed
    }

    fn add_lid(&mut self, cavity: &Cavity, position_mm: &[Vector3<f64>]) {
        let hub = self.points_mm.len();
        self.points_mm.push(cavity.lid_centre_mm(position_mm));
        let rim = cavity.rim();
        for (i, &a) in rim.iter().enumerate() {
            let b = rim[(i + 1) % rim.len()];
            self.triangles.push([hub, a, b]);
        }
    }

    /// The points, world mm.
    pub fn points_mm(&self) -> &[Vector3<f64>] {
        &self.points_mm
    }

    /// The triangles.
    pub fn triangles(&self) -> &[[usize; 3]] {
        &self.triangles
    }

    /// The enclosed volume, mm³.
    pub fn volume_mm3(&self) -> f64 {
        let centre = self.points_mm.iter().sum::<Vector3<f64>>() / self.points_mm.len().max(1) as f64;
        let corner = |vertex: usize| self.points_mm[vertex] - centre;
        self.triangles.iter().map(|&[a, b, c]| corner(a).dot(&corner(b).cross(&corner(c)))).sum::<f64>() / 6.0
    }

    /// For every lattice point (i fastest) whether the surface winds around it, found by rays along i.
    ///
    /// Rays through an edge or a vertex are counted once: a triangle owns the half-open part of the rays that its edges, computed alike for
    /// both their triangles, leave it. No points if the steps are linearly dependent.
    pub fn contains_lattice(&self, lattice: &PointLattice) -> Vec<bool> {
        let [ni, nj, nk] = lattice.counts;
        let Some(to_index) = lattice.steps_mm.try_inverse() else {
            return vec![false; ni * nj * nk];
        };
        let points: Vec<Vector3<f64>> = self.points_mm.iter().map(|p| to_index * (p - lattice.origin_mm)).collect();
        let layers = self.triangles_by_layer(&points, nk);
        let orientation = lattice.steps_mm.determinant().signum();
        let fill_layer = |(k, triangles): (usize, &Vec<usize>)| {
            let mut crossings: Vec<Vec<(f64, f64)>> = vec![vec![]; nj];
            for &triangle in triangles {
                add_crossings(self.triangles[triangle], &points, k as f64, orientation, &mut crossings);
            }
            let mut inside = vec![false; ni * nj];
            for (row, crossings) in inside.chunks_mut(ni.max(1)).zip(&mut crossings) {
                fill_row(row, crossings);
            }
            inside
        };
        layers.par_iter().enumerate().flat_map_iter(fill_layer).collect()
    }

    fn triangles_by_layer(&self, points: &[Vector3<f64>], layer_count: usize) -> Vec<Vec<usize>> {
        let mut layers = vec![vec![]; layer_count];
        for (triangle, corners) in self.triangles.iter().enumerate() {
            let heights = corners.map(|vertex| points[vertex].z);
            let low = heights.into_iter().fold(f64::INFINITY, f64::min).ceil().max(0.0);
            let high = heights.into_iter().fold(f64::NEG_INFINITY, f64::max).floor().min(layer_count as f64 - 1.0);
            if low <= high {
                layers[low as usize..=high as usize].iter_mut().for_each(|layer| layer.push(triangle));
            }
        }
        layers
    }
}

/// Adds where the rays of layer z = k meet a triangle, with +1 where they leave and −1 where they enter.
fn add_crossings(corners: [usize; 3], points: &[Vector3<f64>], k: f64, orientation: f64, rows: &mut [Vec<(f64, f64)>]) {
    let mut ends: Vec<(Vector3<f64>, bool)> = Vec::with_capacity(2);
    for i in 0..3 {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        // Both triangles of an edge must find the same crossing to the last bit.
        let (first, second) = (points[a.min(b)], points[a.max(b)]);
        if (first.z <= k) != (second.z <= k) {
            let place = first.lerp(&second, (k - first.z) / (second.z - first.z));
            ends.push((place, points[a].z <= k));
        }
    }
    let &[(first, first_rises), (second, _)] = &ends[..] else {
        return;
    };
    let (left, right, left_rises) = if first.y <= second.y { (first, second, first_rises) } else { (second, first, !first_rises) };
    let sign = if left_rises { -orientation } else { orientation };
    let start = left.y.ceil().max(0.0);
    let end = right.y.ceil().min(rows.len() as f64);
    if start >= end {
        return;
    }
    for j in start as usize..end as usize {
        let share = (j as f64 - left.y) / (right.y - left.y);
        rows[j].push((left.x + share * (right.x - left.x), sign));
    }
}

/// Marks the points of a row that are wound around.
fn fill_row(row: &mut [bool], crossings: &mut [(f64, f64)]) {
    crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut winding = 0.0;
    let mut crossings = crossings.iter().peekable();
    for (i, inside) in row.iter_mut().enumerate() {
        while let Some((_, sign)) = crossings.next_if(|(x, _)| *x <= i as f64) {
            winding -= sign;
        }
        *inside = winding > 0.5;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(low: f64, high: f64) -> ClosedSurface {
        let points_mm = (0..8).map(|c| Vector3::from_fn(|axis, _| if c >> axis & 1 == 1 { high } else { low })).collect();
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        ClosedSurface { points_mm, triangles }
    }

    #[test]
    fn a_cube_on_the_lattice_is_half_open() {
        let lattice = PointLattice { origin_mm: Vector3::zeros(), steps_mm: Matrix3::identity(), counts: [8, 9, 10] };
        let inside = cube(2.0, 5.0).contains_lattice(&lattice);
        // Rays pass along faces, edges and vertices here: each of the 3 × 3 × 3 points is counted once.
        assert_eq!(inside.iter().filter(|&&is_inside| is_inside).count(), 27);
        assert!((cube(2.0, 5.0).volume_mm3() - 27.0).abs() < 1e-12);
    }

    #[test]
    fn an_oblique_left_handed_lattice_counts_the_volume() {
        let steps_mm = Matrix3::new(0.05, 0.01, 0.0, -0.01, 0.04, 0.02, 0.0, 0.02, -0.05);
        assert!(steps_mm.determinant() < 0.0);
        let lattice = PointLattice { origin_mm: Vector3::new(-1.0, -0.5, 2.6), steps_mm, counts: [60, 70, 70] };
        let inside = cube(0.0, 1.0).contains_lattice(&lattice);
        for (flat, &is_inside) in inside.iter().enumerate() {
            let index = Vector3::new((flat % 60) as f64, (flat / 60 % 70) as f64, (flat / 4200) as f64);
            let p = lattice.origin_mm + steps_mm * index;
            let is_near_face = p.iter().any(|x| x.abs() < 1e-9 || (x - 1.0).abs() < 1e-9);
            assert!(is_near_face || is_inside == p.iter().all(|&x| 0.0 < x && x < 1.0), "{p}");
        }
    }
}
