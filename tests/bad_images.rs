//! Images and masks that are wrong, through the binary: each is refused with exit code 2, its file and what is wrong with it, or said in a warning.
//! That a heart lies outside the images is found when the run has begun: exit code 1.
//!
//! The same through the library, with every type of voxel and header: `src/image/nifti/tests.rs`, `src/image/dicom/tests.rs`, `src/image/mask/tests.rs`.

#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may stop at the first surprise, and says what it could not look at")]

mod common;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use assert_cmd::Command;
use cardiotwin::image::{CineSequence, Grid, LabelMap, Volume, write_cine, write_label_map};
use nalgebra::Vector3;
use tempfile::TempDir;

const SHAPE: [usize; 3] = [28, 28, 8];

/// A tube of blood (1) in a wall (2), closed at the apex, and four frames that show it.
fn files() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let grid = Grid::axis_aligned(SHAPE, Vector3::new(-28.0, -28.0, 0.0), Vector3::new(2.0, 2.0, 8.0)).unwrap();
    let label = |flat: usize| {
        let [i, j, k] = grid.voxel_of(flat);
        let radius_mm = 2.0 * (i as f64 - 13.5).hypot(j as f64 - 13.5);
        let blood_mm = 6.0 + 2.0 * k as f64;
        match k {
            1..7 if radius_mm < blood_mm => 1,
            1..7 if radius_mm < blood_mm + 8.0 => 2,
            _ => 0,
        }
    };
    let labels: Vec<u8> = (0..grid.voxel_count()).map(label).collect();
    let frame = |n: usize| {
        let values = labels.iter().map(|&label| [40.3, 200.3, 90.3][usize::from(label)] + n as f32).collect();
        Volume::new(grid.clone(), values).unwrap()
    };
    let cine = CineSequence::new((0..4).map(frame).collect(), vec![0.0, 0.2, 0.4, 0.6], 0.8).unwrap();
    let create = |name: &str| File::create(folder.path().join(name)).unwrap();
    write_cine(&mut create("cine.nii.gz"), &cine).unwrap();
    write_label_map(&mut create("labels.nii.gz"), &LabelMap::new(grid, labels).unwrap()).unwrap();
    folder
}

/// Writes a file of the folder anew, without compression, with its bytes changed.
fn change(folder: &Path, from: &str, to: &str, edit: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(File::open(folder.join(from)).unwrap()).read_to_end(&mut bytes).unwrap();
    edit(&mut bytes);
    std::fs::write(folder.join(to), bytes).unwrap();
}

fn put(bytes: &mut [u8], offset: usize, values: &[f32]) {
    for (n, value) in values.iter().enumerate() {
        bytes[offset + 4 * n..offset + 4 * n + 4].copy_from_slice(&value.to_le_bytes());
    }
}

/// Exit code, stdout and stderr.
fn cardiotwin(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = Command::cargo_bin("cardiotwin").unwrap().current_dir(folder).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

fn refused(folder: &Path, arguments: &[&str], words: &[&str]) {
    let (code, out, err) = cardiotwin(folder, arguments);
    assert_eq!((code, out.as_str()), (2, ""), "{arguments:?}: {err}");
    for word in words {
        assert!(err.contains(word), "{arguments:?}: `{word}` is missing in:\n{err}");
    }
}

/// `labels` and `cine` as a study that tracks.
fn tracked(folder: &Path, labels: &str, cine: &str) {
    let text = format!("kind = \"track\"\n[anatomy]\nedge_length_mm = 8.0\nlabels = \"{labels}\"\n[images]\ncine = \"{cine}\"\n");
    std::fs::write(folder.join("study.toml"), text).unwrap();
}

#[test]
fn files_that_are_no_images_are_refused_by_name() {
    let folder = files();
    let folder = folder.path();
    assert_eq!(cardiotwin(folder, &["info", "cine.nii.gz"]).0, 0);
    let whole = std::fs::read(folder.join("cine.nii.gz")).unwrap();
    std::fs::write(folder.join("cut.nii.gz"), &whole[..whole.len() / 2]).unwrap();
    refused(folder, &["info", "cut.nii.gz"], &["cut.nii.gz", "cut off"]);
    change(folder, "cine.nii.gz", "nan.nii", |bytes| put(bytes, 352 + 4 * 28, &[f32::NAN]));
    refused(folder, &["info", "nan.nii"], &["nan.nii", "voxel [0, 1, 0] of frame 0 is not finite"]);
    change(folder, "cine.nii.gz", "flat.nii", |bytes| put(bytes, 312, &[0.0; 4]));
    refused(folder, &["info", "flat.nii"], &["flat.nii", "singular", "sform or qform"]);
}

/// Another order and direction of voxels, and a turned patient, are no errors: the volume is the same and the heart lies where the header says.
#[test]
fn left_handed_and_oblique_images_are_read_as_they_lie() {
    let folder = files();
    let folder = folder.path();
    change(folder, "labels.nii.gz", "left_handed.nii", |bytes| put(bytes, 280, &[-2.0, 0.0, 0.0, 28.0]));
    let (c, s) = (0.8, 0.6);
    change(folder, "labels.nii.gz", "oblique.nii", |bytes| {
        put(bytes, 280, &[2.0 * c, 0.0, 8.0 * s, 5.0, 0.0, 2.0, 0.0, -28.0, -2.0 * s, 0.0, 8.0 * c, 9.0]);
    });
    let volume = |name: &str| {
        let (code, out, err) = cardiotwin(folder, &["mesh", name, "--edge-length-mm", "7", "-q"]);
        assert_eq!(code, 0, "{name}: {err}");
        let line = out.lines().find(|line| line.starts_with("cavity_lv")).unwrap().to_string();
        line.split_whitespace().nth(2).unwrap().parse::<f64>().unwrap()
    };
    let upright_ml = volume("labels.nii.gz");
    for name in ["left_handed.nii", "oblique.nii"] {
        assert!((volume(name) / upright_ml - 1.0).abs() < 0.01, "{name}: {} mL for {upright_ml}", volume(name));
    }
    assert!(cardiotwin(folder, &["info", "oblique.nii"]).1.contains("36.9° oblique"));
}

#[test]
fn cines_and_masks_that_do_not_go_together_are_refused() {
    let folder = files();
    let folder = folder.path();
    let run = ["run", "study.toml", "-q"];
    tracked(folder, "labels.nii.gz", "labels.nii.gz");
    refused(folder, &run, &["labels.nii.gz", "one frame"]);
    change(folder, "labels.nii.gz", "empty.nii", |bytes| bytes[352..].fill(0));
    refused(folder, &["mesh", "empty.nii", "-q"], &["no voxel", "label 1"]);
    // A wall with a gap as wide as a quarter of the cavity, in a slice between others.
    change(folder, "labels.nii.gz", "leaking.nii", |bytes| {
        for (n, label) in bytes[352..].iter_mut().enumerate() {
            if n / (28 * 28) == 4 && n % 28 > 14 && *label == 2 {
                *label = 0;
            }
        }
    });
    refused(folder, &["mesh", "leaking.nii", "-q"], &["slice 4: the wall is open", "correct the labels or choose the slices"]);
    change(folder, "labels.nii.gz", "elsewhere.nii", |bytes| put(bytes, 280, &[2.0, 0.0, 0.0, 400.0]));
    tracked(folder, "elsewhere.nii", "cine.nii.gz");
    let (code, _, err) = cardiotwin(folder, &run);
    assert!(code == 1 && err.contains("100 % of the heart's mesh lie outside of the images"), "{code}: {err}");
}

#[test]
fn a_damaged_frame_is_said() {
    let folder = files();
    change(folder.path(), "cine.nii.gz", "blank.nii", |bytes| {
        let frame = 4 * SHAPE.iter().product::<usize>();
        bytes[352 + 2 * frame..352 + 3 * frame].fill(0);
    });
    let (code, out, err) = cardiotwin(folder.path(), &["info", "blank.nii"]);
    assert!(code == 0 && out.contains("frames [2] are blank"), "{out}{err}");
}

/// Another last digit in the series' number, (0020,000E).
fn rename_series(bytes: &mut [u8]) {
    let tag = bytes.windows(6).position(|window| window == [0x20, 0, 0x0E, 0, b'U', b'I']).unwrap();
    let length = usize::from(bytes[tag + 6]) + (usize::from(bytes[tag + 7]) << 8);
    let value = &mut bytes[tag + 8..tag + 8 + length];
    let last = value.iter().rposition(u8::is_ascii_digit).unwrap();
    value[last] = if value[last] == b'1' { b'2' } else { b'1' };
}

/// A patient's folder with a slice taken out, another in two series, a file cut off, and files that are no images.
#[test]
fn a_scanners_folder_with_gaps_strangers_and_damage_is_read_and_all_of_it_said() {
    let Some(scan) = common::real_data("sunnybrook_SCD0000201/dicom") else { return };
    let folder = tempfile::tempdir().unwrap();
    // Twenty files a slice, in their order: the sixth slice is left out.
    for number in (1..=260).filter(|number| !(101..=120).contains(number)) {
        let name = format!("{number}.dcm");
        std::fs::copy(scan.join(&name), folder.path().join(&name)).unwrap();
    }
    let whole = std::fs::read(scan.join("7.dcm")).unwrap();
    std::fs::write(folder.path().join("7.dcm"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(folder.path().join("notes.txt"), "no image").unwrap();
    std::fs::write(folder.path().join("broken.dcm"), "no image").unwrap();
    // The third slice once more, as a series that the scanner repeated: the last number of the series' name is another one.
    for number in 41..=60 {
        let mut bytes = std::fs::read(scan.join(format!("{number}.dcm"))).unwrap();
        rename_series(&mut bytes);
        std::fs::write(folder.path().join(format!("again_{number}.dcm")), bytes).unwrap();
    }
    let (code, out, err) = cardiotwin(folder.path(), &["info", "."]);
    assert_eq!(code, 0, "{err}");
    for words in [
        "256 × 256 × 13 voxels",
        "1 slices are missing",
        "broken.dcm: it is no DICOM file or is damaged",
        "7.dcm",
        "20 images of other series",
    ] {
        assert!(out.contains(words), "`{words}` is missing in:\n{out}");
    }
}
