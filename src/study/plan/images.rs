//! `[images]`: the cine sequence of a patient and how it is prepared, \[Billet2009\] §3.

use std::ops::Range;
use std::path::PathBuf;

use super::PhantomPlan;
use crate::study::reader::TableReader;

/// Where the images come from.
#[derive(Debug, Clone, PartialEq)]
pub enum ImageSource {
    /// Read from a file.
    Cine(ImagesPlan),
    /// Made from a heart whose truth is known.
    Phantom(PhantomPlan),
}

/// A cine sequence and how it is prepared. The heart period is the parameter `heart_period_s`, where written.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagesPlan {
    /// `cine`: 4D NIfTI, or a folder of DICOM slices.
    pub cine: PathBuf,
    /// `timing`: trigger times and heart periods beside the image, JSON; see [`crate::image::CineTiming::from_sidecar`].
    pub timing: Option<PathBuf>,
    /// `first_frame_s`: time of the first frame after the trigger (R wave); that of `timing`, or the header's, where absent.
    pub first_frame_s: Option<f64>,
    /// `long_axis`: further views, taken in another breath-hold: 4D NIfTI, or a folder of DICOM slices. They are shown, not tracked.
    pub long_axis: Option<PathBuf>,
    /// `long_axis_timing`: as `timing`, of the long-axis views.
    pub long_axis_timing: Option<PathBuf>,
    /// `correct_slice_shifts`: whether slices that lie beside their neighbours are moved back, with all labels drawn on them.
    pub correct_slice_shifts: bool,
    /// Where `cardiotwin volumes`, and a personalisation to measured volumes, have the volume curve from.
    pub volumes: VolumeSource,
    /// `match_stroke_volumes`: whether the smooth curves of both ventricles eject the same.
    pub match_stroke_volumes: bool,
    /// `quantile_low`: intensities below this quantile of all frames become 0.
    pub quantile_low: f64,
    /// `quantile_high`: intensities above this quantile of all frames become 255.
    pub quantile_high: f64,
    /// `isotropic_spacing_mm`: voxel edge after resampling; the in-plane voxel edge where absent.
    pub isotropic_spacing_mm: Option<f64>,
    /// `[[images.validation]]`: labels that results are compared with and that nothing is fitted to.
    pub validation: Vec<ReferenceLabels>,
}

/// Where the volume curve comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum VolumeSource {
    /// From the cine, followed from the labels of the anatomy.
    Images,
    /// `volumes`: a label map of every frame.
    Labels {
        /// 4D NIfTI.
        path: PathBuf,
        /// `volumes_code_cavity_lv`.
        code: u8,
        /// `volumes_code_cavity_rv`; the right ventricle's curve is not known where absent.
        code_right: Option<u8>,
        /// `volumes_slices`: the slices that count, all where absent.
        slices: Option<Range<usize>>,
    },
    /// `volumes`: a CSV file.
    Table(PathBuf),
}

/// Labels drawn by an expert on one frame, or on every frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceLabels {
    /// `labels`: the label map, NIfTI.
    pub path: PathBuf,
    /// `frame`: the frame it was drawn on, from 0; every frame of a 4-D label map where absent.
    pub frame: Option<usize>,
    /// `code_cavity_lv`: blood of the left ventricle.
    pub code_cavity_lv: u16,
    /// `slices`: the slices that count, all where absent.
    pub slices: Option<Range<usize>>,
}

pub(super) fn read(table: TableReader) -> Option<ImagesPlan> {
    let validation = table.tables("validation").into_iter().map(read_labels).collect();
    let plan = table.is_written().then(|| ImagesPlan {
        cine: table.required_data_path("cine"),
        timing: table.data_file("timing"),
        long_axis: table.data_path("long_axis"),
        long_axis_timing: table.data_file("long_axis_timing"),
        correct_slice_shifts: table.flag("correct_slice_shifts", false),
        volumes: read_volumes(&table),
        match_stroke_volumes: table.flag("match_stroke_volumes", false),
        first_frame_s: table.optional_number("first_frame_s", -2.5..=2.5),
        quantile_low: table.number("quantile_low", 0.0..=0.5, 0.01),
        quantile_high: table.number("quantile_high", 0.5..=1.0, 0.99),
        isotropic_spacing_mm: table.optional_number("isotropic_spacing_mm", 0.2..=10.0),
        validation,
    });
    if plan.as_ref().is_some_and(|plan| plan.quantile_low >= plan.quantile_high) {
        table.problem("quantile_low", "is not below quantile_high", "choose quantile_low < quantile_high");
    }
    table.close();
    plan
}

fn read_volumes(table: &TableReader) -> VolumeSource {
    let path = table.data_file("volumes");
    let code = u8::try_from(table.count("volumes_code_cavity_lv", 1..=i64::from(u8::MAX), 1)).unwrap_or(u8::MAX);
    let code_right = table.optional_count("volumes_code_cavity_rv", 1..=i64::from(u8::MAX)).and_then(|code| u8::try_from(code).ok());
    let slices = slice_range(table, "volumes_slices");
    match path {
        Some(path) if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv")) => VolumeSource::Table(path),
        Some(path) => VolumeSource::Labels { path, code, code_right, slices },
        None => VolumeSource::Images,
    }
}

/// The slices from the first to the last of a list of two.
pub(super) fn slice_range(table: &TableReader, key: &'static str) -> Option<Range<usize>> {
    let ends = table.numbers(key)?;
    let range = match ends.as_slice() {
        &[first, last] if 0.0 <= first && first <= last && ends.iter().all(|end| end.fract() == 0.0) => {
            Some(first as usize..last as usize + 1)
        }
        _ => None,
    };
    if range.is_none() {
        table.problem(key, "is no range of slices", "write the first and the last slice that count, counted from 0: [2, 10]");
    }
    range
}

fn read_labels(table: TableReader) -> ReferenceLabels {
    let frame = table.count("frame", 0..=100_000, 0);
    let labels = ReferenceLabels {
        path: table.required_data_file("labels"),
        frame: table.has("frame").then_some(frame),
        code_cavity_lv: u16::try_from(table.count("code_cavity_lv", 1..=i64::from(u8::MAX), 1)).unwrap_or(u16::MAX),
        slices: slice_range(&table, "slices"),
    };
    table.close();
    labels
}
