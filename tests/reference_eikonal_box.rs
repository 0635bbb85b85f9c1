//! Activation times against those of another code, an anisotropic fast iterative method (`eikonal_box` of the shared data).
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test fails by panicking, and says why it had nothing to do")]

use std::path::Path;

use cardiotwin::electrophysiology::{ActivationSettings, Conduction, Onset, activate_with};
use cardiotwin::mesh::io::{Numbering, read_mesh_file};
use nalgebra::Vector3;

/// The same first-order problem on the same mesh has one answer; this is the answer of a code that shares nothing with ours.
#[test]
fn times_agree_with_a_fast_iterative_method() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/eikonal_box");
    if !folder.exists() {
        eprintln!("{} is not here; nothing to compare with", folder.display());
        return;
    }
    let file = |name: &str| read_mesh_file(&folder.join(name)).unwrap();
    let (input, theirs) = (file("box.vtu"), file("result.vtu"));
    let angles = |name: &str| input.tetrahedron_fields[name].values.iter();
    let fibre = |(phi, theta): (&f64, &f64)| Vector3::new(phi.cos() * theta.sin(), phi.sin() * theta.sin(), theta.cos());
    let fibres: Vec<_> = angles("Phi").zip(angles("Theta")).map(fibre).collect();
    let conduction = Conduction::new(vec![3.0; fibres.len()], 1.0 / 9.0, fibres).unwrap();
    let mesh = input.to_tet_mesh(1.0, Numbering::Free).unwrap();
    let seeds = std::fs::read_to_string(folder.join("seeds.txt")).unwrap();
    for (set, line) in seeds.lines().enumerate() {
        let onsets: Vec<_> = line.split_whitespace().map(|vertex| Onset { vertex: vertex.parse().unwrap(), time_s: 0.0 }).collect();
        let map = activate_with(&mesh, &conduction, &onsets, &ActivationSettings { ray_length_mm: Some(0.0) }).unwrap();
        let theirs = &theirs.point_fields[&format!("seed{}", set + 1)].values;
        let away = theirs.iter().zip(map.times_s()).filter(|(theirs, _)| **theirs > 10.0);
        let mut deviations: Vec<f64> = away.map(|(theirs, ours)| (ours / theirs - 1.0).abs()).collect();
        deviations.sort_by(f64::total_cmp);
        let at = |share: f64| deviations[(share * (deviations.len() - 1) as f64) as usize];
        assert!(at(0.5) < 1e-3 && at(0.95) < 1e-2, "seed set {}: median {}, 95th percentile {}", set + 1, at(0.5), at(0.95));
    }
}
