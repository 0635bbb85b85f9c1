//! Our part of `eikonal.py`: writes a box for the peers to solve, times ours on it, and leaves our activation times beside it.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a script's helper: it fails loudly and prints its figures")]

use std::path::Path;

use cardiotwin::electrophysiology::{ActivationSettings, Conduction, Onset, activate_with};
use nalgebra::Vector3;

#[path = "../../tests/meshes/mod.rs"]
mod meshes;

const SPEED_MM_PER_S: f64 = 600.0;
const RATIO: f64 = 1.0 / 9.0;

/// Arguments: folder, cells a side, turn of the fibres through the box (degrees), repeats.
fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, cells, turn_deg, repeats] = arguments.as_slice() else { panic_with_usage() };
    let folder = Path::new(folder);
    let (cells, turn_deg, repeats): (usize, f64, usize) = (cells.parse().unwrap(), turn_deg.parse().unwrap(), repeats.parse().unwrap());
    let (mesh, _) = meshes::block(Vector3::repeat(20.0), [cells; 3]);
    let fibre = |t: usize| {
        let depth = mesh.corners_mm(t).iter().map(|p| p.x).sum::<f64>() / 80.0;
        let angle = (0.5 * turn_deg - turn_deg * depth).to_radians() + 0.6;
        Vector3::new(0.3, angle.cos(), angle.sin()).normalize()
    };
    let count = mesh.tetrahedron_count();
    let conduction = Conduction::new(vec![SPEED_MM_PER_S; count], RATIO, (0..count).map(fibre).collect()).unwrap();

    let write = |name: &str, numbers: &mut dyn Iterator<Item = f64>| {
        std::fs::write(folder.join(name), numbers.flat_map(f64::to_le_bytes).collect::<Vec<u8>>()).unwrap();
    };
    write("points.f64", &mut mesh.vertices_mm().iter().flat_map(|p| [p.x, p.y, p.z]));
    write("fibres.f64", &mut conduction.fibres().iter().flat_map(|p| [p.x, p.y, p.z]));
    let corners = mesh.tetrahedra().iter().flatten().flat_map(|&v| i32::try_from(v).unwrap().to_le_bytes());
    std::fs::write(folder.join("tetrahedra.i32"), corners.collect::<Vec<u8>>()).unwrap();
    std::fs::write(folder.join("case.txt"), format!("{SPEED_MM_PER_S} {RATIO} 0\n")).unwrap();

    let onsets = [Onset { vertex: 0, time_s: 0.0 }];
    for (name, ray_length_mm) in [("march", Some(0.0)), ("rays", None)] {
        for repeat in 0..repeats {
            let begin_s = processor_s();
            let map = activate_with(&mesh, &conduction, &onsets, &ActivationSettings { ray_length_mm }).unwrap();
            println!("{name} {:.6}", processor_s() - begin_s);
            if repeat == 0 {
                write(&format!("{name}.f64"), &mut map.times_s().iter().copied());
            }
        }
    }
}

/// Time this thread has had a processor, as Linux counts it.
fn processor_s() -> f64 {
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    statistics.split(' ').next().unwrap().parse::<f64>().unwrap() * 1e-9
}

fn panic_with_usage() -> ! {
    println!("usage: eikonal_case FOLDER CELLS TURN_DEG REPEATS");
    std::process::exit(2)
}
