//! The files that a run leaves, whichever kind it is: curves, frames, meshes; names and units are a contract with their readers.

use std::path::Path;

use serde::Serialize;

use super::clock::Clock;
use super::error::RunError;
use super::forward::{deformation, observables};
use super::track::Tracked;
use super::wall::{WallSummary, write_wall};
use crate::anatomy::{Anatomy, Ventricle};
use crate::heart::{ActivationTimes, BeatObservables, FrameState, HeartModel, Strain, Trajectory};
use crate::mesh::io::{FieldValues, write_vtu};
use crate::mesh::{MeshQuality, SurfaceTag};
use crate::report::{create_folder, write_csv, write_pvd};
use crate::study::{Plan, Provenance, Status};

/// The beat in figures, as `summary.json` names them; absent for a ventricle that the heart does not have.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
pub(super) struct BeatSummary {
    pub(super) ejection_fraction_lv: Option<f64>,
    pub(super) end_diastolic_volume_lv_ml: Option<f64>,
    pub(super) end_systolic_volume_lv_ml: Option<f64>,
    pub(super) stroke_volume_lv_ml: Option<f64>,
    pub(super) pressure_peak_lv_mmhg: Option<f64>,
    pub(super) pressure_end_diastolic_lv_mmhg: Option<f64>,
    pub(super) pressure_rate_max_lv_mmhg_per_s: Option<f64>,
    pub(super) pressure_systolic_aorta_mmhg: Option<f64>,
    pub(super) pressure_diastolic_aorta_mmhg: Option<f64>,
    pub(super) isovolumetric_contraction_lv_ms: Option<f64>,
    pub(super) ejection_lv_ms: Option<f64>,
    pub(super) isovolumetric_relaxation_lv_ms: Option<f64>,
    pub(super) filling_lv_ms: Option<f64>,
    pub(super) ejection_fraction_rv: Option<f64>,
    pub(super) end_diastolic_volume_rv_ml: Option<f64>,
    pub(super) end_systolic_volume_rv_ml: Option<f64>,
    pub(super) stroke_volume_rv_ml: Option<f64>,
    pub(super) pressure_peak_rv_mmhg: Option<f64>,
    pub(super) pressure_end_diastolic_rv_mmhg: Option<f64>,
    pub(super) pressure_rate_max_rv_mmhg_per_s: Option<f64>,
    pub(super) pressure_systolic_pulmonary_mmhg: Option<f64>,
    pub(super) pressure_diastolic_pulmonary_mmhg: Option<f64>,
    pub(super) isovolumetric_contraction_rv_ms: Option<f64>,
    pub(super) ejection_rv_ms: Option<f64>,
    pub(super) isovolumetric_relaxation_rv_ms: Option<f64>,
    pub(super) filling_rv_ms: Option<f64>,
    pub(super) total_activation_time_ms: f64,
    pub(super) activation_time_lv_ms: f64,
    pub(super) activation_time_rv_ms: Option<f64>,
    /// Steps of corotational kinematics that were taken in parts.
    pub(super) divided_step_count: usize,
    #[serde(flatten)]
    pub(super) wall: Option<WallSummary>,
}

impl BeatSummary {
    /// The last beat of a trajectory.
    pub(super) fn new(model: &HeartModel, trajectory: &Trajectory, clock: &Clock) -> Self {
        let observables = observables(trajectory, clock);
        let of = |ventricle, value: fn(&BeatObservables) -> f64| observables.iter().find(|(v, _)| *v == ventricle).map(|(_, o)| value(o));
        let (left, right) = (Ventricle::Left, Ventricle::Right);
        let activation = ActivationTimes::new(model.anatomy(), model.activation());
        Self {
            ejection_fraction_lv: of(left, |o| o.ejection_fraction),
            end_diastolic_volume_lv_ml: of(left, |o| o.end_diastolic_volume_ml),
            end_systolic_volume_lv_ml: of(left, |o| o.end_systolic_volume_ml),
            stroke_volume_lv_ml: of(left, |o| o.stroke_volume_ml),
            pressure_peak_lv_mmhg: of(left, |o| o.pressure_peak_mmhg),
            pressure_end_diastolic_lv_mmhg: of(left, |o| o.pressure_end_diastolic_mmhg),
            pressure_rate_max_lv_mmhg_per_s: of(left, |o| o.pressure_rate_max_mmhg_per_s),
            pressure_systolic_aorta_mmhg: of(left, |o| o.arterial_pressure_systolic_mmhg),
            pressure_diastolic_aorta_mmhg: of(left, |o| o.arterial_pressure_diastolic_mmhg),
            isovolumetric_contraction_lv_ms: of(left, |o| o.isovolumetric_contraction_ms),
            ejection_lv_ms: of(left, |o| o.ejection_ms),
            isovolumetric_relaxation_lv_ms: of(left, |o| o.isovolumetric_relaxation_ms),
            filling_lv_ms: of(left, |o| o.filling_ms),
            ejection_fraction_rv: of(right, |o| o.ejection_fraction),
            end_diastolic_volume_rv_ml: of(right, |o| o.end_diastolic_volume_ml),
            end_systolic_volume_rv_ml: of(right, |o| o.end_systolic_volume_ml),
            stroke_volume_rv_ml: of(right, |o| o.stroke_volume_ml),
            pressure_peak_rv_mmhg: of(right, |o| o.pressure_peak_mmhg),
            pressure_end_diastolic_rv_mmhg: of(right, |o| o.pressure_end_diastolic_mmhg),
            pressure_rate_max_rv_mmhg_per_s: of(right, |o| o.pressure_rate_max_mmhg_per_s),
            pressure_systolic_pulmonary_mmhg: of(right, |o| o.arterial_pressure_systolic_mmhg),
            pressure_diastolic_pulmonary_mmhg: of(right, |o| o.arterial_pressure_diastolic_mmhg),
            isovolumetric_contraction_rv_ms: of(right, |o| o.isovolumetric_contraction_ms),
            ejection_rv_ms: of(right, |o| o.ejection_ms),
            isovolumetric_relaxation_rv_ms: of(right, |o| o.isovolumetric_relaxation_ms),
            filling_rv_ms: of(right, |o| o.filling_ms),
            total_activation_time_ms: crate::units::MS_PER_S * activation.total_s,
            activation_time_lv_ms: crate::units::MS_PER_S * activation.left_s,
            activation_time_rv_ms: activation.right_s.map(|time_s| crate::units::MS_PER_S * time_s),
            divided_step_count: trajectory.divided_step_count,
            wall: deformation(model, trajectory, clock).map(|beat| WallSummary::new(&beat)),
        }
    }
}

/// `summary.json`; what a kind does not have is absent.
#[derive(Debug, Serialize)]
pub(super) struct Summary<'a, D: Serialize> {
    pub(super) kind: crate::study::Kind,
    pub(super) status: Status,
    #[serde(flatten)]
    pub(super) beat: BeatSummary,
    #[serde(flatten)]
    pub(super) details: D,
    pub(super) mesh: MeshQuality,
    pub(super) warnings: &'a [String],
    pub(super) wall_time_s: f64,
    pub(super) provenance: &'a Provenance,
}

/// A row of `frames.csv`: one image time.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the columns of the file, units last")]
pub(super) struct FrameRow {
    pub(super) frame: usize,
    pub(super) time_s: f64,
    pub(super) volume_lv_ml: Option<f64>,
    pub(super) volume_rv_ml: Option<f64>,
    pub(super) pressure_lv_kpa: Option<f64>,
    pub(super) pressure_rv_kpa: Option<f64>,
    pub(super) volume_tracked_lv_ml: Option<f64>,
    pub(super) volume_measured_lv_ml: Option<f64>,
    pub(super) volume_residual_lv_ml: Option<f64>,
    pub(super) boundary_rms_endocardium_lv_mm: Option<f64>,
    pub(super) boundary_rms_epicardium_mm: Option<f64>,
    pub(super) volume_truth_lv_ml: Option<f64>,
}

/// The rows of `frames.csv`; `measured_ml` and `truth_ml` may be empty.
pub(super) fn frame_rows(
    clock: &Clock,
    trajectory: &Trajectory,
    tracked: Option<&Tracked>,
    measured_ml: &[f64],
    truth_ml: &[f64],
) -> Vec<FrameRow> {
    let row = |(place, state): (usize, &crate::heart::FrameState)| {
        let tracked_frame = tracked.and_then(|tracked| tracked.motion.frames.get(place));
        let tracked_state = tracked.and_then(|tracked| tracked.motion.trajectory.frames.get(place));
        let rms = |tag| tracked_frame.and_then(|frame| frame.residuals.iter().find(|r| r.tag == tag).map(|r| r.rms_mm));
        let (volume_lv_ml, measured) = (state.volume_ml.first().copied(), measured_ml.get(place).copied());
        FrameRow {
            frame: clock.frames.get(place).copied().unwrap_or(place),
            time_s: state.time_s,
            volume_lv_ml,
            volume_rv_ml: state.volume_ml.get(1).copied(),
            pressure_lv_kpa: state.pressure_kpa.first().copied(),
            pressure_rv_kpa: state.pressure_kpa.get(1).copied(),
            volume_tracked_lv_ml: tracked_state.and_then(|state| state.volume_ml.first().copied()),
            volume_measured_lv_ml: measured,
            volume_residual_lv_ml: volume_lv_ml.zip(measured).map(|(simulated, measured)| simulated - measured),
            boundary_rms_endocardium_lv_mm: rms(SurfaceTag::EndocardiumLv),
            boundary_rms_epicardium_mm: rms(SurfaceTag::Epicardium),
            volume_truth_lv_ml: truth_ml.get(place).copied(),
        }
    };
    trajectory.frames.iter().enumerate().map(row).collect()
}

/// Writes the beating mesh at the frames of a trajectory as `name`.pvd and a folder `name` of VTU files. Strains are against
/// end-diastole.
pub(super) fn write_series(folder: &Path, name: &str, model: &HeartModel, trajectory: &Trajectory, clock: &Clock) -> Result<(), RunError> {
    create_folder(&folder.join(name))?;
    let anatomy = model.anatomy();
    let rest_mm = anatomy.mesh.vertices_mm();
    let beat = deformation(model, trajectory, clock);
    let reference_mm = beat.as_ref().map_or(rest_mm, |beat| &beat.reference_mm);
    let fibres: Vec<_> = anatomy.fibre_axes.iter().map(|axes| axes.column(0).into_owned()).collect();
    let segments: Vec<i32> = anatomy.aha_segments.iter().map(|&segment| i32::from(segment)).collect();
    let mut listed = Vec::with_capacity(trajectory.frames.len());
    for (number, frame) in trajectory.frames.iter().enumerate() {
        let displacement_mm: Vec<_> = frame.position_mm.iter().zip(rest_mm).map(|(now, rest)| now - rest).collect();
        let stress_kpa = model.active_stress_kpa(frame.time_s);
        let strains = Strain::of_tetrahedra(anatomy, reference_mm, &frame.position_mm);
        let of = |value: fn(&Strain) -> f64| strains.iter().map(value).collect::<Vec<f64>>();
        let [circumferential, longitudinal, radial] = [of(|s| s.circumferential), of(|s| s.longitudinal), of(|s| s.radial)];
        let file = format!("{name}/{number:03}.vtu");
        let point_fields = [
            ("displacement_mm", FieldValues::Vectors(&displacement_mm)),
            ("activation_time_s", FieldValues::Scalars(model.activation().times_s())),
            ("transmural_depth", FieldValues::Scalars(&anatomy.transmural_depth)),
        ];
        let cell_fields = [
            ("active_stress_kpa", FieldValues::Scalars(&stress_kpa)),
            ("strain_circumferential", FieldValues::Scalars(&circumferential)),
            ("strain_longitudinal", FieldValues::Scalars(&longitudinal)),
            ("strain_radial", FieldValues::Scalars(&radial)),
            ("fibre", FieldValues::Vectors(&fibres)),
            ("aha_segment", FieldValues::Labels(&segments)),
        ];
        write_vtu(&folder.join(&file), &anatomy.mesh, &frame.position_mm, &point_fields, &cell_fields)?;
        listed.push((frame.time_s, file));
    }
    Ok(write_pvd(&folder.join(format!("{name}.pvd")), &listed)?)
}

/// Writes the positions of a mesh that no model moves, as [`write_series`] does.
pub(super) fn write_positions(folder: &Path, name: &str, anatomy: &Anatomy, frames: &[FrameState]) -> Result<(), RunError> {
    create_folder(&folder.join(name))?;
    let segments: Vec<i32> = anatomy.aha_segments.iter().map(|&segment| i32::from(segment)).collect();
    let mut listed = Vec::with_capacity(frames.len());
    for (number, frame) in frames.iter().enumerate() {
        let displacement_mm: Vec<_> = frame.position_mm.iter().zip(anatomy.mesh.vertices_mm()).map(|(now, rest)| now - rest).collect();
        let file = format!("{name}/{number:03}.vtu");
        let point_fields = [
            ("displacement_mm", FieldValues::Vectors(&displacement_mm)),
            ("transmural_depth", FieldValues::Scalars(&anatomy.transmural_depth)),
        ];
        let cell_fields = [("aha_segment", FieldValues::Labels(&segments))];
        write_vtu(&folder.join(&file), &anatomy.mesh, &frame.position_mm, &point_fields, &cell_fields)?;
        listed.push((frame.time_s, file));
    }
    Ok(write_pvd(&folder.join(format!("{name}.pvd")), &listed)?)
}

/// Writes `curves.csv`, `frames.csv` and what the wall does, and the mesh series where the plan asks for it.
pub(super) fn write_beat(
    plan: &Plan,
    model: &HeartModel,
    trajectory: &Trajectory,
    clock: &Clock,
    rows: &[FrameRow],
) -> Result<(), RunError> {
    let folder = &plan.output.directory;
    write_csv(&folder.join("curves.csv"), &trajectory.curves)?;
    write_csv(&folder.join("frames.csv"), rows)?;
    if let Some(beat) = deformation(model, trajectory, clock) {
        write_wall(folder, model, &beat)?;
    }
    if plan.output.meshes {
        write_series(folder, "heart", model, trajectory, clock)?;
    }
    Ok(())
}

/// A row of `base_motion.csv`: a base vertex at a frame, world RAS.
#[derive(Debug, Clone, Serialize)]
struct BaseMotionRow {
    frame: usize,
    time_s: f64,
    vertex: usize,
    x_mm: f64,
    y_mm: f64,
    z_mm: f64,
}

/// Writes the motion of the base, which a later run without images can follow.
pub(super) fn write_base_motion(folder: &Path, clock: &Clock, model: &HeartModel, trajectory: &Trajectory) -> Result<(), RunError> {
    let vertices = model.anatomy().surface.vertices_with(SurfaceTag::Base);
    let rows: Vec<BaseMotionRow> = trajectory
        .frames
        .iter()
        .zip(&clock.frames)
        .flat_map(|(state, &frame)| {
            vertices.iter().map(move |&vertex| {
                let [[x_mm, y_mm, z_mm]] = state.position_mm[vertex].data.0;
                BaseMotionRow { frame, time_s: state.time_s, vertex, x_mm, y_mm, z_mm }
            })
        })
        .collect();
    Ok(write_csv(&folder.join("base_motion.csv"), &rows)?)
}
