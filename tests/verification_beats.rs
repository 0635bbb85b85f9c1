//! Whole beats from outside: two ventricles with physiological figures, a bundle branch block, and hearts at the edges of their ranges.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings, IdealisedBiventricle, Ventricle};
use cardiotwin::heart::{
    BeatDeformation, BeatObservables, HeartError, HeartModel, ModelSettings, OnsetSites, Parameter, Parameters, SimulationPlan, StepError,
    Trajectory, simulate,
};
use cardiotwin::mechanics::Kinematics;
use cardiotwin::phantom::IdealisedLv;
use cardiotwin::study::{Config, Overrides, Plan, RunContext, Silent, run};
use rayon::prelude::*;
use serde_json::Value;

const START_S: f64 = -0.15;
const PERIOD_S: f64 = 0.8;

fn biventricle() -> Arc<Anatomy> {
    static ANATOMY: OnceLock<Arc<Anatomy>> = OnceLock::new();
    let build = || IdealisedBiventricle::default().build(&MesherSettings::with_edge_length_mm(7.5), &AnatomySettings::default()).unwrap();
    Arc::clone(ANATOMY.get_or_init(|| Arc::new(build())))
}

fn beat(model: &HeartModel, period_s: f64) -> Result<Trajectory, StepError> {
    let frame_times_s = (0..80).map(|n| START_S + period_s * f64::from(n) / 80.0).collect();
    let plan = SimulationPlan { start_time_s: START_S, end_time_s: START_S + period_s, frame_times_s };
    simulate(model, &plan, &[], &mut |_, _| ControlFlow::Continue(()))
}

/// The beat of two ventricles with all defaults.
fn default_beat() -> &'static (HeartModel, Trajectory) {
    static BEAT: OnceLock<(HeartModel, Trajectory)> = OnceLock::new();
    BEAT.get_or_init(|| {
        let model = HeartModel::new(biventricle(), Parameters::default(), ModelSettings::default()).unwrap();
        let trajectory = beat(&model, PERIOD_S).unwrap();
        (model, trajectory)
    })
}

fn deformation(trajectory: &Trajectory) -> BeatDeformation {
    BeatDeformation::of_beat(&biventricle(), &trajectory.frames, &trajectory.curves, START_S, PERIOD_S).unwrap()
}

/// MODEL §5 ranges where the default meets them; what it does not meet is said in `studies/02_biventricular_beat`.
#[test]
fn the_default_biventricle_has_physiological_figures_at_once() {
    let (_, trajectory) = default_beat();
    let [left, right] =
        [Ventricle::Left, Ventricle::Right].map(|v| BeatObservables::of_beat(&trajectory.curves, v, START_S, PERIOD_S).unwrap());
    let wall = deformation(trajectory).end_systole;
    let ranges = [
        ("LV ejection fraction", left.ejection_fraction, 0.5..0.7),
        ("LV end-diastolic volume", left.end_diastolic_volume_ml, 109.0..189.0),
        ("LV peak pressure", left.pressure_peak_mmhg, 100.0..140.0),
        ("RV peak pressure", right.pressure_peak_mmhg, 15.0..35.0),
        ("dP/dt", left.pressure_rate_max_mmhg_per_s, 1200.0..3000.0),
        ("ejection", left.ejection_ms, 250.0..315.0),
        ("circumferential strain", wall.strain.circumferential, -0.25..-0.12),
        ("longitudinal strain", wall.strain.longitudinal, -0.22..-0.08),
        ("radial strain", wall.strain.radial, 0.2..0.45),
        ("wall thickening", wall.wall_thickening, 0.15..0.5),
    ];
    for (name, value, range) in ranges {
        assert!(range.contains(&value), "{name} {value} outside {range:?}");
    }
}

/// What study 02 states, on a mesh so coarse that it takes seconds: published tissue under large rotations, a base that is free to descend.
/// Where a figure leaves its range the heart is not normal any more, whatever the studies say.
#[test]
fn the_second_study_beats_as_a_normal_heart_on_a_coarse_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("studies/02_biventricular_beat/study.toml");
    let settings = ["anatomy.edge_length_mm=10", "simulation.beats=1", "output.figures=false", "output.meshes=false"];
    let settings = settings.iter().map(ToString::to_string).collect();
    let overrides = Overrides { output: Some(folder.path().to_path_buf()), settings, ..Overrides::default() };
    let plan = Plan::new(&Config::read(&file, overrides).unwrap()).unwrap();
    run(&plan, &RunContext::new(&Silent, &AtomicBool::new(false))).unwrap();
    let summary: Value = serde_json::from_str(&std::fs::read_to_string(folder.path().join("summary.json")).unwrap()).unwrap();
    let ranges = [
        ("ejection_fraction_lv", 0.55..0.7),
        ("ejection_fraction_rv", 0.45..0.7),
        ("end_diastolic_volume_lv_ml", 109.0..189.0),
        ("end_diastolic_volume_rv_ml", 113.0..223.0),
        ("pressure_peak_lv_mmhg", 100.0..140.0),
        ("pressure_peak_rv_mmhg", 15.0..35.0),
        ("pressure_rate_max_lv_mmhg_per_s", 1200.0..2500.0),
        ("isovolumetric_contraction_lv_ms", 30.0..50.0),
        ("ejection_lv_ms", 269.0..315.0),
        ("isovolumetric_relaxation_lv_ms", 77.0..115.0),
        ("base_descent_mm", 11.0..18.0),
        ("twist_lv_deg", 10.0..20.0),
        ("strain_circumferential_lv", -0.23..-0.15),
        ("strain_longitudinal_lv", -0.20..-0.14),
        ("strain_radial_lv", 0.25..0.50),
        ("wall_thickening_lv", 0.25..0.50),
    ];
    for (name, range) in ranges {
        let value = summary[name].as_f64().unwrap_or(f64::NAN);
        assert!(range.contains(&value), "{name} {value} outside {range:?}");
    }
}

/// Mean circumferential strain of some segments, one a frame.
fn strain(beat: &BeatDeformation, segments: &[u8]) -> Vec<f64> {
    let mean = |frame: usize| segments.iter().map(|&s| beat.strains_of(s)[frame].circumferential).sum::<f64>() / segments.len() as f64;
    (0..beat.times_s.len()).map(mean).collect()
}

/// With the right ventricle activated alone the septum shortens before the aortic valve opens, against a lateral wall that it stretches;
/// when that wall contracts late, the septum is stretched in its turn before the valve shuts \[Prinzen1999\].
#[test]
fn in_left_bundle_branch_block_the_septum_flashes_and_the_lateral_wall_is_late() {
    const SEPTAL: [u8; 4] = [2, 3, 8, 9];
    const LATERAL: [u8; 4] = [5, 6, 11, 12];
    let (normal_model, normal_beat) = default_beat();
    let parameters = Parameters::default().with(Parameter::EndocardialSpeedFactor, 2.5).unwrap();
    let settings = ModelSettings { onset_sites: OnsetSites::LeftBundleBranchBlock, ..ModelSettings::default() };
    let model = HeartModel::new(biventricle(), parameters, settings).unwrap();
    let trajectory = beat(&model, PERIOD_S).unwrap();

    let span_ms = |model: &HeartModel| {
        let (first_s, last_s) = model.activation().span_s();
        (last_s - first_s) * 1e3
    };
    assert!(span_ms(normal_model) < 100.0 && span_ms(&model) > 120.0, "QRS {} and {} ms", span_ms(normal_model), span_ms(&model));

    let early = |trajectory: &Trajectory| {
        let beat = deformation(trajectory);
        let opening_s = beat.end_systole_s
            - BeatObservables::of_beat(&trajectory.curves, Ventricle::Left, START_S, PERIOD_S).unwrap().ejection_ms / 1e3;
        let at_opening = beat.times_s.partition_point(|&time_s| time_s < opening_s);
        let at_end = beat.times_s.partition_point(|&time_s| time_s < beat.end_systole_s);
        (strain(&beat, &SEPTAL), strain(&beat, &LATERAL), at_opening, at_end)
    };
    let (septal, lateral, opening, end) = early(&trajectory);
    let (septal_normal, lateral_normal, opening_normal, _) = early(normal_beat);
    assert!(septal[opening] < -0.05 && lateral[opening] > 0.04, "at the opening: {} and {}", septal[opening], lateral[opening]);
    let difference = |septal: f64, lateral: f64| (lateral - septal).abs();
    let normal = difference(septal_normal[opening_normal], lateral_normal[opening_normal]);
    assert!(difference(septal[opening], lateral[opening]) > 2.0 * normal, "normally {normal}");
    let time_of_peak = |strain: &[f64]| (0..strain.len()).min_by(|&a, &b| strain[a].total_cmp(&strain[b])).unwrap();
    assert!(time_of_peak(&septal) < end && time_of_peak(&lateral) > end, "the septum peaks first, the lateral wall after the valve shut");
    assert!(septal[end] > septal.iter().copied().fold(0.0, f64::min) + 0.01, "the septum is stretched again before the valve shuts");
}

/// A heart at the edge of its ranges.
#[derive(Debug, Clone, Copy)]
struct Extreme {
    kinematics: Kinematics,
    step_s: f64,
    stiffness_kpa: f64,
    peak_kpa: f64,
    duration_s: f64,
    period_s: f64,
}

/// Steps of 0.5–10 ms, stiffness and contraction over their whole ranges and at what is usual, APD 0.2–0.5 s, HP 0.5–1.5 s. Short steps
/// and large rotations take a part of the cases; large rotations in short steps are the heart's own tests, larger meshes
/// `benches/survival.rs`.
fn extremes() -> Vec<Extreme> {
    let mut cases = Vec::new();
    for (stiffness_kpa, peak_kpa) in [(0.1, 0.0), (0.1, 1000.0), (2000.0, 0.0), (2000.0, 1000.0), (30.0, 60.0), (100.0, 120.0)] {
        for (duration_s, period_s) in [(0.2, 0.5), (0.45, 0.5), (0.3, 1.5), (0.5, 1.5)] {
            for (kinematics, step_s) in
                [(Kinematics::Linear, 0.0005), (Kinematics::Linear, 0.002), (Kinematics::Linear, 0.01), (Kinematics::Corotational, 0.01)]
            {
                let is_dear = step_s < 0.01 || kinematics == Kinematics::Corotational;
                if !is_dear || duration_s == 0.45 || (duration_s == 0.3 && stiffness_kpa == 30.0) {
                    cases.push(Extreme { kinematics, step_s, stiffness_kpa, peak_kpa, duration_s, period_s });
                }
            }
        }
    }
    cases
}

/// What became of a heart at the edge of its ranges.
fn outcome(anatomy: &Arc<Anatomy>, case: &Extreme) -> Result<Trajectory, String> {
    let &Extreme { kinematics, step_s, stiffness_kpa, peak_kpa, duration_s, period_s } = case;
    let values = [
        (Parameter::FibreStiffness, stiffness_kpa),
        (Parameter::TransverseStiffness, stiffness_kpa),
        (Parameter::ContractionPeakLv, peak_kpa),
        (Parameter::ActionPotentialDuration, duration_s),
        (Parameter::HeartPeriod, period_s),
    ];
    let parameters = values.iter().fold(Parameters::default(), |parameters, &(p, value)| parameters.with(p, value).unwrap());
    let settings = ModelSettings { step_s, kinematics, ..ModelSettings::default() };
    let model = match HeartModel::new(Arc::clone(anatomy), parameters, settings) {
        Ok(model) => model,
        Err(error) => {
            assert!(matches!(error, HeartError::Mechanics(_) | HeartError::Setting { .. }), "{error}");
            return Err(error.to_string());
        }
    };
    beat(&model, period_s).map_err(|error| {
        let text = error.to_string();
        assert!(text.starts_with("at ") && text.contains(&format!("(step {step_s} s)")), "no time and step in: {text}");
        assert!(!text.contains("NaN") && text.bytes().filter(u8::is_ascii_digit).count() > 8, "no residual in: {text}");
        text
    })
}

/// Either a beat or an error that says when and why; never a number that is none.
#[test]
fn a_heart_at_the_edge_of_its_ranges_beats_or_says_why_not() {
    let mesher = MesherSettings::with_edge_length_mm(11.0);
    let anatomy = Arc::new(IdealisedLv::default().build(&mesher, &AnatomySettings::default()).unwrap());
    let cases = extremes();
    let beats = |case: &Extreme| {
        let Ok(trajectory) = outcome(&anatomy, case) else { return false };
        let rows = trajectory.curves.iter().filter_map(|row| row.ventricle(Ventricle::Left));
        for row in rows {
            let numbers = [row.volume_ml, row.pressure_kpa, row.arterial_pressure_kpa, row.outflow_ml_per_s, row.inflow_ml_per_s];
            assert!(numbers.iter().all(|number| number.is_finite()), "{row:?} of {case:?}");
        }
        let positions = trajectory.frames.iter().flat_map(|frame| &frame.position_mm);
        assert!(positions.flat_map(|p| p.iter()).all(|number| number.is_finite()), "{case:?}");
        true
    };
    for kinematics in [Kinematics::Linear, Kinematics::Corotational] {
        let of_kind: Vec<&Extreme> = cases.iter().filter(|case| case.kinematics == kinematics).collect();
        let beaten = of_kind.par_iter().filter(|case| beats(case)).count();
        assert!(beaten > of_kind.len() / 2, "{beaten} of {} hearts beat with {kinematics:?} kinematics", of_kind.len());
    }
}
