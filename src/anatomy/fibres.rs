//! Local axes of the wall and rule-based fibres, \[Billet2009\] §3.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{AnatomyError, HeartAxes};

/// Helix angles of the fibres: linear in the transmural depth, against the circumferential direction, positive for a right-handed helix
/// about the long axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FibreRule {
    /// Helix angle at the endocardium, °.
    pub helix_endocardium_deg: f64,
    /// Helix angle at the epicardium, °.
    pub helix_epicardium_deg: f64,
}

impl Default for FibreRule {
    /// +80° to −80°, \[Billet2009\] §3.
    fn default() -> Self {
        Self { helix_endocardium_deg: 80.0, helix_epicardium_deg: -80.0 }
    }
}

impl FibreRule {
    /// Refuses angles beyond ±90°.
    pub(super) fn check(&self) -> Result<(), AnatomyError> {
        for (name, value) in [
            ("the helix angle at the endocardium in degrees", self.helix_endocardium_deg),
            ("the helix angle at the epicardium in degrees", self.helix_epicardium_deg),
        ] {
            if !(-90.0..=90.0).contains(&value) {
                return Err(AnatomyError::Setting { name, value, expectation: "lie between -90 and 90" });
            }
        }
        Ok(())
    }

    /// Helix angle at a transmural depth (0 endocardium, 1 epicardium), radian.
    pub fn helix_angle_rad(&self, depth: f64) -> f64 {
        (self.helix_endocardium_deg + (self.helix_epicardium_deg - self.helix_endocardium_deg) * depth).to_radians()
    }

    /// Fibre axes at a depth: columns fibre, sheet, sheet-normal in terms of the local axes (columns circumferential, longitudinal, radial).
    ///
    /// $f = \cos\alpha\,c + \sin\alpha\,l$, the sheet runs across the wall ($s = r$), $n = f \times s$.
    pub fn fibre_axes(&self, local_axes: &Matrix3<f64>, depth: f64) -> Matrix3<f64> {
        let angle = self.helix_angle_rad(depth);
        let fibre = local_axes.column(0) * angle.cos() + local_axes.column(1) * angle.sin();
        let sheet = local_axes.column(2).into_owned();
        Matrix3::from_columns(&[fibre, sheet, fibre.cross(&sheet)])
    }
}

/// Columns circumferential, longitudinal, radial: radial along the gradient of the transmural depth (towards the epicardium), longitudinal
/// the long axis (apex to base) made orthogonal to it, circumferential = longitudinal × radial (anticlockwise seen from the base).
///
/// Where the wall's normal is the long axis, at the tip of the apex, the septal direction takes the long axis' place.
pub(super) fn local_axes(depth_gradient: &Vector3<f64>, axes: &HeartAxes) -> Matrix3<f64> {
    let radial = depth_gradient.try_normalize(1e-12).unwrap_or(-axes.long_axis);
    let across = |direction: &Vector3<f64>| (direction - radial * radial.dot(direction)).try_normalize(1e-6);
    let longitudinal = across(&axes.long_axis).or_else(|| across(&axes.septal_direction)).unwrap_or(axes.long_axis);
    Matrix3::from_columns(&[longitudinal.cross(&radial), longitudinal, radial])
}

/// Columns fibre, sheet, sheet-normal from a fibre and a direction across it; `None` if either has no length or both are parallel.
pub(super) fn orthonormal_axes(fibre: &Vector3<f64>, sheet: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let fibre = fibre.try_normalize(1e-9)?;
    let sheet = sheet.try_normalize(1e-9)?;
    let sheet = (sheet - fibre * fibre.dot(&sheet)).try_normalize(1e-3)?;
    Some(Matrix3::from_columns(&[fibre, sheet, fibre.cross(&sheet)]))
}
