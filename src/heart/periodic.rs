//! Beats until they repeat themselves.

use std::ops::ControlFlow;

use super::{CurveRow, HeartModel, HeartState, Parameter, SimulationPlan, StepError, Trajectory, simulate_from};
use crate::mechanics::StepLoad;

/// When beats count as repeating.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Periodicity {
    /// Largest difference of any cavity volume between a beat and the one before, mL.
    pub tolerance_ml: f64,
    /// Beats after which it is given up.
    pub beat_limit: usize,
}

impl Default for Periodicity {
    fn default() -> Self {
        Self { tolerance_ml: 0.5, beat_limit: 20 }
    }
}

/// What repeating the beats came to; not reaching the periodic state is an outcome, not an error.
#[derive(Debug, Clone, PartialEq)]
pub struct PeriodicOutcome {
    /// The last beat alone.
    pub last_beat: Trajectory,
    /// The curves of all beats.
    pub curves: Vec<CurveRow>,
    /// Beats done.
    pub beat_count: usize,
    /// Largest difference of a cavity volume between the last two beats, mL; infinite after one beat.
    pub change_ml: f64,
    /// Whether that is within the tolerance.
    pub is_periodic: bool,
}

/// Beats a heart from `start_time_s`, as [`simulate`](super::simulate), until two consecutive beats agree, or the limit is reached. The frames are those of the
/// last beat, at the `frame_times_s` after its start that lie within one period, its end included.
///
/// # Errors
/// The [`StepError`] of the first step that fails.
pub fn simulate_until_periodic(
    model: &HeartModel,
    start_time_s: f64,
    frame_times_s: &[f64],
    periodicity: Periodicity,
    loads: &[&dyn StepLoad],
    observer: &mut dyn FnMut(&HeartState, &CurveRow) -> ControlFlow<()>,
) -> Result<PeriodicOutcome, StepError> {
    let period_s = model.parameters()[Parameter::HeartPeriod];
    let mut state = model.state_at_start(start_time_s, &mut model.workspace())?;
    let mut curves: Vec<CurveRow> = Vec::new();
    let mut before: Option<Trajectory> = None;
    let mut early_frames = Vec::new();
    let mut beat_count = 0_usize;
    let rounding_s = 1e-9 * period_s;
    let wants_end = frame_times_s.iter().any(|time_s| (time_s - period_s).abs() <= rounding_s);
    loop {
        // A beat ends with the step that reaches or passes its end, so that step may hold frames of the next one.
        let [start_s, end_s] = [beat_count, beat_count + 1].map(|beat| start_time_s + period_s * beat as f64);
        let within = frame_times_s.iter().filter(|&&time_s| (0.0..period_s - rounding_s).contains(&time_s));
        let times_s = within.clone().map(|time_s| start_s + time_s).chain(within.map(|time_s| end_s + time_s)).collect();
        let plan = SimulationPlan { start_time_s: state.time_s, end_time_s: end_s, frame_times_s: times_s };
        let mut beat = simulate_from(model, state, &plan, loads, observer)?;
        let late_frames = beat.frames.split_off(beat.frames.partition_point(|frame| frame.time_s < end_s - rounding_s));
        let early = std::mem::replace(&mut early_frames, late_frames);
        // A frame that one beat ends on and the next starts from is met twice.
        let met_s = early.last().map_or(f64::NEG_INFINITY, |frame| frame.time_s + rounding_s);
        beat.frames.retain(|frame| frame.time_s > met_s);
        beat.frames.splice(0..0, early);
        beat_count += 1;
        curves.extend(beat.curves.iter().skip(usize::from(beat_count > 1)));
        let change_ml = before.as_ref().map_or(f64::INFINITY, |before| largest_change_ml(&before.curves, &beat.curves, period_s));
        let is_periodic = change_ml <= periodicity.tolerance_ml;
        if is_periodic || beat.stopped || beat_count >= periodicity.beat_limit {
            let end = early_frames.first().filter(|frame| wants_end && (frame.time_s - end_s).abs() <= rounding_s);
            beat.frames.extend(end.cloned());
            return Ok(PeriodicOutcome { last_beat: beat, curves, beat_count, change_ml, is_periodic });
        }
        state = beat.last.clone();
        before = Some(beat);
    }
}

/// Largest difference between the volumes of a beat and those one period before, interpolated, mL.
fn largest_change_ml(before: &[CurveRow], after: &[CurveRow], period_s: f64) -> f64 {
    let mut largest_ml = 0.0_f64;
    for row in after {
        let time_s = row.time_s - period_s;
        let next = before.partition_point(|earlier| earlier.time_s <= time_s);
        let (Some(earlier), Some(later)) = (before.get(next.saturating_sub(1)), before.get(next.min(before.len() - 1))) else { continue };
        let span_s = later.time_s - earlier.time_s;
        let weight = if span_s > 0.0 { ((time_s - earlier.time_s) / span_s).clamp(0.0, 1.0) } else { 0.0 };
        let volumes = |row: &CurveRow| [row.volume_lv_ml, row.volume_rv_ml].map(|volume| volume.unwrap_or(0.0));
        for ((now, from), to) in volumes(row).into_iter().zip(volumes(earlier)).zip(volumes(later)) {
            largest_ml = largest_ml.max((now - from - (to - from) * weight).abs());
        }
    }
    largest_ml
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heart::idealised_lv::IdealisedLv;
    use crate::heart::{ModelSettings, Parameters};
    use std::sync::Arc;

    fn run(tolerance_ml: f64, beat_limit: usize) -> PeriodicOutcome {
        let anatomy = Arc::new(IdealisedLv { resolution: [12, 6, 1], ..IdealisedLv::default() }.anatomy());
        let settings = ModelSettings { step_s: 0.01, ..ModelSettings::default() };
        // The step does not divide the period, so beats start at shifted instants.
        let parameters = Parameters::default().with(Parameter::HeartPeriod, 0.803).unwrap();
        let model = HeartModel::new(anatomy, parameters, settings).unwrap();
        let periodicity = Periodicity { tolerance_ml, beat_limit };
        simulate_until_periodic(&model, -0.1, &[0.0, 0.4], periodicity, &[], &mut |_, _| ControlFlow::Continue(())).unwrap()
    }

    #[test]
    fn beats_repeat_and_the_last_one_is_kept() {
        let outcome = run(1.0, 30);
        assert!(outcome.is_periodic && outcome.change_ml <= 1.0 && outcome.beat_count > 1, "{} mL", outcome.change_ml);
        let start_s = -0.1 + 0.803 * (outcome.beat_count - 1) as f64;
        let times: Vec<f64> = outcome.last_beat.frames.iter().map(|frame| frame.time_s - start_s).collect();
        assert_eq!(times.len(), 2, "{times:?}");
        assert!((times[0] - 0.0).abs() < 1e-9 && (times[1] - 0.4).abs() < 1e-9, "{times:?}");
        assert!(outcome.curves.windows(2).all(|pair| pair[1].time_s > pair[0].time_s), "no row stands twice");
    }

    /// Also where steps end on the start of the next beat, and its end is asked for.
    #[test]
    fn every_frame_of_the_last_beat_stands_once() {
        let anatomy = Arc::new(IdealisedLv { resolution: [12, 6, 1], ..IdealisedLv::default() }.anatomy());
        let parameters = Parameters::default().with(Parameter::HeartPeriod, 0.8).unwrap();
        let model = HeartModel::new(anatomy, parameters, ModelSettings { step_s: 0.01, ..ModelSettings::default() }).unwrap();
        let times_s: Vec<f64> = (0..=8).map(|frame| 0.1 * f64::from(frame)).collect();
        let periodicity = Periodicity { tolerance_ml: 1e-12, beat_limit: 3 };
        let beat = simulate_until_periodic(&model, -0.15, &times_s, periodicity, &[], &mut |_, _| ControlFlow::Continue(())).unwrap();
        let found_s: Vec<f64> = beat.last_beat.frames.iter().map(|frame| frame.time_s + 0.15 - 1.6).collect();
        assert_eq!(found_s.len(), times_s.len(), "{found_s:?}");
        assert!(found_s.iter().zip(&times_s).all(|(found, wanted)| (found - wanted).abs() < 1e-9), "{found_s:?}");
    }

    #[test]
    fn the_limit_of_beats_is_an_outcome() {
        let outcome = run(1e-12, 2);
        assert!(!outcome.is_periodic && outcome.beat_count == 2 && outcome.change_ml > 1e-12);
    }
}
