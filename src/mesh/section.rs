//! Contours of a surface cut by a plane, for drawing a mesh over an image slice.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::{SurfaceTag, TaggedSurface};

/// A polyline in which a plane cuts one surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Contour {
    /// The surface it belongs to.
    pub tag: SurfaceTag,
    /// Its points in order, world mm.
    pub points_mm: Vec<Vector3<f64>>,
    /// Whether the last point is joined to the first.
    pub is_closed: bool,
}

/// The contours of a tagged surface at `position_mm` in the plane through `point_mm` with `normal` (any length), surface by surface.
///
/// A vertex exactly in the plane counts as above it, so every contour is a simple chain.
pub fn section(surface: &TaggedSurface, position_mm: &[Vector3<f64>], point_mm: &Vector3<f64>, normal: &Vector3<f64>) -> Vec<Contour> {
    let height: Vec<f64> = position_mm.iter().map(|p| normal.dot(&(p - point_mm))).collect();
    let mut contours = vec![];
    for tag in SurfaceTag::ALL {
        // From each triangle's rising edge to its falling edge; the neighbour rises where this one falls.
        let mut next = BTreeMap::new();
        for triangle in surface.triangles_with(tag) {
            let edge_where = |rises: bool| {
                (0..3).map(|i| (triangle[i], triangle[(i + 1) % 3])).find(|&(a, b)| {
                    let (from, to) = (height[a] >= 0.0, height[b] >= 0.0);
                    from != to && to == rises
                })
            };
            if let (Some((a, b)), Some((c, d))) = (edge_where(true), edge_where(false)) {
                next.insert((a, b), (d, c));
            }
        }
        let crossing = |&(below, above): &(usize, usize)| {
            let (low, high) = (height[below], height[above]);
            position_mm[below].lerp(&position_mm[above], low / (low - high))
        };
        for (edges, is_closed) in chains(next) {
            contours.push(Contour { tag, points_mm: edges.iter().map(crossing).collect(), is_closed });
        }
    }
    contours
}

type Edge = (usize, usize);

/// Strings links together: open chains from their beginnings first, then the rings.
fn chains(mut next: BTreeMap<Edge, Edge>) -> Vec<(Vec<Edge>, bool)> {
    let ends: std::collections::BTreeSet<Edge> = next.values().copied().collect();
    let beginnings: Vec<Edge> = next.keys().copied().filter(|edge| !ends.contains(edge)).collect();
    let mut found = vec![];
    for start in beginnings {
        let mut chain = vec![start];
        while let Some(edge) = next.remove(&chain[chain.len() - 1]) {
            chain.push(edge);
        }
        found.push((chain, false));
    }
    while let Some((start, second)) = next.pop_first() {
        let mut chain = vec![start];
        let mut edge = second;
        while edge != start {
            chain.push(edge);
            match next.remove(&edge) {
                Some(following) => edge = following,
                None => break,
            }
        }
        found.push((chain, true));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;

    /// An octahedron around the origin, cut into four tetrahedra about its vertical axis.
    fn octahedron() -> (TetMesh, TaggedSurface) {
        let x = Vector3::x();
        let (y, z) = (Vector3::y(), Vector3::z());
        let ring = |i: usize| [2, 3, 4, 5][i % 4];
        let tetrahedra = (0..4).map(|i| [0, 1, ring(i + 1), ring(i)]).collect();
        let mesh = TetMesh::new(vec![z, -z, x, y, -x, -y], tetrahedra).unwrap();
        let tag = |t: &[usize; 3]| if t.contains(&0) { SurfaceTag::Base } else { SurfaceTag::Epicardium };
        let tags = mesh.boundary_triangles().iter().map(tag).collect();
        let surface = TaggedSurface::new(&mesh, tags).unwrap();
        (mesh, surface)
    }

    #[test]
    fn a_level_cut_of_one_surface_is_a_closed_square() {
        let (mesh, surface) = octahedron();
        let contours = section(&surface, mesh.vertices_mm(), &Vector3::new(0.0, 0.0, 0.25), &Vector3::z());
        assert_eq!(contours.len(), 1);
        assert!(contours[0].is_closed && contours[0].tag == SurfaceTag::Base && contours[0].points_mm.len() == 4);
        for p in &contours[0].points_mm {
            assert!((p.z - 0.25).abs() < 1e-15 && (p.xy().norm() - 0.75).abs() < 1e-15);
        }
    }

    #[test]
    fn an_upright_cut_gives_one_open_contour_a_surface() {
        let (mesh, surface) = octahedron();
        let contours = section(&surface, mesh.vertices_mm(), &Vector3::new(0.1, 0.0, 0.0), &Vector3::new(1.0, 0.3, 0.0));
        assert_eq!(contours.len(), 2);
        let ends = |c: &Contour| [c.points_mm[0], c.points_mm[c.points_mm.len() - 1]];
        assert!(contours.iter().all(|c| !c.is_closed && c.points_mm.len() == 4));
        let (base, epicardium) = (ends(&contours[0]), ends(&contours[1]));
        assert!((base[0] - epicardium[1]).norm() < 1e-15 && (base[1] - epicardium[0]).norm() < 1e-15);
    }

    #[test]
    fn a_cut_through_vertices_or_beside_the_mesh_is_well_defined() {
        let (mesh, surface) = octahedron();
        let through = section(&surface, mesh.vertices_mm(), &Vector3::zeros(), &Vector3::z());
        assert_eq!(through.len(), 1);
        assert!(through[0].is_closed && through[0].points_mm.iter().all(|p| p.z == 0.0));
        assert!(section(&surface, mesh.vertices_mm(), &Vector3::new(0.0, 0.0, 2.0), &Vector3::z()).is_empty());
    }
}
