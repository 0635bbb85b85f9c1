//! `beats.csv`: every beat of a run, own and extra ones, from its depolarisation to the next.

use std::path::Path;

use serde::Serialize;

use super::error::RunError;
use crate::anatomy::Ventricle;
use crate::heart::{EachBeat, HeartModel, Trajectory};
use crate::report::write_csv;
use crate::units::MS_PER_S;

/// A row of `beats.csv`.
#[derive(Debug, Clone, Serialize)]
pub(super) struct BeatRow {
    beat: usize,
    start_s: f64,
    end_s: f64,
    total_activation_time_ms: f64,
    end_diastolic_volume_lv_ml: Option<f64>,
    end_systolic_volume_lv_ml: Option<f64>,
    stroke_volume_lv_ml: Option<f64>,
    pressure_peak_lv_mmhg: Option<f64>,
    end_diastolic_volume_rv_ml: Option<f64>,
    end_systolic_volume_rv_ml: Option<f64>,
    stroke_volume_rv_ml: Option<f64>,
    pressure_peak_rv_mmhg: Option<f64>,
}

/// Writes the beats of a trajectory.
pub(super) fn write_each_beat(folder: &Path, model: &HeartModel, trajectory: &Trajectory) -> Result<(), RunError> {
    Ok(write_csv(&folder.join("beats.csv"), &beat_rows(model, trajectory))?)
}

/// The beats of a trajectory.
pub(super) fn beat_rows(model: &HeartModel, trajectory: &Trajectory) -> Vec<BeatRow> {
    let beats_of = |ventricle| EachBeat::of_rhythm(&trajectory.curves, model.rhythm(), ventricle);
    let (left, right) = (beats_of(Ventricle::Left), beats_of(Ventricle::Right));
    let row = |beat: usize| {
        let (lv, rv) = (left.get(beat), right.get(beat));
        let any = lv.or(rv)?;
        Some(BeatRow {
            beat: beat + 1,
            start_s: any.depolarisation.start_s,
            end_s: any.end_s,
            total_activation_time_ms: (any.depolarisation.end_s - any.depolarisation.start_s) * MS_PER_S,
            end_diastolic_volume_lv_ml: lv.map(|b| b.end_diastolic_volume_ml),
            end_systolic_volume_lv_ml: lv.map(|b| b.end_systolic_volume_ml),
            stroke_volume_lv_ml: lv.map(EachBeat::stroke_volume_ml),
            pressure_peak_lv_mmhg: lv.map(|b| b.pressure_peak_mmhg),
            end_diastolic_volume_rv_ml: rv.map(|b| b.end_diastolic_volume_ml),
            end_systolic_volume_rv_ml: rv.map(|b| b.end_systolic_volume_ml),
            stroke_volume_rv_ml: rv.map(EachBeat::stroke_volume_ml),
            pressure_peak_rv_mmhg: rv.map(|b| b.pressure_peak_mmhg),
        })
    };
    (0..left.len().max(right.len())).filter_map(row).collect()
}
