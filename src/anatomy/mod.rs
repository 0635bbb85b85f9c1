//! The patient's heart at rest: mesh, surfaces, cavities, regions, transmural depth and fibres, \[Billet2009\] §3.

mod build;
mod error;
mod fibres;
mod idealised_biventricle;
mod laplace;
pub mod mesher;
mod segments;
mod transmural;

pub use build::{AnatomySettings, build_anatomy, build_from_fields, complete_anatomy};
pub use error::AnatomyError;
pub use fibres::FibreRule;
pub use idealised_biventricle::IdealisedBiventricle;
pub use segments::{AhaSegment, DEFAULT_SEPTAL_DIRECTION};

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::mesh::{Cavity, MeshError, SurfaceTag, TaggedSurface, TetMesh};

/// A ventricle; an LV-only heart has the left one alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ventricle {
    /// Left ventricle.
    Left,
    /// Right ventricle.
    Right,
}

impl Ventricle {
    /// The endocardium of this ventricle.
    pub fn endocardium(self) -> SurfaceTag {
        match self {
            Self::Left => SurfaceTag::EndocardiumLv,
            Self::Right => SurfaceTag::EndocardiumRv,
        }
    }
}

/// The part of the wall a tetrahedron belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// Free wall of the left ventricle (the whole wall of an LV-only heart but its septal segments).
    FreeWallLv,
    /// Septum.
    Septum,
    /// Free wall of the right ventricle.
    FreeWallRv,
    /// Scar.
    Scar,
}

/// The heart's own frame, used for fibres, strains and segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeartAxes {
    /// A point of the long axis, mm (the centre of the LV lid).
    pub base_centre_mm: Vector3<f64>,
    /// Unit long axis, from apex to base.
    pub long_axis: Vector3<f64>,
    /// Unit vector across the long axis towards the septum (or the RV insertion side), the origin of AHA angles.
    pub septal_direction: Vector3<f64>,
}

/// Everything known of the heart before it beats. Per-tetrahedron fields have one entry a tetrahedron.
#[derive(Debug, Clone, PartialEq)]
pub struct Anatomy {
    /// The myocardium.
    pub mesh: TetMesh,
    /// Its tagged boundary.
    pub surface: TaggedSurface,
    /// One cavity a ventricle, left first.
    pub cavities: Vec<(Ventricle, Cavity)>,
    /// Transmural depth a vertex: 0 at the endocardium, 1 at the epicardium.
    pub transmural_depth: Vec<f64>,
    /// Columns fibre, sheet, sheet-normal a tetrahedron; orthonormal.
    pub fibre_axes: Vec<Matrix3<f64>>,
    /// Columns circumferential, longitudinal, radial a tetrahedron; orthonormal.
    pub heart_axes: Vec<Matrix3<f64>>,
    /// Region a tetrahedron.
    pub regions: Vec<Region>,
    /// AHA segment a tetrahedron, 1–17; 0 outside the LV.
    pub aha_segments: Vec<u8>,
    /// The heart's own frame.
    pub axes: HeartAxes,
}

impl Anatomy {
    /// The cavities of a tagged surface, left first; an LV-only heart has one.
    ///
    /// # Errors
    /// [`MeshError`] if the LV endocardium is missing, or a rim is not one closed loop.
    pub fn close_cavities(surface: &TaggedSurface) -> Result<Vec<(Ventricle, Cavity)>, MeshError> {
        let mut cavities = vec![(Ventricle::Left, Cavity::new(surface, SurfaceTag::EndocardiumLv)?)];
        if surface.tags().contains(&SurfaceTag::EndocardiumRv) {
            cavities.push((Ventricle::Right, Cavity::new(surface, SurfaceTag::EndocardiumRv)?));
        }
        Ok(cavities)
    }

    /// The same heart with measured or otherwise made fibres instead of the rule's: a direction a tetrahedron, and across it the sheets
    /// (the wall's normal where none are given). They are made orthonormal.
    ///
    /// # Errors
    /// [`AnatomyError::FieldLength`] or [`AnatomyError::FibreDirection`] for a direction without length or a sheet along the fibre.
    pub fn with_fibres(mut self, fibres: &[Vector3<f64>], sheets: Option<&[Vector3<f64>]>) -> Result<Self, AnatomyError> {
        let expected = self.mesh.tetrahedron_count();
        for (name, length) in [("fibres", fibres.len()), ("sheets", sheets.map_or(expected, <[_]>::len))] {
            if length != expected {
                return Err(AnatomyError::FieldLength { name, length, expected });
            }
        }
        for tetrahedron in 0..expected {
            let sheet = sheets.map_or_else(|| self.heart_axes[tetrahedron].column(2).into_owned(), |sheets| sheets[tetrahedron]);
            let axes = fibres::orthonormal_axes(&fibres[tetrahedron], &sheet);
            self.fibre_axes[tetrahedron] = axes.ok_or(AnatomyError::FibreDirection { tetrahedron })?;
        }
        Ok(self)
    }

    /// Marks as scar every tetrahedron whose centre (mm) is in it.
    pub fn mark_scar(&mut self, is_scar: &dyn Fn(&Vector3<f64>) -> bool) {
        for tetrahedron in 0..self.mesh.tetrahedron_count() {
            let centre_mm = self.mesh.corners_mm(tetrahedron).iter().sum::<Vector3<f64>>() / 4.0;
            if is_scar(&centre_mm) {
                self.regions[tetrahedron] = Region::Scar;
            }
        }
    }
}
