//! Across the wall: transmural depth, its direction, and which tetrahedra are septum or right ventricle.

use nalgebra::Vector3;

use super::laplace::{Laplacian, gradients};
use super::{AnatomyError, Region};
use crate::mesh::{MeshError, SurfaceTag, TaggedSurface, TetMesh};

/// The wall seen from inside to outside.
pub(super) struct TransmuralLayout {
    /// Depth a vertex: 0 at the endocardium that it belongs to, 1 at the other side of the wall.
    pub(super) depth_at_vertices: Vec<f64>,
    /// Mean depth a tetrahedron.
    pub(super) depth: Vec<f64>,
    /// Gradient of the depth a tetrahedron, 1/mm.
    pub(super) gradient: Vec<Vector3<f64>>,
    /// For two ventricles, what the surfaces say of the regions and of where the septum lies.
    pub(super) septum: Option<SeptalLayout>,
}

/// What two ventricles tell of their septum.
pub(super) struct SeptalLayout {
    /// Region a tetrahedron: LV free wall, septum or RV free wall.
    pub(super) regions: Vec<Region>,
    /// The middle of the right-ventricular side of the septum, mm.
    pub(super) centre_mm: Vector3<f64>,
}

/// One ventricle: depth is harmonic, 0 on the endocardium and 1 on the epicardium.
///
/// # Errors
/// [`MeshError::MissingSurface`], or a stalled solve.
pub(super) fn lay_out_lv(mesh: &TetMesh, surface: &TaggedSurface) -> Result<TransmuralLayout, AnatomyError> {
    let laplacian = Laplacian::of(mesh);
    let fixed = fix(mesh, surface, &[(SurfaceTag::Epicardium, 1.0), (SurfaceTag::EndocardiumLv, 0.0)])?;
    let depth = laplacian.solve(&fixed)?;
    let gradient = gradients(mesh, &depth);
    Ok(TransmuralLayout { depth: means(mesh, &depth), depth_at_vertices: depth, gradient, septum: None })
}

/// Two ventricles. The septum belongs to the left one: its depth runs from the LV endocardium (0) to the RV endocardium (1), which there
/// counts as the outside; in the free wall of the right ventricle depth runs from the RV endocardium to the epicardium.
///
/// The septal part of the RV endocardium is where the harmonic function that leaves the RV blood flows to the LV rather than to the
/// epicardium; the wall is divided between the ventricles by the harmonic function that is 1 on the LV endocardium and this part and 0 on
/// the rest of the RV endocardium.
///
/// # Errors
/// [`MeshError::MissingSurface`], [`AnatomyError::NoSeptum`] if no part of the RV faces the LV, or a stalled solve.
pub(super) fn lay_out_biventricle(mesh: &TetMesh, surface: &TaggedSurface) -> Result<TransmuralLayout, AnatomyError> {
    use SurfaceTag::{EndocardiumLv, EndocardiumRv, Epicardium};
    let laplacian = Laplacian::of(mesh);
    let solve = |values: &[(SurfaceTag, f64)]| laplacian.solve(&fix(mesh, surface, values)?);
    let from_lv = solve(&[(Epicardium, 1.0), (EndocardiumRv, 1.0), (EndocardiumLv, 0.0)])?;
    let from_rv = solve(&[(Epicardium, 1.0), (EndocardiumLv, 1.0), (EndocardiumRv, 0.0)])?;
    let to_epicardium = solve(&[(Epicardium, 1.0), (EndocardiumLv, 0.0), (EndocardiumRv, 0.0)])?;
    let septal = SeptalFace::find(mesh, surface, &from_rv, &to_epicardium)?;

    let mut fixed = fix(mesh, surface, &[(EndocardiumRv, 0.0), (EndocardiumLv, 1.0)])?;
    septal.vertices.iter().for_each(|&vertex| fixed[vertex] = Some(1.0));
    let left = laplacian.solve(&fixed)?;
    let mut fixed = fix(mesh, surface, &[(Epicardium, 0.0)])?;
    septal.vertices.iter().for_each(|&vertex| fixed[vertex] = Some(1.0));
    let septum = laplacian.solve(&fixed)?;

    let (left_share, septum_share) = (means(mesh, &left), means(mesh, &septum));
    let is_left: Vec<bool> = left_share.iter().map(|&share| share > 0.5).collect();
    let region = |(&is_left, &share): (&bool, &f64)| match (is_left, share > 0.5) {
        (false, _) => Region::FreeWallRv,
        (true, true) => Region::Septum,
        (true, false) => Region::FreeWallLv,
    };
    let pick =
        |of_lv: Vec<f64>, of_rv: Vec<f64>| is_left.iter().zip(of_lv.iter().zip(of_rv)).map(|(&l, (a, b))| if l { *a } else { b }).collect();
    let gradient_pairs = gradients(mesh, &from_lv).into_iter().zip(gradients(mesh, &from_rv));
    Ok(TransmuralLayout {
        depth: pick(means(mesh, &from_lv), means(mesh, &from_rv)),
        gradient: is_left.iter().zip(gradient_pairs).map(|(&l, (a, b))| if l { a } else { b }).collect(),
        depth_at_vertices: left.iter().zip(from_lv.iter().zip(&from_rv)).map(|(&l, (a, b))| if l > 0.5 { *a } else { *b }).collect(),
        septum: Some(SeptalLayout { regions: is_left.iter().zip(&septum_share).map(region).collect(), centre_mm: septal.centre_mm }),
    })
}

/// The part of the RV endocardium that faces the LV.
struct SeptalFace {
    vertices: Vec<usize>,
    centre_mm: Vector3<f64>,
}

impl SeptalFace {
    fn find(mesh: &TetMesh, surface: &TaggedSurface, from_rv: &[f64], to_epicardium: &[f64]) -> Result<Self, AnatomyError> {
        // from_rv flows to both; the part that does not flow to the epicardium flows to the LV.
        let (all, outward) = (gradients(mesh, from_rv), gradients(mesh, to_epicardium));
        let holder = holders_of_boundary(mesh);
        let mut balance = vec![0.0; mesh.vertex_count()];
        let (mut area_sum, mut moment) = (0.0, Vector3::zeros());
        for (triangle, _) in surface.triangles().iter().zip(surface.tags()).filter(|(_, tag)| **tag == SurfaceTag::EndocardiumRv) {
            let [a, b, c] = triangle.map(|vertex| mesh.vertices_mm()[vertex]);
            let area = (b - a).cross(&(c - a)) / 2.0;
            let tetrahedron = holder[triangle];
            // Into the wall is against the outward normal.
            let (total, to_epicardium) = (-all[tetrahedron].dot(&area), -outward[tetrahedron].dot(&area));
            let excess = total - 2.0 * to_epicardium;
            triangle.iter().for_each(|&vertex| balance[vertex] += excess);
            if excess > 0.0 {
                area_sum += area.norm();
                moment += (a + b + c) * (area.norm() / 3.0);
            }
        }
        let vertices: Vec<usize> = surface.vertices_with(SurfaceTag::EndocardiumRv).into_iter().filter(|&v| balance[v] > 0.0).collect();
        if vertices.is_empty() || area_sum == 0.0 {
            return Err(AnatomyError::NoSeptum);
        }
        Ok(Self { vertices, centre_mm: moment / area_sum })
    }
}

/// The tetrahedron behind every boundary triangle.
fn holders_of_boundary(mesh: &TetMesh) -> std::collections::HashMap<[usize; 3], usize> {
    let at_vertex = mesh.vertex_tetrahedra();
    let boundary = mesh.boundary_triangles();
    let holder = |triangle: &[usize; 3]| {
        let holds = |&&t: &&usize| triangle.iter().all(|v| mesh.tetrahedra()[t].contains(v));
        at_vertex[triangle[0]].iter().find(holds).copied().unwrap_or(0)
    };
    boundary.iter().map(|triangle| (*triangle, holder(triangle))).collect()
}

/// Values on whole surfaces; a vertex of several surfaces takes the last.
fn fix(mesh: &TetMesh, surface: &TaggedSurface, values: &[(SurfaceTag, f64)]) -> Result<Vec<Option<f64>>, AnatomyError> {
    let mut fixed = vec![None; mesh.vertex_count()];
    for &(tag, value) in values {
        let vertices = surface.vertices_with(tag);
        if vertices.is_empty() {
            return Err(MeshError::MissingSurface { tag }.into());
        }
        vertices.into_iter().for_each(|vertex| fixed[vertex] = Some(value));
    }
    Ok(fixed)
}

fn means(mesh: &TetMesh, values: &[f64]) -> Vec<f64> {
    mesh.tetrahedra().iter().map(|corners| corners.iter().map(|&vertex| values[vertex]).sum::<f64>() / 4.0).collect()
}
