//! One coupled step under corotational kinematics: Newton's method on muscle, springs, data, pressures and valves at once.
//!
//! The balance of forces at the step's end, positions Y and pressures p, is
//!
//! $$r(Y, p) = F - f_{int}(Y) + \sum_k (p_k - \bar p_k)\, \partial_y V_k(Y) = 0,$$
//!
//! where the pressures follow the moving surface: a wall that turns takes the direction of its load along. $\bar p_k$ is the pressure
//! under which the mesh rests, so the prestress that it is in equilibrium with turns as well. About a trial $(Y^\ast, p^\ast)$
//!
//! $$Y(p) = Y^\ast + \delta + \sum_k (p_k - p_k^\ast)\, W_k, \qquad A\,\delta = r(Y^\ast, p^\ast), \quad A\,W_k = \partial_y V_k,$$
//!
//! with $A = K_T + K_{img} - \sum_k (p_k^\ast - \bar p_k)\, \partial_y^2 V_k$ As in linear
//! kinematics the cavities' answer is affine in p and the valves give the pressures. The tangent is kept while rounds converge fast, also from step to step, and
//! made convex where it is not positive definite; what a round may move is measured by the residual or by the potential, see `potential`.

use nalgebra::{DMatrix, DVector, Vector3};

use super::potential::Descent;
use super::pressure_stiffness::add_pressure_stiffness;
use super::step::{dot, net_outflow_mm3};
use super::{HeartModel, HeartState, StepError, StepOutcome, StepWorkspace};
use crate::circulation::{CavityResponse, ValveProblem, VentricleFlow, VentriclePorts};
use crate::mechanics::{Linearisation, MechanicsError, SolvePath, SolveReport, StepLoad};
use crate::numerics::LinearSolveError;
use crate::units::{MM3_PER_ML, mm3_from_ml};

/// Rounds before a step is given up; 2–4 are usual.
const ROUND_LIMIT: usize = 40;

/// How far a round may be shortened: to a fraction of 2⁻⁸.
const HALVING_LIMIT: i32 = 8;

/// How much more residual than before a round may leave where the potential falls: near a tetrahedron without volume it falls into a
/// wall, out of which many rounds must climb.
const GROWTH_LIMIT: f64 = 3.0;

/// A step has converged when its residual, relative to the force that moves every vertex by 1 mm on its own, is below this.
const RESIDUAL_TOLERANCE: f64 = 1e-7;

/// Residual that the linear solve of a round may leave, relative.
const FORCING: f64 = 1e-2;

/// A first trial with a residual beyond this, in the measure of [`RESIDUAL_TOLERANCE`], has squeezed a tetrahedron flat.
const FAR_FROM_BALANCE: f64 = 0.05;

/// A round that leaves more of the residual than this is followed by a new tangent.
const KEEP_TANGENT_BELOW: f64 = 0.1;

/// A round with a convex tangent that leaves less of the residual than this is followed by the exact tangent.
const EXACT_BELOW: f64 = 0.5;

/// What a round is linearised with: each is tried where the one before it is not positive definite or leads nowhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Curvature {
    /// All of A.
    #[default]
    Exact,
    /// A with the convex tangent of every tetrahedron.
    ConvexTissue,
    /// The same without $\partial_y^2 V$.
    Convex,
}

impl Curvature {
    fn next(self) -> Option<Self> {
        match self {
            Self::Exact => Some(Self::ConvexTissue),
            Self::ConvexTissue => Some(Self::Convex),
            Self::Convex => None,
        }
    }
}

/// Memory of Newton's method.
#[derive(Debug, Default)]
pub(super) struct NewtonWorkspace {
    /// r, then ∂V, in; δ, then W, out.
    columns: Vec<Vec<Vector3<f64>>>,
    /// r at the trial, mN.
    pub(super) residual_mn: Vec<Vector3<f64>>,
    /// Y(p) − Y*, mm.
    pub(super) direction_mm: Vec<Vector3<f64>>,
    pub(super) candidate_mm: Vec<Vector3<f64>>,
    /// p* a ventricle, kPa.
    pub(super) pressure_kpa: Vec<f64>,
    curvature: Curvature,
    /// Whether there is a tangent of an earlier step: with it a step begins.
    has_tangent: bool,
    /// Whether the tangent serves another round.
    is_tangent_good: bool,
}

/// What a step of Newton's method is held against.
pub(super) struct Goal<'a> {
    pub(super) before_mm3: &'a [f64],
    pub(super) ports: &'a [VentriclePorts],
    residual_mn: f64,
    volume_mm3: f64,
}

/// Where a round has come to.
struct Round {
    flows: Vec<VentricleFlow>,
    residual_mn: f64,
    defect_mm3: f64,
    is_full: bool,
}

impl HeartModel {
    /// One step as [`HeartModel::step`], of the model's length and whole.
    pub(super) fn newton_step(
        &self,
        state: &HeartState,
        data: &[&dyn StepLoad],
        workspace: &mut StepWorkspace,
    ) -> Result<StepOutcome, StepError> {
        let (time_s, step_s) = (state.time_s, self.settings.step_s);
        let mechanics = |source: MechanicsError| StepError::Mechanics { time_s, step_s, source };
        self.assemble(state, data, workspace).map_err(mechanics)?;
        let before_mm3: Vec<f64> = state.ventricles.iter().map(|ventricle| ventricle.volume_mm3).collect();
        let goal = Goal {
            before_mm3: &before_mm3,
            ports: &self.ports(state),
            residual_mn: RESIDUAL_TOLERANCE * self.operator.unit_displacement_force_mn(),
            volume_mm3: mm3_from_ml(self.settings.volume_tolerance_ml),
        };
        let mut residual_mn = self.start(state, workspace).map_err(mechanics)?;
        let mut solve = SolveReport { path: SolvePath::Direct, iteration_count: 0, relative_residual: 0.0, was_refactorised: false };
        let mut defect_mm3 = f64::INFINITY;
        for round_count in 1..=ROUND_LIMIT {
            let report = self.solve_round(state, workspace).map_err(mechanics)?;
            solve = SolveReport { iteration_count: solve.iteration_count + report.iteration_count, ..report };
            let Some(round) = self.take_round(state, &goal, residual_mn, workspace)? else {
                if !std::mem::take(&mut workspace.newton.is_tangent_good) {
                    let Some(curvature) = workspace.newton.curvature.next() else { break };
                    workspace.newton.curvature = curvature;
                }
                residual_mn = self.stay(state, workspace).map_err(mechanics)?;
                continue;
            };
            let after_mm3 = self.volumes_mm3(&workspace.trial_mm);
            self.check_distance(state, &workspace.trial_mm)?;
            defect_mm3 = round.defect_mm3;
            workspace.newton.is_tangent_good = round.is_full && round.residual_mn < KEEP_TANGENT_BELOW * residual_mn;
            if round.is_full && round.residual_mn < EXACT_BELOW * residual_mn && workspace.newton.curvature != Curvature::Exact {
                (workspace.newton.curvature, workspace.newton.is_tangent_good) = (Curvature::Exact, false);
            }
            residual_mn = round.residual_mn;
            if round.is_full && residual_mn <= goal.residual_mn && defect_mm3 <= goal.volume_mm3 {
                let state = self.next_state(state, workspace, &round.flows, &after_mm3);
                let volume_defect_ml = defect_mm3 / MM3_PER_ML;
                return Ok(StepOutcome { state, round_count, substep_count: 1, volume_defect_ml, solve });
            }
        }
        let tolerance_mn = goal.residual_mn;
        Err(StepError::NotConverged { time_s, step_s, residual_mn, tolerance_mn, volume_defect_ml: defect_mm3 / MM3_PER_ML })
    }

    /// The first trial: the motion goes on with its acceleration, the pressures as they are; from where the heart is if that turns a
    /// tetrahedron inside out or nearly so. Gives the norm of r there.
    fn start(&self, state: &HeartState, workspace: &mut StepWorkspace) -> Result<f64, MechanicsError> {
        workspace.predict(state, self.settings.step_s);
        let curve_s2 = self.settings.step_s.powi(2);
        workspace.trial_mm.iter_mut().zip(&state.motion.acceleration_mm_per_s2).for_each(|(trial, a)| *trial += a * curve_s2);
        if self.operator.update_force(&workspace.trial_mm, &mut workspace.system).is_err() {
            workspace.trial_mm.copy_from_slice(&state.motion.position_mm);
            self.operator.update_force(&workspace.trial_mm, &mut workspace.system)?;
        }
        let newton = &mut workspace.newton;
        newton.is_tangent_good = newton.has_tangent && newton.curvature == Curvature::Exact;
        newton.curvature = Curvature::Exact;
        newton.pressure_kpa.clear();
        newton.pressure_kpa.extend(state.ventricles.iter().map(|ventricle| ventricle.pressure_kpa));
        newton.direction_mm.clone_from(&workspace.trial_mm);
        newton.residual_mn.clone_from(&workspace.trial_mm);
        newton.candidate_mm.clone_from(&workspace.trial_mm);
        let onward_mn = self.balance(state, workspace)?;
        if onward_mn < FAR_FROM_BALANCE * self.operator.unit_displacement_force_mn() {
            return Ok(onward_mn);
        }
        workspace.trial_mm.copy_from_slice(&state.motion.position_mm);
        self.stay(state, workspace)
    }

    /// Takes forces and r back to the trial, which a round has not left.
    fn stay(&self, state: &HeartState, workspace: &mut StepWorkspace) -> Result<f64, MechanicsError> {
        workspace.newton.candidate_mm.clone_from(&workspace.trial_mm);
        self.operator.update_force(&workspace.trial_mm, &mut workspace.system)?;
        self.balance(state, workspace)
    }

    /// Writes ∂V at the candidate and r there under p*, and gives the norm of r.
    fn balance(&self, state: &HeartState, workspace: &mut StepWorkspace) -> Result<f64, MechanicsError> {
        let StepWorkspace { system, gradients_mm2, newton, .. } = workspace;
        self.operator.residual(system, &mut newton.residual_mn)?;
        for (ventricle, (_, cavity)) in self.anatomy.cavities.iter().enumerate() {
            let gradient_mm2 = &mut gradients_mm2[ventricle];
            gradient_mm2.fill(Vector3::zeros());
            cavity.add_gradient(&newton.candidate_mm, 1.0, gradient_mm2);
            let over_kpa = newton.pressure_kpa[ventricle] - state.ventricles[ventricle].rest_pressure_kpa;
            newton.residual_mn.iter_mut().zip(gradient_mm2.iter()).for_each(|(residual, gradient)| *residual += gradient * over_kpa);
        }
        Ok(dot(&newton.residual_mn, &newton.residual_mn).sqrt())
    }

    /// δ, and W where the tangent is new; with a preconditioner of its own, then with a tangent that is more convex, where it must be.
    fn solve_round(&self, state: &HeartState, workspace: &mut StepWorkspace) -> Result<SolveReport, MechanicsError> {
        let mut is_renewed = false;
        loop {
            if !workspace.newton.is_tangent_good {
                self.linearise(state, workspace)?;
            }
            let StepWorkspace { solver, system, gradients_mm2, yields_mm_per_kpa, newton, .. } = workspace;
            let column_count = if newton.is_tangent_good { 1 } else { 1 + gradients_mm2.len() };
            newton.columns.resize_with(1 + gradients_mm2.len(), Vec::new);
            newton.columns[0].clone_from(&newton.residual_mn);
            newton.columns[1..].iter_mut().zip(gradients_mm2).for_each(|(column, gradient)| column.clone_from(gradient));
            let error = match solver.correct(&self.operator, system, &mut newton.columns[..column_count], FORCING) {
                Ok(report) if column_count == 1 => return Ok(report),
                Ok(report) => {
                    yields_mm_per_kpa.iter_mut().zip(&newton.columns[1..]).for_each(|(yielded, column)| yielded.clone_from(column));
                    return Ok(report);
                }
                Err(error) => error,
            };
            newton.is_tangent_good = false;
            match (&error, newton.curvature.next()) {
                (MechanicsError::Solve(LinearSolveError::NotConverged { .. }), _) if !is_renewed => is_renewed = true,
                (MechanicsError::NotConvex | MechanicsError::Solve(_), Some(curvature)) => newton.curvature = curvature,
                _ => return Err(error),
            }
            solver.forget_preconditioner();
        }
    }

    /// A at the trial.
    fn linearise(&self, state: &HeartState, workspace: &mut StepWorkspace) -> Result<(), MechanicsError> {
        let StepWorkspace { system, trial_mm, newton, .. } = workspace;
        let linearisation = if newton.curvature == Curvature::Exact { Linearisation::Exact } else { Linearisation::Convex };
        newton.has_tangent = true;
        self.operator.linearise(trial_mm, linearisation, system)?;
        if let Some(tangent) = system.tangent.as_mut().filter(|_| newton.curvature != Curvature::Convex) {
            for (ventricle, (_, cavity)) in self.anatomy.cavities.iter().enumerate() {
                let over_kpa = newton.pressure_kpa[ventricle] - state.ventricles[ventricle].rest_pressure_kpa;
                add_pressure_stiffness(cavity, trial_mm, over_kpa, tangent);
            }
        }
        Ok(())
    }

    /// Lets the valves find the pressures and takes the trial there, or part of the way: as far as the residual falls about as its
    /// linearisation does, or the potential falls, and no tetrahedron turns inside out. None if no part of the way will do.
    fn take_round(
        &self,
        state: &HeartState,
        goal: &Goal<'_>,
        before_mn: f64,
        workspace: &mut StepWorkspace,
    ) -> Result<Option<Round>, StepError> {
        let (time_s, step_s) = (state.time_s, self.settings.step_s);
        let mechanics = |source: MechanicsError| StepError::Mechanics { time_s, step_s, source };
        let response = self.trial_response(workspace);
        let flows = ValveProblem::new(&response, goal.before_mm3, goal.ports, self.valve_resistance(), step_s)
            .and_then(|valves| valves.solve())
            .map_err(|source| StepError::Circulation { time_s, step_s, source })?;
        let start_kpa = workspace.newton.pressure_kpa.clone();
        let change_kpa: Vec<f64> = flows.iter().zip(&start_kpa).map(|(flow, start)| flow.pressure_kpa - start).collect();
        workspace.write_direction(&change_kpa);
        let descent = Descent::new(self, goal, workspace).map_err(mechanics)?;
        // What the linearised forces change by on the whole way.
        let linear_mn: f64 =
            change_kpa.iter().zip(&workspace.gradients_mm2).map(|(change, gradient)| change.abs() * dot(gradient, gradient).sqrt()).sum();
        for halving in 0..=HALVING_LIMIT {
            let part = 0.5f64.powi(halving);
            workspace.move_candidate(part);
            if self.operator.update_force(&workspace.newton.candidate_mm, &mut workspace.system).is_err() {
                continue;
            }
            let pressure_kpa = &mut workspace.newton.pressure_kpa;
            pressure_kpa.iter_mut().zip(start_kpa.iter().zip(&change_kpa)).for_each(|(p, (start, change))| *p = start + change * part);
            let residual_mn = self.balance(state, workspace).map_err(mechanics)?;
            let is_near = residual_mn <= (1.0 - 0.5 * part) * (before_mn + part * linear_mn) || residual_mn <= goal.residual_mn;
            let is_tame = residual_mn <= GROWTH_LIMIT * (before_mn + linear_mn);
            if is_near || is_tame && descent.is_met(part, self, state, goal, workspace).map_err(mechanics)? {
                workspace.trial_mm.copy_from_slice(&workspace.newton.candidate_mm);
                let defect_mm3 = self.volume_defect_mm3(goal, &flows, &workspace.trial_mm);
                return Ok(Some(Round { flows, residual_mn, defect_mm3, is_full: halving == 0 }));
            }
        }
        workspace.newton.pressure_kpa = start_kpa;
        Ok(None)
    }

    /// V_k(p) = V_k(Y*) + ∂V_k·δ + Σ_l (p_l − p*_l) ∂V_k·W_l.
    fn trial_response(&self, workspace: &StepWorkspace) -> CavityResponse {
        let StepWorkspace { trial_mm, gradients_mm2, yields_mm_per_kpa, newton, .. } = workspace;
        let count = gradients_mm2.len();
        let compliance = DMatrix::from_fn(count, count, |k, l| dot(&gradients_mm2[k], &yields_mm_per_kpa[l]));
        let compliance_mm3_per_kpa = (&compliance + compliance.transpose()) * 0.5;
        let pressure_kpa = DVector::from_column_slice(&newton.pressure_kpa);
        let mut volume_mm3 = DVector::from_vec(self.volumes_mm3(trial_mm)) - &compliance_mm3_per_kpa * pressure_kpa;
        for (volume, gradient) in volume_mm3.iter_mut().zip(gradients_mm2) {
            *volume += dot(gradient, &newton.columns[0]);
        }
        CavityResponse { volume_mm3, compliance_mm3_per_kpa }
    }

    fn volume_defect_mm3(&self, goal: &Goal<'_>, flows: &[VentricleFlow], position_mm: &[Vector3<f64>]) -> f64 {
        let volumes = self.volumes_mm3(position_mm);
        let defect = |v: usize| (volumes[v] - goal.before_mm3[v] + net_outflow_mm3(&flows[v], self.settings.step_s)).abs();
        (0..flows.len()).map(defect).fold(0.0, f64::max)
    }
}

impl StepWorkspace {
    /// δ + Σ (p − p*) W.
    fn write_direction(&mut self, change_kpa: &[f64]) {
        let Self { yields_mm_per_kpa, newton, .. } = self;
        newton.direction_mm.copy_from_slice(&newton.columns[0]);
        for (change, yields) in change_kpa.iter().zip(yields_mm_per_kpa) {
            newton.direction_mm.iter_mut().zip(yields).for_each(|(direction, yielded)| *direction += *yielded * *change);
        }
    }

    fn move_candidate(&mut self, part: f64) {
        let moving = self.trial_mm.iter().zip(&self.newton.direction_mm);
        self.newton.candidate_mm.iter_mut().zip(moving).for_each(|(candidate, (trial, direction))| *candidate = trial + direction * part);
    }
}
