//! Springs and dashpots per area of a surface (Robin conditions), lumped to its vertices.

use nalgebra::{Matrix3, Vector3};

use crate::mesh::{SurfaceTag, TaggedSurface};

/// Springs of one surface: at every vertex a third of each of its triangles' $A\,(k_n\,n n^\top + k_i I)$, kPa·mm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SurfaceSprings {
    /// Vertices of the surface, ascending.
    pub(super) vertices: Vec<usize>,
    /// One block a vertex of the surface.
    pub(super) blocks: Vec<Matrix3<f64>>,
}

impl SurfaceSprings {
    /// Springs of `normal` strength along the normal at rest and `isotropic` strength in all directions, kPa/mm (or kPa·s/mm
    /// for dashpots).
    pub(super) fn new(surface: &TaggedSurface, tag: SurfaceTag, rest_mm: &[Vector3<f64>], normal: f64, isotropic: f64) -> Self {
        let vertices = surface.vertices_with(tag);
        let mut blocks = vec![Matrix3::zeros(); vertices.len()];
        for [a, b, c] in surface.triangles_with(tag) {
            let doubled_mm2 = (rest_mm[b] - rest_mm[a]).cross(&(rest_mm[c] - rest_mm[a]));
            let third_mm2 = doubled_mm2.norm() / 6.0;
            let unit = doubled_mm2.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
            let block = (unit * unit.transpose() * normal + Matrix3::identity() * isotropic) * third_mm2;
            for vertex in [a, b, c] {
                if let Ok(index) = vertices.binary_search(&vertex) {
                    blocks[index] += block;
                }
            }
        }
        Self { vertices, blocks }
    }

    /// Multiplies the springs of every vertex with its part of `grading`, one entry a vertex of the mesh.
    pub(super) fn grade(&mut self, grading: &[f64]) {
        for (vertex, block) in self.vertices.iter().zip(&mut self.blocks) {
            *block *= grading[*vertex];
        }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, &Matrix3<f64>)> {
        self.vertices.iter().copied().zip(&self.blocks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;

    /// The springs of a plane face of area A sum to A (k_n n nᵀ + k_i I), whatever the triangles.
    #[test]
    fn springs_of_a_plane_face_sum_to_area_times_stiffness() {
        let rest = vec![Vector3::zeros(), Vector3::new(2.0, 0.0, 0.0), Vector3::new(0.0, 3.0, 0.0), Vector3::new(0.0, 0.0, 1.0)];
        let mesh = TetMesh::new(rest.clone(), vec![[0, 1, 2, 3]]).unwrap();
        let is_base = |t: &[usize; 3]| t.iter().all(|&v| rest[v].z == 0.0);
        let tag = |t| if is_base(t) { SurfaceTag::Base } else { SurfaceTag::Epicardium };
        let surface = TaggedSurface::new(&mesh, mesh.boundary_triangles().iter().map(tag).collect()).unwrap();
        let springs = SurfaceSprings::new(&surface, SurfaceTag::Base, &rest, 2.0, 0.5);
        assert_eq!(springs.vertices, [0, 1, 2]);
        let sum: Matrix3<f64> = springs.blocks.iter().sum();
        let expected = Matrix3::from_diagonal(&Vector3::new(0.5, 0.5, 2.5)) * 3.0;
        assert!((sum - expected).norm() < 1e-12);
    }
}
