//! One DICOM file as one slice at one instant, in RAS millimetres.

use std::path::{Path, PathBuf};

use dicom_encoding::Codec;
use dicom_encoding::transfer_syntax::TransferSyntaxIndex;
use dicom_object::{DefaultDicomObject, OpenFileOptions, Tag};
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;
use nalgebra::Vector3;

use super::lengths::{check_lengths, says_to_be_dicom};
use super::{jpeg_2000, run_length};

const SERIES_UID: Tag = Tag(0x0020, 0x000E);
const SERIES_DESCRIPTION: Tag = Tag(0x0008, 0x103E);
const INSTANCE_NUMBER: Tag = Tag(0x0020, 0x0013);
const POSITION: Tag = Tag(0x0020, 0x0032);
const ORIENTATION: Tag = Tag(0x0020, 0x0037);
const PIXEL_SPACING: Tag = Tag(0x0028, 0x0030);
const SLICE_THICKNESS: Tag = Tag(0x0018, 0x0050);
const TRIGGER_TIME: Tag = Tag(0x0018, 0x1060);
const NOMINAL_INTERVAL: Tag = Tag(0x0018, 0x1062);
const SAMPLES_PER_PIXEL: Tag = Tag(0x0028, 0x0002);
const NUMBER_OF_FRAMES: Tag = Tag(0x0028, 0x0008);
const ROWS: Tag = Tag(0x0028, 0x0010);
const COLUMNS: Tag = Tag(0x0028, 0x0011);
const BITS_ALLOCATED: Tag = Tag(0x0028, 0x0100);
const BITS_STORED: Tag = Tag(0x0028, 0x0101);
const PIXEL_REPRESENTATION: Tag = Tag(0x0028, 0x0103);
const RESCALE_INTERCEPT: Tag = Tag(0x0028, 0x1052);
const RESCALE_SLOPE: Tag = Tag(0x0028, 0x1053);
const PIXEL_DATA: Tag = Tag(0x7FE0, 0x0010);

/// One slice at one instant.
#[derive(Debug, Clone)]
pub(super) struct Instance {
    pub(super) path: PathBuf,
    pub(super) series: String,
    pub(super) description: String,
    pub(super) number: i64,
    /// Centre of the first pixel, RAS mm.
    pub(super) position_mm: Vector3<f64>,
    /// Unit vectors along rising column and rising row index, RAS.
    pub(super) axes: [Vector3<f64>; 2],
    /// Distance between columns and between rows, mm.
    pub(super) spacing_mm: [f64; 2],
    pub(super) thickness_mm: Option<f64>,
    /// Time after the R wave, ms.
    pub(super) trigger_ms: Option<f64>,
    /// Heart period of the beats it was made of, ms.
    pub(super) period_ms: Option<f64>,
    /// Columns and rows.
    pub(super) shape: [usize; 2],
    /// Intensities, column index fastest.
    pub(super) values: Vec<f32>,
}

/// Why a file gives no slice.
pub(super) enum Skipped {
    /// It is no DICOM file.
    NotDicom,
    /// It is one, but has no usable slice.
    Unusable(String),
}

impl Instance {
    /// Reads a file.
    pub(super) fn read(path: &Path) -> Result<Self, Skipped> {
        let bytes = std::fs::read(path).map_err(|_| Skipped::NotDicom)?;
        if !says_to_be_dicom(&bytes) {
            return Err(Skipped::NotDicom);
        }
        check_lengths(&bytes).map_err(Skipped::Unusable)?;
        drop(bytes);
        let object = OpenFileOptions::new().open_file(path).map_err(|_| Skipped::NotDicom)?;
        Self::from_object(path, &object).map_err(Skipped::Unusable)
    }

    fn from_object(path: &Path, object: &DefaultDicomObject) -> Result<Self, String> {
        let frames = number(object, NUMBER_OF_FRAMES).unwrap_or(1.0);
        if frames != 1.0 || number(object, SAMPLES_PER_PIXEL).unwrap_or(1.0) != 1.0 {
            return Err("it holds several frames or colours; one grey slice a file is read".into());
        }
        let position = numbers::<3>(object, POSITION, "image position")?;
        let orientation = numbers::<6>(object, ORIENTATION, "image orientation")?;
        let [row_mm, column_mm] = numbers::<2>(object, PIXEL_SPACING, "pixel spacing")?;
        let axes = [to_ras(&orientation[..3]), to_ras(&orientation[3..])];
        if axes.iter().any(|axis| (axis.norm() - 1.0).abs() > 0.01) || axes[0].dot(&axes[1]).abs() > 0.01 {
            return Err(format!("its image orientation {orientation:?} is no pair of perpendicular unit vectors"));
        }
        if !(row_mm > 0.0 && column_mm > 0.0) {
            return Err(format!("its pixel spacing is {row_mm} × {column_mm} mm"));
        }
        let size = |tag, name| number(object, tag).filter(|n| (1.0..=8192.0).contains(n)).map(|n| n as usize).ok_or_else(|| missing(name));
        let shape = [size(COLUMNS, "number of columns")?, size(ROWS, "number of rows")?];
        Ok(Self {
            path: path.into(),
            series: text(object, SERIES_UID),
            description: text(object, SERIES_DESCRIPTION),
            number: number(object, INSTANCE_NUMBER).unwrap_or(0.0) as i64,
            position_mm: to_ras(&position),
            axes: axes.map(|axis| axis.normalize()),
            spacing_mm: [column_mm, row_mm],
            thickness_mm: number(object, SLICE_THICKNESS).filter(|mm| *mm > 0.0),
            trigger_ms: number(object, TRIGGER_TIME).filter(|ms| *ms >= 0.0),
            period_ms: number(object, NOMINAL_INTERVAL).filter(|ms| *ms > 0.0),
            shape,
            values: pixels(object, shape)?,
        })
    }

    /// Unit normal of the slice, RAS.
    pub(super) fn normal(&self) -> Vector3<f64> {
        self.axes[0].cross(&self.axes[1])
    }
}

fn missing(name: &str) -> String {
    format!("its {name} is missing or not usable")
}

/// DICOM's patient axes point left and back; RAS points right and front.
fn to_ras(lps: &[f64]) -> Vector3<f64> {
    Vector3::new(-lps[0], -lps[1], lps[2])
}

fn number(object: &DefaultDicomObject, tag: Tag) -> Option<f64> {
    object.get(tag)?.to_float64().ok().filter(|value| value.is_finite())
}

fn numbers<const N: usize>(object: &DefaultDicomObject, tag: Tag, name: &str) -> Result<[f64; N], String> {
    let values = object.get(tag).and_then(|element| element.to_multi_float64().ok()).unwrap_or_default();
    let values = <[f64; N]>::try_from(values).map_err(|_| missing(name))?;
    if values.iter().all(|value| value.is_finite()) { Ok(values) } else { Err(missing(name)) }
}

fn text(object: &DefaultDicomObject, tag: Tag) -> String {
    object.get(tag).and_then(|element| element.to_str().ok()).map(|text| text.trim_matches(['\0', ' ']).to_string()).unwrap_or_default()
}

/// The slice's intensities: stored integers times slope plus intercept.
fn pixels(object: &DefaultDicomObject, shape: [usize; 2]) -> Result<Vec<f32>, String> {
    let allocated = number(object, BITS_ALLOCATED).unwrap_or(0.0) as usize;
    let stored = number(object, BITS_STORED).unwrap_or(allocated as f64) as usize;
    if !matches!(allocated, 8 | 16 | 32) || stored == 0 || stored > allocated {
        return Err(format!("its pixels have {stored} of {allocated} bits"));
    }
    let width = allocated / 8;
    let bytes = pixel_bytes(object, shape, width)?;
    let expected = shape[0] * shape[1] * width;
    if bytes.len() < expected {
        return Err(format!("it has {} bytes of pixels where {expected} are needed", bytes.len()));
    }
    let is_signed = number(object, PIXEL_REPRESENTATION) == Some(1.0);
    let (slope, intercept) = (number(object, RESCALE_SLOPE).unwrap_or(1.0), number(object, RESCALE_INTERCEPT).unwrap_or(0.0));
    let value = |pixel: &[u8]| {
        let raw = pixel.iter().rev().fold(0_u64, |raw, &byte| raw << 8 | u64::from(byte));
        // Bits above the stored ones may hold overlays.
        let shift = 64 - stored;
        let integer = if is_signed { ((raw << shift) as i64 >> shift) as f64 } else { (raw << shift >> shift) as f64 };
        (integer * slope + intercept) as f32
    };
    Ok(bytes[..expected].chunks_exact(width).map(value).collect())
}

const RUN_LENGTH: &str = "1.2.840.10008.1.2.5";

/// Lossless, and either.
const JPEG_2000: [&str; 2] = ["1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91"];

/// The pixel data, decompressed, little endian.
fn pixel_bytes(object: &DefaultDicomObject, shape: [usize; 2], width: usize) -> Result<Vec<u8>, String> {
    let uid = object.meta().transfer_syntax();
    let frame = || object.get(PIXEL_DATA).and_then(|element| element.fragments()).map(<[_]>::concat).ok_or("it has no compressed pixels");
    if uid == RUN_LENGTH {
        return run_length::decode(&frame()?, shape[0] * shape[1], width);
    }
    if JPEG_2000.contains(&uid) {
        jpeg_2000::check_size(&frame()?, shape)?;
    }
    let syntax = TransferSyntaxRegistry.get(uid).ok_or_else(|| format!("its transfer syntax {uid} is unknown"))?;
    if let Codec::EncapsulatedPixelData(reader, _) = syntax.codec() {
        let reader = reader
            .as_ref()
            .ok_or_else(|| format!("its compression ({}) cannot be read; convert it to an uncompressed file", syntax.name()))?;
        let mut bytes = Vec::new();
        reader.decode_frame(object, 0, &mut bytes).map_err(|error| format!("its pixels cannot be decompressed: {error}"))?;
        return Ok(bytes);
    }
    let element = object.get(PIXEL_DATA).ok_or("it has no pixels")?;
    let value = element.value().primitive().ok_or("its pixels are compressed where its transfer syntax says they are not")?;
    Ok(match value {
        dicom_core::PrimitiveValue::U16(words) => words.iter().flat_map(|word| word.to_le_bytes()).collect(),
        dicom_core::PrimitiveValue::U32(words) => words.iter().flat_map(|word| word.to_le_bytes()).collect(),
        other => other.to_bytes().into_owned(),
    })
}
