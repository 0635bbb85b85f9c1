//! Sensitivity studies from outside: killed, cut off, in parts, on other threads, on a full disk, they leave the same table, bit by bit.

#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

mod common;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use rand::{Rng, SeedableRng};

/// Sixteen beats of a very coarse heart.
const STUDY: &str = r#"
kind = "sensitivity"
[anatomy]
edge_length_mm = 15.0
[anatomy.idealised_lv]
[mechanics]
step_s = 0.02
[simulation]
frames = 4
[sensitivity]
method = "morris"
paths = 4
seed = 3
outputs = ["ejection_fraction_lv", "pressure_peak_lv_mmhg", "segment_7_strain_circumferential_peak"]
[[sensitivity.input]]
name = "contraction_peak_lv_kpa"
lower = 60
upper = 200
[[sensitivity.input]]
name = "fibre_stiffness_kpa"
lower = 70
upper = 140
[[sensitivity.input]]
name = "heart_period_s"
lower = 0.7
upper = 0.9
"#;

/// The study in an empty folder of its own, and the folder of its results.
fn study(name: &str, text: &str) -> (PathBuf, PathBuf) {
    common::fresh_study("many_runs", name, text)
}

fn command(study: &Path, results: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cardiotwin"));
    command.arg("run").arg(study).arg("-o").arg(results).args(["--quiet", "--set", "output.figures=false"]).args(more);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// Exit code and stderr.
fn end(mut command: Command) -> (i32, String) {
    let output = command.stderr(Stdio::piped()).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

fn merge(study: &Path, results: &Path) -> i32 {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cardiotwin"));
    command.arg("merge").arg(study).arg("-o").arg(results).args(["--set", "output.figures=false"]);
    end(command).0
}

/// The tables that must not depend on how they came about.
fn tables(results: &Path) -> [String; 2] {
    ["runs.csv", "indices.csv"].map(|name| std::fs::read_to_string(results.join(name)).unwrap())
}

fn row_count(results: &Path) -> usize {
    std::fs::read_to_string(results.join("runs.csv")).map_or(0, |text| text.lines().count().saturating_sub(1))
}

/// The tables of a run of [`STUDY`] that nothing disturbed, on one thread; its study and its results.
fn undisturbed() -> &'static ([String; 2], PathBuf, PathBuf) {
    static ONCE: OnceLock<([String; 2], PathBuf, PathBuf)> = OnceLock::new();
    ONCE.get_or_init(|| {
        let (study, results) = study("undisturbed", STUDY);
        assert_eq!(end(command(&study, &results, &["--threads", "1"])), (0, String::new()));
        let tables = tables(&results);
        assert_eq!(tables[0].lines().count(), 17);
        (tables, study, results)
    })
}

/// Lets a run add `rows` rows, or end, and a little more, and ends it: by Ctrl-C, which it answers to, or for good.
fn end_after(mut child: Child, results: &Path, rows: usize, more: Duration, is_asked: bool) {
    let target = row_count(results) + rows;
    while row_count(results) < target && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(more);
    if is_asked && child.try_wait().unwrap().is_none() {
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        let code = child.wait().unwrap().code();
        assert!([Some(130), Some(0)].contains(&code), "{code:?}");
    } else {
        let _ = child.kill();
        child.wait().unwrap();
    }
}

#[test]
fn a_run_that_is_killed_at_random_points_ends_as_one_that_is_not() {
    let (study, results) = study("killed", STUDY);
    let (expected, ..) = undisturbed();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    for round in 0..6 {
        let child = command(&study, &results, &["--threads", "2"]).spawn().unwrap();
        let (rows, more) = (rng.random_range(0..4), Duration::from_millis(rng.random_range(0..60)));
        end_after(child, &results, rows, more, round % 2 == 1);
        // What a kill in the midst of a write, or a power cut, would leave.
        if let Ok(bytes) = std::fs::read(results.join("runs.csv")) {
            let cut = rng.random_range(0..60).min(bytes.len());
            std::fs::write(results.join("runs.csv"), &bytes[..bytes.len() - cut]).unwrap();
        }
    }
    assert!(row_count(&results) > 0, "it was killed before there was anything to keep");
    assert_eq!(end(command(&study, &results, &["--threads", "2"])).0, 0);
    assert_eq!(&tables(&results), expected);
}

#[test]
fn parts_on_any_number_of_threads_make_the_whole_and_merging_again_changes_nothing() {
    let (study, results) = study("parts", STUDY);
    let (expected, ..) = undisturbed();
    assert_eq!(end(command(&study, &results, &["--threads", "3", "--shard", "2/3"])).0, 0);
    assert_eq!(end(command(&study, &results, &["--shard", "1/3"])).0, 0);
    assert_eq!(merge(&study, &results), 1, "a part is missing");
    assert_eq!(end(command(&study, &results, &["--threads", "1", "--shard", "3/3"])).0, 0);
    for _ in 0..2 {
        assert_eq!(merge(&study, &results), 0);
        assert_eq!(&tables(&results), expected);
    }
}

/// A file that may not grow beyond 1 kB stands for a full disk: the run says so, and goes on from there when there is room.
#[test]
fn a_full_disk_is_told_and_what_was_written_is_kept() {
    let (study, results) = study("full", STUDY);
    let (expected, ..) = undisturbed();
    let mut full = Command::new("sh");
    full.args(["-c", "trap '' XFSZ; ulimit -f 2; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_cardiotwin"), "run"]);
    full.arg(&study).arg("-o").arg(&results).args(["--quiet", "--threads", "2"]).stdout(Stdio::null());
    let (code, said) = end(full);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("runs.csv; see that its folder is writable and the disk is not full"), "{said}");
    assert!(row_count(&results) > 0);
    assert_eq!(end(command(&study, &results, &[])).0, 0);
    assert_eq!(&tables(&results), expected);
}

/// Folders that nobody can write, not even root: below a file, and in a file system that takes no files.
#[test]
fn a_folder_of_results_that_cannot_be_written_is_told() {
    let (study, _) = study("unwritable", STUDY);
    let cohort = study.with_file_name("cohort.toml");
    std::fs::write(&cohort, "base = \"study.toml\"\n[[patient]]\nname = \"A\"\n").unwrap();
    let places = [study.join("results"), PathBuf::from("/proc/cardiotwin/results")];
    for place in places.iter().filter(|place| !place.starts_with("/proc") || Path::new("/proc/self").exists()) {
        for (word, file) in [("run", &study), ("cohort", &cohort)] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_cardiotwin"));
            command.arg(word).arg(file).arg("-o").arg(place).arg("--quiet").stdout(Stdio::null());
            let (code, said) = end(command);
            assert_eq!(code, 1, "{word} into {}: {said}", place.display());
            assert!(said.contains("cannot make the folder") && said.contains("because: "), "{word} into {}: {said}", place.display());
        }
    }
}

#[test]
fn runs_of_another_study_are_not_taken_for_those_of_this_one() {
    let (study, folder) = study("other", STUDY);
    let (expected, _, done) = undisturbed();
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::copy(done.join("runs.csv"), folder.join("runs.csv")).unwrap();
    for other in ["sensitivity.seed=4", "mechanics.step_s=0.01", "sensitivity.outputs=[\"twist_lv_deg\"]"] {
        let (code, said) = end(command(&study, &folder, &["--set", other]));
        assert_eq!(code, 2, "{other}: {said}");
        assert!(said.contains("holds the runs of another study"), "{said}");
    }
    // Garbled rows are run again, and it is said.
    let garbled = expected[0].replacen("converged", "convinced", 3);
    std::fs::write(folder.join("runs.csv"), garbled).unwrap();
    let (code, said) = end(command(&study, &folder, &[]));
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("3 rows were cut off or garbled; they are run again"), "{said}");
    assert_eq!(&tables(&folder), expected);
}

/// A wall of nearly no stiffness under much contraction fails: such runs are rows, with how far they came and why, and the indices do without.
#[test]
fn runs_that_fail_are_rows_with_their_reason_and_the_indices_cope() {
    let soft = STUDY.replace("paths = 4", "paths = 4\nlevels = 2").replace("upper = 200", "upper = 1000");
    let soft = soft.replace("heart_period_s\"\nlower = 0.7\nupper = 0.9", "transverse_stiffness_kpa\"\nlower = 0.1\nupper = 60");
    let (study, results) = study("fails", &soft);
    assert_eq!(end(command(&study, &results, &[])).0, 0);
    let [runs, indices] = tables(&results);
    let failed: Vec<&str> = runs.lines().filter(|line| line.contains(",failed,")).collect();
    assert!((1..16).contains(&failed.len()), "{runs}");
    let has_reason = |line: &&str| {
        ["the motion has blown up", "compliance is not positive", "constants are not positive"].iter().any(|words| line.contains(words))
    };
    assert!(failed.iter().all(has_reason), "{failed:?}");
    assert!(failed.iter().any(|line| line.contains("isovolumetric_contraction,") || line.contains("ejection,")), "{failed:?}");
    assert!(indices.lines().count() > 1, "{indices}");
    let summary = std::fs::read_to_string(results.join("summary.json")).unwrap();
    assert!(summary.contains(&format!("\"failed_run_count\": {}", failed.len())), "{summary}");
}

#[test]
fn a_cohort_in_which_one_image_is_missing_ends_with_1_and_the_other_is_there() {
    let (study, results) =
        study("cohort", "kind = \"mesh\"\n[anatomy]\nedge_length_mm = 15\n[anatomy.idealised_lv]\n[output]\nmeshes = false\n");
    let cohort = study.with_file_name("cohort.toml");
    let text = "base = \"study.toml\"\n[[patient]]\nname = \"A\"\n[[patient]]\nname = \"B\"\nset = { \"anatomy.labels\" = \"none.nii\" }\n";
    std::fs::write(&cohort, text).unwrap();
    let run = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_cardiotwin"));
        command.args(more).arg(&cohort).arg("-o").arg(&results);
        end(command)
    };
    let (code, said) = run(&["cohort", "--quiet"]);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("warning: B failed") && said.contains("none.nii"), "{said}");
    assert!(results.join("A/summary.json").is_file());
    assert_eq!(run(&["merge"]).0, 1);
    std::fs::write(&cohort, text.replace("none.nii", "none.nii\", wrong = \"yes")).unwrap();
    assert_eq!(run(&["cohort"]).0, 1, "a patient's unknown key is that patient's failure");
    std::fs::write(&cohort, "base = \"study.toml\"\n[[patient]]\nname = \"A\"\nfoot = 1\n").unwrap();
    assert_eq!(run(&["cohort"]).0, 2, "an unknown key of the cohort is not");
}
