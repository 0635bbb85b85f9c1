//! Start values from the measured volume curve, \[Billet2009\] §6.2: σ0 from the ejection fraction, onset and APD from the curve's timing.

use super::calibration::simulate_parameters;
use super::clock::Clock;
use super::error::RunError;
use super::forward::frame_volumes_lv_ml;
use crate::anatomy::Anatomy;
use crate::heart::{HeartModel, Parameter, Parameters, Part, RegionalParameter};
use crate::personalisation::{
    ElectricalTiming, FreeParameter, ParameterSpace, PersonalisationError, VolumeTiming, contraction_peak_for_ejection_fraction,
};
use crate::study::RunContext;
use crate::study::plan::{FreeParameter as FreeParameterPlan, PersonalisationPlan, Regions};

/// Time from depolarisation to ejection that the first guess of the onset takes; one pilot corrects it.
const ISOVOLUMIC_CONTRACTION_S: f64 = 0.06;
/// The start's ejection fraction is met to this.
const EJECTION_FRACTION_TOLERANCE: f64 = 0.02;
/// Simulations that σ0 may take.
const MOST_PILOTS: usize = 5;

/// The parameters that the study sets free, each from the study's start, or the data's, or the model's value.
pub(super) fn start_space(
    wanted: &PersonalisationPlan,
    base: &HeartModel,
    clock: &Clock,
    measured_ml: &[f64],
    context: &RunContext,
) -> Result<ParameterSpace, RunError> {
    context.progress().stage("finding start values", None);
    let mut start = base.parameters().clone();
    for free in &wanted.parameters {
        start.set(free.parameter, free.start.unwrap_or(start[free.parameter]).clamp(free.lower, free.upper))?;
    }
    if let Err(error) = from_volume_curve(wanted, base, clock, measured_ml, &mut start, context) {
        if context.is_stopped() {
            return Err(RunError::Stopped);
        }
        context.progress().warning(&format!("start values are the model's own: {error}"));
    }
    let entries =
        wanted.parameters.iter().flat_map(|free| regional_parameters(free, base.anatomy()).map(|regional| entry(free, regional, &start)));
    let space = ParameterSpace::new(start.clone(), entries.collect())?;
    let by_segment = wanted.parameters.iter().filter(|free| free.regions == Regions::AhaSegments);
    Ok(by_segment.fold(space, |space, free| space.with_alike_segments(free.parameter, free.neighbour_sd)))
}

/// The parameter in the parts of the heart in which the study wants it, as far as the heart has them.
fn regional_parameters(free: &FreeParameterPlan, anatomy: &Anatomy) -> impl Iterator<Item = RegionalParameter> {
    let is_wanted = |part: &Part| match (free.regions, part) {
        (Regions::Whole, part) => *part == Part::Whole,
        (Regions::Ventricles, part) => matches!(part, Part::LeftVentricle | Part::RightVentricle | Part::Scar),
        (Regions::AhaSegments, part) => matches!(part, Part::Segment(_)),
    };
    let has_tissue =
        |part: &Part| anatomy.regions.iter().zip(&anatomy.aha_segments).any(|(&region, &segment)| part.contains(region, segment));
    let parts: Vec<Part> = Part::all().filter(is_wanted).filter(has_tissue).collect();
    let parameter = free.parameter;
    parts.into_iter().filter_map(move |part| RegionalParameter::new(parameter, part))
}

/// What the study says of a parameter, for one part of the heart.
fn entry(free: &FreeParameterPlan, regional: RegionalParameter, start: &Parameters) -> FreeParameter {
    let entry = FreeParameter::new(regional).between(free.lower, free.upper);
    let mean = free.prior_mean.clamp(free.lower, free.upper);
    let prior_sd = free.prior_sd.map_or(f64::INFINITY, |sd| sd / entry.transform.slope(mean));
    let initial = start[regional].clamp(free.lower, free.upper);
    FreeParameter { fixed: free.fixed, ..entry.starting_at(initial).with_prior(mean, prior_sd) }
}

/// Moves what has no start of its own in the study: timing first, then σ0.
fn from_volume_curve(
    wanted: &PersonalisationPlan,
    base: &HeartModel,
    clock: &Clock,
    measured_ml: &[f64],
    start: &mut Parameters,
    context: &RunContext,
) -> Result<(), RunError> {
    let bounds = |parameter| {
        let open = wanted.parameters.iter().find(|free| free.parameter == parameter && free.start.is_none() && !free.fixed)?;
        Some((open.lower, open.upper))
    };
    let timing_of = |volumes_ml: &[f64]| {
        // The last frame is the first of the next beat.
        let count = clock.times_s.len().min(volumes_ml.len()).saturating_sub(1);
        VolumeTiming::from_curve(&clock.times_s[..count], &volumes_ml[..count], clock.period_s)
    };
    let pilot = |parameters: &Parameters| -> Result<VolumeTiming, PersonalisationError> {
        let failed = |source| PersonalisationError::Simulation { coordinates: Vec::new(), source };
        let trajectory =
            simulate_parameters(base, parameters.clone(), clock, &|| context.is_stopped()).map_err(|error| failed(error.into()))?;
        timing_of(&frame_volumes_lv_ml(&trajectory))
    };
    let measured = timing_of(measured_ml)?;
    let place = |start: &mut Parameters, parameter, value: f64| match bounds(parameter) {
        Some((lower, upper)) => start.set(parameter, value.clamp(lower, upper)),
        None => Ok(()),
    };
    if let Some(bounds) = bounds(Parameter::ContractionPeakLv) {
        let target = measured.ejection_fraction();
        let first = start[Parameter::ContractionPeakLv];
        let fit = contraction_peak_for_ejection_fraction(target, bounds, first, EJECTION_FRACTION_TOLERANCE, MOST_PILOTS, |peak_kpa| {
            Ok(pilot(&start.clone().with(Parameter::ContractionPeakLv, peak_kpa)?)?.ejection_fraction())
        })?;
        start.set(Parameter::ContractionPeakLv, fit.value.clamp(bounds.0, bounds.1))?;
    }
    let guess = ElectricalTiming::from_volume(&measured, ISOVOLUMIC_CONTRACTION_S, activation_span_s(base));
    place(start, Parameter::OnsetTime, guess.onset_time_s)?;
    place(start, Parameter::ActionPotentialDuration, guess.action_potential_duration_s)?;
    let tried = ElectricalTiming {
        onset_time_s: start[Parameter::OnsetTime],
        action_potential_duration_s: start[Parameter::ActionPotentialDuration],
    };
    let corrected = tried.corrected(&pilot(start)?, &measured);
    place(start, Parameter::OnsetTime, corrected.onset_time_s)?;
    place(start, Parameter::ActionPotentialDuration, corrected.action_potential_duration_s)?;
    Ok(())
}

fn activation_span_s(model: &HeartModel) -> f64 {
    let times_s = model.activation().times_s().iter().copied();
    let (first_s, last_s) = times_s.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    last_s - first_s
}
