//! The round trip: a heart of known shape → images and masks as NIfTI files → read back → mesh as a file → read back, against the heart that was imaged.
//!
//! Volumes are those of the heart, not of its labels, and to be met within 0.5 % in cubic voxels and 2 % in
//! slices of 8 mm. The base is cut by the valve plane, which is known here as it is where
//! somebody drew it; where it is not known the base is the face of the last slice, and half a slice of volume is left to chance.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may stop at the first surprise; what it measured stands in docs/images.md"
)]

mod surfaces;

use std::fs::File;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings, IdealisedBiventricle, complete_anatomy};
use cardiotwin::image::{CineTiming, read_cine, read_label_map, write_cine, write_label_map};
use cardiotwin::mesh::io::{Numbering, TagCodes, read_mesh_file};
use cardiotwin::mesh::{MeshQuality, SurfaceTag};
use cardiotwin::numerics::{mean, quantile};
use cardiotwin::phantom::{IdealisedLv, LABEL_CAVITY_LV, ShortAxisStack, SyntheticCineSettings, VoxelSampling, synthetic_cine};
use cardiotwin::study::{Config, Overrides, Plan, RunContext, Silent, mesh_heart};
use nalgebra::Vector3;
use surfaces::distances_mm;

const VOXEL_MM: f64 = 1.5;
const EDGE_MM: f64 = 5.0;

fn long_axis() -> Vector3<f64> {
    Vector3::new(-0.6, 0.45, 0.66).normalize()
}

/// A left ventricle that lies askew in the world.
fn one_ventricle() -> Anatomy {
    let lv = IdealisedLv { long_axis: long_axis(), centre_mm: Vector3::new(12.0, -31.0, 55.0), ..IdealisedLv::default() };
    lv.build(&MesherSettings::with_edge_length_mm(EDGE_MM), &AnatomySettings::default()).unwrap()
}

/// Two ventricles that do.
fn two_ventricles() -> &'static Anatomy {
    static HEART: OnceLock<Anatomy> = OnceLock::new();
    let heart = IdealisedBiventricle {
        long_axis: long_axis(),
        septal_direction: Vector3::new(0.7, 0.7, 0.1),
        centre_mm: Vector3::new(12.0, -31.0, 55.0),
        ..IdealisedBiventricle::default()
    };
    HEART.get_or_init(|| heart.build(&MesherSettings::with_edge_length_mm(EDGE_MM), &AnatomySettings::default()).unwrap())
}

/// A scanner's images of a heart that stands still, and the tissue of every voxel: `cine.nii.gz` and `labels.nii.gz`.
fn image(heart: &Anatomy, slice_mm: f64, folder: &Path) {
    let stack = ShortAxisStack { voxel_mm: VOXEL_MM, slice_distance_mm: slice_mm, margin_mm: 8.0, end_margin_mm: 12.0 };
    let planes = if slice_mm > 4.0 { 4 } else { 2 };
    let sampling = VoxelSampling { samples_per_voxel: [2, 2, planes], thickness_share: 1.0 };
    let settings = SyntheticCineSettings { sampling, ..SyntheticCineSettings::default() };
    let frames = [heart.mesh.vertices_mm().to_vec(), heart.mesh.vertices_mm().to_vec()];
    let imaged = synthetic_cine(heart, &frames, &[0.0, 0.4], 0.8, &stack.grid(heart).unwrap(), &settings).unwrap();
    write_cine(&mut File::create(folder.join("cine.nii.gz")).unwrap(), &imaged.cine).unwrap();
    write_label_map(&mut File::create(folder.join("labels.nii.gz")).unwrap(), &imaged.labels[0]).unwrap();
}

/// The mesh that the files of a folder become, by the valve plane of the heart.
fn meshed(heart: &Anatomy, folder: &Path) -> Anatomy {
    let base_mm = heart.cavities[0].1.lid_centre_mm(heart.mesh.vertices_mm());
    let list = |v: Vector3<f64>| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z);
    let right = if heart.cavities.len() > 1 { "code_cavity_rv = 3\n" } else { "" };
    let text = format!(
        "kind = \"mesh\"\n[anatomy]\nlabels = \"labels.nii.gz\"\n{right}base_point_mm = {}\nbase_normal = {}\nedge_length_mm = {EDGE_MM:?}\n\
         [images]\ncine = \"cine.nii.gz\"\n",
        list(base_mm),
        list(long_axis())
    );
    let overrides = Overrides { data: Some(folder.into()), ..Overrides::default() };
    let plan = Plan::new(&Config::from_text(&folder.join("study.toml"), text, overrides).unwrap()).unwrap();
    let file = folder.join("heart.vtu");
    mesh_heart(&plan, &file, None, &RunContext::new(&Silent, &AtomicBool::new(false))).unwrap();
    let read = read_mesh_file(&file).unwrap();
    let mesh = read.to_tet_mesh(1.0, Numbering::Oriented).unwrap();
    let surface = read.to_tagged_surface(&mesh, read.surface_field(), &TagCodes::default()).unwrap();
    complete_anatomy(mesh, surface, &AnatomySettings::default()).unwrap()
}

/// Blood of every cavity, then wall, mL.
fn volumes_ml(heart: &Anatomy) -> Vec<f64> {
    let blood = heart.cavities.iter().map(|(_, cavity)| cavity.volume_mm3(heart.mesh.vertices_mm()) / 1e3);
    blood.chain([heart.mesh.total_volume_mm3() / 1e3]).collect()
}

/// Volumes within `share` of the heart's, surfaces on average within `mean_mm`, 95 of 100 points within `most_mm`.
fn comes_back(name: &str, heart: &Anatomy, slice_mm: f64, [share, mean_mm, most_mm]: [f64; 3]) {
    let folder = tempfile::tempdir().unwrap();
    image(heart, slice_mm, folder.path());
    let again = meshed(heart, folder.path());
    println!("{name}, slices of {slice_mm} mm: {:.1?} mL for {:.1?}", volumes_ml(&again), volumes_ml(heart));
    for (found, truth) in volumes_ml(&again).iter().zip(volumes_ml(heart)) {
        assert!((found / truth - 1.0).abs() < share, "{name}: {found} mL for {truth}");
    }
    let quality = MeshQuality::of(&again.mesh);
    assert!(quality.dihedral_least_deg > 10.0, "{quality:?}");
    for tag in [SurfaceTag::EndocardiumLv, SurfaceTag::EndocardiumRv, SurfaceTag::Epicardium] {
        let distances = distances_mm(&again, heart, tag, |_| true);
        if distances.is_empty() {
            continue;
        }
        let [average, most] = [mean(&distances), quantile(&distances, 0.95).unwrap()];
        println!("  {tag:?}: {average:.2} mm on average, {most:.2} mm at the 95th percentile");
        assert!(average < mean_mm && most < most_mm, "{name}, {tag:?}: {average} mm, {most} mm");
    }
}

#[test]
fn one_ventricle_comes_back_from_cubic_voxels_within_half_a_voxel() {
    comes_back("one ventricle", &one_ventricle(), VOXEL_MM, [0.005, 0.25, 0.5 * VOXEL_MM]);
}

#[test]
fn one_ventricle_comes_back_from_thick_slices() {
    comes_back("one ventricle", &one_ventricle(), 8.0, [0.02, 0.5, 1.5]);
}

#[test]
fn two_ventricles_come_back_from_cubic_voxels_within_half_a_voxel() {
    comes_back("two ventricles", two_ventricles(), VOXEL_MM, [0.005, 0.25, 0.5 * VOXEL_MM]);
}

#[test]
fn two_ventricles_come_back_from_thick_slices() {
    comes_back("two ventricles", two_ventricles(), 8.0, [0.02, 0.5, 1.5]);
}

/// The images show the tissue that the masks name: blood by its brightness alone, in the slices below the base, agrees with them voxel by voxel.
#[test]
fn images_show_what_the_masks_say() {
    let folder = tempfile::tempdir().unwrap();
    image(&one_ventricle(), VOXEL_MM, folder.path());
    let cine = read_cine(&folder.path().join("cine.nii.gz"), &CineTiming::default()).unwrap().cine;
    let labels = read_label_map(&folder.path().join("labels.nii.gz")).unwrap();
    assert!((cine.grid().voxel_to_world() - labels.grid().voxel_to_world()).amax() < 1e-9);
    let [ni, nj, nk] = labels.grid().shape();
    let shows_blood = |k: usize| labels.labels()[ni * nj * k..ni * nj * (k + 1)].contains(&LABEL_CAVITY_LV);
    let last = (0..nk).filter(|&k| shows_blood(k)).max().unwrap();
    let (mut both, mut either) = (0_usize, 0_usize);
    for flat in 0..ni * nj * last {
        let (bright, blood) = (cine.frames()[1].values()[flat] > 145.0, labels.labels()[flat] == LABEL_CAVITY_LV);
        both += usize::from(bright && blood);
        either += usize::from(bright) + usize::from(blood);
    }
    let dice = 2.0 * both as f64 / either as f64;
    assert!(both > 10_000 && dice > 0.97, "Dice {dice} of {both} voxels");
}
