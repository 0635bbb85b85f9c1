//! One coupled step: muscle, springs, data and valves at once, \[Billet2009\] §2.
//!
//! With all forces but the cavity pressures on the right, the position at the end of the step is affine in the pressures,
//!
//! $$Y(p) = y_0 + \sum_k p_k W_k, \qquad y_0 = \tilde K^{-1} F, \quad W_k = \tilde K^{-1} L_k,$$
//!
//! with $L_k$ the force of a unit pressure: $\partial_y V_k$ at rest ([`PressureLoad::Reference`]) or at $Y^*$ ([`PressureLoad::Following`]).
//! The cavities answer as $V_k(p) = V_k(Y^*) + \partial_y V_k \cdot (Y(p) - Y^*)$, and the valves give the pressures. The volume is
//! cubic in $Y$: the linearisation point $Y^*$ moves to $Y(p)$ until the volumes are those that the valves let through.
//! So it is in linear kinematics; for corotational ones see `newton`.

use nalgebra::{DMatrix, DVector, Vector3};

use super::newton::NewtonWorkspace;
use super::substeps::FinerHeart;
use super::{HeartModel, HeartState, ModelSettings, PressureLoad, StepError, VentricleState};
use crate::circulation::{CavityResponse, CirculationError, ValveProblem, VentricleFlow, VentriclePorts};
use crate::mechanics::{Kinematics, MechanicsError, SolveReport, SolveSettings, StepLoad, StepSolver, StepSystem};
use crate::units::{MM3_PER_ML, mm3_from_ml};

/// Rounds of the volume linearisation before a step is given up; 2–4 are usual.
const ROUND_LIMIT: usize = 25;

/// Iterations after which a tangent is given up: another preconditioner or a convex tangent is cheaper.
const TANGENT_ITERATION_LIMIT: usize = 100;

/// Residual that images leave in the balance of a step, relative to the force on the tissue at rest: some micrometres, and less than
/// 0.01 mL of a cavity's volume.
const POSITION_TOLERANCE: f64 = 3e-4;

/// Residual that W may have under images: what it lacks, times a step's change of pressure, is settled afterwards.
const RESPONSE_TOLERANCE: f64 = 3e-2;

/// Farther from rest than this a vertex counts as blown up, mm.
const DISTANCE_LIMIT_MM: f64 = 500.0;

/// Memory of one thread that steps a heart.
#[derive(Debug)]
pub struct StepWorkspace {
    pub(super) solver: StepSolver,
    pub(super) system: StepSystem,
    pub(super) anchors_mm: Vec<Vector3<f64>>,
    /// σC over σ0 a vertex at the step's end.
    pub(super) fraction: Vec<f64>,
    pub(super) stress_kpa: Vec<f64>,
    /// y₀, mm.
    free_mm: Vec<Vector3<f64>>,
    /// Y*, then Y, mm.
    pub(super) trial_mm: Vec<Vector3<f64>>,
    /// ∂V at Y*, mm², one a cavity.
    pub(super) gradients_mm2: Vec<Vec<Vector3<f64>>>,
    /// W, mm/kPa, one a cavity.
    pub(super) yields_mm_per_kpa: Vec<Vec<Vector3<f64>>>,
    /// The pressures whose forces the system holds, kPa.
    settled_kpa: Vec<f64>,
    pub(super) newton: NewtonWorkspace,
    /// How often its model's step has been halved, and what halves it once more.
    pub(super) halving: usize,
    pub(super) finer: Option<Box<FinerHeart>>,
}

/// The end of a step and the work it took.
#[derive(Debug, Clone, PartialEq)]
pub struct StepOutcome {
    /// The heart at the end of the step.
    pub state: HeartState,
    /// Rounds of the volume linearisation.
    pub round_count: usize,
    /// Parts that a step of corotational kinematics was taken in: 1 unless the whole did not converge.
    pub substep_count: usize,
    /// Largest difference between a cavity's volume and what its valves let through, mL.
    pub volume_defect_ml: f64,
    /// How the system was solved the first time.
    pub solve: SolveReport,
}

impl HeartModel {
    /// Memory for stepping this heart; one a thread.
    pub fn workspace(&self) -> StepWorkspace {
        let zeros = || vec![Vector3::zeros(); self.anatomy.mesh.vertex_count()];
        StepWorkspace {
            solver: StepSolver::new(self.solve_settings()),
            system: self.operator.empty_system(),
            anchors_mm: Vec::new(),
            fraction: Vec::new(),
            stress_kpa: Vec::new(),
            free_mm: zeros(),
            trial_mm: zeros(),
            gradients_mm2: self.ventricles.iter().map(|_| zeros()).collect(),
            yields_mm_per_kpa: self.ventricles.iter().map(|_| zeros()).collect(),
            settled_kpa: Vec::new(),
            newton: NewtonWorkspace::default(),
            halving: 0,
            finer: None,
        }
    }

    /// A tangent is given up sooner than a step of linear kinematics, which has no other. Under loads of the heart at rest the W only
    /// carry a step's change of pressure, and what they lack can be settled.
    fn solve_settings(&self) -> SolveSettings {
        match (self.settings.kinematics, self.settings.pressure_load) {
            (Kinematics::Linear, PressureLoad::Reference) => {
                // Who wants the volumes closer than usual wants the positions closer.
                let closer = (self.settings.volume_tolerance_ml / ModelSettings::default().volume_tolerance_ml).clamp(1e-5, 1.0);
                let (relative_tolerance, response_tolerance) = (POSITION_TOLERANCE * closer, RESPONSE_TOLERANCE);
                SolveSettings { relative_tolerance, response_tolerance, ..SolveSettings::default() }
            }
            (Kinematics::Linear, PressureLoad::Following) => SolveSettings::default(),
            (Kinematics::Corotational, _) => SolveSettings { iteration_limit: TANGENT_ITERATION_LIMIT, ..SolveSettings::default() },
        }
    }

    /// One step of the model's length from `state` under the loads of data: (K̃ + K_img) Y = F + F̃_img, \[Billet2009\] §4.2.
    ///
    /// # Errors
    /// [`StepError`] with the time, if a system cannot be solved, the volumes are not met, or the motion blows up.
    pub fn step(&self, state: &HeartState, data: &[&dyn StepLoad], workspace: &mut StepWorkspace) -> Result<StepOutcome, StepError> {
        match self.settings.kinematics {
            Kinematics::Linear => self.linear_step(state, data, workspace),
            Kinematics::Corotational => match self.newton_step(state, data, workspace) {
                Err(error) => self.halved_step(state, data, workspace, error),
                done => done,
            },
        }
    }

    fn linear_step(&self, state: &HeartState, data: &[&dyn StepLoad], workspace: &mut StepWorkspace) -> Result<StepOutcome, StepError> {
        let (time_s, step_s) = (state.time_s, self.settings.step_s);
        let mechanics = |source: MechanicsError| StepError::Mechanics { time_s, step_s, source };
        let circulation = |source: CirculationError| StepError::Circulation { time_s, step_s, source };
        self.assemble(state, data, workspace).map_err(mechanics)?;
        let ports = self.ports(state);
        let before_mm3: Vec<f64> = state.ventricles.iter().map(|ventricle| ventricle.volume_mm3).collect();
        workspace.predict(state, step_s);
        let mut solve = self.solve_free(state, workspace).map_err(mechanics)?;
        let mut defect_mm3 = f64::INFINITY;
        let mut pressure_kpa = DVector::from_iterator(before_mm3.len(), state.ventricles.iter().map(|ventricle| ventricle.pressure_kpa));
        for round_count in 1..=ROUND_LIMIT {
            if round_count > 1 {
                solve.iteration_count += self.solve_yields(workspace).map_err(mechanics)?;
            }
            let response = self.cavity_response(workspace, &pressure_kpa);
            let valves = ValveProblem::new(&response, &before_mm3, &ports, self.valve_resistance(), step_s).map_err(circulation)?;
            let flows = valves.solve().map_err(circulation)?;
            workspace.move_trial(&flows);
            solve.iteration_count += self.settle(&flows, workspace).map_err(mechanics)?;
            pressure_kpa.iter_mut().zip(&flows).for_each(|(pressure, flow)| *pressure = flow.pressure_kpa);
            self.check_distance(state, &workspace.trial_mm)?;
            let after_mm3 = self.volumes_mm3(&workspace.trial_mm);
            defect_mm3 =
                (0..flows.len()).map(|v| (after_mm3[v] - before_mm3[v] + net_outflow_mm3(&flows[v], step_s)).abs()).fold(0.0, f64::max);
            if defect_mm3 <= mm3_from_ml(self.settings.volume_tolerance_ml) {
                let state = self.next_state(state, workspace, &flows, &after_mm3);
                return Ok(StepOutcome { state, round_count, substep_count: 1, volume_defect_ml: defect_mm3 / MM3_PER_ML, solve });
            }
        }
        Err(StepError::VolumeNotMet { time_s, step_s, round_count: ROUND_LIMIT, volume_defect_ml: defect_mm3 / MM3_PER_ML })
    }

    /// All that does not depend on the cavity pressures: F + F̃_img and K_img. In corotational kinematics the prestress, which turns with
    /// the wall, is left to the balance.
    pub(super) fn assemble(&self, state: &HeartState, data: &[&dyn StepLoad], workspace: &mut StepWorkspace) -> Result<(), MechanicsError> {
        let step_s = self.settings.step_s;
        let end_s = state.time_s + step_s;
        let StepWorkspace { system, anchors_mm, fraction, stress_kpa, .. } = workspace;
        let anchors = self.settings.base_motion.as_ref().map(|motion| {
            motion.position_mm(end_s, anchors_mm);
            anchors_mm.as_slice()
        });
        self.operator.assemble(&state.motion, anchors, system)?;
        self.write_active_stress(end_s, fraction, stress_kpa);
        self.operator.add_contraction(stress_kpa, system)?;
        if self.settings.kinematics == Kinematics::Linear {
            for (model, ventricle) in self.ventricles.iter().zip(&state.ventricles) {
                for (force, gradient) in system.force_mn.iter_mut().zip(model.rest_gradient_mm2.iter()) {
                    *force -= gradient * ventricle.rest_pressure_kpa;
                }
            }
        }
        for load in data {
            load.add_to(&state.motion, state.time_s, step_s, system);
        }
        Ok(())
    }

    /// y₀ and the first W together: one pass over the factor. What is solved for is $Y(p^*) = \tilde K^{-1}(F + \sum_k p^*_k L_k)$ with the
    /// pressures of the last step, from $Y^*$, and then $y_0 = Y(p^*) - \sum_k p^*_k W_k$: so $Y(p)$ errs by no more than the error of W
    /// times the step's change of pressure, until it is settled.
    fn solve_free(&self, state: &HeartState, workspace: &mut StepWorkspace) -> Result<SolveReport, MechanicsError> {
        self.write_gradients(workspace);
        self.write_pressure_loads(workspace);
        let StepWorkspace { solver, system, free_mm, trial_mm, yields_mm_per_kpa, settled_kpa, .. } = workspace;
        settled_kpa.clear();
        settled_kpa.extend(state.ventricles.iter().map(|ventricle| ventricle.pressure_kpa));
        for (pressure_kpa, load) in settled_kpa.iter().zip(&*yields_mm_per_kpa) {
            add_scaled(&mut system.force_mn, *pressure_kpa, load);
        }
        free_mm.copy_from_slice(trial_mm);
        let report = solver.solve(&self.operator, system, free_mm, yields_mm_per_kpa)?;
        for (ventricle, yields) in state.ventricles.iter().zip(&*yields_mm_per_kpa) {
            add_scaled(free_mm, -ventricle.pressure_kpa, yields);
        }
        Ok(report)
    }

    /// Solves Y again under the pressures found, and y₀ with it, where W was too coarse for the change of pressure. Gives the iterations.
    fn settle(&self, flows: &[VentricleFlow], workspace: &mut StepWorkspace) -> Result<usize, MechanicsError> {
        let StepWorkspace { solver, system, free_mm, trial_mm, yields_mm_per_kpa, settled_kpa, .. } = workspace;
        let changes = flows.iter().zip(&*settled_kpa).map(|(flow, settled)| flow.pressure_kpa - settled);
        if self.settings.pressure_load == PressureLoad::Following || solver.responses_suffice(changes) {
            return Ok(0);
        }
        for ((flow, settled), model) in flows.iter().zip(settled_kpa).zip(&self.ventricles) {
            add_scaled(&mut system.force_mn, flow.pressure_kpa - *settled, &model.rest_gradient_mm2);
            *settled = flow.pressure_kpa;
        }
        let report = solver.settle(&self.operator, system, trial_mm)?;
        free_mm.copy_from_slice(trial_mm);
        for (flow, yields) in flows.iter().zip(yields_mm_per_kpa) {
            add_scaled(free_mm, -flow.pressure_kpa, yields);
        }
        Ok(report.iteration_count)
    }

    /// ∂V, and W where the load follows the surface, at a new Y*; nothing is solved where it does not.
    fn solve_yields(&self, workspace: &mut StepWorkspace) -> Result<usize, MechanicsError> {
        self.write_gradients(workspace);
        if self.settings.pressure_load == PressureLoad::Reference {
            return Ok(0);
        }
        self.write_pressure_loads(workspace);
        let StepWorkspace { solver, system, yields_mm_per_kpa, .. } = workspace;
        let report = solver.solve_responses(&self.operator, &system.stiffness_mn_per_mm, yields_mm_per_kpa)?;
        Ok(report.iteration_count)
    }

    /// The forces of a unit pressure, where W will be.
    fn write_pressure_loads(&self, workspace: &mut StepWorkspace) {
        let StepWorkspace { gradients_mm2, yields_mm_per_kpa, .. } = workspace;
        for ((model, gradient), load) in self.ventricles.iter().zip(gradients_mm2).zip(yields_mm_per_kpa) {
            match self.settings.pressure_load {
                PressureLoad::Reference => load.copy_from_slice(&model.rest_gradient_mm2),
                PressureLoad::Following => load.copy_from_slice(gradient),
            }
        }
    }

    fn write_gradients(&self, workspace: &mut StepWorkspace) {
        for ((_, cavity), gradient) in self.anatomy.cavities.iter().zip(&mut workspace.gradients_mm2) {
            gradient.fill(Vector3::zeros());
            cavity.add_gradient(&workspace.trial_mm, 1.0, gradient);
        }
    }

    /// V_k(p) = V_k(Y*) + ∂V_k·(y₀ − Y*) + Σ_l C_kl p_l with C_kl = ∂V_k·W_l.
    ///
    /// C is symmetric only where the loads are the gradients: not at a moved surface under loads of the heart at rest, nor where the
    /// data's stiffness is not symmetric. The valves see its symmetric part; the rest acts at `pressure_kpa`, those of the last round, so
    /// that the rounds end where the volumes are met.
    fn cavity_response(&self, workspace: &StepWorkspace, pressure_kpa: &DVector<f64>) -> CavityResponse {
        let StepWorkspace { free_mm, trial_mm, gradients_mm2, yields_mm_per_kpa, .. } = workspace;
        let count = gradients_mm2.len();
        let mut volume_mm3 = DVector::from_vec(self.volumes_mm3(trial_mm));
        for (volume, gradient) in volume_mm3.iter_mut().zip(gradients_mm2) {
            *volume += gradient.iter().zip(free_mm).zip(trial_mm).map(|((g, free), trial)| g.dot(&(free - trial))).sum::<f64>();
        }
        let compliance = DMatrix::from_fn(count, count, |k, l| dot(&gradients_mm2[k], &yields_mm_per_kpa[l]));
        let compliance_mm3_per_kpa = (&compliance + compliance.transpose()) * 0.5;
        volume_mm3 += (compliance - &compliance_mm3_per_kpa) * pressure_kpa;
        CavityResponse { volume_mm3, compliance_mm3_per_kpa }
    }

    pub(super) fn volumes_mm3(&self, position_mm: &[Vector3<f64>]) -> Vec<f64> {
        self.anatomy.cavities.iter().map(|(_, cavity)| cavity.volume_mm3(position_mm)).collect()
    }

    pub(super) fn ports(&self, state: &HeartState) -> Vec<VentriclePorts> {
        let step_s = self.settings.step_s;
        let port = |(model, ventricle): (&super::model::VentricleModel, &VentricleState)| VentriclePorts {
            atrial_pressure_kpa: model.atrium.pressure_kpa(state.time_s + step_s),
            artery: model.artery.response(ventricle.capacitor_pressure_kpa, step_s),
        };
        self.ventricles.iter().zip(&state.ventricles).map(port).collect()
    }

    pub(super) fn check_distance(&self, state: &HeartState, position_mm: &[Vector3<f64>]) -> Result<(), StepError> {
        for (vertex, (y, x)) in position_mm.iter().zip(self.anatomy.mesh.vertices_mm()).enumerate() {
            let distance_mm = (y - x).norm();
            if distance_mm.is_nan() || distance_mm > DISTANCE_LIMIT_MM {
                return Err(StepError::BlownUp { time_s: state.time_s, step_s: self.settings.step_s, vertex, distance_mm });
            }
        }
        Ok(())
    }

    pub(super) fn next_state(
        &self,
        state: &HeartState,
        workspace: &StepWorkspace,
        flows: &[VentricleFlow],
        volumes_mm3: &[f64],
    ) -> HeartState {
        let step_s = self.settings.step_s;
        let time_s = state.time_s + step_s;
        let advance = |(ventricle, before): (usize, &VentricleState)| {
            let (model, flow) = (&self.ventricles[ventricle], &flows[ventricle]);
            let capacitor_pressure_kpa = model.artery.advance_kpa(before.capacitor_pressure_kpa, flow.outflow_ml_per_s, step_s);
            VentricleState {
                volume_mm3: volumes_mm3[ventricle],
                pressure_kpa: flow.pressure_kpa,
                capacitor_pressure_kpa,
                arterial_pressure_kpa: model.artery.arterial_pressure_kpa(capacitor_pressure_kpa, flow.outflow_ml_per_s),
                atrial_pressure_kpa: model.atrium.pressure_kpa(time_s),
                outflow_ml_per_s: flow.outflow_ml_per_s,
                inflow_ml_per_s: flow.inflow_ml_per_s,
                phase: before.phase.after(flow.open),
                ..*before
            }
        };
        HeartState {
            time_s,
            motion: self.operator.advance(&state.motion, workspace.trial_mm.clone()),
            ventricles: state.ventricles.iter().enumerate().map(advance).collect(),
        }
    }
}

impl StepWorkspace {
    /// Y* of the first round: the motion goes on as it is.
    pub(super) fn predict(&mut self, state: &HeartState, step_s: f64) {
        let moving = state.motion.position_mm.iter().zip(&state.motion.velocity_mm_per_s);
        for (trial, (y, v)) in self.trial_mm.iter_mut().zip(moving) {
            *trial = y + v * step_s;
        }
    }

    /// Y = y₀ + Σ p W.
    fn move_trial(&mut self, flows: &[VentricleFlow]) {
        self.trial_mm.copy_from_slice(&self.free_mm);
        for (flow, yields) in flows.iter().zip(&self.yields_mm_per_kpa) {
            add_scaled(&mut self.trial_mm, flow.pressure_kpa, yields);
        }
    }
}

/// h (q_out − q_in), mm³.
pub(super) fn net_outflow_mm3(flow: &VentricleFlow, step_s: f64) -> f64 {
    mm3_from_ml((flow.outflow_ml_per_s - flow.inflow_ml_per_s) * step_s)
}

fn add_scaled(sum: &mut [Vector3<f64>], factor: f64, add: &[Vector3<f64>]) {
    for (sum, add) in sum.iter_mut().zip(add) {
        *sum += add * factor;
    }
}

pub(super) fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}
