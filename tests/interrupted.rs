//! Ctrl-C through the binary: the run ends at its next step with exit code 130, its summary says that it was stopped, nothing half-written is left, and
//! the same run goes to its end afterwards.

#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

mod common;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn fresh_folder(name: &str) -> PathBuf {
    common::fresh_folder("interrupted", name)
}

/// Every file below a folder.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() { files.extend(files_below(&entry)) } else { files.push(entry) }
    }
    files
}

fn cardiotwin(study: &Path, settings: &[&str]) -> Command {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("cardiotwin"));
    command.arg("run").arg(study).arg("--json-progress").args(settings.iter().flat_map(|setting| ["--set", setting]));
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// Runs a study, presses Ctrl-C as soon as `stage` has taken a step, looks at what is left, and runs it again with `quick` settings.
fn stopped_and_run_again(name: &str, text: &str, stage: &str, endless: &[&str], quick: &[&str]) {
    let folder = fresh_folder(name);
    let study = folder.join("study.toml");
    std::fs::write(&study, text).unwrap();
    let results = folder.join("results");
    // What an earlier run left must not pass for the result of this one.
    std::fs::create_dir(&results).unwrap();
    std::fs::write(results.join("summary.json"), "{\"status\": \"converged\"}").unwrap();
    std::fs::write(results.join("report.html"), "Finished.").unwrap();

    let mut run = cardiotwin(&study, endless).spawn().unwrap();
    let mut lines = BufReader::new(run.stderr.take().unwrap()).lines().map(Result::unwrap);
    let is_under_way = |line: &String| line.contains("\"progress\"") && line.contains(&format!("\"stage\":\"{stage}\""));
    assert!(lines.any(|line| is_under_way(&line)), "{name}: \"{stage}\" never took a step");
    assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
    let rest: Vec<String> = lines.collect();
    assert_eq!(run.wait().unwrap().code(), Some(130), "{rest:?}");

    let summary = |file: &Path| -> serde_json::Value { serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap() };
    assert_eq!(summary(&results.join("summary.json"))["status"], "stopped");
    let report = || std::fs::read_to_string(results.join("report.html")).unwrap();
    assert!(report().contains("Stopped by hand") && report().trim_end().ends_with("</html>"), "{name}");
    for file in files_below(&folder) {
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        assert!(!name.starts_with(".writing-"), "{name} is left");
        let whole = std::fs::read(&file).unwrap();
        assert!(!whole.is_empty(), "{name} is empty");
        if name.ends_with(".csv") {
            let rows: Vec<usize> = String::from_utf8(whole).unwrap().lines().map(|line| line.matches(',').count()).collect();
            assert!(rows.iter().all(|cells| *cells == rows[0]), "{name} has a row that was cut off");
        }
    }

    let again = cardiotwin(&study, quick).output().unwrap();
    assert_eq!(again.status.code(), Some(0), "{}", String::from_utf8_lossy(&again.stderr));
    assert_eq!(summary(&results.join("summary.json"))["status"], "converged");
    assert!(report().contains("Finished."), "{name}");
}

const HEART: &str = "[anatomy]\nedge_length_mm = 12.0\n[anatomy.idealised_lv]\n[output]\nfigures = false\n[mechanics]\nstep_s = 0.02\n";

#[test]
fn a_simulation_is_stopped_and_run_again() {
    let endless = ["mechanics.step_s=0.0001", "simulation.beats=500"];
    stopped_and_run_again("simulate", &format!("kind = \"simulate\"\n{HEART}"), "beating", &endless, &[]);
}

const TRACKING: &str = "[phantom]\nframes = 6\nvoxel_size_mm = 3.0\n";

#[test]
fn a_tracked_beat_is_stopped_and_run_again() {
    let text = format!("kind = \"track\"\n{HEART}{TRACKING}");
    stopped_and_run_again("track", &text, "tracking the images", &["mechanics.step_s=0.0005"], &[]);
}

/// A study that is stopped between its runs shows those that are done, and goes on with the others.
#[test]
fn a_screening_is_stopped_and_goes_on() {
    let text = format!(
        "kind = \"sensitivity\"\n{HEART}[sensitivity]\nmethod = \"morris\"\npaths = 40\noutputs = [\"ejection_fraction_lv\"]\n\
         [[sensitivity.input]]\nname = \"contraction_peak_lv_kpa\"\nlower = 60\nupper = 200\n\
         [[sensitivity.input]]\nname = \"heart_period_s\"\nlower = 0.7\nupper = 0.9\n"
    );
    stopped_and_run_again("sensitivity", &text, "running the heart", &[], &[]);
}

/// The second Ctrl-C ends a program that is busy writing a large file, at once and without a trace of that file.
#[test]
fn a_second_ctrl_c_leaves_nothing_half_written() {
    let folder = fresh_folder("twice");
    let study = folder.join("study.toml");
    let images = "[phantom]\nframes = 20\nvoxel_size_mm = 2.0\nslice_thickness_mm = 2.0\n";
    std::fs::write(&study, format!("kind = \"phantom\"\n{HEART}{images}")).unwrap();
    let mut run = cardiotwin(&study, &[]).spawn().unwrap();
    let mut lines = BufReader::new(run.stderr.take().unwrap()).lines().map(Result::unwrap);
    let half_written = || files_below(&folder).into_iter().filter(|file| file.to_string_lossy().contains(".writing-")).count();
    while half_written() == 0 {
        assert!(run.try_wait().unwrap().is_none(), "it ended before anything was seen to be written");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let press = || assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
    press();
    assert!(lines.any(|line| line.contains("Ctrl-C again ends at once")), "the first was not heard");
    press();
    assert_eq!(run.wait().unwrap().code(), Some(130));
    assert_eq!(half_written(), 0);
    assert!(!folder.join("results/cine.nii.gz").exists() && !folder.join("results/summary.json").exists(), "it was not at once");
}

#[test]
fn the_images_of_a_phantom_are_stopped_and_made_again() {
    let text = format!("kind = \"phantom\"\n{HEART}[phantom]\nframes = 6\nvoxel_size_mm = 3.0\n");
    stopped_and_run_again("phantom", &text, "beating the true heart", &["mechanics.step_s=0.0001"], &[]);
}
