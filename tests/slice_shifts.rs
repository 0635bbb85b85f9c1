//! Shifts that were put on slices on purpose, 8 mm slices of a phantom and 10 mm slices of a patient, come back within a voxel.
//!
//! A linear drift along the stack is invisible to any estimate, so that shifts of many slices are compared by what is left of it: the
//! difference of each slice from the mean of its neighbours.

#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test may stop at the first surprise, and says aloud what it could not look at"
)]

mod common;

use cardiotwin::anatomy::AnatomySettings;
use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::image::{
    CineSequence, CineTiming, LabelMap, SliceShifts, correct_slice_shifts, estimate_slice_shifts, read_cine, read_label_map,
};
use cardiotwin::phantom::{
    IdealisedLv, PrescribedContraction, ShortAxisStack, SyntheticCineSettings, breath_hold_shifts_mm, synthetic_cine,
};
use nalgebra::{Vector2, Vector3};

const VOXEL_MM: f64 = 1.5;
const SLICE_MM: f64 = 8.0;

/// An oblique ventricle that beats, with noise, texture and bias, on slices displaced by `slice_shifts_mm`; and its labels at rest.
fn phantom(slice_shifts_mm: Vec<Vector2<f64>>) -> (CineSequence, LabelMap) {
    let lv = IdealisedLv { long_axis: Vector3::new(-0.5, 0.4, 0.6), ..IdealisedLv::default() };
    let anatomy = lv.build(&MesherSettings::with_edge_length_mm(7.0), &AnatomySettings::default()).unwrap();
    let grid = ShortAxisStack { voxel_mm: VOXEL_MM, slice_distance_mm: SLICE_MM, ..ShortAxisStack::default() }.grid(&anatomy).unwrap();
    let frame = |n: u32| PrescribedContraction::default().positions_mm(&lv, anatomy.mesh.vertices_mm(), f64::from(n.min(6 - n)) / 3.0);
    let (frames, times_s): (Vec<_>, Vec<_>) = (0..6).map(|n| (frame(n), 0.1 * f64::from(n))).unzip();
    let settings = SyntheticCineSettings { slice_shifts_mm, ..SyntheticCineSettings::default() };
    let mut imaged = synthetic_cine(&anatomy, &frames, &times_s, 0.8, &grid, &settings).unwrap();
    (imaged.cine, imaged.labels.swap_remove(0))
}

/// Slices that show the labels.
fn heart_slices(labels: &LabelMap) -> Vec<usize> {
    let [ni, nj, nk] = labels.grid().shape();
    (0..nk).filter(|k| labels.labels()[ni * nj * k..ni * nj * (k + 1)].iter().filter(|&&label| label != 0).count() > 100).collect()
}

/// How far slice k lies from the mean of its neighbours, where all three are known.
fn offset(shifts: &SliceShifts, slice: usize) -> Option<Vector2<f64>> {
    let at = |slice: usize| shifts.shift_mm.get(slice).copied().flatten();
    Some(at(slice)? - (at(slice - 1)? + at(slice + 1)?) * 0.5)
}

#[test]
fn displaced_slices_of_a_phantom_are_found_within_a_voxel() {
    let (still, labels) = phantom(vec![]);
    let slices = heart_slices(&labels);
    let (one, other) = (slices[3], slices[7]);
    let mut truth = vec![Vector2::zeros(); labels.grid().shape()[2]];
    (truth[one], truth[other]) = (Vector2::new(4.5, -3.0), Vector2::new(-2.6, 3.4));
    let (displaced, moved_labels) = phantom(truth.clone());
    for (heart, moved_heart) in [(Some(&labels), Some(&moved_labels)), (None, None)] {
        let before = estimate_slice_shifts(&still, heart);
        assert!(before.greatest_mm() < 0.5 * VOXEL_MM, "{before:?}");
        let found = estimate_slice_shifts(&displaced, moved_heart);
        let known: Vec<usize> = slices.iter().copied().filter(|&slice| found.shift_mm[slice].is_some()).collect();
        assert!(known.len() + 3 >= slices.len() && known.contains(&one) && known.contains(&other), "{found:?} of {slices:?}");
        for slice in known {
            let shift_mm = found.shift_mm[slice].unwrap();
            assert!((shift_mm - truth[slice]).norm() < VOXEL_MM, "slice {slice}: {shift_mm:?} for {:?}", truth[slice]);
        }
        let left = estimate_slice_shifts(&correct_slice_shifts(&displaced, &found).unwrap(), heart);
        assert!(left.greatest_mm() < VOXEL_MM, "{left:?}");
    }
}

#[test]
fn slices_that_are_all_displaced_are_found_but_for_a_drift() {
    let (_, labels) = phantom(vec![]);
    let truth = breath_hold_shifts_mm(labels.grid().shape()[2], 2.0, 5);
    let (displaced, moved_labels) = phantom(truth.clone());
    let found = estimate_slice_shifts(&displaced, Some(&moved_labels));
    let truth = SliceShifts { shift_mm: truth.into_iter().map(Some).collect() };
    let errors: Vec<f64> =
        heart_slices(&labels).into_iter().filter_map(|slice| Some((offset(&found, slice)? - offset(&truth, slice)?).norm())).collect();
    assert!(errors.len() >= 5 && errors.iter().all(|&error| error < VOXEL_MM), "{errors:?} {found:?}");
}

/// The slices of a real patient lie where the expert's centroids say, within 3 mm; moved on purpose, they are found where they were moved to.
#[test]
fn a_patients_slices_lie_right_and_known_shifts_of_them_are_found_within_a_voxel() {
    let Some(folder) = common::real_data("sunnybrook_SCD0000201") else { return };
    let timing = CineTiming::from_sidecar(&folder.join("meta.json")).unwrap();
    let cine = read_cine(&folder.join("cine_sax_crop.nii.gz"), &timing).unwrap().cine;
    let labels = read_label_map(&folder.join("labels_ED_crop.nii.gz")).unwrap();
    let slices = heart_slices(&labels);
    let truth = breath_hold_shifts_mm(cine.grid().shape()[2], 1.5, 2);
    let negative = SliceShifts { shift_mm: truth.iter().map(|shift| Some(-shift)).collect() };
    let displaced = correct_slice_shifts(&cine, &negative).unwrap();
    let truth = SliceShifts { shift_mm: truth.into_iter().map(Some).collect() };
    let (before, after) = (estimate_slice_shifts(&cine, Some(&labels)), estimate_slice_shifts(&displaced, Some(&labels)));
    assert!(before.greatest_mm() < 3.0, "{before:?}");
    let error = |&slice: &usize| Some((offset(&after, slice)? - offset(&before, slice)? - offset(&truth, slice)?).norm());
    let errors: Vec<f64> = slices.iter().filter_map(error).collect();
    assert!(errors.len() >= 4 && errors.iter().all(|&error| error < cine.grid().spacing_mm().x), "{errors:?} {before:?} {after:?}");
}
