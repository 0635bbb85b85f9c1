//! Real cine MRI from the folder `../shared/data`: what readers and volume curves make of it. Where the data are absent, each test says so and passes.

#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    clippy::print_stdout,
    reason = "a test may stop at the first surprise, and says aloud what it could not look at"
)]

mod common;

use std::path::Path;

use cardiotwin::image::{
    CineReading, CineSequence, CineTiming, VolumeCurve, cine_warnings, follow_cavity, read_cine, read_dicom_folder, read_label_map,
    read_label_maps,
};
use common::real_data;
use nalgebra::Vector3;

/// The files of the scanner and the NIfTI that was made and cropped from them by another program tell the same.
#[test]
fn dicom_and_nifti_of_one_patient_are_the_same_image_in_the_world() {
    let Some(folder) = real_data("sunnybrook_SCD0000201") else { return };
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

fn cine(folder: &Path) -> CineReading {
    let timing = CineTiming::from_sidecar(&folder.join("meta.json")).unwrap();
    read_cine(&folder.join("cine_sax_crop.nii.gz"), &timing).unwrap()
}

/// No frame of either heart is said to be out of order, and frames that were exchanged are named, near ones and far ones.
#[test]
fn exchanged_frames_are_named_and_none_of_a_heart_in_order() {
    for name in ["sunnybrook_SCD0000201", "sri_E774"] {
        let Some(folder) = real_data(name) else { return };
        let cine = cine(&folder).cine;
        let out_of_order = |cine: &CineSequence| cine_warnings(cine).into_iter().filter(|w| w.contains("out of order")).collect::<Vec<_>>();
        assert_eq!(out_of_order(&cine), Vec::<String>::new());
        for (one, other) in [(5, 7), (3, 4), (0, 19), (2, 13), (12, 17)] {
            let mut frames = cine.frames().to_vec();
            frames.swap(one, other);
            let exchanged = CineSequence::new(frames, cine.times_s().to_vec(), cine.period_s()).unwrap();
            let warnings = out_of_order(&exchanged);
            assert!(warnings.iter().any(|w| w.starts_with(&format!("frames {one} and {other} "))), "{name}: {warnings:?}");
        }
    }
}

/// The expert drew end-diastole, from which the images are followed, and independently end-systole.
#[test]
fn volumes_from_the_images_of_a_failing_heart_agree_with_the_expert_at_end_systole() {
    let Some(folder) = real_data("sunnybrook_SCD0000201") else { return };
    let cine = cine(&folder).cine;
    let drawn = |name: &str| read_label_map(&folder.join(name)).unwrap();
    let drawn_ml = |name: &str| drawn(name).count(1) as f64 * drawn(name).grid().voxel_volume_mm3() / 1000.0;
    let contours = follow_cavity(&cine, &drawn("labels_ED_crop.nii.gz"), 1, 19).unwrap();
    let measured_ml = contours.volumes_ml();
    let curve = VolumeCurve::new(cine.times_s().to_vec(), measured_ml.clone(), cine.period_s()).unwrap().smoothed(0.5).unwrap();
    let expert_ml = [drawn_ml("labels_ED_crop.nii.gz"), drawn_ml("labels_ES_crop.nii.gz")];
    println!("measured {measured_ml:.1?}\nsmooth {:.1?}\nexpert {expert_ml:.1?}, EF {:.3}", curve.volumes_ml(), curve.ejection_fraction());
    assert!((measured_ml[19] - expert_ml[0]).abs() < 2.0);
    // Two experts differ by 5 to 10 mL on such a heart.
    assert!((measured_ml[6] - expert_ml[1]).abs() < 5.0);
    assert!(curve.end_systole().frame.abs_diff(6) <= 1);
    assert!((curve.ejection_fraction() - (1.0 - expert_ml[1] / expert_ml[0])).abs() < 0.03);
}

/// Another program's contours of every frame; one of them starts the following.
#[test]
fn volumes_from_the_images_of_an_animal_agree_with_contours_of_every_frame() {
    let Some(folder) = real_data("sri_E774") else { return };
    let cine = cine(&folder).cine;
    let maps = read_label_maps(&folder.join("labels_lv_auto_all_frames_crop.nii.gz")).unwrap();
    // Above slice 13 the contours follow the aorta and the atria.
    let trusted = 0..14;
    let drawn = VolumeCurve::from_label_maps(&maps, 1, trusted.clone(), cine.times_s().to_vec(), cine.period_s()).unwrap();
    let contours = follow_cavity(&cine, &maps[1].slices(trusted), 1, 1).unwrap();
    let measured_ml = contours.volumes_ml();
    println!("measured {measured_ml:.1?}\ndrawn {:.1?}", drawn.volumes_ml());
    let squares: f64 = measured_ml.iter().zip(drawn.volumes_ml()).map(|(a, b)| (a - b).powi(2)).sum();
    assert!((squares / 20.0).sqrt() < 2.5, "{} mL RMS", (squares / 20.0).sqrt());
    let followed = VolumeCurve::new(cine.times_s().to_vec(), measured_ml, cine.period_s()).unwrap();
    assert!((followed.ejection_fraction() - drawn.ejection_fraction()).abs() < 0.03);
    assert!(followed.end_systole().frame.abs_diff(drawn.end_systole().frame) <= 1);
}
