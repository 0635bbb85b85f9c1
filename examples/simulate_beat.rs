//! A beat of two idealised ventricles: anatomy, model, simulation, figures. `cargo run --release --example simulate_beat`

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use std::error::Error;
use std::ops::ControlFlow;
use std::sync::Arc;

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{AnatomySettings, IdealisedBiventricle};
use cardiotwin::heart::{HeartModel, ModelSettings, Parameter, Parameters, SimulationPlan, simulate};

pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    // The heart at rest: a mesh with tagged surfaces, fibres and AHA segments.
    let anatomy = IdealisedBiventricle::default().build(&MesherSettings::with_edge_length_mm(10.0), &AnatomySettings::default())?;

    // Every parameter has a default; each is set by name and held within its physical range.
    let mut parameters = Parameters::default();
    parameters.set(Parameter::ContractionPeakLv, 130.0)?;

    // The model is constant: activation solved, step assembled and factorised.
    let model = HeartModel::new(Arc::new(anatomy), parameters, ModelSettings { step_s: 0.01, ..ModelSettings::default() })?;

    // A beat from late diastole on. The observer sees every step and may end the simulation.
    let plan = SimulationPlan { start_time_s: -0.15, end_time_s: 0.65, frame_times_s: vec![0.0, 0.3] };
    let trajectory = simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(()))?;

    let volumes_ml = trajectory.frames.iter().map(|frame| frame.volume_ml[0]).collect::<Vec<_>>();
    println!(
        "{} steps; left cavity {:.1} mL at the trigger, {:.1} mL 300 ms later",
        trajectory.curves.len() - 1,
        volumes_ml[0],
        volumes_ml[1]
    );
    if volumes_ml[1] > 0.8 * volumes_ml[0] {
        return Err("the heart hardly beats".into());
    }
    Ok(())
}
