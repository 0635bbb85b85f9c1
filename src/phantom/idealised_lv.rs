//! A left ventricle between two truncated ellipsoids.

use nalgebra::{Rotation3, Vector3};

use super::PhantomError;
use super::error::within;
use crate::anatomy::mesher::{MesherSettings, WallShape};
use crate::anatomy::{Anatomy, AnatomySettings, Ventricle, build_anatomy};

/// Endocardium and epicardium are half-ellipsoids about parallel axes, cut by a plane above their equator; of revolution and of one centre unless
/// `cross_section_ratio` or `epicardium_offset_mm` says otherwise, so that the images show how the heart turns.
///
/// The default is a normal human left ventricle at diastasis: a cavity of 119 mL, 52 mm wide and 80 mm long, in a wall of 9 mm (thinner at
/// the apex).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdealisedLv {
    /// Radius of the cavity at its equator, mm; of the circle of the same area where the section is an ellipse.
    pub cavity_radius_mm: f64,
    /// Length of the cavity from its equator to its apex, mm.
    pub cavity_length_mm: f64,
    /// Height of the base plane over the equator, mm; less than the cavity's length.
    pub base_height_mm: f64,
    /// Thickness of the wall at the equator, mm.
    pub wall_thickness_mm: f64,
    /// Thickness of the wall at the apex, mm.
    pub apex_thickness_mm: f64,
    /// Long over short axis ρ of the cavity's cross-section, an ellipse with the semi-axes $a\sqrt\rho$ and $a/\sqrt\rho$ along the own x and y.
    pub cross_section_ratio: f64,
    /// How far the epicardium lies off the cavity's axis along the own x, mm: the wall is thicker by that on one side and thinner on the other.
    pub epicardium_offset_mm: f64,
    /// Centre of the cavity's equator in the world, mm.
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
            cross_section_ratio: 1.0,
            epicardium_offset_mm: 0.0,
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
        let (inner_mm, outer_mm) = (self.inner_axes_mm(), self.outer_axes_mm());
        let offset_mm = Vector3::x() * self.epicardium_offset_mm;
        let cavity = |p: &Vector3<f64>| ellipsoid_distance_mm(&own(p), &inner_mm);
        let epicardium = |p: &Vector3<f64>| ellipsoid_distance_mm(&(own(p) - offset_mm), &outer_mm);
        let reach_mm = Vector3::repeat(outer_mm.amax() + offset_mm.norm() + 2.0 * mesher.edge_length_mm.abs());
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
        truncated_volume_mm3(&self.inner_axes_mm(), self.base_height_mm)
    }

    /// Volume of the wall below the base plane, mm³.
    pub fn wall_volume_mm3(&self) -> f64 {
        truncated_volume_mm3(&self.outer_axes_mm(), self.base_height_mm) - self.cavity_volume_mm3()
    }

    /// Semi-axes of the endocardium along the own axes, mm.
    fn inner_axes_mm(&self) -> Vector3<f64> {
        let stretch = self.cross_section_ratio.sqrt();
        Vector3::new(self.cavity_radius_mm * stretch, self.cavity_radius_mm / stretch, self.cavity_length_mm)
    }

    fn outer_axes_mm(&self) -> Vector3<f64> {
        self.inner_axes_mm() + Vector3::new(self.wall_thickness_mm, self.wall_thickness_mm, self.apex_thickness_mm)
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
        within("the ratio of the cross-section's axes", self.cross_section_ratio, [0.2, 5.0], "lie between 0.2 and 5")?;
        let thinnest = 0.8 * self.wall_thickness_mm;
        within("the offset of the epicardium in mm", self.epicardium_offset_mm, [-thinnest, thinnest], "leave a wall on both sides")?;
        within("the length of the long axis", self.long_axis.norm(), [1e-6, 1e6], "not be zero")?;
        if !self.centre_mm.iter().all(|x| x.is_finite()) {
            return Err(PhantomError::Setting { name: "the centre in mm", value: f64::NAN, expectation: "be finite" });
        }
        Ok(())
    }

    /// World directions → the own frame, long axis along z.
    pub(super) fn own_frame(&self) -> Rotation3<f64> {
        let turn = Rotation3::rotation_between(&self.long_axis, &Vector3::z());
        turn.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
    }
}

/// First-order distance to an ellipsoid with its axes along x, y and z, negative inside: $q (q - 1) / |\nabla \tfrac12 q^2|$, q the scaled radius.
fn ellipsoid_distance_mm(p: &Vector3<f64>, axes_mm: &Vector3<f64>) -> f64 {
    let scaled = p.component_div(axes_mm);
    let (scaled_radius, slope) = (scaled.norm(), scaled.component_div(axes_mm).norm());
    if slope > 0.0 { scaled_radius * (scaled_radius - 1.0) / slope } else { -axes_mm.min() }
}

fn truncated_volume_mm3(axes_mm: &Vector3<f64>, height_mm: f64) -> f64 {
    let profile_mm = axes_mm.z * 2.0 / 3.0 + height_mm - height_mm.powi(3) / (3.0 * axes_mm.z * axes_mm.z);
    std::f64::consts::PI * axes_mm.x * axes_mm.y * profile_mm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mesh_has_the_volumes_of_the_ellipsoids_wherever_they_lie() {
        let oblique =
            IdealisedLv { centre_mm: Vector3::new(-20.0, 35.0, 110.0), long_axis: Vector3::new(-0.6, 0.5, 0.4), ..IdealisedLv::default() };
        let lopsided = IdealisedLv { cross_section_ratio: 1.3, epicardium_offset_mm: 3.0, ..oblique };
        for lv in [IdealisedLv::default(), oblique, lopsided] {
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
        let open = IdealisedLv { epicardium_offset_mm: 9.0, ..IdealisedLv::default() };
        for lv in [flat, cut, open] {
            let error = lv.build(&MesherSettings::with_edge_length_mm(4.0), &AnatomySettings::default()).unwrap_err();
            assert!(matches!(error, PhantomError::Setting { .. }), "{error}");
        }
    }
}
