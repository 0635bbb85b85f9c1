//! The first study, whole: a heart whose truth is known is imaged, tracked and personalised, and its truth comes back.
//!
//! A failure means that some room of the thread from images to parameters has lost accuracy: compare `recovery` in `summary.json` with
//! the CHANGELOG's numbers, then the tracked volumes (images and tracking) with the model's (calibration).

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use cardiotwin::study::{Config, Overrides, Plan, RunContext, RunError, Silent, StudyError, run};
use serde_json::Value;

fn plan(output: &Path, settings: &[&str]) -> Result<Plan, StudyError> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("studies/01_phantom_recovery/study.toml");
    let settings = settings.iter().map(ToString::to_string).collect();
    let overrides = Overrides { output: Some(output.to_path_buf()), settings, ..Overrides::default() };
    Plan::new(&Config::read(&file, overrides)?)
}

/// Whether every interval of the table holds its true value.
fn intervals_hold(recovery: &Value, table: &Path) -> bool {
    let rows: Vec<HashMap<String, String>> = csv::Reader::from_path(table).unwrap().deserialize().map(Result::unwrap).collect();
    let number = |row: &HashMap<String, String>, column: &str| row[column].parse::<f64>().unwrap();
    recovery["parameters"].as_array().unwrap().iter().all(|parameter| {
        let row = rows.iter().find(|row| parameter["parameter"] == row["parameter"].as_str()).unwrap();
        (number(row, "interval_low")..number(row, "interval_high")).contains(&parameter["truth"].as_f64().unwrap())
    })
}

#[test]
fn the_first_study_gives_back_its_truth_within_what_it_states() {
    let folder = tempfile::tempdir().unwrap();
    run(&plan(folder.path(), &[]).unwrap(), &RunContext::new(&Silent, &AtomicBool::new(false))).unwrap();
    let summary: Value = serde_json::from_str(&std::fs::read_to_string(folder.path().join("summary.json")).unwrap()).unwrap();

    let recovery = &summary["recovery"];
    assert_eq!(recovery["within_tolerance"], true, "{recovery:#}");
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    // The published goal for a synthetic twin with thick slices and noise is 2 mL; with the tracking's bias taken off it is half a millilitre.
    assert!(number(&recovery["volume_model_rms_ml"]) < 0.7, "{recovery:#}");
    assert!(intervals_hold(recovery, &folder.path().join("parameters.csv")), "{recovery:#}");
    assert!(number(&recovery["position_tracked_rmse_mm"]) < 0.3 * number(&recovery["position_no_motion_rmse_mm"]), "{recovery:#}");
    let validation = &summary["validation"][0];
    assert!(number(&validation["dice_tracked"]) > number(&validation["dice_no_motion"]) + 0.2, "{validation:#}");
    // Physiology is the last check.
    let ejection_fraction = number(&summary["ejection_fraction_lv"]);
    assert!((0.4..0.75).contains(&ejection_fraction), "EF {ejection_fraction}");
    let peak_mmhg = number(&summary["pressure_peak_lv_mmhg"]);
    assert!((90.0..150.0).contains(&peak_mmhg), "{peak_mmhg} mmHg");

    for file in [
        "curves.csv",
        "frames.csv",
        "parameters.csv",
        "iterations.csv",
        "base_motion.csv",
        "heart.pvd",
        "volume_lv.png",
        "pressure_volume_lv.png",
        "slices.png",
    ] {
        assert!(folder.path().join(file).is_file(), "{file} is missing");
    }
}

#[test]
fn a_run_that_is_stopped_ends_at_once_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let outcome = run(&plan(folder.path(), &["anatomy.edge_length_mm=8"]).unwrap(), &RunContext::new(&Silent, &AtomicBool::new(true)));
    assert!(matches!(outcome, Err(RunError::Stopped)), "{outcome:?}");
}
