//! The heart at rest on another image than the one that it was drawn on: the tracking carries its mesh there.
//!
//! The model rests, free of active stress and in equilibrium with the atrium, at the end of diastole. A mesh that was drawn on another image has another
//! filling; taken for the shape at rest it has thicker or thinner walls, another cavity and other normals than the heart whose stiffness and
//! pressure load it stands for. What the images show of the way from that image to the end of diastole is known, so the mesh goes along.

use std::sync::Arc;

use super::error::RunError;
use super::patient::{Patient, PatientImages};
use super::track::Tracked;
use crate::anatomy::{Anatomy, HeartAxes};
use crate::mesh::TetMesh;

/// The patient whose mesh was carried by `tracked` to the image `frame`, from which its beats start.
///
/// # Errors
/// [`RunError::FrameOutOfRange`] for an image that is none, and that of a mesh that the tracking has turned inside out.
pub(super) fn carried_to(patient: Patient, tracked: &Tracked, frame: usize) -> Result<Patient, RunError> {
    let clock = patient.clock(1);
    let Some(images) = patient.images else { return Err(RunError::NothingToFit) };
    let frame_count = images.cine.frames().len();
    let place = clock.position_of(frame).filter(|_| frame < frame_count);
    let carried = place.and_then(|place| tracked.motion.trajectory.frames.get(place));
    let carried = carried.ok_or(RunError::FrameOutOfRange { key: "personalisation.rest_frame", frame, frame_count })?;
    let later = (frame + frame_count - images.reference_frame) % frame_count;
    Ok(Patient {
        anatomy: Arc::new(moved(&patient.anatomy, &carried.position_mm)?),
        images: Some(PatientImages { reference_frame: frame, ..images }),
        truth: patient.truth.map(|truth| truth.turned_to(later)),
        ..patient
    })
}

/// The same tissue elsewhere. Its fibres and segments are those of the drawn heart: from one image of diastole to another they hardly turn.
fn moved(anatomy: &Anatomy, position_mm: &[nalgebra::Vector3<f64>]) -> Result<Anatomy, RunError> {
    let mesh = TetMesh::new(position_mm.to_vec(), anatomy.mesh.tetrahedra().to_vec())?;
    let shift_mm = anatomy
        .cavities
        .first()
        .map_or_else(Default::default, |(_, cavity)| cavity.lid_centre_mm(position_mm) - cavity.lid_centre_mm(anatomy.mesh.vertices_mm()));
    let axes = HeartAxes { base_centre_mm: anatomy.axes.base_centre_mm + shift_mm, ..anatomy.axes };
    Ok(Anatomy { mesh, axes, ..anatomy.clone() })
}
