//! The tracker against a motion that it has not made: an ellipsoidal ventricle that contracts in closed form, seen through a synthetic cine.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::ops::ControlFlow;
use std::sync::Arc;

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings};
use cardiotwin::heart::{HeartModel, ModelSettings, Parameter, Parameters};
use cardiotwin::image::{CineSequence, Volume};
use cardiotwin::mechanics::{ExplicitSpring, explicit_spring_limit};
use cardiotwin::mesh::SurfaceTag;
use cardiotwin::phantom::{
    IdealisedLv, LABEL_CAVITY_LV, PrescribedContraction, ShortAxisStack, SyntheticCine, SyntheticCineSettings, VoxelSampling,
    synthetic_cine,
};
use cardiotwin::tracking::{
    BaseMode, BaseProjection, BlockMatchingSettings, BlockShape, CavityAgreement, ForceScheme, TrackedMotion, TrackerSettings,
    TrackingError, WallSettings, match_base, track,
};
use nalgebra::Vector3;

const PERIOD_S: f64 = 0.8;
const FRAMES: usize = 10;
/// The frame nearest to the peak of the prescribed contraction.
const PEAK: usize = 4;

struct Scene {
    anatomy: Arc<Anatomy>,
    truth_mm: Vec<Vec<Vector3<f64>>>,
    seen: SyntheticCine,
}

/// The ventricle ejects 35 % of its volume, its base comes down by 6 % of its length.
fn scene(slice_distance_mm: f64, noise: f64) -> Scene {
    let motion = PrescribedContraction { ejection_fraction: 0.35, shortening: 0.06, twist_rad: 0.05 };
    scene_of(IdealisedLv::default(), motion, slice_distance_mm, noise)
}

fn scene_of(lv: IdealisedLv, motion: PrescribedContraction, slice_distance_mm: f64, noise: f64) -> Scene {
    let anatomy = Arc::new(lv.build(&MesherSettings::with_edge_length_mm(7.0), &AnatomySettings::default()).unwrap());
    let times_s: Vec<f64> = (0..FRAMES).map(|n| PERIOD_S * n as f64 / FRAMES as f64).collect();
    let share = |&time_s: &f64| PrescribedContraction::share_at(time_s, PERIOD_S * PEAK as f64 / FRAMES as f64, PERIOD_S);
    let truth_mm: Vec<_> = times_s.iter().map(|t| motion.positions_mm(&lv, anatomy.mesh.vertices_mm(), share(t))).collect();
    let stack = ShortAxisStack { voxel_mm: 2.0, slice_distance_mm, margin_mm: 20.0, end_margin_mm: 16.0 };
    let sampling = VoxelSampling { samples_per_voxel: [1, 1, 2], thickness_share: 1.0 };
    let settings = SyntheticCineSettings {
        sampling,
        noise,
        wall_texture: 0.25,
        wall_texture_length_mm: 6.0,
        background_texture: 0.1,
        ..SyntheticCineSettings::default()
    };
    let seen = synthetic_cine(&anatomy, &truth_mm, &times_s, PERIOD_S, &stack.grid(&anatomy).unwrap(), &settings).unwrap();
    Scene { anatomy, truth_mm, seen }
}

/// A heart that would hardly beat by itself, so that what moves it is the images.
fn weak_heart(anatomy: &Arc<Anatomy>, gain_kpa_per_mm: f64) -> HeartModel {
    let mut parameters = Parameters::default();
    for (parameter, value) in [
        (Parameter::HeartPeriod, PERIOD_S),
        (Parameter::ContractionPeakLv, 40.0),
        (Parameter::FibreStiffness, 100.0),
        (Parameter::TransverseStiffness, 100.0),
        (Parameter::ImageGainEndocardiumLv, gain_kpa_per_mm),
        (Parameter::ImageGainEpicardium, gain_kpa_per_mm),
        (Parameter::ImageGainBase, gain_kpa_per_mm),
    ] {
        parameters.set(parameter, value).unwrap();
    }
    HeartModel::new(Arc::clone(anatomy), parameters, ModelSettings { step_s: 0.02, ..ModelSettings::default() }).unwrap()
}

fn tracked(scene: &Scene, gain_kpa_per_mm: f64, scheme: ForceScheme, base: BaseMode) -> TrackedMotion {
    let settings =
        TrackerSettings { scheme, base, base_projection: BaseProjection::Full, held_out_share: 0.1, ..TrackerSettings::default() };
    let model = weak_heart(&scene.anatomy, gain_kpa_per_mm);
    track(&model, &scene.seen.cine, &settings, &mut |_, _| ControlFlow::Continue(())).unwrap()
}

fn area_vectors(scene: &Scene, position_mm: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    scene.anatomy.surface.vertex_area_vectors_mm2(SurfaceTag::EndocardiumLv, position_mm)
}

/// Root mean square distance of endocardial vertices from the truth along the true normal, mm.
fn endocardial_error_mm(scene: &Scene, position_mm: &[Vector3<f64>], frame: usize) -> f64 {
    let truth_mm = &scene.truth_mm[frame];
    let area = area_vectors(scene, truth_mm);
    let vertices = scene.anatomy.surface.vertices_with(SurfaceTag::EndocardiumLv);
    let squares: f64 = vertices.iter().map(|&v| (position_mm[v] - truth_mm[v]).dot(&area[v].normalize()).powi(2)).sum();
    (squares / vertices.len() as f64).sqrt()
}

/// At the peak the endocardium is within half a voxel of the truth (it moved by about 5 mm), nearer than that of the free heart, the
/// volume is off by less than that too, and the held-out vertices agree with the others.
#[test]
fn the_tracked_wall_follows_a_motion_that_the_model_did_not_make() {
    let scene = scene(4.0, 4.0);
    let motion = tracked(&scene, 30.0, ForceScheme::Variational, BaseMode::BlockMatching(BlockMatchingSettings::default()));
    let free = tracked(&scene, 0.0, ForceScheme::Variational, BaseMode::Springs);
    let still_mm = endocardial_error_mm(&scene, scene.anatomy.mesh.vertices_mm(), PEAK);
    let free_mm = endocardial_error_mm(&scene, &free.trajectory.frames[PEAK].position_mm, PEAK);
    let state = &motion.trajectory.frames[PEAK];
    let error_mm = endocardial_error_mm(&scene, &state.position_mm, PEAK);
    assert!(error_mm < 1.0 && 3.0 * error_mm < still_mm && 2.0 * error_mm < free_mm, "{error_mm} mm; still {still_mm}, free {free_mm} mm");
    let volume_ml = scene.seen.volumes_ml[PEAK][0];
    let area_mm2: f64 = area_vectors(&scene, &scene.truth_mm[PEAK]).iter().map(|area| area.norm()).sum();
    let apart_mm = 1000.0 * (state.volume_ml[0] - volume_ml).abs() / area_mm2;
    assert!(apart_mm < 0.75, "{} mL against {volume_ml} mL, which is {apart_mm} mm of wall", state.volume_ml[0]);
    let frame = &motion.frames[PEAK];
    for residual in &frame.residuals {
        assert!(residual.held_out_rms_mm.unwrap() < 2.0 * residual.rms_mm.max(0.3), "{residual:?}");
        assert!(10 * residual.found > 8 * residual.vertex_count, "{residual:?}");
    }
    let cavity = &scene.anatomy.cavities[0].1;
    let labels = &scene.seen.labels[PEAK];
    let after = CavityAgreement::new(cavity, &state.position_mm, labels, LABEL_CAVITY_LV);
    let before = CavityAgreement::new(cavity, scene.anatomy.mesh.vertices_mm(), labels, LABEL_CAVITY_LV);
    assert!(after.dice > 0.94 && after.dice > before.dice + 0.08, "{} after, {} before", after.dice, before.dice);
    assert!(motion.warnings.is_empty(), "{:?}", motion.warnings);
}

/// The explicit force of the beginning of the step lags behind the image where the boundary moves fast; the implicit schemes do not,
/// [Billet2009] §4.2.
#[test]
fn the_explicit_scheme_lags_behind_the_implicit_ones() {
    let scene = scene(4.0, 0.0);
    let mean_error_mm = |scheme| {
        let motion = tracked(&scene, 1.0, scheme, BaseMode::Springs);
        let errors = (1..FRAMES).map(|frame| endocardial_error_mm(&scene, &motion.trajectory.frames[frame].position_mm, frame));
        errors.sum::<f64>() / (FRAMES - 1) as f64
    };
    let explicit_mm = mean_error_mm(ForceScheme::Explicit);
    for scheme in [ForceScheme::Exact, ForceScheme::Variational] {
        let implicit_mm = mean_error_mm(scheme);
        assert!(implicit_mm < 0.95 * explicit_mm, "{scheme:?} {implicit_mm} mm, explicit {explicit_mm} mm");
    }
}

/// Block matching finds the descent of the base where the wall has texture that the slices resolve and its surroundings have less.
#[test]
fn block_matching_finds_the_descent_of_the_base() {
    let scene = scene(4.0, 4.0);
    let vertices = scene.anatomy.surface.vertices_with(SurfaceTag::Base);
    let matches = match_base(&scene.seen.cine, 0, &vertices, scene.anatomy.mesh.vertices_mm(), &BlockMatchingSettings::default()).unwrap();
    let axis = scene.anatomy.axes.long_axis;
    let mean =
        |displacement: &mut dyn Iterator<Item = Vector3<f64>>| displacement.map(|d| d.dot(&axis)).sum::<f64>() / vertices.len() as f64;
    let rest_mm = scene.anatomy.mesh.vertices_mm();
    let truth_mm = mean(&mut vertices.iter().map(|&v| scene.truth_mm[PEAK][v] - rest_mm[v]));
    let found_mm = mean(&mut matches.displacement_mm()[PEAK].iter().copied());
    assert!(truth_mm < -4.0, "{truth_mm} mm");
    assert!((found_mm - truth_mm).abs() < 1.5, "{found_mm} mm against {truth_mm} mm");
}

/// A lopsided ventricle turns by 12°: blocks in base and wall that the tracked heart carries see it, boundaries and stiff blocks at the base do not.
#[test]
fn blocks_that_the_heart_carries_see_how_it_turns() {
    let lopsided = IdealisedLv { cross_section_ratio: 1.25, epicardium_offset_mm: 2.5, ..IdealisedLv::default() };
    let motion = PrescribedContraction { ejection_fraction: 0.4, shortening: 0.1, twist_rad: 0.2 };
    let scene = scene_of(lopsided, motion, 2.0, 4.0);
    let model = weak_heart(&scene.anatomy, 20.0);
    let blocks = |shape| BlockMatchingSettings { shape, ..BlockMatchingSettings::default() };
    let rmse_mm = |shape, wall| {
        let base = BaseMode::BlockMatching(blocks(shape));
        let settings = TrackerSettings { base, wall, base_projection: BaseProjection::Full, ..TrackerSettings::default() };
        let motion = track(&model, &scene.seen.cine, &settings, &mut |_, _| ControlFlow::Continue(())).unwrap();
        let found = &motion.trajectory.frames[PEAK].position_mm;
        let distances: Vec<f64> = found.iter().zip(&scene.truth_mm[PEAK]).map(|(a, b)| (a - b).norm()).collect();
        cardiotwin::numerics::root_mean_square(&distances)
    };
    let still = rmse_mm(BlockShape::Still, None);
    let carried = rmse_mm(BlockShape::Carried, Some(WallSettings { blocks: blocks(BlockShape::Carried), gain_kpa_per_mm2: 5.0 }));
    assert!(carried < 1.5 && 2.0 * carried < still, "{carried} mm carried, {still} mm still");
}

/// One black frame gives a warning that names it, and the beat is tracked through it.
#[test]
fn a_corrupt_frame_is_named_and_survived() {
    let mut scene = scene(4.0, 0.0);
    let cine = &scene.seen.cine;
    let mut frames = cine.frames().to_vec();
    frames[7] = Volume::new(cine.grid().clone(), vec![0.0; cine.grid().voxel_count()]).unwrap();
    scene.seen.cine = CineSequence::new(frames, cine.times_s().to_vec(), PERIOD_S).unwrap();
    let motion = tracked(&scene, 10.0, ForceScheme::Variational, BaseMode::Springs);
    assert!(motion.warnings.iter().any(|warning| warning.starts_with("frame 7:")), "{:?}", motion.warnings);
    assert!(motion.warnings.iter().all(|warning| warning.starts_with("frame 7:")), "{:?}", motion.warnings);
    assert!(endocardial_error_mm(&scene, &motion.trajectory.frames[PEAK].position_mm, PEAK) < 2.0);
}

/// Bad input is refused by name: images elsewhere in the world, a heart period that contradicts the images, a frame that is not there.
#[test]
fn contradicting_input_is_refused() {
    let scene = scene(8.0, 0.0);
    let model = weak_heart(&scene.anatomy, 1.0);
    let attempt = |model: &HeartModel, cine: &CineSequence, reference_frame: usize| {
        let settings = TrackerSettings { reference_frame, ..TrackerSettings::default() };
        track(model, cine, &settings, &mut |_, _| ControlFlow::Continue(())).unwrap_err()
    };
    let cine = &scene.seen.cine;
    let error = attempt(&model, cine, FRAMES);
    assert!(matches!(error, TrackingError::SettingOutOfRange { name: "reference_frame", .. }), "{error}");
    let slower = CineSequence::new(cine.frames().to_vec(), cine.times_s().to_vec(), 1.1).unwrap();
    assert!(matches!(attempt(&model, &slower, 0), TrackingError::PeriodMismatch { .. }));
    let moved = nalgebra::Matrix4::new_translation(&Vector3::repeat(400.0)) * cine.grid().voxel_to_world();
    let grid = cardiotwin::image::Grid::new(cine.grid().shape(), moved).unwrap();
    let frames = cine.frames().iter().map(|frame| Volume::new(grid.clone(), frame.values().to_vec()).unwrap()).collect();
    let elsewhere = CineSequence::new(frames, cine.times_s().to_vec(), PERIOD_S).unwrap();
    assert!(matches!(attempt(&model, &elsewhere, 0), TrackingError::NotCovered { .. }));
}

/// The same bits on one thread and on several.
#[test]
fn tracking_does_not_depend_on_the_number_of_threads() {
    let scene = scene(8.0, 4.0);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let settings = BlockMatchingSettings { voxel_mm: 3.0, ..BlockMatchingSettings::default() };
        pool.install(|| tracked(&scene, 10.0, ForceScheme::Variational, BaseMode::BlockMatching(settings)))
    };
    assert_eq!(run(1).trajectory.last, run(3).trajectory.last);
}

/// A gain of explicit forces that is below the bound of the springs they amount to (`explicit_spring_limit`) leaves the wall as quiet as
/// implicit forces of that gain do, 0.02 mm a step; 1.3 times the bound (which is on the safe side) shakes it by millimetres. The
/// variational scheme needs none.
#[test]
fn explicit_gains_track_images_below_their_bound_and_shake_the_wall_beyond_it() {
    let scene = scene(8.0, 0.0);
    let model = |gain_kpa_per_mm: f64| {
        let heart = weak_heart(&scene.anatomy, gain_kpa_per_mm);
        HeartModel::new(Arc::clone(&scene.anatomy), heart.parameters().clone(), ModelSettings { step_s: 0.005, ..ModelSettings::default() })
            .unwrap()
    };
    let free = model(0.0);
    let rest_mm = free.tissue().rest_mm();
    let springs = [SurfaceTag::EndocardiumLv, SurfaceTag::Epicardium].map(|tag| {
        let areas_mm2 = scene.anatomy.surface.vertex_area_vectors_mm2(tag, rest_mm).into_iter().enumerate();
        areas_mm2.filter_map(|(vertex, area_mm2)| {
            let stiffness_mn_per_mm = 2.0 * area_mm2.norm();
            Some(ExplicitSpring { vertex, direction: area_mm2.try_normalize(0.0)?, stiffness_mn_per_mm })
        })
    });
    let bound_kpa_per_mm = explicit_spring_limit(free.tissue(), 0.005, &springs.into_iter().flatten().collect::<Vec<_>>()).unwrap();
    // What the endocardium does against its last step, root mean square, mm; infinite where the heart could not be followed.
    let shaking_mm = |factor: f64, scheme: ForceScheme| {
        let endocardium = scene.anatomy.surface.vertices_with(SurfaceTag::EndocardiumLv);
        let mut positions_mm: Vec<Vec<Vector3<f64>>> = Vec::new();
        let settings = TrackerSettings { scheme, base: BaseMode::Springs, ..TrackerSettings::default() };
        let followed = track(&model(factor * bound_kpa_per_mm), &scene.seen.cine, &settings, &mut |state, _| {
            positions_mm.push(endocardium.iter().map(|&vertex| state.motion.position_mm[vertex]).collect());
            ControlFlow::Continue(())
        });
        let turns = positions_mm.windows(3).flat_map(|three| {
            let [before, now, after] = [&three[0], &three[1], &three[2]];
            before.iter().zip(now).zip(after).map(|((b, n), a)| (a - n * 2.0 + b).norm_squared())
        });
        let squares: Vec<f64> = turns.collect();
        if followed.is_ok() { (squares.iter().sum::<f64>() / squares.len() as f64).sqrt() } else { f64::INFINITY }
    };
    let below_mm = shaking_mm(0.95, ForceScheme::Explicit);
    let [implicit_mm, far_mm] = [0.95, 3.0].map(|factor| shaking_mm(factor, ForceScheme::Variational));
    let beyond_mm = [1.3, 1.5].map(|factor| shaking_mm(factor, ForceScheme::Explicit));
    assert!(below_mm < 2.0 * implicit_mm && far_mm < 2.0 * implicit_mm, "{below_mm} and {far_mm} mm against {implicit_mm} mm");
    assert!(beyond_mm.iter().all(|&beyond_mm| beyond_mm > 1.0), "{beyond_mm:?} mm against {below_mm} mm");
}
