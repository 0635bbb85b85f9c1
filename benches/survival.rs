//! Hearts of 1,500 to 100,000 vertices at the ends of their ranges: each beats, or ends in an error that says when and why; no number is none.
//!
//! `cargo bench --bench survival -- 1.5k 15k 100k` takes the sizes named (all without a name) and prints a row a heart: the first beat for up to
//! 15k vertices, contraction and the begin of ejection (0.25 s) beyond. The coarse end of it is a test, `tests/verification_beats.rs`.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "a bench that fails loudly")]

use std::ops::ControlFlow;
use std::sync::Arc;

use cardiotwin::anatomy::{Anatomy, Ventricle};
use cardiotwin::heart::{
    BeatObservables, HeartModel, ModelSettings, Parameter, Parameters, SimulationPlan, StepError, Trajectory, simulate,
};
use cardiotwin::mechanics::Kinematics;

mod hearts;

/// Name, edge length, and whether a whole beat is asked for.
const SIZES: [(&str, f64, bool); 5] =
    [("1.5k", 6.4, true), ("5k", 4.05, true), ("15k", 2.66, true), ("40k", 1.85, false), ("100k", 1.34, false)];

/// Stiffness (along, across) and peak contraction, kPa.
type Tissue = (f64, f64, f64);

/// What is usual, and the ends of the ranges.
const TISSUES: [Tissue; 5] =
    [(100.0, 60.0, 120.0), (30.0, 20.0, 80.0), (0.1, 0.1, 1000.0), (2000.0, 2000.0, 0.0), (2000.0, 2000.0, 1000.0)];

/// Step, APD and HP, s.
const TIMES: [[f64; 3]; 3] = [[0.005, 0.3, 0.8], [0.01, 0.2, 0.5], [0.01, 0.5, 1.5]];

/// The shortest step, with the shortest beat.
const SHORTEST: [f64; 3] = [0.0005, 0.2, 0.5];

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    for (name, edge_length_mm, is_whole) in SIZES {
        if !wanted.is_empty() && !wanted.iter().any(|other| other == name) {
            continue;
        }
        let anatomy = hearts::left_ventricle(edge_length_mm);
        println!("{} vertices", anatomy.mesh.vertex_count());
        let mut counts = (0, 0);
        for kinematics in [Kinematics::Linear, Kinematics::Corotational] {
            for (number, tissue) in TISSUES.into_iter().enumerate() {
                let shortest = (number < 2).then_some(SHORTEST);
                // Large hearts take the usual times, or the longest step, alone.
                let times = TIMES.into_iter().chain(shortest).filter(|times| is_whole || (number < 2) == (times[0] == 0.005));
                for times in times.take(if is_whole { 4 } else { 1 }) {
                    let start_s = hearts::processor_s();
                    let words = outcome(&anatomy, kinematics, tissue, times, is_whole);
                    counts = (counts.0 + usize::from(words.is_ok()), counts.1 + 1);
                    let used_s = hearts::processor_s() - start_s;
                    println!("  {kinematics:?} {tissue:?} kPa, {times:?} s: {} ({used_s:.1} s)", words.unwrap_or_else(|error| error));
                }
            }
        }
        println!("  {} of {} beat", counts.0, counts.1);
    }
}

/// What a heart did, or why it did not.
fn outcome(anatomy: &Arc<Anatomy>, kinematics: Kinematics, tissue: Tissue, times: [f64; 3], is_whole: bool) -> Result<String, String> {
    let [step_s, duration_s, period_s] = times;
    let values = [
        (Parameter::FibreStiffness, tissue.0),
        (Parameter::TransverseStiffness, tissue.1),
        (Parameter::ContractionPeakLv, tissue.2),
        (Parameter::ActionPotentialDuration, duration_s),
        (Parameter::HeartPeriod, period_s),
    ];
    let parameters = values.into_iter().fold(Parameters::default(), |all, (parameter, value)| all.with(parameter, value).unwrap());
    let settings = ModelSettings { step_s, kinematics, ..ModelSettings::default() };
    let model = HeartModel::new(Arc::clone(anatomy), parameters, settings).unwrap();
    let end_s = if is_whole { period_s - 0.1 } else { 0.25 };
    let trajectory = beat(&model, end_s).map_err(|error| error.to_string())?;
    let rows = trajectory.curves.iter().filter_map(|row| row.ventricle(Ventricle::Left));
    assert!(rows.flat_map(|row| [row.volume_ml, row.pressure_kpa, row.arterial_pressure_kpa]).all(f64::is_finite));
    assert!(trajectory.last.motion.position_mm.iter().flat_map(|p| p.iter()).all(|number| number.is_finite()));
    let observables = BeatObservables::of_beat(&trajectory.curves, Ventricle::Left, -0.1, end_s + 0.1).unwrap();
    Ok(format!("EF {:.2}, peak {:.0} mmHg", observables.ejection_fraction, observables.pressure_peak_mmhg))
}

fn beat(model: &HeartModel, end_time_s: f64) -> Result<Trajectory, StepError> {
    let plan = SimulationPlan { start_time_s: -0.1, end_time_s, frame_times_s: vec![] };
    simulate(model, &plan, &[], &mut |_, _| ControlFlow::Continue(()))
}
