//! A folder of DICOM cine slices as scanners write it: short-axis stacks and long-axis views in RAS millimetres.
//!
//! Files are sorted by orientation into stacks, within a stack by position into slices, and within a slice by trigger time into frames;
//! names and order of the files do not matter, nor whether every slice is a series of its own. Uncompressed, RLE, JPEG and JPEG 2000 files are read.

mod instance;
mod jpeg_2000;
mod lengths;
mod run_length;
mod stack;

use std::path::{Path, PathBuf};

use super::{CineReading, CineTiming, ImageError};
use instance::{Instance, Skipped};

/// Folders are searched this deep.
const DEPTH_MAX: usize = 4;

/// At most this many unusable files are named.
const NAMED_MAX: usize = 5;

/// One stack of parallel cine slices; a single slice is a view.
#[derive(Debug, Clone)]
pub struct DicomStack {
    /// The scanner's description of the (first) series.
    pub description: String,
    /// Its frames and times.
    pub reading: CineReading,
}

impl DicomStack {
    /// Number of parallel slices.
    pub fn slice_count(&self) -> usize {
        self.reading.cine.grid().shape()[2]
    }
}

/// What a folder holds.
#[derive(Debug, Clone)]
pub struct DicomFolder {
    /// Stacks, most slices first.
    pub stacks: Vec<DicomStack>,
    /// What was left out, in words.
    pub warnings: Vec<String>,
}

/// Reads all cine stacks of a folder and its sub-folders; `timing` overrides the files' heart period and frame times.
///
/// # Errors
/// [`ImageError::Unreadable`] if the folder cannot be listed, [`ImageError::Unusable`] if it holds no cine stack.
pub fn read_dicom_folder(path: &Path, timing: &CineTiming) -> Result<DicomFolder, ImageError> {
    let mut files = Vec::new();
    list_files(path, DEPTH_MAX, &mut files).map_err(|error| ImageError::Unreadable { path: path.into(), reason: error.to_string() })?;
    files.sort();
    let mut warnings = Vec::new();
    let stacks = parallel_stacks(read_instances(&files, &mut warnings));
    let mut found = Vec::new();
    for instances in &stacks {
        let description = instances[0].description.clone();
        match stack::assemble(instances, timing) {
            Ok(stack::Assembled { cine, warnings }) => found.push(DicomStack { description, reading: CineReading { cine, warnings } }),
            Err(reason) => {
                let (count, example) = (instances.len(), instances[0].path.display());
                warnings.push(format!("{count} parallel images \"{description}\" ({example} …) make no cine stack: {reason}"));
            }
        }
    }
    if found.is_empty() {
        let reason = if warnings.is_empty() {
            "it holds no DICOM file".to_string()
        } else {
            format!("no cine stack in it; {}", warnings.join("; "))
        };
        return Err(ImageError::Unusable { path: path.into(), reason });
    }
    found.sort_by_key(|stack| std::cmp::Reverse(stack.slice_count()));
    Ok(DicomFolder { stacks: found, warnings })
}

fn list_files(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            if depth > 0 {
                list_files(&path, depth - 1, files)?;
            }
        } else {
            files.push(path);
        }
    }
    Ok(())
}

fn read_instances(files: &[PathBuf], warnings: &mut Vec<String>) -> Vec<Instance> {
    let mut instances = Vec::new();
    let mut unusable = Vec::new();
    for file in files {
        match Instance::read(file) {
            Ok(instance) => instances.push(instance),
            Err(Skipped::Unusable(reason)) => unusable.push(format!("{}: {reason}", file.display())),
            Err(Skipped::NotDicom) if file.extension().is_some_and(|name| name.eq_ignore_ascii_case("dcm")) => {
                unusable.push(format!("{}: it is no DICOM file or is damaged", file.display()));
            }
            Err(Skipped::NotDicom) => {}
        }
    }
    if unusable.len() > NAMED_MAX {
        let others = unusable.len() - NAMED_MAX;
        unusable.truncate(NAMED_MAX);
        unusable.push(format!("and {others} more unusable DICOM files"));
    }
    warnings.extend(unusable);
    instances
}

fn parallel_stacks(instances: Vec<Instance>) -> Vec<Vec<Instance>> {
    let mut stacks: Vec<Vec<Instance>> = Vec::new();
    for instance in instances {
        match stacks.iter_mut().find(|stack| stack::are_parallel(&stack[0], &instance)) {
            Some(stack) => stack.push(instance),
            None => stacks.push(vec![instance]),
        }
    }
    stacks
}

#[cfg(test)]
mod tests;
