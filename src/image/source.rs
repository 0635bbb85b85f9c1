//! Images wherever they are: a NIfTI file, or a folder of DICOM slices.

use std::path::Path;

use super::{CineReading, CineTiming, ImageError, ImageSummary, read_cine, read_dicom_folder, read_nifti};

/// Reads the cine of a NIfTI file, or the stack of most slices of a DICOM folder.
///
/// # Errors
/// As [`read_cine`] and [`read_dicom_folder`].
pub fn read_cine_source(path: &Path, timing: &CineTiming) -> Result<CineReading, ImageError> {
    let mut views = read_views(path, timing)?.into_iter();
    let Some(mut largest) = views.next() else {
        return Err(ImageError::Unusable { path: path.into(), reason: "it holds no cine".into() });
    };
    let others: Vec<String> = views.map(|view| view.cine.grid().shape()[2].to_string()).collect();
    if !others.is_empty() {
        largest.warnings.push(format!("further stacks of {} slices in the folder were left out", others.join(", ")));
    }
    Ok(largest)
}

/// Reads the cine of a NIfTI file, or all stacks and views of a DICOM folder, most slices first.
///
/// # Errors
/// As [`read_cine`] and [`read_dicom_folder`].
pub fn read_views(path: &Path, timing: &CineTiming) -> Result<Vec<CineReading>, ImageError> {
    if !path.is_dir() {
        return Ok(vec![read_cine(path, timing)?]);
    }
    let folder = read_dicom_folder(path, timing)?;
    let mut views: Vec<CineReading> = folder.stacks.into_iter().map(|stack| stack.reading).collect();
    if let Some(first) = views.first_mut() {
        first.warnings.splice(0..0, folder.warnings);
    }
    Ok(views)
}

/// What a NIfTI file or each stack of a DICOM folder shows; a file whose times make no beat is summarised without them.
///
/// # Errors
/// As [`read_nifti`] and [`read_dicom_folder`].
pub fn summarise(path: &Path, timing: &CineTiming) -> Result<Vec<ImageSummary>, ImageError> {
    if path.is_dir() {
        let folder = read_dicom_folder(path, timing)?;
        let summary = |stack: &super::DicomStack| ImageSummary::of_cine(&stack.description, &stack.reading.cine, &stack.reading.warnings);
        let mut summaries: Vec<ImageSummary> = folder.stacks.iter().map(summary).collect();
        if let Some(first) = summaries.first_mut() {
            first.warnings.splice(0..0, folder.warnings);
        }
        return Ok(summaries);
    }
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let image = read_nifti(path)?;
    if image.frames.len() < 2 {
        return Ok(vec![ImageSummary::of_frames(&name, &image.frames, &image.warnings)]);
    }
    match read_cine(path, timing) {
        Ok(reading) => Ok(vec![ImageSummary::of_cine(&name, &reading.cine, &reading.warnings)]),
        Err(error) => {
            let mut summary = ImageSummary::of_frames(&name, &image.frames, &image.warnings);
            summary.warnings.push(format!("its times make no heart beat: {error}"));
            Ok(vec![summary])
        }
    }
}
