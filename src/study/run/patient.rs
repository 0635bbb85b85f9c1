//! What a run looks at: the heart at rest and, where there are any, its images, however they came about.

use std::sync::Arc;

use nalgebra::Vector3;

use super::clock::Clock;
use super::error::RunError;
use super::mesh_file::anatomy_of_file;
use super::synthetic::{self, Truth};
use crate::anatomy::mesher::MesherSettings;
use crate::anatomy::{Anatomy, AnatomySettings, FibreRule, IdealisedBiventricle, build_from_fields};
use crate::heart::{Parameter, Parameters};
use crate::image::{CineReading, CineSequence, FieldOptions, Grid, HeartCodes, LabelMap, PreprocessSettings, heart_fields, preprocess};
use crate::study::RunContext;
use crate::study::cine::StudyCine;
use crate::study::drawn_heart::DrawnHeart;
use crate::study::plan::{AnatomyPlan, AnatomySource, FibrePlan, IdealisedLv, ImageSource, ImagesPlan, Plan, ReferenceLabels};

/// A heart at rest with its images.
pub(super) struct Patient {
    pub(super) anatomy: Arc<Anatomy>,
    /// The plan's parameters, with the heart period of the images.
    pub(super) parameters: Parameters,
    pub(super) images: Option<PatientImages>,
    /// What is known of a synthetic patient.
    pub(super) truth: Option<Truth>,
    /// Time at which the mesh rests where there are no images, s.
    pub(super) reference_s: f64,
    /// How many instants of a beat are looked at where there are no images.
    pub(super) frames_without_images: usize,
    pub(super) warnings: Vec<String>,
}

/// Images and labels of one patient.
pub(super) struct PatientImages {
    /// Preprocessed frames.
    pub(super) cine: CineSequence,
    /// Preprocessed long-axis views at the heart period of the cine.
    pub(super) long_axis: Vec<CineSequence>,
    /// Distance between the slices as acquired, mm; the prepared images no longer show it.
    pub(super) slice_distance_mm: f64,
    /// The voxels as acquired, and how images on them are prepared.
    pub(super) acquired: (Grid, PreprocessSettings),
    /// The frame that the mesh was drawn on.
    pub(super) reference_frame: usize,
    /// Labels that nothing was fitted to, with their frame and the code of the LV cavity.
    pub(super) validation: Vec<(usize, LabelMap, u8)>,
}

impl PatientImages {
    /// Says how much of a heart lies outside of the images, in words where it is more than a little.
    fn cover_warning(&self, anatomy: &Anatomy) -> Result<Option<String>, RunError> {
        const REPORTED: f64 = 0.02;
        const REFUSED: f64 = 0.5;
        let (grid, slack_mm) = (self.cine.grid(), 0.5 * self.slice_distance_mm);
        let is_outside = |position_mm: &&Vector3<f64>| {
            let voxel = grid.to_voxel(position_mm);
            (0..3).any(|axis| {
                let (spacing_mm, last) = (grid.spacing_mm()[axis], (grid.shape()[axis] - 1) as f64);
                voxel[axis] * spacing_mm < -slack_mm || (voxel[axis] - last) * spacing_mm > slack_mm
            })
        };
        let vertices_mm = anatomy.mesh.vertices_mm();
        let share = vertices_mm.iter().filter(is_outside).count() as f64 / vertices_mm.len() as f64;
        if share > REFUSED {
            return Err(RunError::OutsideImages { percent: 100.0 * share });
        }
        let words = || format!("{:.0} % of the mesh lie outside of the images, where nothing is tracked", 100.0 * share);
        Ok((share > REPORTED).then(words))
    }
}

impl Patient {
    /// Reads or makes the patient of a plan.
    pub(super) fn new(plan: &Plan, context: &RunContext) -> Result<Self, RunError> {
        let building = || context.progress().stage("building the anatomy", None);
        match (&plan.anatomy.source, &plan.images) {
            (AnatomySource::IdealisedLv(shape), Some(ImageSource::Phantom(phantom))) => {
                building();
                synthetic::patient(plan, phantom, idealised_anatomy(&plan.anatomy, shape)?, shape.reference_time_s, context)
            }
            (AnatomySource::IdealisedBiventricle { shape, reference_time_s }, Some(ImageSource::Phantom(phantom))) => {
                building();
                synthetic::patient(plan, phantom, biventricular_anatomy(&plan.anatomy, shape)?, *reference_time_s, context)
            }
            (AnatomySource::Labels(drawn), images) => {
                context.progress().stage("reading images and labels", None);
                let mut warnings = Vec::new();
                let mut parameters = plan.parameters.clone();
                let (heart, images) = match images {
                    Some(ImageSource::Cine(images)) => {
                        let period_s = plan.written.contains(&Parameter::HeartPeriod.into()).then_some(parameters[Parameter::HeartPeriod]);
                        let study = StudyCine::read(images, period_s, Some(drawn))?;
                        parameters.set(Parameter::HeartPeriod, study.cine.period_s())?;
                        let heart = study.read_heart(drawn)?;
                        (heart, Some(prepared_images(images, study, drawn.frame, &mut warnings)?))
                    }
                    _ => (DrawnHeart::read(drawn)?, None),
                };
                building();
                let DrawnHeart { labels, codes, warnings: odd } = heart;
                warnings.extend(odd);
                let anatomy = anatomy_from_labels(&plan.anatomy, &labels, &codes, &drawn.field_options(), &mut warnings)?;
                if let Some(images) = &images {
                    warnings.extend(images.cover_warning(&anatomy)?);
                }
                let (anatomy, frames_without_images) = (Arc::new(anatomy), plan.simulation.frames);
                Ok(Self { anatomy, parameters, images, truth: None, reference_s: 0.0, frames_without_images, warnings })
            }
            (AnatomySource::IdealisedLv(shape), _) => {
                building();
                Ok(Self::without_images(plan, idealised_anatomy(&plan.anatomy, shape)?, shape.reference_time_s))
            }
            (AnatomySource::IdealisedBiventricle { shape, reference_time_s }, _) => {
                building();
                Ok(Self::without_images(plan, biventricular_anatomy(&plan.anatomy, shape)?, *reference_time_s))
            }
            (AnatomySource::Mesh(mesh), _) => {
                building();
                Ok(Self::without_images(plan, anatomy_of_file(mesh, &anatomy_settings(&plan.anatomy))?, mesh.reference_time_s))
            }
        }
    }

    /// A heart that no image shows.
    fn without_images(plan: &Plan, anatomy: Anatomy, reference_s: f64) -> Self {
        Self {
            anatomy: Arc::new(anatomy),
            parameters: plan.parameters.clone(),
            images: None,
            truth: None,
            reference_s,
            frames_without_images: plan.simulation.frames,
            warnings: Vec::new(),
        }
    }

    /// The clock of `beats` beats from the reference frame.
    pub(super) fn clock(&self, beats: usize) -> Clock {
        self.clock_at(self.parameters[Parameter::HeartPeriod], beats)
    }

    /// The same for another heart period; images keep their times.
    pub(super) fn clock_at(&self, period_s: f64, beats: usize) -> Clock {
        match &self.images {
            Some(images) => Clock::new(images.reference_frame, images.cine.times_s(), period_s, beats),
            None => {
                let count = self.frames_without_images;
                let times_s: Vec<f64> = (0..count).map(|n| self.reference_s + period_s * n as f64 / count as f64).collect();
                Clock::new(0, &times_s, period_s, beats)
            }
        }
    }
}

fn to_code(code: u16) -> u8 {
    u8::try_from(code).unwrap_or(u8::MAX)
}

/// Images and labels as runs use them, all views prepared alike (\[Billet2009\] §6.2).
fn prepared_images(
    images: &ImagesPlan,
    study: StudyCine,
    reference_frame: usize,
    warnings: &mut Vec<String>,
) -> Result<PatientImages, RunError> {
    let frame_count = study.cine.frames().len();
    let in_range = |key, frame| if frame < frame_count { Ok(frame) } else { Err(RunError::FrameOutOfRange { key, frame, frame_count }) };
    in_range("anatomy.frame", reference_frame)?;
    let mut validation = Vec::new();
    for ReferenceLabels { path, frame, code_cavity_lv, slices } in &images.validation {
        let maps = match *frame {
            Some(frame) => {
                in_range("images.validation.frame", frame)?;
                vec![(frame, study.read_labels(path, frame, slices.as_ref())?)]
            }
            None => study.read_labels_of_every_frame(path, slices.as_ref())?.into_iter().enumerate().collect(),
        };
        validation.extend(maps.into_iter().map(|(frame, labels)| (frame, labels, to_code(*code_cavity_lv))));
    }
    let settings = PreprocessSettings {
        spacing_mm: images.isotropic_spacing_mm,
        quantile_low: images.quantile_low,
        quantile_high: images.quantile_high,
    };
    let mut long_axis = Vec::new();
    for CineReading { cine, warnings: odd } in study.read_long_axis(images)? {
        warnings.extend(odd);
        long_axis.push(preprocess(&cine, &settings)?);
    }
    warnings.extend(study.warnings);
    let slice_distance_mm = study.cine.grid().spacing_mm().z;
    let acquired = (study.cine.grid().clone(), settings);
    Ok(PatientImages { cine: preprocess(&study.cine, &settings)?, long_axis, slice_distance_mm, acquired, reference_frame, validation })
}

/// What a study says of every anatomy.
pub(super) fn anatomy_settings(plan: &AnatomyPlan) -> AnatomySettings {
    let default = AnatomySettings::default();
    let rule = |fibres: FibrePlan| FibreRule { helix_endocardium_deg: fibres.endocardium_deg, helix_epicardium_deg: fibres.epicardium_deg };
    AnatomySettings {
        fibres: rule(plan.fibres),
        fibres_rv: Some(rule(plan.fibres_rv)),
        septal_direction: plan.septal_direction.unwrap_or(default.septal_direction),
    }
}

/// The shape of an idealised left ventricle.
pub(super) fn idealised_shape(shape: &IdealisedLv) -> crate::phantom::IdealisedLv {
    crate::phantom::IdealisedLv {
        cavity_radius_mm: shape.cavity_radius_mm,
        cavity_length_mm: shape.cavity_length_mm,
        base_height_mm: shape.base_height_mm,
        wall_thickness_mm: shape.wall_thickness_mm,
        apex_thickness_mm: shape.apex_thickness_mm,
        cross_section_ratio: shape.cross_section_ratio,
        epicardium_offset_mm: shape.epicardium_offset_mm,
        ..crate::phantom::IdealisedLv::default()
    }
}

/// The idealised left ventricle of a plan.
pub(super) fn idealised_anatomy(plan: &AnatomyPlan, shape: &IdealisedLv) -> Result<Anatomy, RunError> {
    Ok(idealised_shape(shape).build(&MesherSettings::with_edge_length_mm(plan.edge_length_mm), &anatomy_settings(plan))?)
}

/// The idealised ventricles of a plan.
pub(super) fn biventricular_anatomy(plan: &AnatomyPlan, shape: &IdealisedBiventricle) -> Result<Anatomy, RunError> {
    Ok(shape.build(&MesherSettings::with_edge_length_mm(plan.edge_length_mm), &anatomy_settings(plan))?)
}

/// The heart that a label map shows.
pub(super) fn anatomy_from_labels(
    plan: &AnatomyPlan,
    labels: &LabelMap,
    codes: &HeartCodes,
    options: &FieldOptions,
    warnings: &mut Vec<String>,
) -> Result<Anatomy, RunError> {
    let fields = heart_fields(labels, codes, options)?;
    warnings.extend(fields.warnings.iter().cloned());
    let mesher = MesherSettings::with_edge_length_mm(plan.edge_length_mm);
    Ok(build_from_fields(&fields, &mesher, &anatomy_settings(plan))?)
}
