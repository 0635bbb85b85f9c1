//! Parameters from data: residuals, Gauss–Newton with constrained QP steps, gains and uncertainty, MODEL §9 and §10.
//!
//! The model appears as a [`TangentModel`] only: a trajectory and its derivatives. [`FiniteDifferenceModel`] makes one of any simulation.

mod constraints;
mod error;
mod evidence;
mod gains;
mod gauss_newton;
mod journal;
mod parameters;
mod problem;
mod profile;
mod residuals;
mod search;
mod start_values;
mod tables;
mod tangents;
mod uncertainty;

use nalgebra::DVector;

pub use constraints::{InequalityConstraint, LinearConstraint, RepolarisedBeforeNextBeat};
pub use error::PersonalisationError;
pub use evidence::Evidence;
pub use gains::{GainChoice, GainEvaluation, GainSearch};
pub use gauss_newton::{
    Calibration, CalibrationOutcome, CalibrationState, ConvergenceTest, GaussNewtonQp, GaussNewtonSettings, IterationRecord, RecordStatus,
    TrustShape, calibrate,
};
pub use journal::{Computed, Journal, JournalEntry, NoEntry};
pub use parameters::{FreeParameter, ParameterSpace, Transform};
pub use problem::{CalibrationProblem, Evaluation, Linearisation};
pub use profile::{ProfilePoint, RISE_95, crossing_95, profile};
pub use residuals::{
    ActivationResidual, BoundaryResidual, CalibrationFrame, CalibrationTrajectory, GroupDistances, Loss, PressureResidual, PriorResidual,
    StackedResidual, SurfaceTarget, Tie, VolumeCurveResidual,
};
pub use search::{SearchMethod, SearchSettings, search};
pub use start_values::{ElectricalTiming, PilotFit, VolumeTiming, conduction_velocity_mm_per_s, contraction_peak_for_ejection_fraction};
pub use tables::{DataSensitivity, Table, data_sensitivities, iteration_table};
pub use tangents::{DifferenceScheme, FiniteDifferenceModel, LinearTrajectory};
pub use uncertainty::{BoundState, NoiseScale, ParameterEstimate, Uncertainty, estimates};

/// A trajectory and its derivative in each parameter, or why there is none.
pub type WithTangents<T, E> = Result<(T, Vec<T>), E>;

/// A model whose trajectories can be differentiated in its parameters.
pub trait TangentModel: Sync {
    /// What is compared with data; a tangent has the same shape.
    type Trajectory;
    /// Why a simulation could not be completed.
    type Error: std::error::Error + Send + Sync + 'static;

    /// The trajectory of `parameters` (in the calibration's own, transformed coordinates).
    ///
    /// # Errors
    /// The model's own.
    fn simulate(&self, parameters: &DVector<f64>) -> Result<Self::Trajectory, Self::Error>;

    /// The trajectory and its derivative in each parameter.
    ///
    /// # Errors
    /// The model's own.
    fn simulate_with_tangents(&self, parameters: &DVector<f64>) -> WithTangents<Self::Trajectory, Self::Error>;

    /// What the tangents of `dimension` parameters cost beside a simulation already done at the same point, in simulations.
    fn tangent_cost(&self, dimension: usize) -> f64;
}

/// What a row shares with others whose errors go along with its own: errors of one place last through the beat, and at one instant all places are
/// early or late together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cluster {
    /// Surface and segment, or quantity.
    pub place: u32,
    /// Frame.
    pub instant: u32,
}

/// Rows that compare a trajectory with data, already divided by their standard deviations.
pub trait Residual<T>: Sync {
    /// Number of rows.
    fn row_count(&self) -> usize;
    /// Writes the rows of `trajectory`.
    fn evaluate(&self, trajectory: &T, rows: &mut [f64]);
    /// Writes the rows' derivative along `tangent` at `trajectory`.
    fn apply_tangent(&self, trajectory: &T, tangent: &T, rows: &mut [f64]);
    /// Writes the loss of every row.
    fn write_losses(&self, losses: &mut [Loss]);
    /// Writes the clusters of every row; as they come, all rows are of one place and each of an instant of its own.
    fn write_clusters(&self, clusters: &mut [Cluster]) {
        for (instant, cluster) in clusters.iter_mut().enumerate() {
            *cluster = Cluster { place: 0, instant: instant as u32 };
        }
    }
}
