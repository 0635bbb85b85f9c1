//! The binary from outside: what it prints, which exit code it ends with, and what it says to bad input.

#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may stop at the first surprise, and says what it could not look at")]

mod common;

use std::path::{Path, PathBuf};

use assert_cmd::Command;

const PHANTOM: &str = "studies/01_phantom_recovery/study.toml";

/// Exit code, stdout and stderr of a command.
struct Answer {
    code: i32,
    out: String,
    err: String,
}

fn cardiotwin(arguments: &[&str]) -> Answer {
    let mut command = Command::cargo_bin("cardiotwin").unwrap();
    let output = command.current_dir(env!("CARGO_MANIFEST_DIR")).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Answer { code: output.status.code().unwrap(), out: text(output.stdout), err: text(output.stderr) }
}

/// A study file of this text in a folder of its own.
fn study(name: &str, text: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("interface").join(name);
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("study.toml");
    std::fs::write(&file, text).unwrap();
    file
}

/// The study file is refused with exit code 2 and these words, and nothing is printed to stdout.
fn refused(name: &str, text: &str, words: &[&str]) {
    let file = study(name, text);
    let answer = cardiotwin(&["check", file.to_str().unwrap()]);
    assert_eq!((answer.code, answer.out.as_str()), (2, ""), "{}", answer.err);
    for word in words {
        assert!(answer.err.contains(word), "`{word}` is missing in:\n{}", answer.err);
    }
}

#[test]
fn help_names_every_command_and_the_exit_codes() {
    let answer = cardiotwin(&["--help"]);
    assert_eq!(answer.code, 0);
    for word in [
        "run",
        "check",
        "info",
        "mesh",
        "volumes",
        "parameters",
        "Exit codes: 0 done; 1 a run failed; 2 a study file or an argument is wrong; 130",
    ] {
        assert!(answer.out.contains(word), "`{word}` is missing in:\n{}", answer.out);
    }
}

#[test]
fn usage_that_makes_no_sense_ends_with_2() {
    for arguments in [&[][..], &["fly"], &["check"], &["check", PHANTOM, "--wings"]] {
        assert_eq!(cardiotwin(arguments).code, 2, "{arguments:?}");
    }
}

#[test]
fn the_first_study_is_a_plan() {
    let answer = cardiotwin(&["check", PHANTOM]);
    assert_eq!((answer.code, answer.err.as_str()), (0, ""));
    for line in
        ["study       01_phantom_recovery/study.toml (personalise)", "free        contraction_peak_lv_kpa in 20 to 400 kPa", "output      "]
    {
        assert!(answer.out.contains(line), "`{line}` is missing in:\n{}", answer.out);
    }
}

#[test]
fn settings_of_the_command_line_win() {
    let answer = cardiotwin(&["check", PHANTOM, "--set", "mechanics.step_s=0.002", "--set", "phantom.seed=7", "-o", "elsewhere"]);
    assert_eq!(answer.code, 0, "{}", answer.err);
    for words in ["step 0.002 s", "seed 7", "output      elsewhere"] {
        assert!(answer.out.contains(words), "`{words}` is missing in:\n{}", answer.out);
    }
    let answer = cardiotwin(&["check", PHANTOM, "--set", "step"]);
    assert_eq!(answer.code, 2);
    assert!(answer.err.contains("--set step: it has no `=`; write --set table.key=value"), "{}", answer.err);
}

#[test]
fn a_study_file_that_is_not_there_is_named() {
    let answer = cardiotwin(&["check", "studies/none/study.toml"]);
    assert_eq!(answer.code, 2);
    assert!(answer.err.contains("cannot read the study file studies/none/study.toml"), "{}", answer.err);
    assert!(answer.err.contains("because: "), "{}", answer.err);
}

#[test]
fn what_is_not_toml_is_shown_with_its_line() {
    refused("not_toml", "kind = \"simulate\"\nthis is no TOML\n", &["is not valid TOML", "line 2"]);
}

#[test]
fn an_unknown_key_is_told_the_nearest() {
    refused(
        "unknown_key",
        "kind = \"simulate\"\n[anatomy.idealised_lv]\ncavity_radus_mm = 20\n",
        &["1 error", "line 3: anatomy.idealised_lv.cavity_radus_mm = 20 is not known", "did you mean `cavity_radius_mm`?"],
    );
}

#[test]
fn a_wrong_type_and_a_value_out_of_range_are_told_what_is_allowed() {
    refused(
        "wrong_values",
        "kind = \"simulate\"\n[anatomy.idealised_lv]\n[mechanics]\nstep_s = \"short\"\npoisson_ratio = 0.7\n",
        &[
            "2 errors",
            "step_s = \"short\" is not a number",
            "line 5: mechanics.poisson_ratio = 0.7 is out of range; choose a value from 0 to 0.49",
        ],
    );
}

#[test]
fn a_missing_image_is_named_with_the_remedy() {
    refused(
        "missing_image",
        "kind = \"track\"\n[anatomy]\nlabels = \"labels.nii.gz\"\n[images]\ncine = \"cine.nii.gz\"\n",
        &["2 errors", "images.cine = \"cine.nii.gz\" names no file", "--data DIR"],
    );
}

#[test]
fn data_that_are_elsewhere_are_found_with_data() {
    let file = study("elsewhere", "kind = \"simulate\"\ndata = \"not/here\"\n[anatomy]\nlabels = \"labels.nii.gz\"\n");
    let folder = file.parent().unwrap().join("data");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("labels.nii.gz"), "").unwrap();
    assert_eq!(cardiotwin(&["check", file.to_str().unwrap()]).code, 2);
    let answer = cardiotwin(&["check", file.to_str().unwrap(), "--data", folder.to_str().unwrap()]);
    assert_eq!(answer.code, 0, "{}", answer.err);
}

#[test]
fn the_table_of_parameters_is_the_documented_one() {
    let answer = cardiotwin(&["parameters"]);
    assert_eq!(answer.code, 0);
    let documented = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/parameters.md")).unwrap();
    assert!(
        answer.out == documented,
        "docs/parameters.md is not what `cardiotwin parameters` prints; write it anew with `cardiotwin parameters > docs/parameters.md`"
    );
}

/// A free beat of a coarse heart, in a second.
const BEAT: &str = "kind = \"simulate\"\n[anatomy]\nedge_length_mm = 12.0\n[anatomy.idealised_lv]\n[mechanics]\nstep_s = 0.01\n";

/// Names in a folder, ascending.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A folder for results that does not exist yet.
fn fresh_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("interface").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

#[test]
fn a_free_beat_leaves_its_files_and_says_what_was_found() {
    let (file, folder) = (study("beat", BEAT), fresh_folder("beat_results"));
    let answer = cardiotwin(&["run", file.to_str().unwrap(), "-o", folder.to_str().unwrap()]);
    assert_eq!(answer.code, 0, "{}", answer.err);
    assert!(answer.out.starts_with("Left ventricle: EDV ") && answer.out.contains("converged; results are in "), "{}", answer.out);
    let figures = ["pressure_volume_lv.png", "beat_lv.png", "volume_lv.png"];
    for name in ["curves.csv", "frames.csv", "heart.pvd", "summary.json"].iter().chain(&figures) {
        assert!(folder.join(name).is_file(), "{name} is missing in {:?}", names(&folder));
    }
    let curves = std::fs::read_to_string(folder.join("curves.csv")).unwrap();
    let columns =
        "time_s,phase_lv,phase_rv,volume_lv_ml,volume_rv_ml,pressure_lv_kpa,pressure_rv_kpa,pressure_aorta_kpa,pressure_pulmonary_kpa,";
    assert!(curves.starts_with(columns), "{}", curves.lines().next().unwrap());
    let summary: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap();
    assert_eq!(summary["kind"], "simulate");
    assert_eq!(summary["status"], "converged");
    assert!(summary["ejection_fraction_lv"].as_f64().is_some_and(|fraction| (0.3..0.8).contains(&fraction)), "{summary}");
    assert_eq!(summary["provenance"]["study_file"], "beat/study.toml");
    assert!(names(&folder).iter().all(|name| !name.contains("tmp")), "{:?}", names(&folder));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let file = study("threads", BEAT);
    let curves = |threads: &str| {
        let folder = fresh_folder(&format!("threads_{threads}"));
        let few = ["--set", "output.figures=false", "--set", "output.meshes=false", "--quiet"];
        let start = ["run", file.to_str().unwrap(), "-o", folder.to_str().unwrap(), "--threads", threads];
        let answer = cardiotwin(&[&start[..], &few].concat());
        assert_eq!((answer.code, answer.out.as_str(), answer.err.as_str()), (0, "", ""));
        std::fs::read(folder.join("curves.csv")).unwrap()
    };
    assert!(curves("1") == curves("4"));
}

#[test]
fn an_image_that_is_none_is_named_and_nothing_is_left() {
    let text = "kind = \"simulate\"\n[anatomy]\nlabels = \"labels.nii.gz\"\n";
    let (file, folder) = (study("no_image", text), fresh_folder("no_image_results"));
    std::fs::write(file.with_file_name("labels.nii.gz"), "this is no image").unwrap();
    let answer = cardiotwin(&["run", file.to_str().unwrap(), "-o", folder.to_str().unwrap()]);
    assert_eq!((answer.code, answer.out.as_str()), (2, ""), "{}", answer.err);
    assert!(answer.err.contains("error: ") && answer.err.contains("labels.nii.gz"), "{}", answer.err);
    assert!(!folder.join("summary.json").exists());
}

#[test]
fn a_folder_that_cannot_be_made_fails_the_run() {
    let file = study("no_folder", BEAT);
    let below_a_file = file.join("results");
    let answer = cardiotwin(&["run", file.to_str().unwrap(), "-o", below_a_file.to_str().unwrap(), "-q"]);
    assert_eq!(answer.code, 1, "{}", answer.err);
    assert!(answer.err.contains("cannot make the folder") && answer.err.contains("because: "), "{}", answer.err);
}

/// A beat that would take minutes ends soon after Ctrl-C, with exit code 130, and what it found is written.
#[cfg(unix)]
#[test]
fn ctrl_c_stops_a_run_that_writes_what_it_has() {
    use std::io::{BufRead, BufReader};
    let (file, folder) = (study("interrupted", BEAT), fresh_folder("interrupted_results"));
    let endless = ["--set", "mechanics.step_s=0.0001", "--set", "simulation.beats=500", "--set", "output.meshes=false"];
    let mut run = std::process::Command::new(assert_cmd::cargo::cargo_bin("cardiotwin"))
        .args(["run", file.to_str().unwrap(), "-o", folder.to_str().unwrap()])
        .args(endless)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(run.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|line| line.contains("beating")), "the run never began to beat");
    let signal = std::process::Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap();
    assert!(signal.success());
    assert!(lines.any(|line| line.contains("stopping at the next step")));
    assert_eq!(run.wait().unwrap().code(), Some(130));
    let summary = std::fs::read_to_string(folder.join("summary.json")).unwrap();
    assert!(summary.contains("\"status\": \"stopped\""), "{summary}");
}

#[test]
fn a_volume_curve_comes_from_a_table_and_bad_tables_are_refused() {
    let folder = study("volumes", "").parent().unwrap().to_path_buf();
    let table = folder.join("curve.csv");
    let rows: String = (0..20)
        .map(|n| format!("{},{}\n", 0.04 * f64::from(n), 100.0 + 30.0 * (std::f64::consts::TAU * f64::from(n) / 20.0).cos()))
        .collect();
    std::fs::write(&table, format!("time_s,volume_lv_ml\n{rows}")).unwrap();
    let results = folder.join("results");
    let answer = cardiotwin(&["volumes", table.to_str().unwrap(), "--period-s", "0.8", "-o", results.to_str().unwrap()]);
    assert_eq!(answer.code, 0, "{}", answer.err);
    assert!(answer.out.contains("EF 46.") && answer.out.contains("(frame 10)") && answer.out.contains("no pause"), "{}", answer.out);
    assert_eq!(std::fs::read_to_string(results.join("volumes.csv")).unwrap().lines().count(), 21);
    assert!(results.join("volumes.png").is_file());
    let answer = cardiotwin(&["volumes", table.to_str().unwrap()]);
    assert!(answer.code == 2 && answer.err.contains("--period-s"), "{}", answer.err);
    std::fs::write(&table, "time_s,volume_lv_ml\n0.1,many\n").unwrap();
    let answer = cardiotwin(&["volumes", table.to_str().unwrap(), "--period-s", "0.8"]);
    assert!(answer.code == 2 && answer.err.contains("line 2"), "{}", answer.err);
}

#[test]
fn what_an_image_shows_is_told_as_a_table_or_json_and_what_is_none_is_refused() {
    let answer = cardiotwin(&["info", "README.md"]);
    assert_eq!((answer.code, answer.out.as_str()), (2, ""));
    assert!(answer.err.contains("README.md") && answer.err.contains("NIfTI"), "{}", answer.err);
    assert!(cardiotwin(&["info", "src"]).err.contains("no DICOM file"));
    let cine = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/sri_E774");
    if !cine.is_dir() {
        return;
    }
    let (cine, timing) = (cine.join("cine_sax_crop.nii.gz"), cine.join("meta.json"));
    let answer = cardiotwin(&["info", cine.to_str().unwrap(), "--timing", timing.to_str().unwrap()]);
    for words in ["160 × 160 × 20 voxels of 0.820 × 0.820 × 5.000 mm", "20 from 10.0 to 610", "RR 63"] {
        assert!(answer.out.contains(words), "`{words}` is missing in:\n{}", answer.out);
    }
    let json = cardiotwin(&["info", cine.to_str().unwrap(), "--json"]).out;
    assert!(json.starts_with("[\n") && json.contains("\"frame_count\": 20") && json.contains("\"slice_shifts_mm\""), "{json}");
}

#[test]
fn a_heart_is_meshed_and_its_file_is_a_heart_again() {
    let shape = study("mesh", "kind = \"mesh\"\n[anatomy]\nedge_length_mm = 8.0\n[anatomy.idealised_biventricle]\n");
    let folder = shape.parent().unwrap();
    let (mesh, again) = (folder.join("heart.vtu"), folder.join("again.msh"));
    let made = cardiotwin(&["mesh", shape.to_str().unwrap(), "-o", mesh.to_str().unwrap(), "--json", "-q"]);
    assert_eq!((made.code, made.err.as_str()), (0, ""));
    for words in ["\"dihedral_least_deg\"", "\"radius_ratio_least\"", "\"part\": \"cavity_rv\"", "\"masks_ml\": null"] {
        assert!(made.out.contains(words), "`{words}` is missing in:\n{}", made.out);
    }
    let text = "kind = \"mesh\"\n[anatomy]\nmesh = \"heart.vtu\"\nfibre_field = \"fibre\"\nsheet_field = \"sheet\"\n";
    let read = study("mesh/again", &text.replace("heart.vtu", "../heart.vtu"));
    let remade = cardiotwin(&["mesh", read.to_str().unwrap(), "-o", again.to_str().unwrap(), "--json", "-q"]);
    let until_time = |text: &str| text.split("\"meshing_s\"").next().unwrap().to_string();
    assert_eq!(until_time(&made.out), until_time(&remade.out), "{}", remade.err);
    let table = cardiotwin(&["mesh", shape.to_str().unwrap(), "-o", mesh.to_str().unwrap(), "-q", "--edge-length-mm", "10"]);
    for words in ["vertices  ", "tetrahedra  ", "dihedral angle (°)  ", "cavity_rv (mL)  ", "meshing (s)  ", "the mesh is in "] {
        assert!(table.out.contains(words), "`{words}` is missing in:\n{}", table.out);
    }
}

#[test]
fn labels_are_meshed_beside_their_volumes_and_bad_ones_are_refused() {
    let missing = cardiotwin(&["mesh", "no_labels.nii.gz"]);
    assert!(missing.code == 2 && missing.err.contains("no_labels.nii.gz does not exist"), "{}", missing.err);
    let masks = cardiotwin(&["mesh", "README.md", "README.md", "-o", "none.vtu"]);
    assert!(masks.code == 2 && masks.err.contains("README.md"), "{}", masks.err);
    let Some(data) = common::real_data("sunnybrook_SCD0000201") else { return };
    let labels = data.join("labels_ED_crop.nii.gz");
    let labels = labels.to_str().unwrap();
    let mesh = study("mesh_of_labels", "").parent().unwrap().join("heart.vtk");
    let mesh = mesh.to_str().unwrap();
    let answer = cardiotwin(&["mesh", labels, "-o", mesh, "--edge-length-mm", "7", "-q"]);
    assert_eq!(answer.code, 0, "{}", answer.err);
    for words in ["(masks 245.9, ", "(masks 135.9, ", "endocardium_lv off by (mm)", "Dice 0.9"] {
        assert!(answer.out.contains(words), "`{words}` is missing in:\n{}", answer.out);
    }
    assert!(answer.err.contains("warning: the wall was thinner than 2 mm"), "{}", answer.err);
    let refused = |arguments: &[&str], words: &str| {
        let answer = cardiotwin(&[&["mesh", labels, "-o", mesh, "-q"], arguments].concat());
        assert!(answer.code == 2 && answer.err.contains(words), "{} {}", answer.code, answer.err);
    };
    refused(&["--set", "anatomy.code_cavity_rv=3"], "holds a right cavity (label 3)");
    refused(&["--set", "anatomy.code_cavity_lv=7"], "a closed wall (label 2)");
    refused(&["--set", "anatomy.label_slices=[4, 4]"], "fewer than two slices");
    refused(&["--edge-length-mm", "90"], "edge_length_mm");
    // The cavity of end-systole was drawn without a wall.
    let bare = labels.replace("ED", "ES");
    let answer = cardiotwin(&["mesh", &bare, "-q"]);
    assert!(answer.code == 2 && answer.err.contains("closed wall (label 2)"), "{}", answer.err);
    assert!(answer.err.contains("set wall_thickness_lv_mm"), "{}", answer.err);
    let walled = cardiotwin(&["mesh", &bare, "-o", mesh, "--edge-length-mm", "7", "-q", "--set", "anatomy.wall_thickness_lv_mm=8"]);
    assert!(walled.code == 0 && walled.out.contains("(masks 183.7, "), "{} {}", walled.out, walled.err);
}
