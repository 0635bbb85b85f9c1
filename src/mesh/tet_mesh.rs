//! A conforming mesh of linear tetrahedra, checked once at construction.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use nalgebra::Vector3;

use super::MeshError;

/// Linear tetrahedra in world millimetres. Every tetrahedron is positively oriented,
/// (b − a) × (c − a) · (d − a) > 0, every vertex is used, and every triangle belongs to one or two tetrahedra, on either side of it.
#[derive(Debug, Clone, PartialEq)]
pub struct TetMesh {
    vertices_mm: Vec<Vector3<f64>>,
    tetrahedra: Vec<[usize; 4]>,
}

impl TetMesh {
    /// Checks and keeps a mesh.
    ///
    /// # Errors
    /// [`MeshError`] names the first vertex or tetrahedron that breaks an invariant of [`TetMesh`].
    pub fn new(vertices_mm: Vec<Vector3<f64>>, tetrahedra: Vec<[usize; 4]>) -> Result<Self, MeshError> {
        let vertex_count = vertices_mm.len();
        if vertices_mm.is_empty() || tetrahedra.is_empty() {
            return Err(MeshError::Empty { vertex_count, tetrahedron_count: tetrahedra.len() });
        }
        if let Some(vertex) = vertices_mm.iter().position(|v| !v.iter().all(|c| c.is_finite())) {
            return Err(MeshError::NonFiniteVertex { vertex });
        }
        let mut used = vec![false; vertex_count];
        let mut first_with = HashMap::with_capacity(tetrahedra.len());
        for (tetrahedron, corners) in tetrahedra.iter().enumerate() {
            for &vertex in corners {
                *used.get_mut(vertex).ok_or(MeshError::VertexOutOfRange { tetrahedron, vertex, vertex_count })? = true;
            }
            let volume_mm3 = signed_volume(corners.map(|v| vertices_mm[v]));
            if volume_mm3.is_nan() || volume_mm3 <= 0.0 {
                let centre_mm = corners.iter().map(|&v| vertices_mm[v]).sum::<Vector3<f64>>() / 4.0;
                return Err(MeshError::InvertedTetrahedron { tetrahedron, volume_mm3, centre_mm });
            }
            let mut sorted = *corners;
            sorted.sort_unstable();
            if let Some(first) = first_with.insert(sorted, tetrahedron) {
                return Err(MeshError::DuplicateTetrahedron { first, second: tetrahedron });
            }
        }
        if let Some(vertex) = used.iter().position(|&is_used| !is_used) {
            return Err(MeshError::UnreferencedVertex { vertex, position_mm: vertices_mm[vertex] });
        }
        let mesh = Self { vertices_mm, tetrahedra };
        mesh.check_triangles()?;
        Ok(mesh)
    }

    /// Vertex positions in mm, one a vertex.
    pub fn vertices_mm(&self) -> &[Vector3<f64>] {
        &self.vertices_mm
    }

    /// Vertex numbers of each tetrahedron.
    pub fn tetrahedra(&self) -> &[[usize; 4]] {
        &self.tetrahedra
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.vertices_mm.len()
    }

    /// Number of tetrahedra.
    pub fn tetrahedron_count(&self) -> usize {
        self.tetrahedra.len()
    }

    /// Positions of the four corners of a tetrahedron, mm.
    pub fn corners_mm(&self, tetrahedron: usize) -> [Vector3<f64>; 4] {
        self.tetrahedra[tetrahedron].map(|vertex| self.vertices_mm[vertex])
    }

    /// Volume of a tetrahedron, mm³.
    pub fn volume_mm3(&self, tetrahedron: usize) -> f64 {
        signed_volume(self.corners_mm(tetrahedron))
    }

    /// Gradients (1/mm) of the four linear shape functions of a tetrahedron: $\nabla\lambda_i$ points from the face opposite to corner i
    /// towards it, with the length of the inverse of its height.
    pub fn shape_gradients_per_mm(&self, tetrahedron: usize) -> [Vector3<f64>; 4] {
        let [a, b, c, d] = self.corners_mm(tetrahedron);
        let six_volumes = (b - a).cross(&(c - a)).dot(&(d - a));
        let at_b = (c - a).cross(&(d - a)) / six_volumes;
        let at_c = (d - a).cross(&(b - a)) / six_volumes;
        let at_d = (b - a).cross(&(c - a)) / six_volumes;
        [-(at_b + at_c + at_d), at_b, at_c, at_d]
    }

    /// Volume of the whole mesh, mm³.
    pub fn total_volume_mm3(&self) -> f64 {
        (0..self.tetrahedron_count()).map(|t| self.volume_mm3(t)).sum()
    }

    /// Triangles that belong to one tetrahedron only, oriented outward from the myocardium, in the order of the tetrahedra.
    pub fn boundary_triangles(&self) -> Vec<[usize; 3]> {
        let counts = self.triangle_counts();
        self.tetrahedra.iter().flat_map(outward_triangles).filter(|triangle| counts[&sorted(*triangle)] == 1).collect()
    }

    /// For every vertex its neighbours along edges, sorted, without itself.
    pub fn vertex_neighbours(&self) -> Vec<Vec<usize>> {
        let mut neighbours = vec![Vec::new(); self.vertex_count()];
        for corners in &self.tetrahedra {
            for &a in corners {
                neighbours[a].extend(corners.iter().copied().filter(|&b| b != a));
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        neighbours
    }

    /// For every vertex the tetrahedra that hold it, ascending.
    pub fn vertex_tetrahedra(&self) -> Vec<Vec<usize>> {
        let mut holders = vec![Vec::new(); self.vertex_count()];
        for (tetrahedron, corners) in self.tetrahedra.iter().enumerate() {
            for &vertex in corners {
                holders[vertex].push(tetrahedron);
            }
        }
        holders
    }

    fn triangle_counts(&self) -> HashMap<[usize; 3], usize> {
        let mut counts = HashMap::with_capacity(2 * self.tetrahedron_count());
        for triangle in self.tetrahedra.iter().flat_map(outward_triangles) {
            *counts.entry(sorted(triangle)).or_insert(0) += 1;
        }
        counts
    }

    fn check_triangles(&self) -> Result<(), MeshError> {
        let mut seen = HashMap::with_capacity(2 * self.tetrahedron_count());
        for (tetrahedron, corners) in self.tetrahedra.iter().enumerate() {
            for vertices in outward_triangles(corners) {
                match seen.entry(sorted(vertices)) {
                    Entry::Vacant(place) => drop(place.insert(Some((tetrahedron, rotated(vertices))))),
                    Entry::Occupied(mut place) => match place.insert(None) {
                        None => return Err(MeshError::NonManifoldTriangle { vertices }),
                        // Seen from inside two neighbours, their triangle turns in opposite senses.
                        Some((first, as_seen)) if as_seen == rotated(vertices) => {
                            return Err(MeshError::OverlappingTetrahedra { first, second: tetrahedron, vertices });
                        }
                        Some(_) => {}
                    },
                }
            }
        }
        Ok(())
    }
}

fn signed_volume([a, b, c, d]: [Vector3<f64>; 4]) -> f64 {
    (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
}

fn outward_triangles(&[a, b, c, d]: &[usize; 4]) -> [[usize; 3]; 4] {
    [[b, c, d], [a, d, c], [a, b, d], [a, c, b]]
}

/// The least vertex first, the sense kept.
fn rotated([a, b, c]: [usize; 3]) -> [usize; 3] {
    if a < b && a < c {
        [a, b, c]
    } else if b < c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

fn sorted(mut triangle: [usize; 3]) -> [usize; 3] {
    triangle.sort_unstable();
    triangle
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit_tetrahedron() -> Vec<Vector3<f64>> {
        vec![Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()]
    }

    #[test]
    fn boundary_triangles_point_outward() {
        let mesh = TetMesh::new(unit_tetrahedron(), vec![[0, 1, 2, 3]]).unwrap();
        let centre = Vector3::repeat(0.25);
        for [a, b, c] in mesh.boundary_triangles() {
            let [a, b, c] = [a, b, c].map(|v| mesh.vertices_mm()[v]);
            assert!((b - a).cross(&(c - a)).dot(&(a - centre)) > 0.0);
        }
    }

    #[test]
    fn an_inverted_tetrahedron_is_named() {
        let error = TetMesh::new(unit_tetrahedron(), vec![[0, 2, 1, 3]]).unwrap_err();
        assert!(matches!(error, MeshError::InvertedTetrahedron { tetrahedron: 0, .. }), "{error}");
    }

    #[test]
    fn tetrahedra_that_overlap_are_named() {
        let mut vertices = unit_tetrahedron();
        vertices.push(Vector3::repeat(2.0));
        let neighbours = vec![[0, 1, 2, 3], [1, 2, 3, 4]];
        assert!(TetMesh::new(vertices.clone(), neighbours).is_ok());
        // The fifth vertex is pushed through the triangle that both share.
        vertices[4] = Vector3::repeat(0.1);
        let error = TetMesh::new(vertices, vec![[0, 1, 2, 3], [1, 3, 2, 4]]).unwrap_err();
        assert!(matches!(error, MeshError::OverlappingTetrahedra { first: 0, second: 1, .. }), "{error}");
    }

    #[test]
    fn unused_vertices_and_duplicates_are_refused() {
        let mut vertices = unit_tetrahedron();
        let twice = TetMesh::new(vertices.clone(), vec![[0, 1, 2, 3], [1, 2, 0, 3]]).unwrap_err();
        assert_eq!(twice, MeshError::DuplicateTetrahedron { first: 0, second: 1 });
        vertices.push(Vector3::repeat(2.0));
        let unused = TetMesh::new(vertices, vec![[0, 1, 2, 3]]).unwrap_err();
        assert!(matches!(unused, MeshError::UnreferencedVertex { vertex: 4, .. }), "{unused}");
    }
}
