//! All tracked surfaces as one load on the step system: (K̃ + K_img) Y^{t+h} = F + F̃_img, \[Billet2009\] §4.2.

use std::sync::{Mutex, PoisonError};

use nalgebra::Vector3;

use super::force_tangents::ImageTangent;
use super::{BoundarySearch, BoundaryTarget, ForceScheme, ImageInstant, SurfaceTargets, TrackingError, VertexLoad};
use crate::image::CineSequence;
use crate::mechanics::{LoadTangent, MotionState, StepLoad, StepSystem, TakenStep};
use crate::mesh::TaggedSurface;

/// A surface with its gain.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceGain {
    /// The search on this surface.
    pub search: BoundarySearch,
    /// Gain γ per area, kPa/mm.
    pub gain_kpa_per_mm: f64,
}

/// The image force of a cine sequence on the endocardia and the epicardium.
#[derive(Debug)]
pub struct ImageForce<'a> {
    pub(super) cine: &'a CineSequence,
    pub(super) surface: &'a TaggedSurface,
    surfaces: Vec<SurfaceGain>,
    pub(super) scheme: ForceScheme,
    held_out: Vec<bool>,
    applied: Mutex<Vec<(usize, VertexLoad)>>,
}

impl<'a> ImageForce<'a> {
    /// The load of `surfaces`. `held_out` (one a mesh vertex, or empty) marks vertices that get no force, so that their residual
    /// can judge the gains.
    ///
    /// # Errors
    /// [`TrackingError::SettingOutOfRange`] for a gain that is negative or not finite.
    pub fn new(
        cine: &'a CineSequence,
        surface: &'a TaggedSurface,
        surfaces: Vec<SurfaceGain>,
        scheme: ForceScheme,
        held_out: Vec<bool>,
    ) -> Result<Self, TrackingError> {
        for one in &surfaces {
            TrackingError::check_setting("gain_kpa_per_mm", one.gain_kpa_per_mm, 0.0, f64::MAX)?;
        }
        Ok(Self { cine, surface, surfaces, scheme, held_out, applied: Mutex::new(Vec::new()) })
    }

    /// The surfaces with their gains.
    pub fn surfaces(&self) -> &[SurfaceGain] {
        &self.surfaces
    }

    /// The boundary points of every surface for a mesh at `position_mm`, in the image of `time_s`.
    pub fn targets(&self, position_mm: &[Vector3<f64>], time_s: f64) -> Vec<SurfaceTargets> {
        let instant = ImageInstant::new(self.cine, time_s);
        self.surfaces.iter().map(|one| one.search.find(self.surface, position_mm, &instant)).collect()
    }

    /// Whether a vertex is held out.
    pub fn is_held_out(&self, vertex: usize) -> bool {
        self.held_out.get(vertex).copied().unwrap_or(false)
    }

    /// γ of a boundary point in mN/mm: gain per area × vertex area × confidence; zero where held out.
    pub fn gain_mn_per_mm(&self, gain_kpa_per_mm: f64, target: &BoundaryTarget) -> f64 {
        if self.is_held_out(target.vertex) { 0.0 } else { gain_kpa_per_mm * target.area_mm2 * target.confidence }
    }

    /// Work of the image force in the last step, mN·mm (= µJ), of every vertex that was pulled: the force F − K Y⁺ that stood at the
    /// step's end times the way from `before_mm` to `after_mm`.
    pub fn work_uj(&self, before_mm: &[Vector3<f64>], after_mm: &[Vector3<f64>]) -> Vec<(usize, f64)> {
        let applied = self.applied.lock().unwrap_or_else(PoisonError::into_inner);
        let work = applied.iter().map(|(vertex, load)| {
            let force_mn = load.force_mn - load.stiffness_mn_per_mm * after_mm[*vertex];
            (*vertex, force_mn.dot(&(after_mm[*vertex] - before_mm[*vertex])))
        });
        work.collect()
    }
}

impl StepLoad for ImageForce<'_> {
    /// Explicit: the boundary at the beginning of the step, in the image of that time. Implicit: the boundary that the mesh sees from
    /// where it stands in the image of the step's end, with the dependence of Z on Y in the stiffness.
    fn add_to(&self, state: &MotionState, time_s: f64, step_s: f64, system: &mut StepSystem) {
        let image_time_s = if self.scheme == ForceScheme::Explicit { time_s } else { time_s + step_s };
        let instant = ImageInstant::new(self.cine, image_time_s);
        let mut applied = self.applied.lock().unwrap_or_else(PoisonError::into_inner);
        applied.clear();
        for one in self.surfaces.iter().filter(|one| one.gain_kpa_per_mm > 0.0) {
            for target in &one.search.find(self.surface, &state.position_mm, &instant).targets {
                let gain = self.gain_mn_per_mm(one.gain_kpa_per_mm, target);
                if gain > 0.0 {
                    let load = self.scheme.load(target, &state.position_mm[target.vertex], gain);
                    system.force_mn[target.vertex] += load.force_mn;
                    system.stiffness_mn_per_mm[target.vertex] += load.stiffness_mn_per_mm;
                    applied.push((target.vertex, load));
                }
            }
        }
    }
    fn tangent<'b>(&'b self, step: &TakenStep<'b>) -> Option<Box<dyn LoadTangent + 'b>> {
        Some(Box::new(ImageTangent::new(self, step)))
    }
}
