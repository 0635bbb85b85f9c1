//! One implicit time step as a linear system, $\tilde K Y^{t+h} = F$, \[Billet2009\] §4.2.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::myocardium::check_size;
use super::scheme::Coefficients;
use super::{MechanicsError, MotionState, Myocardium, StepSystem, TimeScheme};
use crate::numerics::{BlockMatrix, CholeskyFactor, CholeskyWorkspace};

/// A fixed step h of a [`TimeScheme`]. For backward Euler
///
/// $$\tilde K = \frac{M}{h^2} + \frac{C}{h} + K + S, \qquad
/// F = \frac{M}{h^2}(y + h v) + \frac{C}{h}\,y + K x + S a + F_{ext}$$
///
/// with the springs S towards their anchors a; generalised-α has other factors of M and C and their history on the right.
/// $\tilde K$ is constant, and factorised once.
#[derive(Debug)]
pub struct StepOperator {
    myocardium: Arc<Myocardium>,
    step_s: f64,
    scheme: TimeScheme,
    coefficients: Coefficients,
    matrix: BlockMatrix,
    damping: BlockMatrix,
    /// K x + S_p x, mN: the elastic constants on the right.
    rest_force_mn: Vec<Vector3<f64>>,
    factor: CholeskyFactor,
}

impl StepOperator {
    /// Assembles and factorises the step matrix of backward Euler.
    ///
    /// # Errors
    /// As [`StepOperator::with_scheme`].
    pub fn new(myocardium: Arc<Myocardium>, step_s: f64) -> Result<Self, MechanicsError> {
        Self::with_scheme(myocardium, step_s, TimeScheme::BackwardEuler)
    }

    /// Assembles and factorises the step matrix of a scheme.
    ///
    /// # Errors
    /// [`MechanicsError::Property`] for a step that is not positive or a spectral radius outside 0 to 1,
    /// [`MechanicsError::Solve`] if the matrix is not positive definite.
    pub fn with_scheme(myocardium: Arc<Myocardium>, step_s: f64, scheme: TimeScheme) -> Result<Self, MechanicsError> {
        let coefficients = scheme.coefficients(step_s)?;
        let damping = damping_matrix(&myocardium);
        let mut matrix = myocardium.stiffness().clone();
        matrix.add_scaled(coefficients.damping_factor(), &damping);
        for (vertex, mass_kg) in myocardium.vertex_mass_kg().iter().enumerate() {
            matrix.add_to_diagonal(vertex, &(Matrix3::identity() * (mass_kg * coefficients.mass_factor())));
        }
        for (vertex, block) in myocardium.base().iter().chain(myocardium.pericardium_springs().iter()) {
            matrix.add_to_diagonal(vertex, block);
        }
        let mut rest_force_mn = vec![Vector3::zeros(); myocardium.vertex_count()];
        myocardium.stiffness().multiply(myocardium.rest_mm(), &mut rest_force_mn);
        for (vertex, block) in myocardium.pericardium_springs().iter() {
            rest_force_mn[vertex] += block * myocardium.rest_mm()[vertex];
        }
        let factor = CholeskyFactor::new(Arc::clone(myocardium.structure()), &matrix, &mut CholeskyWorkspace::default())?;
        Ok(Self { myocardium, step_s, scheme, coefficients, matrix, damping, rest_force_mn, factor })
    }

    /// The tissue.
    pub fn myocardium(&self) -> &Arc<Myocardium> {
        &self.myocardium
    }

    /// The step h, s.
    pub fn step_s(&self) -> f64 {
        self.step_s
    }

    /// The scheme.
    pub fn scheme(&self) -> TimeScheme {
        self.scheme
    }

    /// A system of the right size, all zero.
    pub fn empty_system(&self) -> StepSystem {
        let count = self.myocardium.vertex_count();
        StepSystem { force_mn: vec![Vector3::zeros(); count], stiffness_mn_per_mm: vec![Matrix3::zeros(); count] }
    }

    /// Starts a step's system: sets the force to inertia, damping, elastic constants and base springs, and the stiffness to zero.
    /// External loads are added to it afterwards. `base_anchor_mm` moves the anchors of the base springs: one position a vertex of
    /// [`Myocardium::base_vertices`]; without it they are at rest.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries.
    pub fn assemble(
        &self,
        state: &MotionState,
        base_anchor_mm: Option<&[Vector3<f64>]>,
        system: &mut StepSystem,
    ) -> Result<(), MechanicsError> {
        let tissue = &*self.myocardium;
        let count = tissue.vertex_count();
        check_size("positions, one a vertex", count, state.position_mm.len())?;
        check_size("velocities, one a vertex", count, state.velocity_mm_per_s.len())?;
        check_size("accelerations, one a vertex", count, state.acceleration_mm_per_s2.len())?;
        check_size("algorithmic accelerations, one a vertex", count, state.algorithmic_acceleration_mm_per_s2.len())?;
        check_size("forces, one a vertex", count, system.force_mn.len())?;
        check_size("stiffness blocks, one a vertex", count, system.stiffness_mn_per_mm.len())?;
        system.stiffness_mn_per_mm.fill(Matrix3::zeros());
        system.force_mn.copy_from_slice(&self.rest_force_mn);
        let damped: Vec<Vector3<f64>> = (0..count).map(|vertex| self.coefficients.damping_on_the_right(state, vertex)).collect();
        self.damping.multiply_add(1.0, &damped, &mut system.force_mn);
        for (vertex, (force, mass_kg)) in system.force_mn.iter_mut().zip(tissue.vertex_mass_kg()).enumerate() {
            *force += self.coefficients.inertia_on_the_right(state, vertex) * *mass_kg;
        }
        if let Some(anchor_mm) = base_anchor_mm {
            check_size("base anchors, one a base vertex", tissue.base_vertices().len(), anchor_mm.len())?;
        }
        for (index, (vertex, block)) in tissue.base().iter().enumerate() {
            let anchor = base_anchor_mm.map_or(tissue.rest_mm()[vertex], |anchor_mm| anchor_mm[index]);
            system.force_mn[vertex] += block * anchor;
        }
        Ok(())
    }

    /// The state at the step's end, whose positions have been solved for; for backward Euler $v^{t+h} = (Y^{t+h} - Y^t)/h$.
    pub fn advance(&self, state: &MotionState, position_mm: Vec<Vector3<f64>>) -> MotionState {
        self.coefficients.advance(state, position_mm)
    }

    /// $\tilde K$, kPa·mm.
    pub fn matrix(&self) -> &BlockMatrix {
        &self.matrix
    }

    /// The factor of $\tilde K$.
    pub(super) fn factor(&self) -> &CholeskyFactor {
        &self.factor
    }
}

/// C = α M + β K and the pericardial dashpots, mN·s/mm.
fn damping_matrix(tissue: &Myocardium) -> BlockMatrix {
    let properties = tissue.properties();
    let mut damping = BlockMatrix::zeros(Arc::clone(tissue.stiffness().pattern()));
    damping.add_scaled(properties.damping_stiffness_s, tissue.stiffness());
    for (vertex, mass_kg) in tissue.vertex_mass_kg().iter().enumerate() {
        damping.add_to_diagonal(vertex, &(Matrix3::identity() * (properties.damping_mass_per_s * mass_kg)));
    }
    for (vertex, block) in tissue.pericardium_dashpots().iter() {
        damping.add_to_diagonal(vertex, block);
    }
    damping
}
