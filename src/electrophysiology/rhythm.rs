//! Several beats: every vertex is depolarised again by what reaches it after its refractory time, td + APD, \[Billet2009\] §2.
//!
//! The n-th depolarisation of all vertices is one map; td carries over from one to the next as the time before which nothing can be
//! depolarised. A stimulus on refractory tissue does nothing. A front that runs into tissue not yet recovered waits there until it is,
//! as in the automaton of \[Moe1964\]: what it comes from is still depolarised then. Where the action potential lasts equally long
//! everywhere no front ever waits, for it follows the last one at the same speed.

use std::collections::BTreeMap;

use super::activation::{check, slowing_s, tangent_s};
use super::march::March;
use super::{ActivationError, ActivationMap, ActivationSettings, Conduction, Onset};
use crate::mesh::TetMesh;

/// All depolarisations of all vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct Rhythm {
    beats: Vec<ActivationMap>,
    blocked: Vec<usize>,
}

/// Depolarises a mesh as often as `stimuli` (of any number of beats, in any order) do. `refractory_s` is the time after td during which
/// a vertex cannot be depolarised again (its APD), one a vertex.
///
/// # Errors
/// As [`super::activate`], and [`ActivationError::BadRefractoryTime`].
pub fn activate_beats(
    mesh: &TetMesh,
    conduction: &Conduction,
    stimuli: &[Onset],
    refractory_s: &[f64],
    settings: &ActivationSettings,
) -> Result<Rhythm, ActivationError> {
    check(mesh, conduction, stimuli)?;
    check_refractory(mesh, refractory_s)?;
    let mut recovered_s = vec![f64::NEG_INFINITY; mesh.vertex_count()];
    let mut waiting: Vec<usize> = (0..stimuli.len()).collect();
    let mut rhythm = Rhythm { beats: vec![], blocked: vec![] };
    while !waiting.is_empty() {
        let mut march = March::new(mesh, conduction);
        march.hold_until(&recovered_s);
        march.start(conduction, stimuli, &first_of_each_vertex(stimuli, &waiting), settings);
        march.run();
        let beat = march.finish(conduction, stimuli)?;
        for (recovered_s, (td_s, refractory_s)) in recovered_s.iter_mut().zip(beat.times_s().iter().zip(refractory_s)) {
            *recovered_s = td_s + refractory_s;
        }
        let (later, done): (Vec<usize>, Vec<usize>) =
            waiting.into_iter().partition(|&stimulus| stimuli[stimulus].time_s >= recovered_s[stimuli[stimulus].vertex]);
        rhythm.blocked.extend(done.into_iter().filter(|&s| stimuli[s].time_s > beat.times_s()[stimuli[s].vertex]));
        rhythm.beats.push(beat);
        waiting = later;
    }
    rhythm.blocked.sort_unstable();
    Ok(rhythm)
}

/// Of the stimuli that wait at one vertex only the earliest can start anything.
fn first_of_each_vertex(stimuli: &[Onset], waiting: &[usize]) -> Vec<usize> {
    let mut first: BTreeMap<usize, usize> = BTreeMap::new();
    for &stimulus in waiting {
        let earliest = first.entry(stimuli[stimulus].vertex).or_insert(stimulus);
        if stimuli[stimulus].time_s < stimuli[*earliest].time_s {
            *earliest = stimulus;
        }
    }
    let mut chosen: Vec<usize> = first.into_values().collect();
    chosen.sort_unstable();
    chosen
}

fn check_refractory(mesh: &TetMesh, refractory_s: &[f64]) -> Result<(), ActivationError> {
    let (refractory_count, vertex_count) = (refractory_s.len(), mesh.vertex_count());
    if refractory_count != vertex_count {
        return Err(ActivationError::RefractoryCount { refractory_count, vertex_count });
    }
    match refractory_s.iter().position(|&time_s| !(time_s > 0.0 && time_s.is_finite())) {
        Some(vertex) => Err(ActivationError::BadRefractoryTime { vertex, refractory_s: refractory_s[vertex] }),
        None => Ok(()),
    }
}

impl Rhythm {
    /// The depolarisations, first to last: the first of all vertices, the second, and so on.
    pub fn beats(&self) -> &[ActivationMap] {
        &self.beats
    }

    /// Stimuli that did nothing, because a front had passed and the tissue was refractory.
    pub fn blocked_stimuli(&self) -> &[usize] {
        &self.blocked
    }

    /// td of the last depolarisation of a vertex up to a time, s; nothing before the first.
    pub fn last_depolarisation_s(&self, vertex: usize, time_s: f64) -> Option<f64> {
        self.beats.iter().rev().map(|beat| beat.times_s()[vertex]).find(|&td_s| td_s <= time_s)
    }

    /// Directional derivatives of the td of all beats (s, one a vertex): as [`ActivationMap::tangent_s`], with the refractory time of
    /// vertex v changing at the rate `refractory_rate_s[v]`. Which stimuli are blocked is held fixed.
    pub fn tangents_s(&self, log_speed_rate: &[f64], stimulus_rate_s: &[f64], refractory_rate_s: &[f64]) -> Vec<Vec<f64>> {
        let mut tangents: Vec<Vec<f64>> = Vec::with_capacity(self.beats.len());
        for beat in &self.beats {
            let recovery_rate_s = |vertex: usize| {
                let last_s = tangents.last().map_or(0.0, |last| last[vertex]);
                last_s + refractory_rate_s.get(vertex).copied().unwrap_or(0.0)
            };
            let tangent = tangent_s(beat, &|_, stencil| slowing_s(stencil, log_speed_rate), stimulus_rate_s, &recovery_rate_s);
            tangents.push(tangent);
        }
        tangents
    }
}
