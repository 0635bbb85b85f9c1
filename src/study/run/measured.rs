//! The volume curves that parameters are fitted to: of the tracked heart, or measured without it.

use super::clock::Clock;
use super::error::RunError;
use super::patient::Patient;
use super::track::Tracked;
use crate::anatomy::Ventricle;
use crate::heart::FrameState;
use crate::image::VolumeCurve;
use crate::study::Plan;
use crate::study::plan::{ImageSource, PersonalisationPlan, VolumeData, VolumeSource};
use crate::study::volumes::smooth_curves;
use crate::units::ml_from_mm3;

/// A measured volume that differs by more than this share from that of the mesh is reported.
const FACTOR_REPORTED: f64 = 0.1;

/// Volumes at the frames of a clock.
pub(super) struct MeasuredVolumes {
    pub(super) left_ml: Vec<f64>,
    /// Of the right ventricle, where it was measured and the heart has one.
    pub(super) right_ml: Option<Vec<f64>>,
    /// Whether they were measured without the heart's mesh.
    pub(super) is_measured: bool,
    /// Whether they are those of the tracked heart.
    pub(super) is_tracked: bool,
    pub(super) warnings: Vec<String>,
}

/// The volumes that a personalisation is fitted to. Curves that are measured without the mesh are smoothed, and scaled to its volume at the frame that it
/// was drawn on: which voxels a cavity is counted to have, at its base and between its trabeculae, is a convention that no parameter can explain.
pub(super) fn measured_volumes(
    plan: &Plan,
    wanted: &PersonalisationPlan,
    patient: &Patient,
    clock: &Clock,
    tracked: &Tracked,
) -> Result<MeasuredVolumes, RunError> {
    let is_written = matches!(&plan.images, Some(ImageSource::Cine(images)) if images.volumes != VolumeSource::Images);
    let default = if is_written { VolumeData::Measured } else { VolumeData::Tracked };
    let of_frames = |frames: &[FrameState], is_tracked: bool| {
        let right: Option<Vec<f64>> = frames.iter().map(|frame| frame.volume_ml.get(1).copied()).collect();
        let left_ml = frames.iter().filter_map(|frame| frame.volume_ml.first().copied()).collect();
        MeasuredVolumes { left_ml, right_ml: right, is_measured: false, is_tracked, warnings: Vec::new() }
    };
    match (wanted.data.volumes.unwrap_or(default), &patient.truth) {
        (VolumeData::Truth, Some(truth)) => return Ok(of_frames(&truth.frames, false)),
        (VolumeData::Measured, _) => {}
        (VolumeData::Tracked | VolumeData::Truth | VolumeData::None, _) => return Ok(of_frames(&tracked.motion.trajectory.frames, true)),
    }
    let anatomy = &patient.anatomy;
    let (left, right) = smooth_curves(plan)?;
    let mut warnings = Vec::new();
    let mut at_frames = |curve: &VolumeCurve, ventricle: Ventricle| -> Result<Option<Vec<f64>>, RunError> {
        let Some((_, cavity)) = anatomy.cavities.iter().find(|(own, _)| *own == ventricle) else { return Ok(None) };
        let mesh_ml = ml_from_mm3(cavity.volume_mm3(anatomy.mesh.vertices_mm()));
        let factor = mesh_ml / curve.volume_at_ml(clock.start_s);
        let side = if ventricle == Ventricle::Left { "left" } else { "right" };
        let words =
            format!("measured volumes of the {side} ventricle were multiplied by {factor:.3}, to the mesh's {mesh_ml:.1} mL at its frame");
        let odd = if (factor - 1.0).abs() > FACTOR_REPORTED { ": do they count the same slices as the labels of the mesh?" } else { "" };
        warnings.push(format!("{words}{odd}"));
        let curve = curve.scaled(factor)?;
        Ok(Some(clock.times_s.iter().map(|&time_s| curve.volume_at_ml(time_s)).collect()))
    };
    let left_ml = at_frames(&left, Ventricle::Left)?.ok_or(RunError::NothingToFit)?;
    let right_ml = right.map(|right| at_frames(&right, Ventricle::Right)).transpose()?.flatten();
    Ok(MeasuredVolumes { left_ml, right_ml, is_measured: true, is_tracked: false, warnings })
}
