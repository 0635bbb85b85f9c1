//! The beat: volumes measured and simulated, pressures with the phases, pressure–volume loops, and its figures in large type.

use crate::anatomy::Ventricle;
use crate::heart::Trajectory;
use crate::report::figures::Curve;
use crate::report::html::{Block, KeyFigure, Plot, Section, readable};
use crate::study::run::clock::Clock;
use crate::study::run::leave::BeatSummary;
use crate::study::run::personalise::TrackingSummary;
use crate::study::run::pictures::{later, ventricle_figures};

/// The curves of the last beat; `further` ones join the volumes of the left and of the right ventricle.
pub(in crate::study::run) fn beat_section(clock: &Clock, trajectory: &Trajectory, further: [&[Curve]; 2]) -> Section {
    let mut blocks = Vec::new();
    let [left, right] = further;
    for mut figures in ventricle_figures(clock, trajectory, left) {
        if figures.ventricle == Ventricle::Right {
            figures.volume.curves.extend(right.iter().map(|curve| later(curve, -clock.last_trigger_s())));
        }
        let volume = Plot::from(&figures.volume).with_phases(&figures.beat.phases);
        let loop_of = Plot::from(&figures.pressure_volume);
        blocks.push(Block::Beside(vec![Block::Plot(volume), Block::Plot(Plot::from(&figures.beat)), Block::Plot(loop_of)]));
    }
    if blocks.is_empty() {
        return Section { title: "The beat".into(), blocks };
    }
    let phases =
        "Behind the curves: isovolumetric contraction (IVC), ejection, isovolumetric relaxation (IVR) and filling of the ventricle.";
    blocks.insert(0, Block::Text(phases.into()));
    Section { title: "The beat".into(), blocks }
}

/// What a clinician asks of a beat first; `measured` (largest and smallest volume, mL) stands beside the left ventricle's.
pub(in crate::study::run) fn key_figures(beat: &BeatSummary, measured_ml: Option<(f64, f64)>) -> Vec<KeyFigure> {
    let of_images = |value: fn(f64, f64) -> f64, unit: &str| {
        measured_ml.map(|(most, least)| format!("images: {} {unit}", readable_to_tenth(value(most, least))))
    };
    let figure = |name: &str, value: Option<f64>, unit: &str, beside: Option<String>| {
        value.map(|value| KeyFigure { name: name.into(), value: readable_to_tenth(value), unit: unit.into(), beside })
    };
    let percent = |share: Option<f64>| share.map(|share| 100.0 * share);
    let right = |name: &str, value, unit| figure(&format!("{name}, RV"), value, unit, None);
    let left = |name: &str, value, unit, beside| figure(&format!("{name}, LV"), value, unit, beside);
    let figures = [
        left("Ejection fraction", percent(beat.ejection_fraction_lv), "%", of_images(|most, least| 100.0 * (1.0 - least / most), "%")),
        left("End-diastolic volume", beat.end_diastolic_volume_lv_ml, "mL", of_images(|most, _| most, "mL")),
        left("End-systolic volume", beat.end_systolic_volume_lv_ml, "mL", of_images(|_, least| least, "mL")),
        left("Stroke volume", beat.stroke_volume_lv_ml, "mL", of_images(|most, least| most - least, "mL")),
        left("Peak pressure", beat.pressure_peak_lv_mmhg, "mmHg", None),
        left("dP/dt max", beat.pressure_rate_max_lv_mmhg_per_s, "mmHg/s", None),
        right("Ejection fraction", percent(beat.ejection_fraction_rv), "%"),
        right("End-diastolic volume", beat.end_diastolic_volume_rv_ml, "mL"),
        right("End-systolic volume", beat.end_systolic_volume_rv_ml, "mL"),
        right("Peak pressure", beat.pressure_peak_rv_mmhg, "mmHg"),
        figure("Total activation time", Some(beat.total_activation_time_ms), "ms", None),
    ];
    figures.into_iter().flatten().collect()
}

/// How well a personalised heart fits, and what tracking it took.
pub(in crate::study::run) fn misfit_figures(volume_ml: [f64; 2], tracking: &TrackingSummary) -> Vec<KeyFigure> {
    let figure = |name: &str, value: f64, unit: &str, beside: Option<String>| KeyFigure {
        name: name.into(),
        value: readable_to_tenth(value),
        unit: unit.into(),
        beside,
    };
    let [before_ml, after_ml] = volume_ml;
    let held_out_mm = tracking.boundary_rms_held_out_mm;
    let held_out = (held_out_mm > 0.0).then(|| format!("held out: {} mm", readable_to_hundredth(held_out_mm)));
    let distance =
        KeyFigure { value: readable_to_hundredth(tracking.boundary_rms_mm), ..figure("Tracked boundary, RMS", 0.0, "mm", held_out) };
    vec![
        figure("Volume misfit of the model, RMS", after_ml, "mL", Some(format!("at its start: {} mL", readable_to_tenth(before_ml)))),
        distance,
        figure("Work of the image forces", tracking.image_work_mj, "mJ", None),
    ]
}

fn readable_to_hundredth(value: f64) -> String {
    readable((100.0 * value).round() / 100.0)
}

/// A tenth is more than any of these is known to; larger numbers whole.
fn readable_to_tenth(value: f64) -> String {
    if value.abs() >= 1000.0 { readable(value.round()) } else { readable((10.0 * value).round() / 10.0) }
}
