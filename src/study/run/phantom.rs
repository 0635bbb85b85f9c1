//! `kind = "phantom"`: a heart beats, is imaged, and its images are left as a patient's would be, with the truth beside them, \[Billet2009\] §6.1.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use super::error::RunError;
use super::imaged_beat::{ImagedBeat, imaged_beat};
use super::leave::{BeatSummary, frame_rows, write_beat, write_positions};
use super::montages::{ImageScene, NamedMotion, montages};
use super::page::{Account, Colouring, Frames, beat_section, key_figures, leave_page, motion_section, wall_section};
use super::patient::{Patient, PatientImages};
use crate::image::{PreprocessSettings, VolumeCurve, preprocess, write_cine, write_label_map, write_label_maps};
use crate::mesh::MeshQuality;
use crate::numerics::root_mean_square;
use crate::phantom::{LABEL_CAVITY_LV, LABEL_CAVITY_RV};
use crate::report::figures::{Curve, Look, VolumeCurves, volume_curves};
use crate::report::html::{Block, Plot, Section};
use crate::report::{write_atomically, write_csv, write_json};
use crate::study::plan::{ImageSource, PhantomPlan};
use crate::study::{Kind, Outcome, Plan, Provenance, RunContext, Status};

/// A row of `volumes.csv`: the truth at one image, from the mesh, by the voxels' shares of blood, and counted in the labels, where every voxel
/// is one tissue.
#[derive(Debug, Clone, Serialize)]
struct VolumeRow {
    frame: usize,
    time_s: f64,
    volume_lv_ml: f64,
    volume_voxels_lv_ml: f64,
    volume_labels_lv_ml: f64,
    volume_rv_ml: Option<f64>,
    volume_voxels_rv_ml: Option<f64>,
    volume_labels_rv_ml: Option<f64>,
}

/// A row of `slice_shifts.csv`: how far a slice shows everything displaced.
#[derive(Debug, Clone, Serialize)]
struct ShiftRow {
    slice: usize,
    shift_i_mm: f64,
    shift_j_mm: f64,
}

/// The images in figures.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
struct ImagesSummary {
    shape: [usize; 3],
    spacing_mm: [f64; 3],
    slice_thickness_mm: f64,
    frame_count: usize,
    first_frame_s: f64,
    frame_step_s: f64,
    reference_frame: usize,
    end_systolic_frame: usize,
    volume_labels_error_rms_lv_ml: f64,
    slice_shift_greatest_mm: f64,
}

#[derive(Serialize)]
struct Summary<'a> {
    kind: Kind,
    status: Status,
    #[serde(flatten)]
    beat: Option<BeatSummary>,
    images: ImagesSummary,
    /// The law of motion, where it is prescribed.
    #[serde(skip_serializing_if = "Option::is_none")]
    prescribed_ejection_fraction: Option<f64>,
    /// All parameters of the heart that was imaged.
    true_parameters: BTreeMap<String, f64>,
    mesh: MeshQuality,
    warnings: &'a [String],
    wall_time_s: f64,
    provenance: &'a Provenance,
}

/// Makes the images of a plan and leaves them with their truth.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let Some(ImageSource::Phantom(phantom)) = &plan.images else { return Err(RunError::NothingToFit) };
    let patient = Patient::new(&Plan { images: None, ..plan.clone() }, context)?;
    let beat = imaged_beat(plan, phantom, &patient.anatomy, patient.reference_s, context)?;

    context.progress().stage("writing images and truth", None);
    let folder = &plan.output.directory;
    let rows = volume_rows(&beat)?;
    let end_systolic_frame = (0..rows.len()).min_by(|&a, &b| rows[a].volume_lv_ml.total_cmp(&rows[b].volume_lv_ml)).unwrap_or(0);
    write_images(folder, &beat, phantom.reference_frame, end_systolic_frame)?;
    write_csv(&folder.join("volumes.csv"), &rows)?;
    write_csv(&folder.join("slice_shifts.csv"), &shift_rows(&beat))?;
    match &beat.model {
        Some((model, trajectory)) => {
            write_beat(plan, model, trajectory, &beat.clock, &frame_rows(&beat.clock, trajectory, None, &[], &[]))?
        }
        None if plan.output.meshes => write_positions(folder, "heart", &patient.anatomy, &beat.frames)?,
        None => {}
    }
    let shown = shown_images(&beat)?;
    let motions = [NamedMotion { name: "truth", frames: &beat.frames }];
    let scene = ImageScene { plan, patient: &patient, images: &shown, clock: &beat.clock, motions: &motions };
    if plan.output.figures {
        for figure in volume_figures(&rows) {
            let suffix = if figure.quantity.starts_with("LV") { "lv" } else { "rv" };
            volume_curves(&folder.join(format!("volume_{suffix}.png")), &figure)?;
        }
        montages(&scene)?;
    }
    let images = images_summary(phantom, &beat, &rows, end_systolic_frame);
    let headlines = headlines(&images, &rows);
    let summary = Summary {
        kind: plan.kind,
        status: Status::Converged,
        beat: beat.model.as_ref().map(|(model, trajectory)| BeatSummary::new(model, trajectory, &beat.clock)),
        images,
        prescribed_ejection_fraction: phantom.contraction.map(|contraction| contraction.ejection_fraction),
        true_parameters: beat.parameters.all_values().map(|(parameter, value)| (parameter.name(), value)).collect(),
        mesh: MeshQuality::of(&patient.anatomy.mesh),
        warnings: &patient.warnings,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&folder.join("summary.json"), &summary)?;
    let account = Account {
        status: Status::Converged,
        headlines: &headlines,
        warnings: summary.warnings,
        key_figures: summary.beat.as_ref().map(|beat| key_figures(beat, None)).unwrap_or_default(),
        record: &summary,
    };
    leave_report(&scene, &beat, &rows, account)?;
    context.progress().finish();
    Ok(Outcome { status: Status::Converged, directory: folder.clone(), headlines })
}

/// Writes `cine.nii.gz`, the labels of every frame, and those of two frames alone, as an expert would draw them.
fn write_images(folder: &Path, beat: &ImagedBeat, reference_frame: usize, end_systolic_frame: usize) -> Result<(), RunError> {
    let (cine, labels) = (&beat.imaged.cine, &beat.imaged.labels);
    write_atomically(&folder.join("cine.nii.gz"), |out| write_cine(out, cine))?;
    write_atomically(&folder.join("labels.nii.gz"), |out| write_label_maps(out, labels, cine.times_s(), cine.period_s()))?;
    for (name, frame) in [("reference", reference_frame), ("end_systole", end_systolic_frame)] {
        write_atomically(&folder.join(format!("labels_{name}.nii.gz")), |out| write_label_map(out, &labels[frame]))?;
    }
    Ok(())
}

fn volume_rows(beat: &ImagedBeat) -> Result<Vec<VolumeRow>, RunError> {
    let cine = &beat.imaged.cine;
    let of_labels = |code| {
        VolumeCurve::from_label_maps(&beat.imaged.labels, code, 0..usize::MAX, cine.times_s().to_vec(), cine.period_s())
            .map(|curve| curve.volumes_ml().to_vec())
    };
    let has_right = beat.imaged.volumes_ml.iter().all(|volumes| volumes.len() > 1);
    let (left, right) = (of_labels(LABEL_CAVITY_LV)?, if has_right { Some(of_labels(LABEL_CAVITY_RV)?) } else { None });
    let row = |(frame, volumes): (usize, &Vec<f64>)| VolumeRow {
        frame,
        time_s: cine.times_s()[frame],
        volume_lv_ml: volumes[0],
        volume_voxels_lv_ml: beat.imaged.voxel_volumes_ml[frame][0],
        volume_labels_lv_ml: left[frame],
        volume_rv_ml: volumes.get(1).copied(),
        volume_voxels_rv_ml: beat.imaged.voxel_volumes_ml[frame].get(1).copied(),
        volume_labels_rv_ml: right.as_ref().map(|right| right[frame]),
    };
    Ok(beat.imaged.volumes_ml.iter().enumerate().map(row).collect())
}

fn shift_rows(beat: &ImagedBeat) -> Vec<ShiftRow> {
    let row = |slice: usize| {
        let shift_mm = beat.imaging.slice_shifts_mm.get(slice).copied().unwrap_or_default();
        ShiftRow { slice, shift_i_mm: shift_mm.x, shift_j_mm: shift_mm.y }
    };
    (0..beat.imaged.cine.grid().shape()[2]).map(row).collect()
}

fn images_summary(phantom: &PhantomPlan, beat: &ImagedBeat, rows: &[VolumeRow], end_systolic_frame: usize) -> ImagesSummary {
    let cine = &beat.imaged.cine;
    let errors: Vec<f64> = rows.iter().map(|row| row.volume_labels_lv_ml - row.volume_lv_ml).collect();
    ImagesSummary {
        shape: cine.grid().shape(),
        spacing_mm: cine.grid().spacing_mm().into(),
        slice_thickness_mm: phantom.slice_thickness_mm,
        frame_count: cine.frames().len(),
        first_frame_s: cine.times_s()[0],
        frame_step_s: cine.period_s() / cine.frames().len() as f64,
        reference_frame: phantom.reference_frame,
        end_systolic_frame,
        volume_labels_error_rms_lv_ml: root_mean_square(&errors),
        slice_shift_greatest_mm: beat.imaging.slice_shifts_mm.iter().map(|shift| shift.norm()).fold(0.0, f64::max),
    }
}

/// Volumes of the truth and of its labels, a ventricle each.
fn volume_figures(rows: &[VolumeRow]) -> Vec<VolumeCurves> {
    let times_s: Vec<f64> = rows.iter().map(|row| row.time_s).collect();
    let of = |value: &dyn Fn(&VolumeRow) -> Option<f64>| rows.iter().filter_map(value).collect::<Vec<f64>>();
    let left = ("LV", of(&|row| Some(row.volume_lv_ml)), of(&|row| Some(row.volume_labels_lv_ml)));
    let right = ("RV", of(&|row| row.volume_rv_ml), of(&|row| row.volume_labels_rv_ml));
    let figure = |(name, truth_ml, labels_ml): (&str, Vec<f64>, Vec<f64>)| {
        let curves = vec![
            Curve::new("mesh", Look::Truth, &times_s, &truth_ml),
            Curve::new("counted in the labels", Look::Measured, &times_s, &labels_ml),
        ];
        let title = format!("{name} volume, truth and labels");
        (!truth_ml.is_empty()).then(|| VolumeCurves { title, quantity: format!("{name} volume"), curves })
    };
    [left, right].into_iter().filter_map(figure).collect()
}

/// The images as a patient's would be prepared.
fn shown_images(beat: &ImagedBeat) -> Result<PatientImages, RunError> {
    Ok(PatientImages {
        cine: preprocess(&beat.imaged.cine, &PreprocessSettings::default())?,
        long_axis: Vec::new(),
        slice_distance_mm: beat.imaged.cine.grid().spacing_mm().z,
        acquired: (beat.imaged.cine.grid().clone(), PreprocessSettings::default()),
        reference_frame: 0,
        validation: Vec::new(),
    })
}

fn leave_report(scene: &ImageScene, beat: &ImagedBeat, rows: &[VolumeRow], account: Account<Summary>) -> Result<(), RunError> {
    let &ImageScene { plan, patient, clock, .. } = scene;
    let frames = Frames::of(clock, &beat.frames);
    let model = beat.model.as_ref().map(|(model, trajectory)| (model, trajectory));
    let colouring = Colouring { anatomy: &patient.anatomy, frames: &beat.frames, model };
    let plots: Vec<Block> = volume_figures(rows).iter().map(|figure| Block::Plot(Plot::from(figure))).collect();
    let mut sections = vec![Section { title: "Truth and labels".into(), blocks: vec![Block::Beside(plots)] }];
    sections.extend(model.map(|(_, trajectory)| beat_section(clock, trajectory, [&[], &[]])));
    sections.push(motion_section(clock, &frames, Some(scene), &colouring)?);
    sections.extend(model.map(|(model, trajectory)| wall_section(model, clock, trajectory)));
    leave_page(plan, account, sections, frames.times_s)
}

fn headlines(images: &ImagesSummary, rows: &[VolumeRow]) -> Vec<String> {
    let [ni, nj, nk] = images.shape;
    let [si, sj, sk] = images.spacing_mm;
    let extreme = |pick: fn(f64, f64) -> f64, from: f64| rows.iter().map(|row| row.volume_lv_ml).fold(from, pick);
    vec![
        format!("{} frames of {ni} × {nj} × {nk} voxels of {si:.2} × {sj:.2} × {sk:.2} mm", images.frame_count),
        format!(
            "LV {:.1} to {:.1} mL; counted in the labels {:.2} mL RMS beside that",
            extreme(f64::max, 0.0),
            extreme(f64::min, f64::INFINITY),
            images.volume_labels_error_rms_lv_ml
        ),
    ]
}
