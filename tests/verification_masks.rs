//! From masks to a mesh: hearts of known shape are drawn into voxels as an expert would, rebuilt from these alone and compared with what
//! they were.

#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may stop at the first surprise, and says what it could not look at")]

mod common;
mod surfaces;

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings, IdealisedBiventricle, Region, Ventricle, build_from_fields, complete_anatomy};
use cardiotwin::heart::{BeatObservables, HeartModel, ModelSettings, Parameters, SimulationPlan, simulate};
use cardiotwin::image::{FieldOptions, HeartCodes, HeartFields, LabelMap, MASK_CODES, heart_fields, labels_of_masks};
use cardiotwin::mesh::io::{Numbering, TableFiles, TagCodes, read_mesh_tables};
use cardiotwin::mesh::{MeshQuality, SurfaceTag, TetLocator};
use cardiotwin::numerics::{mean, median, quantile};
use cardiotwin::phantom::{LABEL_CAVITY_LV, LABEL_CAVITY_RV, LABEL_WALL, ShortAxisStack, VoxelSampling, rasterise};
use nalgebra::Vector3;
use surfaces::distances_mm;

const CODES: HeartCodes = HeartCodes { cavity_lv: LABEL_CAVITY_LV, wall_lv: LABEL_WALL, cavity_rv: Some(LABEL_CAVITY_RV), wall_rv: None };

/// Two ventricles that lie askew in the world.
fn biventricle() -> &'static Anatomy {
    static ANATOMY: OnceLock<Anatomy> = OnceLock::new();
    let heart = IdealisedBiventricle {
        long_axis: Vector3::new(-0.6, 0.45, 0.66),
        septal_direction: Vector3::new(0.7, 0.7, 0.1),
        centre_mm: Vector3::new(12.0, -31.0, 55.0),
        ..IdealisedBiventricle::default()
    };
    ANATOMY.get_or_init(|| heart.build(&MesherSettings::with_edge_length_mm(5.0), &AnatomySettings::default()).unwrap())
}

/// Every voxel by what lies at its centre.
fn drawn(anatomy: &Anatomy, voxel_mm: f64, slice_mm: f64) -> LabelMap {
    let stack = ShortAxisStack { voxel_mm, slice_distance_mm: slice_mm, margin_mm: 6.0, end_margin_mm: 12.0 };
    let grid = stack.grid(anatomy).unwrap();
    rasterise(anatomy, anatomy.mesh.vertices_mm(), &grid, &VoxelSampling::CENTRES).unwrap().to_label_map().unwrap()
}

fn relabelled(labels: &LabelMap, new: impl Fn(&Vector3<f64>, u8) -> u8) -> LabelMap {
    let grid = labels.grid();
    let label = |flat: usize| new(&grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|n| n as f64))), labels.labels()[flat]);
    LabelMap::new(grid.clone(), (0..grid.voxel_count()).map(label).collect()).unwrap()
}

/// Labels without the right ventricle's own wall, as most segmentations are.
fn without_rv_wall(anatomy: &Anatomy, labels: &LabelMap) -> LabelMap {
    let locator = TetLocator::new(anatomy.mesh.tetrahedra(), anatomy.mesh.vertices_mm());
    let is_rv = |p: &Vector3<f64>| anatomy.regions[locator.locate(p).unwrap().tetrahedron] == Region::FreeWallRv;
    relabelled(labels, |p, label| if label == LABEL_WALL && is_rv(p) { 0 } else { label })
}

fn rebuilt(labels: &LabelMap, options: &FieldOptions, edge_length_mm: f64) -> (HeartFields, Anatomy) {
    let fields = heart_fields(labels, &CODES, options).unwrap();
    let mesher = MesherSettings::with_edge_length_mm(edge_length_mm);
    let anatomy = build_from_fields(&fields, &mesher, &AnatomySettings::default()).unwrap();
    (fields, anatomy)
}

/// Volumes of both cavities and of the wall, mL.
fn volumes_ml(anatomy: &Anatomy) -> [f64; 3] {
    let cavity = |n: usize| anatomy.cavities[n].1.volume_mm3(anatomy.mesh.vertices_mm()) / 1e3;
    [cavity(0), cavity(1), anatomy.mesh.total_volume_mm3() / 1e3]
}

/// The boundary is one sphere: the wall has no handle and no bubble.
fn assert_is_a_ball(anatomy: &Anatomy) {
    let triangles = anatomy.surface.triangles();
    let vertices: BTreeSet<usize> = triangles.iter().flatten().copied().collect();
    let edges = triangles.len() * 3 / 2;
    assert_eq!(vertices.len() as i64 - edges as i64 + triangles.len() as i64, 2);
}

/// Volumes are those of the voxels, surfaces those of the heart that was drawn.
fn assert_rebuilt(truth: &Anatomy, labels: &LabelMap, surface_mean_mm: f64, surface_p95_mm: f64) {
    let (fields, anatomy) = rebuilt(labels, &FieldOptions::default(), 5.0);
    assert_is_a_ball(&anatomy);
    let sizes = &fields.report;
    let labelled_ml = [sizes.labelled_cavity_lv_ml, sizes.labelled_cavity_rv_ml.unwrap(), sizes.labelled_wall_ml + sizes.grown_wall_ml];
    for (volume, labelled) in volumes_ml(&anatomy).iter().zip(labelled_ml) {
        assert!((volume / labelled - 1.0).abs() < 0.02, "{volume} mL, labels {labelled} mL");
    }
    let quality = MeshQuality::of(&anatomy.mesh);
    assert!(quality.dihedral_least_deg > 10.0 && quality.dihedral_percentile_1_deg > 20.0, "{quality:?}");
    let slice_mm = labels.grid().spacing_mm().z;
    for tag in [SurfaceTag::EndocardiumLv, SurfaceTag::EndocardiumRv, SurfaceTag::Epicardium] {
        let distances = distances_mm(&anatomy, truth, tag, |p| fields.base_plane.signed_distance_mm(p) < -slice_mm);
        let (mean_mm, p95_mm) = (mean(&distances), quantile(&distances, 0.95).unwrap());
        assert!(mean_mm < surface_mean_mm && p95_mm < surface_p95_mm, "{tag:?}: {mean_mm} mm, {p95_mm} mm");
    }
}

/// Half a voxel is 0.75 mm in the slice; the surface is held to a third of that on average, and between thick slices 95 of 100 points to 1.5 mm.
#[test]
fn two_ventricles_come_back_from_thick_slices() {
    assert_rebuilt(biventricle(), &drawn(biventricle(), 1.5, 8.0), 0.4, 1.5);
}

#[test]
fn two_ventricles_come_back_from_cubic_voxels_within_half_a_voxel() {
    assert_rebuilt(biventricle(), &drawn(biventricle(), 1.5, 1.5), 0.25, 0.75);
}

/// A shape that this program has not made: the biventricle of the cardiac elastodynamics benchmark.
#[test]
fn the_benchmark_biventricle_comes_back_from_thick_slices() {
    let Some(folder) = common::real_data("benchmark_biventricle") else { return };
    let files = TableFiles {
        vertices: folder.join("nodes_xyz_m.txt"),
        tetrahedra: folder.join("tets_0based.txt"),
        surface: folder.join("boundary_tris_0based_and_tag.txt"),
        fibres: None,
    };
    let file = read_mesh_tables(&files).unwrap();
    let mesh = file.to_tet_mesh(1000.0, Numbering::Free).unwrap();
    let surface = file.to_tagged_surface(&mesh, file.surface_field(), &TagCodes::default()).unwrap();
    let truth = complete_anatomy(mesh, surface, &AnatomySettings::default()).unwrap();
    let labels = drawn(&truth, 1.5, 8.0);
    assert_rebuilt(&truth, &labels, 0.5, 1.5);
    // Without its right wall the cavities are the same.
    let sizes = |labels: &LabelMap| heart_fields(labels, &CODES, &FieldOptions::default()).unwrap().report;
    let (walled, open) = (sizes(&labels), sizes(&without_rv_wall(&truth, &labels)));
    assert_eq!(walled.grown_wall_ml, 0.0);
    assert!(open.grown_wall_ml > 5.0, "{open:?}");
    assert!((open.cavity_lv_ml / walled.cavity_lv_ml - 1.0).abs() < 0.01);
    assert!((open.cavity_rv_ml.unwrap() / walled.cavity_rv_ml.unwrap() - 1.0).abs() < 0.02);
}

/// The free wall's thickness, from the right endocardium to the epicardium, is the one asked for.
#[test]
fn a_right_ventricle_without_a_wall_gets_one_of_the_thickness_asked_for() {
    let labels = without_rv_wall(biventricle(), &drawn(biventricle(), 1.5, 8.0));
    for wall_thickness_rv_mm in [3.0, 5.0] {
        let options = FieldOptions { wall_thickness_rv_mm, ..FieldOptions::default() };
        let (fields, anatomy) = rebuilt(&labels, &options, 6.0);
        assert_is_a_ball(&anatomy);
        assert!(fields.report.grown_wall_ml > 20.0, "{:?}", fields.report);
        let free: Vec<f64> = anatomy
            .surface
            .vertices_with(SurfaceTag::EndocardiumRv)
            .into_iter()
            .filter(|&v| anatomy.transmural_depth[v] == 0.0)
            .filter_map(|v| fields.epicardium.sample(&anatomy.mesh.vertices_mm()[v]).map(|distance| -distance))
            .collect();
        let middle_mm = median(&free).unwrap();
        assert!((middle_mm - wall_thickness_rv_mm).abs() < 0.25, "{middle_mm} mm in the middle of {}", free.len());
        let [left_ml, right_ml, _] = volumes_ml(&anatomy);
        assert!((left_ml / fields.report.labelled_cavity_lv_ml - 1.0).abs() < 0.02);
        assert!((right_ml / fields.report.labelled_cavity_rv_ml.unwrap() - 1.0).abs() < 0.02);
    }
}

/// Epicardium, left and right blood as separate masks say what the label map says.
#[test]
fn three_masks_are_one_label_map() {
    let labels = drawn(biventricle(), 2.0, 8.0);
    let mask = |is_inside: fn(u8) -> bool| relabelled(&labels, |_, label| u8::from(is_inside(label)) * 255);
    let (left, right) = (mask(|label| label == LABEL_CAVITY_LV), mask(|label| label == LABEL_CAVITY_RV));
    let (joined, warnings) = labels_of_masks(&mask(|label| label != 0), &left, Some(&right)).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    let [one, other] =
        [(&labels, CODES), (&joined, MASK_CODES)].map(|(l, codes)| heart_fields(l, &codes, &FieldOptions::default()).unwrap());
    assert_eq!(one.report, other.report);
    // Where the epicardium leaves the right ventricle out, its wall is grown.
    let (joined, _) = labels_of_masks(&mask(|label| label == LABEL_CAVITY_LV || label == LABEL_WALL), &left, Some(&right)).unwrap();
    assert_eq!(joined, joined_codes(&labels));
}

/// The labels in the codes of joined masks.
fn joined_codes(labels: &LabelMap) -> LabelMap {
    relabelled(labels, |_, label| match label {
        LABEL_CAVITY_LV => MASK_CODES.cavity_lv,
        LABEL_CAVITY_RV => MASK_CODES.cavity_rv.unwrap(),
        LABEL_WALL => MASK_CODES.wall_lv,
        _ => 0,
    })
}

/// A heart that knows nothing of where its masks come from beats: both ventricles eject, and the left one against the higher pressure.
#[test]
fn two_ventricles_from_masks_beat() {
    let labels = without_rv_wall(biventricle(), &drawn(biventricle(), 2.0, 8.0));
    let (_, anatomy) = rebuilt(&labels, &FieldOptions::default(), 7.5);
    let model = HeartModel::new(Arc::new(anatomy), Parameters::default(), ModelSettings::default()).unwrap();
    let (start_s, period_s) = (-0.15, 0.8);
    let plan = SimulationPlan { start_time_s: start_s, end_time_s: start_s + period_s, frame_times_s: vec![start_s] };
    let trajectory = simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
    let [left, right] =
        [Ventricle::Left, Ventricle::Right].map(|v| BeatObservables::of_beat(&trajectory.curves, v, start_s, period_s).unwrap());
    assert!((0.4..0.75).contains(&left.ejection_fraction) && (0.2..0.75).contains(&right.ejection_fraction), "{left:?} {right:?}");
    assert!(left.pressure_peak_mmhg > 80.0 && (10.0..60.0).contains(&right.pressure_peak_mmhg), "{left:?} {right:?}");
}
