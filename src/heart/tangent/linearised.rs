//! A step of the heart that has been taken, linearised at its end: what all tangents of it share.

use nalgebra::{DMatrix, Vector3};

use super::super::pressure_stiffness::add_pressure_stiffness;
use super::super::step::dot;
use super::super::{HeartModel, HeartState, StepError, StepWorkspace, TangentError, VentricleState};
use super::internal_force::InternalForce;
use crate::circulation::{OpenValves, Phase, VentricleFlow, VentriclePorts};
use crate::mechanics::{ColumnSolver, Kinematics, Linearisation, LoadTangent, MechanicsError, StepLoad, StepSystem, TakenStep};

/// Relative residual that an iterative solve of a column may leave.
pub(super) const RELATIVE_TOLERANCE: f64 = 1e-9;

/// Memory of linearised steps.
#[derive(Default)]
pub(super) struct LinearisedMemory {
    system: Option<StepSystem>,
    solver: ColumnSolver,
    yields_mm_per_kpa: Vec<Vec<Vector3<f64>>>,
}

/// The system with its matrix at the step's end, and W (mm/kPa).
type SystemAndYields<'a> = (&'a StepSystem, &'a [Vec<Vector3<f64>>]);

/// The step that has been taken, as all its tangents see it.
pub(super) struct LinearisedStep<'a> {
    pub(super) model: &'a HeartModel,
    pub(super) before: &'a HeartState,
    pub(super) after: &'a HeartState,
    pub(super) workspace: &'a StepWorkspace,
    /// Its matrix: of linear kinematics, or the tangent of corotational ones at the step's end.
    pub(super) system: &'a StepSystem,
    /// Time since the latest depolarisation a vertex at the step's end, s.
    pub(super) since_s: Vec<Option<f64>>,
    /// ∂V at the step's end, mm², one a cavity.
    pub(super) gradients_mm2: Vec<Vec<Vector3<f64>>>,
    /// W, mm/kPa, one a cavity.
    pub(super) yields_mm_per_kpa: &'a [Vec<Vector3<f64>>],
    pub(super) compliance_mm3_per_kpa: DMatrix<f64>,
    pub(super) flows: Vec<VentricleFlow>,
    pub(super) ports: Vec<VentriclePorts>,
    pub(super) loads: Vec<Box<dyn LoadTangent + 'a>>,
}

impl<'a> LinearisedStep<'a> {
    /// The step from `before` to `after` under `loads` that has left `workspace`.
    ///
    /// # Errors
    /// [`TangentError::NoTangent`] for a load without derivative, [`TangentError::Step`] if a system cannot be solved.
    pub(super) fn new(
        model: &'a HeartModel,
        loads: &[&'a dyn StepLoad],
        (before, after): (&'a HeartState, &'a HeartState),
        workspace: &'a StepWorkspace,
        memory: &'a mut LinearisedMemory,
    ) -> Result<Self, TangentError> {
        let (time_s, step_s) = (before.time_s, model.settings.step_s);
        let taken = TakenStep { state: &before.motion, time_s, step_s, end_mm: &after.motion.position_mm };
        let refused = TangentError::NoTangent { parameter: "loads", reason: "a load of data has no derivative" };
        let loads = loads.iter().map(|load| load.tangent(&taken).ok_or_else(|| refused.clone())).collect::<Result<_, _>>()?;
        let vertex_count = model.anatomy.mesh.vertex_count();
        let gradient = |(_, cavity): &(_, crate::mesh::Cavity)| {
            let mut gradient = vec![Vector3::zeros(); vertex_count];
            cavity.add_gradient(&after.motion.position_mm, 1.0, &mut gradient);
            gradient
        };
        let gradients_mm2: Vec<_> = model.anatomy.cavities.iter().map(gradient).collect();
        let mechanics = |source: MechanicsError| StepError::Mechanics { time_s, step_s, source };
        let (system, yields_mm_per_kpa) = linearise(model, after, workspace, &gradients_mm2, memory).map_err(mechanics)?;
        let count = gradients_mm2.len();
        Ok(Self {
            since_s: (0..vertex_count).map(|vertex| model.rhythm().since_depolarisation_s(vertex, after.time_s)).collect(),
            compliance_mm3_per_kpa: DMatrix::from_fn(count, count, |k, l| dot(&gradients_mm2[k], &yields_mm_per_kpa[l])),
            flows: after.ventricles.iter().map(flow).collect(),
            ports: model.ports(before),
            model,
            before,
            after,
            workspace,
            system,
            gradients_mm2,
            yields_mm_per_kpa,
            loads,
        })
    }

    /// Whether the tissue turns.
    pub(super) fn is_corotational(&self) -> bool {
        self.model.settings.kinematics == Kinematics::Corotational
    }

    /// Where the force of a unit of prestress points: it turns with the wall in corotational kinematics.
    pub(super) fn prestress_mm2(&self, ventricle: usize) -> &[Vector3<f64>] {
        if self.is_corotational() { &self.gradients_mm2[ventricle] } else { &self.model.ventricles[ventricle].rest_gradient_mm2 }
    }

    pub(super) fn internal_force(&self) -> InternalForce<'_> {
        InternalForce {
            model: self.model,
            before: &self.before.motion,
            end_mm: &self.after.motion.position_mm,
            tension_kpa: &self.workspace.stress_kpa,
        }
    }
}

/// What is linear at the step's end: that of the step itself where its matrix is constant and factorised.
fn linearise<'a>(
    model: &HeartModel,
    after: &HeartState,
    workspace: &'a StepWorkspace,
    gradients_mm2: &[Vec<Vector3<f64>>],
    memory: &'a mut LinearisedMemory,
) -> Result<SystemAndYields<'a>, MechanicsError> {
    let LinearisedMemory { system, solver, yields_mm_per_kpa } = memory;
    let is_corotational = model.settings.kinematics == Kinematics::Corotational;
    if !is_corotational && !workspace.system.has_stiffness() {
        return Ok((&workspace.system, &workspace.yields_mm_per_kpa));
    }
    let loads: Vec<&[Vector3<f64>]> = match is_corotational {
        true => gradients_mm2.iter().map(Vec::as_slice).collect(),
        false => model.ventricles.iter().map(|ventricle| ventricle.rest_gradient_mm2.as_slice()).collect(),
    };
    let system = if is_corotational {
        let system = system.get_or_insert_with(|| workspace.system.clone());
        system.clone_from(&workspace.system);
        let position_mm = &after.motion.position_mm;
        model.operator.linearise(position_mm, Linearisation::Exact, system)?;
        if let Some(tangent) = &mut system.tangent {
            for ((_, cavity), ventricle) in model.anatomy.cavities.iter().zip(&after.ventricles) {
                add_pressure_stiffness(cavity, position_mm, ventricle.pressure_kpa - ventricle.rest_pressure_kpa, tangent);
            }
        }
        &*system
    } else {
        &workspace.system
    };
    yields_mm_per_kpa.resize_with(loads.len(), Vec::new);
    for (yields, load) in yields_mm_per_kpa.iter_mut().zip(&loads) {
        yields.clear();
        yields.extend_from_slice(load);
    }
    let guesses: Vec<&[Vector3<f64>]> = workspace.yields_mm_per_kpa.iter().map(Vec::as_slice).collect();
    solver.solve(&workspace.solver, &model.operator, system, yields_mm_per_kpa, &guesses, RELATIVE_TOLERANCE)?;
    Ok((system, yields_mm_per_kpa))
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
