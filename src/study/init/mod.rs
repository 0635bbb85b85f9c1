//! A commented study file for the images, labels, masks or mesh that somebody has: what they hold is looked up, what cannot be known is said.

mod files;
mod labels;
mod text;

use std::path::{Path, PathBuf};

use files::Findings;

use super::{Config, Overrides, Plan, StudyError};
use crate::image::ImageError;
use crate::mesh::MeshError;
use crate::report::{ReportError, write_atomically};

/// What a study file is to be written for.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DraftInputs {
    /// A cine (4D NIfTI or a DICOM folder), label maps, trigger times (`.json`), a volume curve (`.csv`), in any order; or a mesh.
    pub files: Vec<PathBuf>,
    /// Masks in place of a label map.
    pub masks: Option<MaskFiles>,
    /// The frame that labels or masks were drawn on, from 0; looked for where absent.
    pub frame: Option<usize>,
}

/// A heart as binary masks, NIfTI.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MaskFiles {
    /// What the epicardium encloses.
    pub epicardium: PathBuf,
    /// Left blood.
    pub endocardium_lv: PathBuf,
    /// Right blood.
    pub endocardium_rv: Option<PathBuf>,
}

/// A study file that is not yet written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Draft {
    /// The file.
    pub text: String,
    /// What each input was taken for, and what is left to its reader, a line each.
    pub notes: Vec<String>,
}

/// Why no study file was written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum InitError {
    /// It would replace what is there.
    #[error("{} is there already; name another file with -o FILE, or add --force to write over it", file.display())]
    Exists { file: PathBuf },
    /// Nothing was given.
    #[error(
        "no file was given; name a cine and the labels that were drawn on it (cardiotwin init cine.nii.gz labels.nii.gz), labels or a mesh alone"
    )]
    Nothing,
    /// Images without a heart.
    #[error(
        "{} shows a beat, but nobody has drawn the heart; add a label map of one frame (LV blood and wall, and RV blood where it is wanted), \
         drawn for example with 3D Slicer or ITK-SNAP, or masks with --epicardium and --endocardium-lv",
        cine.display()
    )]
    NoHeart { cine: PathBuf },
    /// Two files of a kind of which one is wanted.
    #[error("both {} and {} are {what}; give one of them", one.display(), other.display())]
    Two { what: &'static str, one: PathBuf, other: PathBuf },
    /// A file that is no part of a study.
    #[error("{} is of no use here: {reason}", file.display())]
    Useless { file: PathBuf, reason: String },
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A mesh cannot be read.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The study file that came out makes no plan.
    #[error(transparent)]
    Study(#[from] StudyError),
    /// The study file cannot be written.
    #[error(transparent)]
    Report(#[from] ReportError),
}

/// The study file for these inputs, to be written as `study_file`; it makes a plan.
///
/// # Errors
/// [`InitError`] names the file that cannot be used, and the remedy.
pub fn draft_study(inputs: &DraftInputs, study_file: &Path) -> Result<Draft, InitError> {
    let findings = Findings::new(inputs)?;
    let draft = text::draft(&findings, study_file);
    Plan::new(&Config::from_text(study_file, draft.text.clone(), Overrides::default())?)?;
    Ok(draft)
}

/// Writes a drafted study file, over one that is there.
///
/// # Errors
/// [`InitError::Report`] with the system's reason.
pub fn write_study(study_file: &Path, draft: &Draft) -> Result<(), InitError> {
    Ok(write_atomically(study_file, |out| out.write_all(draft.text.as_bytes()))?)
}
