//! From a label map on thick slices to smooth signed-distance fields of a ventricle ([Billet2009] §3).

use nalgebra::Vector3;

use super::Volume;

/// A plane through `point_mm` with a unit `normal`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// A point of the plane, world mm.
    pub point_mm: Vector3<f64>,
    /// Unit normal, world axes.
    pub normal: Vector3<f64>,
}

impl Plane {
    /// Signed distance, mm: positive on the side to which the normal points.
    pub fn signed_distance_mm(&self, position_mm: &Vector3<f64>) -> f64 {
        self.normal.dot(&(position_mm - self.point_mm))
    }
}

/// One ventricle as implicit functions on one isotropic grid: signed distances in mm, negative inside, to be sampled trilinearly.
///
/// The myocardium is {epicardium < 0} ∖ {cavity < 0}, below the base plane. Both fields are closed at the apex, continue unchanged beyond
/// the base plane (so that the cut is the plane's alone) and are positive on the whole border of the grid except where it lies beyond
/// the base plane; outside the grid everything is outside the ventricle.
#[derive(Debug, Clone)]
pub struct VentricleFields {
    /// Signed distance to the endocardium, mm: negative in the blood.
    pub cavity: Volume,
    /// Signed distance to the epicardium, mm: negative in blood and wall.
    pub epicardium: Volume,
    /// Where the ventricle is cut at the base; the normal points out of the ventricle, towards the atria.
    pub base_plane: Plane,
    /// Tip of the epicardium, world mm.
    pub apex_mm: Vector3<f64>,
    /// Unit vector from apex to base along the slice axis.
    pub long_axis: Vector3<f64>,
    /// What was assumed or left out, in words.
    pub warnings: Vec<String>,
}
