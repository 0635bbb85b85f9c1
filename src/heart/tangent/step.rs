//! One step of all tangents, behind the step of the heart that they are tangents of.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::super::contraction::Contraction;
use super::super::lead_in::{LeadIn, hold_artery};
use super::super::model::VentricleModel;
use super::super::step::dot;
use super::super::{HeartModel, HeartState, PressureLoad, RegionalParameter, StepError, StepWorkspace, TangentError, VentricleState};
use super::internal_force::ForceMemory;
use super::linearised::{LinearisedMemory, LinearisedStep, RELATIVE_TOLERANCE};
use super::rates::{LawRate, ModelRate};
use crate::circulation::{AtrialPressureRate, CirculationError, PortRates, ValveRates, VentricleFlowRate};
use crate::mechanics::{ColumnSolver, ContractionRate, HistoryMemory, Kinematics, MechanicsError, MotionState, StepLoad};
use crate::mesh::SurfaceTag;

/// Most columns that are solved together.
const COLUMN_LIMIT: usize = 40;
/// Groups that the columns of an iterative solve are split into.
const ITERATIVE_SHARES: usize = 2;

/// The derivatives of the heart's state by all parameters, and what they go on with.
pub(super) struct TangentColumns {
    columns: Vec<Column>,
    chunks: Vec<ChunkMemory>,
    linearised: LinearisedMemory,
}

/// One parameter.
struct Column {
    rate: ModelRate,
    /// Derivatives of the state before the last step, in the places of what they are derivatives of.
    before: HeartState,
    /// The same after it.
    after: HeartState,
    /// Whether anything of the state is not zero.
    has_begun: bool,
}

/// Memory of columns that are solved together.
#[derive(Default)]
struct ChunkMemory {
    solver: ColumnSolver,
    spare_mn: Vec<Vec<Vector3<f64>>>,
    history: HistoryMemory,
    fraction_rates: Vec<f64>,
    stress_rates_kpa: Vec<f64>,
    internal: ForceMemory,
}

impl TangentColumns {
    /// The derivatives of the heart at rest.
    ///
    /// # Errors
    /// [`TangentError::NoTangent`] for a parameter or a model without tangent.
    pub(super) fn new(
        model: &HeartModel,
        lead_in: &LeadIn,
        has_loads: bool,
        parameters: &[RegionalParameter],
    ) -> Result<Self, TangentError> {
        if model.settings.kinematics == Kinematics::Linear && model.settings.pressure_load != PressureLoad::Reference {
            let reason = "pressures that follow the surface are not differentiated in linear kinematics";
            return Err(TangentError::NoTangent { parameter: "pressure_load", reason });
        }
        let column = |parameter: &RegionalParameter| {
            let rate = ModelRate::new(model, *parameter, has_loads)?;
            let start = rest_rates(model, &rate, lead_in);
            Ok(Column { before: start.clone(), after: start, rate, has_begun: false })
        };
        let columns = parameters.iter().map(column).collect::<Result<_, TangentError>>()?;
        Ok(Self { columns, chunks: Vec::new(), linearised: LinearisedMemory::default() })
    }

    /// The derivatives of the heart's state before and after the last step, one pair a parameter.
    pub(super) fn rates(&self) -> impl Iterator<Item = (&HeartState, &HeartState)> {
        self.columns.iter().map(|column| (&column.before, &column.after))
    }

    /// The last derivatives.
    pub(super) fn into_rates(self) -> impl Iterator<Item = HeartState> {
        self.columns.into_iter().map(|column| column.after)
    }

    /// What is done to the arteries after a step that leads to the start.
    pub(super) fn hold_arteries(&mut self) {
        for Column { rate, after, .. } in &mut self.columns {
            for (ventricle, own) in after.ventricles.iter_mut().zip(&rate.ventricles) {
                hold_artery(ventricle, own.initial_capacitor_kpa);
            }
        }
    }

    /// Takes them over the step from `before` to `after` that has left `workspace`.
    ///
    /// # Errors
    /// As [`super::simulate_with_tangents`].
    pub(super) fn step(
        &mut self,
        model: &HeartModel,
        loads: &[&dyn StepLoad],
        before: &HeartState,
        after: &HeartState,
        workspace: &StepWorkspace,
    ) -> Result<(), TangentError> {
        let Self { columns, chunks, linearised } = self;
        let taken = LinearisedStep::new(model, loads, (before, after), workspace, linearised)?;
        let (time_s, step_s) = (before.time_s, model.settings.step_s);
        let chunk = columns.len().div_ceil(taken.share_count()).clamp(1, COLUMN_LIMIT);
        chunks.resize_with(columns.len().div_ceil(chunk), ChunkMemory::default);
        columns
            .par_chunks_mut(chunk)
            .zip(chunks)
            .map(|(columns, memory)| {
                taken.respond(columns, memory).map_err(|source| StepError::Mechanics { time_s, step_s, source })?;
                taken.advance(columns).map_err(|source| StepError::Circulation { time_s, step_s, source })
            })
            .collect::<Result<(), StepError>>()?;
        Ok(())
    }
}

impl LinearisedStep<'_> {
    /// Groups that the columns are split into. A column of a direct solve comes out the same whatever stands beside it, and every thread has
    /// a group; those of iterative solves do not quite, and the split must not depend on the number of threads, so that results do not.
    fn share_count(&self) -> usize {
        let is_direct = !self.is_corotational() && !self.system.has_stiffness();
        if is_direct { rayon::current_num_threads() } else { ITERATIVE_SHARES }
    }

    /// Moves the derivatives on: what was after the last step is before this one, and dy₀ is where the positions after it will be.
    fn respond(&self, columns: &mut [Column], memory: &mut ChunkMemory) -> Result<(), MechanicsError> {
        let vertex_count = self.model.anatomy.mesh.vertex_count();
        let mut right = Vec::with_capacity(columns.len());
        for column in columns.iter_mut() {
            std::mem::swap(&mut column.before, &mut column.after);
            let mut force_mn = memory.spare_mn.pop().unwrap_or_default();
            force_mn.clear();
            force_mn.resize(vertex_count, Vector3::zeros());
            self.add_own_force(column, memory, &mut force_mn)?;
            column.has_begun |= force_mn.iter().any(|force| *force != Vector3::zeros());
            if column.has_begun { right.push(force_mn) } else { memory.spare_mn.push(force_mn) }
        }
        let motions: Vec<&MotionState> = columns.iter().filter(|column| column.has_begun).map(|column| &column.before.motion).collect();
        let operator = &self.model.operator;
        operator.add_history(&motions, &mut memory.history, &mut right)?;
        let guesses: Vec<&[Vector3<f64>]> = motions.iter().map(|motion| motion.position_mm.as_slice()).collect();
        memory.solver.solve(&self.workspace.solver, operator, self.system, &mut right, &guesses, RELATIVE_TOLERANCE)?;
        for (column, mut response) in columns.iter_mut().filter(|column| column.has_begun).zip(right) {
            std::mem::swap(&mut column.after.motion.position_mm, &mut response);
            memory.spare_mn.push(response);
        }
        Ok(())
    }

    /// What the parameter itself changes of the forces, and what the state before the step changes otherwise than by inertia and
    /// damping, mN.
    fn add_own_force(&self, column: &Column, memory: &mut ChunkMemory, force_mn: &mut [Vector3<f64>]) -> Result<(), MechanicsError> {
        let Self { model, workspace, after, .. } = self;
        let (tissue, rate) = (model.operator.myocardium(), &column.rate);
        if !self.write_stress_rates(rate, memory) {
            memory.stress_rates_kpa.clear();
        }
        for (ventricle, state) in column.before.ventricles.iter().enumerate() {
            if state.rest_pressure_kpa != 0.0 {
                let gradient = self.prestress_mm2(ventricle).iter();
                force_mn.iter_mut().zip(gradient).for_each(|(force, gradient)| *force -= gradient * state.rest_pressure_kpa);
            }
        }
        let anchors = model.settings.base_motion.as_ref().map(|_| workspace.anchors_mm.as_slice());
        if self.is_corotational() {
            let ChunkMemory { stress_rates_kpa, internal, .. } = memory;
            self.internal_force().subtract_rate(rate, &column.before.motion, stress_rates_kpa, internal, force_mn)?;
            if let Some(passive) = &rate.passive {
                passive.add_outer_force(tissue, &after.motion, anchors, force_mn)?;
            }
        } else {
            if !memory.stress_rates_kpa.is_empty() {
                tissue.add_contraction_force(&memory.stress_rates_kpa, force_mn)?;
            }
            if let Some(passive) = &rate.passive {
                passive.add_force(tissue, &after.motion, anchors, force_mn)?;
            }
        }
        let gain_rate = |tag: SurfaceTag| f64::from(rate.gain_surface == Some(tag));
        if column.has_begun || rate.gain_surface.is_some() {
            self.loads.iter().for_each(|load| load.add_force(&column.before.motion.position_mm, &gain_rate, force_mn));
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

    /// The valves give dp, and dY is then known: the derivatives at the step's end.
    fn advance(&self, columns: &mut [Column]) -> Result<(), CirculationError> {
        let Self { model, compliance_mm3_per_kpa, flows, ports, .. } = self;
        let valves = ValveRates::new(compliance_mm3_per_kpa, flows, ports, model.valve_resistance(), model.settings.step_s)?;
        for column in columns {
            let rates: Vec<PortRates> = (0..flows.len()).map(|ventricle| self.port_rates(column, ventricle)).collect();
            let flow_rates = valves.solve(&rates);
            column.has_begun |= flow_rates.iter().any(|rate| rate.pressure_kpa != 0.0);
            if column.has_begun {
                let response = &mut column.after.motion.position_mm;
                for (rate, yields) in flow_rates.iter().zip(self.yields_mm_per_kpa) {
                    response.iter_mut().zip(yields).for_each(|(y, yielded)| *y += yielded * rate.pressure_kpa);
                }
                model.operator.complete(&column.before.motion, &mut column.after.motion);
            }
            let next = |ventricle| self.next_rates(column, ventricle, &flow_rates[ventricle]);
            column.after.ventricles = (0..flow_rates.len()).map(next).collect();
            column.after.time_s = self.after.time_s;
        }
        Ok(())
    }

    fn port_rates(&self, column: &Column, ventricle: usize) -> PortRates {
        let VentricleModel { artery, atrium, .. } = &self.model.ventricles[ventricle];
        let (rate, state) = (&column.rate.ventricles[ventricle], &column.before.ventricles[ventricle]);
        let capacitor = (self.before.ventricles[ventricle].capacitor_pressure_kpa, state.capacitor_pressure_kpa);
        PortRates {
            atrial_pressure_kpa: atrium.pressure_rate_kpa(&rate.atrium, self.after.time_s),
            artery: artery.response_rate(&rate.artery, capacitor, self.model.settings.step_s),
            valve_resistance_kpa_s_per_ml: column.rate.valve_resistance,
            volume_before_mm3: state.volume_mm3,
            free_volume_mm3: dot(&self.gradients_mm2[ventricle], &column.after.motion.position_mm),
        }
    }

    fn next_rates(&self, column: &Column, ventricle: usize, flow_rate: &VentricleFlowRate) -> VentricleState {
        let VentricleModel { artery, atrium, .. } = &self.model.ventricles[ventricle];
        let (own, state) = (&column.rate.ventricles[ventricle], &column.before.ventricles[ventricle]);
        let flow = (self.after.ventricles[ventricle].outflow_ml_per_s, flow_rate.outflow_ml_per_s);
        let capacitor = (self.before.ventricles[ventricle].capacitor_pressure_kpa, state.capacitor_pressure_kpa);
        let capacitor_pressure_kpa = artery.advance_rate_kpa(&own.artery, capacitor, flow, self.model.settings.step_s);
        VentricleState {
            volume_mm3: dot(&self.gradients_mm2[ventricle], &column.after.motion.position_mm),
            pressure_kpa: flow_rate.pressure_kpa,
            capacitor_pressure_kpa,
            arterial_pressure_kpa: artery.arterial_pressure_rate_kpa(&own.artery, capacitor_pressure_kpa, flow),
            atrial_pressure_kpa: atrium.pressure_rate_kpa(&own.atrium, self.after.time_s),
            outflow_ml_per_s: flow_rate.outflow_ml_per_s,
            inflow_ml_per_s: flow_rate.inflow_ml_per_s,
            phase: self.after.ventricles[ventricle].phase,
            ..*state
        }
    }
}

/// The derivatives of the heart at rest, under pressures that change: with a parameter of the atria, and with the time of the first
/// depolarisation where the heart rests at that, as later on the atrial curve as that is.
fn rest_rates(model: &HeartModel, rate: &ModelRate, LeadIn { rest, first_vertex, .. }: &LeadIn) -> HeartState {
    let zeros = vec![Vector3::zeros(); model.anatomy.mesh.vertex_count()];
    let first_s = first_vertex.map(|vertex| model.activation().times_s()[vertex]);
    let later_s = first_vertex.zip(rate.depolarisation_s.as_ref()).map_or(0.0, |(vertex, rates)| rates[vertex]);
    let of = |(ventricle, state): (usize, &VentricleState)| {
        let own = &rate.ventricles[ventricle];
        let atrium = AtrialPressureRate { kick_end_s: own.atrium.kick_end_s - later_s, ..own.atrium };
        let atrial_pressure_kpa = model.ventricles[ventricle].atrium.pressure_rate_kpa(&atrium, first_s.unwrap_or(rest.time_s));
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
        time_s: rest.time_s,
        motion: MotionState::at_rest(zeros),
        ventricles: rest.ventricles.iter().enumerate().map(of).collect(),
    }
}
