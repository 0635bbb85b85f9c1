//! Images that contradict the heart that is to be tracked in them, through the binary: an error that names what is wrong, or a warning in
//! `summary.json`, and never a silent result.
//!
//! Files that are no images, and hearts outside of them: `tests/bad_images.rs`.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::io::Read;
use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

const FRAMES: usize = 10;

const PHANTOM: &str = "kind = \"phantom\"\n[anatomy]\nedge_length_mm = 9.0\n[anatomy.idealised_lv]\n[mechanics]\nstep_s = 0.02\n[phantom]\nframes = 10\n\
                       voxel_size_mm = 3.0\n[phantom.contraction]\nejection_fraction = 0.4\nshortening = 0.05\n[output]\nfigures = false\nmeshes = false\n";

const TRACK: &str = "kind = \"track\"\n[anatomy]\nlabels = \"labels_reference.nii.gz\"\nedge_length_mm = 9.0\n[images]\ncine = \"cine.nii\"\n\
                     [mechanics]\nstep_s = 0.02\n[tracking]\nbase = \"springs\"\n[output]\nfigures = false\nmeshes = false\n";

/// A phantom's files, its cine without compression.
struct Patient {
    folder: TempDir,
    cine: Vec<u8>,
}

impl Patient {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("phantom.toml"), PHANTOM).unwrap();
        std::fs::write(folder.path().join("track.toml"), TRACK).unwrap();
        let patient = Self { folder, cine: Vec::new() };
        assert_eq!(patient.cardiotwin(&["run", "phantom.toml", "-o", ".", "-q"]).0, 0);
        let mut cine = Vec::new();
        flate2::read::GzDecoder::new(std::fs::File::open(patient.path().join("cine.nii.gz")).unwrap()).read_to_end(&mut cine).unwrap();
        Self { cine, ..patient }
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Exit code and stderr.
    fn cardiotwin(&self, arguments: &[&str]) -> (i32, String) {
        let output = Command::cargo_bin("cardiotwin").unwrap().current_dir(self.path()).args(arguments).output().unwrap();
        (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
    }

    /// Exit code, stderr and warnings of a heart tracked in images whose frames `edit` has changed.
    fn tracked(&self, edit: impl FnOnce(&mut Vec<&mut [u8]>), settings: &[&str]) -> (i32, String, Vec<String>) {
        let mut bytes = self.cine.clone();
        let (_, voxels) = bytes.split_at_mut(352);
        let frame_bytes = voxels.len() / FRAMES;
        edit(&mut voxels.chunks_exact_mut(frame_bytes).collect());
        std::fs::write(self.path().join("cine.nii"), bytes).unwrap();
        let arguments: Vec<&str> =
            ["run", "track.toml", "-o", "tracked", "-q"].into_iter().chain(settings.iter().flat_map(|s| ["--set", s])).collect();
        let (code, words) = self.cardiotwin(&arguments);
        let text = std::fs::read_to_string(self.path().join("tracked/summary.json")).unwrap_or_else(|_| "{}".into());
        let summary: Value = serde_json::from_str(&text).unwrap();
        let warnings = summary["warnings"].as_array().into_iter().flatten().map(|w| w.as_str().unwrap().to_string()).collect();
        std::fs::remove_dir_all(self.path().join("tracked")).ok();
        (code, words, warnings)
    }
}

#[test]
fn images_that_contradict_the_heart_are_refused_or_said() {
    let patient = Patient::new();
    let warned = |(code, words, warnings): (i32, String, Vec<String>), expected: &[&str]| {
        assert_eq!(code, 0, "{words}");
        for part in expected {
            assert!(warnings.iter().any(|warning| warning.contains(part)), "{part:?} not in {warnings:?}");
        }
    };
    let (code, words, warnings) = patient.tracked(|_| {}, &[]);
    assert!(code == 0 && warnings.is_empty(), "sound images: {words} {warnings:?}");
    warned(patient.tracked(|frames| frames[6].fill(0), &[]), &["frame 6: a boundary was found on only", "frame 6 resembles neither"]);
    let swap = |frames: &mut Vec<&mut [u8]>| {
        let [_, _, _, _, a, .., b] = &mut frames[..] else { unreachable!("ten frames") };
        a.swap_with_slice(b);
    };
    let (code, words, warnings) = patient.tracked(swap, &[]);
    assert!(code == 0 && warnings.iter().any(|warning| warning.contains("out of order")), "{code} {words} {warnings:?}");
    let exchange = |frames: &mut Vec<&mut [u8]>| {
        let [_, _, one, _, other, ..] = &mut frames[..] else { unreachable!("ten frames") };
        one.swap_with_slice(other);
    };
    warned(patient.tracked(exchange, &[]), &["frames 2 and 4 resemble each other's neighbours more than their own"]);
    let (code, words, _) = patient.tracked(|frames| frames[1..8].iter_mut().for_each(|frame| frame.fill(0)), &[]);
    assert!(code == 1 && words.contains("a boundary was found on only 0 of"), "most frames are black: {code} {words}");
    let (code, words, _) = patient.tracked(|frames| frames[4][400..404].copy_from_slice(&f32::NAN.to_le_bytes()), &[]);
    assert!(code != 0 && words.contains("of frame 4 is not finite"), "{code} {words}");
    warned(patient.tracked(|_| {}, &["electrophysiology.heart_period_s=0.5"]), &["make a heart period of 0.800 s, but 0.5 s were given"]);
    warned(patient.tracked(|_| {}, &["electrophysiology.heart_period_s=1.2"]), &["of the beat; 400 ms at its end are not seen"]);
}
