//! The assembled heart: all that stays the same while it beats, shared between models that differ in few parameters.

use std::sync::Arc;

use nalgebra::Vector3;

use super::contraction::Contraction;
use super::onset::OnsetSites;
use super::{BaseMotion, ExtraStimulus, HeartError, HeartRhythm, HeartState, Parameter, Parameters, VentricleState};
use crate::anatomy::{Anatomy, Ventricle};
use crate::circulation::{AtrialPressure, Phase, Windkessel};
use crate::electrophysiology::ActivationMap;
use crate::mechanics::{ContractionLaw, Kinematics, MotionState, Myocardium, PassiveProperties, StepOperator, StepSettings, TimeScheme};
use crate::mesh::SurfaceTag;

/// Which configuration the cavity pressures act on in linear kinematics. In corotational ones they follow the surface: the prestress and
/// the fibres turn with the wall, and so must its load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PressureLoad {
    /// Normals and areas of the heart at rest: the linear theory's own, and a convex problem in every step.
    #[default]
    Reference,
    /// Normals and areas of the moving surface. Its load is consistent with the work p dV, but in linear kinematics, which take twist for
    /// growth, it lets a soft ventricle snap into a twisted and inflated state.
    Following,
}

/// What is chosen beside the parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelSettings {
    /// Time step h, s.
    pub step_s: f64,
    /// How time is discretised.
    pub time_scheme: TimeScheme,
    /// How strain is measured.
    pub kinematics: Kinematics,
    /// Where the beat starts.
    pub onset_sites: OnsetSites,
    /// Stimuli beside those of every beat.
    pub extra_stimuli: Vec<ExtraStimulus>,
    /// Where the base springs are anchored over the cycle; at rest without it.
    pub base_motion: Option<Arc<BaseMotion>>,
    /// Which configuration the cavity pressures act on.
    pub pressure_load: PressureLoad,
    /// Largest difference between a cavity's volume and what its valves let through in a step, mL.
    pub volume_tolerance_ml: f64,
}

impl Default for ModelSettings {
    fn default() -> Self {
        Self {
            step_s: 0.005,
            time_scheme: TimeScheme::default(),
            kinematics: Kinematics::default(),
            onset_sites: OnsetSites::Normal,
            extra_stimuli: Vec::new(),
            base_motion: None,
            pressure_load: PressureLoad::default(),
            volume_tolerance_ml: 1e-6,
        }
    }
}

/// A heart ready to beat. It does not change, so several threads may step it, each with its own workspace.
#[derive(Debug, Clone)]
pub struct HeartModel {
    pub(super) anatomy: Arc<Anatomy>,
    pub(super) parameters: Parameters,
    pub(super) settings: ModelSettings,
    pub(super) operator: Arc<StepOperator>,
    rhythm: Arc<HeartRhythm>,
    pub(super) contraction: Contraction,
    pub(super) ventricles: Vec<VentricleModel>,
}

/// What a ventricle is connected to.
#[derive(Debug, Clone)]
pub(super) struct VentricleModel {
    pub(super) ventricle: Ventricle,
    pub(super) artery: Windkessel,
    pub(super) atrium: AtrialPressure,
    /// p_C at the start, kPa.
    initial_capacitor_kpa: f64,
    pub(super) rest_volume_mm3: f64,
    /// ∂V/∂y at rest, mm².
    pub(super) rest_gradient_mm2: Arc<Vec<Vector3<f64>>>,
}

const ELECTRICAL: [Parameter; 4] =
    [Parameter::ConductionVelocity, Parameter::AnisotropyRatio, Parameter::EndocardialSpeedFactor, Parameter::OnsetTime];

pub(super) const PASSIVE: [Parameter; 14] = [
    Parameter::FibreStiffness,
    Parameter::TransverseStiffness,
    Parameter::PoissonRatio,
    Parameter::VolumeStiffness,
    Parameter::Density,
    Parameter::DampingMass,
    Parameter::DampingStiffness,
    Parameter::BaseStiffnessNormal,
    Parameter::BaseStiffnessIsotropic,
    Parameter::PericardiumStiffness,
    Parameter::PericardiumDamping,
    Parameter::PericardiumBaseShare,
    Parameter::ValveRingHeight,
    Parameter::ValveRingStiffness,
];

impl HeartModel {
    /// Puts a heart together: solves the activation, assembles and factorises the step.
    ///
    /// # Errors
    /// [`HeartError`] if the anatomy's fields do not fit its mesh, a cavity has no volume, a setting makes no sense, or a room below
    /// refuses its part.
    pub fn new(anatomy: Arc<Anatomy>, parameters: Parameters, settings: ModelSettings) -> Result<Self, HeartError> {
        check_anatomy(&anatomy)?;
        check_settings(&settings, &anatomy, &parameters)?;
        let operator = Arc::new(step_operator(None, &anatomy, &parameters, &settings)?);
        let rhythm = Arc::new(HeartRhythm::new(&anatomy, &parameters, &settings, None)?);
        let contraction = Contraction::new(&anatomy, operator.myocardium(), &parameters)?;
        let ventricles = anatomy.cavities.iter().map(|(v, _)| VentricleModel::new(&anatomy, *v, &parameters)).collect::<Result<_, _>>()?;
        Ok(Self { anatomy, parameters, settings, operator, rhythm, contraction, ventricles })
    }

    /// This heart with other parameters. The factorised step is kept when no passive parameter differs, the activation map when no
    /// electrical one does; the result is bitwise that of [`HeartModel::new`].
    ///
    /// # Errors
    /// As [`HeartModel::new`].
    pub fn with_parameters(&self, parameters: Parameters) -> Result<Self, HeartError> {
        let same = |set: &[Parameter]| set.iter().all(|&parameter| self.parameters.agrees_with(&parameters, parameter));
        check_settings(&self.settings, &self.anatomy, &parameters)?;
        let operator = if same(&PASSIVE) {
            Arc::clone(&self.operator)
        } else {
            Arc::new(step_operator(Some(self.operator.myocardium()), &self.anatomy, &parameters, &self.settings)?)
        };
        let own = same(&ELECTRICAL).then(|| self.rhythm.own_beat());
        let rhythm = Arc::new(HeartRhythm::new(&self.anatomy, &parameters, &self.settings, own)?);
        let contraction = Contraction::new(&self.anatomy, operator.myocardium(), &parameters)?;
        let ventricles = self.ventricles.iter().map(|v| v.with_parameters(&parameters)).collect::<Result<_, _>>()?;
        let (anatomy, settings) = (Arc::clone(&self.anatomy), self.settings.clone());
        Ok(Self { anatomy, parameters, settings, operator, rhythm, contraction, ventricles })
    }

    pub(super) fn valve_resistance(&self) -> f64 {
        self.parameters[Parameter::ValveResistance]
    }

    /// The heart at rest.
    pub fn anatomy(&self) -> &Arc<Anatomy> {
        &self.anatomy
    }

    /// The tissue at rest.
    pub fn tissue(&self) -> &Arc<Myocardium> {
        self.operator.myocardium()
    }

    /// The parameters.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The settings.
    pub fn settings(&self) -> &ModelSettings {
        &self.settings
    }

    /// Depolarisation times of the first beat, undisturbed.
    pub fn activation(&self) -> &ActivationMap {
        self.rhythm.own_beat()
    }

    /// All depolarisations.
    pub fn rhythm(&self) -> &HeartRhythm {
        &self.rhythm
    }

    /// Active stress σ_C of every tetrahedron at a time, kPa: the mean over its corners.
    pub fn active_stress_kpa(&self, time_s: f64) -> Vec<f64> {
        let (mut fraction, mut stress_kpa) = (Vec::new(), Vec::new());
        self.write_active_stress(time_s, &mut fraction, &mut stress_kpa);
        stress_kpa
    }

    pub(super) fn write_active_stress(&self, time_s: f64, fraction: &mut Vec<f64>, stress_kpa: &mut Vec<f64>) {
        fraction.clear();
        let stress = |(vertex, law): (usize, &ContractionLaw)| {
            self.rhythm.since_depolarisation_s(vertex, time_s).map_or(0.0, |since_s| law.stress_since_kpa(since_s))
        };
        fraction.extend(self.contraction.laws.iter().enumerate().map(stress));
        let mean = |corners: &[usize; 4]| corners.iter().map(|&vertex| fraction[vertex]).sum::<f64>() / 4.0;
        stress_kpa.clear();
        let tetrahedra = self.anatomy.mesh.tetrahedra().iter().zip(&self.contraction.peak_kpa);
        stress_kpa.extend(tetrahedra.map(|(corners, peak_kpa)| peak_kpa * mean(corners)));
    }

    /// The state at rest: the mesh is in equilibrium under the atrial pressures of that instant, whose load is subtracted for good
    /// (prestress). Any instant will do, also a negative one; the ventricles count as filling.
    pub fn initial_state(&self, start_time_s: f64) -> HeartState {
        self.state_at_rest(start_time_s, start_time_s)
    }

    /// The same under the atrial pressures of another instant.
    pub(super) fn state_at_rest(&self, start_time_s: f64, pressure_time_s: f64) -> HeartState {
        let vertices_mm = self.anatomy.mesh.vertices_mm();
        let motion = MotionState::at_rest(vertices_mm.to_vec());
        let state_of = |model: &VentricleModel| {
            let atrial_pressure_kpa = model.atrium.pressure_kpa(pressure_time_s);
            VentricleState {
                ventricle: model.ventricle,
                volume_mm3: model.rest_volume_mm3,
                pressure_kpa: atrial_pressure_kpa,
                capacitor_pressure_kpa: model.initial_capacitor_kpa,
                arterial_pressure_kpa: model.initial_capacitor_kpa,
                atrial_pressure_kpa,
                outflow_ml_per_s: 0.0,
                inflow_ml_per_s: 0.0,
                phase: Phase::Filling,
                rest_pressure_kpa: atrial_pressure_kpa,
            }
        };
        HeartState { time_s: start_time_s, motion, ventricles: self.ventricles.iter().map(state_of).collect() }
    }
}

impl VentricleModel {
    fn new(anatomy: &Anatomy, ventricle: Ventricle, parameters: &Parameters) -> Result<Self, HeartError> {
        let (mut rest_volume_mm3, mut gradient) = (0.0, vec![Vector3::zeros(); anatomy.mesh.vertex_count()]);
        for (_, cavity) in anatomy.cavities.iter().filter(|(v, _)| *v == ventricle) {
            rest_volume_mm3 = cavity.volume_mm3(anatomy.mesh.vertices_mm());
            cavity.add_gradient(anatomy.mesh.vertices_mm(), 1.0, &mut gradient);
        }
        if rest_volume_mm3.is_nan() || rest_volume_mm3 <= 0.0 {
            let cavity = match ventricle {
                Ventricle::Left => "left",
                Ventricle::Right => "right",
            };
            return Err(HeartError::Cavity { cavity, volume_mm3: rest_volume_mm3 });
        }
        let (artery, atrium, initial_capacitor_kpa) = circulation(ventricle, parameters)?;
        Ok(Self { ventricle, artery, atrium, initial_capacitor_kpa, rest_volume_mm3, rest_gradient_mm2: Arc::new(gradient) })
    }

    fn with_parameters(&self, parameters: &Parameters) -> Result<Self, HeartError> {
        let (artery, atrium, initial_capacitor_kpa) = circulation(self.ventricle, parameters)?;
        Ok(Self { artery, atrium, initial_capacitor_kpa, ..self.clone() })
    }
}

/// R, Z, C, p_v and initial p_C of a ventricle's artery, p₀ and Δp of its atrium.
pub(super) fn circulation_of(ventricle: Ventricle) -> [Parameter; 7] {
    use Parameter as P;
    match ventricle {
        Ventricle::Left => [
            P::ResistanceSystemic,
            P::ImpedanceSystemic,
            P::ComplianceSystemic,
            P::VenousPressureSystemic,
            P::InitialPressureAorta,
            P::AtrialPressureLeft,
            P::AtrialKickLeft,
        ],
        Ventricle::Right => [
            P::ResistancePulmonary,
            P::ImpedancePulmonary,
            P::CompliancePulmonary,
            P::VenousPressurePulmonary,
            P::InitialPressurePulmonary,
            P::AtrialPressureRight,
            P::AtrialKickRight,
        ],
    }
}

/// Artery, atrium and initial p_C of a ventricle. The atrial kick ends when the ventricles have begun to rise.
fn circulation(ventricle: Ventricle, parameters: &Parameters) -> Result<(Windkessel, AtrialPressure, f64), HeartError> {
    use Parameter as P;
    let [resistance, impedance, compliance, venous, initial, atrial, kick] =
        circulation_of(ventricle).map(|parameter| parameters[parameter]);
    let artery = Windkessel::new(resistance, impedance, compliance, venous)?;
    let kick_end_s = parameters[P::OnsetTime] + parameters[P::AtrialKickOverlap];
    let (duration_s, period_s) = (parameters[P::AtrialKickDuration], parameters[P::HeartPeriod]);
    Ok((artery, AtrialPressure::new(atrial, kick, kick_end_s, duration_s, period_s)?, initial))
}

/// Assembles and factorises the step; the ordering of a tissue of the same mesh is kept.
fn step_operator(
    same_mesh: Option<&Myocardium>,
    anatomy: &Anatomy,
    parameters: &Parameters,
    settings: &ModelSettings,
) -> Result<StepOperator, HeartError> {
    let passive = passive_properties(parameters);
    let Anatomy { mesh, surface, fibre_axes, .. } = anatomy;
    let myocardium = match same_mesh {
        Some(tissue) => tissue.with_properties(mesh, surface, fibre_axes, &passive)?,
        None => Myocardium::new(mesh, surface, fibre_axes, &passive)?,
    };
    let &ModelSettings { step_s, time_scheme, kinematics, .. } = settings;
    Ok(StepOperator::with_settings(Arc::new(myocardium), StepSettings { step_s, scheme: time_scheme, kinematics })?)
}

pub(super) fn passive_properties(parameters: &Parameters) -> PassiveProperties {
    PassiveProperties {
        fibre_stiffness_kpa: parameters[Parameter::FibreStiffness],
        transverse_stiffness_kpa: parameters[Parameter::TransverseStiffness],
        poisson_ratio: parameters[Parameter::PoissonRatio],
        volume_stiffness_kpa: parameters[Parameter::VolumeStiffness],
        density_kg_per_mm3: parameters[Parameter::Density],
        damping_mass_per_s: parameters[Parameter::DampingMass],
        damping_stiffness_s: parameters[Parameter::DampingStiffness],
        base_stiffness_normal_kpa_per_mm: parameters[Parameter::BaseStiffnessNormal],
        base_stiffness_isotropic_kpa_per_mm: parameters[Parameter::BaseStiffnessIsotropic],
        pericardium_stiffness_kpa_per_mm: parameters[Parameter::PericardiumStiffness],
        pericardium_damping_kpa_s_per_mm: parameters[Parameter::PericardiumDamping],
        pericardium_base_share: parameters[Parameter::PericardiumBaseShare],
        valve_ring_height_mm: parameters[Parameter::ValveRingHeight],
        valve_ring_stiffness_kpa: parameters[Parameter::ValveRingStiffness],
    }
}

fn check_anatomy(anatomy: &Anatomy) -> Result<(), HeartError> {
    let (vertices, tetrahedra) = (anatomy.mesh.vertex_count(), anatomy.mesh.tetrahedron_count());
    let fields = [
        ("transmural depths", anatomy.transmural_depth.len(), vertices),
        ("fibre axes", anatomy.fibre_axes.len(), tetrahedra),
        ("heart axes", anatomy.heart_axes.len(), tetrahedra),
        ("regions", anatomy.regions.len(), tetrahedra),
        ("AHA segments", anatomy.aha_segments.len(), tetrahedra),
    ];
    for (field, found, expected) in fields {
        if found != expected {
            return Err(HeartError::AnatomyField { field, expected, found });
        }
    }
    if !(1..=2).contains(&anatomy.cavities.len()) {
        return Err(HeartError::AnatomyField { field: "cavities", expected: 1, found: anatomy.cavities.len() });
    }
    Ok(())
}

fn check_settings(settings: &ModelSettings, anatomy: &Anatomy, parameters: &Parameters) -> Result<(), HeartError> {
    let period_s = parameters[Parameter::HeartPeriod];
    let (setting, value) = ("step_s", settings.step_s);
    if !(value > 0.0 && value <= period_s / 8.0) {
        return Err(HeartError::Setting { setting, value, requirement: "positive and at most an eighth of the heart period" });
    }
    let (setting, value) = ("volume_tolerance_ml", settings.volume_tolerance_ml);
    if !(value > 0.0 && value.is_finite()) {
        return Err(HeartError::Setting { setting, value, requirement: "positive" });
    }
    if let Some(motion) = &settings.base_motion
        && motion.vertex_count() != anatomy.surface.vertices_with(SurfaceTag::Base).len()
    {
        let base_count = anatomy.surface.vertices_with(SurfaceTag::Base).len();
        let reason = format!("it has {} vertices, the base has {base_count}", motion.vertex_count());
        return Err(HeartError::BaseMotion { reason });
    }
    Ok(())
}
