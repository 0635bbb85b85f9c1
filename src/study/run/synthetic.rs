//! A synthetic patient: an idealised heart beats with true parameters, is imaged, and is handed over as a patient would be.

use std::sync::Arc;

use nalgebra::Vector3;

use super::error::RunError;
use super::imaged_beat::{ImagedBeat, imaged_beat};
use super::patient::{Patient, PatientImages, anatomy_from_labels};
use crate::anatomy::Anatomy;
use crate::heart::{FrameState, Parameter, Parameters};
use crate::image::{BaseCut, FieldOptions, HeartCodes, Plane, PreprocessSettings, preprocess};
use crate::mesh::TetMesh;
use crate::phantom::{LABEL_CAVITY_LV, LABEL_CAVITY_RV, LABEL_WALL, marked_valve_ring_mm};
use crate::study::RunContext;
use crate::study::plan::{ModelAnatomy, PhantomPlan, Plan};

/// What is known of a synthetic patient.
pub(super) struct Truth {
    /// True parameters.
    pub(super) parameters: Parameters,
    /// True volumes of the left ventricle at the frames of a clock of one beat (reference frame first and last), mL.
    pub(super) volumes_lv_ml: Vec<f64>,
    /// The true heart.
    pub(super) anatomy: Arc<Anatomy>,
    /// Its positions at those frames.
    pub(super) frames: Vec<FrameState>,
}

impl Truth {
    /// The same truth in the order of a beat that starts `later` images on.
    pub(super) fn turned_to(self, later: usize) -> Self {
        // The first image again last.
        let turned = |count: usize| (later..count).chain(1..=later);
        Self {
            volumes_lv_ml: turned(self.volumes_lv_ml.len()).filter_map(|n| self.volumes_lv_ml.get(n).copied()).collect(),
            frames: turned(self.frames.len()).filter_map(|n| self.frames.get(n).cloned()).collect(),
            ..self
        }
    }
}

/// Makes the synthetic patient of a plan from the true heart, which has its shape at `reference_s`.
pub(super) fn patient(
    plan: &Plan,
    phantom: &PhantomPlan,
    anatomy: Anatomy,
    reference_s: f64,
    context: &RunContext,
) -> Result<Patient, RunError> {
    let anatomy = Arc::new(anatomy);
    let beat = imaged_beat(plan, phantom, &anatomy, reference_s, context)?;
    let ImagedBeat { parameters, frames, imaged, .. } = beat;

    let mut warnings = Vec::new();
    let reference_frame = phantom.reference_frame;
    let cavity_rv = (anatomy.cavities.len() > 1).then_some(LABEL_CAVITY_RV);
    let codes = HeartCodes { cavity_rv, ..HeartCodes::left(LABEL_CAVITY_LV, LABEL_WALL) };
    let seen = match phantom.anatomy {
        ModelAnatomy::Truth => as_drawn(&anatomy, &frames[reference_frame], phantom)?,
        ModelAnatomy::Labels => {
            let options = FieldOptions { base: base_cut(phantom, &anatomy, &frames[reference_frame])?, ..FieldOptions::default() };
            anatomy_from_labels(&plan.anatomy, &imaged.labels[reference_frame], &codes, &options, &mut warnings)?
        }
    };
    let end_systole = imaged.volumes_ml.iter().enumerate().min_by(|a, b| a.1[0].total_cmp(&b.1[0])).map_or(0, |(frame, _)| frame);
    let images = PatientImages {
        cine: preprocess(&imaged.cine, &PreprocessSettings::default())?,
        long_axis: Vec::new(),
        slice_distance_mm: imaged.cine.grid().spacing_mm().z,
        acquired: (imaged.cine.grid().clone(), PreprocessSettings::default()),
        reference_frame,
        validation: vec![(end_systole, imaged.labels[end_systole].clone(), LABEL_CAVITY_LV)],
    };
    let frames = from_reference(reference_frame, &frames);
    let volumes_lv_ml = frames.iter().filter_map(|frame| frame.volume_ml.first().copied()).collect();
    let model_parameters = plan.parameters.clone().with(Parameter::HeartPeriod, parameters[Parameter::HeartPeriod])?;
    let truth = Truth { parameters, volumes_lv_ml, anatomy, frames };
    Ok(Patient {
        anatomy: Arc::new(seen),
        parameters: model_parameters,
        images: Some(images),
        truth: Some(truth),
        reference_s,
        frames_without_images: plan.simulation.frames,
        warnings,
    })
}

/// Where the mesh of the labels is cut: by the valve plane where that was marked on long-axis views.
fn base_cut(phantom: &PhantomPlan, anatomy: &Anatomy, frame: &FrameState) -> Result<BaseCut, RunError> {
    let Some(sd_mm) = phantom.valve_mark_sd_mm else { return Ok(BaseCut::default()) };
    let marks_mm = marked_valve_ring_mm(anatomy, &frame.position_mm, sd_mm, phantom.seed)?;
    Ok(Plane::through(&marks_mm).map_or(BaseCut::default(), BaseCut::Plane))
}

/// The true heart, at rest in the shape of one instant of its beat, scaled about its centre and shifted.
fn as_drawn(anatomy: &Anatomy, frame: &FrameState, phantom: &PhantomPlan) -> Result<Anatomy, RunError> {
    let true_mm = &frame.position_mm;
    let centre_mm = true_mm.iter().sum::<Vector3<f64>>() / true_mm.len() as f64;
    let drawn = |p: &Vector3<f64>| p + (p - centre_mm) * (phantom.reference_scale - 1.0) + phantom.reference_shift_mm;
    let mesh = TetMesh::new(true_mm.iter().map(drawn).collect(), anatomy.mesh.tetrahedra().to_vec())?;
    Ok(Anatomy { mesh, ..anatomy.clone() })
}

/// What was seen at the frames of a beat (its first again last), in the order of a beat that starts at the frame `reference`.
fn from_reference<T: Clone>(reference: usize, beat: &[T]) -> Vec<T> {
    beat[reference..].iter().chain(&beat[1..=reference]).cloned().collect()
}
