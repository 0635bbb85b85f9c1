//! The tracker: one beat of the heart model under the loads of the images, from the frame that the mesh was drawn on, \[Billet2009\] §4–§6.

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::carried_blocks::{BasePlane, CarriedBlocks, Carrier, WallAtRest, wall_intensities};
use super::proactive_blocks::{Drawn, ProactiveBlocks};
use super::residuals::{TrackedFrame, frame_warnings};
use super::tissue_mask::TissueMask;
use super::{
    AppearanceSettings, BaseForce, BaseMatches, BaseMode, BaseProjection, BlockMatchingSettings, BlockShape, BoundarySearch,
    BoundarySettings, ForceScheme, ImageForce, ImageInstant, SurfaceAppearance, SurfaceGain, TrackingError, WallSettings, match_base,
};
use crate::circulation::Phase;
use crate::heart::{CurveRow, HeartModel, HeartState, Parameter, SimulationPlan, Trajectory, simulate};
use crate::image::CineSequence;
use crate::mechanics::StepLoad;
use crate::mesh::SurfaceTag;

/// How a heart is tracked. The gains are parameters of the model (`image_gain_…_kpa_per_mm`).
#[derive(Debug, Clone, PartialEq)]
pub struct TrackerSettings {
    /// Frame of the cine sequence on which the mesh was drawn, 0-based; tracking starts there and goes through one period.
    pub reference_frame: usize,
    /// How image forces enter the step.
    pub scheme: ForceScheme,
    /// How the surfaces' appearance is learnt.
    pub appearance: AppearanceSettings,
    /// How boundary points are searched.
    pub boundary: BoundarySettings,
    /// How the base is held.
    pub base: BaseMode,
    /// Which part of the way to a matched block is pulled.
    pub base_projection: BaseProjection,
    /// How block matches draw the inside of the wall, where they do.
    pub wall: Option<WallSettings>,
    /// Share of the surface vertices that get no force, so that their residuals can judge the gains.
    pub held_out_share: f64,
    /// Seed of the choice of held-out vertices.
    pub held_out_seed: u64,
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self {
            reference_frame: 0,
            scheme: ForceScheme::default(),
            appearance: AppearanceSettings::default(),
            boundary: BoundarySettings::default(),
            base: BaseMode::Springs,
            base_projection: BaseProjection::default(),
            wall: None,
            held_out_share: 0.0,
            held_out_seed: 1,
        }
    }
}

/// The work that the image forces of one vertex did, by phase of the left ventricle: the model's discrepancy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhaseWork {
    /// Phase of the left ventricle.
    pub phase: Phase,
    /// Mesh vertex.
    pub vertex: usize,
    /// Work, µJ (= mN·mm); negative where the force braked.
    pub work_uj: f64,
    /// The magnitudes of the work of every step, added up, µJ.
    pub magnitude_uj: f64,
}

/// A tracked beat.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedMotion {
    /// Curves by step and positions at the frames: the reference frame first, then one period on, the reference frame's time again last.
    pub trajectory: Trajectory,
    /// Boundary points and residuals, one entry a frame of the trajectory.
    pub frames: Vec<TrackedFrame>,
    /// The base motion found by block matching, where it was asked for.
    pub base: Option<BaseMatches>,
    /// Work of the image forces by vertex and phase, without zeros.
    pub work: Vec<PhaseWork>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Tracks the heart through one period of a cine sequence. `observer` sees the start and every step and may stop.
///
/// The mesh of the model must be that of the reference frame. Base modes `Free` and `BlockMatching` set the model's base springs to
/// zero; `Recorded` moves their anchors.
///
/// # Errors
/// [`TrackingError`] if the images do not cover a surface with a gain, show no contrast there, contradict the heart period by more
/// than 2 %, or lose a surface's boundary in most frames; and the errors of the model and its steps.
pub fn track(
    model: &HeartModel,
    cine: &CineSequence,
    settings: &TrackerSettings,
    observer: &mut dyn FnMut(&HeartState, &CurveRow) -> ControlFlow<()>,
) -> Result<TrackedMotion, TrackingError> {
    let frame_count = cine.frames().len();
    TrackingError::check_setting("reference_frame", settings.reference_frame as f64, 0.0, frame_count as f64 - 1.0)?;
    TrackingError::check_setting("held_out_share", settings.held_out_share, 0.0, 0.9)?;
    let mut warnings = period_warnings(model.parameters()[Parameter::HeartPeriod], cine.period_s())?;
    let model = &with_base_mode(model, &settings.base)?;
    let anatomy = Arc::clone(model.anatomy());
    let start_s = cine.times_s()[settings.reference_frame];
    let surfaces = learn_surfaces(model, cine, start_s, settings, &mut warnings)?;
    let held_out = hold_out(&surfaces, anatomy.mesh.vertex_count(), settings);
    let image_force = ImageForce::new(cine, &anatomy.surface, surfaces, settings.scheme, held_out)?;
    let (trajectory, base, work) = run(model, cine, settings, &image_force, observer)?;
    let seen = trajectory.frames.iter().zip(frame_order(cine, settings.reference_frame));
    let frames: Vec<TrackedFrame> = seen.map(|(state, frame)| TrackedFrame::new(&image_force, state, frame)).collect();
    warnings.extend(frame_warnings(&frames)?);
    Ok(TrackedMotion { trajectory, frames, base, work, warnings })
}

/// One beat under the loads of the images, the base motion that was matched, and the work that image forces do in it.
fn run(
    model: &HeartModel,
    cine: &CineSequence,
    settings: &TrackerSettings,
    image_force: &ImageForce,
    observer: &mut dyn FnMut(&HeartState, &CurveRow) -> ControlFlow<()>,
) -> Result<(Trajectory, Option<BaseMatches>, Vec<PhaseWork>), TrackingError> {
    let (anatomy, gain_kpa_per_mm) = (model.anatomy(), model.parameters()[Parameter::ImageGainBase]);
    let (mesh, projection) = (&anatomy.mesh, settings.base_projection);
    let still = still_base(model, cine, settings)?;
    let still_force =
        still.as_ref().map(|matches| BaseForce::new(&anatomy.surface, matches, mesh.vertices_mm(), projection, gain_kpa_per_mm));
    let still_force = still_force.transpose()?;
    let carried_base = match &settings.base {
        BaseMode::BlockMatching(blocks) if blocks.shape == BlockShape::Carried => {
            let vertices = anatomy.surface.vertices_with(SurfaceTag::Base);
            Some(proactive_blocks(model, cine, settings, (vertices, blocks), Drawn::Base { projection, gain_kpa_per_mm })?)
        }
        _ => None,
    };
    let on_wall = |wall: &WallSettings| {
        let drawn = Drawn::Wall { gain_kpa_per_mm2: wall.gain_kpa_per_mm2 };
        proactive_blocks(model, cine, settings, ((0..mesh.vertex_count()).collect(), &wall.blocks), drawn)
    };
    let carried_wall = settings.wall.as_ref().map(on_wall).transpose()?;
    let mut loads: Vec<&dyn StepLoad> = vec![image_force];
    loads.extend(still_force.as_ref().map(|force| force as &dyn StepLoad));
    loads.extend(carried_base.iter().chain(&carried_wall).map(|force| force as &dyn StepLoad));
    let mut ledger = WorkLedger::new(mesh.vertex_count());
    let trajectory = simulate(model, &plan_of(cine, settings.reference_frame), &loads, &mut |state, row| {
        ledger.book(image_force, state, row);
        observer(state, row)
    })?;
    let base = still.or(carried_base.map(ProactiveBlocks::into_matches));
    Ok((trajectory, base, ledger.entries()))
}

/// The frames of the cine in the order of a trajectory: the reference frame first, and again last.
fn frame_order(cine: &CineSequence, reference_frame: usize) -> impl Iterator<Item = usize> {
    let count = cine.frames().len();
    (0..=count).map(move |n| (reference_frame + n) % count)
}

/// The matches of the base that are made before the heart is tracked, where they are.
fn still_base(model: &HeartModel, cine: &CineSequence, settings: &TrackerSettings) -> Result<Option<BaseMatches>, TrackingError> {
    let BaseMode::BlockMatching(matching) = &settings.base else { return Ok(None) };
    if matching.shape == BlockShape::Carried {
        return Ok(None);
    }
    let anatomy = model.anatomy();
    let vertices = anatomy.surface.vertices_with(SurfaceTag::Base);
    match_base(cine, settings.reference_frame, &vertices, anatomy.mesh.vertices_mm(), matching).map(Some)
}

/// The load of blocks around some vertices that are matched on the way.
fn proactive_blocks<'a>(
    model: &'a HeartModel,
    cine: &'a CineSequence,
    settings: &TrackerSettings,
    (vertices, blocks): (Vec<usize>, &BlockMatchingSettings),
    drawn: Drawn,
) -> Result<ProactiveBlocks<'a>, TrackingError> {
    let (mesh, surface) = (&model.anatomy().mesh, &model.anatomy().surface);
    let carrier = Carrier::new(mesh.vertices_mm(), vertices, blocks.deformation_reach_mm());
    let wall = WallAtRest {
        plane: BasePlane::of(surface, mesh.vertices_mm()),
        tissue: Some(TissueMask::around(mesh, blocks.voxel_mm)),
        intensities: blocks.window.and_then(|window| wall_intensities(&cine.frames()[settings.reference_frame], mesh, window)),
    };
    let matched = CarriedBlocks::new(cine, settings.reference_frame, carrier.centres_mm(), wall, *blocks)?;
    let times_s = plan_of(cine, settings.reference_frame).frame_times_s;
    let frames = times_s.into_iter().zip(frame_order(cine, settings.reference_frame)).take(cine.frames().len()).collect();
    ProactiveBlocks::new((mesh, surface), carrier, matched, drawn, frames, (cine.times_s(), cine.period_s()))
}

/// The gain parameter of a surface.
fn gain_parameter(tag: SurfaceTag) -> Option<Parameter> {
    match tag {
        SurfaceTag::EndocardiumLv => Some(Parameter::ImageGainEndocardiumLv),
        SurfaceTag::EndocardiumRv => Some(Parameter::ImageGainEndocardiumRv),
        SurfaceTag::Epicardium => Some(Parameter::ImageGainEpicardium),
        SurfaceTag::Base => None,
    }
}

/// One period from the reference frame, with a frame at every image and at the end.
fn plan_of(cine: &CineSequence, reference_frame: usize) -> SimulationPlan {
    let (times_s, period_s) = (cine.times_s(), cine.period_s());
    // A reference in the second half of the cycle belongs to the diastole before the first trigger: no contraction precedes it.
    let earlier_s = if times_s[reference_frame] > 0.5 * period_s { period_s } else { 0.0 };
    let start_time_s = times_s[reference_frame] - earlier_s;
    let later = times_s[reference_frame..].iter().map(|t| t - earlier_s);
    let next_beat = times_s[..=reference_frame].iter().map(|t| t + period_s - earlier_s);
    SimulationPlan { start_time_s, end_time_s: start_time_s + period_s, frame_times_s: later.chain(next_beat).collect() }
}

fn period_warnings(model_s: f64, cine_s: f64) -> Result<Vec<String>, TrackingError> {
    let difference = (model_s / cine_s - 1.0).abs();
    if difference > 0.02 {
        return Err(TrackingError::PeriodMismatch { model_s, cine_s });
    }
    let differs = difference > 1e-6;
    Ok(differs.then(|| format!("the heart period is {model_s} s in the model and {cine_s} s in the images")).into_iter().collect())
}

fn with_base_mode(model: &HeartModel, base: &BaseMode) -> Result<HeartModel, TrackingError> {
    match base {
        BaseMode::Springs => Ok(model.clone()),
        BaseMode::Free | BaseMode::BlockMatching(_) => {
            let without = [Parameter::BaseStiffnessNormal, Parameter::BaseStiffnessIsotropic]
                .into_iter()
                .try_fold(model.parameters().clone(), |parameters, spring| parameters.with(spring, 0.0))
                .map_err(crate::heart::HeartError::from)?;
            Ok(model.with_parameters(without)?)
        }
        BaseMode::Recorded(motion) => {
            let settings = crate::heart::ModelSettings { base_motion: Some(Arc::clone(motion)), ..model.settings().clone() };
            Ok(HeartModel::new(Arc::clone(model.anatomy()), model.parameters().clone(), settings)?)
        }
    }
}

/// Every surface of the mesh with its search. One whose gain is zero pulls nothing; if it cannot be learnt either, that is a warning.
fn learn_surfaces(
    model: &HeartModel,
    cine: &CineSequence,
    start_s: f64,
    settings: &TrackerSettings,
    warnings: &mut Vec<String>,
) -> Result<Vec<SurfaceGain>, TrackingError> {
    let anatomy = model.anatomy();
    let instant = ImageInstant::new(cine, start_s);
    let mut surfaces = Vec::new();
    for tag in [SurfaceTag::EndocardiumLv, SurfaceTag::EndocardiumRv, SurfaceTag::Epicardium] {
        let Some(parameter) = gain_parameter(tag).filter(|_| anatomy.surface.tags().contains(&tag)) else { continue };
        let gain_kpa_per_mm = model.parameters()[parameter];
        let learnt = SurfaceAppearance::learn(&anatomy.surface, tag, anatomy.mesh.vertices_mm(), (&instant, start_s), &settings.appearance);
        match learnt {
            Ok(appearance) => {
                let search = BoundarySearch::new(appearance, settings.appearance, settings.boundary)?;
                surfaces.push(SurfaceGain { search, gain_kpa_per_mm });
            }
            Err(error) if gain_kpa_per_mm > 0.0 => return Err(error),
            Err(error) => warnings.push(format!("{error}; its gain is zero, so it is left out")),
        }
    }
    Ok(surfaces)
}

fn hold_out(surfaces: &[SurfaceGain], vertex_count: usize, settings: &TrackerSettings) -> Vec<bool> {
    let mut held_out = vec![false; vertex_count];
    let mut random = ChaCha8Rng::seed_from_u64(settings.held_out_seed);
    for vertex in surfaces.iter().flat_map(|one| &one.search.appearance().vertices) {
        held_out[*vertex] = random.random::<f64>() < settings.held_out_share;
    }
    held_out
}

/// Adds up the work of the image forces while the heart beats.
struct WorkLedger {
    before_mm: Vec<Vector3<f64>>,
    work: Vec<(Phase, Vec<[f64; 2]>)>,
    vertex_count: usize,
}

impl WorkLedger {
    fn new(vertex_count: usize) -> Self {
        Self { before_mm: Vec::new(), work: Vec::new(), vertex_count }
    }

    fn book(&mut self, force: &ImageForce, state: &HeartState, row: &CurveRow) {
        if let Some(phase) = row.phase_lv.filter(|_| !self.before_mm.is_empty()) {
            let place = self.work.iter().position(|(p, _)| *p == phase).unwrap_or_else(|| {
                self.work.push((phase, vec![[0.0; 2]; self.vertex_count]));
                self.work.len() - 1
            });
            for (vertex, work_uj) in force.work_uj(&self.before_mm, &state.motion.position_mm) {
                let [sum, magnitude] = &mut self.work[place].1[vertex];
                *sum += work_uj;
                *magnitude += work_uj.abs();
            }
        }
        self.before_mm.clone_from(&state.motion.position_mm);
    }

    fn entries(self) -> Vec<PhaseWork> {
        let of_phase = |(phase, work): (Phase, Vec<[f64; 2]>)| {
            let entries = work.into_iter().enumerate().filter(|(_, [_, magnitude])| *magnitude > 0.0);
            entries.map(move |(vertex, [work_uj, magnitude_uj])| PhaseWork { phase, vertex, work_uj, magnitude_uj })
        };
        self.work.into_iter().flat_map(of_phase).collect()
    }
}
