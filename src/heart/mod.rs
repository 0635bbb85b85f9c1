//! The coupled heart: parameters, model, step, beat and observables, \[Billet2009\] §2.

mod activation_times;
mod base_motion;
mod beat_deformation;
#[cfg(test)]
mod beat_tests;
mod contraction;
#[cfg(test)]
mod corotational_tests;
mod deformation;
mod each_beat;
mod error;
#[cfg(test)]
mod idealised_lv;
mod lead_in;
mod model;
mod newton;
mod observables;
mod onset;
mod parameters;
mod periodic;
mod phases;
mod potential;
mod pressure_stiffness;
mod regional;
mod rhythm;
mod simulate;
mod state;
mod step;
mod substeps;
mod tangent;
#[cfg(test)]
mod two_ventricle_tests;

pub use activation_times::ActivationTimes;
pub use base_motion::BaseMotion;
pub use beat_deformation::{BeatDeformation, PeakStrain};
pub use deformation::{Deformation, SegmentDeformation, Strain};
pub use each_beat::EachBeat;
pub use error::{HeartError, StepError, TangentError};
pub use model::{HeartModel, ModelSettings, PressureLoad};
pub use observables::BeatObservables;
pub use onset::OnsetSites;
pub use parameters::{OutOfRange, Parameter, ParameterSpec, Parameters, Section};
pub use periodic::{PeriodicOutcome, Periodicity, simulate_until_periodic};
pub use phases::{PhaseEvent, phase_events};
pub use regional::{Part, RegionalParameter};
pub use rhythm::{Depolarisation, ExtraStimulus, HeartRhythm};
pub use simulate::{FrameState, SimulationPlan, Trajectory, simulate, simulate_from};
pub use state::{CurveRow, HeartState, VentricleCurve, VentricleState};
pub use step::{StepOutcome, StepWorkspace};
pub use tangent::simulate_with_tangents;
