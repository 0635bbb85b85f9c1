//! What the images say of a tracked frame: boundary points, signed distances, and warnings where a boundary is lost.

use super::{BoundaryTarget, ImageForce, SurfaceTargets, TrackingError};
use crate::heart::FrameState;
use crate::mesh::SurfaceTag;

/// Signed distances from a surface to the boundary in one frame, weighted by confidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceResidual {
    /// The surface.
    pub tag: SurfaceTag,
    /// Vertices of the surface.
    pub vertex_count: usize,
    /// Vertices with a boundary point.
    pub found: usize,
    /// Mean signed distance, mm (positive: the boundary lies outward of the mesh).
    pub mean_mm: f64,
    /// Root mean square distance, mm.
    pub rms_mm: f64,
    /// Root mean square distance of the vertices that got no force, mm; nothing if none was held out.
    pub held_out_rms_mm: Option<f64>,
}

/// One frame of a tracked motion.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedFrame {
    /// Frame of the cine sequence, 0-based.
    pub frame: usize,
    /// Time, s.
    pub time_s: f64,
    /// The boundary points of every surface: data for personalisation.
    pub targets: Vec<SurfaceTargets>,
    /// Their statistics, in the same order.
    pub residuals: Vec<SurfaceResidual>,
}

impl TrackedFrame {
    /// Looks for the boundary from where the mesh stands in a frame.
    pub(super) fn new(force: &ImageForce, state: &FrameState, frame: usize) -> Self {
        let targets = force.targets(&state.position_mm, state.time_s);
        let residuals = targets.iter().map(|found| SurfaceResidual::new(found, force)).collect();
        Self { frame, time_s: state.time_s, targets, residuals }
    }
}

impl SurfaceResidual {
    fn new(found: &SurfaceTargets, force: &ImageForce) -> Self {
        let weighted = |targets: &mut dyn Iterator<Item = &BoundaryTarget>| {
            targets.fold([0.0; 3], |[w, wd, wdd], t| {
                let (c, d) = (t.confidence, t.signed_distance_mm);
                [w + c, wd + c * d, wdd + c * d * d]
            })
        };
        let [mass, sum, squares] = weighted(&mut found.targets.iter());
        let [held_mass, _, held_squares] = weighted(&mut found.targets.iter().filter(|t| force.is_held_out(t.vertex)));
        Self {
            tag: found.tag,
            vertex_count: found.vertex_count,
            found: found.targets.len(),
            mean_mm: if mass > 0.0 { sum / mass } else { 0.0 },
            rms_mm: if mass > 0.0 { (squares / mass).sqrt() } else { 0.0 },
            held_out_rms_mm: (held_mass > 0.0).then(|| (held_squares / held_mass).sqrt()),
        }
    }

    fn is_lost(&self) -> bool {
        2 * self.found < self.vertex_count
    }
}

/// A warning for each frame in which most of a surface has no boundary point.
///
/// # Errors
/// [`TrackingError::BoundaryLost`] for a surface that is lost in most frames.
pub(super) fn frame_warnings(frames: &[TrackedFrame]) -> Result<Vec<String>, TrackingError> {
    let surface_count = frames.first().map_or(0, |frame| frame.residuals.len());
    let mut warnings = Vec::new();
    for surface in 0..surface_count {
        let lost: Vec<&TrackedFrame> = frames.iter().filter(|frame| frame.residuals[surface].is_lost()).collect();
        if let Some(first) = lost.first().filter(|_| 2 * lost.len() > frames.len()) {
            let SurfaceResidual { tag, vertex_count, found, .. } = first.residuals[surface];
            return Err(TrackingError::BoundaryLost { tag, found, vertex_count, time_s: first.time_s });
        }
        warnings.extend(lost.iter().map(|frame| {
            let SurfaceResidual { tag, vertex_count, found, .. } = frame.residuals[surface];
            format!(
                "frame {}: a boundary was found on only {found} of {vertex_count} vertices of {tag:?}; is the frame corrupt?",
                frame.frame
            )
        }));
    }
    Ok(warnings)
}
