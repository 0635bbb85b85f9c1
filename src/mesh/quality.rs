//! How well shaped the tetrahedra of a mesh are.

use nalgebra::Vector3;
use serde::Serialize;

use super::TetMesh;

/// Shape figures of a mesh. Dihedral angles of a regular tetrahedron are 70.5°; its radius ratio is 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeshQuality {
    /// Number of vertices.
    pub vertex_count: usize,
    /// Number of tetrahedra.
    pub tetrahedron_count: usize,
    /// Volume of all tetrahedra, mm³.
    pub volume_mm3: f64,
    /// Smallest dihedral angle, °.
    pub dihedral_least_deg: f64,
    /// The dihedral angle that one angle in a hundred stays below, °.
    pub dihedral_percentile_1_deg: f64,
    /// The dihedral angle that one angle in twenty stays below, °.
    pub dihedral_percentile_5_deg: f64,
    /// Largest dihedral angle, °.
    pub dihedral_greatest_deg: f64,
    /// Smallest radius ratio: 3 × inscribed radius / circumscribed radius.
    pub radius_ratio_least: f64,
    /// Mean radius ratio.
    pub radius_ratio_mean: f64,
    /// Shortest edge, mm.
    pub edge_least_mm: f64,
    /// Mean edge, mm.
    pub edge_mean_mm: f64,
    /// Longest edge, mm.
    pub edge_greatest_mm: f64,
}

impl MeshQuality {
    /// Measures a mesh; linear in its size.
    pub fn of(mesh: &TetMesh) -> Self {
        let mut angles_deg = Vec::with_capacity(6 * mesh.tetrahedron_count());
        let (mut ratio_least, mut ratio_sum) = (f64::INFINITY, 0.0);
        for tetrahedron in 0..mesh.tetrahedron_count() {
            let corners = mesh.corners_mm(tetrahedron);
            angles_deg.extend(dihedral_angles_deg(&corners));
            let ratio = radius_ratio(&corners);
            ratio_least = f64::min(ratio_least, ratio);
            ratio_sum += ratio;
        }
        angles_deg.sort_unstable_by(f64::total_cmp);
        let quantile = |fraction: f64| angles_deg[((angles_deg.len() - 1) as f64 * fraction) as usize];
        let (mut edge_least_mm, mut edge_greatest_mm, mut edge_sum_mm, mut edge_count) = (f64::INFINITY, 0.0_f64, 0.0, 0.0);
        for (vertex, neighbours) in mesh.vertex_neighbours().iter().enumerate() {
            for &other in neighbours.iter().filter(|&&other| other > vertex) {
                let length_mm = (mesh.vertices_mm()[other] - mesh.vertices_mm()[vertex]).norm();
                edge_least_mm = edge_least_mm.min(length_mm);
                edge_greatest_mm = edge_greatest_mm.max(length_mm);
                edge_sum_mm += length_mm;
                edge_count += 1.0;
            }
        }
        Self {
            vertex_count: mesh.vertex_count(),
            tetrahedron_count: mesh.tetrahedron_count(),
            volume_mm3: mesh.total_volume_mm3(),
            dihedral_least_deg: quantile(0.0),
            dihedral_percentile_1_deg: quantile(0.01),
            dihedral_percentile_5_deg: quantile(0.05),
            dihedral_greatest_deg: quantile(1.0),
            radius_ratio_least: ratio_least,
            radius_ratio_mean: ratio_sum / mesh.tetrahedron_count() as f64,
            edge_least_mm,
            edge_mean_mm: edge_sum_mm / edge_count,
            edge_greatest_mm,
        }
    }
}

/// The six angles between faces, at the edges ab, ac, ad, bc, bd, cd.
fn dihedral_angles_deg(corners: &[Vector3<f64>; 4]) -> [f64; 6] {
    [[0, 1, 2, 3], [0, 2, 1, 3], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 0, 2], [2, 3, 0, 1]].map(|[from, to, one, other]| {
        let edge = corners[to] - corners[from];
        let (u, v) = (edge.cross(&(corners[one] - corners[from])), edge.cross(&(corners[other] - corners[from])));
        u.cross(&v).norm().atan2(u.dot(&v)).to_degrees()
    })
}

/// $3 r / R$ with $r = 3V/\sum A$ and $R$ the radius of the circumscribed sphere.
fn radius_ratio(&[a, b, c, d]: &[Vector3<f64>; 4]) -> f64 {
    let (u, v, w) = (b - a, c - a, d - a);
    let six_volumes = u.cross(&v).dot(&w);
    let double_areas = u.cross(&v).norm() + v.cross(&w).norm() + w.cross(&u).norm() + (c - b).cross(&(d - b)).norm();
    let inscribed = six_volumes / double_areas;
    let toward_centre = u.cross(&v) * w.norm_squared() + v.cross(&w) * u.norm_squared() + w.cross(&u) * v.norm_squared();
    let circumscribed = toward_centre.norm() / (2.0 * six_volumes);
    3.0 * inscribed / circumscribed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_regular_tetrahedron_is_perfect() {
        let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(Vector3::from);
        let mesh = TetMesh::new(corners.to_vec(), vec![[0, 2, 1, 3]]).or_else(|_| TetMesh::new(corners.to_vec(), vec![[0, 1, 2, 3]]));
        let quality = MeshQuality::of(&mesh.unwrap());
        assert!((quality.dihedral_least_deg - (1.0_f64 / 3.0).acos().to_degrees()).abs() < 1e-12);
        assert!((quality.dihedral_greatest_deg - quality.dihedral_least_deg).abs() < 1e-12);
        assert!((quality.radius_ratio_least - 1.0).abs() < 1e-12);
        assert!((quality.edge_mean_mm - 8.0_f64.sqrt()).abs() < 1e-12);
    }

    /// The corner of a cube: three right angles, three of acos(1/√3); r = 1/(3 + √3), R = √3/2.
    #[test]
    fn the_corner_of_a_cube_has_known_angles() {
        let corners = vec![Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
        let quality = MeshQuality::of(&TetMesh::new(corners, vec![[0, 1, 2, 3]]).unwrap());
        assert!((quality.dihedral_least_deg - (1.0_f64 / 3.0).sqrt().acos().to_degrees()).abs() < 1e-12);
        assert!((quality.dihedral_greatest_deg - 90.0).abs() < 1e-12);
        let exact = 3.0 / (3.0 + 3.0_f64.sqrt()) / (3.0_f64.sqrt() / 2.0);
        assert!((quality.radius_ratio_least - exact).abs() < 1e-12);
    }
}
