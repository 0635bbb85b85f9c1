//! What of a heart changes with a parameter, and how fast.

use super::super::contraction::{muscle_peaks_kpa, peak_of};
use super::super::model::{PASSIVE, circulation_of, passive_properties};
use super::super::onset::{conduction, endocardial_layer};
use super::super::{HeartError, HeartModel, Parameter, Parameters, RegionalParameter, TangentError};
use crate::anatomy::Ventricle;
use crate::circulation::{AtrialPressureRate, WindkesselRate};
use crate::electrophysiology::Onset;
use crate::mechanics::{ContractionRate, Kinematics, MechanicsError, Myocardium, PassiveRate};
use crate::mesh::SurfaceTag;

/// Half of the width of central differences of assembled matrices, relative to the parameter: they are exact to about its square.
const DIFFERENCE: f64 = 1e-5;

/// Derivatives of the parts of a heart by one of its parameters; what does not depend on it is zero or none.
pub(super) struct ModelRate {
    /// dσ0 a tetrahedron, kPa.
    pub(super) peak_kpa: Option<Vec<f64>>,
    pub(super) contraction: Option<LawRate>,
    /// dtd a vertex, s.
    pub(super) depolarisation_s: Option<Vec<f64>>,
    pub(super) passive: Option<PassiveRate>,
    /// Two tissues on either side of this one, and how far they are apart, where their internal forces are to be differentiated.
    pub(super) tissues: Option<(Box<[Myocardium; 2]>, f64)>,
    /// The surface whose image gain the parameter is.
    pub(super) gain_surface: Option<SurfaceTag>,
    pub(super) ventricles: Vec<CirculationRate>,
    /// dR_v, kPa·s/mL.
    pub(super) valve_resistance: f64,
}

/// Derivatives of the laws of contraction: of each as much as the parameter rules at its vertex.
pub(super) struct LawRate {
    pub(super) rate: ContractionRate,
    pub(super) shares: Vec<f64>,
}

/// Derivatives of what a ventricle is connected to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct CirculationRate {
    pub(super) artery: WindkesselRate,
    pub(super) atrium: AtrialPressureRate,
    /// dp_C at the start, kPa.
    pub(super) initial_capacitor_kpa: f64,
}

impl ModelRate {
    /// Derivatives by a parameter.
    ///
    /// # Errors
    /// [`TangentError::NoTangent`] where there are none, [`TangentError::Heart`] if a tissue beside this one cannot be assembled.
    pub(super) fn new(model: &HeartModel, regional: RegionalParameter, has_loads: bool) -> Result<Self, TangentError> {
        let parameter = regional.parameter();
        check(model, parameter, has_loads)?;
        let one = |which: Parameter| f64::from(which == parameter);
        let rate = ContractionRate {
            contraction_rate_per_s: one(Parameter::ContractionRate),
            relaxation_rate_per_s: one(Parameter::RelaxationRate),
            action_potential_duration_s: one(Parameter::ActionPotentialDuration),
        };
        let law_rate = || LawRate { rate, shares: model.parameters.share_on_vertices(regional, &model.anatomy) };
        let tissues = if PASSIVE.contains(&parameter) { Some(neighbours(model, parameter)?) } else { None };
        let share_rates = tissues.as_ref().and_then(|(tissues, width)| muscle_share_rates(tissues, *width));
        let ventricles = model.ventricles.iter().map(|ventricle| CirculationRate::new(ventricle.ventricle, parameter)).collect();
        Ok(Self {
            peak_kpa: peak_rates_kpa(model, regional, share_rates.as_deref()),
            contraction: (rate != ContractionRate::default()).then(law_rate),
            depolarisation_s: depolarisation_rates_s(model, regional)?,
            passive: tissues.as_ref().map(|(tissues, width)| PassiveRate::between(&tissues[0], &tissues[1], *width)),
            tissues: tissues.filter(|_| model.settings.kinematics == Kinematics::Corotational),
            gain_surface: gain_surface(parameter),
            ventricles,
            valve_resistance: one(Parameter::ValveResistance),
        })
    }

    /// Whether the contraction depends on the parameter otherwise than by σ0.
    pub(super) fn has_law(&self) -> bool {
        self.contraction.is_some() || self.depolarisation_s.is_some()
    }
}

impl CirculationRate {
    fn new(ventricle: Ventricle, parameter: Parameter) -> Self {
        let one = |which: Parameter| f64::from(which == parameter);
        let [resistance, impedance, compliance, venous, initial, atrial, kick] = circulation_of(ventricle).map(one);
        Self {
            artery: WindkesselRate {
                resistance_kpa_s_per_ml: resistance,
                impedance_kpa_s_per_ml: impedance,
                compliance_ml_per_kpa: compliance,
                venous_pressure_kpa: venous,
            },
            atrium: AtrialPressureRate {
                baseline_kpa: atrial,
                kick_kpa: kick,
                kick_end_s: one(Parameter::OnsetTime) + one(Parameter::AtrialKickOverlap),
                kick_duration_s: one(Parameter::AtrialKickDuration),
            },
            initial_capacitor_kpa: initial,
        }
    }
}

/// Which parameters have no tangent, and why.
fn check(model: &HeartModel, parameter: Parameter, has_loads: bool) -> Result<(), TangentError> {
    use Parameter as P;
    let value = model.parameters[parameter];
    let is_electrical = matches!(
        parameter,
        P::ConductionVelocity | P::AnisotropyRatio | P::EndocardialSpeedFactor | P::OnsetTime | P::ActionPotentialDuration
    );
    let reason = match parameter {
        P::HeartPeriod => "all later beats move with it",
        _ if gain_surface(parameter).is_some() && !has_loads => "the heart does not depend on it without the loads of images",
        P::ValveRingHeight if value == 0.0 => "a ring appears at once",
        P::AtrialKickDuration if value >= model.parameters[P::HeartPeriod] => "the kick is cut to the heart period",
        _ if is_electrical && !model.rhythm().is_regular() => "which stimuli meet refractory tissue may change with it",
        _ => return Ok(()),
    };
    Err(TangentError::NoTangent { parameter: parameter.spec().name, reason })
}

/// dσ0 a tetrahedron: 1 where the parameter rules, less in the fibrous ring; and σ0 d(share) where the ring changes.
fn peak_rates_kpa(model: &HeartModel, regional: RegionalParameter, share_rates: Option<&[f64]>) -> Option<Vec<f64>> {
    let HeartModel { anatomy, parameters, operator, .. } = model;
    if let Some(share_rates) = share_rates {
        return Some(muscle_peaks_kpa(anatomy, parameters).iter().zip(share_rates).map(|(peak, rate)| peak * rate).collect());
    }
    let parameter = regional.parameter();
    if !matches!(parameter, Parameter::ContractionPeakLv | Parameter::ContractionPeakRv | Parameter::ContractionPeakScar) {
        return None;
    }
    let muscle_shares = operator.myocardium().muscle_shares();
    let ruled = anatomy.regions.iter().zip(parameters.share_on_tetrahedra(regional, anatomy));
    let ruled = ruled.map(|(region, share)| if peak_of(*region) == parameter { share } else { 0.0 });
    Some(ruled.zip(muscle_shares).map(|(ruled, share)| ruled * share).collect())
}

/// dtd a vertex through the stencils of the activation map.
fn depolarisation_rates_s(model: &HeartModel, regional: RegionalParameter) -> Result<Option<Vec<f64>>, HeartError> {
    let (anatomy, parameters, map) = (&model.anatomy, &model.parameters, model.activation());
    let onsets: Vec<Onset> = model.settings.onset_sites.onsets(anatomy, parameters);
    let parameter = regional.parameter();
    let rates = match parameter {
        Parameter::OnsetTime => map.tangent_s(&[], &vec![1.0; onsets.len()]),
        Parameter::ConductionVelocity => {
            let bulk = parameters.on_tetrahedra(parameter, anatomy).into_iter();
            let shares = parameters.share_on_tetrahedra(regional, anatomy);
            map.tangent_s(&bulk.zip(shares).map(|(speed, share)| share / speed).collect::<Vec<_>>(), &[])
        }
        Parameter::EndocardialSpeedFactor => {
            let faster = |is_layer: bool| if is_layer { parameters[parameter].recip() } else { 0.0 };
            map.tangent_s(&endocardial_layer(anatomy).into_iter().map(faster).collect::<Vec<_>>(), &[])
        }
        Parameter::AnisotropyRatio => map.anisotropy_tangent_s(&anatomy.mesh, &conduction(anatomy, parameters)?, &onsets),
        _ => return Ok(None),
    };
    Ok(Some(rates))
}

/// The surface whose gain a parameter is.
fn gain_surface(parameter: Parameter) -> Option<SurfaceTag> {
    match parameter {
        Parameter::ImageGainEndocardiumLv => Some(SurfaceTag::EndocardiumLv),
        Parameter::ImageGainEndocardiumRv => Some(SurfaceTag::EndocardiumRv),
        Parameter::ImageGainEpicardium => Some(SurfaceTag::Epicardium),
        Parameter::ImageGainBase => Some(SurfaceTag::Base),
        _ => None,
    }
}

/// Tissues with a little less and a little more of a passive parameter, and how far they are apart. At an end of its range they lie on one
/// side: parameters that may be zero, where the range ends, enter linearly; for others the difference is then exact to 1e-5 only.
fn neighbours(model: &HeartModel, parameter: Parameter) -> Result<(Box<[Myocardium; 2]>, f64), HeartError> {
    let (value, spec) = (model.parameters[parameter], parameter.spec());
    let reach = DIFFERENCE * if value == 0.0 { (spec.upper - spec.lower).min(1.0) } else { value };
    let (low, high) = ((value - reach).max(spec.lower), (value + reach).min(spec.upper));
    let of = |value: f64| tissue(model, &model.parameters.clone().with(parameter, value)?);
    Ok((Box::new([of(low)?, of(high)?]), high - low))
}

/// How the share of muscle changes a tetrahedron, where it does: with the fibrous ring.
fn muscle_share_rates([lower, upper]: &[Myocardium; 2], width: f64) -> Option<Vec<f64>> {
    let rates: Vec<f64> = upper.muscle_shares().iter().zip(lower.muscle_shares()).map(|(u, l)| (u - l) / width).collect();
    rates.iter().any(|rate| *rate != 0.0).then_some(rates)
}

fn tissue(model: &HeartModel, parameters: &Parameters) -> Result<Myocardium, HeartError> {
    let anatomy = &model.anatomy;
    let passive = passive_properties(parameters);
    let made: Result<_, MechanicsError> =
        model.operator.myocardium().with_properties(&anatomy.mesh, &anatomy.surface, &anatomy.fibre_axes, &passive);
    Ok(made?)
}
