//! A cine sequence: one heart beat in frames on one grid, periodic in time.

use super::{Grid, ImageError, Volume};

/// Frames of one cardiac cycle. Times are seconds after the trigger (R wave), ascending, within one period; the sequence repeats.
#[derive(Debug, Clone, PartialEq)]
pub struct CineSequence {
    frames: Vec<Volume>,
    times_s: Vec<f64>,
    period_s: f64,
}

impl CineSequence {
    /// Keeps frames with their times.
    ///
    /// # Errors
    /// [`ImageError::InconsistentCine`] if there are fewer than two frames, numbers differ, grids differ, or the times are not
    /// ascending within one positive period.
    pub fn new(frames: Vec<Volume>, times_s: Vec<f64>, period_s: f64) -> Result<Self, ImageError> {
        let inconsistent = |reason: String| Err(ImageError::InconsistentCine { reason });
        if frames.len() < 2 || frames.len() != times_s.len() {
            return inconsistent(format!("{} frames and {} times; two or more of each are needed", frames.len(), times_s.len()));
        }
        if frames.iter().any(|frame| frame.grid() != frames[0].grid()) {
            return inconsistent("its frames lie on different grids".into());
        }
        if !(times_s.windows(2).all(|pair| pair[0] < pair[1]) && times_s.iter().all(|t| t.is_finite())) {
            return inconsistent("its frame times do not ascend".into());
        }
        let span_s = times_s[times_s.len() - 1] - times_s[0];
        if !(period_s.is_finite() && period_s > span_s) {
            return inconsistent(format!("its frames span {span_s} s, which does not fit into a heart period of {period_s} s"));
        }
        Ok(Self { frames, times_s, period_s })
    }

    /// The grid of every frame.
    pub fn grid(&self) -> &Grid {
        self.frames[0].grid()
    }

    /// The frames in order of time.
    pub fn frames(&self) -> &[Volume] {
        &self.frames
    }

    /// Frame times, s after the trigger.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Heart period HP, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The same beat at another heart period (s, positive): every frame keeps its phase t/HP, as when two breath-holds are brought together.
    ///
    /// # Errors
    /// [`ImageError::InconsistentCine`] if the period is not a positive number.
    pub fn at_period(self, period_s: f64) -> Result<Self, ImageError> {
        let scale = period_s / self.period_s;
        let times_s = self.times_s.iter().map(|time_s| time_s * scale).collect();
        Self::new(self.frames, times_s, period_s)
    }

    /// The two frames around a time and the weight of the second: (earlier, later, weight), periodic.
    pub fn frames_around(&self, time_s: f64) -> (usize, usize, f64) {
        let last = self.times_s.len() - 1;
        let phase_s = self.times_s[0] + (time_s - self.times_s[0]).rem_euclid(self.period_s);
        let earlier = self.times_s.partition_point(|&t| t <= phase_s).max(1) - 1;
        let later_s = if earlier == last { self.times_s[0] + self.period_s } else { self.times_s[earlier + 1] };
        let weight = (phase_s - self.times_s[earlier]) / (later_s - self.times_s[earlier]);
        (earlier, (earlier + 1) % self.times_s.len(), weight.clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn time_wraps_round_the_period() {
        let grid = Grid::axis_aligned([1, 1, 1], Vector3::zeros(), Vector3::repeat(1.0)).unwrap();
        let frame = || Volume::new(grid.clone(), vec![0.0]).unwrap();
        let cine = CineSequence::new(vec![frame(), frame()], vec![0.1, 0.5], 1.0).unwrap();
        let (earlier, later, weight) = cine.frames_around(0.3);
        assert_eq!((earlier, later), (0, 1));
        assert!((weight - 0.5).abs() < 1e-12);
        let (earlier, later, weight) = cine.frames_around(-0.2);
        assert_eq!((earlier, later), (1, 0));
        assert!((weight - 0.5).abs() < 1e-12);
        let slower = cine.clone().at_period(1.5).unwrap();
        assert!((slower.frames_around(-0.3).2 - 0.5).abs() < 1e-12 && slower.period_s() == 1.5);
        assert!(cine.at_period(f64::NAN).is_err());
    }
}
