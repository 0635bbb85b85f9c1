//! Slices displaced on purpose: of a beating ellipse whose drift is known, and of labels.

use super::*;
use nalgebra::Vector3;

/// A beating bright ellipse, oblique to the slices, with a static surrounding texture; slices displaced by `shift_mm`.
fn beating(shift_mm: &[Vector2<f64>]) -> CineSequence {
    let spacing_mm = Vector3::new(1.5, 1.4, 9.0);
    let grid = Grid::axis_aligned([64, 60, shift_mm.len()], Vector3::zeros(), spacing_mm).unwrap();
    let frame = |n: usize| {
        let radius_mm = 24.0 - 5.0 * (std::f64::consts::TAU * n as f64 / 8.0).sin();
        let value = |flat: usize| {
            let [i, j, k] = grid.voxel_of(flat);
            let x = Vector2::new(i as f64 * spacing_mm.x, j as f64 * spacing_mm.y) - shift_mm[k];
            let centre = Vector2::new(42.0 + 0.15 * 9.0 * k as f64, 45.0 - 0.1 * 9.0 * k as f64);
            let offset = x - centre;
            let size_mm = radius_mm * (1.0 - 0.05 * k as f64);
            let edge = (size_mm - (offset.x * offset.x + 1.3 * offset.y * offset.y).sqrt()) / 2.0;
            (200.0 / (1.0 + (-edge).exp()) + 10.0 * (0.3 * x.x).sin() * (0.4 * x.y).cos()) as f32
        };
        Volume::new(grid.clone(), (0..grid.voxel_count()).map(value).collect()).unwrap()
    };
    CineSequence::new((0..8).map(frame).collect(), (0..8).map(|n| 0.1 * f64::from(n)).collect(), 0.8).unwrap()
}

#[test]
fn displaced_slices_of_an_oblique_beating_heart_are_found_and_put_back() {
    let mut truth = vec![Vector2::zeros(); 9];
    truth[3] = Vector2::new(4.0, -2.5);
    truth[6] = Vector2::new(-3.0, 1.0);
    let cine = beating(&truth);
    let found = estimate_slice_shifts(&cine, None);
    assert_eq!(found.not_estimable(), [0, 8]);
    for slice in 1..8 {
        let shift_mm = found.shift_mm[slice].unwrap();
        // A third of a pixel, and the price of sparseness.
        assert!((shift_mm - truth[slice]).norm() < 0.6, "slice {slice}: {shift_mm} for {}", truth[slice]);
    }
    let warnings = found.warnings(2.0);
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    assert!(warnings[0].contains("slice 3"));
    let left = estimate_slice_shifts(&correct_slice_shifts(&cine, &found).unwrap(), None);
    assert!(left.greatest_mm() < 0.7, "{:?}", left.shift_mm);
}

#[test]
fn an_oblique_heart_without_shifts_is_left_alone() {
    let found = estimate_slice_shifts(&beating(&[Vector2::zeros(); 7]), None);
    assert!(found.greatest_mm() < 0.3, "{:?}", found.shift_mm);
    assert!(found.warnings(2.0).is_empty());
}

#[test]
fn labels_move_with_their_slice() {
    let grid = Grid::axis_aligned([9, 9, 3], Vector3::new(1.0, 2.0, 3.0), Vector3::new(2.0, 2.0, 8.0)).unwrap();
    let shifts = SliceShifts { shift_mm: vec![None, Some(Vector2::new(4.0, -2.0)), Some(Vector2::zeros())] };
    let drawn = |flat: usize| u8::from([[4, 4, 0], [6, 3, 1]].contains(&grid.voxel_of(flat)));
    let labels = LabelMap::new(grid.clone(), (0..grid.voxel_count()).map(drawn).collect()).unwrap();
    let moved = correct_label_shifts(&labels, &grid, &shifts);
    assert_eq!((moved.at([4, 4, 0]), moved.at([4, 4, 1]), moved.count(1)), (1, 1, 2));
}

#[test]
fn two_slices_or_a_still_image_are_not_estimable() {
    assert_eq!(estimate_slice_shifts(&beating(&[Vector2::zeros(); 2]), None).shift_mm, vec![None; 2]);
    let grid = Grid::axis_aligned([5, 5, 4], Vector3::zeros(), Vector3::repeat(2.0)).unwrap();
    let still = Volume::new(grid, vec![1.0; 100]).unwrap();
    let cine = CineSequence::new(vec![still.clone(), still], vec![0.0, 0.5], 1.0).unwrap();
    assert_eq!(estimate_slice_shifts(&cine, None).not_estimable(), [0, 1, 2, 3]);
    assert!(correct_slice_shifts(&cine, &SliceShifts { shift_mm: vec![] }).is_err());
}
