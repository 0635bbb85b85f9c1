//! Folders of DICOM files as scanners leave them, written here, of a moving pattern that is known at every place and phase.

use std::f64::consts::TAU;

use dicom_core::value::{C, PixelFragmentSequence};
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, Tag};
use nalgebra::{Rotation3, Vector3};

use super::*;

const EXPLICIT: &str = "1.2.840.10008.1.2.1";
const IMPLICIT: &str = "1.2.840.10008.1.2";
const RLE: &str = "1.2.840.10008.1.2.5";
const JPEG_2000: &str = "1.2.840.10008.1.2.4.90";
const JPEG_LS: &str = "1.2.840.10008.1.2.4.80";

/// The stored numbers of `File::new(0, 0, 4, …)`, packed without loss by OpenJPEG 2.5.4 (Pillow 13.0, three resolutions).
const SLICE_J2K: &[u8] = include_bytes!("../../../tests/images/slice_12x9.j2k");
const SHAPE: [usize; 2] = [12, 9];
const SPACING_MM: [f64; 2] = [1.5, 1.7];
const GAP_MM: f64 = 8.0;

/// What one file says.
struct File {
    slice: f64,
    phase: f64,
    period_ms: f64,
    series: String,
    number: i64,
    trigger: bool,
    syntax: &'static str,
}

impl File {
    fn new(slice: usize, frame: usize, frame_count: usize, period_ms: f64) -> Self {
        let phase = (frame as f64 + 0.4) / frame_count as f64;
        let (series, number) = (format!("1.2.{}", slice + 1), frame as i64 + 1);
        Self { slice: slice as f64, phase, period_ms, series, number, trigger: true, syntax: EXPLICIT }
    }
}

/// Axes in DICOM's LPS: columns, rows, slices.
fn axes() -> [Vector3<f64>; 3] {
    let rotation = Rotation3::from_euler_angles(0.3, -0.5, 0.9);
    [rotation * Vector3::x(), rotation * Vector3::y(), rotation * Vector3::z()]
}

/// Intensity at an LPS position and a phase; whole numbers up to 0.5.
fn intensity(lps: Vector3<f64>, phase: f64) -> f64 {
    500.0 + 6.0 * lps.x - 4.0 * lps.y + 3.0 * lps.z + 80.0 * (TAU * phase).sin()
}

fn first_pixel(slice: f64) -> Vector3<f64> {
    Vector3::new(-20.0, 15.0, 40.0) + axes()[2] * GAP_MM * slice
}

fn write(path: &Path, file: &File) {
    let [columns, rows, _] = axes();
    let origin = first_pixel(file.slice);
    let place = |flat: usize| origin + columns * SPACING_MM[0] * (flat % SHAPE[0]) as f64 + rows * SPACING_MM[1] * (flat / SHAPE[0]) as f64;
    // Stored as half of the intensity less 100, so that slope and intercept matter.
    let stored: Vec<u16> =
        (0..SHAPE[0] * SHAPE[1]).map(|flat| ((intensity(place(flat), file.phase) - 100.0) / 0.25).round() as u16).collect();
    let text = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join("\\");
    let mut object = InMemDicomObject::new_empty();
    let mut put = |group, element, vr, value: String| {
        object.put(DataElement::new(Tag(group, element), vr, PrimitiveValue::from(value)));
    };
    put(0x0008, 0x103E, VR::LO, "cine".into());
    put(0x0018, 0x0050, VR::DS, GAP_MM.to_string());
    if file.trigger {
        put(0x0018, 0x1060, VR::DS, format!("{:.1}", file.phase * file.period_ms));
    }
    put(0x0018, 0x1062, VR::IS, format!("{}", file.period_ms.round()));
    put(0x0020, 0x000E, VR::UI, file.series.clone());
    put(0x0020, 0x0013, VR::IS, file.number.to_string());
    put(0x0020, 0x0032, VR::DS, text(origin.as_slice()));
    put(0x0020, 0x0037, VR::DS, text(&[columns.as_slice(), rows.as_slice()].concat()));
    put(0x0028, 0x0030, VR::DS, text(&[SPACING_MM[1], SPACING_MM[0]]));
    put(0x0028, 0x1052, VR::DS, "100".into());
    put(0x0028, 0x1053, VR::DS, "0.25".into());
    let shorts = [(0x0002, 1), (0x0010, SHAPE[1]), (0x0011, SHAPE[0]), (0x0100, 16), (0x0101, 16), (0x0102, 15), (0x0103, 0)];
    for (element, value) in shorts {
        object.put(DataElement::new(Tag(0x0028, element), VR::US, PrimitiveValue::from(value as u16)));
    }
    object.put(DataElement::new(Tag(0x0028, 0x0004), VR::CS, PrimitiveValue::from("MONOCHROME2")));
    let pixels = Tag(0x7FE0, 0x0010);
    if [RLE, JPEG_2000, JPEG_LS].contains(&file.syntax) {
        let frame = if file.syntax == JPEG_2000 { SLICE_J2K.to_vec() } else { run_length(&stored) };
        let fragments: C<Vec<u8>> = C::from_vec(vec![frame]);
        object.put(DataElement::new(pixels, VR::OB, PixelFragmentSequence::new_fragments(fragments)));
    } else {
        object.put(DataElement::new(pixels, VR::OW, PrimitiveValue::U16(C::from_vec(stored))));
    }
    let meta = FileMetaTableBuilder::new().transfer_syntax(file.syntax).media_storage_sop_class_uid("1.2.840.10008.5.1.4.1.1.4");
    let meta = meta.media_storage_sop_instance_uid(format!("{}.{}", file.series, file.number));
    object.with_meta(meta).unwrap().write_to_file(path).unwrap();
}

/// High bytes, then low bytes, as literal runs (PS3.5 annex G).
fn run_length(words: &[u16]) -> Vec<u8> {
    let segment = |shift: u32| {
        let bytes: Vec<u8> = words.iter().map(|word| (word >> shift) as u8).collect();
        let mut runs: Vec<u8> = bytes.chunks(128).flat_map(|run| std::iter::once(run.len() as u8 - 1).chain(run.iter().copied())).collect();
        runs.resize(runs.len().next_multiple_of(2), 0x80);
        runs
    };
    let (high, low) = (segment(8), segment(0));
    let mut header = [0_u32; 16];
    header[..3].copy_from_slice(&[2, 64, 64 + high.len() as u32]);
    [header.iter().flat_map(|word| word.to_le_bytes()).collect(), high, low].concat()
}

fn write_all(folder: &Path, files: &[File]) {
    for (n, file) in files.iter().enumerate() {
        // Names in an order that says nothing.
        write(&folder.join(format!("{:05}.dcm", (n * 7919) % 100_003)), file);
    }
}

fn stack_files(slices: std::ops::Range<usize>, frame_count: usize) -> Vec<File> {
    let period_ms = |slice: usize| 700.0 + 12.0 * (slice % 3) as f64;
    slices.flat_map(|slice| (0..frame_count).map(move |frame| File::new(slice, frame, frame_count, period_ms(slice)))).collect()
}

/// The largest difference to the pattern over all voxels and frames.
fn deviation(cine: &crate::image::CineSequence) -> f64 {
    let grid = cine.grid();
    let mut largest: f64 = 0.0;
    for (frame, time_s) in cine.frames().iter().zip(cine.times_s()) {
        for flat in 0..grid.voxel_count() {
            let ras = grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|n| n as f64)));
            let expected = intensity(Vector3::new(-ras.x, -ras.y, ras.z), time_s / cine.period_s());
            largest = largest.max((f64::from(frame.values()[flat]) - expected).abs());
        }
    }
    largest
}

fn read(files: &[File]) -> Result<DicomFolder, ImageError> {
    let folder = tempfile::tempdir().unwrap();
    write_all(folder.path(), files);
    read_dicom_folder(folder.path(), &CineTiming::default())
}

#[test]
fn slices_of_many_series_and_periods_become_one_stack_in_world_coordinates() {
    let folder = read(&stack_files(0..5, 10)).unwrap();
    assert_eq!(folder.stacks.len(), 1);
    let cine = &folder.stacks[0].reading.cine;
    assert_eq!((cine.grid().shape(), cine.times_s().len()), ([12, 9, 5], 10));
    assert!((cine.period_s() - 0.712).abs() < 1e-9);
    assert!((cine.times_s()[3] - 0.712 * 0.34).abs() < 2e-4);
    // Half a stored unit, and trigger times rounded to 0.1 ms.
    assert!(deviation(cine) < 0.25, "{}", deviation(cine));
    assert!(folder.stacks[0].reading.warnings.iter().any(|w| w.contains("700 to 724 ms")), "{:?}", folder.stacks[0].reading.warnings);
}

#[test]
fn transfer_syntaxes_are_read_alike() {
    let with = |syntax| {
        let mut files = stack_files(0..3, 4);
        files.iter_mut().for_each(|file| file.syntax = syntax);
        read(&files).unwrap().stacks[0].reading.cine.clone()
    };
    let explicit = with(EXPLICIT);
    assert_eq!(explicit, with(IMPLICIT));
    assert_eq!(explicit, with(RLE));
}

/// One file, and what was read of it.
fn read_slice(syntax: &'static str, edit: impl FnOnce(&mut Vec<u8>)) -> Result<Instance, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slice.dcm");
    write(&path, &File { syntax, ..File::new(0, 0, 4, 700.0) });
    let mut bytes = std::fs::read(&path).unwrap();
    edit(&mut bytes);
    std::fs::write(&path, bytes).unwrap();
    Instance::read(&path).map_err(|skipped| match skipped {
        Skipped::Unusable(reason) => reason,
        Skipped::NotDicom => "no DICOM file".into(),
    })
}

/// Another program's packing gives every number back; a codestream of another size is refused before it is unpacked.
#[test]
fn jpeg_2000_is_read_without_loss_and_held_to_the_size_of_the_slice() {
    let plain = read_slice(EXPLICIT, |_| {}).unwrap();
    assert_eq!(read_slice(JPEG_2000, |_| {}).unwrap().values, plain.values);
    let place = |bytes: &[u8]| bytes.windows(4).position(|word| word == [0xFF, 0x4F, 0xFF, 0x51]).unwrap();
    let wider = read_slice(JPEG_2000, |bytes| {
        let start = place(bytes);
        bytes[start + 11] = 200;
    });
    assert!(wider.unwrap_err().contains("1 components of 200 × 9 pixels (every 1 across, every 1 down) where one of 12 × 9"));
    let coarser = read_slice(JPEG_2000, |bytes| {
        let start = place(bytes);
        bytes[start + 43] = 2;
    });
    assert!(coarser.unwrap_err().contains("every 2 across"));
    let headless = read_slice(JPEG_2000, |bytes| {
        let start = place(bytes);
        bytes[start] = 0;
    });
    assert!(headless.unwrap_err().contains("codestream does not begin"));
}

#[test]
fn a_compression_that_is_not_read_is_named_with_the_remedy() {
    let mut files = stack_files(0..2, 4);
    files.iter_mut().for_each(|file| file.syntax = JPEG_LS);
    let message = read(&files).unwrap_err().to_string();
    assert!(message.contains("JPEG-LS") && message.contains("convert it to an uncompressed file"), "{message}");
}

#[test]
fn a_slice_of_other_phases_is_brought_onto_the_common_ones() {
    let mut files = stack_files(0..4, 24);
    files.retain(|file| file.slice != 2.0);
    files.extend((0..19).map(|frame| File::new(2, frame, 19, 700.0)));
    let stack = &read(&files).unwrap().stacks[0];
    assert!(stack.reading.warnings.iter().any(|w| w.contains("slice 2 has 19 frames")), "{:?}", stack.reading.warnings);
    // Linear interpolation of a sine of amplitude 80 between 19 frames: 80 (π/19)²/2 = 1.1.
    assert!(deviation(&stack.reading.cine) < 1.5, "{}", deviation(&stack.reading.cine));
}

#[test]
fn a_missing_slice_is_interpolated_and_said() {
    let mut files = stack_files(0..5, 6);
    files.retain(|file| file.slice != 2.0);
    let stack = &read(&files).unwrap().stacks[0];
    assert_eq!(stack.slice_count(), 5);
    assert!(stack.reading.warnings.iter().any(|w| w.contains("1 slices are missing")), "{:?}", stack.reading.warnings);
    assert!(deviation(&stack.reading.cine) < 0.25);
}

#[test]
fn without_trigger_times_frames_follow_their_numbers() {
    let mut files = stack_files(0..3, 8);
    for file in &mut files {
        file.trigger = false;
        file.period_ms = 800.0;
        file.phase = (file.number - 1) as f64 / 8.0;
    }
    let stack = &read(&files).unwrap().stacks[0];
    assert!((stack.reading.cine.period_s() - 0.8).abs() < 1e-9);
    assert!(deviation(&stack.reading.cine) < 0.25);
    assert!(stack.reading.warnings.iter().any(|w| w.contains("trigger times are missing")));
}

#[test]
fn mixed_series_damaged_files_and_strangers_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = stack_files(0..4, 6);
    files.iter_mut().for_each(|file| file.series = "1.9".into());
    // A repeated slice of another series, with other phases.
    files.extend((0..6).map(|frame| File { series: "1.8".into(), number: 50 + frame as i64, ..File::new(1, frame, 5, 650.0) }));
    write_all(folder.path(), &files);
    std::fs::write(folder.path().join("notes.txt"), "not an image").unwrap();
    std::fs::write(folder.path().join("damaged.dcm"), b"DICM?").unwrap();
    let read = read_dicom_folder(folder.path(), &CineTiming::default()).unwrap();
    assert!(deviation(&read.stacks[0].reading.cine) < 0.25);
    assert!(
        read.stacks[0].reading.warnings.iter().any(|w| w.contains("6 images of other series")),
        "{:?}",
        read.stacks[0].reading.warnings
    );
    assert_eq!(read.warnings.len(), 1, "{:?}", read.warnings);
    assert!(read.warnings[0].contains("damaged.dcm"));
}

#[test]
fn folders_without_a_cine_say_why() {
    let message = |files: &[File]| read(files).unwrap_err().to_string();
    assert!(message(&[]).contains("no DICOM file"));
    assert!(message(&stack_files(0..4, 1)).contains("one instant only"));
    let mut uneven = stack_files(0..5, 4);
    uneven.iter_mut().filter(|file| file.slice == 3.0).for_each(|file| file.slice = 3.4);
    assert!(message(&uneven).contains("no regular stack"));
    assert!(read_dicom_folder(Path::new("no_such_folder"), &CineTiming::default()).unwrap_err().to_string().contains("no_such_folder"));
}

#[test]
fn garbled_files_never_panic() {
    use rand::{Rng, SeedableRng};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slice.dcm");
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    for syntax in [EXPLICIT, RLE, JPEG_2000] {
        write(&path, &File { syntax, ..File::new(0, 0, 4, 700.0) });
        let whole = std::fs::read(&path).unwrap();
        for round in 0..30 {
            let mut bytes = whole.clone();
            for _ in 0..random.random_range(1..5) {
                // JPEG 2000 is met in its own bytes, at the end, as often as in the tags.
                let first = if syntax == JPEG_2000 && random.random() { bytes.len() - SLICE_J2K.len() } else { 128 };
                let at = random.random_range(first..bytes.len());
                bytes[at] = random.random();
            }
            if round % 4 == 0 {
                bytes.truncate(random.random_range(0..whole.len()));
            }
            std::fs::write(&path, &bytes).unwrap();
            let _ = Instance::read(&path);
        }
    }
}
