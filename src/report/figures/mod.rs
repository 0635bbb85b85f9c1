//! Figures as PNG, from plain arrays; legible in print, and told apart without colour vision (the palette of Okabe and Ito).

mod chart;
mod curves;
mod loops;
mod montage;
mod parameters;
mod style;

pub use chart::{Curve, Look};
pub use curves::{CostHistory, PressureCurves, TimeBand, VolumeCurves, cost_over_iterations, pressures, volume_curves};
pub use loops::{LoopPoint, PressureVolumeLoop, pressure_volume_loop};
pub use montage::{Contour, Montage, MontagePanel, slice_montage};
pub use parameters::{ParameterInterval, parameter_intervals};
