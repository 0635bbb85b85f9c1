//! Mesh files that meshio and VTK wrote, our own, and damaged ones.
//!
//! The files in `tests/mesh_files` hold the same two tetrahedra, six tagged triangles and fields, each in another format or encoding:
//! `meshio_*` by meshio 5.3.5, `vtk_*` by VTK 9, `gmsh_*` by Gmsh 4.15, `by_hand_41.msh` after its manual.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may stop at the first surprise")]

use std::path::{Path, PathBuf};

use cardiotwin::mesh::io::{FieldValues, MeshFile, Numbering, TagCodes, read_mesh_file, write_mesh_file};
use cardiotwin::mesh::{MeshError, SurfaceTag, TaggedSurface, TetMesh};
use nalgebra::Vector3;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;

fn fixtures() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/mesh_files");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn tag_field(path: &Path) -> &'static str {
    if path.extension().is_some_and(|ending| ending == "msh") { "physical" } else { "surface_tag" }
}

#[test]
fn every_program_and_encoding_gives_the_same_mesh() {
    let expected_points = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0], [7.5, 7.5, 7.5]].map(Vector3::from);
    assert!(fixtures().len() >= 17);
    for path in fixtures() {
        let file = read_mesh_file(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(file.points, expected_points, "{path:?}");
        assert_eq!(file.tetrahedra, [[0, 1, 2, 3], [1, 2, 3, 4]], "{path:?}");
        assert_eq!(file.triangles, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 4], [1, 3, 4], [2, 3, 4]], "{path:?}");
        let mesh = file.to_tet_mesh(1.0, Numbering::Oriented).unwrap();
        let surface = file.to_tagged_surface(&mesh, tag_field(&path), &TagCodes::default()).unwrap();
        let count = |tag| surface.triangles_with(tag).count();
        assert_eq!([SurfaceTag::EndocardiumLv, SurfaceTag::Epicardium, SurfaceTag::Base].map(count), [3, 2, 1], "{path:?}");
        if tag_field(&path) == "surface_tag" {
            assert_eq!(file.point_fields["depth"].values, [0.0, 0.25, 0.5, 0.75, 1.0], "{path:?}");
            let shift = file.point_fields["shift"].vectors().unwrap();
            assert!(shift.iter().zip(&file.points).all(|(s, p)| (s - p * 0.1).norm() < 1e-12), "{path:?}");
            assert_eq!(file.tetrahedron_fields["fibre"].vectors().unwrap(), [Vector3::x(), Vector3::y()], "{path:?}");
            assert_eq!(file.triangle_fields["surface_tag"].values, [30.0, 30.0, 30.0, 40.0, 40.0, 10.0], "{path:?}");
        }
    }
}

fn read_bytes(folder: &Path, ending: &str, bytes: &[u8]) -> Result<MeshFile, MeshError> {
    let path = folder.join(format!("damaged.{ending}"));
    std::fs::write(&path, bytes).unwrap();
    read_mesh_file(&path)
}

proptest! {
    /// A file that is cut short is refused, unless nothing but fields behind the cells is missing; damage may go unnoticed, but does not
    /// panic.
    #[test]
    fn damaged_files_are_refused_or_survived(which in any::<Index>(), cut in any::<Index>(), bytes_changed in vec(any::<(Index, u8)>(), 1..5)) {
        let folder = tempfile::tempdir().unwrap();
        let fixtures = fixtures();
        let path = which.get(&fixtures);
        let (mut bytes, whole) = (std::fs::read(path).unwrap(), read_mesh_file(path).unwrap());
        let ending = path.extension().unwrap().to_str().unwrap();
        match read_bytes(folder.path(), ending, &bytes[..cut.index(bytes.len())]) {
            Ok(cut) => prop_assert!(cut.points == whole.points && cut.tetrahedra == whole.tetrahedra && cut.triangles == whole.triangles),
            Err(error) => prop_assert!(error.to_string().contains("damaged"), "{}", error),
        }
        for (place, byte) in bytes_changed {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        if let Ok(file) = read_bytes(folder.path(), ending, &bytes) {
            for numbering in [Numbering::Oriented, Numbering::Free] {
                let mesh = file.to_tet_mesh(1.0, numbering);
                let _ = mesh.and_then(|mesh| file.to_tagged_surface(&mesh, file.surface_field(), &TagCodes::default()));
            }
            let _ = file.directions("fibre");
        }
    }
}

/// A block of tetrahedra large enough for several compressed blocks.
fn block(n: usize) -> (TetMesh, TaggedSurface) {
    let at = |i: usize, j: usize, k: usize| i + (n + 1) * (j + (n + 1) * k);
    let axis = |i: usize| i as f64 * 3.3;
    let mut points = vec![];
    let mut tetrahedra = vec![];
    for k in 0..=n {
        for j in 0..=n {
            points.extend((0..=n).map(|i| Vector3::new(axis(i), axis(j) / 3.0, -axis(k))));
        }
    }
    for (k, j, i) in (0..n * n * n).map(|c| (c / (n * n), c / n % n, c % n)) {
        for (even, [first, second]) in [[0, 1], [1, 2], [2, 0], [1, 0], [2, 1], [0, 2]].into_iter().enumerate() {
            let mut corner = [i, j, k];
            corner[first] += 1;
            let one = at(corner[0], corner[1], corner[2]);
            corner[second] += 1;
            let two = at(corner[0], corner[1], corner[2]);
            let (start, end) = (at(i, j, k), at(i + 1, j + 1, k + 1));
            // The last axis is turned round, and with it the order.
            tetrahedra.push(if even < 3 { [start, two, one, end] } else { [start, one, two, end] });
        }
    }
    let mesh = TetMesh::new(points, tetrahedra).unwrap();
    let tag = |t: &[usize; 3]| SurfaceTag::ALL[t.iter().sum::<usize>() % 4];
    let tags = mesh.boundary_triangles().iter().map(tag).collect();
    let surface = TaggedSurface::new(&mesh, tags).unwrap();
    (mesh, surface)
}

#[test]
fn what_is_written_is_read_back_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, surface) = block(12);
    let scalars: Vec<f64> = (0..mesh.vertex_count()).map(|v| (v as f64).sin() * 1e-7).collect();
    let vectors: Vec<Vector3<f64>> = (0..mesh.tetrahedron_count()).map(|t| Vector3::new((t as f64).sqrt(), -1.0, 1.0 / 3.0)).collect();
    let labels: Vec<i32> = (0..mesh.tetrahedron_count()).map(|t| t as i32 % 17 - 3).collect();
    for (ending, name) in [("vtu", "a <odd> & \"quoted\" name"), ("vtk", "a name of 5 words"), ("msh", "a $name of 5 words")] {
        let path = folder.path().join("block").with_extension(ending);
        let point_fields = [(name, FieldValues::Scalars(&scalars))];
        let cell_fields = [("fibre", FieldValues::Vectors(&vectors)), ("segment", FieldValues::Labels(&labels))];
        write_mesh_file(&path, &mesh, &surface, &point_fields, &cell_fields).unwrap();
        let file = read_mesh_file(&path).unwrap();
        let again = file.to_tet_mesh(1.0, Numbering::Oriented).unwrap();
        assert!(again == mesh, "{ending}");
        assert!(file.to_tagged_surface(&again, file.surface_field(), &TagCodes::default()).unwrap() == surface, "{ending}");
        assert_eq!(file.point_fields[name].values, scalars);
        assert_eq!(file.directions("fibre").unwrap(), vectors);
        assert!(file.tetrahedron_fields["segment"].values.iter().zip(&labels).all(|(read, &written)| *read == f64::from(written)));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().filter(|e| e.as_ref().unwrap().path().ends_with("partial")).count(), 0);
    }
}

/// Fibres of +57° meet fibres of −57° within one layer: at 0°, not at 90°, as the axes alone would have it. Signs by lot mean nothing.
#[test]
fn fibres_at_points_meet_the_way_their_signs_go() {
    let (mesh, surface) = block(5);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("block.vtu");
    let farthest_mm = mesh.vertices_mm().iter().map(|x| x.x).fold(0.0, f64::max);
    let is_last = |vertex: usize| mesh.vertices_mm()[vertex].x > 0.99 * farthest_mm;
    let angle = 57_f64.to_radians();
    let fibre = |vertex: usize| Vector3::new(0.0, angle.cos(), if is_last(vertex) { -angle.sin() } else { angle.sin() });
    let signed: Vec<Vector3<f64>> = (0..mesh.vertex_count()).map(fibre).collect();
    let by_lot: Vec<Vector3<f64>> = signed.iter().enumerate().map(|(v, f)| if v * v % 7 < 3 { -f } else { *f }).collect();
    let read = |directions: &[Vector3<f64>]| {
        write_mesh_file(&path, &mesh, &surface, &[("fibre", FieldValues::Vectors(directions))], &[]).unwrap();
        read_mesh_file(&path).unwrap().directions("fibre").unwrap()
    };
    for ((corners, vector), axis) in mesh.tetrahedra().iter().zip(read(&signed)).zip(read(&by_lot)) {
        let last = corners.iter().filter(|&&vertex| is_last(vertex)).count() as f64;
        let expected = Vector3::new(0.0, angle.cos(), angle.sin() * (1.0 - last / 2.0));
        assert!((vector - expected).norm() < 1e-12);
        let (up, along) = (axis.z.abs(), axis.y.abs());
        assert!(up > 0.8 * axis.norm() && along < 0.6 * axis.norm(), "{axis} with {last} corners turned");
    }
}

#[test]
fn what_is_wrong_is_named() {
    let (mesh, surface) = block(5);
    let short = [0.0; 3];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.vtu");
    let error = write_mesh_file(&path, &mesh, &surface, &[("depth", FieldValues::Scalars(&short))], &[]).unwrap_err();
    assert!(matches!(&error, MeshError::FieldLength { length: 3, expected: 216, .. }), "{error}");
    let unwritable = folder.path().join("no/such/folder.vtu");
    assert!(matches!(write_mesh_file(&unwritable, &mesh, &surface, &[], &[]), Err(MeshError::Unwritable { .. })));
    assert!(matches!(read_mesh_file(&path), Err(MeshError::Unreadable { .. })));
    write_mesh_file(&path, &mesh, &surface, &[], &[]).unwrap();
    let mut file = read_mesh_file(&path).unwrap();
    let metres = file.to_tet_mesh(1e-3, Numbering::Oriented).unwrap_err();
    assert!(matches!(metres, MeshError::ImplausibleSize { .. }), "{metres}");
    let field = file.to_tagged_surface(&mesh, "tags", &TagCodes::default()).unwrap_err();
    assert!(field.to_string().contains("surface_tag"), "{field}");
    let mut codes = TagCodes::default();
    codes.0.remove(&40);
    assert!(matches!(file.to_tagged_surface(&mesh, "surface_tag", &codes), Err(MeshError::UnknownTag { code: 40, .. })));
    file.triangles[7] = [0, 1, 2];
    assert!(matches!(file.to_tagged_surface(&mesh, "surface_tag", &TagCodes::default()), Err(MeshError::UntaggedTriangle { .. })));
    file.tetrahedra.iter_mut().for_each(|corners| corners.swap(0, 1));
    assert_eq!(file.to_tet_mesh(1.0, Numbering::Oriented).unwrap().tetrahedron_count(), mesh.tetrahedron_count());
    file.tetrahedra[4].swap(0, 1);
    assert!(matches!(file.to_tet_mesh(1.0, Numbering::Oriented), Err(MeshError::InvertedTetrahedron { .. })));
}

/// Another code's file, compressed in many blocks; the totals by VTK itself.
#[test]
fn the_eikonal_box_is_read_as_vtk_reads_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/eikonal_box/result.vtu");
    if !path.exists() {
        return;
    }
    let file = read_mesh_file(&path).unwrap();
    assert_eq!((file.points.len(), file.tetrahedra.len()), (35_937, 196_608));
    let corner_sum: usize = file.tetrahedra.iter().flatten().sum();
    assert_eq!(corner_sum, 14_130_610_176);
    let point_sum: Vector3<f64> = file.points.iter().sum();
    assert!((point_sum - Vector3::repeat(4_599_936.0)).norm() < 1e-6);
    for (name, sum) in
        [("seed1", 2_730_311.917_934), ("seed2", 2_059_622.843_973), ("seed3", 3_106_965.125_137), ("seed4", 3_609_458.805_903)]
    {
        assert!((file.point_fields[name].values.iter().sum::<f64>() - sum).abs() < 1e-3, "{name}");
    }
}
