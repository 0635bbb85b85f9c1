//! The programs of `examples/` run.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a test may stop at the first surprise; examples show what they found"
)]

#[path = "../examples/build_mesh.rs"]
mod build_mesh;
#[path = "../examples/personalise.rs"]
mod personalise;
#[path = "../examples/read_cine.rs"]
mod read_cine;
#[path = "../examples/simulate_beat.rs"]
mod simulate_beat;

#[test]
fn a_beat_is_simulated() {
    simulate_beat::main().unwrap();
}

#[test]
fn a_cine_is_read() {
    read_cine::main().unwrap();
}

#[test]
fn a_mesh_is_built() {
    build_mesh::main().unwrap();
}

#[test]
fn a_patient_is_personalised() {
    personalise::main().unwrap();
}
