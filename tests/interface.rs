//! The binary from outside: what it prints, which exit code it ends with, and what it says to bad input.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

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
    for word in ["run", "check", "parameters", "Exit codes: 0 done; 1 a run failed; 2 a study file or an argument is wrong; 130"] {
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
