//! A left ventricle between two truncated ellipsoids.

use nalgebra::{Rotation3, Vector3};

use super::PhantomError;
use super::error::within;
use crate::anatomy::mesher::{MesherSettings, WallShape};
use crate::anatomy::{Anatomy, AnatomySettings, Ventricle, build_anatomy};

/// Endocardium and epicardium are half-ellipsoids of revolution about one axis and one centre, cut by a plane above their equator.
///
/// The default is a normal human left ventricle at diastasis: a cavity of 119 mL, 52 mm wide and 80 mm long, in a wall of 9 mm (thinner at
/// the apex).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdealisedLv {
    /// Radius of the cavity at its equator, mm.
    pub cavity_radius_mm: f64,
    /// Length of the cavity from its equator to its apex, mm.
    pub cavity_length_mm: f64,
    /// Height of the base plane over the equator, mm; less than the cavity's length.
    pub base_height_mm: f64,
    /// Thickness of the wall at the equator, mm.
    pub wall_thickness_mm: f64,
    /// Thickness of the wall at the apex, mm.
    pub apex_thickness_mm: f64,
    /// Centre of the equator in the world, mm.
    pub centre_mm: Vector3<f64>,
    /// Direction from apex to base in the world; any length.
    pub long_axis: Vector3<f64>,
}

impl Default for IdealisedLv {
    fn default() -> Self {
        Self {
            cavity_radius_mm: 26.0,
            cavity_length_mm: 60.0,
            base_height_mm: 18.0,
            wall_thickness_mm: 9.0,
            apex_thickness_mm: 7.0,
            centre_mm: Vector3::zeros(),
            long_axis: Vector3::z(),
        }
    }
}

impl IdealisedLv {
    /// Meshes the wall and completes the anatomy. The septum lies towards `settings.septal_direction`.
    ///
    /// # Errors
    /// [`PhantomError`] if a length is out of range, or the mesher cannot resolve the wall.
    pub fn build(&self, mesher: &MesherSettings, settings: &AnatomySettings) -> Result<Anatomy, PhantomError> {
        self.check()?;
        let own_frame = self.own_frame();
        let own = |p: &Vector3<f64>| own_frame * (p - self.centre_mm);
        let cavity = |p: &Vector3<f64>| ellipsoid_distance_mm(&own(p), self.cavity_radius_mm, self.cavity_length_mm);
        let (outer_radius_mm, outer_length_mm) = self.outer_axes_mm();
        let epicardium = |p: &Vector3<f64>| ellipsoid_distance_mm(&own(p), outer_radius_mm, outer_length_mm);
        let reach_mm = Vector3::repeat(outer_radius_mm.max(outer_length_mm) + 2.0 * mesher.edge_length_mm.abs());
        let base_normal = self.long_axis.normalize();
        let shape = WallShape {
            epicardium: &epicardium,
            cavities: vec![(Ventricle::Left, &cavity)],
            base_point_mm: self.centre_mm + base_normal * self.base_height_mm,
            base_normal,
            bounds_mm: [self.centre_mm - reach_mm, self.centre_mm + reach_mm],
        };
        Ok(build_anatomy(&shape, mesher, settings)?)
    }

    /// Volume of the cavity below the base plane, mm³: $\pi a^2 \left(\tfrac23 c + h - \tfrac{h^3}{3c^2}\right)$.
    pub fn cavity_volume_mm3(&self) -> f64 {
        truncated_volume_mm3(self.cavity_radius_mm, self.cavity_length_mm, self.base_height_mm)
    }

    /// Volume of the wall below the base plane, mm³.
    pub fn wall_volume_mm3(&self) -> f64 {
        let (radius_mm, length_mm) = self.outer_axes_mm();
        truncated_volume_mm3(radius_mm, length_mm, self.base_height_mm) - self.cavity_volume_mm3()
    }

    fn outer_axes_mm(&self) -> (f64, f64) {
        (self.cavity_radius_mm + self.wall_thickness_mm, self.cavity_length_mm + self.apex_thickness_mm)
    }

    fn check(&self) -> Result<(), PhantomError> {
        let lengths = [
            ("the cavity radius in mm", self.cavity_radius_mm),
            ("the cavity length in mm", self.cavity_length_mm),
            ("the wall thickness in mm", self.wall_thickness_mm),
            ("the apex thickness in mm", self.apex_thickness_mm),
        ];
        for (name, value) in lengths {
            within(name, value, [0.1, 1000.0], "lie between 0.1 and 1000 mm")?;
        }
        let most = 0.95 * self.cavity_length_mm;
        within("the base height in mm", self.base_height_mm, [-most, most], "lie well within the length of the cavity")?;
        within("the length of the long axis", self.long_axis.norm(), [1e-6, 1e6], "not be zero")?;
        if !self.centre_mm.iter().all(|x| x.is_finite()) {
            return Err(PhantomError::Setting { name: "the centre in mm", value: f64::NAN, expectation: "be finite" });
        }
        Ok(())
    }

    /// World directions → the own frame, long axis along z.
    fn own_frame(&self) -> Rotation3<f64> {
        let turn = Rotation3::rotation_between(&self.long_axis, &Vector3::z());
        turn.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
    }
}

/// First-order distance to an ellipsoid of revolution about z, negative inside: $q (q - 1) / |\nabla \tfrac12 q^2|$, q the scaled radius.
fn ellipsoid_distance_mm(p: &Vector3<f64>, radius_mm: f64, length_mm: f64) -> f64 {
    let axes = Vector3::new(radius_mm, radius_mm, length_mm);
    let scaled = p.component_div(&axes);
    let (scaled_radius, slope) = (scaled.norm(), scaled.component_div(&axes).norm());
    if slope > 0.0 { scaled_radius * (scaled_radius - 1.0) / slope } else { -radius_mm.min(length_mm) }
}

fn truncated_volume_mm3(radius_mm: f64, length_mm: f64, height_mm: f64) -> f64 {
    let profile_mm = length_mm * 2.0 / 3.0 + height_mm - height_mm.powi(3) / (3.0 * length_mm * length_mm);
    std::f64::consts::PI * radius_mm * radius_mm * profile_mm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mesh_has_the_volumes_of_the_ellipsoids_wherever_they_lie() {
        let oblique =
            IdealisedLv { centre_mm: Vector3::new(-20.0, 35.0, 110.0), long_axis: Vector3::new(-0.6, 0.5, 0.4), ..IdealisedLv::default() };
        for lv in [IdealisedLv::default(), oblique] {
            let anatomy = lv.build(&MesherSettings::with_edge_length_mm(4.0), &AnatomySettings::default()).unwrap();
            let wall_mm3 = anatomy.mesh.total_volume_mm3();
            let cavity_mm3 = anatomy.cavities[0].1.volume_mm3(anatomy.mesh.vertices_mm());
            // Chords of a 4 mm edge on a radius of 26 mm cut off about (4/26)²/8 ≈ 0.3 % of the radius.
            assert!((cavity_mm3 / lv.cavity_volume_mm3() - 1.0).abs() < 0.01, "{cavity_mm3} {}", lv.cavity_volume_mm3());
            assert!((wall_mm3 / lv.wall_volume_mm3() - 1.0).abs() < 0.02, "{wall_mm3} {}", lv.wall_volume_mm3());
            assert!(anatomy.axes.long_axis.dot(&lv.long_axis.normalize()) > 0.999);
        }
    }

    #[test]
    fn the_default_is_a_normal_left_ventricle() {
        let lv = IdealisedLv::default();
        assert!((110_000.0..130_000.0).contains(&lv.cavity_volume_mm3()), "{} mm³", lv.cavity_volume_mm3());
        // 1.05 g/mL: a mass of 100–150 g.
        assert!((95_000.0..143_000.0).contains(&lv.wall_volume_mm3()), "{} mm³", lv.wall_volume_mm3());
    }

    #[test]
    fn impossible_shapes_are_refused() {
        let flat = IdealisedLv { wall_thickness_mm: 0.0, ..IdealisedLv::default() };
        let cut = IdealisedLv { base_height_mm: 80.0, ..IdealisedLv::default() };
        for lv in [flat, cut] {
            let error = lv.build(&MesherSettings::with_edge_length_mm(4.0), &AnatomySettings::default()).unwrap_err();
            assert!(matches!(error, PhantomError::Setting { .. }), "{error}");
        }
    }
}
