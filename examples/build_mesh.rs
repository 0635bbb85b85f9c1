//! From a label map to a heart's mesh in a file: `cargo run --release --example build_mesh -- labels.nii.gz heart.vtu`; without arguments labels are made up.

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use std::error::Error;
use std::path::PathBuf;

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{AnatomySettings, build_from_fields};
use cardiotwin::image::{FieldOptions, Grid, HeartCodes, LabelMap, heart_fields, read_label_map};
use cardiotwin::mesh::MeshQuality;
use cardiotwin::mesh::io::{FieldValues, write_mesh_file};
use nalgebra::Vector3;

pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let mut paths = std::env::args().skip(1).filter(|argument| argument.contains(".nii") || argument.contains(".vt")).map(PathBuf::from);
    let labels = paths.next().map_or_else(drawn, |path| Ok(read_label_map(&path)?))?;
    let file = paths.next().unwrap_or_else(|| std::env::temp_dir().join("cardiotwin_example_heart.vtu"));

    // Labels become distances to smooth surfaces, whatever the slices' thickness, and those a mesh.
    let fields = heart_fields(&labels, &HeartCodes::left(1, 2), &FieldOptions::default())?;
    let anatomy = build_from_fields(&fields, &MesherSettings::with_edge_length_mm(6.0), &AnatomySettings::default())?;

    let fibres: Vec<Vector3<f64>> = anatomy.fibre_axes.iter().map(|axes| axes.column(0).into_owned()).collect();
    write_mesh_file(&file, &anatomy.mesh, &anatomy.surface, &[], &[("fibre", FieldValues::Vectors(&fibres))])?;
    let quality = MeshQuality::of(&anatomy.mesh);
    let (_, cavity) = &anatomy.cavities[0];
    let cavity_ml = cavity.volume_mm3(anatomy.mesh.vertices_mm()) / 1000.0;
    println!("{}: {} tetrahedra, cavity {cavity_ml:.1} mL, {quality:?}", file.display(), anatomy.mesh.tetrahedra().len());
    Ok(())
}

/// A cup of wall (2) around blood (1), in slices of 8 mm.
fn drawn() -> Result<LabelMap, Box<dyn Error>> {
    let grid = Grid::axis_aligned([50, 50, 11], Vector3::zeros(), Vector3::new(2.0, 2.0, 8.0))?;
    let code = |flat: usize| {
        let [i, j, k] = grid.voxel_of(flat);
        let (r_mm, z_mm) = (2.0 * (i as f64 - 24.5).hypot(j as f64 - 24.5), 70.0 - 8.0 * k as f64);
        match (z_mm, (r_mm / 24.0).hypot(z_mm / 56.0), (r_mm / 34.0).hypot(z_mm / 66.0)) {
            (z_mm, ..) if z_mm < -10.0 => 0,
            (_, inner, _) if inner < 1.0 => 1,
            (_, _, outer) if outer < 1.0 => 2,
            _ => 0,
        }
    };
    Ok(LabelMap::new(grid.clone(), (0..grid.voxel_count()).map(code).collect())?)
}
