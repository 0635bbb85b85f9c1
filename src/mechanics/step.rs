//! One implicit time step as a linear system, $\tilde K Y^{t+h} = F$, \[Billet2009\] §4.2.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::kinematics::CorotationalConstants;
use super::myocardium::check_size;
use super::scheme::Coefficients;
use super::{Kinematics, Linearisation, MechanicsError, MotionState, Myocardium, StepSystem, Tangent, TimeScheme};
use crate::numerics::{BlockMatrix, CholeskyFactor, CholeskyWorkspace, PanelWorkspace};

/// How a step is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepSettings {
    /// The step h, s.
    pub step_s: f64,
    /// How time is discretised.
    pub scheme: TimeScheme,
    /// How strain is measured.
    pub kinematics: Kinematics,
}

/// A fixed step h of a [`TimeScheme`]. For backward Euler and linear kinematics
///
/// $$\tilde K = \frac{M}{h^2} + \frac{C}{h} + K + S, \qquad
/// F = \frac{M}{h^2}(y + h v) + \frac{C}{h}\,y + K x + S a + F_{ext}$$
///
/// with the springs S towards their anchors a; generalised-α has other factors of M and C and their history on the right.
/// $\tilde K$ is constant, and factorised once.
///
/// Corotational kinematics have internal forces $f_{int}(y)$ in the place of $K (y - x)$, $\beta K v$ and the contraction, which hold
/// in the frame of each tetrahedron's rotation. [`StepOperator::linearise`] gives their tangent, which takes the place of
/// $\tilde K$; a step is solved by Newton's method on [`StepOperator::residual`].
#[derive(Debug)]
pub struct StepOperator {
    myocardium: Arc<Myocardium>,
    settings: StepSettings,
    coefficients: Coefficients,
    matrix: BlockMatrix,
    damping: Damping,
    /// S_p x and, in linear kinematics, K x, mN: the elastic constants on the right.
    rest_force_mn: Vec<Vector3<f64>>,
    factor: CholeskyFactor,
}

/// Memory of [`StepOperator::add_history`].
#[derive(Debug, Default)]
pub struct HistoryMemory {
    damped_mm_per_s: Vec<Vec<Vector3<f64>>>,
    panel: PanelWorkspace,
}

/// C, or the part of it that is constant.
#[derive(Debug)]
enum Damping {
    /// αM + βK and the pericardial dashpots, mN·s/mm.
    Linear(BlockMatrix),
    /// αM and the pericardial dashpots, mN·s/mm.
    Corotational(Vec<Matrix3<f64>>, CorotationalConstants),
}

impl StepOperator {
    /// Assembles and factorises the step matrix of backward Euler with linear kinematics.
    ///
    /// # Errors
    /// As [`StepOperator::with_settings`].
    pub fn new(myocardium: Arc<Myocardium>, step_s: f64) -> Result<Self, MechanicsError> {
        Self::with_scheme(myocardium, step_s, TimeScheme::BackwardEuler)
    }

    /// Assembles and factorises the step matrix of a scheme with linear kinematics.
    ///
    /// # Errors
    /// As [`StepOperator::with_settings`].
    pub fn with_scheme(myocardium: Arc<Myocardium>, step_s: f64, scheme: TimeScheme) -> Result<Self, MechanicsError> {
        Self::with_settings(myocardium, StepSettings { step_s, scheme, kinematics: Kinematics::Linear })
    }

    /// Assembles and factorises the step matrix; in corotational kinematics that of the tissue at rest.
    ///
    /// # Errors
    /// [`MechanicsError::Property`] for a step that is not positive or a spectral radius outside 0 to 1,
    /// [`MechanicsError::Solve`] if the matrix is not positive definite.
    pub fn with_settings(myocardium: Arc<Myocardium>, settings: StepSettings) -> Result<Self, MechanicsError> {
        let coefficients = settings.scheme.coefficients(settings.step_s)?;
        let damping = damping_matrix(&myocardium);
        let mut matrix = myocardium.stiffness().clone();
        matrix.add_scaled(coefficients.damping_factor(), &damping);
        let mut rest_force_mn = vec![Vector3::zeros(); myocardium.vertex_count()];
        for (vertex, mass_kg) in myocardium.vertex_mass_kg().iter().enumerate() {
            matrix.add_to_diagonal(vertex, &(Matrix3::identity() * (mass_kg * coefficients.mass_factor())));
        }
        for (vertex, block) in myocardium.base().iter().chain(myocardium.pericardium_springs().iter()) {
            matrix.add_to_diagonal(vertex, block);
        }
        let damping = match settings.kinematics {
            Kinematics::Linear => {
                myocardium.stiffness().multiply(myocardium.rest_mm(), &mut rest_force_mn);
                Damping::Linear(damping)
            }
            Kinematics::Corotational => corotational_damping(&myocardium, coefficients),
        };
        for (vertex, block) in myocardium.pericardium_springs().iter() {
            rest_force_mn[vertex] += block * myocardium.rest_mm()[vertex];
        }
        let factor = CholeskyFactor::new(Arc::clone(myocardium.structure()), &matrix, &mut CholeskyWorkspace::default())?;
        Ok(Self { myocardium, settings, coefficients, matrix, damping, rest_force_mn, factor })
    }

    /// The tissue.
    pub fn myocardium(&self) -> &Arc<Myocardium> {
        &self.myocardium
    }

    /// The step h, s.
    pub fn step_s(&self) -> f64 {
        self.settings.step_s
    }

    /// How a step is taken.
    pub fn settings(&self) -> StepSettings {
        self.settings
    }

    /// A system of the right size, all zero.
    pub fn empty_system(&self) -> StepSystem {
        let count = self.myocardium.vertex_count();
        let tangent = match self.settings.kinematics {
            Kinematics::Linear => None,
            Kinematics::Corotational => Some(Tangent::new(&self.myocardium)),
        };
        StepSystem { force_mn: vec![Vector3::zeros(); count], stiffness_mn_per_mm: vec![Matrix3::zeros(); count], tangent }
    }

    /// Starts a step's system: sets the force to inertia, damping, elastic constants and base springs, and the stiffness to zero.
    /// In corotational kinematics elasticity and its damping are left to [`StepOperator::linearise`]. External loads are added to it afterwards. `base_anchor_mm` moves the anchors of the base springs: one position a vertex of
    /// [`Myocardium::base_vertices`]; without it they are at rest.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries, [`MechanicsError::InvertedElement`] if corotational
    /// kinematics meet a tetrahedron that is flat or inside out.
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
        match (&self.damping, &mut system.tangent) {
            (Damping::Linear(damping), None) => damping.multiply_add(1.0, &damped, &mut system.force_mn),
            (Damping::Corotational(damping, _), Some(tangent)) => {
                tangent.begin(tissue, state, &self.coefficients)?;
                system.force_mn.iter_mut().zip(damping).zip(&damped).for_each(|((force, block), damped)| *force += block * damped);
            }
            _ => return Err(MechanicsError::NotLinearised),
        }
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

    /// Adds to every force what its motion leaves on the right of a step, the part of [`StepOperator::assemble`] that is linear in the
    /// motion: for backward Euler $\frac{M}{h^2}(y + h v) + \frac Ch\,y$. In corotational kinematics without the damping of the stretch.
    /// `memory` may be that of any earlier call.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries or the numbers of motions and forces differ.
    pub fn add_history(
        &self,
        motions: &[&MotionState],
        memory: &mut HistoryMemory,
        forces_mn: &mut [Vec<Vector3<f64>>],
    ) -> Result<(), MechanicsError> {
        let count = self.myocardium.vertex_count();
        check_size("forces, one a motion", motions.len(), forces_mn.len())?;
        let HistoryMemory { damped_mm_per_s, panel } = memory;
        damped_mm_per_s.resize_with(motions.len().max(damped_mm_per_s.len()), Vec::new);
        for ((motion, damped), force_mn) in motions.iter().zip(damped_mm_per_s.iter_mut()).zip(&mut *forces_mn) {
            check_size("positions, one a vertex", count, motion.position_mm.len())?;
            check_size("forces, one a vertex", count, force_mn.len())?;
            damped.resize(count, Vector3::zeros());
            let masses_kg = self.myocardium.vertex_mass_kg();
            for (vertex, ((force, damped), mass_kg)) in force_mn.iter_mut().zip(damped).zip(masses_kg).enumerate() {
                *force += self.coefficients.inertia_on_the_right(motion, vertex) * *mass_kg;
                *damped = self.coefficients.damping_on_the_right(motion, vertex);
            }
        }
        match &self.damping {
            Damping::Linear(damping) => damping.multiply_add_columns(&damped_mm_per_s[..motions.len()], forces_mn, panel),
            Damping::Corotational(damping, _) => {
                for (damped, force_mn) in damped_mm_per_s.iter().zip(forces_mn) {
                    force_mn.iter_mut().zip(damping).zip(damped).for_each(|((force, block), damped)| *force += block * damped);
                }
            }
        }
        Ok(())
    }

    /// Adds the contraction σC, kPa a tetrahedron, to a step's system: as a force in linear kinematics; in corotational ones as a
    /// tension that turns with the fibre, once [`StepOperator::linearise`] is called.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries.
    pub fn add_contraction(&self, stress_kpa: &[f64], system: &mut StepSystem) -> Result<(), MechanicsError> {
        let Some(tangent) = &mut system.tangent else {
            return self.myocardium.add_contraction_force(stress_kpa, &mut system.force_mn);
        };
        check_size("contraction stresses, one a tetrahedron", self.myocardium.tetrahedron_count(), stress_kpa.len())?;
        tangent.set_tension(stress_kpa);
        Ok(())
    }

    /// Takes a corotational system to trial positions of the step's end: internal forces and their tangent there. Nothing is to be
    /// done in linear kinematics.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`], or [`MechanicsError::InvertedElement`] if a tetrahedron is flat or inside out there.
    pub fn linearise(
        &self,
        trial_mm: &[Vector3<f64>],
        linearisation: Linearisation,
        system: &mut StepSystem,
    ) -> Result<(), MechanicsError> {
        check_size("trial positions, one a vertex", self.myocardium.vertex_count(), trial_mm.len())?;
        match (&self.damping, &mut system.tangent) {
            (Damping::Corotational(_, constants), Some(tangent)) => tangent.linearise(&self.myocardium, constants, trial_mm, linearisation),
            _ => Ok(()),
        }
    }

    /// Takes the internal forces of a corotational system to other trial positions than it was linearised about, and leaves the
    /// tangent.
    ///
    /// # Errors
    /// As [`StepOperator::linearise`]; the forces are then undefined.
    pub fn update_force(&self, trial_mm: &[Vector3<f64>], system: &mut StepSystem) -> Result<(), MechanicsError> {
        check_size("trial positions, one a vertex", self.myocardium.vertex_count(), trial_mm.len())?;
        system.tangent.as_mut().map_or(Ok(()), |tangent| tangent.update_force(&self.myocardium, trial_mm))
    }

    /// Writes what is left of the balance of forces at the trial positions of a corotational system, mN.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries, [`MechanicsError::NotLinearised`] if the system is not
    /// corotational.
    pub fn residual(&self, system: &StepSystem, residual_mn: &mut [Vector3<f64>]) -> Result<(), MechanicsError> {
        let (Damping::Corotational(_, constants), Some(tangent)) = (&self.damping, &system.tangent) else {
            return Err(MechanicsError::NotLinearised);
        };
        check_size("residuals, one a vertex", self.myocardium.vertex_count(), residual_mn.len())?;
        for (vertex, residual) in residual_mn.iter_mut().enumerate() {
            let stiffness = constants.diagonal_mn_per_mm[vertex] + system.stiffness_mn_per_mm[vertex];
            *residual = system.force_mn[vertex] - tangent.force_mn()[vertex] - stiffness * tangent.trial_mm()[vertex];
        }
        Ok(())
    }

    /// The internal forces of a tissue at the end of a step of corotational kinematics that begins with `start`, mN, under a tension σC
    /// (kPa a tetrahedron). `system` is memory.
    ///
    /// # Errors
    /// As [`StepOperator::linearise`], and [`MechanicsError::NotLinearised`] if the system is not corotational.
    pub fn internal_force_mn<'a>(
        &self,
        tissue: &Myocardium,
        start: &MotionState,
        tension_kpa: &[f64],
        end_mm: &[Vector3<f64>],
        system: &'a mut StepSystem,
    ) -> Result<&'a [Vector3<f64>], MechanicsError> {
        check_size("end positions, one a vertex", tissue.vertex_count(), end_mm.len())?;
        check_size("positions, one a vertex", tissue.vertex_count(), start.position_mm.len())?;
        check_size("contraction stresses, one a tetrahedron", tissue.tetrahedron_count(), tension_kpa.len())?;
        let tangent = system.tangent.as_mut().ok_or(MechanicsError::NotLinearised)?;
        tangent.begin(tissue, start, &self.coefficients)?;
        tangent.set_tension(tension_kpa);
        tangent.update_force(tissue, end_mm)?;
        Ok(tangent.force_mn())
    }

    /// What minus the residual is the gradient of, in two parts whose sum it is, mN·mm: the internal energy where the system's forces
    /// were last computed, and the rest of it beside its value at `from_mm` (with the symmetric part of the data's stiffness).
    ///
    /// # Errors
    /// As [`StepOperator::residual`].
    pub fn energy_mn_mm(&self, system: &StepSystem, from_mm: &[Vector3<f64>]) -> Result<(f64, f64), MechanicsError> {
        let (Damping::Corotational(_, constants), Some(tangent)) = (&self.damping, &system.tangent) else {
            return Err(MechanicsError::NotLinearised);
        };
        check_size("positions, one a vertex", self.myocardium.vertex_count(), from_mm.len())?;
        let change = |(vertex, (to, from)): (usize, (&Vector3<f64>, &Vector3<f64>))| {
            let stiffness = constants.diagonal_mn_per_mm[vertex] + system.stiffness_mn_per_mm[vertex];
            (to - from).dot(&(stiffness * (to + from) / 2.0 - system.force_mn[vertex]))
        };
        Ok((tangent.energy_mn_mm(), tangent.trial_mm().iter().zip(from_mm).enumerate().map(change).sum()))
    }

    /// Norm of the forces that would move every vertex of the tissue at rest by 1 mm, each on its own, mN: what residuals are read
    /// against.
    pub fn unit_displacement_force_mn(&self) -> f64 {
        let count = self.myocardium.vertex_count();
        (0..count).map(|vertex| (self.matrix.diagonal(vertex).trace() / 3.0).powi(2)).sum::<f64>().sqrt()
    }

    /// Writes (K_T + K_img) x, the derivative of minus the residual along x, mN.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries, [`MechanicsError::NotLinearised`] if the system is not.
    pub fn multiply(&self, system: &StepSystem, x: &[Vector3<f64>], product_mn: &mut [Vector3<f64>]) -> Result<(), MechanicsError> {
        let tangent = system.tangent.as_ref().filter(|tangent| tangent.is_linearised()).ok_or(MechanicsError::NotLinearised)?;
        check_size("directions, one a vertex", self.myocardium.vertex_count(), x.len())?;
        check_size("products, one a vertex", self.myocardium.vertex_count(), product_mn.len())?;
        tangent.matrix().multiply(x, product_mn);
        tangent.mean_stiffnesses().iter().for_each(|stiffness| stiffness.multiply_add(x, product_mn));
        for ((product, block), x) in product_mn.iter_mut().zip(&system.stiffness_mn_per_mm).zip(x) {
            *product += block * x;
        }
        Ok(())
    }

    /// The state at the step's end, whose positions have been solved for; for backward Euler $v^{t+h} = (Y^{t+h} - Y^t)/h$.
    pub fn advance(&self, state: &MotionState, position_mm: Vec<Vector3<f64>>) -> MotionState {
        self.coefficients.advance(state, position_mm)
    }

    /// [`StepOperator::advance`] into memory: writes velocities and accelerations of `next`, which has the positions.
    pub fn complete(&self, state: &MotionState, next: &mut MotionState) {
        self.coefficients.complete(state, next);
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

/// The part of C that does not turn with the tissue, and what else is constant in corotational kinematics.
fn corotational_damping(tissue: &Myocardium, coefficients: Coefficients) -> Damping {
    let alpha_per_s = tissue.properties().damping_mass_per_s;
    let mut damping: Vec<_> = tissue.vertex_mass_kg().iter().map(|mass_kg| Matrix3::identity() * (alpha_per_s * mass_kg)).collect();
    for (vertex, block) in tissue.pericardium_dashpots().iter() {
        damping[vertex] += block;
    }
    let mut diagonal: Vec<_> = damping.iter().map(|block| block * coefficients.damping_factor()).collect();
    for (block, mass_kg) in diagonal.iter_mut().zip(tissue.vertex_mass_kg()) {
        *block += Matrix3::identity() * (mass_kg * coefficients.mass_factor());
    }
    for (vertex, block) in tissue.base().iter().chain(tissue.pericardium_springs().iter()) {
        diagonal[vertex] += block;
    }
    Damping::Corotational(damping, CorotationalConstants::new(tissue, diagonal))
}
