//! One step of all tangents, behind the step of the heart that they are tangents of.

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;

use super::super::contraction::Contraction;
use super::super::model::VentricleModel;
use super::super::step::dot;
use super::super::{HeartModel, HeartState, PressureLoad, RegionalParameter, StepError, StepWorkspace, TangentError, VentricleState};
use super::rates::{LawRate, ModelRate};
use crate::circulation::{CirculationError, OpenValves, Phase, PortRates, ValveRates, VentricleFlow, VentricleFlowRate, VentriclePorts};
use crate::mechanics::{ColumnSolver, ContractionRate, Kinematics, MechanicsError, MotionState, StepLoad};

/// Columns that are solved together; fixed, so that results do not depend on the number of threads.
const COLUMNS_AT_ONCE: usize = 10;

/// Relative residual that an iterative solve of a column may leave.
const RELATIVE_TOLERANCE: f64 = 1e-9;

/// The derivatives of the heart's state by all parameters, and what they go on with.
pub(super) struct TangentColumns {
    columns: Vec<Column>,
    chunks: Vec<ChunkMemory>,
}

/// One parameter.
struct Column {
    rate: ModelRate,
    /// Derivatives in the places of what they are derivatives of.
    state: HeartState,
    /// Whether anything of the state is not zero.
    has_begun: bool,
}

/// Memory of columns that are solved together.
#[derive(Default)]
struct ChunkMemory {
    solver: ColumnSolver,
    forces_mn: Vec<Vec<Vector3<f64>>>,
    damped_mm_per_s: Vec<Vec<Vector3<f64>>>,
    fraction_rates: Vec<f64>,
    stress_rates_kpa: Vec<f64>,
}

/// The step that has been taken, as all its tangents see it.
struct TakenStep<'a> {
    model: &'a HeartModel,
    before: &'a HeartState,
    after: &'a HeartState,
    workspace: &'a StepWorkspace,
    /// Time since the latest depolarisation a vertex at the step's end, s.
    since_s: Vec<Option<f64>>,
    /// ∂V at the step's end, mm², one a cavity.
    gradients_mm2: Vec<Vec<Vector3<f64>>>,
    flows: Vec<VentricleFlow>,
    ports: Vec<VentriclePorts>,
    compliance_mm3_per_kpa: DMatrix<f64>,
}

impl TangentColumns {
    /// The derivatives of the start.
    ///
    /// # Errors
    /// [`TangentError::NoTangent`] for a parameter or a model without tangent.
    pub(super) fn new(
        model: &HeartModel,
        start: &HeartState,
        loads: &[&dyn StepLoad],
        parameters: &[RegionalParameter],
    ) -> Result<Self, TangentError> {
        check(model, loads)?;
        let column = |parameter: &RegionalParameter| {
            let rate = ModelRate::new(model, *parameter)?;
            Ok(Column { state: initial_rates(model, &rate, start), rate, has_begun: false })
        };
        let columns = parameters.iter().map(column).collect::<Result<_, TangentError>>()?;
        Ok(Self { columns, chunks: Vec::new() })
    }

    /// The derivatives of the heart's state, one a parameter.
    pub(super) fn states(&self) -> impl Iterator<Item = &HeartState> {
        self.columns.iter().map(|column| &column.state)
    }

    /// Takes them over the step from `before` to `after` that has left `workspace`.
    pub(super) fn step(
        &mut self,
        model: &HeartModel,
        before: &HeartState,
        after: &HeartState,
        workspace: &StepWorkspace,
    ) -> Result<(), TangentError> {
        let taken = TakenStep::new(model, before, after, workspace);
        let (time_s, step_s) = (before.time_s, model.settings.step_s);
        self.chunks.resize_with(self.columns.len().div_ceil(COLUMNS_AT_ONCE), ChunkMemory::default);
        let chunks = self.columns.par_chunks_mut(COLUMNS_AT_ONCE).zip(&mut self.chunks);
        chunks
            .map(|(columns, memory)| {
                let responses = taken.begun_responses(columns, memory).map_err(|source| StepError::Mechanics { time_s, step_s, source })?;
                taken.advance(columns, responses).map_err(|source| StepError::Circulation { time_s, step_s, source })
            })
            .collect::<Result<(), StepError>>()?;
        Ok(())
    }
}

impl<'a> TakenStep<'a> {
    fn new(model: &'a HeartModel, before: &'a HeartState, after: &'a HeartState, workspace: &'a StepWorkspace) -> Self {
        let vertex_count = model.anatomy.mesh.vertex_count();
        let gradient = |(_, cavity): &(_, crate::mesh::Cavity)| {
            let mut gradient = vec![Vector3::zeros(); vertex_count];
            cavity.add_gradient(&after.motion.position_mm, 1.0, &mut gradient);
            gradient
        };
        let gradients_mm2: Vec<_> = model.anatomy.cavities.iter().map(gradient).collect();
        let count = gradients_mm2.len();
        Self {
            since_s: (0..vertex_count).map(|vertex| model.rhythm().since_depolarisation_s(vertex, after.time_s)).collect(),
            compliance_mm3_per_kpa: DMatrix::from_fn(count, count, |k, l| dot(&gradients_mm2[k], &workspace.yields_mm_per_kpa[l])),
            gradients_mm2,
            flows: after.ventricles.iter().map(flow).collect(),
            ports: model.ports(before),
            model,
            before,
            after,
            workspace,
        }
    }

    /// dy₀ of the columns, mm; empty where it is zero because nothing depends on the parameter yet.
    fn begun_responses(&self, columns: &mut [Column], memory: &mut ChunkMemory) -> Result<Vec<Vec<Vector3<f64>>>, MechanicsError> {
        let vertex_count = self.model.anatomy.mesh.vertex_count();
        let mut forces_mn = std::mem::take(&mut memory.forces_mn);
        forces_mn.resize_with(columns.len(), Vec::new);
        for (column, force_mn) in columns.iter_mut().zip(&mut forces_mn) {
            force_mn.clear();
            force_mn.resize(vertex_count, Vector3::zeros());
            self.add_own_force(column, memory, force_mn)?;
            column.has_begun |= force_mn.iter().any(|force| *force != Vector3::zeros());
        }
        let begun: Vec<&Column> = columns.iter().filter(|column| column.has_begun).collect();
        let mut right: Vec<_> = columns.iter().zip(&mut forces_mn).filter(|(c, _)| c.has_begun).map(|(_, f)| std::mem::take(f)).collect();
        let motions: Vec<&MotionState> = begun.iter().map(|column| &column.state.motion).collect();
        let StepWorkspace { solver, system, .. } = self.workspace;
        let operator = &self.model.operator;
        operator.add_history(&motions, &mut memory.damped_mm_per_s, &mut right)?;
        let guesses: Vec<&[Vector3<f64>]> = motions.iter().map(|motion| motion.position_mm.as_slice()).collect();
        memory.solver.solve(solver, operator, system, &mut right, &guesses, RELATIVE_TOLERANCE)?;
        let mut right = right.into_iter();
        let place = |column: &Column| if column.has_begun { right.next().unwrap_or_default() } else { Vec::new() };
        Ok(columns.iter().map(place).collect())
    }

    /// What the parameter itself changes of the forces, and the prestress that has changed with it, mN.
    fn add_own_force(&self, column: &Column, memory: &mut ChunkMemory, force_mn: &mut [Vector3<f64>]) -> Result<(), MechanicsError> {
        let Self { model, workspace, .. } = self;
        let tissue = model.operator.myocardium();
        if self.write_stress_rates(&column.rate, memory) {
            tissue.add_contraction_force(&memory.stress_rates_kpa, force_mn)?;
        }
        for (ventricle, rate) in model.ventricles.iter().zip(&column.state.ventricles) {
            if rate.rest_pressure_kpa != 0.0 {
                let gradient = ventricle.rest_gradient_mm2.iter();
                force_mn.iter_mut().zip(gradient).for_each(|(force, gradient)| *force -= gradient * rate.rest_pressure_kpa);
            }
        }
        if let Some(passive) = &column.rate.passive {
            let anchors = model.settings.base_motion.as_ref().map(|_| workspace.anchors_mm.as_slice());
            passive.add_force(tissue, &self.after.motion, anchors, force_mn)?;
        }
        Ok(())
    }

    /// dσC a tetrahedron: $d\sigma_0$ times the mean of its corners' fractions, and $\sigma_0$ times the mean of their derivatives. False
    /// where all are zero.
    fn write_stress_rates(&self, rate: &ModelRate, memory: &mut ChunkMemory) -> bool {
        let ChunkMemory { fraction_rates, stress_rates_kpa, .. } = memory;
        let Contraction { laws, peak_kpa } = &self.model.contraction;
        let tetrahedra = self.model.anatomy.mesh.tetrahedra();
        let mean = |of: &[f64], corners: &[usize; 4]| corners.iter().map(|&vertex| of[vertex]).sum::<f64>() / 4.0;
        stress_rates_kpa.clear();
        match &rate.peak_kpa {
            Some(peak_rates) => stress_rates_kpa.extend(tetrahedra.iter().zip(peak_rates).map(|(corners, peak_rate)| match *peak_rate {
                0.0 => 0.0,
                peak_rate => peak_rate * mean(&self.workspace.fraction, corners),
            })),
            None if rate.has_law() => stress_rates_kpa.resize(tetrahedra.len(), 0.0),
            None => return false,
        }
        if rate.has_law() {
            fraction_rates.clear();
            fraction_rates.extend(self.since_s.iter().zip(laws).enumerate().map(|(vertex, (since_s, law))| {
                let Some(since_s) = *since_s else { return 0.0 };
                let later_s = rate.depolarisation_s.as_ref().map_or(0.0, |rates| rates[vertex]);
                match &rate.contraction {
                    None => law.stress_since_rate_kpa(&ContractionRate::default(), since_s, -later_s),
                    Some(LawRate { shares, .. }) if shares[vertex] == 0.0 => 0.0,
                    Some(LawRate { rate, shares }) => law.stress_since_rate_kpa(rate, since_s, 0.0) * shares[vertex],
                }
            }));
            let stresses = stress_rates_kpa.iter_mut().zip(tetrahedra).zip(peak_kpa);
            stresses.for_each(|((stress, corners), peak_kpa)| *stress += peak_kpa * mean(fraction_rates, corners));
        }
        stress_rates_kpa.iter().any(|stress| *stress != 0.0)
    }

    /// The valves give dp, and dY is then known: the states at the step's end.
    fn advance(&self, columns: &mut [Column], responses: Vec<Vec<Vector3<f64>>>) -> Result<(), CirculationError> {
        let Self { model, compliance_mm3_per_kpa, flows, ports, .. } = self;
        let step_s = model.settings.step_s;
        let valves = ValveRates::new(compliance_mm3_per_kpa, flows, ports, model.valve_resistance(), step_s)?;
        for (column, mut response) in columns.iter_mut().zip(responses) {
            let rates: Vec<PortRates> = (0..flows.len()).map(|ventricle| self.port_rates(column, ventricle, &response)).collect();
            let flow_rates = valves.solve(&rates);
            column.has_begun |= flow_rates.iter().any(|rate| rate.pressure_kpa != 0.0);
            if column.has_begun {
                response.resize(model.anatomy.mesh.vertex_count(), Vector3::zeros());
                for (rate, yields) in flow_rates.iter().zip(&self.workspace.yields_mm_per_kpa) {
                    response.iter_mut().zip(yields).for_each(|(y, yielded)| *y += yielded * rate.pressure_kpa);
                }
            } else {
                response.clone_from(&column.state.motion.position_mm);
            }
            column.state = self.next_rates(column, response, &flow_rates);
        }
        Ok(())
    }

    fn port_rates(&self, column: &Column, ventricle: usize, response_mm: &[Vector3<f64>]) -> PortRates {
        let VentricleModel { artery, atrium, .. } = &self.model.ventricles[ventricle];
        let (rate, state) = (&column.rate.ventricles[ventricle], &column.state.ventricles[ventricle]);
        let capacitor = (self.before.ventricles[ventricle].capacitor_pressure_kpa, state.capacitor_pressure_kpa);
        PortRates {
            atrial_pressure_kpa: atrium.pressure_rate_kpa(&rate.atrium, self.after.time_s),
            artery: artery.response_rate(&rate.artery, capacitor, self.model.settings.step_s),
            valve_resistance_kpa_s_per_ml: column.rate.valve_resistance,
            volume_before_mm3: state.volume_mm3,
            free_volume_mm3: dot(&self.gradients_mm2[ventricle], response_mm),
        }
    }

    fn next_rates(&self, column: &Column, position_mm: Vec<Vector3<f64>>, flow_rates: &[VentricleFlowRate]) -> HeartState {
        let step_s = self.model.settings.step_s;
        let advance = |(ventricle, rate): (usize, &VentricleState)| {
            let (own, flow_rate) = (&column.rate.ventricles[ventricle], &flow_rates[ventricle]);
            let VentricleModel { artery, atrium, .. } = &self.model.ventricles[ventricle];
            let flow = (self.after.ventricles[ventricle].outflow_ml_per_s, flow_rate.outflow_ml_per_s);
            let capacitor = (self.before.ventricles[ventricle].capacitor_pressure_kpa, rate.capacitor_pressure_kpa);
            let capacitor_pressure_kpa = artery.advance_rate_kpa(&own.artery, capacitor, flow, step_s);
            VentricleState {
                volume_mm3: dot(&self.gradients_mm2[ventricle], &position_mm),
                pressure_kpa: flow_rate.pressure_kpa,
                capacitor_pressure_kpa,
                arterial_pressure_kpa: artery.arterial_pressure_rate_kpa(&own.artery, capacitor_pressure_kpa, flow),
                atrial_pressure_kpa: atrium.pressure_rate_kpa(&own.atrium, self.after.time_s),
                outflow_ml_per_s: flow_rate.outflow_ml_per_s,
                inflow_ml_per_s: flow_rate.inflow_ml_per_s,
                phase: self.after.ventricles[ventricle].phase,
                ..*rate
            }
        };
        HeartState {
            time_s: self.after.time_s,
            ventricles: column.state.ventricles.iter().enumerate().map(advance).collect(),
            motion: self.model.operator.advance(&column.state.motion, position_mm),
        }
    }
}

/// Which models have no tangents.
fn check(model: &HeartModel, loads: &[&dyn StepLoad]) -> Result<(), TangentError> {
    let refuse = |parameter, reason| Err(TangentError::NoTangent { parameter, reason });
    if model.settings.kinematics != Kinematics::Linear {
        return refuse("kinematics", "those of large rotations are not differentiated");
    }
    if model.settings.pressure_load != PressureLoad::Reference {
        return refuse("pressure_load", "pressures that follow the surface are not differentiated in linear kinematics");
    }
    if !loads.is_empty() {
        return refuse("loads", "the loads of data are not differentiated");
    }
    Ok(())
}

/// The derivatives of [`HeartModel::initial_state`]: the mesh rests, under pressures that change.
fn initial_rates(model: &HeartModel, rate: &ModelRate, start: &HeartState) -> HeartState {
    let zeros = vec![Vector3::zeros(); model.anatomy.mesh.vertex_count()];
    let of = |(ventricle, state): (usize, &VentricleState)| {
        let own = &rate.ventricles[ventricle];
        let atrial_pressure_kpa = model.ventricles[ventricle].atrium.pressure_rate_kpa(&own.atrium, start.time_s);
        VentricleState {
            volume_mm3: 0.0,
            pressure_kpa: atrial_pressure_kpa,
            capacitor_pressure_kpa: own.initial_capacitor_kpa,
            arterial_pressure_kpa: own.initial_capacitor_kpa,
            atrial_pressure_kpa,
            outflow_ml_per_s: 0.0,
            inflow_ml_per_s: 0.0,
            rest_pressure_kpa: atrial_pressure_kpa,
            ..*state
        }
    };
    HeartState {
        time_s: start.time_s,
        motion: MotionState::at_rest(zeros),
        ventricles: start.ventricles.iter().enumerate().map(of).collect(),
    }
}

/// The flow that a state was reached with; its open valves are those of its phase.
fn flow(state: &VentricleState) -> VentricleFlow {
    let open = match state.phase {
        Phase::Filling => OpenValves::Inflow,
        Phase::Ejection if state.inflow_ml_per_s > 0.0 => OpenValves::Both,
        Phase::Ejection => OpenValves::Outflow,
        Phase::IsovolumetricContraction | Phase::IsovolumetricRelaxation => OpenValves::Neither,
    };
    let VentricleState { pressure_kpa, outflow_ml_per_s, inflow_ml_per_s, .. } = *state;
    VentricleFlow { pressure_kpa, outflow_ml_per_s, inflow_ml_per_s, open }
}
