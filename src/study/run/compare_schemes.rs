//! `kind = "compare_schemes"`: a synthetic heart tracked without image forces and by each force scheme, over time steps and gains, \[Billet2009\] §6.1.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

use super::error::RunError;
use super::forward::heart_model;
use super::gains::scaled_gains;
use super::page::{Account, leave_page, table_section};
use super::patient::{Patient, PatientImages};
use super::synthetic::Truth;
use super::track::tracker_settings;
use crate::heart::{FrameState, HeartState, Parameter};
use crate::mesh::SurfaceTag;
use crate::numerics::root_mean_square;
use crate::report::figures::{Curve, Look, Sweep, SweepCell, TimeCurves, sweep, time_curves};
use crate::report::html::{Block, Plot, Section, Table};
use crate::report::{write_csv, write_json};
use crate::study::plan::ModelPlan;
use crate::study::{Kind, Outcome, Plan, Provenance, RunContext, Status};
use crate::tracking::{ForceScheme, TrackedMotion, TrackerSettings, track};
use crate::units::MS_PER_S;

/// One way to track the beat.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Case {
    scheme: Scheme,
    step_s: f64,
    gain_factor: f64,
}

/// A force scheme, or none for the heart without image forces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
enum Scheme {
    #[serde(serialize_with = "as_none")]
    Without,
    With(ForceScheme),
}

fn as_none<S: serde::Serializer>(serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str("none")
}

const SCHEMES: [Scheme; 5] = [
    Scheme::Without,
    Scheme::With(ForceScheme::Explicit),
    Scheme::With(ForceScheme::Published),
    Scheme::With(ForceScheme::Exact),
    Scheme::With(ForceScheme::Variational),
];

impl Scheme {
    fn name(self) -> &'static str {
        match self {
            Self::Without => "without image forces",
            Self::With(ForceScheme::Explicit) => "explicit",
            Self::With(ForceScheme::Published) => "implicit, published",
            Self::With(ForceScheme::Exact) => "implicit, exact",
            Self::With(ForceScheme::Variational) => "implicit, variational",
        }
    }

    fn look(self) -> Look {
        match self {
            Self::Without => Look::Initial,
            Self::With(ForceScheme::Explicit) => Look::Simulated,
            Self::With(ForceScheme::Published) => Look::Other,
            Self::With(ForceScheme::Exact) => Look::Truth,
            Self::With(ForceScheme::Variational) => Look::Tracked,
        }
    }
}

/// A row of `cases.csv`.
#[derive(Debug, Clone, Serialize)]
struct CaseRow {
    scheme: Scheme,
    step_s: f64,
    gain_factor: f64,
    /// `finished`; `broke` where the mesh turned inside out or a step failed; `stopped`.
    status: &'static str,
    /// Time since the start of the beat, s.
    broke_after_s: Option<f64>,
    /// Mean over the images of the root mean square distance of all vertices from the truth, mm.
    rmse_mean_mm: Option<f64>,
    /// Largest over the images, mm.
    rmse_greatest_mm: Option<f64>,
    /// Root mean square difference of the volume of the left ventricle from the truth, mL.
    volume_rms_lv_ml: Option<f64>,
    /// The same of the right ventricle, where there is one.
    volume_rms_rv_ml: Option<f64>,
    /// Root mean square acceleration of the endocardia over all steps, mm/s²: what oscillates shows here.
    endocardium_acceleration_rms_mm_per_s2: Option<f64>,
    /// The same of the right ventricle's endocardium alone, where there is one.
    endocardium_rv_acceleration_rms_mm_per_s2: Option<f64>,
    /// Why it broke.
    reason: String,
}

/// A row of `rmse.csv`: one scheme at one image, with the step and gains as written.
#[derive(Debug, Clone, Serialize)]
struct FrameRow {
    scheme: Scheme,
    frame: usize,
    time_s: f64,
    rmse_mm: f64,
    volume_lv_ml: Option<f64>,
    volume_truth_lv_ml: Option<f64>,
    volume_rv_ml: Option<f64>,
    volume_truth_rv_ml: Option<f64>,
}

/// A row of `speed.csv`: one scheme after one step, with the step and gains as written.
#[derive(Debug, Clone, Serialize)]
struct SpeedRow {
    scheme: Scheme,
    time_s: f64,
    endocardium_speed_rms_mm_per_s: f64,
    endocardium_rv_speed_rms_mm_per_s: Option<f64>,
}

/// What became of a case.
struct Tried {
    row: CaseRow,
    frames: Vec<FrameRow>,
    speeds: Vec<SpeedRow>,
}

#[derive(Serialize)]
struct Summary<'a> {
    kind: Kind,
    status: Status,
    /// The cases with the step and gains as written.
    schemes: Vec<CaseRow>,
    /// Mean RMSE of the variational scheme below that of the explicit one, relative.
    gain_of_implicit_over_explicit: Option<f64>,
    warnings: &'a [String],
    wall_time_s: f64,
    provenance: &'a Provenance,
}

/// Tracks the phantom in every case of the plan and leaves a table of them.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let patient = Patient::new(plan, context)?;
    let (Some(images), Some(truth)) = (&patient.images, &patient.truth) else { return Err(RunError::NothingToFit) };
    let cases = cases(plan);
    context.progress().stage("tracking in every case", Some(cases.len() as u64));
    let done = AtomicU64::new(0);
    let attempt = |case: &Case| {
        let tried = attempt(plan, &patient, images, truth, *case, context);
        context.progress().step(done.fetch_add(1, Ordering::Relaxed) + 1);
        tried
    };
    let tried = cases.par_iter().map(attempt).collect::<Result<Vec<_>, _>>()?;

    context.progress().stage("writing results", None);
    let folder = &plan.output.directory;
    let as_written = &tried[..SCHEMES.len()];
    write_csv(&folder.join("cases.csv"), &tried.iter().map(|one| &one.row).collect::<Vec<_>>())?;
    write_csv(&folder.join("rmse.csv"), &as_written.iter().flat_map(|one| &one.frames).collect::<Vec<_>>())?;
    write_csv(&folder.join("speed.csv"), &as_written.iter().flat_map(|one| &one.speeds).collect::<Vec<_>>())?;
    let figures = figures(as_written);
    if plan.output.figures {
        figures.iter().try_for_each(|(file, figure)| time_curves(&folder.join(file), figure))?;
        sweep(&folder.join("sweep.png"), &sweep_figure(&tried, &patient))?;
    }
    let schemes: Vec<CaseRow> = as_written.iter().map(|one| one.row.clone()).collect();
    let status = if context.is_stopped() { Status::Stopped } else { Status::Converged };
    let headlines: Vec<String> = schemes.iter().map(headline).collect();
    let summary = Summary {
        kind: plan.kind,
        status,
        gain_of_implicit_over_explicit: schemes[4].rmse_mean_mm.zip(schemes[1].rmse_mean_mm).map(|(ours, theirs)| 1.0 - ours / theirs),
        schemes,
        warnings: &patient.warnings,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&folder.join("summary.json"), &summary)?;
    let account = Account { status, headlines: &headlines, warnings: summary.warnings, key_figures: Vec::new(), record: &summary };
    leave_report(plan, &tried, &figures, account)?;
    context.progress().finish();
    Ok(Outcome { status, directory: folder.clone(), headlines })
}

/// The five schemes as the study writes step and gains, then every scheme at every step and gain of the comparison; without image
/// forces the gain makes no difference.
fn cases(plan: &Plan) -> Vec<Case> {
    let written = SCHEMES.map(|scheme| Case { scheme, step_s: plan.model.step_s, gain_factor: 1.0 });
    let mut cases = written.to_vec();
    for &step_s in plan.comparison.iter().flat_map(|comparison| &comparison.steps_s) {
        cases.push(Case { scheme: Scheme::Without, step_s, gain_factor: 1.0 });
        for &gain_factor in plan.comparison.iter().flat_map(|comparison| &comparison.gain_factors) {
            cases.extend(SCHEMES[1..].iter().map(|&scheme| Case { scheme, step_s, gain_factor }));
        }
    }
    cases
}

/// Tracks one case. To break is an outcome, not an error.
fn attempt(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    truth: &Truth,
    case: Case,
    context: &RunContext,
) -> Result<Tried, RunError> {
    let model_plan = ModelPlan { step_s: case.step_s, ..plan.model.clone() };
    let factor = if case.scheme == Scheme::Without { 0.0 } else { case.gain_factor };
    let model = heart_model(&model_plan, &patient.anatomy, scaled_gains(&patient.parameters, factor)?)?;
    let scheme = if let Scheme::With(scheme) = case.scheme { scheme } else { ForceScheme::default() };
    let settings = TrackerSettings { scheme, ..tracker_settings(plan, patient, images)? };
    let mut watch = Watch::new(patient, case);
    let motion = track(&model, &images.cine, &settings, &mut |state, _| {
        let is_whole = watch.see(state, patient);
        if is_whole && !context.is_stopped() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    let mut row = CaseRow {
        scheme: case.scheme,
        step_s: case.step_s,
        gain_factor: case.gain_factor,
        status: "finished",
        broke_after_s: None,
        rmse_mean_mm: None,
        rmse_greatest_mm: None,
        volume_rms_lv_ml: None,
        volume_rms_rv_ml: None,
        endocardium_acceleration_rms_mm_per_s2: None,
        endocardium_rv_acceleration_rms_mm_per_s2: None,
        reason: String::new(),
    };
    let reason = match &motion {
        Err(error) => Some(error.to_string()),
        Ok(_) if watch.is_inside_out => Some("the mesh turned inside out".into()),
        Ok(_) => None,
    };
    let frames = match motion {
        Ok(motion) if reason.is_none() => compare(&motion, truth, case.scheme),
        _ => Vec::new(),
    };
    if let Some(reason) = reason {
        (row.status, row.reason, row.broke_after_s) = ("broke", reason, Some(watch.last_s - watch.start_s));
    } else if context.is_stopped() {
        row.status = "stopped";
    } else {
        // The first image is where every case starts.
        let rmse_mm: Vec<f64> = frames.iter().skip(1).map(|frame| frame.rmse_mm).collect();
        let left_ml: Vec<f64> = frames.iter().filter_map(|f| Some(f.volume_lv_ml? - f.volume_truth_lv_ml?)).collect();
        let right_ml: Vec<f64> = frames.iter().filter_map(|f| Some(f.volume_rv_ml? - f.volume_truth_rv_ml?)).collect();
        row.rmse_mean_mm = Some(rmse_mm.iter().sum::<f64>() / rmse_mm.len().max(1) as f64);
        row.rmse_greatest_mm = rmse_mm.iter().copied().max_by(f64::total_cmp);
        row.volume_rms_lv_ml = Some(root_mean_square(&left_ml));
        row.volume_rms_rv_ml = (!right_ml.is_empty()).then(|| root_mean_square(&right_ml));
        let [all, right] = &watch.accelerations_mm_per_s2;
        row.endocardium_acceleration_rms_mm_per_s2 = Some(root_mean_square(all));
        row.endocardium_rv_acceleration_rms_mm_per_s2 = (!right.is_empty()).then(|| root_mean_square(right));
    }
    Ok(Tried { row, frames, speeds: watch.speeds })
}

/// Every image of a tracked beat against the truth.
fn compare(motion: &TrackedMotion, truth: &Truth, scheme: Scheme) -> Vec<FrameRow> {
    let row = |((seen, state), true_state): ((&crate::tracking::TrackedFrame, &FrameState), &FrameState)| FrameRow {
        scheme,
        frame: seen.frame,
        time_s: state.time_s,
        rmse_mm: rmse_mm(state, true_state),
        volume_lv_ml: state.volume_ml.first().copied(),
        volume_truth_lv_ml: true_state.volume_ml.first().copied(),
        volume_rv_ml: state.volume_ml.get(1).copied(),
        volume_truth_rv_ml: true_state.volume_ml.get(1).copied(),
    };
    motion.frames.iter().zip(&motion.trajectory.frames).zip(&truth.frames).map(row).collect()
}

fn rmse_mm(state: &FrameState, truth: &FrameState) -> f64 {
    let distances: Vec<f64> = state.position_mm.iter().zip(&truth.position_mm).map(|(found, real)| (found - real).norm()).collect();
    root_mean_square(&distances)
}

/// Sees every step of a case: whether the mesh is whole, and how fast the endocardia move.
struct Watch {
    scheme: Scheme,
    /// Vertices of the endocardia, the left one's first, and where the right one's begin.
    endocardium: Vec<usize>,
    left_count: usize,
    start_s: f64,
    last_s: f64,
    velocity_mm_per_s: Vec<nalgebra::Vector3<f64>>,
    speeds: Vec<SpeedRow>,
    /// Of both endocardia, and of the right one.
    accelerations_mm_per_s2: [Vec<f64>; 2],
    is_inside_out: bool,
}

/// A mesh is inside out when this part of its tetrahedra is.
const INSIDE_OUT_SHARE: f64 = 0.05;

impl Watch {
    fn new(patient: &Patient, case: Case) -> Self {
        let surface = &patient.anatomy.surface;
        let [left, right] = [SurfaceTag::EndocardiumLv, SurfaceTag::EndocardiumRv].map(|tag| surface.vertices_with(tag));
        Self {
            scheme: case.scheme,
            left_count: left.len(),
            endocardium: [left, right].concat(),
            start_s: f64::NAN,
            last_s: f64::NAN,
            velocity_mm_per_s: Vec::new(),
            speeds: Vec::new(),
            accelerations_mm_per_s2: [Vec::new(), Vec::new()],
            is_inside_out: false,
        }
    }

    /// Whether the mesh is still whole.
    fn see(&mut self, state: &HeartState, patient: &Patient) -> bool {
        if self.start_s.is_nan() {
            self.start_s = state.time_s;
        }
        let velocity: Vec<_> = self.endocardium.iter().map(|&vertex| state.motion.velocity_mm_per_s[vertex]).collect();
        if state.time_s > self.last_s {
            let changes = velocity.iter().zip(&self.velocity_mm_per_s).map(|(now, before)| (now - before).norm());
            let accelerations: Vec<f64> = changes.map(|change| change / (state.time_s - self.last_s)).collect();
            let of_right = accelerations.get(self.left_count..).filter(|right| !right.is_empty());
            self.accelerations_mm_per_s2[1].extend(of_right.map(root_mean_square));
            self.accelerations_mm_per_s2[0].push(root_mean_square(&accelerations));
        }
        let speeds: Vec<f64> = velocity.iter().map(|v| v.norm()).collect();
        let right = &speeds[self.left_count..];
        self.speeds.push(SpeedRow {
            scheme: self.scheme,
            time_s: state.time_s,
            endocardium_speed_rms_mm_per_s: root_mean_square(&speeds),
            endocardium_rv_speed_rms_mm_per_s: (!right.is_empty()).then(|| root_mean_square(right)),
        });
        (self.velocity_mm_per_s, self.last_s) = (velocity, state.time_s);
        let position_mm = &state.motion.position_mm;
        let is_inverted = |[a, b, c, d]: &&[usize; 4]| {
            let edge = |vertex: usize| position_mm[vertex] - position_mm[*a];
            edge(*b).cross(&edge(*c)).dot(&edge(*d)) <= 0.0
        };
        let tetrahedra = patient.anatomy.mesh.tetrahedra();
        self.is_inside_out = tetrahedra.iter().filter(is_inverted).count() as f64 > INSIDE_OUT_SHARE * tetrahedra.len() as f64;
        !self.is_inside_out
    }
}

/// What there is to draw, with the names of the files: distances from the truth, speeds of the endocardia.
fn figures(as_written: &[Tried]) -> Vec<(&'static str, TimeCurves)> {
    let curves = |points: fn(&Tried) -> Vec<(f64, f64)>| {
        let of = |one: &Tried| Curve { name: one.row.scheme.name().into(), look: one.row.scheme.look(), points: points(one) };
        as_written.iter().map(of).filter(|curve| !curve.points.is_empty()).collect::<Vec<_>>()
    };
    let speeds = |of: &str| format!("Speed of the tracked endocardium{of}");
    let figures = [
        (
            "rmse.png",
            "Distance of the tracked heart from the truth".into(),
            "RMSE of all vertices (mm)",
            curves(|one| one.frames.iter().map(|frame| (frame.time_s, frame.rmse_mm)).collect()),
        ),
        (
            "speed.png",
            speeds(""),
            "RMS speed (mm/s)",
            curves(|one| one.speeds.iter().map(|row| (row.time_s, row.endocardium_speed_rms_mm_per_s)).collect()),
        ),
        (
            "speed_rv.png",
            speeds(" of the right ventricle"),
            "RMS speed (mm/s)",
            curves(|one| one.speeds.iter().filter_map(|row| Some((row.time_s, row.endocardium_rv_speed_rms_mm_per_s?))).collect()),
        ),
    ];
    let figures = figures.into_iter().filter(|(file, .., curves)| *file != "speed_rv.png" || !curves.is_empty());
    figures.map(|(file, title, quantity, curves)| (file, TimeCurves { title, quantity: quantity.into(), curves })).collect()
}

/// Every scheme over steps and gains: how near it comes, or when it breaks.
fn sweep_figure(tried: &[Tried], patient: &Patient) -> Sweep {
    let sorted = |value: fn(&CaseRow) -> f64| {
        let mut values: Vec<f64> = tried.iter().filter(|one| one.row.scheme != Scheme::Without).map(|one| value(&one.row)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    };
    let (steps_s, factors) = (sorted(|row| row.step_s), sorted(|row| row.gain_factor));
    let cell = |scheme: Scheme, gain_factor: f64, step_s: f64| {
        let found = tried.iter().map(|one| &one.row).find(|row| (row.scheme, row.gain_factor, row.step_s) == (scheme, gain_factor, step_s));
        match found.map(|row| (row.rmse_mean_mm, row.broke_after_s)) {
            Some((Some(rmse_mm), _)) => SweepCell::Result(rmse_mm),
            Some((None, Some(after_s))) => SweepCell::BrokeAfterMs(after_s * MS_PER_S),
            _ => SweepCell::Untried,
        }
    };
    let cells = |scheme| {
        factors.iter().flat_map(|&factor| steps_s.iter().map(move |&step_s| (factor, step_s))).map(move |(f, s)| cell(scheme, f, s))
    };
    let gain_kpa_per_mm = patient.parameters[Parameter::ImageGainEndocardiumLv];
    Sweep {
        title: "Mean distance from the truth (mm) over steps and gains".into(),
        column_quantity: "step (ms)".into(),
        row_quantity: "gain (kPa/mm)".into(),
        columns: steps_s.iter().map(|step_s| format!("{}", (step_s * MS_PER_S * 1e3).round() / 1e3)).collect(),
        rows: factors.iter().map(|factor| format!("{}", (factor * gain_kpa_per_mm * 1e3).round() / 1e3)).collect(),
        grids: SCHEMES[1..].iter().map(|&scheme| (scheme.name().to_string(), cells(scheme).collect())).collect(),
    }
}

fn leave_report(plan: &Plan, tried: &[Tried], figures: &[(&str, TimeCurves)], account: Account<Summary>) -> Result<(), RunError> {
    let plots = figures.iter().map(|(_, figure)| Block::Plot(Plot::from(figure))).collect();
    let cases: Vec<&CaseRow> = tried.iter().map(|one| &one.row).collect();
    let as_written = Table::of_rows("The schemes at the step and gains as written", &account.record.schemes);
    let sections = vec![
        Section { title: "The schemes side by side".into(), blocks: vec![Block::Beside(plots), Block::Table(as_written)] },
        table_section("Every step and gain", "All cases", &cases),
    ];
    leave_page(plan, account, sections, Vec::new())
}

fn headline(row: &CaseRow) -> String {
    match (row.rmse_mean_mm, row.broke_after_s) {
        (Some(rmse_mm), _) => format!("{}: RMSE {rmse_mm:.2} mm on average", row.scheme.name()),
        (None, Some(broke_after_s)) => format!("{}: broke after {broke_after_s:.3} s ({})", row.scheme.name(), row.reason),
        (None, None) => format!("{}: {}", row.scheme.name(), row.status),
    }
}
