//! Active and visco-elastic mechanics of the myocardium, \[Billet2009\] §2; every force is a load on one step system.

mod base_distance;
mod column_solver;
mod contraction;
mod corotational;
mod element;
mod error;
mod explicit_limit;
mod guesses;
mod kinematics;
mod material;
mod myocardium;
mod passive_rate;
mod preconditioner;
mod scheme;
mod solver;
mod springs;
mod step;

use nalgebra::{Matrix3, Vector3};

use crate::mesh::SurfaceTag;

pub use column_solver::ColumnSolver;
pub use contraction::{ContractionLaw, ContractionRate};
pub use error::MechanicsError;
pub use explicit_limit::{ExplicitSpring, explicit_spring_limit};
pub use kinematics::{Kinematics, Linearisation, Tangent};
pub use material::{PassiveProperties, TransverseIsotropy};
pub use myocardium::Myocardium;
pub use passive_rate::PassiveRate;
pub use scheme::TimeScheme;
pub use solver::{SolvePath, SolveReport, SolveSettings, StepSolver};
pub use step::{HistoryMemory, StepOperator, StepSettings};

/// How every vertex moves at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionState {
    /// Positions y, mm.
    pub position_mm: Vec<Vector3<f64>>,
    /// Velocities, mm/s.
    pub velocity_mm_per_s: Vec<Vector3<f64>>,
    /// Accelerations ÿ, mm/s².
    pub acceleration_mm_per_s2: Vec<Vector3<f64>>,
    /// The auxiliary acceleration a that generalised-α carries, mm/s²; equal to ÿ in schemes without one.
    pub algorithmic_acceleration_mm_per_s2: Vec<Vector3<f64>>,
}

impl MotionState {
    /// No motion, at the given positions (mm).
    pub fn at_rest(position_mm: Vec<Vector3<f64>>) -> Self {
        let zero = vec![Vector3::zeros(); position_mm.len()];
        Self {
            position_mm,
            velocity_mm_per_s: zero.clone(),
            acceleration_mm_per_s2: zero.clone(),
            algorithmic_acceleration_mm_per_s2: zero,
        }
    }
}

/// What is added to the step system K̃ Y = F: forces on the right, 3 × 3 blocks on the diagonal of the left, so that
/// (K̃ + K_img) Y^{t+h} = F + F̃_img, \[Billet2009\] §4.2.
#[derive(Debug, Clone, PartialEq)]
pub struct StepSystem {
    /// F a vertex, mN.
    pub force_mn: Vec<Vector3<f64>>,
    /// Diagonal blocks of K_img a vertex, kPa·mm (= mN/mm); zero where there is no load.
    pub stiffness_mn_per_mm: Vec<Matrix3<f64>>,
    /// Internal forces and their tangent, in corotational kinematics; see [`StepOperator::linearise`].
    pub tangent: Option<Tangent>,
}

impl StepSystem {
    /// Whether anything was added to the left.
    pub fn has_stiffness(&self) -> bool {
        self.stiffness_mn_per_mm.iter().any(|block| *block != Matrix3::zeros())
    }
}

/// A force that the data exert during one step. Implementations add to the system and never edit a state.
pub trait StepLoad: Sync {
    /// Adds this load's force and stiffness for the step from `time_s` to `time_s + step_s`. The unknown of the system is the
    /// position at the end of the step, so a spring k (z − y) adds k z to the force and k to the stiffness.
    fn add_to(&self, state: &MotionState, time_s: f64, step_s: f64, system: &mut StepSystem);

    /// The derivative of this load in a step that has been taken, where it is known: a load without one has no tangents.
    fn tangent<'a>(&'a self, _step: &TakenStep<'a>) -> Option<Box<dyn LoadTangent + 'a>> {
        None
    }
}

/// A step that has been taken, as the derivatives of its loads see it.
#[derive(Debug, Clone, Copy)]
pub struct TakenStep<'a> {
    /// The state that it began with.
    pub state: &'a MotionState,
    /// When it began, s.
    pub time_s: f64,
    /// How long it took, s.
    pub step_s: f64,
    /// Positions at its end, mm.
    pub end_mm: &'a [Vector3<f64>],
}

/// The derivative of a [`StepLoad`] in one step.
pub trait LoadTangent: Sync {
    /// Adds $dF - dK\,Y$ with Y the positions at the step's end, mN, where the positions at its beginning change by `position_rate_mm`
    /// and the gain on a surface by `gain_rate`.
    fn add_force(&self, position_rate_mm: &[Vector3<f64>], gain_rate: &dyn Fn(SurfaceTag) -> f64, force_mn: &mut [Vector3<f64>]);
}
