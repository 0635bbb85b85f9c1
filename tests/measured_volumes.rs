//! Parameters fitted to volumes that were measured without the model, from files alone: from a table, from labels of every frame, from the images
//! themselves; of the left ventricle, and of the right one where there is one.
//!
//! A failure means that the curve of the files is not the curve that is fitted, or that what is found does not go with it.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

/// A coarse left ventricle whose beat is simulated, as a scanner's files.
const LV: &str = "kind = \"phantom\"\n[anatomy]\nedge_length_mm = 9.0\n[anatomy.idealised_lv]\nbase_height_mm = 20.5\n[mechanics]\nstep_s = 0.01\n\
                  [phantom]\nframes = 10\nvoxel_size_mm = 2.0\n[phantom.truth]\ncontraction_peak_lv_kpa = 150.0\n\
                  [output]\nfigures = false\nmeshes = false\n";

/// The same of two ventricles.
const BOTH: &str = "kind = \"phantom\"\n[anatomy]\nedge_length_mm = 9.0\n[anatomy.idealised_biventricle]\n[mechanics]\nstep_s = 0.01\n\
                    [phantom]\nframes = 8\nvoxel_size_mm = 2.0\n[phantom.truth]\ncontraction_peak_lv_kpa = 150.0\ncontraction_peak_rv_kpa = 150.0\n\
                    [output]\nfigures = false\nmeshes = false\n";

/// A patient whose images and labels were sent; what is fitted, and to what, follows.
const PATIENT: &str = "kind = \"personalise\"\n[output]\nfigures = false\nmeshes = false\n[mechanics]\nstep_s = 0.01\n[anatomy]\nedge_length_mm = 9.0\n\
                       labels = \"labels_reference.nii.gz\"\n[personalisation]\nmax_iterations = 2\nsigma_volume_ml = 1.0\nsigma_boundary_mm = 5.0\n";

fn parameter(name: &str) -> String {
    format!("[[personalisation.parameter]]\nname = \"{name}\"\nlower = 20.0\nupper = 400.0\nstart = 90.0\n")
}

/// Runs the binary in a folder; what it says to stdout and stderr.
fn cardiotwin(folder: &Path, arguments: &[&str]) -> [String; 2] {
    let output = Command::cargo_bin("cardiotwin").unwrap().current_dir(folder).args(arguments).output().unwrap();
    let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(output.status.success(), "{arguments:?}: {err}");
    [out, err]
}

/// Runs a study text in a folder and returns its summary.
fn run(folder: &Path, name: &str, text: &str) -> Value {
    std::fs::write(folder.join(format!("{name}.toml")), text).unwrap();
    cardiotwin(folder, &["run", &format!("{name}.toml"), "-o", name, "-q"]);
    serde_json::from_str(&std::fs::read_to_string(folder.join(name).join("summary.json")).unwrap()).unwrap()
}

/// A column of a CSV file.
fn column(file: &Path, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(file).unwrap();
    let mut lines = text.lines();
    let place = lines.next().unwrap().split(',').position(|head| head == name).unwrap();
    lines.map(|line| line.split(',').nth(place).unwrap().parse().unwrap()).collect()
}

fn number(summary: &Value, key: &str) -> f64 {
    summary[key].as_f64().unwrap_or(f64::NAN)
}

/// What a parameter was found to be.
fn found(folder: &Path, name: &str) -> f64 {
    let text = std::fs::read_to_string(folder.join("parameters.csv")).unwrap();
    let place = text.lines().next().unwrap().split(',').position(|head| head == "value").unwrap();
    text.lines().find(|line| line.starts_with(name)).unwrap().split(',').nth(place).unwrap().parse().unwrap()
}

fn warns(summary: &Value, words: &str) -> bool {
    summary["warnings"].as_array().unwrap().iter().any(|warning| warning.as_str().unwrap().contains(words))
}

#[test]
fn a_left_ventricle_is_fitted_to_a_table_to_labels_and_to_its_images() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("phantom.toml"), LV).unwrap();
    cardiotwin(folder, &["run", "phantom.toml", "-o", ".", "-q"]);
    let truth_ml = column(&folder.join("volumes.csv"), "volume_lv_ml");
    let largest = |volumes: &[f64]| volumes.iter().copied().fold(0.0, f64::max);
    let ejected = |volumes: &[f64]| 1.0 - volumes.iter().copied().fold(f64::INFINITY, f64::min) / largest(volumes);
    // What one program measures is a table for the other: `cardiotwin volumes` of the labels of every frame.
    let [said, _] = cardiotwin(folder, &["volumes", "labels.nii.gz", "-o", "counted"]);
    assert!(said.contains("EDV") && said.contains("EF"), "{said}");
    let sources = [
        ("table", "volumes = \"counted/volumes.csv\"\n", ""),
        ("labels", "volumes = \"labels.nii.gz\"\n", ""),
        ("images", "", "volumes = \"measured\"\n"),
    ];
    for ((name, images, personalisation), share) in sources.into_iter().zip([0.1, 0.1, 0.15]) {
        let text = format!("{PATIENT}{personalisation}{}[images]\ncine = \"cine.nii.gz\"\n{images}", parameter("contraction_peak_lv_kpa"));
        let summary = run(folder, name, &text);
        let measured_ml = column(&folder.join(name).join("frames.csv"), "volume_measured_lv_ml");
        // The curve that is fitted is that of the files: the heart's own, but for 8 mm slices and smoothing; followed on
        // images, a base that moves through them is not seen.
        assert!((ejected(&measured_ml) - ejected(&truth_ml)).abs() < 0.06, "{name}: {measured_ml:?} {truth_ml:?}");
        assert!(
            measured_ml.iter().zip(&truth_ml).all(|(a, b)| (a - b).abs() < share * largest(&truth_ml)),
            "{name}: {measured_ml:?} {truth_ml:?}"
        );
        assert!(warns(&summary, "measured volumes of the left ventricle were multiplied by"), "{name}: {}", summary["warnings"]);
        let [before_ml, after_ml] = ["volume_rms_initial_ml", "volume_rms_ml"].map(|key| number(&summary, key));
        assert!(after_ml < 0.5 * before_ml, "{name}: {before_ml} → {after_ml} mL");
        let peak_kpa = found(&folder.join(name), "contraction_peak_lv_kpa");
        assert!((peak_kpa - 150.0).abs() < 30.0, "{name}: {peak_kpa} kPa from 90, truth 150");
    }
    // A table of the smooth volumes or the labels that it was counted in: the same data.
    let of = |name: &str| column(&folder.join(name).join("frames.csv"), "volume_measured_lv_ml");
    assert!(of("table").iter().zip(of("labels")).all(|(a, b)| (a - b).abs() < 1e-3), "{:?} {:?}", of("table"), of("labels"));
}

#[test]
fn both_ventricles_are_fitted_to_their_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("phantom.toml"), BOTH).unwrap();
    cardiotwin(folder, &["run", "phantom.toml", "-o", ".", "-q"]);
    let right = PATIENT.replace("labels = ", "code_cavity_rv = 3\nlabels = ");
    let text = format!(
        "{right}{}{}[images]\ncine = \"cine.nii.gz\"\nvolumes = \"labels.nii.gz\"\nvolumes_code_cavity_rv = 3\nmatch_stroke_volumes = true\n",
        parameter("contraction_peak_lv_kpa"),
        parameter("contraction_peak_rv_kpa")
    );
    let summary = run(folder, "both", &text);
    for side in ["left", "right"] {
        assert!(warns(&summary, &format!("measured volumes of the {side} ventricle")), "{}", summary["warnings"]);
    }
    for side in ["", "rv_"] {
        let [before_ml, after_ml] = ["initial_ml", "ml"].map(|end| number(&summary, &format!("volume_rms_{side}{end}")));
        assert!(after_ml < 0.6 * before_ml, "{side}: {before_ml} → {after_ml} mL");
    }
    for name in ["contraction_peak_lv_kpa", "contraction_peak_rv_kpa"] {
        let peak_kpa = found(&folder.join("both"), name);
        assert!(peak_kpa > 115.0, "{name}: {peak_kpa} kPa from 90, truth 150");
    }
}
