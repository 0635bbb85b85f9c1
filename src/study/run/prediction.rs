//! What the heart does under other onsets: the figures by which pacing is judged, beside those of its own onset.

use std::sync::Arc;

use serde::Serialize;

use super::clock::Clock;
use super::error::RunError;
use super::forward::{beat, deformation, heart_model, observables, step_count};
use super::patient::Patient;
use super::pictures;
use super::synthetic::Truth;
use super::wall::{SegmentRow, segment_rows};
use crate::anatomy::{Anatomy, Ventricle};
use crate::heart::{ActivationTimes, HeartModel, Parameter, Parameters, Trajectory, VentricleCurve};
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
pub(super) struct PredictionRow {
    /// `own`, or the name of a `[[prediction]]`.
    pub(super) onset: String,
    /// `model`, or `truth` of a phantom.
    heart: &'static str,
    pub(super) total_activation_time_ms: f64,
    pub(super) activation_time_lv_ms: f64,
    pub(super) pressure_rate_max_lv_mmhg_per_s: Option<f64>,
    /// Of that rate, against the same heart's own onset.
    pub(super) pressure_rate_change_percent: Option<f64>,
    pub(super) ejection_fraction_lv: Option<f64>,
    pub(super) stroke_volume_lv_ml: Option<f64>,
    pub(super) pressure_peak_lv_mmhg: Option<f64>,
    isovolumetric_contraction_lv_ms: Option<f64>,
    pub(super) mechanical_dispersion_ms: Option<f64>,
    ejection_fraction_rv: Option<f64>,
    pressure_rate_max_rv_mmhg_per_s: Option<f64>,
}

/// A heart that beat under an onset.
pub(super) struct Beaten {
    pub(super) name: String,
    pub(super) model: HeartModel,
    trajectory: Trajectory,
    clock: Clock,
}

/// A heart under its own onset, then under those of the plan; of a phantom, its true heart under the same ones too.
pub(super) struct Predictions {
    pub(super) beaten: Vec<Beaten>,
    /// A row of `predictions.csv` for every one of them.
    pub(super) rows: Vec<PredictionRow>,
    /// Rows of the true heart; none but of a phantom.
    pub(super) truth: Vec<PredictionRow>,
}

/// Runs the plan's predictions with `parameters` on the patient's heart, and on the phantom's true one where there is one. None where
/// the plan predicts nothing, or where that was stopped.
pub(super) fn predict(
    plan: &Plan,
    patient: &Patient,
    parameters: &Parameters,
    context: &RunContext,
) -> Result<Option<Predictions>, RunError> {
    if plan.predictions.is_empty() {
        return Ok(None);
    }
    let made = || -> Result<Predictions, RunError> {
        let beaten = beats(plan, &patient.anatomy, parameters, patient.clock(1).start_s, context)?;
        let of_truth = |truth: &Truth| beats(plan, &truth.anatomy, &truth.parameters, patient.reference_s, context);
        let truth = patient.truth.as_ref().map(of_truth).transpose()?.unwrap_or_default();
        Ok(Predictions { rows: rows("model", &beaten), beaten, truth: rows("truth", &truth) })
    };
    match made() {
        Err(RunError::Stopped) => Ok(None),
        other => other.map(Some),
    }
}

/// What is to be said where predictions were asked for and are not there.
pub(super) fn missing_predictions(plan: &Plan, predictions: Option<&Predictions>) -> Option<String> {
    let is_missing = !plan.predictions.is_empty() && predictions.is_none();
    is_missing.then(|| "stopped before the predictions were made: there are none here".into())
}

impl Predictions {
    /// Leaves `predictions.csv`, `prediction_pressure_lv.png`, `prediction_volume_lv.png` and `activation_<name>.png`.
    pub(super) fn leave(&self, plan: &Plan) -> Result<(), RunError> {
        let folder = &plan.output.directory;
        write_csv(&folder.join("predictions.csv"), &self.all_rows().collect::<Vec<_>>())?;
        if plan.output.figures {
            time_curves(&folder.join("prediction_pressure_lv.png"), &self.pressures())?;
            time_curves(&folder.join("prediction_volume_lv.png"), &self.volumes())?;
            for one in &self.beaten {
                let file = folder.join(format!("activation_{}.png", one.name));
                pictures::activation(&file, &one.model, &format!("Activation, {}", one.name))?;
            }
        }
        Ok(())
    }

    fn all_rows(&self) -> impl Iterator<Item = &PredictionRow> {
        self.rows.iter().chain(&self.truth)
    }

    /// A line for whoever ran it, an onset and a heart each.
    pub(super) fn headlines(&self) -> Vec<String> {
        self.all_rows().filter_map(headline).collect()
    }

    /// Pressures of the left ventricle.
    pub(super) fn pressures(&self) -> TimeCurves {
        let curves = self.curves(|curve| mmhg_from_kpa(curve.pressure_kpa));
        TimeCurves { title: "LV pressure under each onset".into(), quantity: "LV pressure (mmHg)".into(), curves }
    }

    /// Volumes of the left ventricle.
    pub(super) fn volumes(&self) -> TimeCurves {
        let curves = self.curves(|curve| curve.volume_ml);
        TimeCurves { title: "LV volume under each onset".into(), quantity: "LV volume (mL)".into(), curves }
    }

    fn curves(&self, value: fn(&VentricleCurve) -> f64) -> Vec<Curve> {
        let curve = |(one, look): (&Beaten, Look)| {
            let points = one.last_beat().map(|(time_s, curve)| (time_s, value(&curve))).collect();
            let name = onset_in_words(&one.name);
            Curve { name, look, points }
        };
        self.beaten.iter().zip(LOOKS).map(curve).collect()
    }
}

impl Beaten {
    /// The left ventricle in the last beat, by s after the trigger.
    fn last_beat(&self) -> impl Iterator<Item = (f64, VentricleCurve)> {
        let (from_s, trigger_s) = (self.clock.last_beat_s() - 1e-9, self.clock.last_trigger_s());
        let rows = self.trajectory.curves.iter().filter(move |row| row.time_s >= from_s);
        rows.filter_map(move |row| Some((row.time_s - trigger_s, row.ventricle(Ventricle::Left)?)))
    }

    /// What its wall does, by segment; none without frames.
    pub(super) fn segments(&self) -> Vec<SegmentRow> {
        let deformation = deformation(&self.model, &self.trajectory, &self.clock);
        deformation.map(|beat| segment_rows(&self.model, &beat)).unwrap_or_default()
    }
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

/// An onset as it is said.
pub(super) fn onset_in_words(onset: &str) -> String {
    match onset {
        OWN_ONSET => "own onset".into(),
        "lbbb" => "LBBB".into(),
        name => name.replace('_', " ").replace("rv ", "RV "),
    }
}

fn headline(row: &PredictionRow) -> Option<String> {
    Some(format!(
        "Under {} ({}): activation {:.0} ms, dP/dt max {:.0} mmHg/s ({:+.1} %), EF {:.1} %, dispersion {:.0} ms",
        onset_in_words(&row.onset),
        row.heart,
        row.total_activation_time_ms,
        row.pressure_rate_max_lv_mmhg_per_s?,
        row.pressure_rate_change_percent?,
        100.0 * row.ejection_fraction_lv?,
        row.mechanical_dispersion_ms?
    ))
}
