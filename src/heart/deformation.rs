//! How the wall deforms between two instants: strains by AHA segment, twist, thickening, descent of the base.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::anatomy::Anatomy;
use crate::mesh::SurfaceTag;

/// Mean engineering strains, relative changes of length along the local axes at rest: |F_t d| / |F_0 d| − 1.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Strain {
    /// Ecc, around the ventricle; negative in systole.
    pub circumferential: f64,
    /// Ell, from apex to base; negative in systole.
    pub longitudinal: f64,
    /// Err, across the wall; positive in systole.
    pub radial: f64,
}

impl Strain {
    /// Strains of every tetrahedron from `reference_mm` to `position_mm`, positions of every vertex; not a number where an element is flat.
    pub fn of_tetrahedra(anatomy: &Anatomy, reference_mm: &[Vector3<f64>], position_mm: &[Vector3<f64>]) -> Vec<Self> {
        let of = |tetrahedron| {
            let strain = tetrahedron_strain(anatomy, tetrahedron, [reference_mm, position_mm]).unwrap_or([f64::NAN; 3]);
            Self::from_array(strain)
        };
        (0..anatomy.mesh.tetrahedron_count()).map(of).collect()
    }

    fn from_array([circumferential, longitudinal, radial]: [f64; 3]) -> Self {
        Self { circumferential, longitudinal, radial }
    }
}

/// Deformation of one AHA segment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SegmentDeformation {
    /// AHA segment, 1–17.
    pub segment: u8,
    /// Mean strains, weighted by volume at rest.
    pub strain: Strain,
    /// Mean thickness of the wall at the reference instant, mm.
    pub thickness_mm: f64,
    /// Change of the thickness, mm.
    pub thickening_mm: f64,
}

impl SegmentDeformation {
    /// Change of the thickness over the thickness.
    pub fn relative_thickening(&self) -> f64 {
        self.thickening_mm / self.thickness_mm
    }
}

/// Deformation of the left ventricle from a reference instant (end-diastole) to another (end-systole).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Deformation {
    /// One entry a segment that the anatomy has, ascending.
    pub segments: Vec<SegmentDeformation>,
    /// Mean strains of the whole left ventricle.
    pub strain: Strain,
    /// Rotation of the apical segments (13–16) minus that of the basal ones (1–6), degrees; positive where the apex turns anticlockwise
    /// seen from the apex, as a normal heart's does. Zero where the anatomy has not both.
    pub twist_deg: f64,
    /// Twist over the distance of the two levels, degrees per mm.
    pub torsion_deg_per_mm: f64,
    /// How far the base moves towards the apex, mm.
    pub base_descent_mm: f64,
    /// Change of the wall's thickness over the thickness, mean of the segments.
    pub wall_thickening: f64,
}

/// Sums over the tetrahedra of one segment.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    weight: f64,
    strain: [f64; 3],
    /// Volume and mean area ∫|∇depth| dV, at the reference and at the instant.
    volumes: [f64; 2],
    areas: [f64; 2],
}

impl Deformation {
    /// The deformation from `reference_mm` to `position_mm`, positions of every vertex.
    pub fn between(anatomy: &Anatomy, reference_mm: &[Vector3<f64>], position_mm: &[Vector3<f64>]) -> Self {
        let mut sums = [Sums::default(); 18];
        for (tetrahedron, &segment) in anatomy.aha_segments.iter().enumerate().filter(|&(_, &segment)| (1..=17).contains(&segment)) {
            sums[usize::from(segment)].add(anatomy, tetrahedron, reference_mm, position_mm);
        }
        let segments: Vec<SegmentDeformation> =
            (1..=17).zip(&sums[1..]).filter(|(_, sums)| sums.weight > 0.0).map(|(segment, sums)| sums.segment(segment)).collect();
        let wall_thickening = segments.iter().map(SegmentDeformation::relative_thickening).sum::<f64>() / segments.len().max(1) as f64;
        let strain = sums.iter().fold(Sums::default(), |a, b| a.plus(b)).mean_strain();
        let levels = [13..=16, 1..=6].map(|segments| Level::of(anatomy, segments, reference_mm, position_mm));
        let (twist_deg, distance_mm) = match levels {
            // Anticlockwise seen from the apex is clockwise about the axis that points from apex to base.
            [Some(apical), Some(basal)] => ((basal.rotation_rad - apical.rotation_rad).to_degrees(), basal.height_mm - apical.height_mm),
            _ => (0.0, 1.0),
        };
        let base = anatomy.surface.vertices_with(SurfaceTag::Base);
        let descent = base.iter().map(|&vertex| (reference_mm[vertex] - position_mm[vertex]).dot(&anatomy.axes.long_axis));
        let base_descent_mm = descent.sum::<f64>() / base.len().max(1) as f64;
        Self { segments, strain, twist_deg, torsion_deg_per_mm: twist_deg / distance_mm, base_descent_mm, wall_thickening }
    }
}

impl Sums {
    fn add(&mut self, anatomy: &Anatomy, tetrahedron: usize, reference_mm: &[Vector3<f64>], position_mm: &[Vector3<f64>]) {
        let corners = anatomy.mesh.tetrahedra()[tetrahedron];
        let Some(strain) = tetrahedron_strain(anatomy, tetrahedron, [reference_mm, position_mm]) else { return };
        let volume = anatomy.mesh.volume_mm3(tetrahedron);
        let instants = [reference_mm, position_mm].map(|y| edges(&corners.map(|vertex| y[vertex])));
        self.weight += volume;
        self.strain.iter_mut().zip(strain).for_each(|(sum, strain)| *sum += volume * strain);
        let depth = corners.map(|vertex| anatomy.transmural_depth[vertex]);
        let depth_rise = Vector3::new(depth[1] - depth[0], depth[2] - depth[0], depth[3] - depth[0]);
        for (instant, y) in instants.iter().enumerate() {
            let Some(inverse) = y.try_inverse() else { continue };
            let volume = y.determinant().abs() / 6.0;
            self.volumes[instant] += volume;
            self.areas[instant] += volume * (inverse.transpose() * depth_rise).norm();
        }
    }

    fn plus(mut self, other: &Self) -> Self {
        self.weight += other.weight;
        self.strain.iter_mut().zip(other.strain).for_each(|(sum, more)| *sum += more);
        self
    }

    fn mean_strain(&self) -> Strain {
        Strain::from_array(self.strain.map(|sum| sum / self.weight.max(f64::MIN_POSITIVE)))
    }

    /// By the coarea formula ∫|∇depth| dV is the mean area of the layers of equal depth, so V over it is the mean thickness.
    fn segment(&self, segment: u8) -> SegmentDeformation {
        let [thickness_mm, later_mm] = [0, 1].map(|instant| self.volumes[instant] / self.areas[instant].max(f64::MIN_POSITIVE));
        SegmentDeformation { segment, strain: self.mean_strain(), thickness_mm, thickening_mm: later_mm - thickness_mm }
    }
}

/// A ring of segments: its mean height and rotation about the long axis.
struct Level {
    height_mm: f64,
    rotation_rad: f64,
}

impl Level {
    fn of(
        anatomy: &Anatomy,
        segments: std::ops::RangeInclusive<u8>,
        reference_mm: &[Vector3<f64>],
        position_mm: &[Vector3<f64>],
    ) -> Option<Self> {
        let axis = anatomy.axes.long_axis;
        let (mut volume, mut height, mut rotation) = (0.0, 0.0, 0.0);
        for (tetrahedron, _) in anatomy.aha_segments.iter().enumerate().filter(|(_, segment)| segments.contains(segment)) {
            let corners = anatomy.mesh.tetrahedra()[tetrahedron];
            let [before, after] = [reference_mm, position_mm]
                .map(|y| corners.iter().map(|&vertex| y[vertex]).sum::<Vector3<f64>>() / 4.0 - anatomy.axes.base_centre_mm);
            let [across, turned] = [before, after].map(|offset| offset - axis * axis.dot(&offset));
            let weight = anatomy.mesh.volume_mm3(tetrahedron);
            volume += weight;
            height += weight * before.dot(&axis);
            rotation += weight * across.cross(&turned).dot(&axis).atan2(across.dot(&turned));
        }
        (volume > 0.0).then(|| Self { height_mm: height / volume, rotation_rad: rotation / volume })
    }
}

/// Relative change of length of the line elements along the local axes at rest.
fn tetrahedron_strain(anatomy: &Anatomy, tetrahedron: usize, instants_mm: [&[Vector3<f64>]; 2]) -> Option<[f64; 3]> {
    let corners = anatomy.mesh.tetrahedra()[tetrahedron];
    let inverse_rest = edges(&anatomy.mesh.corners_mm(tetrahedron)).try_inverse()?;
    let instants = instants_mm.map(|y| edges(&corners.map(|vertex| y[vertex])));
    Some([0, 1, 2].map(|axis| {
        let direction = inverse_rest * anatomy.heart_axes[tetrahedron].column(axis);
        let [before, after] = instants.map(|y| (y * direction).norm());
        after / before - 1.0
    }))
}

fn edges([a, b, c, d]: &[Vector3<f64>; 4]) -> Matrix3<f64> {
    Matrix3::from_columns(&[b - a, c - a, d - a])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heart::idealised_lv::IdealisedLv;
    use nalgebra::Rotation3;

    fn moved(anatomy: &Anatomy, map: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> Deformation {
        let rest = anatomy.mesh.vertices_mm();
        Deformation::between(anatomy, rest, &rest.iter().map(map).collect::<Vec<_>>())
    }

    #[test]
    fn narrowing_across_the_axis_is_circumferential_shortening_everywhere() {
        let anatomy = IdealisedLv::default().anatomy();
        let deformation = moved(&anatomy, |x| Vector3::new(0.83 * x.x, 0.83 * x.y, x.z));
        assert_eq!(deformation.segments.len(), 17);
        for segment in &deformation.segments {
            assert!((segment.strain.circumferential + 0.17).abs() < 1e-12, "{segment:?}");
        }
        assert!((deformation.strain.circumferential + 0.17).abs() < 1e-12);
        assert!(deformation.strain.longitudinal.abs() < 0.06 && deformation.twist_deg.abs() < 1e-9);
    }

    #[test]
    fn a_rigid_motion_strains_nothing() {
        let anatomy = IdealisedLv::default().anatomy();
        let rotation = Rotation3::from_euler_angles(0.3, -0.2, 0.0);
        let Deformation { segments, .. } = moved(&anatomy, |x| rotation * x + Vector3::new(5.0, 1.0, -2.0));
        for SegmentDeformation { strain, thickening_mm, .. } in segments {
            let largest = [strain.circumferential, strain.longitudinal, strain.radial, thickening_mm].map(f64::abs);
            assert!(largest.iter().all(|&value| value < 1e-10), "{largest:?}");
        }
    }

    /// The apex turned anticlockwise as seen from the apex is a positive twist, of the angle's rise between the levels.
    #[test]
    fn twist_is_the_rotation_of_the_apex_against_the_base() {
        let anatomy = IdealisedLv { resolution: [24, 16, 2], ..IdealisedLv::default() }.anatomy();
        let degrees_per_mm = 0.25_f64;
        let deformation =
            moved(&anatomy, |x| Rotation3::from_axis_angle(&Vector3::z_axis(), (degrees_per_mm * (x.z - 20.0)).to_radians()) * x);
        assert!((deformation.torsion_deg_per_mm - degrees_per_mm).abs() < 0.01, "{}", deformation.torsion_deg_per_mm);
        assert!(deformation.twist_deg > 5.0);
    }

    #[test]
    fn the_base_descends_towards_the_apex() {
        let anatomy = IdealisedLv::default().anatomy();
        let deformation = moved(&anatomy, |x| x - Vector3::z() * 12.0);
        assert!((deformation.base_descent_mm - 12.0).abs() < 1e-12);
    }

    /// Between concentric half-spheres the wall is as thick everywhere; the chords of the mesh leave a few per cent.
    #[test]
    fn thickness_is_that_of_a_spherical_shell_and_grows_with_it() {
        let shell = IdealisedLv { radius_mm: 30.0, half_length_mm: 30.0, wall_mm: 10.0, base_height_mm: 0.0, ..IdealisedLv::default() };
        let anatomy = IdealisedLv { resolution: [40, 20, 2], ..shell }.anatomy();
        for segment in moved(&anatomy, |x| x * 1.1).segments {
            assert!((segment.thickness_mm / 10.0 - 1.0).abs() < 0.02, "{segment:?}");
            assert!((segment.thickening_mm - 0.1 * segment.thickness_mm).abs() < 1e-9);
        }
    }
}
