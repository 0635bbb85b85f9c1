//! Arteries, atria and valves; sees the heart only as an affine cavity response, \[Billet2009\] §2.

mod atrium;
mod error;
mod phase;
mod valve_rates;
mod valves;
mod windkessel;

pub use atrium::{AtrialPressure, AtrialPressureRate};
pub use error::CirculationError;
pub use phase::Phase;
pub use valve_rates::{PortRates, ValveRates, VentricleFlowRate};
pub use valves::{CavityResponse, OpenValves, ValveProblem, VentricleFlow, VentriclePorts};
pub use windkessel::{ArterialResponse, Windkessel, WindkesselRate};
