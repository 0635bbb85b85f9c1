//! Ellipsoids cut into thick oblique slices, whose volumes and surfaces are known.

use nalgebra::{Matrix4, Rotation3};

use super::*;
use crate::image::Grid;

const CODES: HeartCodes = HeartCodes { cavity_lv: 1, wall_lv: 2, cavity_rv: None, wall_rv: None };

/// A truncated ellipsoidal ventricle on slices: semi-axes of cavity and epicardium in mm (short, long), centre on the base plane.
struct Ellipsoids {
    cavity_mm: [f64; 2],
    epicardium_mm: [f64; 2],
}

const HEART: Ellipsoids = Ellipsoids { cavity_mm: [24.0, 70.0], epicardium_mm: [33.0, 79.0] };

impl Ellipsoids {
    /// −1 at the centre, 0 on the surface.
    fn level(semi_axes_mm: [f64; 2], x: Vector3<f64>) -> f64 {
        ((x.x * x.x + x.y * x.y) / semi_axes_mm[0].powi(2) + x.z * x.z / semi_axes_mm[1].powi(2)).sqrt() - 1.0
    }

    fn code(&self, x: Vector3<f64>) -> u8 {
        if Self::level(self.cavity_mm, x) < 0.0 { 1 } else { 2 * u8::from(Self::level(self.epicardium_mm, x) < 0.0) }
    }
}

/// Slices of `gap_mm` from base (k = 0) to apex, with the ventricle's base at the outer face of slice 0; `map` places them in the world.
fn label_map(heart: &Ellipsoids, in_plane_mm: [f64; 2], gap_mm: f64, map: &Matrix4<f64>) -> LabelMap {
    let shape = [(90.0 / in_plane_mm[0]) as usize, (90.0 / in_plane_mm[1]) as usize, (90.0 / gap_mm) as usize];
    let local = Matrix4::new_translation(&Vector3::new(-44.3, -45.2, -0.5 * gap_mm))
        * Matrix4::new_nonuniform_scaling(&Vector3::new(in_plane_mm[0], in_plane_mm[1], -gap_mm));
    let grid = Grid::new(shape, map * local).unwrap();
    let code = |flat| {
        let [i, j, k] = grid.voxel_of(flat);
        heart.code((local * Vector3::new(i as f64, j as f64, k as f64).push(1.0)).xyz())
    };
    let labels = (0..grid.voxel_count()).map(code).collect();
    LabelMap::new(grid, labels).unwrap()
}

fn oblique() -> Matrix4<f64> {
    Matrix4::new_translation(&Vector3::new(12.0, -40.0, 33.0)) * Rotation3::from_euler_angles(0.5, -0.9, 2.0).to_homogeneous()
}

fn message(labels: &LabelMap) -> String {
    heart_fields(labels, &CODES, &FieldOptions::default()).unwrap_err().to_string()
}

/// The volume of the mesher's input is that of the labels (2 % was asked for), and the surface stays within half a voxel of the truth
/// where slices show it; the caps are judged by the tips.
#[test]
fn thick_oblique_slices_give_back_volume_and_surface_of_an_ellipsoid() {
    for (in_plane_mm, gap_mm, volume_tolerance, surface_mm) in [([1.4, 1.4], 10.0, 0.02, 1.2), ([1.2, 1.3], 5.0, 0.01, 0.65)] {
        let map = oblique();
        let labels = label_map(&HEART, in_plane_mm, gap_mm, &map);
        let fields = heart_fields(&labels, &CODES, &FieldOptions::default()).unwrap();
        let report = &fields.report;
        assert_eq!(report.basal_slice, 0);
        assert!((report.cavity_lv_ml / report.labelled_cavity_lv_ml - 1.0).abs() < volume_tolerance, "{report:?}");
        assert!((report.wall_ml / report.labelled_wall_ml - 1.0).abs() < volume_tolerance, "{report:?}");
        let exact_ml = |[short, long]: [f64; 2]| 2.0 / 3.0 * std::f64::consts::PI * short * short * long / 1000.0;
        assert!((report.cavity_lv_ml / exact_ml(HEART.cavity_mm) - 1.0).abs() < 0.02, "{report:?}");
        for (field, semi_axes_mm) in [(&fields.cavity_lv, HEART.cavity_mm), (&fields.epicardium, HEART.epicardium_mm)] {
            for height in 1..=7 {
                for turn in 0..12 {
                    let z = -0.1 * f64::from(height) * semi_axes_mm[1];
                    let radius = semi_axes_mm[0] * (1.0 - (z / semi_axes_mm[1]).powi(2)).sqrt();
                    let angle = f64::from(turn) * std::f64::consts::FRAC_PI_6;
                    let point = map * Vector3::new(radius * angle.cos(), radius * angle.sin(), z).push(1.0);
                    let distance_mm = field.sample(&point.xyz()).unwrap();
                    assert!(distance_mm.abs() < surface_mm, "{distance_mm} mm off at height {z}, slices of {gap_mm} mm");
                }
            }
        }
        let apex_mm = (map * Vector3::new(0.0, 0.0, -HEART.epicardium_mm[1]).push(1.0)).xyz();
        assert!((fields.apex_mm - apex_mm).norm() < 0.5 * gap_mm, "{} {apex_mm}", fields.apex_mm);
        assert!((fields.long_axis - map.fixed_view::<3, 1>(0, 2)).norm() < 1e-9);
        assert!(fields.base_plane.signed_distance_mm(&map.fixed_view::<3, 1>(0, 3).into_owned()).abs() < 1e-9);
    }
}

#[test]
fn fields_are_distances_close_at_the_apex_and_are_positive_on_the_border() {
    let labels = label_map(&HEART, [1.4, 1.4], 8.0, &oblique());
    let fields = heart_fields(&labels, &CODES, &FieldOptions::default()).unwrap();
    for field in [&fields.cavity_lv, &fields.epicardium] {
        let grid = field.grid();
        let [ni, nj, nk] = grid.shape();
        let mut steep = 0;
        for flat in 0..grid.voxel_count() {
            let [i, j, k] = grid.voxel_of(flat);
            let position_mm = grid.to_world_mm(&Vector3::new(i as f64, j as f64, k as f64));
            let on_border = i == 0 || j == 0 || k == 0 || i + 1 == ni || j + 1 == nj || k + 1 == nk;
            if on_border && fields.base_plane.signed_distance_mm(&position_mm) <= 0.0 {
                assert!(field.at([i, j, k]) > 0.0);
            }
            if !on_border && field.at([i, j, k]).abs() < 4.0 {
                let (_, slope) = field.sample_with_gradient(&(position_mm + 0.3 * fields.long_axis)).unwrap();
                steep += usize::from((slope.norm() - 1.0).abs() > 0.25);
            }
        }
        // Edges where the base begins and the ridge at the apex are the exceptions.
        assert!(steep < grid.voxel_count() / 200, "{steep} of {}", grid.voxel_count());
    }
    assert!(fields.report.apical_wall_mm > 4.0 && fields.report.apical_wall_mm < 14.0, "{:?}", fields.report);
}

#[test]
fn base_at_mid_slice_removes_half_a_slice() {
    let labels = label_map(&HEART, [1.4, 1.4], 8.0, &oblique());
    let options = FieldOptions { base: BaseCut::MidSlice, ..FieldOptions::default() };
    let (whole, cut) = (heart_fields(&labels, &CODES, &FieldOptions::default()).unwrap(), heart_fields(&labels, &CODES, &options).unwrap());
    let removed_ml = whole.report.cavity_lv_ml - cut.report.cavity_lv_ml;
    let slab_ml = 4.0 * std::f64::consts::PI * HEART.cavity_mm[0].powi(2) / 1000.0;
    assert!((removed_ml / slab_ml - 1.0).abs() < 0.03, "{removed_ml} {slab_ml}");
}

#[test]
fn apex_is_found_at_either_end_and_can_be_told() {
    let labels = label_map(&HEART, [1.4, 1.4], 8.0, &Matrix4::identity());
    let detected = heart_fields(&labels, &CODES, &FieldOptions::default()).unwrap();
    assert!(detected.long_axis.z > 0.99);
    let options = FieldOptions { apex: ApexEnd::FirstSlice, ..FieldOptions::default() };
    let told = heart_fields(&labels, &CODES, &options).unwrap();
    assert!(told.long_axis.z < -0.99);
    assert!(!told.warnings.is_empty(), "an apex as wide as a base is closed by force and reported");
}

fn edited(labels: &LabelMap, edit: impl Fn([usize; 3], u8) -> u8) -> LabelMap {
    let grid = labels.grid().clone();
    let new = labels.labels().iter().enumerate().map(|(flat, &label)| edit(grid.voxel_of(flat), label)).collect();
    LabelMap::new(grid, new).unwrap()
}

#[test]
fn open_walls_at_the_base_are_left_out_and_in_the_middle_refused() {
    let labels = label_map(&HEART, [1.4, 1.4], 8.0, &oblique());
    let open_in = |slice: usize| edited(&labels, |[i, _, k], label| if k == slice && label == 2 && i > 30 { 0 } else { label });
    let fields = heart_fields(&open_in(0), &CODES, &FieldOptions::default()).unwrap();
    assert_eq!(fields.report.basal_slice, 1);
    assert!(fields.warnings.iter().any(|w| w.contains("slice 0") && w.contains("left out")), "{:?}", fields.warnings);
    assert!(message(&open_in(3)).contains("slice 3"));
}

/// The cavity is the one that stands in the labels, and the grown wall has the thickness asked for, at the apex too; where a wall is labelled
/// in every slice, nothing is grown.
#[test]
fn a_left_cavity_without_a_wall_gets_one_if_it_is_asked_for() {
    let labels = label_map(&HEART, [1.4, 1.4], 8.0, &oblique());
    let walled = heart_fields(&labels, &CODES, &FieldOptions::default()).unwrap().report;
    let bare = edited(&labels, |_, label| u8::from(label == 1));
    let open_at_the_base = edited(&labels, |[i, _, k], label| if k < 2 && label == 2 && i > 30 { 0 } else { label });
    for thickness_mm in [1.5, 9.0] {
        let options = FieldOptions { wall_thickness_lv_mm: Some(thickness_mm), ..FieldOptions::default() };
        assert_eq!(heart_fields(&labels, &CODES, &options).unwrap().report, walled);
        let fields = heart_fields(&bare, &CODES, &options).unwrap();
        let report = &fields.report;
        assert_eq!((report.basal_slice, report.labelled_wall_ml), (0, 0.0));
        assert!((report.cavity_lv_ml / report.labelled_cavity_lv_ml - 1.0).abs() < 0.02, "{report:?}");
        assert!((report.grown_wall_ml - report.wall_ml).abs() < 0.02 * report.wall_ml, "{report:?}");
        let [cavity_mm, epicardium_mm] = [&fields.cavity_lv, &fields.epicardium].map(|field| field.sample(&fields.apex_mm).unwrap());
        assert!((cavity_mm - thickness_mm).abs() < 1.0 && epicardium_mm.abs() < 1.0, "{cavity_mm} {epicardium_mm}");
        let at = |height: f64, beyond_mm: f64| {
            let radius = HEART.cavity_mm[0] * (1.0 - height * height).sqrt();
            (oblique() * Vector3::new(0.0, radius + beyond_mm, -height * HEART.cavity_mm[1]).push(1.0)).xyz()
        };
        assert!(fields.epicardium.sample(&at(0.1, thickness_mm)).unwrap().abs() < 0.7);
        assert!((fields.epicardium.sample(&at(0.4, 0.0)).unwrap() + thickness_mm).abs() < 0.7);
    }
    let options = FieldOptions { wall_thickness_lv_mm: Some(9.0), ..FieldOptions::default() };
    let partly = heart_fields(&open_at_the_base, &CODES, &options).unwrap();
    assert_eq!(partly.report.basal_slice, 0);
    assert!(partly.warnings.iter().any(|w| w.contains("left ventricle has a labelled wall in 7 of 9 slices")), "{:?}", partly.warnings);
    assert!((partly.report.cavity_lv_ml / walled.cavity_lv_ml - 1.0).abs() < 0.01);
    // Along the normals, 9 mm around the cavity hold 5.7 % more than this ellipsoid, whose wall has them along the axes only.
    let thicker = partly.report.wall_ml / walled.wall_ml;
    assert!((1.0..1.08).contains(&thicker), "{thicker}");
}

#[test]
fn unusable_labels_are_refused_with_their_reason() {
    let labels = label_map(&HEART, [1.4, 1.4], 8.0, &oblique());
    assert!(message(&edited(&labels, |_, _| 0)).contains("label 1"));
    let bare = message(&edited(&labels, |_, label| if label == 2 { 0 } else { label }));
    assert!(bare.contains("closed wall (label 2)") && bare.contains("set wall_thickness_lv_mm"), "{bare}");
    assert!(message(&edited(&labels, |_, label| 2 * u8::from(label > 0))).contains("fewer than two slices"));
    assert!(message(&edited(&labels, |[_, _, k], label| if k == 4 { label } else { 0 })).contains("fewer than two slices"));
    assert!(message(&edited(&labels, |[_, _, k], label| if k == 4 && label == 1 { 2 } else { label })).contains("slice 4"));
    let same = HeartCodes::left(1, 1);
    assert!(heart_fields(&labels, &same, &FieldOptions::default()).is_err());
    let coarse = FieldOptions { spacing_mm: Some(f64::NAN), ..FieldOptions::default() };
    assert!(heart_fields(&labels, &CODES, &coarse).is_err());
}

#[test]
fn specks_and_holes_are_cleaned() {
    let labels = label_map(&HEART, [1.4, 1.4], 8.0, &oblique());
    let speckled = edited(&labels, |[i, j, k], label| match (i, j, k) {
        (2, 2, 4) => 1,
        (32, 32, 3) => 0,
        _ => label,
    });
    let (clean, cleaned) = (
        heart_fields(&labels, &CODES, &FieldOptions::default()).unwrap(),
        heart_fields(&speckled, &CODES, &FieldOptions::default()).unwrap(),
    );
    assert_eq!(clean.report, cleaned.report);
    assert!(cleaned.warnings.iter().any(|w| w.contains("slice 4")));
}

const BOTH: HeartCodes = HeartCodes { cavity_rv: Some(3), ..CODES };

/// A smaller left ventricle with a right one beside it, an ellipsoid that the left one cuts, without a wall of its own.
fn two_ventricles(gap_mm: f64, map: &Matrix4<f64>) -> LabelMap {
    let left = Ellipsoids { cavity_mm: [15.0, 50.0], epicardium_mm: [22.0, 57.0] };
    let labels = label_map(&left, [1.4, 1.4], gap_mm, map);
    let to_own = map.try_inverse().unwrap();
    let right = |flat: usize| {
        let voxel = Vector3::from(labels.grid().voxel_of(flat).map(|n| n as f64));
        let own = (to_own * labels.grid().to_world_mm(&voxel).push(1.0)).xyz() - Vector3::new(14.0, 0.0, 0.0);
        own.component_div(&Vector3::new(25.0, 22.0, 48.0)).norm() < 1.0
    };
    let codes = labels.labels().iter().enumerate().map(|(flat, &label)| if label == 0 && right(flat) { 3 } else { label });
    LabelMap::new(labels.grid().clone(), codes.collect()).unwrap()
}

fn message_of_both(labels: &LabelMap, options: &FieldOptions) -> String {
    heart_fields(labels, &BOTH, options).unwrap_err().to_string()
}

#[test]
fn a_right_cavity_keeps_its_volume_and_gets_a_wall() {
    let labels = two_ventricles(8.0, &oblique());
    let fields = heart_fields(&labels, &BOTH, &FieldOptions::default()).unwrap();
    let report = &fields.report;
    let right_ml = (report.cavity_rv_ml.unwrap(), report.labelled_cavity_rv_ml.unwrap());
    assert!((right_ml.0 / right_ml.1 - 1.0).abs() < 0.02, "{report:?}");
    assert!((report.cavity_lv_ml / report.labelled_cavity_lv_ml - 1.0).abs() < 0.02, "{report:?}");
    assert!(((report.wall_ml - report.grown_wall_ml) / report.labelled_wall_ml - 1.0).abs() < 0.03, "{report:?}");
    // The middle of the free wall, where the cavity ends: the epicardium lies 3 mm further.
    let at = |x: f64| (oblique() * Vector3::new(x, 0.0, -12.0).push(1.0)).xyz();
    let right = fields.cavity_rv.as_ref().unwrap();
    let edge_mm = 14.0 + 25.0 * (1.0 - (12.0_f64 / 48.0).powi(2)).sqrt();
    assert!(right.sample(&at(edge_mm)).unwrap().abs() < 0.7);
    assert!((right.sample(&at(edge_mm + 1.0)).unwrap() - fields.epicardium.sample(&at(edge_mm + 1.0)).unwrap() - 3.0).abs() < 0.3);
}

#[test]
fn a_right_cavity_that_ends_early_takes_slices_with_it_and_one_with_gaps_is_refused() {
    let labels = two_ventricles(8.0, &oblique());
    let without_rv_in = |lost: &dyn Fn(usize) -> bool| edited(&labels, |[_, _, k], label| if label == 3 && lost(k) { 0 } else { label });
    let fields = heart_fields(&without_rv_in(&|k| k == 0), &BOTH, &FieldOptions::default()).unwrap();
    assert_eq!(fields.report.basal_slice, 1);
    assert!(fields.warnings.iter().any(|w| w.contains("slice 0: no right cavity at the base")), "{:?}", fields.warnings);
    assert!(message_of_both(&without_rv_in(&|k| k == 2), &FieldOptions::default()).contains("slice 2: the right cavity is missing"));
    assert!(message_of_both(&without_rv_in(&|k| k > 0), &FieldOptions::default()).contains("hold a right cavity (label 3)"));
    assert!(message_of_both(&without_rv_in(&|_| true), &FieldOptions::default()).contains("no slice with a left ventricle"));
}

#[test]
fn slices_along_another_axis_are_the_same_slices() {
    let labels = two_ventricles(8.0, &oblique());
    let grid = labels.grid();
    let mut map = *grid.voxel_to_world();
    for (column, from) in [(0, 2), (1, 0), (2, 1)] {
        map.set_column(column, &grid.voxel_to_world().column(from));
    }
    let [ni, nj, nk] = grid.shape();
    let turned = Grid::new([nk, ni, nj], map).unwrap();
    let label = |flat| {
        let [k, i, j] = turned.voxel_of(flat);
        labels.at([i, j, k])
    };
    let turned = LabelMap::new(turned.clone(), (0..turned.voxel_count()).map(label).collect()).unwrap();
    let [straight, across] = [&labels, &turned].map(|l| heart_fields(l, &BOTH, &FieldOptions::default()).unwrap());
    assert_eq!(straight.report, across.report);
    assert!(across.warnings[0].contains("longest along i (8.0 mm)"), "{:?}", across.warnings);
}

/// A plane that leans by 20° cuts as much of the fields as of the voxels.
#[test]
fn a_valve_plane_of_ones_own_cuts_labels_and_fields_alike() {
    let labels = two_ventricles(8.0, &oblique());
    let with = |height_mm: f64, lean_rad: f64| {
        let place = (oblique() * Vector3::new(0.0, 0.0, height_mm).push(1.0)).xyz();
        let normal = (oblique() * Vector3::new(lean_rad.sin(), 0.0, -lean_rad.cos()).push(0.0)).xyz();
        FieldOptions { base: BaseCut::Plane(Plane { point_mm: place, normal }), ..FieldOptions::default() }
    };
    let fields = heart_fields(&labels, &BOTH, &with(-16.0, 0.35)).unwrap();
    let report = &fields.report;
    assert!(fields.base_plane.normal.dot(&fields.long_axis) > 0.9, "the normal points to the atria, whichever way it was given");
    let whole = heart_fields(&labels, &BOTH, &FieldOptions::default()).unwrap().report;
    assert!(report.cavity_lv_ml < 0.8 * whole.cavity_lv_ml);
    for (field, counted) in [
        (report.cavity_lv_ml, report.labelled_cavity_lv_ml),
        (report.cavity_rv_ml.unwrap(), report.labelled_cavity_rv_ml.unwrap()),
        (report.wall_ml - report.grown_wall_ml, report.labelled_wall_ml),
    ] {
        assert!((field / counted - 1.0).abs() < 0.03, "{report:?}");
    }
    assert!(message_of_both(&labels, &with(-10.0, 1.3)).contains("leans by 74°"));
    assert!(message_of_both(&labels, &with(30.0, 0.0)).contains("lies beyond the labels"));
    assert!(message_of_both(&labels, &with(-55.0, 0.0)).contains("leaves less than a tenth"));
}
