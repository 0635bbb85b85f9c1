//! Two ventricles between ellipsoids: a heart of known shape for tests and for studies without a patient.

use nalgebra::{Rotation3, Vector3};

use super::mesher::{MesherSettings, WallShape};
use super::{Anatomy, AnatomyError, AnatomySettings, Ventricle, build_anatomy};
use crate::numerics::rounded_max;

/// The left ventricle lies between two half-ellipsoids of revolution; the right one is the part of a wider ellipsoid, shifted towards the
/// septal side, that lies outside the left epicardium. A plane above the equator cuts both.
///
/// The default is a normal adult heart at diastasis; both cavities hold about 120 mL.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdealisedBiventricle {
    /// Radius of the LV cavity at its equator, mm.
    pub lv_radius_mm: f64,
    /// Length of the LV cavity from its equator to its apex, mm.
    pub lv_length_mm: f64,
    /// Thickness of the LV wall and septum, mm.
    pub lv_wall_mm: f64,
    /// Half-width of the RV ellipsoid from the LV outwards, mm.
    pub rv_width_mm: f64,
    /// Half-width of the RV ellipsoid across, mm.
    pub rv_depth_mm: f64,
    /// Length of the RV ellipsoid from its equator to its apex, mm.
    pub rv_length_mm: f64,
    /// Distance of the RV ellipsoid's centre from the LV's axis, mm.
    pub rv_offset_mm: f64,
    /// Thickness of the RV free wall, mm.
    pub rv_wall_mm: f64,
    /// Radius of the rounding where the ventricles meet, mm.
    pub rounding_mm: f64,
    /// Height of the base plane over the equator, mm.
    pub base_height_mm: f64,
    /// Centre of the LV's equator in the world, mm.
    pub centre_mm: Vector3<f64>,
    /// Direction from apex to base in the world; any length.
    pub long_axis: Vector3<f64>,
    /// Direction from the LV to the RV in the world; any length, made orthogonal to the long axis.
    pub septal_direction: Vector3<f64>,
}

impl Default for IdealisedBiventricle {
    fn default() -> Self {
        Self {
            lv_radius_mm: 26.0,
            lv_length_mm: 60.0,
            lv_wall_mm: 9.0,
            rv_width_mm: 44.0,
            rv_depth_mm: 40.0,
            rv_length_mm: 58.0,
            rv_offset_mm: 22.0,
            rv_wall_mm: 3.0,
            rounding_mm: 5.0,
            base_height_mm: 18.0,
            centre_mm: Vector3::zeros(),
            long_axis: Vector3::z(),
            septal_direction: Vector3::x(),
        }
    }
}

impl IdealisedBiventricle {
    /// Meshes both walls and completes the anatomy.
    ///
    /// # Errors
    /// [`AnatomyError`] if a length or direction is out of range, or the mesher cannot resolve the walls.
    pub fn build(&self, mesher: &MesherSettings, settings: &AnatomySettings) -> Result<Anatomy, AnatomyError> {
        self.check()?;
        let to_own = self.own_frame()?;
        let own = |p: &Vector3<f64>| to_own * (p - self.centre_mm);
        let epicardium = |p: &Vector3<f64>| self.epicardium_mm(&own(p));
        let left = |p: &Vector3<f64>| self.left_cavity_mm(&own(p));
        let right = |p: &Vector3<f64>| self.right_cavity_mm(&own(p));
        let base_normal = self.long_axis.normalize();
        let width_mm = (self.rv_offset_mm + self.rv_width_mm + self.rv_wall_mm).max(self.rv_depth_mm + self.rv_wall_mm);
        let reach_mm = width_mm.max(self.lv_length_mm + self.lv_wall_mm).max(self.lv_radius_mm + self.lv_wall_mm);
        let margin_mm = Vector3::repeat(1.5 * reach_mm + 2.0 * mesher.edge_length_mm.abs());
        let shape = WallShape {
            epicardium: &epicardium,
            cavities: vec![(Ventricle::Left, &left), (Ventricle::Right, &right)],
            base_point_mm: self.centre_mm + base_normal * self.base_height_mm,
            base_normal,
            bounds_mm: [self.centre_mm - margin_mm, self.centre_mm + margin_mm],
        };
        build_anatomy(&shape, mesher, settings)
    }

    fn check(&self) -> Result<(), AnatomyError> {
        let lengths = [
            ("lv_radius_mm", self.lv_radius_mm),
            ("lv_length_mm", self.lv_length_mm),
            ("lv_wall_mm", self.lv_wall_mm),
            ("rv_width_mm", self.rv_width_mm),
            ("rv_depth_mm", self.rv_depth_mm),
            ("rv_length_mm", self.rv_length_mm),
            ("rv_offset_mm", self.rv_offset_mm),
            ("rv_wall_mm", self.rv_wall_mm),
            ("rounding_mm", self.rounding_mm),
        ];
        for (name, value) in lengths {
            if !(value > 0.0 && value <= 200.0) {
                return Err(AnatomyError::Setting { name, value, expectation: "lie between 0 and 200" });
            }
        }
        let limit_mm = 0.9 * self.lv_length_mm.min(self.rv_length_mm);
        if !(0.0..limit_mm).contains(&self.base_height_mm) {
            let expectation = "lie between 0 and nine tenths of the shorter ventricle's length";
            return Err(AnatomyError::Setting { name: "base_height_mm", value: self.base_height_mm, expectation });
        }
        let protrusion_mm = self.rv_offset_mm + self.rv_width_mm - self.lv_radius_mm - self.lv_wall_mm;
        if protrusion_mm < 2.0 * self.rounding_mm {
            let expectation = "exceed twice the rounding: make the RV wider or move it outwards";
            return Err(AnatomyError::Setting { name: "the width of the RV cavity", value: protrusion_mm, expectation });
        }
        Ok(())
    }

    /// Rotation from the world to the heart's own axes: x towards the RV, z towards the base.
    fn own_frame(&self) -> Result<Rotation3<f64>, AnatomyError> {
        let invalid = |name| AnatomyError::Setting { name, value: 0.0, expectation: "be directions that are not parallel" };
        let z = self.long_axis.try_normalize(1e-9).ok_or_else(|| invalid("long_axis"))?;
        let across = self.septal_direction - z * z.dot(&self.septal_direction);
        let x = across.try_normalize(1e-6).ok_or_else(|| invalid("septal_direction"))?;
        Ok(Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]).inverse())
    }

    fn left_cavity_mm(&self, p: &Vector3<f64>) -> f64 {
        ellipsoid_distance_mm(p, &Vector3::new(self.lv_radius_mm, self.lv_radius_mm, self.lv_length_mm))
    }

    fn left_epicardium_mm(&self, p: &Vector3<f64>) -> f64 {
        let radius_mm = self.lv_radius_mm + self.lv_wall_mm;
        ellipsoid_distance_mm(p, &Vector3::new(radius_mm, radius_mm, self.lv_length_mm + self.lv_wall_mm))
    }

    fn right_ellipsoid_mm(&self, p: &Vector3<f64>, more_mm: f64) -> f64 {
        let radii = Vector3::new(self.rv_width_mm, self.rv_depth_mm, self.rv_length_mm).add_scalar(more_mm);
        ellipsoid_distance_mm(&(p - Vector3::x() * self.rv_offset_mm), &radii)
    }

    fn right_cavity_mm(&self, p: &Vector3<f64>) -> f64 {
        rounded_max(self.right_ellipsoid_mm(p, 0.0), -self.left_epicardium_mm(p), self.rounding_mm)
    }

    fn epicardium_mm(&self, p: &Vector3<f64>) -> f64 {
        -rounded_max(-self.left_epicardium_mm(p), -self.right_ellipsoid_mm(p, self.rv_wall_mm), self.rounding_mm)
    }
}

/// Distance to an ellipsoid about the origin, negative inside, exact to first order at its surface: $k(k-1)/|p/r^2|$ with $k = |p/r|$.
fn ellipsoid_distance_mm(p: &Vector3<f64>, radii_mm: &Vector3<f64>) -> f64 {
    let scaled = p.component_div(radii_mm);
    let k = scaled.norm();
    let slope = scaled.component_div(radii_mm).norm();
    if slope < 1e-12 { -radii_mm.min() } else { k * (k - 1.0) / slope }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::Region;
    use crate::mesh::{MeshQuality, SurfaceTag};

    fn default_heart(edge_length_mm: f64) -> Anatomy {
        IdealisedBiventricle::default().build(&MesherSettings::with_edge_length_mm(edge_length_mm), &AnatomySettings::default()).unwrap()
    }

    #[test]
    fn both_ventricles_are_of_normal_size_and_well_meshed() {
        let anatomy = default_heart(5.0);
        let volume_ml = |i: usize| anatomy.cavities[i].1.volume_mm3(anatomy.mesh.vertices_mm()) / 1e3;
        assert_eq!(anatomy.cavities.iter().map(|(v, _)| *v).collect::<Vec<_>>(), [Ventricle::Left, Ventricle::Right]);
        assert!((110.0..130.0).contains(&volume_ml(0)) && (110.0..150.0).contains(&volume_ml(1)), "{} {}", volume_ml(0), volume_ml(1));
        let quality = MeshQuality::of(&anatomy.mesh);
        assert!(quality.dihedral_least_deg > 8.0 && quality.dihedral_percentile_1_deg > 18.0, "{quality:?}");
        assert!((anatomy.axes.septal_direction - Vector3::x()).norm() < 0.1, "{:?}", anatomy.axes);
    }

    #[test]
    fn regions_lie_where_the_shape_says() {
        let anatomy = default_heart(5.0);
        let heart = IdealisedBiventricle::default();
        let mut wrong_mm3 = 0.0;
        for (t, &region) in anatomy.regions.iter().enumerate() {
            let centre = anatomy.mesh.corners_mm(t).iter().sum::<Vector3<f64>>() / 4.0;
            // Well inside the LV's ellipsoid it is LV or septum; well outside it is RV; the septum is what the RV ellipsoid covers.
            let from_epicardium = heart.left_epicardium_mm(&centre);
            let is_rv = region == Region::FreeWallRv;
            let is_misplaced = (from_epicardium < -3.0 && is_rv) || (from_epicardium > 3.0 && !is_rv);
            let is_far_side = centre.x < -5.0 && region == Region::Septum;
            let misses_septum =
                centre.x > 25.0 && centre.y.abs() < 12.0 && centre.z.abs() < 15.0 && from_epicardium < -1.0 && region != Region::Septum;
            if is_misplaced || is_far_side || misses_septum {
                wrong_mm3 += anatomy.mesh.volume_mm3(t);
            }
            assert_eq!(is_rv, anatomy.aha_segments[t] == 0);
        }
        assert!(wrong_mm3 < 0.01 * anatomy.mesh.total_volume_mm3(), "{wrong_mm3}");
    }

    #[test]
    fn fibres_turn_the_right_way_in_both_free_walls() {
        let anatomy = default_heart(5.0);
        let (mut right, mut all) = (0, 0);
        for (t, axes) in anatomy.fibre_axes.iter().enumerate() {
            let centre = anatomy.mesh.corners_mm(t).iter().sum::<Vector3<f64>>() / 4.0;
            let rv_centre = Vector3::x() * IdealisedBiventricle::default().rv_offset_mm;
            let (about, depth) = match anatomy.regions[t] {
                Region::FreeWallRv if centre.x > 45.0 => (centre - rv_centre, &anatomy.transmural_depth),
                Region::FreeWallLv if centre.x < 0.0 => (centre, &anatomy.transmural_depth),
                _ => continue,
            };
            let circumferential = Vector3::z().cross(&about);
            let mean: f64 = anatomy.mesh.tetrahedra()[t].iter().map(|&v| depth[v]).sum::<f64>() / 4.0;
            let handedness = axes.column(0).z * axes.column(0).dot(&circumferential);
            if centre.z.abs() < 15.0 && (mean - 0.5).abs() > 0.2 {
                all += 1;
                right += usize::from((handedness > 0.0) == (mean < 0.5));
            }
        }
        assert!(all > 200 && right * 100 > all * 97, "{right} of {all}");
    }

    #[test]
    fn the_septum_is_crossed_from_left_to_right() {
        let anatomy = default_heart(5.0);
        let depths =
            |tag: SurfaceTag| -> Vec<f64> { anatomy.surface.vertices_with(tag).iter().map(|&v| anatomy.transmural_depth[v]).collect() };
        assert!(depths(SurfaceTag::EndocardiumLv).iter().all(|&d| d == 0.0));
        assert!(depths(SurfaceTag::Epicardium).iter().all(|&d| d == 1.0));
        let right = depths(SurfaceTag::EndocardiumRv);
        let (septal, free) = (right.iter().filter(|&&d| d == 1.0).count(), right.iter().filter(|&&d| d == 0.0).count());
        assert!(septal + free == right.len() && septal * 5 > right.len() && free * 3 > right.len(), "{septal} {free}");
    }

    #[test]
    fn senseless_shapes_are_refused() {
        let mesher = MesherSettings::with_edge_length_mm(6.0);
        let build = |heart: IdealisedBiventricle| heart.build(&mesher, &AnatomySettings::default());
        let normal = IdealisedBiventricle::default();
        assert!(matches!(
            build(IdealisedBiventricle { rv_wall_mm: -1.0, ..normal }),
            Err(AnatomyError::Setting { name: "rv_wall_mm", .. })
        ));
        assert!(matches!(build(IdealisedBiventricle { base_height_mm: f64::NAN, ..normal }), Err(AnatomyError::Setting { .. })));
        assert!(matches!(
            build(IdealisedBiventricle { rv_offset_mm: 1e-3, rv_width_mm: 30.0, ..normal }),
            Err(AnatomyError::Setting { .. })
        ));
        assert!(matches!(build(IdealisedBiventricle { septal_direction: Vector3::z(), ..normal }), Err(AnatomyError::Setting { .. })));
    }
}
