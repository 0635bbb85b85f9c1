//! How far the tissue is from the base, and what depends on that: the fibrous ring of the valves and the grading of the pericardium.
//!
//! Muscle fibres end in the fibrous ring around the valves, which the cut through the ventricles leaves away; at a free edge steep fibres
//! would draw the wall down into spikes. The ring is stiff and does not contract. With d the distance to the base surface and H its height
//!
//! $$w = s^2 (3 - 2 s), \quad s = \min(d / H, 1), \qquad \sigma_C \leftarrow w\,\sigma_C, \quad D \leftarrow D + (1 - w)\,D_{ring},$$
//!
//! where $D_{ring}$ is isotropic with the tissue's Poisson ratio. The pericardium holds the apex more firmly than the base, which slides
//! along it \[Strocchi2020\]: its springs $k$ are those of the apex times $b + (1 - b)\,d / d_{max}$.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh, distance_to_triangle_mm};

/// Distance d of every vertex to the base surface, mm.
pub(super) struct BaseDistance {
    distance_mm: Vec<f64>,
}

/// A triangle of the base in a sphere.
struct BaseTriangle {
    corners_mm: [Vector3<f64>; 3],
    centre_mm: Vector3<f64>,
    radius_mm: f64,
}

impl BaseDistance {
    /// None for a mesh without a base.
    pub(super) fn new(mesh: &TetMesh, surface: &TaggedSurface) -> Option<Self> {
        let corners_of = |triangle: [usize; 3]| triangle.map(|vertex| mesh.vertices_mm()[vertex]);
        let base: Vec<_> = surface.triangles_with(SurfaceTag::Base).map(|triangle| BaseTriangle::new(corners_of(triangle))).collect();
        let distance = |point: &Vector3<f64>| base.iter().fold(f64::INFINITY, |least_mm, triangle| triangle.nearer(point, least_mm));
        let distance_mm = if base.is_empty() { return None } else { mesh.vertices_mm().par_iter().map(distance).collect() };
        Some(Self { distance_mm })
    }

    /// w a tetrahedron, the mean of its corners: 0 in tissue that is all ring, 1 in tissue that is all muscle.
    pub(super) fn muscle_shares(&self, tetrahedra: &[[usize; 4]], height_mm: f64) -> Vec<f64> {
        if height_mm <= 0.0 {
            return vec![1.0; tetrahedra.len()];
        }
        let share = |vertex: &usize| smooth_step(self.distance_mm[*vertex] / height_mm);
        tetrahedra.iter().map(|corners| corners.iter().map(share).sum::<f64>() / 4.0).collect()
    }

    /// $b + (1 - b)\,d / d_{max}$ a vertex: `at_base` at the base, 1 farthest from it.
    pub(super) fn grading(&self, at_base: f64) -> Vec<f64> {
        let farthest_mm = self.distance_mm.iter().fold(0.0, |a: f64, &b| a.max(b));
        self.distance_mm.iter().map(|distance_mm| at_base + (1.0 - at_base) * distance_mm / farthest_mm).collect()
    }
}

impl BaseTriangle {
    fn new(corners_mm: [Vector3<f64>; 3]) -> Self {
        let centre_mm = corners_mm.iter().sum::<Vector3<f64>>() / 3.0;
        let radius_mm = corners_mm.iter().map(|corner| (corner - centre_mm).norm()).fold(0.0, f64::max);
        Self { corners_mm, centre_mm, radius_mm }
    }

    /// The distance of a point to this triangle, or `least_mm` if it is less.
    fn nearer(&self, point: &Vector3<f64>, least_mm: f64) -> f64 {
        if (point - self.centre_mm).norm() - self.radius_mm >= least_mm {
            return least_mm;
        }
        distance_to_triangle_mm(&self.corners_mm, point).min(least_mm)
    }
}

/// $s^2 (3 - 2 s)$: from 0 at 0 to 1 at 1, level at both.
fn smooth_step(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}
