//! Taylor tests of the tangents of a beating left ventricle by every class of parameters, and what has none.

use std::sync::{Arc, OnceLock};

use nalgebra::DVector;

use super::super::idealised_lv::IdealisedLv;
use super::super::{ModelSettings, Parameter, Parameters, Part, PressureLoad, simulate};
use super::*;
use crate::anatomy::mesher::MesherSettings;
use crate::anatomy::{AhaSegment, Anatomy, AnatomySettings, IdealisedBiventricle, Region};
use crate::mechanics::{Kinematics, TimeScheme};
use crate::numerics::TaylorTest;

fn ventricle() -> Arc<Anatomy> {
    static ANATOMY: OnceLock<Arc<Anatomy>> = OnceLock::new();
    let scarred = || {
        let mut anatomy = IdealisedLv { resolution: [12, 6, 1], ..IdealisedLv::default() }.anatomy();
        for (region, segment) in anatomy.regions.iter_mut().zip(&anatomy.aha_segments) {
            if [7, 12, 13].contains(segment) {
                *region = Region::Scar;
            }
        }
        Arc::new(anatomy)
    };
    Arc::clone(ANATOMY.get_or_init(scarred))
}

/// A tight tolerance of the volume, so that differences are not of its size.
fn settings() -> ModelSettings {
    ModelSettings { step_s: 0.01, volume_tolerance_ml: 1e-11, ..ModelSettings::default() }
}

/// Everything on: springs all round, a fibrous ring, resistance to a change of volume; and no vertex depolarised at the end of a step.
fn parameters() -> Parameters {
    [
        (Parameter::PericardiumStiffness, 0.05),
        (Parameter::PericardiumBaseShare, 0.6),
        (Parameter::VolumeStiffness, 30.0),
        (Parameter::ValveRingHeight, 15.0),
        (Parameter::OnsetTime, 0.0237),
    ]
    .into_iter()
    .fold(Parameters::default(), |all, (parameter, value)| all.with(parameter, value).unwrap())
}

fn model() -> HeartModel {
    HeartModel::new(ventricle(), parameters(), settings()).unwrap()
}

/// The kick, an isovolumetric contraction, an ejection, a relaxation and the beginning of a filling.
fn beat() -> SimulationPlan {
    SimulationPlan { start_time_s: -0.1, end_time_s: 0.55, frame_times_s: vec![-0.03, 0.123, 0.3, 0.477] }
}

fn forever() -> impl FnMut(&HeartState, &CurveRow) -> ControlFlow<()> {
    |_, _| ControlFlow::Continue(())
}

/// Every number of a trajectory: volumes in mL, pressures in 0.1 kPa, flows in 10 mL/s, positions in mm.
fn numbers(trajectory: &Trajectory) -> DVector<f64> {
    let rows = trajectory.curves.iter().flat_map(|row| {
        let CurveRow { volume_lv_ml, volume_rv_ml, pressure_lv_kpa, pressure_rv_kpa, pressure_aorta_kpa, pressure_pulmonary_kpa, .. } =
            *row;
        let CurveRow { pressure_atrium_left_kpa, flow_aorta_ml_per_s, flow_mitral_ml_per_s, flow_pulmonary_ml_per_s, .. } = *row;
        let volumes = [volume_lv_ml, volume_rv_ml].into_iter().flatten();
        let pressures = [pressure_lv_kpa, pressure_rv_kpa, pressure_aorta_kpa, pressure_pulmonary_kpa, pressure_atrium_left_kpa];
        let flows = [flow_aorta_ml_per_s, flow_mitral_ml_per_s, flow_pulmonary_ml_per_s];
        volumes
            .chain(pressures.into_iter().flatten().map(|p| p * 10.0))
            .chain(flows.into_iter().flatten().map(|q| q / 10.0))
            .collect::<Vec<_>>()
    });
    let frames = trajectory.frames.iter().flat_map(|frame| {
        frame
            .position_mm
            .iter()
            .flat_map(|y| [y.x, y.y, y.z])
            .chain(frame.volume_ml.iter().copied())
            .chain(frame.pressure_kpa.iter().copied())
    });
    DVector::from_vec(rows.chain(frames).collect())
}

fn everywhere(class: &[(Parameter, f64)]) -> Vec<(RegionalParameter, f64)> {
    class.iter().map(|&(parameter, scale)| (parameter.into(), scale)).collect()
}

/// The Taylor test along a direction that changes every parameter by about `reach` of itself, or in a unit given with it.
fn taylor(model: &HeartModel, plan: &SimulationPlan, class: &[(RegionalParameter, f64)], reach: f64) -> (TaylorTest, Vec<DVector<f64>>) {
    let which: Vec<RegionalParameter> = class.iter().map(|one| one.0).collect();
    let (base, tangents) = simulate_with_tangents(model, plan, &[], &which, &mut forever()).unwrap();
    assert_eq!(base, simulate(model, plan, &[], &mut forever()).unwrap(), "the simulation is that without tangents, bit for bit");
    let slopes: Vec<DVector<f64>> = tangents.iter().map(numbers).collect();
    let direction =
        DVector::from_iterator(class.len(), class.iter().enumerate().map(|(i, one)| one.1 * (1.0 + (2.3 * i as f64).sin() / 2.0)));
    let run = |x: &DVector<f64>| {
        let parameters = which.iter().zip(x.iter()).fold(model.parameters().clone(), |all, (&parameter, &change)| {
            let value = all[parameter] + change;
            all.with(parameter, value).unwrap()
        });
        simulate(&model.with_parameters(parameters).unwrap(), plan, &[], &mut forever()).map(|trajectory| numbers(&trajectory))
    };
    let slope: DVector<f64> = slopes.iter().zip(direction.iter()).map(|(slope, by)| slope * *by).sum();
    (TaylorTest::run(run, &DVector::zeros(class.len()), &direction, &slope, reach, 5).unwrap(), slopes)
}

#[track_caller]
fn passes(model: &HeartModel, plan: &SimulationPlan, class: &[(RegionalParameter, f64)], reach: f64) {
    let (test, _) = taylor(model, plan, class, reach);
    assert!((test.order() - 2.0).abs() < 0.15, "order {}: {test:?}", test.order());
    for one in class {
        let (test, _) = taylor(model, plan, &[*one], reach);
        assert!((test.order() - 2.0).abs() < 0.15 || test.order().is_infinite(), "{}, order {}: {test:?}", one.0.name(), test.order());
    }
}

#[test]
fn contraction_passes_the_taylor_test() {
    let class = [
        (Parameter::ContractionPeakLv, 120.0),
        (Parameter::ContractionPeakScar, 80.0),
        (Parameter::ContractionRate, 10.0),
        (Parameter::RelaxationRate, 15.0),
        (Parameter::ActionPotentialDuration, 0.3),
    ];
    passes(&model(), &beat(), &everywhere(&class), 2e-4);
}

#[test]
fn activation_passes_the_taylor_test() {
    let class = [
        (Parameter::ConductionVelocity, 600.0),
        (Parameter::AnisotropyRatio, 0.16),
        (Parameter::EndocardialSpeedFactor, 4.0),
        (Parameter::OnsetTime, 0.03),
    ];
    passes(&model(), &beat(), &everywhere(&class), 2e-4);
}

/// The onset lies before the start: the derivatives begin with the steps that lead there.
#[test]
fn a_start_after_the_onset_passes_the_taylor_test() {
    let class = [
        (Parameter::OnsetTime, 0.03),
        (Parameter::ConductionVelocity, 600.0),
        (Parameter::ContractionPeakLv, 120.0),
        (Parameter::AtrialPressureLeft, 1.0),
        (Parameter::AtrialKickLeft, 0.5),
        (Parameter::AtrialKickOverlap, 0.05),
        (Parameter::InitialPressureAorta, 10.0),
    ];
    let plan = SimulationPlan { start_time_s: 0.06, end_time_s: 0.3, frame_times_s: vec![0.123, 0.27] };
    passes(&model(), &plan, &everywhere(&class), 2e-4);
}

/// Every part's own value, and the whole heart's where parts have their own.
#[test]
fn parts_of_the_heart_pass_the_taylor_test() {
    let of = |parameter, part| RegionalParameter::new(parameter, part).unwrap();
    let segment = |number| Part::Segment(AhaSegment::new(number).unwrap());
    let class = [
        (of(Parameter::ContractionPeakLv, segment(8)), 90.0),
        (of(Parameter::ContractionPeakLv, Part::Whole), 120.0),
        (of(Parameter::ActionPotentialDuration, segment(3)), 0.28),
        (of(Parameter::ContractionRate, Part::Scar), 7.0),
        (of(Parameter::RelaxationRate, Part::Whole), 15.0),
        (of(Parameter::ConductionVelocity, Part::Scar), 300.0),
        (of(Parameter::ConductionVelocity, Part::LeftVentricle), 650.0),
    ];
    let model = model();
    let own = class.iter().fold(model.parameters().clone(), |all, &(regional, value)| all.with(regional, value).unwrap());
    passes(&model.with_parameters(own).unwrap(), &beat(), &class, 2e-4);
}

#[test]
fn circulation_passes_the_taylor_test() {
    let class = [
        (Parameter::ResistanceSystemic, 0.12),
        (Parameter::ImpedanceSystemic, 0.008),
        (Parameter::ComplianceSystemic, 10.0),
        (Parameter::VenousPressureSystemic, 0.5),
        (Parameter::InitialPressureAorta, 10.0),
        (Parameter::AtrialPressureLeft, 1.0),
        (Parameter::AtrialKickLeft, 0.5),
        (Parameter::AtrialKickDuration, 0.12),
        (Parameter::AtrialKickOverlap, 0.05),
        (Parameter::ValveResistance, 0.002),
    ];
    passes(&model(), &beat(), &everywhere(&class), 1e-3);
}

#[test]
fn tissue_and_springs_pass_the_taylor_test() {
    let class = [
        (Parameter::FibreStiffness, 100.0),
        (Parameter::TransverseStiffness, 60.0),
        (Parameter::PoissonRatio, 0.1),
        (Parameter::VolumeStiffness, 30.0),
        (Parameter::Density, 1e-6),
        (Parameter::DampingMass, 10.0),
        (Parameter::DampingStiffness, 0.01),
        (Parameter::BaseStiffnessNormal, 2.5),
        (Parameter::BaseStiffnessIsotropic, 2.5),
        (Parameter::PericardiumStiffness, 0.05),
        (Parameter::PericardiumDamping, 0.005),
        (Parameter::PericardiumBaseShare, 0.6),
        (Parameter::ValveRingHeight, 15.0),
        (Parameter::ValveRingStiffness, 300.0),
    ];
    passes(&model(), &beat(), &everywhere(&class), 1e-3);
}

/// Both ventricles at once, in the scheme of second order, and tissue at the ends of its range.
#[test]
fn two_ventricles_in_generalised_alpha_pass_the_taylor_test() {
    let mesher = MesherSettings::with_edge_length_mm(13.0);
    let anatomy = Arc::new(IdealisedBiventricle::default().build(&mesher, &AnatomySettings::default()).unwrap());
    let settings = ModelSettings { time_scheme: TimeScheme::GeneralisedAlpha { spectral_radius: 0.4 }, ..settings() };
    let ends = [(Parameter::VolumeStiffness, 0.0), (Parameter::PericardiumBaseShare, 1.0), (Parameter::PericardiumStiffness, 0.0)];
    let parameters = ends.into_iter().fold(parameters(), |all, (parameter, value)| all.with(parameter, value).unwrap());
    let model = HeartModel::new(anatomy, parameters, settings).unwrap();
    let plan = SimulationPlan { start_time_s: -0.08, end_time_s: 0.2, frame_times_s: vec![0.05, 0.17] };
    let class = [
        (Parameter::ContractionPeakLv, 120.0),
        (Parameter::ContractionPeakRv, 125.0),
        (Parameter::ResistancePulmonary, 0.015),
        (Parameter::InitialPressurePulmonary, 2.0),
        (Parameter::AtrialPressureRight, 0.4),
        (Parameter::AtrialKickRight, 0.3),
        (Parameter::FibreStiffness, 100.0),
        (Parameter::DampingStiffness, 0.01),
        (Parameter::VolumeStiffness, 5.0),
        (Parameter::PericardiumStiffness, 0.05),
    ];
    let (test, _) = taylor(&model, &plan, &everywhere(&class), 2e-4);
    assert!((test.order() - 2.0).abs() < 0.15, "order {}: {test:?}", test.order());
}

/// Soft tissue that turns, in the schemes of either order; every class at once, and each property of the tissue alone.
#[test]
fn large_rotations_pass_the_taylor_test() {
    let soft = [
        (Parameter::FibreStiffness, 30.0),
        (Parameter::TransverseStiffness, 20.0),
        (Parameter::ContractionPeakLv, 80.0),
        (Parameter::ContractionPeakScar, 50.0),
    ];
    let soft = soft.into_iter().fold(parameters(), |all, (parameter, value)| all.with(parameter, value).unwrap());
    let class = [
        (Parameter::ContractionPeakLv, 80.0),
        (Parameter::RelaxationRate, 15.0),
        (Parameter::ConductionVelocity, 600.0),
        (Parameter::ResistanceSystemic, 0.12),
        (Parameter::AtrialPressureLeft, 1.0),
        (Parameter::FibreStiffness, 30.0),
        (Parameter::DampingStiffness, 0.01),
        (Parameter::VolumeStiffness, 30.0),
        (Parameter::ValveRingHeight, 15.0),
        (Parameter::Density, 1e-6),
        (Parameter::PericardiumStiffness, 0.05),
    ];
    let plan = SimulationPlan { start_time_s: -0.05, end_time_s: 0.14, frame_times_s: vec![0.05, 0.13] };
    for time_scheme in [TimeScheme::BackwardEuler, TimeScheme::GeneralisedAlpha { spectral_radius: 0.4 }] {
        let settings = ModelSettings { kinematics: Kinematics::Corotational, time_scheme, ..settings() };
        let model = HeartModel::new(ventricle(), soft.clone(), settings).unwrap();
        let (test, _) = taylor(&model, &plan, &everywhere(&class), 2e-3);
        assert!((test.order() - 2.0).abs() < 0.2, "{time_scheme:?}, order {}: {test:?}", test.order());
    }
}

/// More columns than are solved together, some that begin late: the same whatever the number of threads.
#[test]
fn tangents_do_not_depend_on_the_number_of_threads() {
    let class: Vec<RegionalParameter> = Parameter::ALL[6..19].iter().map(|&parameter| parameter.into()).collect();
    let plan = SimulationPlan { end_time_s: 0.15, ..beat() };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| simulate_with_tangents(&model(), &plan, &[], &class, &mut forever()).unwrap())
    };
    assert!(with(1) == with(3));
}

/// Before the first depolarisation no contraction matters; the aorta's resistance matters to its pressure from the start.
#[test]
fn a_tangent_is_zero_until_its_parameter_matters() {
    let plan = SimulationPlan { end_time_s: 0.0, ..beat() };
    let class = [Parameter::ContractionPeakLv.into(), Parameter::ResistanceSystemic.into()];
    let (_, tangents) = simulate_with_tangents(&model(), &plan, &[], &class, &mut forever()).unwrap();
    assert!(numbers(&tangents[0]).iter().all(|number| *number == 0.0));
    assert!(tangents[1].curves.iter().all(|row| row.volume_lv_ml == Some(0.0)));
    assert!(tangents[1].last.ventricles[0].arterial_pressure_kpa > 0.0);
}

#[test]
fn what_has_no_tangent_is_named() {
    let refused = |model: &HeartModel, parameter: Parameter| {
        simulate_with_tangents(model, &beat(), &[], &[parameter.into()], &mut forever()).unwrap_err().to_string()
    };
    let told = refused(&model(), Parameter::HeartPeriod);
    assert_eq!(told, "no tangent for heart_period_s: all later beats move with it; use finite differences");
    let without_ring = model().with_parameters(Parameters::default()).unwrap();
    assert!(refused(&without_ring, Parameter::ValveRingHeight).contains("valve_ring_height_mm"));
    let follower = ModelSettings { pressure_load: PressureLoad::Following, ..settings() };
    let follower = HeartModel::new(ventricle(), parameters(), follower).unwrap();
    assert!(refused(&follower, Parameter::ContractionPeakLv).contains("pressure_load"));
    assert!(refused(&model(), Parameter::ImageGainEpicardium).contains("without the loads of images"));
}
