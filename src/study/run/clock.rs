//! How the times of a cine sequence and of a simulation fit together: the mesh rests at the reference frame, and frames repeat each beat.

/// The beats of a run and the frames that are compared in its last beat.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Clock {
    /// Time at which the mesh rests and the simulation starts, s after the first trigger (negative: before it).
    pub(super) start_s: f64,
    /// End of the last beat, s.
    pub(super) end_s: f64,
    /// Heart period HP, s.
    pub(super) period_s: f64,
    /// Cine frames in the order in which the last beat meets them: the reference frame first, and again last.
    pub(super) frames: Vec<usize>,
    /// When it meets them, s; same order.
    pub(super) times_s: Vec<f64>,
}

impl Clock {
    /// The clock of a run of `beats` beats from the reference frame, with cine frames at `frame_times_s` (ascending, s after the
    /// trigger, within one period).
    ///
    /// A reference in the second half of the cycle belongs to the diastole before the first trigger, so that no contraction precedes it.
    pub(super) fn new(reference_frame: usize, frame_times_s: &[f64], period_s: f64, beats: usize) -> Self {
        let count = frame_times_s.len();
        let reference_s = frame_times_s.get(reference_frame).copied().unwrap_or(0.0);
        let start_s = if reference_s > period_s / 2.0 { reference_s - period_s } else { reference_s };
        let last_beat_s = start_s + (beats.max(1) - 1) as f64 * period_s;
        let met = |n: usize| {
            let frame = (reference_frame + n) % count.max(1);
            let round = if reference_frame + n >= count { period_s } else { 0.0 };
            (frame, last_beat_s + (frame_times_s[frame] - reference_s) + round)
        };
        let (frames, times_s) = if count == 0 { (Vec::new(), Vec::new()) } else { (0..=count).map(met).unzip() };
        Self { start_s, end_s: last_beat_s + period_s, period_s, frames, times_s }
    }

    /// Start of the last beat, s.
    pub(super) fn last_beat_s(&self) -> f64 {
        self.end_s - self.period_s
    }

    /// The trigger of the last beat, s.
    pub(super) fn last_trigger_s(&self) -> f64 {
        self.last_beat_s() - self.start_s
    }

    /// Place of a cine frame in the order of the last beat; of the reference frame its second, after the beat.
    pub(super) fn position_of(&self, frame: usize) -> Option<usize> {
        self.frames.iter().rposition(|&other| other == frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_diastolic_reference_starts_before_the_trigger_and_closes_the_beat() {
        let clock = Clock::new(3, &[0.0, 0.2, 0.4, 0.7], 0.8, 2);
        assert!((clock.start_s + 0.1).abs() < 1e-12 && (clock.end_s - 1.5).abs() < 1e-12);
        assert_eq!(clock.frames, [3, 0, 1, 2, 3]);
        let expected = [0.7, 0.8, 1.0, 1.2, 1.5];
        assert!(clock.times_s.iter().zip(expected).all(|(found, time)| (found - time).abs() < 1e-9), "{:?}", clock.times_s);
        assert_eq!(clock.position_of(3), Some(4));
    }

    #[test]
    fn frames_before_an_early_reference_come_last() {
        let clock = Clock::new(1, &[0.0, 0.2, 0.4], 1.0, 1);
        assert_eq!(clock.frames, [1, 2, 0, 1]);
        let expected = [0.2, 0.4, 1.0, 1.2];
        assert!(clock.times_s.iter().zip(expected).all(|(found, time)| (found - time).abs() < 1e-9), "{:?}", clock.times_s);
    }
}
