//! Start values from the measured volume curve, \[Billet2009\] §6.2: σ0 from the ejection fraction, onset and APD from the curve's timing.

use serde::Serialize;

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
/// Factor on a σ0 that cannot be simulated.
const WEAKENED: f64 = 0.7;
/// Simulations that σ0 may take.
const MOST_PILOTS: usize = 5;

/// A row of `stages.csv`: a parameter after a stage of the search, and how well the heart then fits.
#[derive(Debug, Clone, Serialize)]
pub(super) struct StageRow {
    pub(super) stage: &'static str,
    /// Simulations spent in this stage.
    pub(super) simulations: f64,
    pub(super) parameter: String,
    pub(super) value: f64,
}

/// The parameters that the study sets free, each from the study's start, or the data's, or the model's value; and the stages on the way.
pub(super) fn start_space(
    wanted: &PersonalisationPlan,
    base: &HeartModel,
    clock: &Clock,
    measured_ml: &[f64],
    context: &RunContext,
) -> Result<(ParameterSpace, Vec<StageRow>), RunError> {
    context.progress().stage("finding start values", None);
    let mut start = base.parameters().clone();
    for free in &wanted.parameters {
        start.set(free.parameter, free.start.unwrap_or(start[free.parameter]).clamp(free.lower, free.upper))?;
    }
    let mut pilots = Pilots { wanted, base, clock, context, count: 0, rows: Vec::new() };
    pilots.note("study", &start);
    if let Err(error) = pilots.follow_volume_curve(measured_ml, &mut start) {
        if context.is_stopped() {
            return Err(RunError::Stopped);
        }
        context.progress().warning(&format!("start values are the model's own: {error}"));
        pilots.weaken_until_it_beats(&mut start)?;
    }
    let entries =
        wanted.parameters.iter().flat_map(|free| regional_parameters(free, base.anatomy()).map(|regional| entry(free, regional, &start)));
    let space = ParameterSpace::new(start.clone(), entries.collect())?;
    let by_segment = wanted.parameters.iter().filter(|free| free.regions == Regions::AhaSegments);
    let space = by_segment.fold(space, |space, free| space.with_alike_segments(free.parameter, free.neighbour_sd));
    Ok((space, pilots.rows))
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

/// The stages of \[Billet2009\] §6.2 before the search for all parameters together, on the volume curve alone.
struct Pilots<'a> {
    wanted: &'a PersonalisationPlan,
    base: &'a HeartModel,
    clock: &'a Clock,
    context: &'a RunContext<'a>,
    /// Simulations since the last stage.
    count: u32,
    rows: Vec<StageRow>,
}

impl Pilots<'_> {
    /// Moves what has no start of its own in the study: the electrical parameters first, then σ0, then the timing once more with a pilot.
    fn follow_volume_curve(&mut self, measured_ml: &[f64], start: &mut Parameters) -> Result<(), RunError> {
        let measured = self.timing(measured_ml)?;
        let guess = ElectricalTiming::from_volume(&measured, ISOVOLUMIC_CONTRACTION_S, activation_span_s(self.base));
        self.place(start, guess)?;
        self.note("electrical", start);
        if let Some(bounds) = self.open_bounds(Parameter::ContractionPeakLv) {
            let first = start[Parameter::ContractionPeakLv];
            let found = start.clone();
            let target = measured.ejection_fraction();
            let fit =
                contraction_peak_for_ejection_fraction(target, bounds, first, EJECTION_FRACTION_TOLERANCE, MOST_PILOTS, |peak_kpa| {
                    match self.pilot(&found.clone().with(Parameter::ContractionPeakLv, peak_kpa)?) {
                        // A beat that cannot be simulated is one that is too strong.
                        Err(PersonalisationError::Simulation { .. }) if !self.context.is_stopped() => Ok(1.0),
                        pilot => Ok(pilot?.ejection_fraction()),
                    }
                })?;
            start.set(Parameter::ContractionPeakLv, fit.value.clamp(bounds.0, bounds.1))?;
            self.note("contraction", start);
        }
        let tried = ElectricalTiming {
            onset_time_s: start[Parameter::OnsetTime],
            action_potential_duration_s: start[Parameter::ActionPotentialDuration],
        };
        let pilot = self.pilot(start)?;
        self.place(start, tried.corrected(&pilot, &measured))?;
        self.note("timing", start);
        Ok(())
    }

    /// A start too strong to be simulated is weakened until it can be.
    fn weaken_until_it_beats(&mut self, start: &mut Parameters) -> Result<(), RunError> {
        let peak = self.wanted.parameters.iter().find(|free| free.parameter == Parameter::ContractionPeakLv && !free.fixed);
        let Some(peak) = peak else { return Ok(()) };
        for _ in 0..MOST_PILOTS {
            self.count += 1;
            match simulate_parameters(self.base, start.clone(), self.clock, &|| self.context.is_stopped()) {
                Ok(_) => break,
                Err(_) if self.context.is_stopped() => return Err(RunError::Stopped),
                Err(_) => start.set(peak.parameter, (WEAKENED * start[peak.parameter]).max(peak.lower))?,
            }
        }
        self.note("weakened", start);
        Ok(())
    }

    /// The bounds of a parameter whose start is left to the data.
    fn open_bounds(&self, parameter: Parameter) -> Option<(f64, f64)> {
        let open = self.wanted.parameters.iter().find(|free| free.parameter == parameter && free.start.is_none() && !free.fixed)?;
        Some((open.lower, open.upper))
    }

    fn place(&self, start: &mut Parameters, timing: ElectricalTiming) -> Result<(), RunError> {
        let values =
            [(Parameter::OnsetTime, timing.onset_time_s), (Parameter::ActionPotentialDuration, timing.action_potential_duration_s)];
        for (parameter, value) in values {
            if let Some((lower, upper)) = self.open_bounds(parameter) {
                start.set(parameter, value.clamp(lower, upper))?;
            }
        }
        Ok(())
    }

    fn timing(&self, volumes_ml: &[f64]) -> Result<VolumeTiming, PersonalisationError> {
        // The last frame is the first of the next beat.
        let count = self.clock.times_s.len().min(volumes_ml.len()).saturating_sub(1);
        VolumeTiming::from_curve(&self.clock.times_s[..count], &volumes_ml[..count], self.clock.period_s)
    }

    fn pilot(&mut self, parameters: &Parameters) -> Result<VolumeTiming, PersonalisationError> {
        let failed = |source| PersonalisationError::Simulation { coordinates: Vec::new(), source };
        self.count += 1;
        let (_, trajectory) = simulate_parameters(self.base, parameters.clone(), self.clock, &|| self.context.is_stopped())
            .map_err(|error| failed(error.into()))?;
        self.timing(&frame_volumes_lv_ml(&trajectory))
    }

    /// The rows of a stage that is over.
    fn note(&mut self, stage: &'static str, parameters: &Parameters) {
        let simulations = f64::from(std::mem::take(&mut self.count));
        let row =
            |parameter: Parameter| StageRow { stage, simulations, parameter: parameter.spec().name.into(), value: parameters[parameter] };
        self.rows.extend(self.wanted.parameters.iter().map(|free| row(free.parameter)));
    }
}

fn activation_span_s(model: &HeartModel) -> f64 {
    let times_s = model.activation().times_s().iter().copied();
    let (first_s, last_s) = times_s.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    last_s - first_s
}
