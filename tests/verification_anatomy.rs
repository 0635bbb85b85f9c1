//! The mesher and the anatomy against closed forms, over random shapes, and on a patient's labels.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may stop at the first surprise")]

use std::collections::BTreeSet;
use std::path::Path;

use cardiotwin::anatomy::mesher::{MesherSettings, WallShape, mesh_inside, mesh_wall};
use cardiotwin::anatomy::{AnatomySettings, FibreRule, IdealisedBiventricle, Region, Ventricle, build_from_fields, complete_anatomy};
use cardiotwin::image::{FieldOptions, HeartCodes, heart_fields, read_label_map};
use cardiotwin::mesh::io::{Numbering, TableFiles, TagCodes, read_mesh_tables};
use cardiotwin::mesh::{Cavity, MeshError, MeshQuality, SurfaceTag, TaggedSurface, TetMesh};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A smooth random function of a position: a few waves of the given length, mm.
fn waves(random: &mut ChaCha8Rng, length_mm: f64) -> impl Fn(&Vector3<f64>) -> f64 + Sync + use<> {
    let mut draw = |scale: f64| Vector3::from_fn(|_, _| random.random_range(-scale..scale));
    let waves: Vec<(Vector3<f64>, f64)> =
        (0..6).map(|_| (draw(1.0).normalize() * (std::f64::consts::TAU / length_mm), draw(3.0).x)).collect();
    move |p| waves.iter().map(|(wave, phase)| (wave.dot(p) + phase).sin()).sum::<f64>()
}

fn euler_characteristic(triangles: &[[usize; 3]]) -> i64 {
    let vertices: BTreeSet<usize> = triangles.iter().flatten().copied().collect();
    let edges: BTreeSet<[usize; 2]> =
        triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).map(|[a, b]| [a.min(b), a.max(b)]).collect();
    vertices.len() as i64 - edges.len() as i64 + triangles.len() as i64
}

/// [Labelle2007] proves 10.78° for its thresholds; nothing is optimised here.
#[test]
fn stuffing_keeps_its_angle_bound_on_smooth_random_shapes() {
    let mut least_deg = f64::INFINITY;
    for seed in 0..12 {
        let wave = waves(&mut ChaCha8Rng::seed_from_u64(seed), 20.0);
        let shape = |p: &Vector3<f64>| (p.norm() - 18.0).max(-0.2 - wave(p)).max(p.norm() - 17.0);
        let settings = MesherSettings { edge_length_mm: 1.1, optimisation_passes: 0 };
        let mesh = mesh_inside(&shape, &[Vector3::repeat(-18.0), Vector3::repeat(18.0)], &settings).unwrap();
        least_deg = least_deg.min(MeshQuality::of(&mesh).dihedral_least_deg);
    }
    assert!(least_deg > 10.78, "{least_deg}");
}

/// A ball's volume error is that of a polyhedron with its corners on the sphere: second order in the edge.
#[test]
fn volume_of_a_spherical_shell_converges_at_second_order() {
    let (inner, outer) = (20.0, 30.0);
    let shell = |p: &Vector3<f64>| (p.norm() - outer).max(inner - p.norm());
    let exact = 4.0 / 3.0 * std::f64::consts::PI * (outer.powi(3) - inner.powi(3));
    let errors = [6.0, 3.0, 1.5].map(|edge_length_mm| {
        let bounds = [Vector3::repeat(-31.0), Vector3::repeat(31.0)];
        let mesh = mesh_inside(&shell, &bounds, &MesherSettings::with_edge_length_mm(edge_length_mm)).unwrap();
        let triangles = mesh.boundary_triangles();
        assert_eq!(euler_characteristic(&triangles), 4, "two spheres");
        (mesh.total_volume_mm3() / exact - 1.0).abs()
    });
    assert!(errors[1] < errors[0] / 3.2 && errors[2] < errors[1] / 3.2, "{errors:?}");
}

/// A ventricle with a bumpy, tilted, unevenly thick wall.
fn mesh_random_ventricle(seed: u64) -> (f64, Vector3<f64>, Vector3<f64>, TetMesh, TaggedSurface) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let bumps = waves(&mut random, 40.0);
    let (radius, length, wall) = (random.random_range(18.0..32.0), random.random_range(40.0..60.0), random.random_range(2.0..10.0));
    let bump = random.random_range(0.0..0.8);
    let shift = Vector3::from_fn(|_, _| random.random_range(-0.3..0.3)) * wall;
    let ellipsoid = move |p: &Vector3<f64>, more: f64| {
        let (r, l) = (radius + more, length + more);
        r * (((p.x / r).powi(2) + (p.y / r).powi(2) + (p.z / l).powi(2)).sqrt() - 1.0)
    };
    let cavity = &move |p: &Vector3<f64>| ellipsoid(&(p - shift), 0.0) + bump * bumps(p);
    let epicardium = move |p: &Vector3<f64>| ellipsoid(p, wall).min(cavity(p) - 2.0);
    let normal = Vector3::new(random.random_range(-0.3..0.3), random.random_range(-0.3..0.3), 1.0).normalize();
    let point = Vector3::new(0.0, 0.0, random.random_range(0.0..15.0));
    let edge_length_mm = random.random_range(4.0..8.0);
    let shape = WallShape {
        epicardium: &epicardium,
        cavities: vec![(Ventricle::Left, cavity)],
        base_point_mm: point,
        base_normal: normal,
        bounds_mm: [Vector3::repeat(-75.0), Vector3::repeat(75.0)],
    };
    let (mesh, surface) =
        mesh_wall(&shape, &MesherSettings::with_edge_length_mm(edge_length_mm)).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
    (wall / edge_length_mm, point, normal, mesh, surface)
}

#[test]
fn random_ventricles_are_manifold_tagged_and_well_shaped() {
    let mut least_deg = f64::INFINITY;
    for seed in 0..12 {
        let (elements, point, normal, mesh, surface) = mesh_random_ventricle(seed);
        assert_eq!(euler_characteristic(surface.triangles()), 2, "seed {seed}: the boundary of a cup is one sphere");
        for (tag, expected) in [(SurfaceTag::EndocardiumLv, 1), (SurfaceTag::Epicardium, 1), (SurfaceTag::Base, 0)] {
            let patch: Vec<[usize; 3]> = surface.triangles_with(tag).collect();
            assert_eq!(euler_characteristic(&patch), expected, "seed {seed}: {tag:?} is a disc or a ring");
        }
        for vertex in surface.vertices_with(SurfaceTag::Base) {
            assert!(normal.dot(&(mesh.vertices_mm()[vertex] - point)).abs() < 1e-9, "seed {seed}: the base is flat");
        }
        let quality = MeshQuality::of(&mesh);
        least_deg = least_deg.min(quality.dihedral_least_deg);
        // Walls of less than an edge length are beyond the bound; they must only not be inverted, which the mesh itself checks.
        assert!(quality.dihedral_least_deg > if elements > 1.5 { 20.0 } else { 2.0 }, "seed {seed}, {elements}: {quality:?}");
    }
    assert!(least_deg > 2.0, "{least_deg}");
}

/// Blood and wall of the idealised biventricle by midpoint sums over slices and rows, in each row of which the ellipsoids are intervals.
fn biventricle_volumes_mm3(heart: &IdealisedBiventricle) -> [f64; 3] {
    let interval = |centre: f64, [a, b, c]: [f64; 3], y: f64, z: f64| {
        let half = a * (1.0 - (y / b).powi(2) - (z / c).powi(2)).max(0.0).sqrt();
        [centre - half, centre + half]
    };
    let length = |[low, high]: [f64; 2]| (high - low).max(0.0);
    let overlap = |[a, b]: [f64; 2], [c, d]: [f64; 2]| length([a.max(c), b.min(d)]);
    let step_mm = 0.2;
    let mut volumes_mm3 = [0.0; 3];
    let rows = |low: f64, high: f64| {
        let count = ((high - low) / step_mm).round();
        (0..count as usize).map(move |i| low + (high - low) * (i as f64 + 0.5) / count)
    };
    for z in rows(-70.0, heart.base_height_mm) {
        for y in rows(-45.0, 45.0) {
            let (r, l, w) = (heart.lv_radius_mm, heart.lv_length_mm, heart.lv_wall_mm);
            let left = interval(0.0, [r, r, l], y, z);
            let left_outside = interval(0.0, [r + w, r + w, l + w], y, z);
            let radii = [heart.rv_width_mm, heart.rv_depth_mm, heart.rv_length_mm];
            let right = interval(heart.rv_offset_mm, radii, y, z);
            let right_outside = interval(heart.rv_offset_mm, radii.map(|radius| radius + heart.rv_wall_mm), y, z);
            let right_blood = length(right) - overlap(right, left_outside);
            let heart_and_blood = length(left_outside) + length(right_outside) - overlap(left_outside, right_outside);
            for (volume, row) in volumes_mm3.iter_mut().zip([length(left), right_blood, heart_and_blood - length(left) - right_blood]) {
                *volume += row * step_mm * step_mm;
            }
        }
    }
    volumes_mm3
}

#[test]
fn volumes_of_the_idealised_biventricle_converge_at_second_order() {
    // Hardly rounded, the ventricles are ellipsoids throughout.
    let heart = IdealisedBiventricle { rounding_mm: 0.5, ..IdealisedBiventricle::default() };
    let exact = biventricle_volumes_mm3(&heart);
    let t: f64 = heart.base_height_mm / heart.lv_length_mm;
    let closed_form = std::f64::consts::PI * heart.lv_radius_mm.powi(2) * heart.lv_length_mm * (2.0 / 3.0 + t - t.powi(3) / 3.0);
    assert!((exact[0] / closed_form - 1.0).abs() < 1e-4, "{exact:?} {closed_form}");
    let errors = [8.0, 4.0].map(|edge_length_mm| {
        let anatomy = heart.build(&MesherSettings::with_edge_length_mm(edge_length_mm), &AnatomySettings::default()).unwrap();
        let blood = |i: usize| anatomy.cavities[i].1.volume_mm3(anatomy.mesh.vertices_mm());
        let found = [blood(0), blood(1), anatomy.mesh.total_volume_mm3()];
        [0, 1, 2].map(|i| (found[i] / exact[i] - 1.0).abs())
    });
    assert!(errors[0].iter().all(|error| *error < 0.08) && errors[1].iter().all(|error| *error < 0.015), "{errors:?}");
    assert!((0..3).all(|i| errors[1][i] < errors[0][i] / 3.0), "{errors:?}");
}

/// A right-ventricular wall of 3 mm, in tetrahedra up to four times as long, wherever the heart lies: never perforated, pinched or inverted.
#[test]
fn thin_right_ventricles_are_meshed_at_any_edge_length() {
    let mut least_deg = f64::INFINITY;
    for (edge_length_mm, long_axis) in [
        (12.0, Vector3::z()),
        (10.0, Vector3::new(0.6, -0.6, 0.5)),
        (8.0, Vector3::z()),
        (6.5, Vector3::new(-0.3, 0.2, 1.0)),
        (5.0, Vector3::z()),
        (4.0, Vector3::new(0.5, 0.1, 1.0)),
    ] {
        let heart = IdealisedBiventricle { long_axis, ..IdealisedBiventricle::default() };
        let anatomy = heart.build(&MesherSettings::with_edge_length_mm(edge_length_mm), &AnatomySettings::default()).unwrap();
        for (tag, expected) in
            [(SurfaceTag::EndocardiumLv, 1), (SurfaceTag::EndocardiumRv, 1), (SurfaceTag::Epicardium, 1), (SurfaceTag::Base, -1)]
        {
            let patch: Vec<[usize; 3]> = anatomy.surface.triangles_with(tag).collect();
            assert_eq!(euler_characteristic(&patch), expected, "{edge_length_mm} mm: {tag:?} is a disc, the base one with two holes");
        }
        let quality = MeshQuality::of(&anatomy.mesh);
        assert!(quality.dihedral_percentile_1_deg > 11.0 && quality.dihedral_greatest_deg < 172.0, "{edge_length_mm} mm: {quality:?}");
        least_deg = least_deg.min(quality.dihedral_least_deg);
    }
    assert!(least_deg > 8.0, "{least_deg}");
}

/// Labels of 1.4 × 1.4 × 10 mm. A cavity of 246 mL and a wall of 136 mL by counting voxels; the mesh must hold them within 2 %.
#[test]
fn a_patient_becomes_a_mesh_of_the_labels_volumes() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/sunnybrook_SCD0000201/labels_ED_crop.nii.gz");
    if !path.exists() {
        return;
    }
    let labels = read_label_map(&path).unwrap();
    let fields = heart_fields(&labels, &HeartCodes::left(1, 2), &FieldOptions::default()).unwrap();
    let mesher = MesherSettings::with_edge_length_mm(6.5);
    let anatomy = build_from_fields(&fields, &mesher, &AnatomySettings::default()).unwrap();
    let cavity = Cavity::new(&anatomy.surface, SurfaceTag::EndocardiumLv).unwrap();
    let cavity_ml = cavity.volume_mm3(anatomy.mesh.vertices_mm()) / 1e3;
    let quality = MeshQuality::of(&anatomy.mesh);
    assert!((cavity_ml / fields.report.labelled_cavity_lv_ml - 1.0).abs() < 0.02, "{cavity_ml} mL");
    assert!((quality.volume_mm3 / 1e3 / fields.report.labelled_wall_ml - 1.0).abs() < 0.02, "{quality:?}");
    assert!(quality.dihedral_least_deg > 12.0 && quality.dihedral_percentile_1_deg > 20.0, "{quality:?}");
    assert!((2000..4000).contains(&quality.vertex_count), "{quality:?}");
    assert!((anatomy.axes.long_axis - fields.long_axis).norm() < 0.5, "{:?} {:?}", anatomy.axes, fields.long_axis);
    assert!((1..=17).all(|segment| anatomy.aha_segments.contains(&segment)));
}

/// The biventricle of the cardiac elastodynamics benchmark: plain text, in metres, with fibres at its nodes.
#[test]
fn the_benchmark_biventricle_becomes_an_anatomy_with_its_own_fibres() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/benchmark_biventricle");
    if !folder.exists() {
        return;
    }
    let file = read_mesh_tables(&TableFiles {
        vertices: folder.join("nodes_xyz_m.txt"),
        tetrahedra: folder.join("tets_0based.txt"),
        surface: folder.join("boundary_tris_0based_and_tag.txt"),
        fibres: Some(folder.join("fibre_sheet_normal_nodal.txt")),
    })
    .unwrap();
    assert!(matches!(file.to_tet_mesh(1.0, Numbering::Free), Err(MeshError::ImplausibleSize { .. })), "metres are noticed");
    assert!(matches!(file.to_tet_mesh(1000.0, Numbering::Oriented), Err(MeshError::InvertedTetrahedron { .. })), "so is its numbering");
    let mesh = file.to_tet_mesh(1000.0, Numbering::Free).unwrap();
    assert_eq!((mesh.vertex_count(), mesh.tetrahedron_count()), (11_444, 45_304));
    let surface = file.to_tagged_surface(&mesh, file.surface_field(), &TagCodes::default()).unwrap();
    let anatomy = complete_anatomy(mesh, surface, &AnatomySettings::default()).unwrap();

    // The same triangles closed over the mean of their rims, summed in Python.
    let volumes_ml: Vec<f64> = anatomy.cavities.iter().map(|(_, c)| c.volume_mm3(anatomy.mesh.vertices_mm()) / 1e3).collect();
    assert!((volumes_ml[0] - 90.078).abs() < 1e-3 && (volumes_ml[1] - 96.485).abs() < 1e-3, "{volumes_ml:?}");
    let share = |region: Region| {
        let of_region = (0..anatomy.regions.len()).filter(|&t| anatomy.regions[t] == region);
        of_region.map(|t| anatomy.mesh.volume_mm3(t)).sum::<f64>() / anatomy.mesh.total_volume_mm3()
    };
    let shares = [Region::FreeWallLv, Region::Septum, Region::FreeWallRv].map(share);
    assert!(shares[0] > 0.35 && (0.1..0.35).contains(&shares[1]) && (0.1..0.4).contains(&shares[2]), "{shares:?}");
    assert!((1..=17).all(|segment| anatomy.aha_segments.contains(&segment)));

    // Its fibres are another code's, by a rule of its own from 60° to −60°: half of the LV lies within 15° of ours.
    let rule = FibreRule { helix_endocardium_deg: 60.0, helix_epicardium_deg: -60.0 };
    let (mesh, surface) = (anatomy.mesh.clone(), anatomy.surface.clone());
    let by_rule = complete_anatomy(mesh, surface, &AnatomySettings { fibres: rule, ..AnatomySettings::default() }).unwrap();
    let own = anatomy.with_fibres(&file.directions("fibre").unwrap(), Some(&file.directions("sheet").unwrap())).unwrap();
    let mut angles_deg: Vec<f64> = (0..own.regions.len())
        .filter(|&t| own.regions[t] == Region::FreeWallLv)
        .map(|t| by_rule.fibre_axes[t].column(0).dot(&own.fibre_axes[t].column(0)).abs().min(1.0).acos().to_degrees())
        .collect();
    angles_deg.sort_by(f64::total_cmp);
    assert!(angles_deg[angles_deg.len() / 2] < 15.0, "{}", angles_deg[angles_deg.len() / 2]);
}

/// The free wall of the right ventricle takes its own angles, read against its own local axes, and nothing else changes.
#[test]
fn the_right_free_wall_may_have_fibres_of_its_own() {
    let mesher = MesherSettings::with_edge_length_mm(8.0);
    let own = FibreRule { helix_endocardium_deg: 60.0, helix_epicardium_deg: -30.0 };
    let build = |fibres_rv| IdealisedBiventricle::default().build(&mesher, &AnatomySettings { fibres_rv, ..AnatomySettings::default() });
    let (common, apart) = (build(None).unwrap(), build(Some(own)).unwrap());
    for (t, (axes, before)) in apart.fibre_axes.iter().zip(&common.fibre_axes).enumerate() {
        if apart.regions[t] != Region::FreeWallRv {
            assert_eq!(axes, before);
            continue;
        }
        let [along, up] = [0, 1].map(|axis| axes.column(0).dot(&apart.heart_axes[t].column(axis)));
        let [common_along, common_up] = [0, 1].map(|axis| before.column(0).dot(&apart.heart_axes[t].column(axis)));
        // Depth is what the common rule, 80° to −80°, makes of its angle.
        let depth = (80.0 - common_up.atan2(common_along).to_degrees()) / 160.0;
        let expected_deg = 60.0 - 90.0 * depth;
        assert!((up.atan2(along).to_degrees() - expected_deg).abs() < 1e-6, "at depth {depth}");
    }
    let refused = build(Some(FibreRule { helix_endocardium_deg: 100.0, ..own }));
    assert!(refused.is_err());
}
