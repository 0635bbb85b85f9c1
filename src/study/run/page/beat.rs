//! The beat: volumes measured and simulated, pressures with the phases, pressure–volume loops, and its figures in large type.

use crate::anatomy::Ventricle;
use crate::heart::{Trajectory, VentricleCurve};
use crate::report::figures::{Curve, TimeBand};
use crate::report::html::{Block, KeyFigure, Plot, Section, Table, readable};
use crate::study::run::clock::Clock;
use crate::study::run::leave::BeatSummary;
use crate::study::run::personal_summary::TrackingSummary;
use crate::study::run::pictures::{later, ventricle_figures};
use crate::units::MS_PER_S;

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
        let name = &figures.pressure_volume.ventricle;
        let pressures = Plot { title: format!("Pressures of the {name} over the beat"), ..Plot::from(&figures.beat) };
        let durations = Block::Table(durations(name, &figures.beat.phases));
        blocks.push(Block::Beside(vec![Block::Plot(volume), Block::Plot(pressures), Block::Plot(loop_of), durations]));
    }
    if blocks.is_empty() {
        return Section { title: "The beat".into(), blocks };
    }
    let phases = "Behind the curves: isovolumetric contraction (IVC), ejection, isovolumetric relaxation (IVR) and filling of the ventricle. \
                  A loop that does not close is that of a beat that does not yet repeat: the heart starts at rest in the first image, with its \
                  arteries as the parameters say.";
    blocks.insert(0, Block::Text(phases.into()));
    Section { title: "The beat".into(), blocks }
}

/// The phases of a ventricle with their times.
fn durations(ventricle: &str, phases: &[TimeBand]) -> Table {
    let whole_ms = |time_s: f64| readable((MS_PER_S * time_s).round());
    let row = |band: &TimeBand| vec![band.name.clone(), whole_ms(band.from_s), whole_ms(band.to_s), whole_ms(band.to_s - band.from_s)];
    Table {
        caption: format!("Phases of the {ventricle}, ms after the trigger"),
        columns: ["Phase", "From", "To", "Duration"].map(str::to_owned).to_vec(),
        rows: phases.iter().map(row).collect(),
    }
}

/// What a clinician asks of a beat first; `measured` (largest and smallest volume, mL) stands beside the left ventricle's.
pub(in crate::study::run) fn key_figures(beat: &BeatSummary, measured_ml: Option<(f64, f64)>) -> Vec<KeyFigure> {
    let of_images = |value: fn(f64, f64) -> f64, unit: &str| {
        measured_ml.map(|(most, least)| format!("images: {} {unit}", to_tenth(value(most, least))))
    };
    let figure = |name: &str, value: Option<f64>, unit: &str, beside: Option<String>| {
        value.map(|value| KeyFigure { name: name.into(), value: to_tenth(value), unit: unit.into(), beside })
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

/// How well a personalised heart fits, and what tracking it took; the work of image forces beside what the heart itself does in a beat.
pub(in crate::study::run) fn misfit_figures(
    volume_ml: [f64; 2],
    tracking: &TrackingSummary,
    clock: &Clock,
    trajectory: &Trajectory,
) -> Vec<KeyFigure> {
    let figure = |name: &str, value: f64, unit: &str, beside: Option<String>| KeyFigure {
        name: name.into(),
        value: to_tenth(value),
        unit: unit.into(),
        beside,
    };
    let [before_ml, after_ml] = volume_ml;
    let held_out_mm = tracking.boundary_rms_held_out_mm;
    let held_out = (held_out_mm > 0.0).then(|| format!("points held out: {held_out_mm:.2} mm"));
    let distance = KeyFigure {
        value: format!("{:.2}", tracking.boundary_rms_mm),
        ..figure("Tracked heart to the images' boundary, RMS", 0.0, "mm", held_out)
    };
    let stroke_work = format!("stroke work of the LV: {} mJ", to_tenth(stroke_work_mj(clock, trajectory)));
    vec![
        figure("Volume misfit of the model, RMS", after_ml, "mL", Some(format!("at its start: {} mL", to_tenth(before_ml)))),
        distance,
        figure("Work of the image forces, magnitude", tracking.image_work_mj, "mJ", Some(stroke_work)),
    ]
}

/// What the left ventricle does to its blood in the last beat, `$ W = -\oint p\,dV $` (kPa mL = mJ).
fn stroke_work_mj(clock: &Clock, trajectory: &Trajectory) -> f64 {
    let rows = trajectory.curves.iter().filter(|row| row.time_s >= clock.last_beat_s() - 1e-9);
    let curve: Vec<_> = rows.filter_map(|row| row.ventricle(Ventricle::Left)).collect();
    let step = |pair: &[VentricleCurve]| 0.5 * (pair[0].pressure_kpa + pair[1].pressure_kpa) * (pair[0].volume_ml - pair[1].volume_ml);
    curve.windows(2).map(step).sum()
}

/// A tenth is more than any of these is known to; larger numbers whole.
fn to_tenth(value: f64) -> String {
    let text = if value.abs() >= 200.0 { format!("{value:.0}") } else { format!("{value:.1}") };
    text.replace('-', "−")
}
