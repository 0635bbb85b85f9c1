//! Real cine MRI from the folder `../shared/data`: what readers and volume curves make of it. Where the data are absent, each test says so and passes.

#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test may stop at the first surprise, and says aloud what it could not look at"
)]

use std::path::{Path, PathBuf};

use cardiotwin::image::{CineTiming, read_cine, read_dicom_folder};
use nalgebra::Vector3;

/// A data set, or none where this machine has no copy of it.
fn data(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !folder.is_dir() {
        eprintln!("SKIPPED: {} is not at hand", folder.display());
        return None;
    }
    Some(folder)
}

/// The files of the scanner and the NIfTI that was made and cropped from them by another program tell the same.
#[test]
fn dicom_and_nifti_of_one_patient_are_the_same_image_in_the_world() {
    let Some(folder) = data("sunnybrook_SCD0000201") else { return };
    let timing = CineTiming::from_sidecar(&folder.join("meta.json")).unwrap();
    let nifti = read_cine(&folder.join("cine_sax_crop.nii.gz"), &timing).unwrap().cine;
    let read = read_dicom_folder(&folder.join("dicom"), &CineTiming::default()).unwrap();
    assert_eq!(read.warnings, Vec::<String>::new());
    assert_eq!(read.stacks.len(), 1);
    let dicom = &read.stacks[0].reading.cine;
    assert_eq!((dicom.grid().shape(), dicom.frames().len()), ([256, 256, 13], 20));

    let in_dicom = |voxel: [usize; 3]| dicom.grid().to_voxel(&nifti.grid().to_world_mm(&Vector3::from(voxel.map(|n| n as f64))));
    for flat in 0..nifti.grid().voxel_count() {
        let at = in_dicom(nifti.grid().voxel_of(flat));
        let nearest = at.map(f64::round);
        // The affine of the file is in single precision, and its slices are 0.6 µm off a regular stack.
        assert!((at - nearest).norm() < 2e-3, "{at}");
        let voxel = [nearest.x as usize, nearest.y as usize, nearest.z as usize];
        for (from_dicom, from_nifti) in dicom.frames().iter().zip(nifti.frames()) {
            assert_eq!(from_dicom.at(voxel), from_nifti.values()[flat]);
        }
    }
    assert!((dicom.period_s() - nifti.period_s()).abs() < 2e-3, "{} and {} s", dicom.period_s(), nifti.period_s());
    for (from_dicom, from_nifti) in dicom.times_s().iter().zip(nifti.times_s()) {
        assert!((from_dicom - from_nifti).abs() < 2e-3, "{from_dicom} and {from_nifti} s");
    }
}
