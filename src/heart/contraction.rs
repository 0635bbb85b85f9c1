//! How strongly, how fast and how long every part of the heart contracts, \[Billet2009\] eq. 1.

use super::{HeartError, Parameter, Parameters};
use crate::anatomy::{Anatomy, Region};
use crate::mechanics::{ContractionLaw, Myocardium};

/// The active stress of every tetrahedron.
#[derive(Debug, Clone)]
pub(super) struct Contraction {
    /// The law of \[Billet2009\] eq. 1 with σ0 = 1 kPa, a vertex.
    pub(super) laws: Vec<ContractionLaw>,
    /// σ0 a tetrahedron, kPa.
    pub(super) peak_kpa: Vec<f64>,
}

impl Contraction {
    /// The fibrous ring of the valves does not contract.
    pub(super) fn new(anatomy: &Anatomy, tissue: &Myocardium, parameters: &Parameters) -> Result<Self, HeartError> {
        let at_vertices = |parameter| parameters.on_vertices(parameter, anatomy);
        let [contraction, relaxation, duration] =
            [Parameter::ContractionRate, Parameter::RelaxationRate, Parameter::ActionPotentialDuration].map(at_vertices);
        let law = |vertex: usize| ContractionLaw {
            peak_kpa: 1.0,
            contraction_rate_per_s: contraction[vertex],
            relaxation_rate_per_s: relaxation[vertex],
            action_potential_duration_s: duration[vertex],
            period_s: parameters[Parameter::HeartPeriod],
        };
        let laws: Vec<_> = (0..anatomy.mesh.vertex_count()).map(law).collect();
        laws.iter().try_for_each(ContractionLaw::check)?;
        let peak_kpa = muscle_peaks_kpa(anatomy, parameters).into_iter().zip(tissue.muscle_shares()).map(|(peak, share)| peak * share);
        let peak_kpa = peak_kpa.collect();
        Ok(Self { laws, peak_kpa })
    }
}

/// σ0 of a region.
pub(super) fn peak_of(region: Region) -> Parameter {
    match region {
        Region::FreeWallLv | Region::Septum => Parameter::ContractionPeakLv,
        Region::FreeWallRv => Parameter::ContractionPeakRv,
        Region::Scar => Parameter::ContractionPeakScar,
    }
}

/// σ0 a tetrahedron that is all muscle, kPa.
pub(super) fn muscle_peaks_kpa(anatomy: &Anatomy, parameters: &Parameters) -> Vec<f64> {
    let lv_kpa = parameters.on_tetrahedra(Parameter::ContractionPeakLv, anatomy);
    let peak = |(region, lv_kpa)| match peak_of(region) {
        Parameter::ContractionPeakLv => lv_kpa,
        other => parameters[other],
    };
    anatomy.regions.iter().copied().zip(lv_kpa).map(peak).collect()
}
