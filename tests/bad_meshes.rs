//! Meshes that are no heart, through the binary: each is told what is wrong, in which file, where, and what to do about it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may stop at the first surprise")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{AnatomySettings, IdealisedBiventricle};
use cardiotwin::mesh::io::{FieldValues, MeshFile, read_mesh_file, write_mesh_file};
use nalgebra::Vector3;

/// A coarse biventricle as a file of this name, with a field of fibres.
fn good(folder: &Path, name: &str) -> PathBuf {
    let heart = IdealisedBiventricle::default();
    let anatomy = heart.build(&MesherSettings::with_edge_length_mm(12.0), &AnatomySettings::default()).unwrap();
    let fibres: Vec<Vector3<f64>> = anatomy.fibre_axes.iter().map(|axes| axes.column(0).into_owned()).collect();
    let path = folder.join(name);
    write_mesh_file(&path, &anatomy.mesh, &anatomy.surface, &[], &[("fibre", FieldValues::Vectors(&fibres))]).unwrap();
    path
}

fn write_tables(folder: &Path, file: &MeshFile) {
    let rows = |table: &mut dyn Iterator<Item = String>| table.fold(String::new(), |text, row| text + &row + "\n");
    let tags = &file.triangle_fields["surface_tag"].values;
    let vertices = rows(&mut file.points.iter().map(|p| format!("{} {} {}", p.x, p.y, p.z)));
    let tetrahedra = rows(&mut file.tetrahedra.iter().map(|[a, b, c, d]| format!("{a} {b} {c} {d}")));
    let surface = rows(&mut file.triangles.iter().zip(tags).map(|([a, b, c], tag)| format!("{a} {b} {c} {tag}")));
    for (name, text) in [("vertices.txt", vertices), ("tetrahedra.txt", tetrahedra), ("surface.txt", surface)] {
        std::fs::write(folder.join(name), text).unwrap();
    }
}

/// Runs a study of `[anatomy]` with these keys; exit code and stderr.
fn run(folder: &Path, anatomy: &str) -> (i32, String) {
    let study = folder.join("study.toml");
    std::fs::write(&study, format!("kind = \"simulate\"\n[anatomy]\n{anatomy}\n[output]\nmeshes = false\nfigures = false\n")).unwrap();
    let output = Command::cargo_bin("cardiotwin").unwrap().arg("run").arg(&study).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

const TABLES: &str = "[anatomy.mesh_tables]\nvertices = \"vertices.txt\"\ntetrahedra = \"tetrahedra.txt\"\nsurface = \"surface.txt\"\n";

/// The first triangle with this code none of whose vertices another surface shares.
fn inner_triangle(file: &MeshFile, code: f64) -> usize {
    let tags = &file.triangle_fields["surface_tag"].values;
    let is_inner = |triangle: &[usize; 3]| {
        file.triangles.iter().zip(tags).all(|(other, &tag)| tag == code || !triangle.iter().any(|vertex| other.contains(vertex)))
    };
    (0..file.triangles.len()).find(|&t| tags[t] == code && is_inner(&file.triangles[t])).unwrap()
}

type Damage = fn(&mut MeshFile);

#[test]
fn a_mesh_that_is_no_heart_is_told_what_where_and_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let whole = read_mesh_file(&good(folder.path(), "heart.vtk")).unwrap();
    let cases: [(&str, Damage, &[&str]); 12] = [
        ("", |f| f.tetrahedra[17].swap(0, 1), &["tetrahedron 17 at (", "inverted", "remesh there"]),
        ("numbering = \"free\"", |f| f.points[f.tetrahedra[17][0]] += Vector3::repeat(40.0), &["overlap", "one is inverted, remesh"]),
        ("", |f| f.tetrahedra.push(f.tetrahedra[3]), &["tetrahedra 3 and ", "have the same vertices; remove one"]),
        ("", |f| f.points.push(Vector3::zeros()), &["at (0.0, 0.0, 0.0) mm belongs to no tetrahedron; remove unused vertices"]),
        ("", |f| f.points.iter_mut().for_each(|p| *p *= 1e-3), &["is the file in metres? give its unit"]),
        ("unit = \"m\"", |_| {}, &["a heart is 10 to 1000 mm", "give its unit"]),
        ("", |f| f.points[5].y = f64::NAN, &["vertex 5 has a coordinate that is not a finite number; export the mesh anew"]),
        ("", |f| f.tetrahedra[9][2] = 100_000, &["tetrahedron 9 names vertex 100000, but there are only", "count from 1?"]),
        ("code_epicardium = 41", |_| {}, &["surface code 40 of the boundary triangle at (", "stands for no surface", "say which surface"]),
        (
            "",
            |f| {
                let hole = inner_triangle(f, 30.0);
                f.triangle_fields.get_mut("surface_tag").unwrap().values[hole] = 40.0;
            },
            &["the rim of EndocardiumLv is not one closed loop but 2, one through vertex", "close the hole, or mend the surface tags"],
        ),
        (
            "",
            |f| {
                let values = &mut f.triangle_fields.get_mut("surface_tag").unwrap().values;
                values.iter_mut().filter(|tag| **tag == 30.0).for_each(|tag| *tag = 40.0);
            },
            &["no triangle is tagged EndocardiumLv; check the surface tags"],
        ),
        ("fibre_field = \"fibres\"", |_| {}, &["have no field \"fibres\" of 3 component(s)", "name one of them"]),
    ];
    let mut report = String::new();
    for (keys, damage, expected) in cases {
        let mut file = whole.clone();
        damage(&mut file);
        write_tables(folder.path(), &file);
        let (code, message) = run(folder.path(), &format!("{keys}\n{TABLES}"));
        for words in expected.iter().chain(&["vertices.txt cannot be used: "]) {
            if code != 1 || !message.contains(words) {
                writeln!(report, "`{words}` is missing in ({code}): {message}").unwrap();
            }
        }
    }
    assert!(report.is_empty(), "{report}");
}

#[test]
fn a_surface_with_a_gap_and_files_cut_short_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = read_mesh_file(&good(folder.path(), "heart.vtk")).unwrap();
    let missing = inner_triangle(&file, 40.0);
    file.triangles.remove(missing);
    file.triangle_fields.get_mut("surface_tag").unwrap().values.remove(missing);
    write_tables(folder.path(), &file);
    let (code, message) = run(folder.path(), TABLES);
    assert!(code == 1 && message.contains("is not among the tagged triangles of the file; tag the whole boundary"), "{message}");
    for name in ["heart.vtu", "heart.vtk", "heart.msh"] {
        let path = good(folder.path(), name);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 3]).unwrap();
        let (code, message) = run(folder.path(), &format!("mesh = \"{name}\""));
        assert!(code == 1 && message.contains(&format!("{name} cannot be used: ")), "{message}");
        assert!(message.contains("truncated") || message.contains("ends too early"), "{message}");
    }
}

/// Whatever the format, the same heart beats, with the file's own fibres.
#[test]
fn a_mesh_made_elsewhere_beats_whatever_its_format() {
    let folder = tempfile::tempdir().unwrap();
    let mut summaries = vec![];
    for name in ["heart.vtu", "heart.vtk", "heart.msh"] {
        good(folder.path(), name);
        let (code, message) = run(folder.path(), &format!("mesh = \"{name}\"\nfibre_field = \"fibre\""));
        assert_eq!(code, 0, "{message}");
        let summary: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(folder.path().join("results/summary.json")).unwrap()).unwrap();
        summaries.push([summary["ejection_fraction_lv"].clone(), summary["pressure_peak_rv_mmhg"].clone()]);
    }
    assert!(summaries[0] == summaries[1] && summaries[1] == summaries[2], "{summaries:?}");
    assert!(summaries[0][0].as_f64().is_some_and(|fraction| (0.2..0.8).contains(&fraction)), "{summaries:?}");
}
