//! Figures as PNG, from plain arrays; legible in print, and told apart without colour vision (the palette of Okabe and Ito).

mod chart;
mod convergence;
mod curves;
mod loops;
mod montage;
mod parameters;
mod ranking;
mod strains;
mod style;
mod surface;
mod sweep;

pub use chart::{Curve, Look};
pub use convergence::{Convergence, SolverCurve, convergence};
pub use curves::{
    BeatCurves, CostHistory, TimeBand, TimeCurves, VolumeCurves, beat_curves, cost_over_iterations, time_curves, volume_curves,
};
pub use loops::{LoopPoint, PressureVolumeLoop, pressure_volume_loop};
pub use montage::{Contour, Montage, MontagePanel, slice_montage};
pub use parameters::{ParameterInterval, parameter_intervals};
pub use ranking::{Bar, ranking};
pub use strains::{StrainCurves, StrainPanel, strain_curves};
pub use surface::{SurfaceMap, SurfaceView, surface_map};
pub use sweep::{Sweep, SweepCell, sweep};
