//! A motion in closed form for the idealised ventricle: it shortens, thickens, twists and keeps the volume of every piece of wall.

use nalgebra::{Rotation2, Vector2, Vector3};

use super::IdealisedLv;

/// A contraction at its peak. With z' = z_apex + (1 − ε)(z − z_apex) and r'² = (r² − κ r_endo(z)²)/(1 − ε) the map has determinant 1, and the cavity
/// ejects the share κ of its volume, exactly; r in coordinates that make a circle of an elliptic cross-section, and before the heart turns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrescribedContraction {
    /// Ejection fraction κ, below 1.
    pub ejection_fraction: f64,
    /// Shortening ε of the long axis, below 1; the base comes down, the apex stays.
    pub shortening: f64,
    /// Turn of the base relative to the apex, radian.
    pub twist_rad: f64,
}

impl Default for PrescribedContraction {
    fn default() -> Self {
        Self { ejection_fraction: 0.6, shortening: 0.15, twist_rad: 0.2 }
    }
}

impl PrescribedContraction {
    /// Where points of the wall or the cavity of `lv` are at a share of the contraction (0 at rest, 1 at its peak).
    pub fn positions_mm(&self, lv: &IdealisedLv, rest_mm: &[Vector3<f64>], share: f64) -> Vec<Vector3<f64>> {
        let own_frame = lv.own_frame();
        let apex_mm = -lv.cavity_length_mm - lv.apex_thickness_mm;
        let length_mm = lv.base_height_mm - apex_mm;
        let stretch = 1.0 - share * self.shortening;
        let widths = Vector2::new(lv.cross_section_ratio.sqrt(), lv.cross_section_ratio.sqrt().recip());
        let place = |rest: &Vector3<f64>| {
            let own = own_frame * (rest - lv.centre_mm);
            let round = own.xy().component_div(&widths);
            let endocardium_mm2 = lv.cavity_radius_mm.powi(2) * (1.0 - (own.z / lv.cavity_length_mm).powi(2)).max(0.0);
            let squared_mm2 = round.norm_squared();
            let shrunk_mm2 = (squared_mm2 - share * self.ejection_fraction * endocardium_mm2.min(squared_mm2)) / stretch;
            let factor = if squared_mm2 > 0.0 { (shrunk_mm2.max(0.0) / squared_mm2).sqrt() } else { 0.0 };
            let turn = Rotation2::new(share * self.twist_rad * (own.z - apex_mm) / length_mm);
            let across = turn * (own.xy() * factor);
            let moved = Vector3::new(across.x, across.y, apex_mm + stretch * (own.z - apex_mm));
            lv.centre_mm + own_frame.inverse() * moved
        };
        rest_mm.iter().map(place).collect()
    }

    /// The share of the contraction at a time: rises over `systole_s` and falls over as long, by half a cosine each; periodic.
    pub fn share_at(time_s: f64, systole_s: f64, period_s: f64) -> f64 {
        let phase_s = time_s.rem_euclid(period_s);
        let turn = (phase_s / systole_s).min(2.0) * std::f64::consts::PI;
        0.5 * (1.0 - turn.cos())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::AnatomySettings;
    use crate::anatomy::mesher::MesherSettings;

    #[test]
    fn the_cavity_ejects_its_share_and_the_wall_keeps_its_volume() {
        let oblique =
            IdealisedLv { long_axis: Vector3::new(-0.6, 0.5, 0.4), centre_mm: Vector3::new(10.0, 20.0, 30.0), ..IdealisedLv::default() };
        let lopsided = IdealisedLv { cross_section_ratio: 1.3, epicardium_offset_mm: 3.0, ..oblique };
        let motion = PrescribedContraction::default();
        for lv in [oblique, lopsided] {
            let anatomy = lv.build(&MesherSettings::with_edge_length_mm(3.0), &AnatomySettings::default()).unwrap();
            let rest = anatomy.mesh.vertices_mm();
            let moved = motion.positions_mm(&lv, rest, 1.0);
            let cavity = &anatomy.cavities[0].1;
            let ejected = 1.0 - cavity.volume_mm3(&moved) / cavity.volume_mm3(rest);
            assert!((ejected - motion.ejection_fraction).abs() < 0.01, "{ejected}");
            let volume = |points: &[Vector3<f64>], [a, b, c, d]: [usize; 4]| {
                (points[b] - points[a]).cross(&(points[c] - points[a])).dot(&(points[d] - points[a])) / 6.0
            };
            let moved_mm3: f64 = anatomy.mesh.tetrahedra().iter().map(|&t| volume(&moved, t)).sum();
            assert!((moved_mm3 / anatomy.mesh.total_volume_mm3() - 1.0).abs() < 0.01);
        }
    }
}
