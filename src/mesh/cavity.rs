//! A ventricular cavity: endocardium closed by a lid over its rim; volume and gradient by the divergence theorem.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::{MeshError, SurfaceTag, TaggedSurface};

/// A cavity closed by a fan over the rim of its endocardium.
///
/// $V(y) = \frac16 \sum_{abc} y_a \cdot (y_b \times y_c)$ over the closed surface, oriented out of the blood; the centre of the
/// fan is the mean of the rim, so $V$ depends on mesh vertices only and $p\,\partial V/\partial y$ is the consistent pressure load.
#[derive(Debug, Clone, PartialEq)]
pub struct Cavity {
    tag: SurfaceTag,
    endocardium: Vec<[usize; 3]>,
    rim: Vec<usize>,
}

impl Cavity {
    /// Closes the endocardium `tag` of a surface.
    ///
    /// # Errors
    /// [`MeshError::MissingSurface`] if no triangle has the tag, [`MeshError::OpenEndocardium`] if its rim is not one
    /// loop, [`MeshError::ClosedEndocardium`] if it has none.
    pub fn new(surface: &TaggedSurface, tag: SurfaceTag) -> Result<Self, MeshError> {
        // Outward from the myocardium is into the blood: turn the triangles round.
        let endocardium: Vec<[usize; 3]> = surface.triangles_with(tag).map(|[a, b, c]| [a, c, b]).collect();
        if endocardium.is_empty() {
            return Err(MeshError::MissingSurface { tag });
        }
        let rim = rim_loop(tag, &endocardium)?;
        Ok(Self { tag, endocardium, rim })
    }

    /// The endocardium this cavity lies behind.
    pub fn tag(&self) -> SurfaceTag {
        self.tag
    }

    /// Endocardial triangles, oriented out of the blood.
    pub fn endocardium(&self) -> &[[usize; 3]] {
        &self.endocardium
    }

    /// Rim vertices in order, such that (centre, vertex, next vertex) is oriented out of the blood.
    pub fn rim(&self) -> &[usize] {
        &self.rim
    }

    /// Centre of the lid, mm.
    pub fn lid_centre_mm(&self, position_mm: &[Vector3<f64>]) -> Vector3<f64> {
        self.rim.iter().map(|&vertex| position_mm[vertex]).sum::<Vector3<f64>>() / self.rim.len() as f64
    }

    /// Cavity volume, mm³.
    pub fn volume_mm3(&self, position_mm: &[Vector3<f64>]) -> f64 {
        // Relative to the lid's centre the fan contributes nothing, and rounding stays small far from the origin.
        let centre = self.lid_centre_mm(position_mm);
        let at = |vertex: usize| position_mm[vertex] - centre;
        self.endocardium.iter().map(|&[a, b, c]| at(a).dot(&at(b).cross(&at(c)))).sum::<f64>() / 6.0
    }

    /// Adds `factor` times ∂V/∂y (mm²) to `sum_mm2`, one vector a mesh vertex.
    pub fn add_gradient(&self, position_mm: &[Vector3<f64>], factor: f64, sum_mm2: &mut [Vector3<f64>]) {
        let centre = self.lid_centre_mm(position_mm);
        let at = |vertex: usize| position_mm[vertex] - centre;
        let mut centre_gradient = Vector3::zeros();
        for &[a, b, c] in &self.endocardium {
            for [i, j, k] in [[a, b, c], [b, c, a], [c, a, b]] {
                let gradient = at(j).cross(&at(k)) * (factor / 6.0);
                sum_mm2[i] += gradient;
                centre_gradient -= gradient;
            }
        }
        let share = centre_gradient / self.rim.len() as f64;
        for &vertex in &self.rim {
            sum_mm2[vertex] += share;
        }
    }
}

/// Orders the boundary edges of a triangle set into one loop.
fn rim_loop(tag: SurfaceTag, triangles: &[[usize; 3]]) -> Result<Vec<usize>, MeshError> {
    let mut directed = BTreeSet::new();
    for &[a, b, c] in triangles {
        directed.extend([(a, b), (b, c), (c, a)]);
    }
    let mut next = BTreeMap::new();
    for &(a, b) in directed.iter().filter(|&&(a, b)| !directed.contains(&(b, a))) {
        // The lid runs against the endocardium's rim edge, so that the closed surface is oriented alike.
        if next.insert(b, a).is_some() {
            return Err(MeshError::OpenEndocardium { tag, loop_count: 2, vertex: b });
        }
    }
    let mut loops: Vec<Vec<usize>> = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut rim = vec![start];
        let mut vertex = next.remove(&start);
        while let Some(v) = vertex.filter(|&v| v != start) {
            rim.push(v);
            vertex = next.remove(&v);
        }
        loops.push(rim);
    }
    loops.sort_by_key(Vec::len);
    match (loops.pop(), loops.first()) {
        (Some(rim), None) => Ok(rim),
        (None, _) => Err(MeshError::ClosedEndocardium { tag }),
        (Some(_), Some(hole)) => Err(MeshError::OpenEndocardium { tag, loop_count: loops.len() + 1, vertex: hole[0] }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;

    /// A unit cube cut into tetrahedra around its centre; the face z = 1 is the base, x = 0 … the "endocardium" seen from outside.
    fn bowl() -> (TetMesh, TaggedSurface) {
        let mut vertices = vec![];
        for k in 0..2 {
            for j in 0..2 {
                for i in 0..2 {
                    vertices.push(Vector3::new(f64::from(i), f64::from(j), f64::from(k)));
                }
            }
        }
        vertices.push(Vector3::repeat(0.5));
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let mut tetrahedra = vec![];
        for [a, b, c, d] in faces {
            tetrahedra.extend([[a, c, b, 8], [a, d, c, 8]]);
        }
        let mesh = TetMesh::new(vertices, tetrahedra).unwrap();
        let tags = mesh
            .boundary_triangles()
            .iter()
            .map(|t| if t.iter().all(|&v| mesh.vertices_mm()[v].z == 1.0) { SurfaceTag::Base } else { SurfaceTag::EndocardiumLv })
            .collect();
        let surface = TaggedSurface::new(&mesh, tags).unwrap();
        (mesh, surface)
    }

    #[test]
    fn the_cavity_of_an_open_cube_is_the_cube_turned_inside_out() {
        let (mesh, surface) = bowl();
        let cavity = Cavity::new(&surface, SurfaceTag::EndocardiumLv).unwrap();
        // Its wall lies inside, so its "blood" is outside: the sign is negative.
        assert!((cavity.volume_mm3(mesh.vertices_mm()) + 1.0).abs() < 1e-14);
    }

    #[test]
    fn the_gradient_is_the_derivative_of_the_volume() {
        let (mesh, surface) = bowl();
        let cavity = Cavity::new(&surface, SurfaceTag::EndocardiumLv).unwrap();
        let mut position = mesh.vertices_mm().to_vec();
        for (vertex, p) in position.iter_mut().enumerate() {
            *p += Vector3::new((vertex as f64).sin(), (2.0 * vertex as f64).cos(), (3.0 * vertex as f64).sin()) * 0.1;
        }
        let mut gradient = vec![Vector3::zeros(); position.len()];
        cavity.add_gradient(&position, 1.0, &mut gradient);
        let step = 1e-5;
        for vertex in 0..position.len() {
            for axis in 0..3 {
                let mut moved = position.clone();
                moved[vertex][axis] += step;
                let plus = cavity.volume_mm3(&moved);
                moved[vertex][axis] -= 2.0 * step;
                let difference = (plus - cavity.volume_mm3(&moved)) / (2.0 * step);
                assert!((difference - gradient[vertex][axis]).abs() < 1e-9, "vertex {vertex} axis {axis}");
            }
        }
    }
}
