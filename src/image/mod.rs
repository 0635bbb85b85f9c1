//! Images in world millimetres: volumes, cine sequences, label maps; knows no mesh.

mod alignment;
mod cine;
mod contour;
mod dicom;
mod error;
mod frame_order;
mod grid;
mod mask;
mod nifti;
mod phases;
mod preprocess;
mod sampling;
mod smoothing;
mod source;
mod summary;
mod timing;
mod volume;
mod volume_curve;

pub use alignment::{SliceShifts, correct_label_shifts, correct_slice_shifts, estimate_slice_shifts};
pub use cine::CineSequence;
pub use contour::{CavityContours, CavitySlice, follow_cavity};
pub use dicom::{DicomFolder, DicomStack, read_dicom_folder};
pub use error::ImageError;
pub use grid::Grid;
pub use mask::{
    ApexEnd, BaseCut, FieldOptions, FieldReport, HeartCodes, HeartFields, MASK_CODES, Plane, enclosed_volume_ml, heart_fields,
    labels_of_masks,
};
pub use nifti::{
    CineReading, NiftiImage, read_cine, read_label_map, read_label_maps, read_nifti, write_cine, write_label_map, write_label_maps,
};
pub use preprocess::{PREPARED_MAX, PreprocessSettings, preprocess, resampled_isotropic};
pub use smoothing::gaussian_smoothed;
pub use source::{read_cine_source, read_views, summarise};
pub use summary::{ImageSummary, LabelSummary, cine_warnings};
pub use timing::CineTiming;
pub use volume::{LabelMap, Volume};
pub use volume_curve::{CurvePoint, MidDiastole, VolumeCurve};
