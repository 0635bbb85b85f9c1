//! Cine sequences and label maps as NIfTI-1 files (`.nii.gz`), as scanners' files are read: sform and qform, RAS mm, frame step in seconds.
//!
//! The header is laid out here byte by byte: the `nifti` crate writes to paths only, and from one array that holds a copy of all frames.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::GzEncoder;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::image::{CineSequence, Grid, LabelMap};

/// Length of the header and of the empty list of extensions after it.
const VOXEL_OFFSET: usize = 352;

/// What the voxels are, in the numbers of the standard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Voxels {
    /// 32-bit floats.
    Intensities,
    /// Bytes that name tissues.
    Labels,
}

/// Writes a cine sequence, compressed, as 32-bit floats. Its frames must be evenly spaced over its heart period, as the header knows a first time
/// and a step only; both are written in seconds.
///
/// # Errors
/// Those of `out`; [`io::ErrorKind::InvalidInput`] if frames are not evenly spaced, or there are more voxels along an axis than the format can say.
pub fn write_cine(out: &mut dyn Write, cine: &CineSequence) -> io::Result<()> {
    let (start_s, step_s) = even_times(cine.times_s(), cine.period_s())?;
    let header = header(cine.grid(), Some((cine.frames().len(), start_s, step_s)), Voxels::Intensities)?;
    let frames = cine.frames().iter().map(|frame| frame.values().iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>());
    write_compressed(out, &header, frames)
}

/// Writes the label maps of all frames of a beat (on one grid), compressed, as bytes; the times are those of [`write_cine`].
///
/// # Errors
/// As [`write_cine`]; [`io::ErrorKind::InvalidInput`] if there is not one map a time, or they lie on several grids.
pub fn write_label_maps(out: &mut dyn Write, maps: &[LabelMap], times_s: &[f64], period_s: f64) -> io::Result<()> {
    let Some(first) = maps.first().filter(|first| maps.len() == times_s.len() && maps.iter().all(|map| map.grid() == first.grid())) else {
        return Err(invalid(format!("{} label maps at {} times; one a time, on one grid, is needed", maps.len(), times_s.len())));
    };
    let (start_s, step_s) = even_times(times_s, period_s)?;
    let header = header(first.grid(), Some((maps.len(), start_s, step_s)), Voxels::Labels)?;
    write_compressed(out, &header, maps.iter().map(|map| map.labels().to_vec()))
}

/// Writes one label map, compressed, as bytes of a 3-D image.
///
/// # Errors
/// Those of `out`; [`io::ErrorKind::InvalidInput`] if there are more voxels along an axis than the format can say.
pub fn write_label_map(out: &mut dyn Write, map: &LabelMap) -> io::Result<()> {
    write_compressed(out, &header(map.grid(), None, Voxels::Labels)?, std::iter::once(map.labels().to_vec()))
}

fn invalid(reason: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, reason)
}

fn write_compressed(out: &mut dyn Write, header: &[u8], frames: impl Iterator<Item = Vec<u8>>) -> io::Result<()> {
    let mut encoder = GzEncoder::new(out, Compression::default());
    encoder.write_all(header)?;
    for frame in frames {
        encoder.write_all(&frame)?;
    }
    encoder.finish()?.flush()
}

/// The first time and the step of frames that are spread evenly over the period.
fn even_times(times_s: &[f64], period_s: f64) -> io::Result<(f64, f64)> {
    const TOLERANCE: f64 = 1e-3;
    let start_s = times_s.first().copied().unwrap_or(0.0);
    let step_s = period_s / times_s.len().max(1) as f64;
    let is_even = |(n, time_s): (usize, &f64)| (time_s - start_s - n as f64 * step_s).abs() <= TOLERANCE * step_s;
    if times_s.iter().enumerate().all(is_even) {
        return Ok((start_s, step_s));
    }
    Err(invalid(format!("the frames are not spread evenly over the heart period of {period_s} s, which a NIfTI header cannot say")))
}

/// A header of the standard's layout, with its list of extensions, which is empty. `time`: frames, first time and step, s; none for a 3-D image.
fn header(grid: &Grid, time: Option<(usize, f64, f64)>, voxels: Voxels) -> io::Result<Vec<u8>> {
    const MM_AND_SECONDS: u8 = 2 | 8;
    const SCANNER_COORDINATES: i16 = 1;
    const LABEL_INTENT: i16 = 1002;
    let mut bytes = vec![0; VOXEL_OFFSET];
    let mut put = |offset: usize, value: &[u8]| bytes[offset..offset + value.len()].copy_from_slice(value);
    let [ni, nj, nk] = grid.shape();
    let (frame_count, start_s, step_s) = time.unwrap_or((1, 0.0, 0.0));
    let dimensions = [if time.is_some() { 4 } else { 3 }, ni, nj, nk, frame_count, 1, 1, 1];
    put(0, &348_i32.to_le_bytes());
    for (place, count) in dimensions.into_iter().enumerate() {
        let count =
            i16::try_from(count).map_err(|_| invalid(format!("{count} voxels or frames along an axis are too many for NIfTI-1")))?;
        put(40 + 2 * place, &count.to_le_bytes());
    }
    let (intent, datatype, bits): (i16, i16, i16) = match voxels {
        Voxels::Intensities => (0, 16, 32),
        Voxels::Labels => (LABEL_INTENT, 2, 8),
    };
    put(68, &intent.to_le_bytes());
    put(70, &datatype.to_le_bytes());
    put(72, &bits.to_le_bytes());
    let Orientation { turn, handedness } = Orientation::of(grid);
    let spacing = grid.spacing_mm();
    let sizes = [handedness, spacing.x, spacing.y, spacing.z, step_s, 1.0, 1.0, 1.0];
    sizes.iter().enumerate().for_each(|(n, size)| put(76 + 4 * n, &(*size as f32).to_le_bytes()));
    put(108, &(VOXEL_OFFSET as f32).to_le_bytes());
    put(112, &1.0_f32.to_le_bytes());
    put(123, &[MM_AND_SECONDS]);
    put(136, &(start_s as f32).to_le_bytes());
    put(254, &SCANNER_COORDINATES.to_le_bytes());
    let affine = grid.voxel_to_world();
    if let Some(turn) = turn {
        put(252, &SCANNER_COORDINATES.to_le_bytes());
        let numbers = [turn.i, turn.j, turn.k, affine[(0, 3)], affine[(1, 3)], affine[(2, 3)]];
        numbers.iter().enumerate().for_each(|(n, number)| put(256 + 4 * n, &(*number as f32).to_le_bytes()));
    }
    for row in 0..3 {
        (0..4).for_each(|column| put(280 + 16 * row + 4 * column, &(affine[(row, column)] as f32).to_le_bytes()));
    }
    put(344, b"n+1\0");
    Ok(bytes)
}

/// The voxel axes as a quaternion of non-negative real part and a sign of the third axis; no quaternion for axes that are not at right angles.
struct Orientation {
    turn: Option<UnitQuaternion<f64>>,
    handedness: f64,
}

impl Orientation {
    fn of(grid: &Grid) -> Self {
        const SKEW: f64 = 1e-5;
        let axes = Matrix3::from_fn(|row, column| grid.voxel_to_world()[(row, column)] / grid.spacing_mm()[column]);
        let handedness = axes.determinant().signum();
        let right_handed = axes * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, handedness));
        let is_rotation = (right_handed.transpose() * right_handed - Matrix3::identity()).norm() < SKEW;
        let turn = is_rotation.then(|| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(right_handed)));
        let turn = turn.map(|q| if q.w < 0.0 { UnitQuaternion::new_unchecked(-q.into_inner()) } else { q });
        Self { turn, handedness }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix4;

    use super::super::{NiftiImage, affine_mm, read_from, read_header};
    use super::*;
    use crate::image::Volume;
    use std::path::Path;

    /// Oblique, and left-handed where asked.
    fn grid(handedness: f64) -> Grid {
        let turn = Rotation3::from_euler_angles(0.3, -2.2, 1.1).to_homogeneous();
        let scale = Matrix4::new_nonuniform_scaling(&Vector3::new(1.5, 1.25, 8.0 * handedness));
        Grid::new([5, 4, 3], Matrix4::new_translation(&Vector3::new(-40.5, 12.25, 100.0)) * turn * scale).unwrap()
    }

    fn cine(grid: &Grid) -> CineSequence {
        let frame = |n: usize| Volume::new(grid.clone(), (0..60).map(|v| (v * (n + 1)) as f32 - 7.25).collect()).unwrap();
        CineSequence::new((0..4).map(frame).collect(), (0..4).map(|n| -0.02 + 0.2 * f64::from(n)).collect(), 0.8).unwrap()
    }

    fn read(bytes: &[u8]) -> NiftiImage {
        read_from(bytes, Path::new("written.nii.gz")).unwrap()
    }

    #[test]
    fn a_cine_comes_back_with_its_values_times_and_place() {
        for grid in [grid(1.0), grid(-1.0)] {
            let cine = cine(&grid);
            let mut bytes = Vec::new();
            write_cine(&mut bytes, &cine).unwrap();
            let image = read(&bytes);
            assert!(image.warnings.is_empty(), "{:?}", image.warnings);
            assert!((image.start_s + 0.02).abs() < 1e-8 && (image.step_s.unwrap() - 0.2).abs() < 1e-8);
            for (found, frame) in image.frames.iter().zip(cine.frames()) {
                assert_eq!(found.values(), frame.values());
                // Positions of order 100 mm in single precision.
                assert!((found.grid().voxel_to_world() - grid.voxel_to_world()).norm() < 1e-5);
            }
            assert_eq!(image.frames.len(), 4);
        }
    }

    #[test]
    fn the_qform_says_the_same_as_the_sform() {
        for grid in [grid(1.0), grid(-1.0)] {
            let mut bytes = header(&grid, None, Voxels::Labels).unwrap();
            bytes[254] = 0;
            let header = read_header(&mut &bytes[..]).unwrap();
            let by_qform = affine_mm(&header, &mut Vec::new()).unwrap();
            assert!((by_qform - grid.voxel_to_world()).norm() < 1e-4, "{by_qform}");
        }
    }

    #[test]
    fn skewed_axes_have_no_qform_and_keep_their_sform() {
        let skewed = Matrix4::new(2.0, 0.0, 1.0, 5.0, 0.0, 2.0, 0.0, 6.0, 0.0, 0.0, 8.0, 7.0, 0.0, 0.0, 0.0, 1.0);
        let grid = Grid::new([2, 2, 2], skewed).unwrap();
        let map = LabelMap::new(grid.clone(), vec![0, 1, 2, 3, 0, 1, 2, 255]).unwrap();
        let mut bytes = Vec::new();
        write_label_map(&mut bytes, &map).unwrap();
        let image = read(&bytes);
        assert_eq!(image.frames[0].grid(), &grid);
        assert_eq!(image.frames[0].values(), [0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 255.0]);
    }

    #[test]
    fn what_a_header_cannot_say_is_refused() {
        let cine = cine(&grid(1.0));
        let half = CineSequence::new(cine.frames().to_vec(), vec![0.0, 0.1, 0.2, 0.3], 0.8).unwrap();
        assert!(write_cine(&mut Vec::new(), &half).unwrap_err().to_string().contains("not spread evenly"));
        let map = LabelMap::new(grid(1.0), vec![0; 60]).unwrap();
        assert!(write_label_maps(&mut Vec::new(), &[map], &[0.0, 0.1], 0.2).is_err());
        let long = Grid::axis_aligned([40_000, 1, 1], Vector3::zeros(), Vector3::repeat(1.0)).unwrap();
        assert!(write_label_map(&mut Vec::new(), &LabelMap::new(long, vec![0; 40_000]).unwrap()).is_err());
    }
}
