//! When the frames of a cine sequence were taken, and how long the heart's period is.

use std::path::Path;

use serde::Deserialize;

use super::ImageError;
use super::phases::CommonPhases;

/// What is known about a cine's times beside its header; what is `None` is taken from the header.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CineTiming {
    /// Time of the first frame after the trigger (R wave), s.
    pub start_s: Option<f64>,
    /// Heart period, s.
    pub period_s: Option<f64>,
    /// Time of every frame after the trigger, s; wins over `start_s`.
    pub frame_times_s: Option<Vec<f64>>,
    /// What was assumed, in words.
    pub warnings: Vec<String>,
    /// At which phases each slice was taken, where that is known.
    pub(super) phases: Option<CommonPhases>,
}

/// Shortest and longest heart period that is believed, s (from small rodents to athletes at rest).
const PERIOD_RANGE_S: (f64, f64) = (0.08, 4.0);

/// Heart periods of slices that differ by more than this fraction are reported.
const PERIOD_SPREAD_REPORTED: f64 = 0.005;

#[derive(Deserialize)]
struct Sidecar {
    trigger_time_ms_per_slice: Vec<Vec<f64>>,
    #[serde(default)]
    nominal_interval_ms: Vec<f64>,
}

impl CineTiming {
    /// Times from a JSON file beside the image, with the keys `trigger_time_ms_per_slice` (slices × frames, ms after the R wave) and, where
    /// known, `nominal_interval_ms` (heart periods met, ms). Slices taken at different heart periods are brought onto common phases:
    /// each slice's times are divided by its own period (see `slice_periods_ms`), and the median over the slices is multiplied by
    /// the median period. A slice that was taken at other phases is interpolated when the image is read.
    ///
    /// # Errors
    /// [`ImageError::Unreadable`] or [`ImageError::Unusable`].
    pub fn from_sidecar(path: &Path) -> Result<Self, ImageError> {
        let text =
            std::fs::read_to_string(path).map_err(|error| ImageError::Unreadable { path: path.into(), reason: error.to_string() })?;
        let sidecar: Sidecar =
            serde_json::from_str(&text).map_err(|error| ImageError::Unusable { path: path.into(), reason: error.to_string() })?;
        Self::from_trigger_times_ms(&sidecar.trigger_time_ms_per_slice, &sidecar.nominal_interval_ms)
            .map_err(|reason| ImageError::Unusable { path: path.into(), reason })
    }

    /// The same from numbers: slices × frames, ms; and the heart periods met, ms, which may be empty.
    ///
    /// # Errors
    /// Says which slice has fewer than two times, another number of them, or times that do not ascend.
    pub fn from_trigger_times_ms(slices: &[Vec<f64>], nominal_interval_ms: &[f64]) -> Result<Self, String> {
        let frame_count = slices.first().map_or(0, Vec::len);
        if frame_count < 2 {
            return Err("trigger times of at least one slice and two frames are needed".into());
        }
        for (slice, times) in slices.iter().enumerate() {
            if times.len() != frame_count {
                return Err(format!("slice {slice} has {} trigger times where slice 0 has {frame_count}", times.len()));
            }
            if !(times.windows(2).all(|pair| pair[0] < pair[1]) && times.iter().all(|t| t.is_finite())) {
                return Err(format!("the trigger times of slice {slice} do not ascend"));
            }
        }
        let periods_s: Vec<f64> = slice_periods_ms(slices, nominal_interval_ms).iter().map(|ms| ms / 1000.0).collect();
        let frame_phase =
            |frame: usize| median(slices.iter().zip(&periods_s).map(|(times, period_s)| times[frame] / 1000.0 / period_s).collect());
        let phases: Vec<f64> = (0..frame_count).map(frame_phase).collect();
        let period_s = median(periods_s.clone());
        let shortest_s = periods_s.iter().copied().fold(f64::INFINITY, f64::min);
        let longest_s = periods_s.iter().copied().fold(0.0, f64::max);
        let mut warnings = Vec::new();
        if longest_s - shortest_s > PERIOD_SPREAD_REPORTED * period_s {
            warnings.push(format!(
                "the heart period differs by slice from {:.0} to {:.0} ms; the slices were brought onto common phases of {:.0} ms",
                1000.0 * shortest_s,
                1000.0 * longest_s,
                1000.0 * period_s
            ));
        }
        let frame_times_s = phases.iter().map(|phase| phase * period_s).collect();
        let own_phases = |(times, period_s): (&Vec<f64>, &f64)| times.iter().map(|ms| ms / 1000.0 / period_s).collect();
        let phases = CommonPhases { common: phases, own: slices.iter().zip(&periods_s).map(own_phases).collect() };
        Ok(Self { start_s: None, period_s: Some(period_s), frame_times_s: Some(frame_times_s), warnings, phases: Some(phases) })
    }

    /// Frame times and period of `frame_count` frames, with the header's start and step where nothing better is known.
    ///
    /// # Errors
    /// Says what is missing or contradicts itself.
    pub(crate) fn resolve(&self, frame_count: usize, header_start_s: f64, header_step_s: Option<f64>) -> Result<(Vec<f64>, f64), String> {
        let start_s = self.start_s.unwrap_or(header_start_s);
        let step_s = || match (header_step_s, self.period_s) {
            (Some(step_s), _) => Ok(step_s),
            (None, Some(period_s)) => Ok(period_s / frame_count as f64),
            (None, None) => Err("its header has no frame step; give the heart period or the frame times".to_string()),
        };
        let times_s = match &self.frame_times_s {
            Some(times_s) if times_s.len() == frame_count => times_s.clone(),
            Some(times_s) => return Err(format!("{} frame times were given for its {frame_count} frames", times_s.len())),
            None => {
                let step_s = self.compatible_step(step_s()?, frame_count);
                (0..frame_count).map(|frame| start_s + step_s * frame as f64).collect()
            }
        };
        let period_s = match self.period_s {
            Some(period_s) => period_s,
            None if self.frame_times_s.is_some() => spanned_period(&times_s),
            None => step_s()? * frame_count as f64,
        };
        if !(period_s >= PERIOD_RANGE_S.0 && period_s <= PERIOD_RANGE_S.1) {
            return Err(format!(
                "a heart period of {period_s} s is not believable ({} to {} s is); check the header's time unit or give the heart period",
                PERIOD_RANGE_S.0, PERIOD_RANGE_S.1
            ));
        }
        Ok((times_s, period_s))
    }

    /// Says by how much a given heart period is too short for the frames of a header; frames that fall short of the period are said elsewhere.
    pub(super) fn contradiction(&self, header_step_s: f64, frame_count: usize) -> Option<String> {
        const ROUNDING: f64 = 0.02;
        let (period_s, header_s) = (self.period_s?, header_step_s * frame_count as f64);
        (self.frame_times_s.is_none() && header_s > (1.0 + ROUNDING) * period_s).then(|| {
            format!("its frames of {header_step_s} s make a heart period of {header_s:.3} s, but {period_s} s were given; the frames were spread over these")
        })
    }

    /// Headers round the step; where the period is known, frames that would not fit into it are spread over it evenly.
    fn compatible_step(&self, step_s: f64, frame_count: usize) -> f64 {
        match self.period_s {
            Some(period_s) if step_s * (frame_count as f64 - 0.5) > period_s => period_s / frame_count as f64,
            _ => step_s,
        }
    }
}

/// n/(n−1) times the time from the first to the last of n frames: their period if they are evenly spread over it.
fn spanned_period(times: &[f64]) -> f64 {
    let count = times.len() as f64;
    (times[times.len() - 1] - times[0]) * count / (count - 1.0)
}

/// The heart period of every slice (ms) of slices × trigger times (ms): the scanner's own where it is known for each slice, else the one
/// that the frames span, n/(n−1) times their range. Where the periods met say that the frames cover a part of the beat only
/// (prospective gating), the spanned ones are stretched to them.
pub(super) fn slice_periods_ms(slices: &[Vec<f64>], nominal_interval_ms: &[f64]) -> Vec<f64> {
    const PARTIAL_BEAT: f64 = 0.05;
    if !nominal_interval_ms.is_empty() && nominal_interval_ms.len() == slices.len() {
        return nominal_interval_ms.to_vec();
    }
    let spanned: Vec<f64> = slices.iter().map(|times| spanned_period(times)).collect();
    if nominal_interval_ms.is_empty() || spanned.is_empty() {
        return spanned;
    }
    let stretch = median(nominal_interval_ms.to_vec()) / median(spanned.clone());
    if stretch > 1.0 + PARTIAL_BEAT { spanned.into_iter().map(|ms| ms * stretch).collect() } else { spanned }
}

/// Median of at least one finite number.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { 0.5 * (values[middle - 1] + values[middle]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_of_other_heart_periods_come_onto_common_phases() {
        let slice = |period_ms: f64| (0..20).map(|frame| period_ms * (0.025 + f64::from(frame) / 20.0)).collect::<Vec<_>>();
        let timing = CineTiming::from_trigger_times_ms(&[slice(690.0), slice(700.0), slice(720.0)], &[]).unwrap();
        assert!((timing.period_s.unwrap() - 0.7).abs() < 1e-12);
        let times_s = timing.frame_times_s.unwrap();
        for frame in 0..20 {
            assert!((times_s[frame] - 0.7 * (0.025 + frame as f64 / 20.0)).abs() < 1e-12);
        }
        assert!(timing.warnings[0].contains("690 to 720 ms"), "{:?}", timing.warnings);
    }

    #[test]
    fn frames_of_a_part_of_the_beat_keep_their_times() {
        // 20 frames over the first 600 of 800 ms.
        let slice: Vec<f64> = (0..20).map(|frame| 30.0 * f64::from(frame)).collect();
        let timing = CineTiming::from_trigger_times_ms(&[slice.clone(), slice], &[800.0]).unwrap();
        assert!((timing.period_s.unwrap() - 0.8).abs() < 1e-12);
        assert!((timing.frame_times_s.unwrap()[19] - 0.57).abs() < 1e-12);
    }

    #[test]
    fn header_times_serve_where_nothing_else_is_given() {
        let (times_s, period_s) = CineTiming::default().resolve(20, 0.01, Some(0.0349)).unwrap();
        assert!((times_s[19] - 0.01 - 19.0 * 0.0349).abs() < 1e-12);
        assert!((period_s - 0.698).abs() < 1e-12);
        let known = CineTiming { period_s: Some(0.7), start_s: Some(0.0), ..CineTiming::default() };
        assert!((known.resolve(20, 0.3, None).unwrap().0[10] - 0.35).abs() < 1e-12);
        let rounded_up = CineTiming { period_s: Some(0.631), ..CineTiming::default() };
        assert!(rounded_up.resolve(20, 0.0, Some(0.040)).unwrap().0[19] < 0.631);
    }

    #[test]
    fn contradictions_are_said() {
        let unknown = CineTiming::default();
        assert!(unknown.resolve(20, 0.0, None).unwrap_err().contains("heart period"));
        assert!(unknown.resolve(20, 0.0, Some(34.9)).unwrap_err().contains("not believable"));
        assert!(unknown.resolve(20, 0.0, Some(f64::NAN)).is_err());
        let three = CineTiming { frame_times_s: Some(vec![0.0, 0.1, 0.2]), ..CineTiming::default() };
        assert!(three.resolve(4, 0.0, None).unwrap_err().contains("3 frame times"));
        assert!(CineTiming::from_trigger_times_ms(&[vec![0.0, 1.0], vec![0.0]], &[]).unwrap_err().contains("slice 1"));
        assert!(CineTiming::from_trigger_times_ms(&[], &[]).is_err());
    }
}
