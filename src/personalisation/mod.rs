//! Parameters from data: residuals, Gauss–Newton with constrained QP steps, gains and uncertainty.

use nalgebra::DVector;

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
    fn simulate_with_tangents(&self, parameters: &DVector<f64>) -> Result<(Self::Trajectory, Vec<Self::Trajectory>), Self::Error>;
}

/// Rows that compare a trajectory with data, already divided by their standard deviations.
pub trait Residual<T>: Sync {
    /// Number of rows.
    fn row_count(&self) -> usize;
    /// Writes the rows of `trajectory`.
    fn evaluate(&self, trajectory: &T, rows: &mut [f64]);
    /// Writes the rows' derivative along `tangent` at `trajectory`.
    fn apply_tangent(&self, trajectory: &T, tangent: &T, rows: &mut [f64]);
}
