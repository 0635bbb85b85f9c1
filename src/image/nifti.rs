//! NIfTI-1 files (.nii, .nii.gz) as volumes, cine sequences and label maps in world millimetres (RAS).
//!
//! Everything a header says is checked before a voxel is read, so that garbled files end in an [`ImageError`].

mod writer;

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use ::nifti::{InMemNiftiVolume, IntoNdArray, NiftiHeader, NiftiType};
use nalgebra::{Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector3};

use super::phases::CommonPhases;
use super::{CineSequence, CineTiming, Grid, ImageError, LabelMap, Volume};

pub use writer::{write_cine, write_label_map, write_label_maps};

/// A 3-D or 4-D image as its file tells it.
#[derive(Debug, Clone)]
pub struct NiftiImage {
    /// The frames; one for a 3-D image. All lie on one grid.
    pub frames: Vec<Volume>,
    /// Time of the first frame, s.
    pub start_s: f64,
    /// Time between frames, s, where the header has one.
    pub step_s: Option<f64>,
    /// What was assumed, in words.
    pub warnings: Vec<String>,
}

/// A cine sequence and what was assumed in reading it.
#[derive(Debug, Clone)]
pub struct CineReading {
    /// The frames with their times.
    pub cine: CineSequence,
    /// What was assumed, in words.
    pub warnings: Vec<String>,
}

/// Reads a 3-D or 4-D image: integers or floats of any size, scaled by its slope and intercept, in world mm by its sform, else its qform.
///
/// # Errors
/// [`ImageError::Unreadable`] if the file cannot be opened or ends early, [`ImageError::Unusable`] if what it holds makes no image.
pub fn read_nifti(path: &Path) -> Result<NiftiImage, ImageError> {
    let unreadable = |error: std::io::Error| ImageError::Unreadable { path: path.into(), reason: error.to_string() };
    read_from(BufReader::new(File::open(path).map_err(unreadable)?), path)
}

fn read_from<'a>(source: impl BufRead + 'a, path: &Path) -> Result<NiftiImage, ImageError> {
    let unreadable = |reason: String| ImageError::Unreadable { path: path.into(), reason };
    let unusable = |reason: String| ImageError::Unusable { path: path.into(), reason };
    let mut source = maybe_decompressed(source).map_err(|error| unreadable(error.to_string()))?;
    let header = read_header(&mut source).map_err(unusable)?;
    let layout = Layout::of(&header).map_err(unusable)?;
    let raw = read_voxel_bytes(&mut source, &header, &layout).map_err(unreadable)?;
    decode(&header, &layout, raw).map_err(unusable)
}

/// Reads a 4-D image as one heart beat; `timing` says what the header does not know or has wrong.
///
/// # Errors
/// As [`read_nifti`]; [`ImageError::Unusable`] if the image has one frame or the times contradict themselves.
pub fn read_cine(path: &Path, timing: &CineTiming) -> Result<CineReading, ImageError> {
    let unusable = |reason: String| ImageError::Unusable { path: path.into(), reason };
    let image = read_nifti(path)?;
    let frame_count = image.frames.len();
    if frame_count < 2 {
        return Err(unusable("it has one frame; a cine sequence is a 4-D image".into()));
    }
    let (times_s, period_s) = timing.resolve(frame_count, image.start_s, image.step_s).map_err(unusable)?;
    let mut warnings = [image.warnings, timing.warnings.clone()].concat();
    warnings.extend(image.step_s.and_then(|step_s| timing.contradiction(step_s, frame_count)));
    let frames = match &timing.phases {
        Some(phases) => at_common_phases(image.frames, phases, &mut warnings).map_err(|error| unusable(error.to_string()))?,
        None => image.frames,
    };
    let cine = CineSequence::new(frames, times_s, period_s).map_err(|error| unusable(error.to_string()))?;
    Ok(CineReading { cine, warnings })
}

/// Interpolates the slices (index k) that were taken at other phases than the rest.
fn at_common_phases(mut frames: Vec<Volume>, phases: &CommonPhases, warnings: &mut Vec<String>) -> Result<Vec<Volume>, ImageError> {
    let grid = frames[0].grid().clone();
    let [ni, nj, nk] = grid.shape();
    if phases.own.len() != nk || phases.own.iter().any(|own| own.len() != frames.len()) {
        warnings.push(format!(
            "times are known of {} slices where the image has {nk}: all slices were taken as simultaneous",
            phases.own.len()
        ));
        return Ok(frames);
    }
    let unfit = phases.unfit_slices();
    if unfit.is_empty() {
        return Ok(frames);
    }
    warnings.push(format!("slices {unfit:?} were taken at other phases of the beat: interpolated in time"));
    let mut values: Vec<Vec<f32>> = frames.drain(..).map(Volume::into_values).collect();
    for slice in unfit {
        let plane = ni * nj * slice..ni * nj * (slice + 1);
        let own: Vec<&[f32]> = values.iter().map(|frame| &frame[plane.clone()]).collect();
        let resampled = phases.resampled(slice, &own);
        for (frame, resampled) in values.iter_mut().zip(resampled) {
            frame[plane.clone()].copy_from_slice(&resampled);
        }
    }
    values.into_iter().map(|values| Volume::new(grid.clone(), values)).collect()
}

/// Reads a 3-D label map.
///
/// # Errors
/// As [`read_label_maps`]; [`ImageError::Unusable`] if it has several frames.
pub fn read_label_map(path: &Path) -> Result<LabelMap, ImageError> {
    let mut maps = read_label_maps(path)?;
    match (maps.pop(), maps.len()) {
        (Some(map), 0) => Ok(map),
        (_, others) => Err(ImageError::Unusable { path: path.into(), reason: format!("it has {} frames; one was expected", others + 1) }),
    }
}

/// Reads a 3-D or 4-D label map, one per frame.
///
/// # Errors
/// As [`read_nifti`]; [`ImageError::Unusable`] if a value is not an integer from 0 to 255.
pub fn read_label_maps(path: &Path) -> Result<Vec<LabelMap>, ImageError> {
    let unusable = |reason: String| ImageError::Unusable { path: path.into(), reason };
    let to_labels = |frame: Volume| {
        if let Some(value) = frame.values().iter().find(|v| v.fract() != 0.0 || **v < 0.0 || **v > 255.0) {
            return Err(unusable(format!("it has the value {value}; labels are integers from 0 to 255")));
        }
        LabelMap::new(frame.grid().clone(), frame.values().iter().map(|&v| v as u8).collect())
    };
    read_nifti(path)?.frames.into_iter().map(to_labels).collect()
}

/// The bytes, decompressed if they begin as gzip does, whatever the file's name.
fn maybe_decompressed<'a>(mut source: impl BufRead + 'a) -> std::io::Result<Box<dyn Read + 'a>> {
    let is_compressed = source.fill_buf()?.starts_with(&[0x1f, 0x8b]);
    Ok(if is_compressed { Box::new(flate2::bufread::MultiGzDecoder::new(source)) } else { Box::new(source) })
}

const HEADER_BYTES: u64 = 348;

/// More than any cine; a small compressed file must not fill the memory.
const VOXEL_BYTES_MAX: usize = 16 << 30;

fn read_header(source: &mut dyn Read) -> Result<NiftiHeader, String> {
    let mut bytes = Vec::new();
    source.take(HEADER_BYTES).read_to_end(&mut bytes).map_err(|error| format!("its header cannot be read: {error}"))?;
    if bytes.len() as u64 != HEADER_BYTES {
        return Err(format!("it ends after {} bytes, within the header; it is no NIfTI file or was cut off", bytes.len()));
    }
    let header = NiftiHeader::from_reader(bytes.as_slice()).map_err(|error| format!("it is no NIfTI-1 file ({error})"))?;
    if &header.magic == ::nifti::header::MAGIC_CODE_NI1 {
        return Err("it is a header whose voxels lie in another file; convert it to a single .nii file".into());
    }
    Ok(header)
}

/// What of the header tells where voxels lie, in the file and in the world.
struct Layout {
    shape: [usize; 3],
    frame_count: usize,
    datatype: NiftiType,
    byte_count: usize,
    voxel_to_world: Matrix4<f64>,
    warnings: Vec<String>,
}

impl Layout {
    fn of(header: &NiftiHeader) -> Result<Self, String> {
        let dims: Vec<usize> = header.dim().map_err(|error| error.to_string())?.iter().map(|&n| usize::from(n)).collect();
        if dims.len() < 3 || dims[4.min(dims.len())..].iter().any(|&n| n != 1) {
            return Err(format!("it has the dimensions {dims:?}; a 3-D or 4-D image is needed"));
        }
        let datatype = header.data_type().map_err(|error| error.to_string())?;
        if i64::from(header.bitpix) != 8 * datatype.size_of() as i64 {
            return Err(format!("its header contradicts itself: {} bits a voxel for the type {datatype:?}", header.bitpix));
        }
        let byte_count = dims
            .iter()
            .try_fold(datatype.size_of(), |product, &n| product.checked_mul(n))
            .filter(|&bytes| bytes <= VOXEL_BYTES_MAX)
            .ok_or_else(|| format!("its dimensions {dims:?} make more than {} GB of voxels", VOXEL_BYTES_MAX >> 30))?;
        let mut warnings = Vec::new();
        let voxel_to_world = affine_mm(header, &mut warnings)?;
        let frame_count = dims.get(3).copied().unwrap_or(1);
        Ok(Self { shape: [dims[0], dims[1], dims[2]], frame_count, datatype, byte_count, voxel_to_world, warnings })
    }
}

fn read_voxel_bytes(source: &mut dyn Read, header: &NiftiHeader, layout: &Layout) -> Result<Vec<u8>, String> {
    let offset = f64::from(header.vox_offset).max(352.0);
    if !(offset.is_finite() && offset <= 1e9) {
        return Err(format!("its voxels are said to begin at byte {offset}"));
    }
    let cut_off = |error: std::io::Error| format!("it is damaged or cut off: {error}");
    let skipped_bytes = offset as u64 - HEADER_BYTES;
    std::io::copy(&mut source.take(skipped_bytes), &mut std::io::sink()).map_err(cut_off)?;
    let mut raw = Vec::new();
    source.take(layout.byte_count as u64).read_to_end(&mut raw).map_err(cut_off)?;
    if raw.len() != layout.byte_count {
        return Err(format!("it is cut off: {} bytes of voxels where {} are announced", raw.len(), layout.byte_count));
    }
    Ok(raw)
}

fn decode(header: &NiftiHeader, layout: &Layout, raw: Vec<u8>) -> Result<NiftiImage, String> {
    if matches!(layout.datatype, NiftiType::Rgb24 | NiftiType::Rgba32 | NiftiType::Complex64 | NiftiType::Complex128) {
        return Err(format!("its voxels are of type {:?}; one real number a voxel is needed", layout.datatype));
    }
    // Slope and intercept are applied below in f64; a slope of zero or NaN means none.
    let stored = InMemNiftiVolume::from_raw_fields(header.dim, layout.datatype, 0.0, 0.0, raw, header.endianness)
        .and_then(|voxels| voxels.into_ndarray::<f32>())
        .map_err(|error| error.to_string())?;
    let (mut values, _) = stored.into_raw_vec_and_offset();
    let (slope, intercept) = (f64::from(header.scl_slope), f64::from(header.scl_inter));
    if slope.is_finite() && slope != 0.0 && intercept.is_finite() && (slope, intercept) != (1.0, 0.0) {
        values.iter_mut().for_each(|v| *v = (f64::from(*v) * slope + intercept) as f32);
    }
    let grid = Grid::new(layout.shape, layout.voxel_to_world).map_err(|error| error.to_string())?;
    let mut warnings = layout.warnings.clone();
    if grid.spacing_mm().iter().any(|spacing_mm| !(0.02..=50.0).contains(spacing_mm)) {
        warnings.push(format!("a voxel measures {:?} mm; check the spatial unit", grid.spacing_mm().as_slice()));
    }
    let mut frames = Vec::with_capacity(layout.frame_count);
    for (frame, chunk) in values.chunks_exact(grid.voxel_count()).enumerate() {
        let volume = Volume::new(grid.clone(), chunk.to_vec()).map_err(|error| match error {
            ImageError::NonFinite { voxel, .. } => ImageError::NonFinite { frame, voxel }.to_string(),
            other => other.to_string(),
        })?;
        frames.push(volume);
    }
    let (unit_s, step_s) = time_step(header, layout.frame_count, &mut warnings);
    let start_s = f64::from(header.toffset) * unit_s;
    Ok(NiftiImage { frames, start_s: if start_s.is_finite() { start_s } else { 0.0 }, step_s, warnings })
}

/// The header's time unit in seconds and its frame step; a missing unit is guessed from the size of the step.
fn time_step(header: &NiftiHeader, frame_count: usize, warnings: &mut Vec<String>) -> (f64, Option<f64>) {
    const SHORTEST_STEP_IN_MS: f64 = 4.0;
    let step = f64::from(header.pixdim[4]);
    let given = frame_count > 1 && step.is_finite() && step > 0.0;
    let unit_s = match header.xyzt_units & 0o70 {
        8 => 1.0,
        16 => 1e-3,
        24 => 1e-6,
        _ if !given => 1.0,
        _ => {
            let unit_s = if step >= SHORTEST_STEP_IN_MS { 1e-3 } else { 1.0 };
            let name = if unit_s == 1.0 { "s" } else { "ms" };
            warnings.push(format!("the header has no time unit; its frame step of {step} was taken to be in {name}"));
            unit_s
        }
    };
    (unit_s, given.then_some(step * unit_s))
}

/// Voxel index → world mm: the sform if it is set, else the qform, else the bare spacing.
fn affine_mm(header: &NiftiHeader, warnings: &mut Vec<String>) -> Result<Matrix4<f64>, String> {
    let unit_mm = match header.xyzt_units & 0o7 {
        1 => 1000.0,
        3 => 1e-3,
        _ => 1.0,
    };
    let affine = if header.sform_code > 0 {
        let rows = [header.srow_x, header.srow_y, header.srow_z];
        Matrix4::from_fn(|r, c| if r < 3 { f64::from(rows[r][c]) } else { f64::from(u8::from(c == 3)) })
    } else if header.qform_code > 0 {
        qform(header)
    } else {
        warnings.push("the header has neither sform nor qform: the voxel axes were taken as world axes".into());
        Matrix4::new_nonuniform_scaling(&pixel_spacing(header))
    };
    let affine_mm = Matrix4::new_scaling(unit_mm) * affine;
    let is_regular = affine_mm.iter().all(|x| x.is_finite()) && affine_mm.fixed_view::<3, 3>(0, 0).determinant().abs() > 1e-12;
    if is_regular { Ok(affine_mm) } else { Err(ImageError::SingularAffine.to_string()) }
}

fn pixel_spacing(header: &NiftiHeader) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| f64::from(header.pixdim[axis + 1]))
}

/// R(b, c, d) · diag(pixdim₁, pixdim₂, qfac · pixdim₃) and the offset, as the NIfTI-1 standard has it ("method 2").
fn qform(header: &NiftiHeader) -> Matrix4<f64> {
    let [b, c, d] = [header.quatern_b, header.quatern_c, header.quatern_d].map(f64::from);
    let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
    let rotation: Matrix3<f64> = UnitQuaternion::from_quaternion(Quaternion::new(a, b, c, d)).to_rotation_matrix().into_inner();
    let qfac = if header.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
    let spacing = pixel_spacing(header).component_mul(&Vector3::new(1.0, 1.0, qfac));
    let mut affine = (rotation * Matrix3::from_diagonal(&spacing)).to_homogeneous();
    for (row, offset) in [header.quatern_x, header.quatern_y, header.quatern_z].into_iter().enumerate() {
        affine[(row, 3)] = f64::from(offset);
    }
    affine
}

#[cfg(test)]
mod tests;
