//! `kind = "compare_bases"`: the same images tracked with a free base, with springs and with block matching, \[Billet2009\] §6.2.

use std::time::Instant;

use nalgebra::Vector3;
use serde::Serialize;

use super::clock::Clock;
use super::discrepancy::work_magnitude_mj;
use super::error::RunError;
use super::forward::frame_volumes_lv_ml;
use super::montages::{ImageScene, NamedMotion, every_frame, montages};
use super::page::{Account, Frames, leave_page, table_section};
use super::patient::{Patient, PatientImages};
use super::track::{Tracked, surface_rms_mm, track_patient, validate};
use super::track_only;
use crate::mesh::SurfaceTag;
use crate::numerics::root_mean_square;
use crate::report::figures::{Curve, Look, TimeCurves, VolumeCurves, time_curves, volume_curves};
use crate::report::html::{Block, Plot, Section, Slices, Table};
use crate::report::{create_folder, write_csv, write_json};
use crate::study::plan::{BaseMode, OutputPlan, TrackingPlan};
use crate::study::volumes::measured_curve;
use crate::study::{Kind, Outcome, Plan, Provenance, RunContext, Status};
use crate::tracking::{BaseProjection, CavityAgreement};

/// One way to hold the base.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Mode {
    /// Its folder.
    key: &'static str,
    name: &'static str,
    look: Look,
    base: BaseMode,
    projection: BaseProjection,
}

const MODES: [Mode; 4] = [
    Mode { key: "free", name: "free base", look: Look::Initial, base: BaseMode::Free, projection: BaseProjection::Full },
    Mode { key: "springs", name: "springs", look: Look::Simulated, base: BaseMode::Springs, projection: BaseProjection::Full },
    Mode {
        key: "block_matching_normal",
        name: "block matching, normal",
        look: Look::Other,
        base: BaseMode::BlockMatching,
        projection: BaseProjection::Normal,
    },
    Mode {
        key: "block_matching_full",
        name: "block matching, full",
        look: Look::Tracked,
        base: BaseMode::BlockMatching,
        projection: BaseProjection::Full,
    },
];

/// A row of `modes.csv`.
#[derive(Debug, Clone, Serialize)]
struct ModeRow {
    mode: &'static str,
    /// `finished`, or `failed` with its reason.
    status: &'static str,
    end_diastolic_volume_lv_ml: Option<f64>,
    end_systolic_volume_lv_ml: Option<f64>,
    ejection_fraction_lv: Option<f64>,
    /// Root mean square difference from the volumes of the contours over the frames.
    volume_rms_lv_ml: Option<f64>,
    /// Mean over the labelled frames.
    dice: Option<f64>,
    /// Mean over the labelled frames.
    mean_distance_mm: Option<f64>,
    /// How far the base comes towards the apex, mean of its vertices, at most.
    base_descent_greatest_mm: Option<f64>,
    boundary_rms_endocardium_lv_mm: Option<f64>,
    boundary_rms_epicardium_mm: Option<f64>,
    /// Magnitudes added up over the beat.
    image_work_mj: Option<f64>,
    wall_time_s: f64,
    reason: String,
}

/// A row of `volumes.csv`: a mode in a frame.
#[derive(Debug, Clone, Serialize)]
struct VolumeRow {
    mode: &'static str,
    frame: usize,
    time_s: f64,
    volume_lv_ml: f64,
    volume_contours_lv_ml: f64,
    base_descent_mm: f64,
}

/// A row of `agreement.csv`: a mode against the labels of a frame.
#[derive(Debug, Clone, Serialize)]
struct AgreementRow {
    mode: &'static str,
    frame: usize,
    time_s: f64,
    dice: f64,
    mean_distance_mm: Option<f64>,
    volume_ml: f64,
    volume_labels_ml: f64,
}

#[derive(Serialize)]
struct Summary<'a> {
    kind: Kind,
    status: Status,
    volume_contours_end_diastolic_ml: f64,
    volume_contours_end_systolic_ml: f64,
    modes: &'a [ModeRow],
    warnings: &'a [String],
    wall_time_s: f64,
    provenance: &'a Provenance,
}

/// What came of a mode.
struct Tried {
    mode: Mode,
    row: ModeRow,
    tracked: Option<Tracked>,
    volumes: Vec<VolumeRow>,
    agreement: Vec<AgreementRow>,
}

/// Tracks the images with every base; each leaves the files of a tracked beat in a folder of its own, and all together their comparison.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let patient = Patient::new(plan, context)?;
    let Some(images) = &patient.images else { return Err(RunError::NothingToFit) };
    let clock = patient.clock(1);
    let contours_ml = contour_volumes_ml(plan, &patient, &clock)?;
    let mut tried = Vec::with_capacity(MODES.len());
    for mode in MODES {
        tried.push(attempt(plan, &patient, images, &contours_ml, mode, context)?);
    }

    context.progress().stage("writing results", None);
    let folder = &plan.output.directory;
    let modes: Vec<ModeRow> = tried.iter().map(|one| one.row.clone()).collect();
    write_csv(&folder.join("modes.csv"), &modes)?;
    write_csv(&folder.join("volumes.csv"), &tried.iter().flat_map(|one| &one.volumes).collect::<Vec<_>>())?;
    let no_motion = tried.iter().find_map(|one| one.tracked.as_ref()).map(|tracked| no_motion(&patient, images, tracked, &clock));
    let agreement: Vec<_> = no_motion.iter().flatten().chain(tried.iter().flat_map(|one| &one.agreement)).collect();
    write_csv(&folder.join("agreement.csv"), &agreement)?;
    let motions = motions(plan, &tried);
    let scene = ImageScene { plan, patient: &patient, images, clock: &clock, motions: &motions };
    if plan.output.figures {
        draw(&scene, &contours_ml, &tried)?;
    }
    let extreme = |pick: fn(f64, f64) -> f64, from: f64| contours_ml.iter().copied().fold(from, pick);
    let status = Status::Converged;
    let summary = Summary {
        kind: plan.kind,
        status,
        volume_contours_end_diastolic_ml: extreme(f64::max, f64::NEG_INFINITY),
        volume_contours_end_systolic_ml: extreme(f64::min, f64::INFINITY),
        modes: &modes,
        warnings: &patient.warnings,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&folder.join("summary.json"), &summary)?;
    let still = no_motion.as_deref().and_then(means).map(|(dice, mm)| format!("no motion: Dice {dice:.3}, mean distance {mm:.2} mm"));
    let headlines: Vec<String> = modes.iter().map(headline).chain(still).collect();
    let account = Account { status, headlines: &headlines, warnings: summary.warnings, key_figures: Vec::new(), record: &summary };
    leave_report(&scene, &contours_ml, &tried, &agreement, account)?;
    context.progress().finish();
    Ok(Outcome { status, directory: folder.clone(), headlines })
}

/// The measured volumes at the frames of a clock, mL; of a phantom its true ones.
fn contour_volumes_ml(plan: &Plan, patient: &Patient, clock: &Clock) -> Result<Vec<f64>, RunError> {
    if let Some(truth) = &patient.truth {
        return Ok(truth.volumes_lv_ml.clone());
    }
    let measured = measured_curve(plan)?;
    Ok(clock.frames.iter().map(|&frame| measured.volumes_ml().get(frame).copied().unwrap_or(f64::NAN)).collect())
}

/// Tracks with one base. A heart that cannot be tracked so is an outcome, not an error.
fn attempt(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    contours_ml: &[f64],
    mode: Mode,
    context: &RunContext,
) -> Result<Tried, RunError> {
    let started = Instant::now();
    context.progress().stage(mode.name, None);
    let tracking = TrackingPlan { base: mode.base, base_projection: mode.projection, ..plan.tracking.clone() };
    let output = OutputPlan { directory: plan.output.directory.join(mode.key), figures: false, ..plan.output.clone() };
    let plan = Plan { tracking, output, ..plan.clone() };
    create_folder(&plan.output.directory)?;
    let tracked = match track_patient(&plan, patient, images, patient.parameters.clone(), context).and_then(Tracked::whole) {
        Ok(tracked) => tracked,
        Err(RunError::Stopped) => return Err(RunError::Stopped),
        Err(error) => {
            let row = failed_row(mode, &error, started.elapsed().as_secs_f64());
            return Ok(Tried { mode, row, tracked: None, volumes: Vec::new(), agreement: Vec::new() });
        }
    };
    track_only::leave(&plan, patient, images, &tracked, started)?;
    let clock = patient.clock(1);
    let volumes = volume_rows(mode.key, patient, &clock, &tracked, contours_ml);
    let validations = validate(patient, images, &tracked.motion);
    let agreement: Vec<_> = validations.iter().map(|one| agreement_row(mode.key, &clock, one.frame, &one.tracked)).collect();
    let row = finished_row(mode, &tracked, &volumes, &agreement, started.elapsed().as_secs_f64());
    Ok(Tried { mode, row, tracked: Some(tracked), volumes, agreement })
}

fn failed_row(mode: Mode, error: &RunError, wall_time_s: f64) -> ModeRow {
    ModeRow {
        mode: mode.key,
        status: "failed",
        end_diastolic_volume_lv_ml: None,
        end_systolic_volume_lv_ml: None,
        ejection_fraction_lv: None,
        volume_rms_lv_ml: None,
        dice: None,
        mean_distance_mm: None,
        base_descent_greatest_mm: None,
        boundary_rms_endocardium_lv_mm: None,
        boundary_rms_epicardium_mm: None,
        image_work_mj: None,
        wall_time_s,
        reason: error.to_string(),
    }
}

fn finished_row(mode: Mode, tracked: &Tracked, volumes: &[VolumeRow], agreement: &[AgreementRow], wall_time_s: f64) -> ModeRow {
    let motion = &tracked.motion;
    let volumes_ml = frame_volumes_lv_ml(&motion.trajectory);
    let largest_ml = volumes_ml.iter().copied().max_by(f64::total_cmp);
    let smallest_ml = volumes_ml.iter().copied().min_by(f64::total_cmp);
    let means = means(agreement);
    let differences: Vec<f64> = volumes.iter().map(|row| row.volume_lv_ml - row.volume_contours_lv_ml).collect();
    ModeRow {
        mode: mode.key,
        status: "finished",
        end_diastolic_volume_lv_ml: largest_ml,
        end_systolic_volume_lv_ml: smallest_ml,
        ejection_fraction_lv: largest_ml.zip(smallest_ml).map(|(large, small)| 1.0 - small / large),
        volume_rms_lv_ml: Some(root_mean_square(&differences)),
        dice: means.map(|(dice, _)| dice),
        mean_distance_mm: means.map(|(_, mm)| mm),
        base_descent_greatest_mm: volumes.iter().map(|row| row.base_descent_mm).max_by(f64::total_cmp),
        boundary_rms_endocardium_lv_mm: surface_rms_mm(motion, SurfaceTag::EndocardiumLv),
        boundary_rms_epicardium_mm: surface_rms_mm(motion, SurfaceTag::Epicardium),
        image_work_mj: Some(work_magnitude_mj(motion)),
        wall_time_s,
        reason: String::new(),
    }
}

fn volume_rows(mode: &'static str, patient: &Patient, clock: &Clock, tracked: &Tracked, contours_ml: &[f64]) -> Vec<VolumeRow> {
    let anatomy = &patient.anatomy;
    let base = anatomy.surface.vertices_with(SurfaceTag::Base);
    let rest_mm = anatomy.mesh.vertices_mm();
    let descent_mm = |position_mm: &[Vector3<f64>]| {
        let descents = base.iter().map(|&vertex| (rest_mm[vertex] - position_mm[vertex]).dot(&anatomy.axes.long_axis));
        descents.sum::<f64>() / base.len().max(1) as f64
    };
    let frames = tracked.motion.trajectory.frames.iter().zip(&clock.frames).zip(contours_ml);
    let row = |((state, &frame), &volume_contours_lv_ml): ((&crate::heart::FrameState, &usize), &f64)| VolumeRow {
        mode,
        frame,
        time_s: state.time_s,
        volume_lv_ml: state.volume_ml.first().copied().unwrap_or(f64::NAN),
        volume_contours_lv_ml,
        base_descent_mm: descent_mm(&state.position_mm),
    };
    frames.map(row).collect()
}

fn agreement_row(mode: &'static str, clock: &Clock, frame: usize, agreement: &CavityAgreement) -> AgreementRow {
    AgreementRow {
        mode,
        frame,
        time_s: clock.position_of(frame).map_or(f64::NAN, |place| clock.times_s[place]),
        dice: agreement.dice,
        mean_distance_mm: agreement.mean_distance_mm,
        volume_ml: agreement.mesh_volume_ml,
        volume_labels_ml: agreement.label_volume_ml,
    }
}

/// The mesh at rest against the labels.
fn no_motion(patient: &Patient, images: &PatientImages, tracked: &Tracked, clock: &Clock) -> Vec<AgreementRow> {
    let validations = validate(patient, images, &tracked.motion);
    validations.iter().map(|one| agreement_row("no_motion", clock, one.frame, &one.no_motion)).collect()
}

/// Mean Dice coefficient and mean distance (mm) over the labelled frames.
fn means(rows: &[AgreementRow]) -> Option<(f64, f64)> {
    let distances: Vec<f64> = rows.iter().filter_map(|row| row.mean_distance_mm).collect();
    let mean = |values: &mut dyn Iterator<Item = f64>, count: usize| values.sum::<f64>() / count as f64;
    (!distances.is_empty())
        .then(|| (mean(&mut rows.iter().map(|row| row.dice), rows.len()), mean(&mut distances.iter().copied(), distances.len())))
}

/// Those that came to an end.
fn finished(tried: &[Tried]) -> impl Iterator<Item = &Tried> {
    tried.iter().filter(|one| one.tracked.is_some())
}

fn curves(tried: &[Tried], value: fn(&VolumeRow) -> f64) -> Vec<Curve> {
    let curve = |one: &Tried| Curve {
        name: one.mode.name.into(),
        look: one.mode.look,
        points: one.volumes.iter().map(|row| (row.time_s, value(row))).collect(),
    };
    finished(tried).map(curve).collect()
}

fn volume_figure(clock: &Clock, contours_ml: &[f64], tried: &[Tried]) -> VolumeCurves {
    let mut curves = curves(tried, |row| row.volume_lv_ml);
    curves.push(Curve::new("contours", Look::Measured, &clock.times_s, contours_ml));
    VolumeCurves { title: "LV volume with each base".into(), quantity: "LV volume".into(), curves }
}

fn base_figure(tried: &[Tried]) -> TimeCurves {
    let curves = curves(tried, |row| row.base_descent_mm);
    TimeCurves { title: "Way of the base towards the apex".into(), quantity: "base descent (mm)".into(), curves }
}

/// The motions that are shown: of block matching the one of the study's projection.
fn motions<'a>(plan: &Plan, tried: &'a [Tried]) -> Vec<NamedMotion<'a>> {
    let is_shown = |one: &&Tried| one.mode.base != BaseMode::BlockMatching || one.mode.projection == plan.tracking.base_projection;
    let shown = finished(tried).filter(is_shown);
    shown.filter_map(|one| Some(NamedMotion { name: one.mode.name, frames: &one.tracked.as_ref()?.motion.trajectory.frames })).collect()
}

fn draw(scene: &ImageScene, contours_ml: &[f64], tried: &[Tried]) -> Result<(), RunError> {
    let folder = &scene.plan.output.directory;
    volume_curves(&folder.join("volume_lv.png"), &volume_figure(scene.clock, contours_ml, tried))?;
    time_curves(&folder.join("base.png"), &base_figure(tried))?;
    montages(scene)
}

fn leave_report(
    scene: &ImageScene,
    contours_ml: &[f64],
    tried: &[Tried],
    agreement: &[&AgreementRow],
    account: Account<Summary>,
) -> Result<(), RunError> {
    let volumes = Block::Plot(Plot::from(&volume_figure(scene.clock, contours_ml, tried)));
    let base = Block::Plot(Plot::from(&base_figure(tried)));
    let compared = Section {
        title: "The bases side by side".into(),
        blocks: vec![Block::Beside(vec![volumes, base]), Block::Table(Table::of_rows("Every base", account.record.modes))],
    };
    let mut sections = vec![compared];
    let mut times_s = Vec::new();
    if let Some(motion) = scene.motions.first() {
        let frames = Frames::of(scene.clock, motion.frames);
        let montage = every_frame(scene, &frames.places)?;
        sections.push(Section { title: "Through the beat".into(), blocks: vec![Block::Slices(Slices(montage))] });
        times_s = frames.times_s;
    }
    sections.push(table_section("Against the labels", "Every labelled frame", agreement));
    leave_page(scene.plan, account, sections, times_s)
}

fn headline(row: &ModeRow) -> String {
    let (Some(volume_ml), Some(descent_mm)) = (row.volume_rms_lv_ml, row.base_descent_greatest_mm) else {
        return format!("{}: failed ({})", row.mode, row.reason);
    };
    let agreement = row.dice.zip(row.mean_distance_mm);
    let judged = agreement.map_or(String::new(), |(dice, mm)| format!(", Dice {dice:.3}, mean distance {mm:.2} mm"));
    format!("{}: volume {volume_ml:.1} mL RMS from the contours{judged}, base descends {descent_mm:.1} mm", row.mode)
}
