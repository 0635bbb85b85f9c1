//! NIfTI files written byte by byte here, so that reader and crate are tested against the standard's layout and not against a writer.

use proptest::prelude::{Arbitrary, any};

use super::*;

/// A header by byte offset, as the NIfTI-1 standard lays it out.
struct Bytes(Vec<u8>);

impl Bytes {
    fn new(dims: &[i16], datatype: i16, bits: i16) -> Self {
        let mut bytes = Self(vec![0; 352]);
        bytes.put(0, &348_i32.to_le_bytes());
        bytes.put(40, &(dims.len() as i16).to_le_bytes());
        for (axis, n) in dims.iter().enumerate() {
            bytes.put(42 + 2 * axis, &n.to_le_bytes());
        }
        bytes.put(70, &datatype.to_le_bytes());
        bytes.put(72, &bits.to_le_bytes());
        bytes.floats(76, &[1.0, 1.5, 2.0, 8.0, 35.0]);
        bytes.floats(108, &[352.0]);
        bytes.put(123, &[2 | 16]);
        bytes.put(254, &1_i16.to_le_bytes());
        bytes.floats(280, &[-1.5, 0.0, 0.0, 10.0]);
        bytes.floats(296, &[0.0, 2.0, 0.0, -20.0]);
        bytes.floats(312, &[0.0, 0.0, 8.0, 30.0]);
        bytes.put(344, b"n+1\0");
        bytes
    }

    fn put(&mut self, offset: usize, bytes: &[u8]) {
        self.0[offset..offset + bytes.len()].copy_from_slice(bytes);
    }

    fn floats(&mut self, offset: usize, values: &[f32]) {
        values.iter().enumerate().for_each(|(n, v)| self.put(offset + 4 * n, &v.to_le_bytes()));
    }

    fn with_voxels(mut self, voxels: &[u8]) -> Vec<u8> {
        self.0.extend_from_slice(voxels);
        self.0
    }
}

fn int16_image() -> Vec<u8> {
    let voxels: Vec<u8> = (0..2 * 3 * 2 * 2_i16).flat_map(|v| (10 * v - 7).to_le_bytes()).collect();
    Bytes::new(&[2, 3, 2, 2], 4, 16).with_voxels(&voxels)
}

fn read_bytes(bytes: &[u8]) -> Result<NiftiImage, ImageError> {
    read_from(bytes, Path::new("image.nii"))
}

fn compressed(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn message(bytes: &[u8]) -> String {
    read_bytes(bytes).unwrap_err().to_string()
}

#[test]
fn int16_values_lie_where_the_standard_says() {
    for bytes in [int16_image(), compressed(&int16_image())] {
        let image = read_bytes(&bytes).unwrap();
        assert_eq!(image.frames.len(), 2);
        assert_eq!(image.frames[0].at([1, 0, 0]), 3.0);
        assert_eq!(image.frames[0].at([0, 1, 0]), 13.0);
        assert_eq!(image.frames[1].at([0, 0, 1]), 173.0);
        assert_eq!(image.frames[0].grid().to_world_mm(&Vector3::new(1.0, 2.0, 1.0)), Vector3::new(8.5, -16.0, 38.0));
        assert!((image.step_s.unwrap() - 0.035).abs() < 1e-9);
        assert!(image.warnings.is_empty());
    }
}

#[test]
fn slope_and_intercept_apply_to_every_type_and_nan_means_none() {
    let mut header = Bytes::new(&[2, 1, 1], 2, 8);
    header.floats(112, &[0.5, -1.0]);
    assert_eq!(read_bytes(&header.with_voxels(&[0, 250])).unwrap().frames[0].values(), [-1.0, 124.0]);
    let mut header = Bytes::new(&[2, 1, 1], 16, 32);
    header.floats(112, &[f32::NAN, f32::NAN]);
    let voxels = [1.25_f32, -3.5].map(f32::to_le_bytes).concat();
    assert_eq!(read_bytes(&header.with_voxels(&voxels)).unwrap().frames[0].values(), [1.25, -3.5]);
}

#[test]
fn every_real_type_is_read() {
    let types: [(i16, i16, Vec<u8>); 8] = [
        (2, 8, vec![200, 3]),
        (256, 8, vec![200, 3]),
        (4, 16, [200_i16, 3].map(i16::to_le_bytes).concat()),
        (512, 16, [60_000_u16, 3].map(u16::to_le_bytes).concat()),
        (8, 32, [-70_000_i32, 3].map(i32::to_le_bytes).concat()),
        (768, 32, [70_000_u32, 3].map(u32::to_le_bytes).concat()),
        (16, 32, [0.5_f32, 3.0].map(f32::to_le_bytes).concat()),
        (64, 64, [0.25_f64, 3.0].map(f64::to_le_bytes).concat()),
    ];
    let expected = [200.0, -56.0, 200.0, 60_000.0, -70_000.0, 70_000.0, 0.5, 0.25];
    for ((datatype, bits, voxels), first) in types.into_iter().zip(expected) {
        let image = read_bytes(&Bytes::new(&[2, 1, 1], datatype, bits).with_voxels(&voxels)).unwrap();
        assert_eq!(image.frames[0].values(), [first, 3.0], "type {datatype}");
    }
}

#[test]
fn units_of_metres_micrometres_and_seconds_become_mm_and_s() {
    for (code, scale) in [(1_u8, 1000.0_f64), (2, 1.0), (3, 1e-3)] {
        let mut header = Bytes(int16_image());
        header.put(123, &[code | 8]);
        let image = read_bytes(&header.0).unwrap();
        assert!((image.frames[0].grid().spacing_mm() - Vector3::new(1.5, 2.0, 8.0) * scale).norm() < 1e-6 * scale);
        assert_eq!(image.step_s, Some(35.0));
    }
}

#[test]
fn sform_wins_over_qform_and_qform_serves_without() {
    // A quarter turn about z (a = d = √½) and a flipped slice axis.
    let mut header = Bytes(int16_image());
    header.put(252, &1_i16.to_le_bytes());
    header.floats(76, &[-1.0]);
    header.floats(256, &[0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2, 1.0, 2.0, 3.0]);
    let by_sform = read_bytes(&header.0).unwrap().frames[0].grid().to_world_mm(&Vector3::zeros());
    assert_eq!(by_sform, Vector3::new(10.0, -20.0, 30.0));
    header.put(254, &0_i16.to_le_bytes());
    let by_qform = read_bytes(&header.0).unwrap().frames[0].grid().to_world_mm(&Vector3::new(1.0, 2.0, 1.0));
    assert!((by_qform - Vector3::new(1.0 - 4.0, 2.0 + 1.5, 3.0 - 8.0)).norm() < 1e-5, "{by_qform}");
    header.put(252, &0_i16.to_le_bytes());
    assert!(read_bytes(&header.0).unwrap().warnings[0].contains("neither sform nor qform"));
}

#[test]
fn big_endian_files_are_read() {
    let mut header = int16_image();
    let swap = |bytes: &mut Vec<u8>, from: usize, width: usize, count: usize| {
        (0..count).for_each(|n| bytes[from + n * width..from + (n + 1) * width].reverse());
    };
    swap(&mut header, 0, 4, 1);
    swap(&mut header, 40, 2, 8);
    swap(&mut header, 68, 2, 4);
    swap(&mut header, 76, 4, 11);
    swap(&mut header, 252, 2, 2);
    swap(&mut header, 256, 4, 18);
    swap(&mut header, 352, 2, 24);
    let image = read_bytes(&header).unwrap();
    assert_eq!(image.frames[1].at([0, 0, 1]), 173.0);
}

#[test]
fn what_is_no_usable_image_is_said_clearly() {
    assert!(read_nifti(Path::new("no_such_file.nii.gz")).unwrap_err().to_string().contains("no_such_file.nii.gz"));
    assert!(message(b"").contains("ends after 0 bytes"));
    assert!(message(&[b'x'; 5000]).contains("no NIfTI-1 file"));
    assert!(message(&int16_image()[..360]).contains("cut off"));
    let whole = compressed(&int16_image());
    assert!(message(&whole[..whole.len() - 20]).contains("cut off"));
    assert!(message(&Bytes::new(&[2, 2], 2, 8).with_voxels(&[0; 4])).contains("3-D or 4-D"));
    assert!(message(&Bytes::new(&[2, 2, 1, 1, 3], 2, 8).with_voxels(&[0; 12])).contains("3-D or 4-D"));
    assert!(message(&Bytes::new(&[2, 0, 1], 2, 8).with_voxels(&[0; 4])).contains("cannot be used"));
    assert!(message(&Bytes::new(&[2, -4, 1], 2, 8).with_voxels(&[0; 4])).contains("cut off"));
    assert!(message(&Bytes::new(&[2, 2, 1], 2, 16).with_voxels(&[0; 8])).contains("16 bits"));
    assert!(message(&Bytes::new(&[1, 1, 1], 128, 24).with_voxels(&[0; 3])).contains("Rgb24"));
    assert!(message(&Bytes::new(&[32767, 32767, 32767, 32767], 64, 64).with_voxels(&[0; 8])).contains("16 GB"));
    let nan: Vec<u8> = [1.0, f32::NAN].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert!(message(&Bytes::new(&[2, 1, 1], 16, 32).with_voxels(&nan)).contains("voxel [1, 0, 0] of frame 0 is not finite"));
    let mut flat = Bytes(int16_image());
    flat.floats(312, &[0.0, 0.0, 0.0, 30.0]);
    assert!(message(&flat.0).contains("singular"));
    let mut undefined = Bytes(int16_image());
    undefined.floats(296, &[f32::NAN]);
    assert!(message(&undefined.0).contains("singular or not finite"));
    let mut no_spacing = Bytes(int16_image());
    no_spacing.put(254, &0_i16.to_le_bytes());
    no_spacing.put(252, &1_i16.to_le_bytes());
    no_spacing.floats(84, &[0.0]);
    assert!(message(&no_spacing.0).contains("singular"));
}

#[test]
fn labels_must_be_small_integers_and_a_cine_must_have_frames() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("image.nii");
    std::fs::write(&path, int16_image()).unwrap();
    assert!(read_label_map(&path).unwrap_err().to_string().contains("value -7"));
    let cine = read_cine(&path, &CineTiming::default()).unwrap_err();
    assert!(cine.to_string().contains("not believable"), "{cine}");
    let timing = CineTiming { period_s: Some(0.8), ..CineTiming::default() };
    assert_eq!(read_cine(&path, &timing).unwrap().cine.period_s(), 0.8);
    std::fs::write(&path, Bytes::new(&[2, 1, 1], 2, 8).with_voxels(&[0, 2])).unwrap();
    assert_eq!(read_label_map(&path).unwrap().labels(), [0, 2]);
    assert!(read_cine(&path, &timing).unwrap_err().to_string().contains("one frame"));
}

proptest::proptest! {
    /// Any answer is right but a panic or an exhausted memory.
    #[test]
    fn garbled_bytes_never_panic(
        edits in proptest::collection::vec((proptest::sample::Index::arbitrary(), any::<u8>()), 0..6),
        length in proptest::sample::Index::arbitrary(),
        cut in any::<bool>(),
        in_archive in any::<bool>(),
    ) {
        let mut bytes = if in_archive { compressed(&int16_image()) } else { int16_image() };
        for (at, byte) in edits {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if cut {
            bytes.truncate(length.index(bytes.len()));
        }
        let _ = read_bytes(&bytes);
        let _ = read_bytes(&compressed(&bytes));
    }

    /// Headers of the right size and magic that otherwise say anything.
    #[test]
    fn arbitrary_headers_never_panic(noise in proptest::collection::vec(any::<u8>(), 352), voxels in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut header = Bytes(noise);
        header.put(0, &348_i32.to_le_bytes());
        header.put(344, b"n+1\0");
        header.put(40, &4_i16.to_le_bytes());
        let _ = read_bytes(&header.with_voxels(&voxels));
    }
}

#[test]
fn a_slice_taken_at_other_phases_is_interpolated_as_the_sidecar_says() {
    // Two slices, four frames; the second slice half a frame late, its intensity rising by 10 a frame.
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cine.nii");
    let voxels: Vec<u8> = (0..4_i16).flat_map(|frame| [7, 10 * frame]).flat_map(i16::to_le_bytes).collect();
    std::fs::write(&path, Bytes::new(&[1, 1, 2, 4], 4, 16).with_voxels(&voxels)).unwrap();
    let times = |start: f64| (0..4).map(|frame| start + 200.0 * f64::from(frame)).collect::<Vec<_>>();
    let timing = CineTiming::from_trigger_times_ms(&[times(0.0), times(100.0), times(0.0)], &[]).unwrap();
    assert!(read_cine(&path, &timing).unwrap().warnings.iter().any(|w| w.contains("3 slices where the image has 2")));
    let timing = CineTiming::from_trigger_times_ms(&[times(0.0), times(0.0), times(100.0)], &[]).unwrap();
    let timing = CineTiming { phases: timing.phases.map(|p| CommonPhases { own: p.own[1..].to_vec(), ..p }), ..timing };
    let read = read_cine(&path, &timing).unwrap();
    let late: Vec<f32> = read.cine.frames().iter().map(|frame| frame.at([0, 0, 1])).collect();
    assert_eq!(late, [15.0, 5.0, 15.0, 25.0]);
    assert!(read.cine.frames().iter().all(|frame| frame.at([0, 0, 0]) == 7.0));
    assert!(read.warnings.iter().any(|w| w.contains("slices [1]")));
}
