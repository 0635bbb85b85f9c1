//! How far a surface of one mesh lies from the same surface of another.

use cardiotwin::anatomy::Anatomy;
use cardiotwin::mesh::SurfaceTag;
use nalgebra::Vector3;

/// A triangle in the ball that encloses it.
struct Facet {
    corners_mm: [Vector3<f64>; 3],
    centre_mm: Vector3<f64>,
    radius_mm: f64,
}

/// Distances (mm) of a surface's vertices, those for which `counts` holds, from the same surface of another mesh.
pub(crate) fn distances_mm(from: &Anatomy, to: &Anatomy, tag: SurfaceTag, counts: impl Fn(&Vector3<f64>) -> bool) -> Vec<f64> {
    let facet = |triangle: [usize; 3]| {
        let corners_mm = triangle.map(|v| to.mesh.vertices_mm()[v]);
        let centre_mm = corners_mm.iter().sum::<Vector3<f64>>() / 3.0;
        let radius_mm = corners_mm.iter().map(|corner| (corner - centre_mm).norm()).fold(0.0, f64::max);
        Facet { corners_mm, centre_mm, radius_mm }
    };
    let facets: Vec<Facet> = to.surface.triangles_with(tag).map(facet).collect();
    let points = from.surface.vertices_with(tag).into_iter().map(|v| from.mesh.vertices_mm()[v]);
    points.filter(counts).map(|point| nearest_mm(&point, &facets)).collect()
}

fn nearest_mm(point: &Vector3<f64>, facets: &[Facet]) -> f64 {
    facets.iter().fold(f64::INFINITY, |nearest, facet| {
        let is_farther = (point - facet.centre_mm).norm_squared() > (nearest + facet.radius_mm).powi(2);
        if is_farther { nearest } else { nearest.min(distance_mm(point, &facet.corners_mm)) }
    })
}

/// Distance of a point from a triangle.
fn distance_mm(p: &Vector3<f64>, &[a, b, c]: &[Vector3<f64>; 3]) -> f64 {
    let from_edge = |[a, b]: [Vector3<f64>; 2]| {
        let edge = b - a;
        (p - a - edge * ((p - a).dot(&edge) / edge.norm_squared()).clamp(0.0, 1.0)).norm()
    };
    let normal = (b - a).cross(&(c - a)).normalize();
    let edges = [[a, b], [b, c], [c, a]];
    let is_over = edges.iter().all(|[u, v]| (v - u).cross(&(p - u)).dot(&normal) >= 0.0);
    let nearest = edges.map(from_edge).into_iter().fold(f64::INFINITY, f64::min);
    if is_over { nearest.min((p - a).dot(&normal).abs()) } else { nearest }
}
