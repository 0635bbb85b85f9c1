//! The force that draws the base along the motion that block matching has found, \[Billet2009\] §5.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::force_tangents::BaseTangent;
use super::{BlockMatchingSettings, TrackingError};
use crate::heart::BaseMotion;
use crate::mechanics::{LoadTangent, MotionState, StepLoad, StepSystem, TakenStep};
use crate::mesh::{SurfaceTag, TaggedSurface};

/// How the base is held, \[Billet2009\] §6.2.
#[derive(Debug, Clone, PartialEq)]
pub enum BaseMode {
    /// Nothing holds the base.
    Free,
    /// The model's own springs to the reference position.
    Springs,
    /// No springs; blocks matched in the images draw the base.
    BlockMatching(BlockMatchingSettings),
    /// The model's springs, anchored on the motion of an earlier run.
    Recorded(Arc<BaseMotion>),
}

/// Which part of the way to the match is pulled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BaseProjection {
    /// Along the mesh normal only, as in \[Billet2009\] §5: the base moves mostly along the long axis.
    #[default]
    Normal,
    /// The whole vector.
    Full,
}

/// Displacements of vertices, of the base or of the whole wall, from their reference positions at some times of a cycle, with confidences; periodic in time.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseMatches {
    vertices: Vec<usize>,
    times_s: Vec<f64>,
    period_s: f64,
    displacement_mm: Vec<Vec<Vector3<f64>>>,
    confidence: Vec<Vec<f64>>,
}

impl BaseMatches {
    pub(super) fn new(
        vertices: Vec<usize>,
        times_s: Vec<f64>,
        period_s: f64,
        displacement_mm: Vec<Vec<Vector3<f64>>>,
        confidence: Vec<Vec<f64>>,
    ) -> Self {
        Self { vertices, times_s, period_s, displacement_mm, confidence }
    }

    /// Takes the matches of one frame for better ones.
    pub(super) fn set(&mut self, frame: usize, displacement_mm: Vec<Vector3<f64>>, confidence: Vec<f64>) {
        self.displacement_mm[frame] = displacement_mm;
        self.confidence[frame] = confidence;
    }

    /// Refuses matches of vertices that a mesh does not have.
    pub(super) fn check_vertices(&self, vertex_count: usize) -> Result<(), TrackingError> {
        let Some(vertex) = self.vertices.iter().find(|&&vertex| vertex >= vertex_count) else { return Ok(()) };
        Err(TrackingError::BaseMatches { reason: format!("it names vertex {vertex}, but the mesh has {vertex_count}") })
    }

    /// The vertices.
    pub fn vertices(&self) -> &[usize] {
        &self.vertices
    }

    /// Times, s.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Displacements from the reference position, mm, by time and by place in [`BaseMatches::vertices`].
    pub fn displacement_mm(&self) -> &[Vec<Vector3<f64>>] {
        &self.displacement_mm
    }

    /// Confidences in 0..=1, by time and by place in [`BaseMatches::vertices`].
    pub fn confidence(&self) -> &[Vec<f64>] {
        &self.confidence
    }

    /// Displacement (mm) and confidence of one place at a time, linear between the times and periodic.
    pub fn at(&self, place: usize, time_s: f64) -> (Vector3<f64>, f64) {
        let last = self.times_s.len() - 1;
        let phase_s = self.times_s[0] + (time_s - self.times_s[0]).rem_euclid(self.period_s);
        let earlier = self.times_s.partition_point(|&t| t <= phase_s).max(1) - 1;
        let (later, later_s) =
            if earlier == last { (0, self.times_s[0] + self.period_s) } else { (earlier + 1, self.times_s[earlier + 1]) };
        let weight = ((phase_s - self.times_s[earlier]) / (later_s - self.times_s[earlier])).clamp(0.0, 1.0);
        let (from, to) = (self.displacement_mm[earlier][place], self.displacement_mm[later][place]);
        let (sure, surer) = (self.confidence[earlier][place], self.confidence[later][place]);
        (from + (to - from) * weight, sure + (surer - sure) * weight)
    }
}

/// Springs, implicit in time, from base vertices to the places where their matches are.
#[derive(Debug, Clone)]
pub struct BaseForce<'a> {
    pub(super) surface: &'a TaggedSurface,
    pub(super) matches: &'a BaseMatches,
    pub(super) reference_mm: &'a [Vector3<f64>],
    pub(super) projection: BaseProjection,
    pub(super) gain_kpa_per_mm: f64,
}

impl<'a> BaseForce<'a> {
    /// The load; `reference_mm` holds the reference positions of all mesh vertices.
    ///
    /// # Errors
    /// [`TrackingError::SettingOutOfRange`] for a gain that is negative or not finite, [`TrackingError::BaseMatches`] if the matches
    /// name a vertex that the mesh does not have.
    pub fn new(
        surface: &'a TaggedSurface,
        matches: &'a BaseMatches,
        reference_mm: &'a [Vector3<f64>],
        projection: BaseProjection,
        gain_kpa_per_mm: f64,
    ) -> Result<Self, TrackingError> {
        TrackingError::check_setting("image_gain_base_kpa_per_mm", gain_kpa_per_mm, 0.0, f64::MAX)?;
        matches.check_vertices(reference_mm.len())?;
        Ok(Self { surface, matches, reference_mm, projection, gain_kpa_per_mm })
    }
}

impl StepLoad for BaseForce<'_> {
    /// F = 2γ P (Z − Y^{t+h}) with Z the match at t + h, γ the gain × area × confidence, P = N Nᵀ or I.
    fn add_to(&self, state: &MotionState, time_s: f64, step_s: f64, system: &mut StepSystem) {
        let area_mm2 = self.surface.vertex_area_vectors_mm2(SurfaceTag::Base, &state.position_mm);
        for (place, &vertex) in self.matches.vertices.iter().enumerate() {
            let (displacement_mm, confidence) = self.matches.at(place, time_s + step_s);
            let gain_mn_per_mm = 2.0 * self.gain_kpa_per_mm * confidence * area_mm2[vertex].norm();
            let Some(normal) = area_mm2[vertex].try_normalize(0.0) else { continue };
            let stiffness = gain_mn_per_mm
                * match self.projection {
                    BaseProjection::Normal => normal * normal.transpose(),
                    BaseProjection::Full => Matrix3::identity(),
                };
            system.force_mn[vertex] += stiffness * (self.reference_mm[vertex] + displacement_mm);
            system.stiffness_mn_per_mm[vertex] += stiffness;
        }
    }
    fn tangent<'b>(&'b self, step: &TakenStep<'b>) -> Option<Box<dyn LoadTangent + 'b>> {
        Some(Box::new(BaseTangent { force: self, taken: *step }))
    }
}
