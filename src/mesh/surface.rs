//! The boundary of the myocardium, each triangle tagged with the surface it belongs to.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{MeshError, TetMesh};

/// The surfaces of the ventricles, \[Billet2009\] §3.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceTag {
    /// Left-ventricular endocardium.
    EndocardiumLv,
    /// Right-ventricular endocardium.
    EndocardiumRv,
    /// Epicardium of both ventricles.
    Epicardium,
    /// The cut towards the atria and outflow tracts.
    Base,
}

impl SurfaceTag {
    /// Every tag.
    pub const ALL: [Self; 4] = [Self::Base, Self::EndocardiumRv, Self::EndocardiumLv, Self::Epicardium];

    /// The number that stands for this tag in mesh files: base 10, RV endocardium 20, LV endocardium 30, epicardium 40, as in the
    /// cardiac elastodynamics benchmark's meshes.
    pub fn code(self) -> i32 {
        match self {
            Self::Base => 10,
            Self::EndocardiumRv => 20,
            Self::EndocardiumLv => 30,
            Self::Epicardium => 40,
        }
    }
}

/// Boundary triangles, oriented outward from the myocardium (so an endocardial normal points into the blood).
#[derive(Debug, Clone, PartialEq)]
pub struct TaggedSurface {
    triangles: Vec<[usize; 3]>,
    tags: Vec<SurfaceTag>,
}

impl TaggedSurface {
    /// Keeps the boundary of `mesh`, with one tag a triangle of [`TetMesh::boundary_triangles`].
    ///
    /// # Errors
    /// [`MeshError::TagCount`] if the numbers differ.
    pub fn new(mesh: &TetMesh, tags: Vec<SurfaceTag>) -> Result<Self, MeshError> {
        let triangles = mesh.boundary_triangles();
        if triangles.len() != tags.len() {
            return Err(MeshError::TagCount { triangle_count: triangles.len(), tag_count: tags.len() });
        }
        Ok(Self { triangles, tags })
    }

    /// All triangles, vertex numbers.
    pub fn triangles(&self) -> &[[usize; 3]] {
        &self.triangles
    }

    /// One tag a triangle.
    pub fn tags(&self) -> &[SurfaceTag] {
        &self.tags
    }

    /// Triangles of one surface.
    pub fn triangles_with(&self, tag: SurfaceTag) -> impl Iterator<Item = [usize; 3]> + '_ {
        self.triangles.iter().zip(&self.tags).filter(move |&(_, &t)| t == tag).map(|(&triangle, _)| triangle)
    }

    /// Vertices of one surface, ascending.
    pub fn vertices_with(&self, tag: SurfaceTag) -> Vec<usize> {
        let mut vertices: Vec<usize> = self.triangles_with(tag).flatten().collect();
        vertices.sort_unstable();
        vertices.dedup();
        vertices
    }

    /// Area vectors (outward, mm²) lumped to the vertices of one surface at the given positions: a third of each triangle's
    /// area vector; one a mesh vertex, zero elsewhere. Normalised they are the vertex normals, their norms the vertex areas.
    pub fn vertex_area_vectors_mm2(&self, tag: SurfaceTag, position_mm: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut area = vec![Vector3::zeros(); position_mm.len()];
        for [a, b, c] in self.triangles_with(tag) {
            let third = (position_mm[b] - position_mm[a]).cross(&(position_mm[c] - position_mm[a])) / 6.0;
            for vertex in [a, b, c] {
                area[vertex] += third;
            }
        }
        area
    }
}
