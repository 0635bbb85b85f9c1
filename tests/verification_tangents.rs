//! Derivatives of a tracked heart's whole run: with image forces, along contraction, stiffness, circulation and gains at once.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::ops::ControlFlow;
use std::sync::Arc;

use cardiotwin::anatomy::AnatomySettings;
use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::heart::{HeartModel, ModelSettings, Parameter, Parameters, SimulationPlan, Trajectory, simulate, simulate_with_tangents};
use cardiotwin::image::{CineSequence, Grid, Volume};
use cardiotwin::mesh::{SurfaceTag, TaggedSurface};
use cardiotwin::numerics::TaylorTest;
use cardiotwin::phantom::IdealisedLv;
use cardiotwin::tracking::{
    AppearanceSettings, BoundarySearch, BoundarySettings, ForceScheme, ImageForce, ImageInstant, SurfaceAppearance, SurfaceGain,
};
use nalgebra::{DVector, Vector3};

const SURFACES: [(SurfaceTag, Parameter); 2] =
    [(SurfaceTag::EndocardiumLv, Parameter::ImageGainEndocardiumLv), (SurfaceTag::Epicardium, Parameter::ImageGainEpicardium)];

/// Blood, muscle and what is around it with edges of 2 mm; the cavity of the second frame is narrower by a tenth.
fn cine(lv: &IdealisedLv) -> CineSequence {
    let frame = |narrower: f64| {
        let spacing_mm = 2.0;
        let half_mm = Vector3::new(48.0, 48.0, 84.0);
        let shape = [0, 1, 2].map(|axis| (2.0 * half_mm[axis] / spacing_mm) as usize + 1);
        let grid = Grid::axis_aligned(shape, -half_mm, Vector3::repeat(spacing_mm)).unwrap();
        let inside = |p: &Vector3<f64>, radius_mm: f64, length_mm: f64| {
            let distance_mm = radius_mm * (1.0 - Vector3::new(p.x / radius_mm, p.y / radius_mm, p.z / length_mm).norm());
            1.0 / (1.0 + (-distance_mm / 2.0).exp())
        };
        let (outer_mm, outer_length_mm) = (lv.cavity_radius_mm + lv.wall_thickness_mm, lv.cavity_length_mm + lv.apex_thickness_mm);
        let intensity = |flat: usize| {
            let p = grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|n| n as f64)));
            let blood = inside(&p, lv.cavity_radius_mm * narrower, lv.cavity_length_mm * narrower);
            let heart = inside(&p, outer_mm * (0.6 + 0.4 * narrower), outer_length_mm * (0.6 + 0.4 * narrower));
            (300.0 - 200.0 * heart + 300.0 * blood) as f32
        };
        Volume::new(grid.clone(), (0..grid.voxel_count()).map(intensity).collect()).unwrap()
    };
    CineSequence::new(vec![frame(1.0), frame(0.9)], vec![0.0, 0.3], 0.8).unwrap()
}

fn searches(cine: &CineSequence, surface: &TaggedSurface, position_mm: &[Vector3<f64>]) -> Vec<BoundarySearch> {
    let sides = AppearanceSettings::default();
    let instant = ImageInstant::new(cine, 0.0);
    let search = |(tag, _): (SurfaceTag, Parameter)| {
        let appearance = SurfaceAppearance::learn(surface, tag, position_mm, (&instant, 0.0), &sides).unwrap();
        BoundarySearch::new(appearance, sides, BoundarySettings::default()).unwrap()
    };
    SURFACES.map(search).to_vec()
}

fn numbers(trajectory: &Trajectory) -> DVector<f64> {
    let rows = trajectory.curves.iter().flat_map(|row| [row.volume_lv_ml.unwrap(), row.pressure_lv_kpa.unwrap() * 10.0]);
    let frames = trajectory.frames.iter().flat_map(|frame| frame.position_mm.iter().flat_map(|y| [y.x, y.y, y.z]));
    DVector::from_vec(rows.chain(frames).collect())
}

/// In the symmetric scheme and in one that is not. Image gains are parameters of the model and of its loads at once.
#[test]
fn tangents_of_a_tracked_heart_pass_the_taylor_test() {
    let lv = IdealisedLv::default();
    let anatomy = Arc::new(lv.build(&MesherSettings::with_edge_length_mm(11.0), &AnatomySettings::default()).unwrap());
    let cine = cine(&lv);
    let searches = searches(&cine, &anatomy.surface, anatomy.mesh.vertices_mm());
    let settings = ModelSettings { step_s: 0.01, volume_tolerance_ml: 1e-10, ..ModelSettings::default() };
    let start = Parameters::default().with(Parameter::OnsetTime, 0.0237).unwrap();
    let model = HeartModel::new(Arc::clone(&anatomy), start, settings).unwrap();
    let plan = SimulationPlan { start_time_s: 0.0, end_time_s: 0.12, frame_times_s: vec![0.055, 0.12] };
    let class = [
        (Parameter::ContractionPeakLv, 120.0),
        (Parameter::FibreStiffness, 100.0),
        (Parameter::InitialPressureAorta, 10.0),
        (Parameter::ImageGainEndocardiumLv, 20.0),
        (Parameter::ImageGainEpicardium, -10.0),
    ];
    let which: Vec<_> = class.iter().map(|one| one.0.into()).collect();
    for scheme in [ForceScheme::Variational, ForceScheme::Exact] {
        let load = |parameters: &Parameters| {
            let gained = searches.iter().zip(SURFACES);
            let gained = gained.map(|(search, (_, gain))| SurfaceGain { search: search.clone(), gain_kpa_per_mm: parameters[gain] });
            ImageForce::new(&cine, &anatomy.surface, gained.collect(), scheme, vec![]).unwrap()
        };
        let force = load(model.parameters());
        let go_on = &mut |_: &_, _: &_| ControlFlow::Continue(());
        let (base, tangents) = simulate_with_tangents(&model, &plan, &[&force], &which, go_on).unwrap();
        assert_eq!(base, simulate(&model, &plan, &[&force], go_on).unwrap());
        let slope: DVector<f64> = tangents.iter().zip(class).map(|(tangent, (_, by))| numbers(tangent) * by).sum();
        let run = |x: &DVector<f64>| {
            let parameters = class.iter().fold(model.parameters().clone(), |all, &(parameter, by)| {
                let value = all[parameter] + by * x[0];
                all.with(parameter, value).unwrap()
            });
            let force = load(&parameters);
            let moved = model.with_parameters(parameters).unwrap();
            simulate(&moved, &plan, &[&force], &mut |_, _| ControlFlow::Continue(())).map(|trajectory| numbers(&trajectory))
        };
        let test = TaylorTest::run(run, &DVector::zeros(1), &DVector::repeat(1, 1.0), &slope, 8e-3, 4).unwrap();
        assert!((test.order() - 2.0).abs() < 0.25, "{scheme:?}: order {}, {test:?}", test.order());
    }
}
