//! What a left ventricle of 100 thousand vertices needs: processor time of its mesh, its model and its steps, and the memory at the peak.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "a bench that fails loudly")]

use cardiotwin::heart::{HeartModel, ModelSettings, Parameters};

mod hearts;

const EDGE_LENGTH_MM: f64 = 1.34;

/// The largest resident set so far, where Linux tells it.
fn peak_memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().find_map(|line| line.strip_prefix("VmHWM:")).map_or_else(|| "unknown".to_owned(), |peak| peak.trim().to_owned())
}

fn main() {
    let start_s = hearts::processor_s();
    let anatomy = hearts::left_ventricle(EDGE_LENGTH_MM);
    let meshed_s = hearts::processor_s();
    println!("{} vertices: mesh and anatomy {:.1} s, peak {}", anatomy.mesh.vertex_count(), meshed_s - start_s, peak_memory());
    let model = HeartModel::new(anatomy, Parameters::default(), ModelSettings::default()).unwrap();
    println!("model {:.1} s, peak {}", hearts::processor_s() - meshed_s, peak_memory());
    let (mut workspace, mut state) = (model.workspace(), model.initial_state(0.0));
    for _ in 0..3 {
        let start_s = hearts::processor_s();
        state = model.step(&state, &[], &mut workspace).unwrap().state;
        println!("step {:.2} s, peak {}", hearts::processor_s() - start_s, peak_memory());
    }
}
