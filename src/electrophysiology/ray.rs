//! Straight rays from an onset to the vertices around it, timed exactly through every tetrahedron they cross.
//!
//! The solution has its greatest curvature around a point source, and linear tetrahedra make their greatest errors there, which the front
//! then carries along: this is why fast marching from a point converges as $h \log h$ only. The time along any path is an upper bound of
//! td, so straight rays can only improve what the march finds; in a uniform medium they are exact.

use nalgebra::Vector3;

use super::Conduction;
use crate::mesh::TetMesh;

/// Tetrahedra a ray may cross before it is given up.
const CROSSING_LIMIT: usize = 400;
/// How far the end of a ray is moved off its vertex, relative to the way to the middle of a tetrahedron there, so that no ray runs along
/// edges or through vertices.
const OFFSET: f64 = 1e-5;

/// A part of a ray within one tetrahedron.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayLeg {
    /// The tetrahedron.
    pub tetrahedron: usize,
    /// Time spent in it, s.
    pub travel_s: f64,
}

/// Who holds a vertex.
pub(super) trait Holders {
    /// The tetrahedra of a vertex.
    fn tetrahedra_of(&self, vertex: usize) -> impl Iterator<Item = usize> + '_;
}

/// The legs of the straight ray from one vertex to another, or nothing if it leaves the mesh.
pub(super) fn trace(mesh: &TetMesh, holders: &impl Holders, conduction: &Conduction, from: usize, to: usize) -> Option<Vec<RayLeg>> {
    let origin = mesh.vertices_mm()[from];
    let straight = mesh.vertices_mm()[to] - origin;
    let inside = mean(holders.tetrahedra_of(to).map(|t| mesh.corners_mm(t).iter().sum::<Vector3<f64>>() / 4.0))?;
    let aim = straight + (inside - mesh.vertices_mm()[to]) * OFFSET;
    let mut tetrahedron = first_tetrahedron(mesh, holders, from, &aim)?;
    let (mut legs, mut share) = (vec![], 0.0);
    for _ in 0..CROSSING_LIMIT {
        let corners = &mesh.tetrahedra()[tetrahedron];
        let is_last = corners.contains(&to);
        let exit = leave(mesh, tetrahedron, &origin, &aim);
        let end = if is_last { 1.0 } else { exit?.1.clamp(share, 1.0) };
        legs.push(RayLeg { tetrahedron, travel_s: (end - share) * conduction.travel_time_s(tetrahedron, &straight) });
        if is_last {
            return Some(legs);
        }
        share = end;
        let opposite = exit?.0;
        let face = corners.map(|v| if v == opposite { corners[usize::from(corners[0] == opposite)] } else { v });
        let is_neighbour = |&t: &usize| t != tetrahedron && face.iter().all(|v| mesh.tetrahedra()[t].contains(v));
        tetrahedron = holders.tetrahedra_of(face[0]).find(is_neighbour)?;
    }
    None
}

fn mean(points: impl Iterator<Item = Vector3<f64>>) -> Option<Vector3<f64>> {
    let (sum, count) = points.fold((Vector3::zeros(), 0), |(sum, count), point| (sum + point, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The tetrahedron of a vertex that a direction runs into.
fn first_tetrahedron(mesh: &TetMesh, holders: &impl Holders, vertex: usize, aim: &Vector3<f64>) -> Option<usize> {
    // Inside the cone of the vertex all other barycentric coordinates grow.
    let least_growth = |t: usize| {
        let growths = corner_slopes(mesh, t, aim).into_iter().zip(mesh.tetrahedra()[t]);
        growths.filter(|&(_, corner)| corner != vertex).map(|(growth, _)| growth).fold(f64::INFINITY, f64::min)
    };
    let growths = holders.tetrahedra_of(vertex).map(|t| (least_growth(t), t));
    growths.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))).filter(|&(growth, _)| growth >= 0.0).map(|(_, t)| t)
}

/// The vertex opposite to the face through which the ray leaves, and the share of the ray up to there.
fn leave(mesh: &TetMesh, tetrahedron: usize, origin: &Vector3<f64>, aim: &Vector3<f64>) -> Option<(usize, f64)> {
    let slopes = corner_slopes(mesh, tetrahedron, aim);
    let corners = mesh.tetrahedra()[tetrahedron];
    let positions = mesh.corners_mm(tetrahedron);
    let volume = mesh.volume_mm3(tetrahedron);
    let ends = (0..4).filter(|&c| slopes[c] < 0.0).map(|c| {
        let others = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]][c].map(|k| positions[k]);
        let height = (others[1] - others[0]).cross(&(others[2] - others[0])).dot(&(others[0] - origin)) / (6.0 * volume);
        (corners[c], -height / slopes[c])
    });
    ends.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// How the barycentric coordinates change along a direction.
fn corner_slopes(mesh: &TetMesh, tetrahedron: usize, direction: &Vector3<f64>) -> [f64; 4] {
    let [a, b, c, d] = mesh.corners_mm(tetrahedron);
    let six_volumes = (b - a).cross(&(c - a)).dot(&(d - a));
    let slope = |p: Vector3<f64>, q: Vector3<f64>, r: Vector3<f64>| (q - p).cross(&(r - p)).dot(direction) / six_volumes;
    [-slope(b, c, d), -slope(a, d, c), -slope(a, b, d), -slope(a, c, b)]
}
