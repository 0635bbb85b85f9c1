//! Beats that are not all alike: extrasystoles, their pauses, and stimuli that come to nothing.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings, Ventricle};
use cardiotwin::heart::{
    EachBeat, ExtraStimulus, HeartError, HeartModel, ModelSettings, OnsetSites, Parameter, Parameters, SimulationPlan, Trajectory, simulate,
};
use cardiotwin::mechanics::ContractionLaw;
use cardiotwin::phantom::IdealisedLv;

const START_S: f64 = -0.15;

fn anatomy() -> Arc<Anatomy> {
    static ANATOMY: OnceLock<Arc<Anatomy>> = OnceLock::new();
    let build = || IdealisedLv::default().build(&MesherSettings::with_edge_length_mm(11.0), &AnatomySettings::default()).unwrap();
    Arc::clone(ANATOMY.get_or_init(|| Arc::new(build())))
}

fn parameters(values: &[(Parameter, f64)]) -> Parameters {
    values.iter().fold(Parameters::default(), |parameters, &(parameter, value)| parameters.with(parameter, value).unwrap())
}

/// At the apex, where no own beat starts.
fn apex(beat: usize, delay_s: f64) -> ExtraStimulus {
    let axes = &anatomy().axes;
    ExtraStimulus { point_mm: axes.base_centre_mm - axes.long_axis * 200.0, beat, delay_s }
}

fn heart(parameters: Parameters, extra_stimuli: Vec<ExtraStimulus>) -> HeartModel {
    HeartModel::new(anatomy(), parameters, ModelSettings { extra_stimuli, ..ModelSettings::default() }).unwrap()
}

fn beats(model: &HeartModel, count: usize) -> Trajectory {
    let end_time_s = START_S + model.parameters()[Parameter::HeartPeriod] * count as f64;
    let plan = SimulationPlan { start_time_s: START_S, end_time_s, frame_times_s: vec![] };
    simulate(model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap()
}

/// σC of a heart that nothing disturbs is eq. 1 of its one map, bit by bit, and so it is where every extra stimulus is blocked.
#[test]
fn an_undisturbed_heart_repeats_one_map() {
    let values = parameters(&[]);
    let law = ContractionLaw {
        peak_kpa: 1.0,
        contraction_rate_per_s: values[Parameter::ContractionRate],
        relaxation_rate_per_s: values[Parameter::RelaxationRate],
        action_potential_duration_s: values[Parameter::ActionPotentialDuration],
        period_s: values[Parameter::HeartPeriod],
    };
    let (alone, blocked) = (heart(values.clone(), vec![]), heart(values.clone(), vec![apex(1, 0.15)]));
    assert_eq!((alone.rhythm().blocked_stimuli(), blocked.rhythm().blocked_stimuli()), (&[][..], &[0][..]));
    for time_s in [-0.1, 0.01, 0.05, 0.2, 0.36, 0.7, 0.83, 1.1, 4.37] {
        let fractions: Vec<f64> = alone.activation().times_s().iter().map(|&td_s| law.stress_kpa(time_s, td_s)).collect();
        let mean = |corners: &[usize; 4]| corners.iter().map(|&v| fractions[v]).sum::<f64>() / 4.0;
        let expected: Vec<f64> =
            anatomy().mesh.tetrahedra().iter().map(|corners| values[Parameter::ContractionPeakLv] * mean(corners)).collect();
        assert_eq!(alone.active_stress_kpa(time_s), expected);
        assert_eq!(blocked.active_stress_kpa(time_s), expected);
    }
    assert_eq!(beats(&alone, 2), beats(&blocked, 2));
}

/// An extrasystole from the apex depolarises tissue when a heart that beats from there alone would, and not before it gets there: the
/// contraction takes td from the latest beat that has reached the tissue.
#[test]
fn tissue_contracts_from_the_latest_beat_that_has_reached_it() {
    let delay_s = 0.5;
    let extra = heart(parameters(&[]), vec![apex(0, delay_s)]);
    let paced_from = parameters(&[(Parameter::OnsetTime, parameters(&[])[Parameter::OnsetTime] + delay_s)]);
    let onset_sites = OnsetSites::Points(vec![(apex(0, 0.0).point_mm, 0.0)]);
    let paced = HeartModel::new(anatomy(), paced_from, ModelSettings { onset_sites, ..ModelSettings::default() }).unwrap();
    let (first_s, last_s) = paced.activation().span_s();
    for share in [0.0, 0.3, 0.7, 1.0] {
        let time_s = first_s + share * (last_s - first_s);
        for vertex in 0..anatomy().mesh.vertex_count() {
            let td_s = [extra.activation().times_s()[vertex], paced.activation().times_s()[vertex]];
            let latest_s = td_s.into_iter().filter(|&td_s| td_s <= time_s).fold(f64::NEG_INFINITY, f64::max);
            let since_s = extra.rhythm().since_depolarisation_s(vertex, time_s).unwrap();
            assert!((since_s - (time_s - latest_s)).abs() < 1e-9, "vertex {vertex} at {time_s} s: {since_s}");
        }
    }
    assert_eq!(extra.rhythm().since_depolarisation_s(0, -0.1), None);
}

/// The beat that comes early finds a ventricle that has not filled: it ejects little. The own beat that follows is blocked; in the
/// compensatory pause the ventricle fills and the aorta empties, so that the next beat ejects more than a normal one, and the
/// ones after come back to normal.
#[test]
fn an_extrasystole_is_weak_and_the_beat_after_its_pause_strong() {
    for (period_s, duration_s, delay_s, share) in [(0.5, 0.25, 0.33, 0.6), (0.8, 0.3, 0.5, 0.8), (1.5, 0.3, 1.25, 0.97)] {
        let values = parameters(&[(Parameter::HeartPeriod, period_s), (Parameter::ActionPotentialDuration, duration_s)]);
        let model = heart(values, vec![apex(5, delay_s)]);
        let beats = EachBeat::of_rhythm(&beats(&model, 12).curves, model.rhythm(), Ventricle::Left);
        assert_eq!(beats.len(), 12, "one extra beat, one own beat missing");
        let intervals_s: Vec<f64> = beats.windows(2).map(|pair| pair[1].depolarisation.start_s - pair[0].depolarisation.start_s).collect();
        for (beat, interval_s) in intervals_s.into_iter().enumerate() {
            let expected_s = [period_s, delay_s, 2.0 * period_s - delay_s][if beat == 5 || beat == 6 { beat - 4 } else { 0 }];
            assert!((interval_s - expected_s).abs() < 1e-6, "{interval_s} s after beat {beat}");
        }
        let [normal, premature, after, last] = [4, 6, 7, 11].map(|beat| beats[beat]);
        let stroke_ml = [normal, premature, after, last].map(|beat| beat.stroke_volume_ml());
        assert!(premature.end_diastolic_volume_ml < normal.end_diastolic_volume_ml && stroke_ml[1] < share * stroke_ml[0], "{beats:?}");
        assert!(after.end_diastolic_volume_ml > normal.end_diastolic_volume_ml && stroke_ml[2] > 1.01 * stroke_ml[0], "{beats:?}");
        assert!((stroke_ml[3] - stroke_ml[0]).abs() < 0.2 * (stroke_ml[2] - stroke_ml[0]), "{beats:?}");
    }
}

/// A lead that stimulates in every beat: within the refractory time it does nothing, after it every own beat is followed by an extra one,
/// and where the extra one blocks the next own beat the lead has taken the heart over.
#[test]
fn a_repeating_site_couples_or_takes_over() {
    let starts_s = |period_s: f64, delay_s: f64| {
        let onset_sites = OnsetSites::Together(vec![OnsetSites::Normal, OnsetSites::Points(vec![(apex(0, 0.0).point_mm, delay_s)])]);
        let settings = ModelSettings { onset_sites, ..ModelSettings::default() };
        let model = HeartModel::new(anatomy(), parameters(&[(Parameter::HeartPeriod, period_s)]), settings).unwrap();
        let starts = model.rhythm().depolarisations(START_S, 2.9 * period_s);
        starts.iter().map(|depolarisation| depolarisation.start_s).collect::<Vec<_>>()
    };
    for (period_s, delay_s, expected_s) in
        [(0.8, 0.2, &[0.02, 0.82, 1.62][..]), (1.0, 0.5, &[0.02, 0.52, 1.02, 1.52, 2.02, 2.52]), (0.8, 0.52, &[0.02, 0.54, 1.34, 2.14])]
    {
        let found_s = starts_s(period_s, delay_s);
        let agrees = found_s.len() == expected_s.len() && found_s.iter().zip(expected_s).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(agrees, "{found_s:?} where {expected_s:?} are due");
    }
}

#[test]
fn a_stimulus_belongs_to_its_beat() {
    let settings = ModelSettings { extra_stimuli: vec![apex(1, 0.9)], ..ModelSettings::default() };
    let error = HeartModel::new(anatomy(), parameters(&[]), settings).unwrap_err();
    assert!(matches!(error, HeartError::Setting { setting: "delay_s", .. }), "{error}");
}
