//! Tetrahedral meshes of any implicit function, and of a ventricular wall with its surfaces tagged, \[Billet2009\] §3.
//!
//! Isosurface stuffing (`stuffing`) fills the inside with tetrahedra of bounded angles; the base plane is a plane of the lattice itself,
//! so that base and rim are sharp by construction; `optimise` then moves vertices (those of the surface on the surface) to raise the
//! least dihedral angles, and `tagging` says which triangle is endocardium, epicardium or base.

mod clefts;
mod collapse;
mod lattice;
mod optimise;
mod stencils;
mod stuffing;
mod tagging;
mod thin_walls;

use nalgebra::Vector3;

use super::{AnatomyError, Ventricle};
use crate::mesh::{TaggedSurface, TetMesh};
use lattice::Lattice;
use stuffing::StuffedMesh;

/// An implicit function of a world position in mm: negative inside, positive outside.
pub type LevelSet<'a> = dyn Fn(&Vector3<f64>) -> f64 + Sync + 'a;

/// Mean edge of a body-centred cubic lattice as a fraction of its spacing: three edges of 1 and four of √3/2 a point.
const MEAN_EDGE: f64 = (3.0 + 4.0 * 0.866_025_403_784_438_6) / 7.0;

/// How finely, and how carefully.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MesherSettings {
    /// Mean edge length, mm.
    pub edge_length_mm: f64,
    /// Passes of the optimisation; 0 leaves the stuffed mesh as it is.
    pub optimisation_passes: usize,
}

impl MesherSettings {
    /// Settings for an edge length, with the optimisation on.
    pub fn with_edge_length_mm(edge_length_mm: f64) -> Self {
        Self { edge_length_mm, optimisation_passes: 8 }
    }
}

/// The wall of one ventricle or two as implicit functions in world mm: inside the epicardium, outside every cavity, below the base plane.
///
/// All level sets must continue smoothly beyond the base plane (the cut is the plane's alone), and be positive on the border of the box
/// wherever it lies below the plane.
pub struct WallShape<'a> {
    /// Negative in wall and blood.
    pub epicardium: &'a LevelSet<'a>,
    /// Negative in the blood of each ventricle; the left first.
    pub cavities: Vec<(Ventricle, &'a LevelSet<'a>)>,
    /// A point of the base plane, mm.
    pub base_point_mm: Vector3<f64>,
    /// Unit normal of the base plane, out of the ventricles (towards the atria).
    pub base_normal: Vector3<f64>,
    /// Least and greatest corner of a box around the wall, mm.
    pub bounds_mm: [Vector3<f64>; 2],
}

/// A tetrahedral mesh of the inside of `level` within the box `bounds_mm`.
///
/// # Errors
/// [`AnatomyError`] if the edge length is not positive, the lattice is too large, the function is not finite or nowhere negative.
pub fn mesh_inside(level: &LevelSet, bounds_mm: &[Vector3<f64>; 2], settings: &MesherSettings) -> Result<TetMesh, AnatomyError> {
    let lattice = Lattice::around(bounds_mm, None, checked_spacing_mm(settings)?)?;
    let mut mesh = stuffing::stuff(&lattice, level, None)?;
    improve(&mut mesh, level, &lattice, settings.optimisation_passes);
    Ok(TetMesh::new(mesh.vertices_mm, mesh.tetrahedra)?)
}

/// A tetrahedral mesh of a ventricular wall with its tagged boundary: the base is exactly plane, each endocardium, the epicardium and
/// the base are one connected manifold patch each, and every endocardium has one closed rim in the base plane.
///
/// # Errors
/// [`AnatomyError`] as for [`mesh_inside`], and if the wall is perforated, pinched or in pieces at this edge length.
pub fn mesh_wall(shape: &WallShape, settings: &MesherSettings) -> Result<(TetMesh, TaggedSurface), AnatomyError> {
    let spacing_mm = checked_spacing_mm(settings)?;
    let normal_length = shape.base_normal.norm();
    if !(normal_length.is_finite() && (normal_length - 1.0).abs() < 1e-6) {
        let expectation = "be a unit vector";
        return Err(AnatomyError::Setting { name: "the length of the base normal", value: normal_length, expectation });
    }
    let wall = |p: &Vector3<f64>| shape.cavities.iter().fold((shape.epicardium)(p), |level, (_, cavity)| level.max(-cavity(p)));
    let lattice = Lattice::around(&shape.bounds_mm, Some((shape.base_point_mm, shape.base_normal)), spacing_mm)?;
    let room = |p: &Vector3<f64>| shape.cavities.iter().zip(1..).find(|((_, cavity), _)| cavity(p) < 0.0).map_or(0, |(_, room)| room);
    let mut stuffed = stuffing::stuff(&lattice, &wall, Some(&room))?;
    tagging::keep_largest_piece(&mut stuffed);
    improve(&mut stuffed, &wall, &lattice, settings.optimisation_passes);
    tagging::tag_wall(stuffed, shape)
}

/// Moves vertices; where thin walls have left short edges, removes those and moves again.
fn improve(mesh: &mut StuffedMesh, level: &LevelSet, lattice: &Lattice, passes: usize) {
    optimise::optimise(mesh, level, lattice, passes);
    if passes > 0 && collapse::collapse_short_edges(mesh, lattice.spacing_mm()) > 0 {
        mesh.drop_unused_vertices();
        optimise::optimise(mesh, level, lattice, passes);
    }
}

fn checked_spacing_mm(settings: &MesherSettings) -> Result<f64, AnatomyError> {
    let value = settings.edge_length_mm;
    if value.is_finite() && value > 0.0 {
        Ok(value / MEAN_EDGE)
    } else {
        Err(AnatomyError::Setting { name: "the edge length in mm", value, expectation: "be positive" })
    }
}

/// The gradient of a level set by central differences over `step_mm`.
fn gradient(level: &LevelSet, p: &Vector3<f64>, step_mm: f64) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| {
        let step = Vector3::ith(axis, step_mm);
        (level(&(p + step)) - level(&(p - step))) / (2.0 * step_mm)
    })
}

/// The zero of a level set near `start` by Newton's iteration along its gradient, within the plane of normal `plane` if one is given;
/// none if it does not converge to `tolerance_mm`.
fn surface_point(level: &LevelSet, start: &Vector3<f64>, plane: Option<&Vector3<f64>>, tolerance_mm: f64) -> Option<Vector3<f64>> {
    let mut point = *start;
    for _ in 0..12 {
        let value = level(&point);
        let mut slope = gradient(level, &point, tolerance_mm.max(1e-6));
        if let Some(normal) = plane {
            slope -= normal * normal.dot(&slope);
        }
        let step = slope * (value / slope.norm_squared());
        if !step.iter().all(|s| s.is_finite()) {
            return None;
        }
        if step.norm() < tolerance_mm {
            return Some(point - step);
        }
        point -= step;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Cavity, SurfaceTag};

    fn ellipsoid(radius_mm: f64, length_mm: f64) -> impl Fn(&Vector3<f64>) -> f64 + Sync {
        move |p| ((p.x / radius_mm).powi(2) + (p.y / radius_mm).powi(2) + (p.z / length_mm).powi(2)).sqrt() - 1.0
    }

    /// Truncated ellipsoids: wall and blood volume below z = 20 mm are known exactly.
    #[test]
    fn volumes_of_a_truncated_ellipsoid_converge_at_second_order() {
        let (outer, inner) = (ellipsoid(35.0, 70.0), ellipsoid(25.0, 60.0));
        let below = |radius: f64, length: f64| {
            let t: f64 = 20.0 / length;
            std::f64::consts::PI * radius * radius * length * (t - t.powi(3) / 3.0 + 2.0 / 3.0)
        };
        let shape = WallShape {
            epicardium: &outer,
            cavities: vec![(Ventricle::Left, &inner)],
            base_point_mm: Vector3::new(0.0, 0.0, 20.0),
            base_normal: Vector3::z(),
            bounds_mm: [Vector3::new(-36.0, -36.0, -71.0), Vector3::new(36.0, 36.0, 30.0)],
        };
        let errors = [6.0, 3.0].map(|edge_length_mm| {
            let (mesh, surface) = mesh_wall(&shape, &MesherSettings::with_edge_length_mm(edge_length_mm)).unwrap();
            let blood_mm3 = Cavity::new(&surface, SurfaceTag::EndocardiumLv).unwrap().volume_mm3(mesh.vertices_mm());
            let blood = (blood_mm3 / below(25.0, 60.0) - 1.0).abs();
            let all = ((blood_mm3 + mesh.total_volume_mm3()) / below(35.0, 70.0) - 1.0).abs();
            [blood, all]
        });
        for (coarse, fine) in errors[0].iter().zip(errors[1]) {
            assert!(*coarse < 0.02 && fine < coarse / 3.0, "{coarse} → {fine}");
        }
    }
}
