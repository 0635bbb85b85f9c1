//! First steps with one's own data, from outside: `init` writes study files that pass `check`, `cite` names what was used, completions are scripts,
//! and programs can listen to a run.

#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may stop at the first surprise, and says what it could not look at")]

mod common;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use assert_cmd::Command;

/// Exit code, stdout and stderr of a command run in a folder.
fn cardiotwin(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = Command::cargo_bin("cardiotwin").unwrap().current_dir(folder).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

fn fresh_folder(name: &str) -> PathBuf {
    common::fresh_folder("first_steps", name)
}

/// The files of a coarse phantom of two ventricles: cine, labels of every frame, labels of two frames, a mesh.
fn phantom() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = fresh_folder("phantom");
        let study = "kind = \"phantom\"\n[anatomy]\nedge_length_mm = 9.0\n[anatomy.idealised_biventricle]\n[mechanics]\nstep_s = 0.02\n\
                     [phantom]\nframes = 6\nvoxel_size_mm = 3.0\nseed = 3\n[output]\nfigures = false\n";
        std::fs::write(folder.join("phantom.toml"), study).unwrap();
        let (code, _, err) = cardiotwin(&folder, &["run", "phantom.toml", "-o", ".", "-q"]);
        assert_eq!(code, 0, "{err}");
        folder
    })
}

/// Writes a study for some files of the phantom into a folder beside it; it must pass `check`, whose words are returned with the file.
fn init(name: &str, files: &[&str]) -> (String, String, String) {
    let folder = fresh_folder(name);
    let files: Vec<String> = files
        .iter()
        .map(|file| if file.contains(".nii") || file.contains(".vtu") { format!("../phantom/{file}") } else { file.to_string() })
        .collect();
    let arguments: Vec<&str> = std::iter::once("init").chain(files.iter().map(String::as_str)).collect();
    phantom();
    let (code, out, err) = cardiotwin(&folder, &arguments);
    assert_eq!(code, 0, "{err}");
    let (code, check, err) = cardiotwin(&folder, &["check", "study.toml"]);
    assert_eq!(code, 0, "{err}");
    (std::fs::read_to_string(folder.join("study.toml")).unwrap(), out, check)
}

fn has_lines(text: &str, lines: &[&str]) {
    for line in lines {
        assert!(text.lines().any(|found| found == *line), "`{line}` is missing in:\n{text}");
    }
}

#[test]
fn a_cine_and_labels_become_a_personalisation_whose_frame_and_codes_were_looked_up() {
    let (study, said, check) = init("cine", &["labels_end_systole.nii.gz", "cine.nii.gz", "labels_reference.nii.gz"]);
    has_lines(
        &study,
        &[
            "kind = \"personalise\"",
            "data = \"../phantom\"",
            "labels = \"labels_reference.nii.gz\"",
            "code_cavity_rv = 3",
            "cine = \"cine.nii.gz\"",
            "labels = \"labels_end_systole.nii.gz\"",
        ],
    );
    // The phantom's labels were drawn on its first frame and on that of the least volume.
    let volumes = std::fs::read_to_string(phantom().join("volumes.csv")).unwrap();
    let column =
        volumes.lines().next().unwrap().split(',').position(|name| name.starts_with("volume_lv") || name.contains("_lv_ml")).unwrap();
    let volume = |line: &str| line.split(',').nth(column).unwrap().parse::<f64>().unwrap();
    let least = volumes.lines().skip(1).enumerate().min_by(|a, b| volume(a.1).total_cmp(&volume(b.1))).unwrap().0;
    has_lines(&study, &["frame = 0", &format!("frame = {least}")]);
    for words in ["cine      ", "6 frames of ", "heart period 8", "LV blood 1, wall 2, RV blood 3", "judge     "] {
        assert!(said.contains(words), "`{words}` is missing in:\n{said}");
    }
    assert!(check.contains("(personalise)") && check.contains("RV cavity 3"), "{check}");
}

#[test]
fn labels_of_every_frame_are_the_anatomy_and_the_volume_curve() {
    let (study, said, _) = init("every_frame", &["cine.nii.gz", "labels.nii.gz"]);
    has_lines(&study, &["labels = \"labels.nii.gz\"", "volumes = \"labels.nii.gz\"", "volumes_code_cavity_lv = 1"]);
    assert!(said.contains("end-diastole, where the labelled cavity is the largest"), "{said}");
    assert!(!study.lines().any(|line| line.starts_with("label_slices")), "all slices show the ventricle");
}

#[test]
fn a_drawing_or_a_mesh_alone_becomes_a_free_heart() {
    let (study, ..) = init("labels", &["labels_reference.nii.gz", "--frame", "4"]);
    has_lines(&study, &["kind = \"simulate\"", "frame = 4", "code_cavity_lv = 1", "code_wall_lv = 2"]);
    let (study, _, check) = init("mesh", &["heart/000.vtu"]);
    has_lines(&study, &["mesh = \"000.vtu\"", "unit = \"mm\"", "fibre_field = \"fibre\""]);
    assert!(check.contains("mesh 000.vtu in mm; fibres its own"), "{check}");
}

#[test]
fn what_makes_no_study_is_told_the_remedy_and_nothing_is_overwritten() {
    let folder = fresh_folder("refused");
    let phantom = phantom();
    let at = |file: &str| phantom.join(file).to_string_lossy().into_owned();
    let refused = |arguments: &[&str], words: &str| {
        let (code, out, err) = cardiotwin(&folder, &[&["init"], arguments].concat());
        assert_eq!((code, out.as_str()), (2, ""), "{err}");
        assert!(err.contains(words), "`{words}` is missing in:\n{err}");
    };
    refused(&[], "no file was given; name a cine and the labels");
    refused(&[&at("cine.nii.gz")], "nobody has drawn the heart; add a label map");
    refused(&[&at("cine.nii.gz"), &at("cine.nii.gz")], "are cines; give one of them");
    refused(&[&at("labels.nii.gz"), &at("heart/000.vtu")], "the heart has one shape");
    refused(&[&at("phantom.toml")], "phantom.toml");
    refused(&["--epicardium", &at("labels.nii.gz")], "--endocardium-lv");
    std::fs::write(folder.join("study.toml"), "mine").unwrap();
    refused(&[&at("labels_reference.nii.gz")], "study.toml is there already; name another file with -o FILE, or add --force");
    assert_eq!(std::fs::read_to_string(folder.join("study.toml")).unwrap(), "mine");
    assert_eq!(cardiotwin(&folder, &["init", &at("labels_reference.nii.gz"), "--force"]).0, 0);
    assert!(std::fs::read_to_string(folder.join("study.toml")).unwrap().contains("kind = \"simulate\""));
}

#[test]
fn real_drawings_are_given_back_to_their_frames() {
    let Some(data) = common::real_data("sunnybrook_SCD0000201") else { return };
    let folder = fresh_folder("real");
    let at = |file: &str| data.join(file).to_string_lossy().into_owned();
    let files = ["cine_sax_crop.nii.gz", "labels_ES_crop.nii.gz", "labels_ED_crop.nii.gz", "meta.json"].map(at);
    let arguments: Vec<&str> = std::iter::once("init").chain(files.iter().map(String::as_str)).collect();
    let (code, _, err) = cardiotwin(&folder, &arguments);
    assert_eq!(code, 0, "{err}");
    let study = std::fs::read_to_string(folder.join("study.toml")).unwrap();
    // The expert drew end-diastole on frame 19 of 20 and end-systole on frame 6; neighbours look alike.
    let frames: Vec<i64> = study.lines().filter_map(|line| line.strip_prefix("frame = ")).map(|frame| frame.parse().unwrap()).collect();
    let apart = |found: i64, drawn: i64| (found - drawn).rem_euclid(20).min((drawn - found).rem_euclid(20));
    assert!(frames.len() == 2 && apart(frames[0], 19) <= 2 && apart(frames[1], 6) <= 2, "{frames:?}");
    has_lines(&study, &["timing = \"meta.json\"", "labels = \"labels_ED_crop.nii.gz\""]);
    assert_eq!(cardiotwin(&folder, &["check", "study.toml"]).0, 0);
}

/// Automatic contours of every frame that leave the ventricle above slice 13: those slices are left out, and end-diastole is the one that was found by eye.
#[test]
fn contours_that_leave_the_ventricle_do_not_choose_its_start() {
    let Some(data) = common::real_data("sri_E774") else { return };
    let folder = fresh_folder("animal");
    let files = ["cine_sax_crop.nii.gz", "labels_lv_auto_all_frames_crop.nii.gz", "meta.json"].map(|file| data.join(file));
    let arguments: Vec<&str> = std::iter::once("init").chain(files.iter().map(|file| file.to_str().unwrap())).collect();
    let (code, said, err) = cardiotwin(&folder, &arguments);
    assert_eq!(code, 0, "{err}");
    let study = std::fs::read_to_string(folder.join("study.toml")).unwrap();
    has_lines(&study, &["frame = 1", "label_slices = [0, 13]", "volumes_slices = [0, 13]"]);
    assert!(said.contains("80.9 mL; the least is 57.1 mL on frame 11") && said.contains("slices    0 to 13"), "{said}");
    assert_eq!(cardiotwin(&folder, &["check", "study.toml"]).0, 0);
}

#[test]
fn a_study_is_cited_by_what_it_uses() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let cited = |study: &str| {
        let (code, out, err) = cardiotwin(root, &["cite", study]);
        assert_eq!(code, 0, "{err}");
        out
    };
    let (patient, swept) = (cited("studies/01_phantom_recovery/study.toml"), cited("studies/16_sensitivity_ejection_fraction/study.toml"));
    for key in ["@software{cardiotwin,", "@inproceedings{Billet2009,", "{Ourselin2000,", "{Goulart2024,"] {
        assert!(patient.contains(key), "{key} is missing in:\n{patient}");
    }
    assert!(!patient.contains("{Jansen1999,") && swept.contains("{Jansen1999,") && !swept.contains("{Ourselin2000,"), "{swept}");
    assert_eq!(patient.matches('{').count(), patient.matches('}').count());
}

#[test]
fn completions_know_every_command() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for shell in ["bash", "zsh", "fish"] {
        let (code, script, err) = cardiotwin(root, &["completions", shell]);
        assert_eq!(code, 0, "{err}");
        for command in ["run", "cohort", "merge", "init", "check", "cite", "info", "mesh", "volumes", "follow", "parameters", "completions"]
        {
            assert!(script.contains(command), "{command} is missing in the completions of {shell}");
        }
    }
    let loaded = std::process::Command::new("bash")
        .args(["-c", "source /dev/stdin && complete -p cardiotwin"])
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn();
    let Ok(mut bash) = loaded else {
        eprintln!("SKIPPED: no bash to load its completions");
        return;
    };
    let script = cardiotwin(root, &["completions", "bash"]).1;
    std::io::Write::write_all(&mut bash.stdin.take().unwrap(), script.as_bytes()).unwrap();
    let output = bash.wait_with_output().unwrap();
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("cardiotwin"), "{output:?}");
}

/// A free beat of a coarse heart, in a second.
const BEAT: &str = "kind = \"simulate\"\n[anatomy]\nedge_length_mm = 12.0\n[anatomy.idealised_lv]\n[mechanics]\nstep_s = 0.01\n[output]\nfigures = false\n";

#[test]
fn programs_hear_stages_progress_warnings_and_errors_as_json_lines() {
    let folder = fresh_folder("json");
    std::fs::write(folder.join("beat.toml"), BEAT).unwrap();
    let lines = |arguments: &[&str]| {
        let (code, _, err) = cardiotwin(&folder, arguments);
        let lines: Vec<serde_json::Value> =
            err.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}"))).collect();
        (code, lines)
    };
    let (code, told) = lines(&["run", "beat.toml", "--json-progress"]);
    assert_eq!(code, 0);
    let stages: Vec<&str> = told.iter().filter(|line| line["event"] == "stage").map(|line| line["stage"].as_str().unwrap()).collect();
    assert_eq!(stages, ["building the anatomy", "activating and assembling", "beating", "writing results"]);
    let last = told.iter().rfind(|line| line["event"] == "progress" && line["stage"] == "beating").unwrap();
    assert!(last["done"] == last["total"] && last["eta_s"] == 0.0 && last["elapsed_s"].as_f64().unwrap() > 0.0, "{last}");
    assert_eq!(told.iter().filter(|line| line["event"] == "done").count(), stages.len());
    let (code, told) = lines(&["run", "none.toml", "--json-progress"]);
    assert!(code == 2 && told.len() == 1 && told[0]["event"] == "error", "{told:?}");
    assert!(told[0]["text"].as_str().unwrap().contains("cannot read the study file none.toml"), "{told:?}");
}

#[test]
fn verbose_says_first_what_will_be_done_and_quiet_says_nothing() {
    let folder = fresh_folder("verbose");
    std::fs::write(folder.join("beat.toml"), BEAT).unwrap();
    let (code, _, err) = cardiotwin(&folder, &["run", "beat.toml", "--verbose"]);
    assert!(code == 0 && err.starts_with("study       ") && err.contains("model       step 0.01 s"), "{err}");
    assert_eq!(cardiotwin(&folder, &["run", "beat.toml", "--quiet"]), (0, String::new(), String::new()));
    assert_eq!(cardiotwin(&folder, &["run", "beat.toml", "--quiet", "--verbose"]).0, 2);
}
