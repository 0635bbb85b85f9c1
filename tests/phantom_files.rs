//! A phantom from its study file to its files and back: what is written is read as a patient's, here and by others, and shows the truth beside it.
//!
//! A failure of the volumes means that images, labels and mesh no longer show one heart; of the header, that others would see it elsewhere.

#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test may stop at the first surprise, and says aloud what it could not look at"
)]

use std::path::Path;
use std::process::Command;
use std::sync::atomic::AtomicBool;

use cardiotwin::image::{CineTiming, read_cine, read_label_map, read_label_maps, summarise};
use cardiotwin::study::{Config, CurveSource, Overrides, Plan, RunContext, Silent, measure_volumes, run};
use serde_json::Value;

const EJECTION_FRACTION: f64 = 0.55;
const SLICE_MM: f64 = 8.0;

const LV: &str = r#"
kind = "phantom"
[anatomy]
edge_length_mm = 8.0
[anatomy.idealised_lv]
base_height_mm = 20.5
reference_time_s = 0.0
[electrophysiology]
heart_period_s = 0.9
[phantom]
frames = 10
voxel_size_mm = 2.0
seed = 3
[phantom.contraction]
ejection_fraction = 0.55
shortening = 0.0
twist_deg = 8.0
[output]
figures = false
"#;

/// Runs a study text and returns its summary.
fn leave(text: &str, folder: &Path, settings: &[&str]) -> Value {
    let settings = settings.iter().map(ToString::to_string).collect();
    let overrides = Overrides { output: Some(folder.to_path_buf()), settings, data: None };
    let plan = Plan::new(&Config::from_text(Path::new("phantom.toml"), text.into(), overrides).unwrap()).unwrap();
    run(&plan, &RunContext::new(&Silent, &AtomicBool::new(false))).unwrap();
    serde_json::from_str(&std::fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap()
}

/// A column of a CSV file.
fn column(file: &Path, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(file).unwrap();
    let mut lines = text.lines();
    let place = lines.next().unwrap().split(',').position(|head| head == name).unwrap();
    lines.map(|line| line.split(',').nth(place).unwrap().parse().unwrap()).collect()
}

#[test]
fn what_is_written_is_read_back_as_a_patients_files_with_the_truth_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let summary = leave(LV, folder.path(), &[]);
    let file = |name: &str| folder.path().join(name);

    let cine = read_cine(&file("cine.nii.gz"), &CineTiming::default()).unwrap();
    assert!(cine.warnings.is_empty(), "{:?}", cine.warnings);
    let cine = cine.cine;
    assert_eq!(cine.frames().len(), 10);
    assert!((cine.period_s() - 0.9).abs() < 1e-6 && cine.times_s()[0].abs() < 1e-9);
    let shape: Vec<usize> = summary["images"]["shape"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap() as usize).collect();
    assert_eq!(cine.grid().shape().as_slice(), shape);
    let shown = &summarise(&file("cine.nii.gz"), &CineTiming::default()).unwrap()[0];
    assert!((shown.spacing_mm[2] - SLICE_MM).abs() < 1e-5 && shown.period_s.is_some(), "{shown:?}");

    // Truth: the prescribed ejection fraction, but for the chords of an 8 mm mesh; the voxels show the volume of the mesh.
    let mesh_ml = column(&file("volumes.csv"), "volume_lv_ml");
    let (greatest, least) = mesh_ml.iter().fold((0.0_f64, f64::INFINITY), |(high, low), &v| (high.max(v), low.min(v)));
    assert!((1.0 - least / greatest - EJECTION_FRACTION).abs() < 0.02, "{greatest} → {least} mL");
    let voxels_ml = column(&file("volumes.csv"), "volume_voxels_lv_ml");
    assert!(mesh_ml.iter().zip(&voxels_ml).all(|(mesh, voxels)| (voxels / mesh - 1.0).abs() < 0.015), "{mesh_ml:?} {voxels_ml:?}");

    // Labels: every voxel is one tissue, so that the base may be half a slice off; this one lies 0.25 mm above the border of two slices.
    let maps = read_label_maps(&file("labels.nii.gz")).unwrap();
    assert_eq!((maps.len(), maps[0].grid().shape()), (10, cine.grid().shape()));
    let lines = measure_volumes(
        &CurveSource::Labels { path: file("labels.nii.gz"), timing: None, code: 1, code_right: None, slices: None },
        &file("volumes"),
    )
    .unwrap();
    assert!(lines[1].starts_with("EDV"), "{lines:?}");
    let labels_ml = column(&file("volumes/volumes.csv"), "volume_lv_ml");
    // The file's affine is in single precision.
    let counted_ml = column(&file("volumes.csv"), "volume_labels_lv_ml");
    assert!(labels_ml.iter().zip(&counted_ml).all(|(read, counted)| (read / counted - 1.0).abs() < 1e-6), "{labels_ml:?} {counted_ml:?}");
    assert!(mesh_ml.iter().zip(&labels_ml).all(|(mesh, labels)| (mesh - labels).abs() < 3.0), "{mesh_ml:?} {labels_ml:?}");
    let reference = read_label_map(&file("labels_reference.nii.gz")).unwrap();
    assert_eq!(reference, maps[0]);
    assert_eq!(
        read_label_map(&file("labels_end_systole.nii.gz")).unwrap(),
        maps[summary["images"]["end_systolic_frame"].as_u64().unwrap() as usize]
    );
    assert!(file("heart.pvd").is_file() && file("heart/010.vtu").is_file() && file("slice_shifts.csv").is_file());
    assert_eq!(summary["true_parameters"]["heart_period_s"], 0.9);
}

/// The files alone, tracked as a patient's: the heart of the labels follows the images to an ejection that nobody told it.
#[test]
fn a_phantom_is_tracked_from_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let summary = leave(LV, folder.path(), &[]);
    let end_systole = summary["images"]["end_systolic_frame"].as_u64().unwrap();
    let text = format!(
        "kind = \"track\"\n[anatomy]\nlabels = \"labels_reference.nii.gz\"\nedge_length_mm = 7.0\n[images]\ncine = \"cine.nii.gz\"\n\
         [[images.validation]]\nlabels = \"labels_end_systole.nii.gz\"\nframe = {end_systole}\n[tracking]\nbase = \"springs\"\n\
         [mechanics]\nstep_s = 0.01\n[output]\nfigures = false\nmeshes = false\n"
    );
    let overrides = Overrides { output: Some(folder.path().join("tracked")), data: Some(folder.path().into()), settings: vec![] };
    let plan = Plan::new(&Config::from_text(Path::new("patient.toml"), text, overrides).unwrap()).unwrap();
    run(&plan, &RunContext::new(&Silent, &AtomicBool::new(false))).unwrap();
    let tracked: Value = serde_json::from_str(&std::fs::read_to_string(folder.path().join("tracked/summary.json")).unwrap()).unwrap();
    let agreement = &tracked["validation"][0];
    let number = |key: &str| agreement[key].as_f64().unwrap();
    assert!(number("dice_tracked") > 0.85 && number("dice_tracked") > number("dice_no_motion") + 0.15, "{agreement:#}");
    assert!((number("volume_tracked_ml") / number("volume_labels_ml") - 1.0).abs() < 0.2, "{agreement:#}");
}

/// Two ventricles whose beat is simulated: the right one is in the labels, the volumes and the truth as the left one is.
#[test]
fn both_ventricles_of_a_simulated_beat_are_imaged() {
    let folder = tempfile::tempdir().unwrap();
    let text = "kind = \"phantom\"\n[anatomy]\nedge_length_mm = 9.0\n[anatomy.idealised_biventricle]\n[mechanics]\nstep_s = 0.01\n\
                [phantom]\nframes = 6\nvoxel_size_mm = 2.5\nslice_thickness_mm = 6.0\nslice_distance_mm = 7.0\n[phantom.truth]\ncontraction_peak_lv_kpa = 110.0\n\
                [output]\nfigures = false\nmeshes = false\n";
    let summary = leave(text, folder.path(), &["phantom.slice_shift_sd_mm=1.5"]);
    assert_eq!(summary["true_parameters"]["contraction_peak_lv_kpa"], 110.0);
    assert!(summary["images"]["slice_shift_greatest_mm"].as_f64().unwrap() > 0.5);
    let file = folder.path().join("volumes.csv");
    for side in ["lv", "rv"] {
        let (mesh, voxels) = (column(&file, &format!("volume_{side}_ml")), column(&file, &format!("volume_voxels_{side}_ml")));
        // Slices of 6 mm every 7 mm miss a seventh of the heart, and the part beyond apex and base is not representative: an error of
        // some share of a slice, however much the cavity holds.
        let share_ml = 0.04 * mesh.iter().copied().fold(0.0, f64::max);
        assert!(mesh.iter().zip(&voxels).all(|(mesh, voxels)| (voxels - mesh).abs() < share_ml), "{side}: {mesh:?} {voxels:?}");
    }
    let map = read_label_map(&folder.path().join("labels_reference.nii.gz")).unwrap();
    assert!([1, 2, 3].iter().all(|&code| map.count(code) > 500), "LV, wall and RV are all there");
}

/// nibabel, where a Python with it is at hand (`CARDIOTWIN_PYTHON`, else `python3`), sees the same shape, place, times and volumes.
#[test]
fn nibabel_reads_the_same_world_coordinates_times_and_volumes() {
    const SCRIPT: &str = "import sys, numpy, nibabel\n\
        image, labels = (nibabel.load(sys.argv[1] + name) for name in ('/cine.nii.gz', '/labels.nii.gz'))\n\
        header = image.header\n\
        assert header.get_xyzt_units() == ('mm', 'sec'), header.get_xyzt_units()\n\
        assert numpy.allclose(header.get_sform(), header.get_qform(), atol=1e-4), (header.get_sform(), header.get_qform())\n\
        ml = abs(numpy.linalg.det(labels.affine[:3, :3])) * (numpy.asarray(labels.dataobj) == 1).sum((0, 1, 2)) / 1000\n\
        numbers = [*image.shape, header.get_zooms()[3], float(header['toffset']), *image.affine[:3].ravel(), image.get_fdata()[3, 4, 5, 6], *ml]\n\
        print(*(repr(float(number)) for number in numbers))\n";
    let python = std::env::var("CARDIOTWIN_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_nibabel = Command::new(&python).args(["-c", "import nibabel"]).output().is_ok_and(|answer| answer.status.success());
    if !has_nibabel {
        eprintln!("SKIPPED: {python} has no nibabel; set CARDIOTWIN_PYTHON to one that has");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    leave(LV, folder.path(), &["phantom.frames=8", "output.meshes=false", "anatomy.idealised_lv.reference_time_s=-0.1"]);
    let answer = Command::new(&python).args(["-c", SCRIPT]).arg(folder.path()).output().unwrap();
    assert!(answer.status.success(), "{}", String::from_utf8_lossy(&answer.stderr));
    let numbers: Vec<f64> = String::from_utf8(answer.stdout).unwrap().split_whitespace().map(|word| word.parse().unwrap()).collect();
    let cine = read_cine(&folder.path().join("cine.nii.gz"), &CineTiming::default()).unwrap().cine;
    let [ni, nj, nk] = cine.grid().shape().map(|n| n as f64);
    let affine = cine.grid().voxel_to_world();
    let step_s = cine.times_s()[1] - cine.times_s()[0];
    let mut expected = vec![ni, nj, nk, 8.0, step_s, cine.times_s()[0]];
    expected.extend((0..12).map(|n| affine[(n / 4, n % 4)]));
    expected.push(f64::from(cine.frames()[6].at([3, 4, 5])));
    expected.extend(column(&folder.path().join("volumes.csv"), "volume_labels_lv_ml"));
    assert_eq!(numbers.len(), expected.len());
    for (place, (theirs, ours)) in numbers.iter().zip(&expected).enumerate() {
        assert!((theirs - ours).abs() < 1e-4 * (1.0 + ours.abs()), "number {place}: nibabel {theirs}, here {ours}");
    }
}
