//! What the heart does under other onsets: the figures by which pacing is judged, beside those of its own onset.

use std::sync::Arc;

use serde::Serialize;

use super::clock::Clock;
use super::error::RunError;
use super::forward::{beat, deformation, heart_model, observables, step_count};
use super::patient::Patient;
use super::pictures;
use crate::anatomy::{Anatomy, Ventricle};
use crate::heart::{ActivationTimes, HeartModel, Parameter, Parameters, Trajectory};
use crate::report::figures::{Curve, Look, TimeCurves, time_curves};
use crate::report::write_csv;
use crate::study::plan::{ModelPlan, OWN_ONSET, PredictionPlan};
use crate::study::{Plan, RunContext};
use crate::units::{MS_PER_S, mmhg_from_kpa};

/// Frames of a beat: they resolve when a segment is shortest.
const FRAMES: usize = 160;

/// Looks of the curves of one figure; a further onset is in the table alone.
const LOOKS: [Look; 5] = [Look::Simulated, Look::Artery, Look::Anterior, Look::Other, Look::Inferior];

/// A row of `predictions.csv`: an onset.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the columns of the file, units last")]
struct PredictionRow {
    /// `own`, or the name of a `[[prediction]]`.
    onset: String,
    /// `model`, or `truth` of a phantom.
    heart: &'static str,
    total_activation_time_ms: f64,
    activation_time_lv_ms: f64,
    pressure_rate_max_lv_mmhg_per_s: Option<f64>,
    /// Of that rate, against the same heart's own onset.
    pressure_rate_change_percent: Option<f64>,
    ejection_fraction_lv: Option<f64>,
    stroke_volume_lv_ml: Option<f64>,
    pressure_peak_lv_mmhg: Option<f64>,
    isovolumetric_contraction_lv_ms: Option<f64>,
    mechanical_dispersion_ms: Option<f64>,
    ejection_fraction_rv: Option<f64>,
    pressure_rate_max_rv_mmhg_per_s: Option<f64>,
}

/// A heart that beat under an onset.
struct Beaten {
    name: String,
    model: HeartModel,
    trajectory: Trajectory,
    clock: Clock,
}

/// Runs the plan's predictions with `parameters` on the patient's heart, and on the phantom's true one where there is one, and leaves
/// `predictions.csv`, `prediction_pressure_lv.png`, `prediction_volume_lv.png` and `activation_<name>.png`. Gives a line for whoever ran
/// it, an onset each; nothing where the plan predicts nothing.
pub(super) fn predict(plan: &Plan, patient: &Patient, parameters: &Parameters, context: &RunContext) -> Result<Vec<String>, RunError> {
    if plan.predictions.is_empty() {
        return Ok(Vec::new());
    }
    let start_s = patient.clock(1).start_s;
    let beaten = beats(plan, &patient.anatomy, parameters, start_s, context)?;
    let mut rows = rows("model", &beaten);
    if let Some(truth) = &patient.truth {
        rows.extend(self::rows("truth", &beats(plan, &truth.anatomy, &truth.parameters, patient.reference_s, context)?));
    }
    write_csv(&plan.output.directory.join("predictions.csv"), &rows)?;
    if plan.output.figures {
        draw(plan, &beaten)?;
    }
    Ok(rows.iter().filter_map(headline).collect())
}

/// The heart under its own onset, then under those of the plan.
fn beats(
    plan: &Plan,
    anatomy: &Arc<Anatomy>,
    parameters: &Parameters,
    start_s: f64,
    context: &RunContext,
) -> Result<Vec<Beaten>, RunError> {
    let own = PredictionPlan { name: OWN_ONSET.into(), onset: plan.model.onset.clone() };
    let period_s = parameters[Parameter::HeartPeriod];
    let times_s: Vec<f64> = (0..FRAMES).map(|frame| start_s + period_s * frame as f64 / FRAMES as f64).collect();
    let one = |prediction: &PredictionPlan| -> Result<Beaten, RunError> {
        let clock = Clock::new(0, &times_s, period_s, plan.simulation.beats.count());
        context.progress().stage(&format!("predicting {}", prediction.name), Some(step_count(&clock, plan.model.step_s)));
        let model = heart_model(&ModelPlan { onset: prediction.onset.clone(), ..plan.model.clone() }, anatomy, parameters.clone())?;
        let trajectory = beat(&model, &clock, &[], context)?;
        if trajectory.stopped { Err(RunError::Stopped) } else { Ok(Beaten { name: prediction.name.clone(), model, trajectory, clock }) }
    };
    std::iter::once(&own).chain(&plan.predictions).map(one).collect()
}

fn rows(heart: &'static str, beaten: &[Beaten]) -> Vec<PredictionRow> {
    let rows: Vec<_> = beaten.iter().map(|one| row(heart, one)).collect();
    let own_rate = rows.first().and_then(|row| row.pressure_rate_max_lv_mmhg_per_s);
    let change = |mut row: PredictionRow| {
        row.pressure_rate_change_percent =
            row.pressure_rate_max_lv_mmhg_per_s.zip(own_rate).map(|(rate, own_rate)| 100.0 * (rate / own_rate - 1.0));
        row
    };
    rows.into_iter().map(change).collect()
}

fn row(heart: &'static str, Beaten { name, model, trajectory, clock }: &Beaten) -> PredictionRow {
    let figures = observables(trajectory, clock);
    let of = |ventricle: Ventricle| figures.iter().find(|(which, _)| *which == ventricle).map(|(_, figures)| figures);
    let (left, right) = (of(Ventricle::Left), of(Ventricle::Right));
    let activation = ActivationTimes::new(model.anatomy(), model.activation());
    let dispersion_s = deformation(model, trajectory, clock).and_then(|beat| beat.mechanical_dispersion_s());
    PredictionRow {
        onset: name.clone(),
        heart,
        total_activation_time_ms: activation.total_s * MS_PER_S,
        activation_time_lv_ms: activation.left_s * MS_PER_S,
        pressure_rate_max_lv_mmhg_per_s: left.map(|o| o.pressure_rate_max_mmhg_per_s),
        pressure_rate_change_percent: None,
        ejection_fraction_lv: left.map(|o| o.ejection_fraction),
        stroke_volume_lv_ml: left.map(|o| o.stroke_volume_ml),
        pressure_peak_lv_mmhg: left.map(|o| o.pressure_peak_mmhg),
        isovolumetric_contraction_lv_ms: left.map(|o| o.isovolumetric_contraction_ms),
        mechanical_dispersion_ms: dispersion_s.map(|dispersion_s| dispersion_s * MS_PER_S),
        ejection_fraction_rv: right.map(|o| o.ejection_fraction),
        pressure_rate_max_rv_mmhg_per_s: right.map(|o| o.pressure_rate_max_mmhg_per_s),
    }
}

fn headline(row: &PredictionRow) -> Option<String> {
    Some(format!(
        "{} ({}): activation {:.0} ms, dP/dt max {:.0} mmHg/s ({:+.1} %), EF {:.1} %, dispersion {:.0} ms",
        row.onset,
        row.heart,
        row.total_activation_time_ms,
        row.pressure_rate_max_lv_mmhg_per_s?,
        row.pressure_rate_change_percent?,
        100.0 * row.ejection_fraction_lv?,
        row.mechanical_dispersion_ms?
    ))
}

fn draw(plan: &Plan, beaten: &[Beaten]) -> Result<(), RunError> {
    let folder = &plan.output.directory;
    let curves = |value: fn(&crate::heart::VentricleCurve) -> f64| {
        let curve = |(one, look): (&Beaten, Look)| {
            let trigger_s = one.clock.last_trigger_s();
            let rows = one.trajectory.curves.iter().filter(|row| row.time_s >= one.clock.last_beat_s() - 1e-9);
            let points = rows.filter_map(|row| Some((row.time_s - trigger_s, value(&row.ventricle(Ventricle::Left)?)))).collect();
            Curve { name: one.name.clone(), look, points }
        };
        beaten.iter().zip(LOOKS).map(curve).collect::<Vec<_>>()
    };
    let title = "LV pressure under each onset".to_owned();
    let pressures = TimeCurves { title, quantity: "LV pressure (mmHg)".into(), curves: curves(|c| mmhg_from_kpa(c.pressure_kpa)) };
    time_curves(&folder.join("prediction_pressure_lv.png"), &pressures)?;
    let title = "LV volume under each onset".to_owned();
    let volumes = TimeCurves { title, quantity: "LV volume (mL)".into(), curves: curves(|c| c.volume_ml) };
    time_curves(&folder.join("prediction_volume_lv.png"), &volumes)?;
    for one in beaten {
        pictures::activation(&folder.join(format!("activation_{}.png", one.name)), &one.model, &format!("Activation, {}", one.name))?;
    }
    Ok(())
}
