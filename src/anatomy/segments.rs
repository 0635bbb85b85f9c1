//! The heart's own axes and the 17 segments of the left ventricle \[Cerqueira2002\].

use nalgebra::Vector3;

use super::{AnatomyError, HeartAxes, Region};
use crate::mesh::{Cavity, TetMesh};

/// Where the septum lies if nobody says: to the right and in front of the left ventricle of a human lying in a scanner (RAS).
pub const DEFAULT_SEPTAL_DIRECTION: [f64; 3] = [0.75, 0.6, -0.3];

/// A segment of the left ventricle, 1–17: 1–6 at the base, 7–12 in the middle, 13–16 towards the apex, 17 the apex \[Cerqueira2002\].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AhaSegment(u8);

impl AhaSegment {
    /// The segment of a number; none outside 1–17.
    pub fn new(number: u8) -> Option<Self> {
        (1..=17).contains(&number).then_some(Self(number))
    }

    /// All segments in their order.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..=17).map(Self)
    }

    /// Its number, 1–17.
    pub fn number(self) -> u8 {
        self.0
    }

    /// Whether two segments share a border. A sixth of the circle at mid-height meets two quarters towards the apex where their angles
    /// overlap.
    pub fn is_neighbour_of(self, other: Self) -> bool {
        #[rustfmt::skip]
        const BORDERS: [(u8, u8); 36] = [
            (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (1, 6),
            (1, 7), (2, 8), (3, 9), (4, 10), (5, 11), (6, 12),
            (7, 8), (8, 9), (9, 10), (10, 11), (11, 12), (7, 12),
            (7, 13), (8, 13), (8, 14), (9, 14), (9, 15), (10, 15), (11, 15), (11, 16), (12, 16), (12, 13),
            (13, 14), (14, 15), (15, 16), (13, 16),
            (13, 17), (14, 17), (15, 17), (16, 17),
        ];
        BORDERS.contains(&(self.0, other.0)) || BORDERS.contains(&(other.0, self.0))
    }
}

/// The heart's frame from its LV cavity: the long axis joins the centroid of the blood with the centre of the lid.
///
/// # Errors
/// [`AnatomyError::Setting`] if the septal direction is parallel to the long axis or not finite.
pub(super) fn heart_axes(mesh: &TetMesh, cavity: &Cavity, septal_direction: &Vector3<f64>) -> Result<HeartAxes, AnatomyError> {
    let position_mm = mesh.vertices_mm();
    let base_centre_mm = lid_centroid_mm(position_mm, cavity);
    // Tetrahedra between the lid's centre and the endocardium fill the blood, with sign.
    let (mut volume, mut moment) = (0.0, Vector3::zeros());
    for &triangle in cavity.endocardium() {
        let [a, b, c] = triangle.map(|vertex| position_mm[vertex] - base_centre_mm);
        let six_volumes = a.dot(&b.cross(&c));
        volume += six_volumes;
        moment += (a + b + c) * (six_volumes / 4.0);
    }
    let invalid = |name, value| AnatomyError::Setting { name, value, expectation: "exceed 0.1; check the surface tags or the direction" };
    let long_axis = (-moment / volume).try_normalize(1e-9).ok_or_else(|| invalid("the length of the long axis in mm", 0.0))?;
    let unit = septal_direction.try_normalize(1e-12).unwrap_or_else(Vector3::zeros);
    let across = unit - long_axis * long_axis.dot(&unit);
    let across_length = across.norm();
    if across_length.is_nan() || across_length <= 0.1 {
        return Err(invalid("the part of the unit septal direction across the long axis", across_length));
    }
    Ok(HeartAxes { base_centre_mm, long_axis, septal_direction: across / across_length })
}

/// The centroid of the lid as a surface; the mean of the rim's vertices leans towards where they lie densely.
fn lid_centroid_mm(position_mm: &[Vector3<f64>], cavity: &Cavity) -> Vector3<f64> {
    let hub = cavity.lid_centre_mm(position_mm);
    let rim = cavity.rim();
    let (mut area, mut moment) = (0.0, Vector3::zeros());
    for (i, &vertex) in rim.iter().enumerate() {
        let (a, b) = (position_mm[vertex] - hub, position_mm[rim[(i + 1) % rim.len()]] - hub);
        let double_area = a.cross(&b).norm();
        area += double_area;
        moment += (a + b) * (double_area / 3.0);
    }
    hub + moment / area
}

/// AHA segment 1–17 of a point of the LV wall, `cavity_depth_mm` the distance from the lid to the end of the cavity along the long axis.
///
/// The cavity is divided into three equal parts along the axis; beyond its end is segment 17. Angles are taken about the long axis
/// from the middle of the septum (between segments 2 and 3) towards the anterior wall, which is at long axis × septal direction.
pub(super) fn aha_segment(axes: &HeartAxes, cavity_depth_mm: f64, position_mm: &Vector3<f64>) -> u8 {
    let from_base = position_mm - axes.base_centre_mm;
    let depth = -from_base.dot(&axes.long_axis) / cavity_depth_mm;
    let anterior = axes.long_axis.cross(&axes.septal_direction);
    let angle_deg = from_base.dot(&anterior).atan2(from_base.dot(&axes.septal_direction)).to_degrees().rem_euclid(360.0);
    const SIX: [u8; 6] = [2, 1, 6, 5, 4, 3];
    const FOUR: [u8; 4] = [14, 13, 16, 15];
    let sixth = SIX[((angle_deg / 60.0) as usize).min(5)];
    if depth < 1.0 / 3.0 {
        sixth
    } else if depth < 2.0 / 3.0 {
        sixth + 6
    } else if depth < 1.0 {
        FOUR[((angle_deg + 45.0).rem_euclid(360.0) / 90.0) as usize % 4]
    } else {
        17
    }
}

/// Distance from the lid's centre to the end of the cavity along the long axis, mm.
pub(super) fn cavity_depth_mm(mesh: &TetMesh, cavity: &Cavity, axes: &HeartAxes) -> f64 {
    let depth = |&vertex: &usize| -(mesh.vertices_mm()[vertex] - axes.base_centre_mm).dot(&axes.long_axis);
    cavity.endocardium().iter().flatten().map(depth).fold(0.0, f64::max)
}

/// The region of an LV segment: the septum is segments 2, 3, 8, 9 and 14.
pub(super) fn region_of_segment(segment: u8) -> Region {
    if matches!(segment, 2 | 3 | 8 | 9 | 14) { Region::Septum } else { Region::FreeWallLv }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A heart as it lies in the chest (RAS): the apex points left, forward and down; the septum faces right and forward.
    fn axes_in_chest() -> HeartAxes {
        let long_axis = Vector3::new(0.6, -0.6, 0.5).normalize();
        let septum = Vector3::new(0.7, 0.6, -0.1);
        let septal_direction = (septum - long_axis * long_axis.dot(&septum)).normalize();
        HeartAxes { base_centre_mm: Vector3::new(-20.0, 30.0, 10.0), long_axis, septal_direction }
    }

    #[test]
    fn segments_lie_where_the_atlas_has_them() {
        let axes = axes_in_chest();
        let at = |height: f64, direction: Vector3<f64>| {
            let across = (direction - axes.long_axis * axes.long_axis.dot(&direction)).normalize();
            aha_segment(&axes, 90.0, &(axes.base_centre_mm - axes.long_axis * height + across * 30.0))
        };
        let (up, left_behind) = (Vector3::z(), Vector3::new(-1.0, -1.0, 0.0));
        assert_eq!([at(10.0, up), at(40.0, up), at(70.0, up), at(95.0, up)], [1, 7, 13, 17]);
        assert_eq!([at(10.0, -up), at(40.0, -up), at(70.0, -up)], [4, 10, 15]);
        assert_eq!(at(70.0, axes.septal_direction), 14);
        assert_eq!(at(70.0, left_behind), 16);
        let septum_above = axes.septal_direction + axes.long_axis.cross(&axes.septal_direction) * 0.5;
        assert_eq!(at(10.0, septum_above), 2);
        assert_eq!(at(10.0, left_behind + up * 0.5), 6);
        assert_eq!(at(40.0, left_behind - up * 0.5), 11);
    }

    /// Two points a little apart lie in one segment or in neighbours, and every border is met: the table against the geometry.
    #[test]
    fn neighbours_are_the_segments_that_touch() {
        let axes = axes_in_chest();
        let anterior = axes.long_axis.cross(&axes.septal_direction);
        let at = |angle_deg: f64, height: f64| {
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            let point = axes.base_centre_mm - axes.long_axis * height + (axes.septal_direction * cos + anterior * sin) * 20.0;
            AhaSegment::new(aha_segment(&axes, 90.0, &point)).unwrap()
        };
        let mut met = std::collections::BTreeSet::new();
        // Off the borders themselves, where rounding decides.
        let places = (0..720).flat_map(|angle| (0..200).map(move |height| (0.13 + 0.5 * f64::from(angle), 0.13 + 0.5 * f64::from(height))));
        for (angle, height) in places {
            for other in [at(angle + 0.5, height), at(angle, height + 0.5)] {
                let here = at(angle, height);
                assert!(here == other || height >= 89.5 || here.is_neighbour_of(other), "{here:?} {other:?}");
                met.insert((here.min(other), here.max(other)));
            }
        }
        let all = || AhaSegment::all().flat_map(|a| AhaSegment::all().map(move |b| (a, b)));
        assert!(all().filter(|(a, b)| a < b && a.is_neighbour_of(*b)).all(|pair| met.contains(&pair)));
        assert_eq!((AhaSegment::new(0), AhaSegment::new(18)), (None, None));
    }
}
