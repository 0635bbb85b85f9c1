//! How thick the wall is behind each vertex of a surface, so that its own side is not read beyond it.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::mesh::{SurfaceTag, TaggedSurface};

/// Distance (mm) from each of `vertices`, against its outward normal, to the nearest surface of another kind than its own and the base;
/// infinite where there is none within `limit_mm`.
pub(super) fn thickness_mm(
    surface: &TaggedSurface,
    tag: SurfaceTag,
    vertices: &[usize],
    area_mm2: &[Vector3<f64>],
    position_mm: &[Vector3<f64>],
    limit_mm: f64,
) -> Vec<f64> {
    let is_opposite = |other: &SurfaceTag| *other != tag && *other != SurfaceTag::Base;
    let opposite: Vec<[Vector3<f64>; 3]> = surface
        .triangles()
        .iter()
        .zip(surface.tags())
        .filter(|(_, other)| is_opposite(other))
        .map(|(corners, _)| corners.map(|vertex| position_mm[vertex]))
        .collect();
    let cells = Cells::new(&opposite, limit_mm);
    let behind = |&vertex: &usize| {
        let Some(normal) = area_mm2[vertex].try_normalize(0.0) else { return f64::INFINITY };
        let near = cells.around(&position_mm[vertex]);
        let hits = near.filter_map(|triangle| distance_along(&position_mm[vertex], &-normal, &opposite[triangle]));
        hits.filter(|&hit_mm| hit_mm <= limit_mm).fold(f64::INFINITY, f64::min)
    };
    vertices.par_iter().map(behind).collect()
}

/// Triangles by the cubes that their first corners lie in, so large that whatever a ray can reach lies in the 27 around its origin.
struct Cells {
    edge_mm: f64,
    triangles: BTreeMap<[i64; 3], Vec<usize>>,
}

impl Cells {
    fn new(triangles: &[[Vector3<f64>; 3]], limit_mm: f64) -> Self {
        let reach_mm = triangles.iter().map(|[a, b, c]| (b - a).norm().max((c - a).norm())).fold(0.0, f64::max);
        let mut cells = Self { edge_mm: limit_mm + reach_mm, triangles: BTreeMap::new() };
        for (index, [a, _, _]) in triangles.iter().enumerate() {
            cells.triangles.entry(cells.cell(a)).or_default().push(index);
        }
        cells
    }

    fn cell(&self, at_mm: &Vector3<f64>) -> [i64; 3] {
        [0, 1, 2].map(|axis| (at_mm[axis] / self.edge_mm).floor() as i64)
    }

    fn around(&self, at_mm: &Vector3<f64>) -> impl Iterator<Item = usize> {
        let [i, j, k] = self.cell(at_mm);
        let offsets = (0..27).map(|n| [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1]);
        offsets.filter_map(move |[a, b, c]| self.triangles.get(&[i + a, j + b, k + c])).flatten().copied()
    }
}

/// Where a ray meets a triangle, by Cramer's rule: o + t d = a + u (b − a) + v (c − a) with t > 0, u, v ≥ 0, u + v ≤ 1.
fn distance_along(origin: &Vector3<f64>, direction: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]) -> Option<f64> {
    let (ab, ac, ao) = (b - a, c - a, origin - a);
    let (across, beside) = (direction.cross(&ac), ao.cross(&ab));
    let determinant = ab.dot(&across);
    let [t, u, v] = [ac.dot(&beside), ao.dot(&across), direction.dot(&beside)].map(|numerator| numerator / determinant);
    (t > 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::slab;
    use super::*;

    /// A plate whose thickness grows from 2 to 6 mm: measured from its top and, against the slant, from below.
    #[test]
    fn the_thickness_of_a_wedge_is_measured_across_it() {
        let (mesh, surface) = slab(8, |p| Vector3::new(20.0 * p.x, 20.0 * p.y, (4.0 + 2.0 * p.x) * (p.z - 1.0)));
        let measured = |tag| {
            let vertices = surface.vertices_with(tag);
            let area_mm2 = surface.vertex_area_vectors_mm2(tag, mesh.vertices_mm());
            let found = thickness_mm(&surface, tag, &vertices, &area_mm2, mesh.vertices_mm(), 7.0);
            vertices.into_iter().zip(found).filter(|(v, _)| mesh.vertices_mm()[*v].xy().amax() < 15.0).collect::<Vec<_>>()
        };
        for (vertex, found_mm) in measured(SurfaceTag::EndocardiumLv) {
            let expected_mm = 4.0 + 0.1 * mesh.vertices_mm()[vertex].x;
            assert!((found_mm - expected_mm).abs() < 1e-9, "{found_mm} mm for {expected_mm}");
        }
        for (vertex, found_mm) in measured(SurfaceTag::Epicardium) {
            // The bottom slopes by 1 in 10, so its normal meets the top √1.01 farther away.
            let expected_mm = -mesh.vertices_mm()[vertex].z * 1.01_f64.sqrt();
            assert!((found_mm - expected_mm).abs() < 1e-9, "{found_mm} mm for {expected_mm}");
        }
    }
}
