//! When the tissue is depolarised, beat after beat: the heart's own beats, and what extra stimuli make of them, \[Billet2009\] §2.
//!
//! Undisturbed, one activation map repeats every heart period. A stimulus that finds recovered tissue (td + APD has passed) starts a
//! depolarisation of its own; one that finds refractory tissue does nothing, and so does an own beat that falls into the refractory time
//! of an extra one, which leaves the compensatory pause.

use std::sync::Arc;

use nalgebra::Vector3;

use super::onset::conduction;
use super::{HeartError, ModelSettings, Parameter, Parameters};
use crate::anatomy::Anatomy;
use crate::electrophysiology::{ActivationMap, ActivationSettings, Onset, activate, activate_beats, nearest_vertex};

/// Beats after the last extra stimulus within which the rhythm must have come to repeat itself.
const SETTLING_BEATS: usize = 8;
/// Depolarisations that differ by less count as repeating, s. Where stencils depend on each other in circles the march settles a time to
/// 0.05 ms only; no step of the mechanics is so short.
const SAME_S: f64 = 2e-4;

/// A stimulus that is given once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtraStimulus {
    /// The vertex nearest to this point (world, mm) is stimulated.
    pub point_mm: Vector3<f64>,
    /// Beat, from 0.
    pub beat: usize,
    /// Time after the onset of that beat, s; less than a heart period.
    pub delay_s: f64,
}

/// All depolarisations of all vertices: some that come once, then some that repeat without end.
#[derive(Debug, Clone, PartialEq)]
pub struct HeartRhythm {
    own_beat: Arc<ActivationMap>,
    /// td of the vertices in each depolarisation that comes once, s.
    once_s: Vec<Vec<f64>>,
    /// td in the first round of those that repeat, s.
    repeating_s: Vec<Vec<f64>>,
    /// Time after which they repeat: one heart period, or several.
    cycle_s: f64,
    blocked: Vec<usize>,
}

/// From the first to the last td of one depolarisation of the heart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Depolarisation {
    /// First td, s.
    pub start_s: f64,
    /// Last td, s.
    pub end_s: f64,
}

impl HeartRhythm {
    /// The rhythm of a heart; `own_beat` is the map of its own first beat where that is known.
    pub(super) fn new(
        anatomy: &Anatomy,
        parameters: &Parameters,
        settings: &ModelSettings,
        own_beat: Option<&Arc<ActivationMap>>,
    ) -> Result<Self, HeartError> {
        let period_s = parameters[Parameter::HeartPeriod];
        let refractory_s = parameters.on_vertices(Parameter::ActionPotentialDuration, anatomy);
        let own = settings.onset_sites.onsets(anatomy, parameters);
        let own_beat = match own_beat {
            Some(known) => Arc::clone(known),
            None => Arc::new(activate(&anatomy.mesh, &conduction(anatomy, parameters)?, &own)?),
        };
        let returns = |onset: &Onset| onset.time_s >= own_beat.times_s()[onset.vertex] + refractory_s[onset.vertex];
        let returns = own.iter().any(returns);
        if settings.extra_stimuli.is_empty() && !returns {
            return Ok(Self::undisturbed(own_beat, period_s, vec![]));
        }
        let disturbed = Self::disturbed(anatomy, parameters, settings, Arc::clone(&own_beat))?;
        if disturbed.blocked.len() == settings.extra_stimuli.len() && !returns {
            return Ok(Self::undisturbed(own_beat, period_s, disturbed.blocked));
        }
        Ok(disturbed)
    }

    fn undisturbed(own_beat: Arc<ActivationMap>, period_s: f64, blocked: Vec<usize>) -> Self {
        let repeating_s = vec![own_beat.times_s().to_vec()];
        Self { own_beat, once_s: vec![], repeating_s, cycle_s: period_s, blocked }
    }

    /// The rhythm of a heart that something disturbs.
    fn disturbed(
        anatomy: &Anatomy,
        parameters: &Parameters,
        settings: &ModelSettings,
        own_beat: Arc<ActivationMap>,
    ) -> Result<Self, HeartError> {
        let (period_s, own) = (parameters[Parameter::HeartPeriod], settings.onset_sites.onsets(anatomy, parameters));
        let start_s = parameters[Parameter::OnsetTime];
        check_delays(own.iter().map(|onset| onset.time_s - start_s).chain(settings.extra_stimuli.iter().map(|s| s.delay_s)), period_s)?;
        let last_beat = settings.extra_stimuli.iter().map(|stimulus| stimulus.beat).max().unwrap_or(0) + SETTLING_BEATS;
        let mut stimuli: Vec<Onset> = Vec::new();
        for stimulus in &settings.extra_stimuli {
            let time_s = start_s + period_s * stimulus.beat as f64 + stimulus.delay_s;
            stimuli.extend(nearest_vertex(anatomy.mesh.vertices_mm(), &stimulus.point_mm).map(|vertex| Onset { vertex, time_s }));
        }
        let extra_count = stimuli.len();
        stimuli.extend((0..=last_beat).flat_map(|beat| own.iter().map(move |&onset| later(onset, period_s * beat as f64))));
        let refractory_s = parameters.on_vertices(Parameter::ActionPotentialDuration, anatomy);
        let rhythm =
            activate_beats(&anatomy.mesh, &conduction(anatomy, parameters)?, &stimuli, &refractory_s, &ActivationSettings::default())?;
        let mut times_s: Vec<Vec<f64>> = rhythm.beats().iter().map(|beat| beat.times_s().to_vec()).collect();
        let (cycle, period_count) = cycle(&times_s, period_s).ok_or(HeartError::RestlessRhythm { beat_count: last_beat + 1 })?;
        let repeating_s = times_s[cycle.clone()].to_vec();
        times_s.truncate(cycle.start);
        let blocked = rhythm.blocked_stimuli().iter().copied().filter(|&stimulus| stimulus < extra_count).collect();
        Ok(Self { own_beat, once_s: times_s, repeating_s, cycle_s: period_s * period_count, blocked })
    }

    /// The first of the heart's own beats, undisturbed.
    pub fn own_beat(&self) -> &Arc<ActivationMap> {
        &self.own_beat
    }

    /// Whether one map repeats every heart period.
    pub fn is_regular(&self) -> bool {
        self.once_s.is_empty() && self.repeating_s.len() == 1
    }

    /// Extra stimuli that found refractory tissue and did nothing, by their number in [`ModelSettings::extra_stimuli`].
    pub fn blocked_stimuli(&self) -> &[usize] {
        &self.blocked
    }

    /// Time since the latest td of a vertex, s; nothing before its first.
    pub fn since_depolarisation_s(&self, vertex: usize, time_s: f64) -> Option<f64> {
        let since = |td_s: &Vec<f64>| Some(time_s - td_s[vertex]).filter(|&since_s| since_s >= 0.0);
        let repeated = self.repeating_s.iter().filter_map(since).map(|since_s| since_s.rem_euclid(self.cycle_s));
        repeated.chain(self.once_s.iter().filter_map(since)).min_by(f64::total_cmp)
    }

    /// The depolarisations that begin after `start_s` and not after `end_s`, in order of time.
    pub fn depolarisations(&self, start_s: f64, end_s: f64) -> Vec<Depolarisation> {
        let span = |times_s: &Vec<f64>| {
            let (first, last) = times_s.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &t| (a.min(t), b.max(t)));
            Depolarisation { start_s: first, end_s: last }
        };
        let mut found: Vec<Depolarisation> = self.once_s.iter().map(span).collect();
        for first in self.repeating_s.iter().map(span) {
            let round = |n: u32| f64::from(n) * self.cycle_s;
            let rounds = (0..).map(round).take_while(|later_s| first.start_s + later_s <= end_s);
            found.extend(rounds.map(|later_s| Depolarisation { start_s: first.start_s + later_s, end_s: first.end_s + later_s }));
        }
        found.retain(|depolarisation| depolarisation.start_s > start_s && depolarisation.start_s <= end_s);
        found.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
        found
    }
}

fn later(onset: Onset, later_s: f64) -> Onset {
    Onset { time_s: onset.time_s + later_s, ..onset }
}

fn check_delays(mut delays_s: impl Iterator<Item = f64>, period_s: f64) -> Result<(), HeartError> {
    let requirement = "from zero to less than the heart period, so that a stimulus belongs to its beat";
    match delays_s.find(|delay_s| !(0.0..period_s).contains(delay_s)) {
        Some(value) => Err(HeartError::Setting { setting: "delay_s", value, requirement }),
        None => Ok(()),
    }
}

/// The last depolarisations that repeat the ones before them, as many as there are in a cycle, moved back to their first round; and
/// the heart periods that a cycle takes.
fn cycle(times_s: &[Vec<f64>], period_s: f64) -> Option<(std::ops::Range<usize>, f64)> {
    let count = times_s.len();
    for length in 1..=count / 2 {
        let period_count = ((times_s[count - 1][0] - times_s[count - 1 - length][0]) / period_s).round();
        let repeats = |map: usize| {
            let pairs = times_s[map].iter().zip(&times_s[map + length]);
            pairs.into_iter().all(|(before_s, after_s)| (after_s - before_s - period_count * period_s).abs() < SAME_S)
        };
        let same_count = (0..count - length).rev().take_while(|&map| repeats(map)).count();
        if period_count >= 1.0 && same_count >= length {
            let start = count - length - same_count;
            return Some((start..start + length, period_count));
        }
    }
    None
}
