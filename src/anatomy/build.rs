//! From a wall's shape, or a tagged mesh, to a whole anatomy: depth, axes, fibres, segments, regions.

use nalgebra::Vector3;

use super::fibres::local_axes;
use super::mesher::{LevelSet, MesherSettings, WallShape, mesh_wall};
use super::segments::{aha_segment, cavity_depth_mm, heart_axes, region_of_segment};
use super::transmural::{lay_out_biventricle, lay_out_lv};
use super::{Anatomy, AnatomyError, DEFAULT_SEPTAL_DIRECTION, FibreRule, Region, Ventricle};
use crate::image::{HeartFields, Volume, enclosed_volume_ml};
use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};
use crate::units::MM3_PER_ML;

/// What a mesh alone does not say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnatomySettings {
    /// Helix angles of the fibres.
    pub fibres: FibreRule,
    /// Helix angles in the free wall of the right ventricle; those of the left where absent.
    pub fibres_rv: Option<FibreRule>,
    /// World direction from the LV towards the middle of the septum; any length, made orthogonal to the long axis. An LV-only geometry
    /// does not show it, so the study gives it or takes [`DEFAULT_SEPTAL_DIRECTION`]. With two ventricles the meshed septum decides.
    pub septal_direction: Vector3<f64>,
}

impl Default for AnatomySettings {
    fn default() -> Self {
        Self { fibres: FibreRule::default(), fibres_rv: None, septal_direction: Vector3::from(DEFAULT_SEPTAL_DIRECTION) }
    }
}

impl AnatomySettings {
    fn check(&self) -> Result<(), AnatomyError> {
        self.fibres.check()?;
        self.fibres_rv.map_or(Ok(()), |fibres| fibres.check())
    }
}

/// Meshes a wall of one ventricle or two and completes it.
///
/// # Errors
/// [`AnatomyError`] of the mesher or of [`complete_anatomy`].
pub fn build_anatomy(shape: &WallShape, mesher: &MesherSettings, settings: &AnatomySettings) -> Result<Anatomy, AnatomyError> {
    settings.check()?;
    let (mesh, surface) = mesh_wall(shape, mesher)?;
    complete_anatomy(mesh, surface, settings)
}

/// Volumes of cavities and hull that are off by less than this share are left as they are.
const VOLUME_TOLERANCE: f64 = 2e-3;

/// Meshes the heart of an image's signed-distance fields, one ventricle or two, and completes it.
///
/// A polyhedron with its corners on a curved surface encloses less than the surface does where it bulges. The mesh is therefore made twice:
/// the second time every level set is moved by δ = (V − V_mesh)/A, with V the volume that it encloses, V_mesh that of the first mesh and A the
/// area of its surface. What remains is of a higher order in the edge length, and the surface lies as much inside as outside of the true
/// one.
///
/// # Errors
/// [`AnatomyError`] of [`build_anatomy`].
pub fn build_from_fields(fields: &HeartFields, mesher: &MesherSettings, settings: &AnatomySettings) -> Result<Anatomy, AnatomyError> {
    settings.fibres.check()?;
    let mut shifts = Shifts::default();
    let (mesh, surface) = shifts.mesh(fields, mesher)?;
    let is_near = shifts.correct(fields, &mesh, &surface)?;
    let (mesh, surface) = if is_near { (mesh, surface) } else { shifts.mesh(fields, mesher)? };
    complete_anatomy(mesh, surface, settings)
}

/// By how much each level set is moved outward, mm.
#[derive(Default)]
struct Shifts {
    epicardium_mm: f64,
    cavities_mm: [f64; 2],
}

impl Shifts {
    fn mesh(&self, fields: &HeartFields, mesher: &MesherSettings) -> Result<(TetMesh, TaggedSurface), AnatomyError> {
        let left = |p: &Vector3<f64>| distance_mm(&fields.cavity_lv, p) - self.cavities_mm[0];
        let right = |p: &Vector3<f64>| fields.cavity_rv.as_ref().map_or(FAR_MM, |field| distance_mm(field, p)) - self.cavities_mm[1];
        let epicardium = |p: &Vector3<f64>| distance_mm(&fields.epicardium, p) - self.epicardium_mm;
        let mut cavities: Vec<(Ventricle, &LevelSet)> = vec![(Ventricle::Left, &left)];
        if fields.cavity_rv.is_some() {
            cavities.push((Ventricle::Right, &right));
        }
        let shape = WallShape {
            epicardium: &epicardium,
            cavities,
            base_point_mm: fields.base_plane.point_mm,
            base_normal: fields.base_plane.normal,
            bounds_mm: box_of(&fields.epicardium),
        };
        mesh_wall(&shape, mesher)
    }

    /// Sets the shifts that make up for what a mesh lacks; whether it lacks nothing.
    fn correct(&mut self, fields: &HeartFields, mesh: &TetMesh, surface: &TaggedSurface) -> Result<bool, AnatomyError> {
        let area_mm2 = |tag| {
            let of = |[a, b, c]: [usize; 3]| {
                let at = |v: usize| mesh.vertices_mm()[v];
                (at(b) - at(a)).cross(&(at(c) - at(a))).norm() / 2.0
            };
            surface.triangles_with(tag).map(of).sum::<f64>()
        };
        let wanted_mm3 = [Some(&fields.cavity_lv), fields.cavity_rv.as_ref()].map(|field| field.map(|f| enclosed_volume_mm3(f, fields)));
        let mut hull_mm3 = mesh.total_volume_mm3();
        let mut largest = 0.0_f64;
        for ((ventricle, cavity), (wanted, shift)) in
            Anatomy::close_cavities(surface)?.iter().zip(wanted_mm3.iter().zip(&mut self.cavities_mm))
        {
            let meshed_mm3 = cavity.volume_mm3(mesh.vertices_mm());
            let lacking_mm3 = wanted.unwrap_or(meshed_mm3) - meshed_mm3;
            *shift += lacking_mm3 / area_mm2(ventricle.endocardium());
            hull_mm3 += meshed_mm3;
            largest = largest.max(lacking_mm3.abs() / meshed_mm3);
        }
        let lacking_mm3 = enclosed_volume_mm3(&fields.epicardium, fields) - hull_mm3;
        self.epicardium_mm += lacking_mm3 / area_mm2(SurfaceTag::Epicardium);
        Ok(largest.max(lacking_mm3.abs() / hull_mm3) < VOLUME_TOLERANCE)
    }
}

fn enclosed_volume_mm3(field: &Volume, fields: &HeartFields) -> f64 {
    enclosed_volume_ml(field, &fields.base_plane) * MM3_PER_ML
}

/// Beyond the grid everything is outside by this much.
const FAR_MM: f64 = 1e3;

/// A sampled signed distance; beyond the grid everything is far outside.
fn distance_mm(field: &Volume, position_mm: &Vector3<f64>) -> f64 {
    field.sample(position_mm).unwrap_or(FAR_MM)
}

fn box_of(field: &Volume) -> [Vector3<f64>; 2] {
    let grid = field.grid();
    let last = grid.shape().map(|n| n.saturating_sub(1) as f64);
    let corner = |c: usize| grid.to_world_mm(&Vector3::from_fn(|axis, _| if c >> axis & 1 == 1 { last[axis] } else { 0.0 }));
    let start = [corner(0), corner(0)];
    (1..8).map(corner).fold(start, |[low, high], p| [low.inf(&p), high.sup(&p)])
}

/// Completes a tagged mesh of one ventricle or two, however it was made: transmural depth (harmonic, 0 on the endocardium, 1 on the other
/// side of the wall), local axes, fibres, AHA segments of the LV and regions. The septum belongs to the LV, with the RV side outside.
///
/// # Errors
/// [`AnatomyError`] if a surface is missing, a cavity cannot be closed, an angle is out of range or the depth cannot be solved for.
pub fn complete_anatomy(mesh: TetMesh, surface: TaggedSurface, settings: &AnatomySettings) -> Result<Anatomy, AnatomyError> {
    settings.check()?;
    let cavities = Anatomy::close_cavities(&surface)?;
    let cavity = &cavities[0].1;
    let layout = if cavities.len() > 1 { lay_out_biventricle(&mesh, &surface)? } else { lay_out_lv(&mesh, &surface)? };
    let septal_direction = match &layout.septum {
        Some(septum) => septum.centre_mm - cavity.lid_centre_mm(mesh.vertices_mm()),
        None => settings.septal_direction,
    };
    let axes = heart_axes(&mesh, cavity, &septal_direction)?;
    let cavity_depth_mm = cavity_depth_mm(&mesh, cavity, &axes);
    let centre = |t: usize| mesh.corners_mm(t).iter().sum::<Vector3<f64>>() / 4.0;
    let mut aha_segments: Vec<u8> = (0..mesh.tetrahedron_count()).map(|t| aha_segment(&axes, cavity_depth_mm, &centre(t))).collect();
    let regions = match layout.septum {
        Some(septum) => septum.regions,
        None => aha_segments.iter().map(|&segment| region_of_segment(segment)).collect(),
    };
    for (segment, _) in aha_segments.iter_mut().zip(&regions).filter(|(_, region)| **region == Region::FreeWallRv) {
        *segment = 0;
    }
    let heart_axes: Vec<_> = layout.gradient.iter().map(|gradient| local_axes(gradient, &axes)).collect();
    let rule_of = |region: &Region| match region {
        Region::FreeWallRv => settings.fibres_rv.unwrap_or(settings.fibres),
        Region::FreeWallLv | Region::Septum | Region::Scar => settings.fibres,
    };
    let places = heart_axes.iter().zip(&layout.depth).zip(&regions);
    let fibre_axes = places.map(|((local, &depth), region)| rule_of(region).fibre_axes(local, depth)).collect();
    let transmural_depth = layout.depth_at_vertices;
    Ok(Anatomy { mesh, surface, cavities, transmural_depth, fibre_axes, heart_axes, regions, aha_segments, axes })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::Region;

    fn ellipsoidal_lv(edge_length_mm: f64) -> Anatomy {
        let ellipsoid = |radius: f64, length: f64| {
            move |p: &Vector3<f64>| ((p.x / radius).powi(2) + (p.y / radius).powi(2) + (p.z / length).powi(2)).sqrt() - 1.0
        };
        let (outer, inner) = (ellipsoid(35.0, 70.0), ellipsoid(25.0, 60.0));
        let shape = WallShape {
            epicardium: &outer,
            cavities: vec![(Ventricle::Left, &inner)],
            base_point_mm: Vector3::new(0.0, 0.0, 20.0),
            base_normal: Vector3::z(),
            bounds_mm: [Vector3::new(-36.0, -36.0, -71.0), Vector3::new(36.0, 36.0, 30.0)],
        };
        let settings = AnatomySettings { septal_direction: Vector3::x(), ..AnatomySettings::default() };
        build_anatomy(&shape, &MesherSettings::with_edge_length_mm(edge_length_mm), &settings).unwrap()
    }

    #[test]
    fn fibres_follow_the_rule_about_the_true_axis() {
        let anatomy = ellipsoidal_lv(4.0);
        assert!((anatomy.axes.long_axis - Vector3::z()).norm() < 0.02, "{:?}", anatomy.axes);
        let rule = FibreRule::default();
        for (t, corners) in anatomy.mesh.tetrahedra().iter().enumerate() {
            let axes = anatomy.fibre_axes[t];
            assert!((axes.transpose() * axes - nalgebra::Matrix3::identity()).norm() < 1e-12 && axes.determinant() > 0.0);
            let centre = anatomy.mesh.corners_mm(t).iter().sum::<Vector3<f64>>() / 4.0;
            if centre.z < -40.0 {
                continue;
            }
            // Independent of the code's axes: anticlockwise about z, and the wall's meridian as the rest of the fibre.
            let circumferential = Vector3::z().cross(&centre).normalize();
            let depth = corners.iter().map(|&v| anatomy.transmural_depth[v]).sum::<f64>() / 4.0;
            let fibre = axes.column(0).into_owned() * axes.column(0).dot(&circumferential).signum();
            let angle_deg = fibre.z.atan2(fibre.dot(&circumferential)).to_degrees();
            let expected_deg = rule.helix_angle_rad(depth).to_degrees();
            assert!((angle_deg - expected_deg).abs() < 8.0, "{angle_deg} {expected_deg} at {centre}");
        }
    }

    #[test]
    fn segments_share_the_wall_evenly_round_the_axis() {
        let anatomy = ellipsoidal_lv(5.0);
        let mut volume_mm3 = [0.0; 18];
        for (t, &segment) in anatomy.aha_segments.iter().enumerate() {
            volume_mm3[usize::from(segment)] += anatomy.mesh.volume_mm3(t);
        }
        for ring in [1..7, 7..13, 13..17] {
            let mean = volume_mm3[ring.clone()].iter().sum::<f64>() / ring.len() as f64;
            assert!(volume_mm3[ring].iter().all(|v| (v / mean - 1.0).abs() < 0.1), "{volume_mm3:?}");
        }
        assert!(volume_mm3[0] == 0.0 && volume_mm3[17] > 0.0);
        let septum: f64 =
            (0..anatomy.regions.len()).filter(|&t| anatomy.regions[t] == Region::Septum).map(|t| anatomy.mesh.volume_mm3(t)).sum();
        let share = septum / anatomy.mesh.total_volume_mm3();
        assert!((0.25..0.36).contains(&share), "{share}");
    }

    #[test]
    fn a_septal_direction_along_the_axis_is_refused() {
        let anatomy = ellipsoidal_lv(6.0);
        let settings = AnatomySettings { septal_direction: Vector3::z(), ..AnatomySettings::default() };
        let error = complete_anatomy(anatomy.mesh, anatomy.surface, &settings).unwrap_err();
        assert!(matches!(error, AnatomyError::Setting { .. }), "{error}");
    }
}
