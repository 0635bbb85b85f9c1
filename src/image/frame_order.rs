//! Frames that do not belong where they stand: a corrupt one, one that got out of order, or two that were exchanged.

use rayon::prelude::*;

use super::CineSequence;
use super::timing::median;

/// A frame that differs this many times as much from both its neighbours as they do from each other, and more than frames usually do, is odd.
const ODD: f64 = 1.15;

/// Two frames were exchanged if their squared differences from their neighbours add up to this many times what they would the other way round.
/// Of the sequences at hand in order none exceeds 0.7 (1.004 where frames of a phantom at rest differ by noise alone, 1.2 beside a corrupt frame),
/// and every exchange exceeds 1.3 unless both frames show the same phase.
const EXCHANGED: f64 = 1.25;

/// About as many differences of voxels are taken.
const COMPARISONS: usize = 100_000_000;

/// Frames that resemble neither of their neighbours although those resemble each other, and the two frames that were most likely exchanged,
/// in words. A heart that moves on carries every frame further from the one before the last, and noise tells no pair of frames from another.
pub(super) fn frame_warnings(cine: &CineSequence) -> Vec<String> {
    let count = cine.frames().len();
    if count < 5 {
        return Vec::new();
    }
    let squared = Differences::between(cine);
    let next: Vec<f64> = (0..count).map(|frame| squared.of(frame, frame + 1).sqrt()).collect();
    let usual = median(next.clone());
    let is_odd = |&frame: &usize| {
        let least = next[frame].min(next[(frame + count - 1) % count]);
        least > usual && least > ODD * squared.of(frame + count - 1, frame + 1).sqrt()
    };
    let words = |frame| format!("frame {frame} resembles neither of its neighbours, which resemble each other: corrupt, or out of order?");
    let mut warnings: Vec<String> = (0..count).filter(is_odd).map(words).collect();
    if let Some([one, other]) = squared.exchanged() {
        warnings
            .push(format!("frames {one} and {other} resemble each other's neighbours more than their own: exchanged, or out of order?"));
    }
    warnings
}

/// Sums of squared differences between any two frames of a cyclic sequence.
struct Differences {
    count: usize,
    squared: Vec<f64>,
}

impl Differences {
    fn between(cine: &CineSequence) -> Self {
        let count = cine.frames().len();
        let stride = (cine.grid().voxel_count() * count * count).div_ceil(2 * COMPARISONS);
        let difference = |pair: usize| {
            let [one, other] = [pair / count, pair % count].map(|frame| cine.frames()[frame].values());
            if pair / count >= pair % count {
                return 0.0;
            }
            one.iter().zip(other).step_by(stride).map(|(a, b)| f64::from(a - b).powi(2)).sum()
        };
        Self { count, squared: (0..count * count).into_par_iter().map(difference).collect() }
    }

    fn of(&self, one: usize, other: usize) -> f64 {
        let [one, other] = [one % self.count, other % self.count];
        self.squared[one.min(other) * self.count + one.max(other)]
    }

    /// The two frames that would gain most by an exchange, if that is what happened to them.
    fn exchanged(&self) -> Option<[usize; 2]> {
        let pairs = (0..self.count).flat_map(|one| (one + 1..self.count).map(move |other| [one, other]));
        let gains = pairs.map(|pair| (self.gain_of_exchange(pair), pair));
        gains.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(gain, _)| *gain > EXCHANGED).map(|(_, pair)| pair)
    }

    /// The squared differences across the steps that begin or end at two frames, over those after an exchange of the two.
    fn gain_of_exchange(&self, [one, other]: [usize; 2]) -> f64 {
        let mut steps = [one + self.count - 1, one, other + self.count - 1, other].map(|step| step % self.count);
        steps.sort_unstable();
        let exchanged = |frame: usize| match frame % self.count {
            frame if frame == one => other,
            frame if frame == other => one,
            frame => frame,
        };
        let (mut now, mut then) = (0.0, 0.0);
        for (place, &step) in steps.iter().enumerate() {
            if place == 0 || steps[place - 1] != step {
                now += self.of(step, step + 1);
                then += self.of(exchanged(step), exchanged(step + 1));
            }
        }
        now / then.max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Grid, Volume};
    use nalgebra::Vector3;

    /// A disc that shrinks and grows while it goes aside and back, in noise; `order` says which phase each frame shows.
    fn beating(order: &[usize]) -> CineSequence {
        let grid = Grid::axis_aligned([40, 40, 2], Vector3::zeros(), Vector3::repeat(1.5)).unwrap();
        let frame = |&phase: &usize| {
            let (aside, larger) = (std::f64::consts::TAU * phase as f64 / 12.0).sin_cos();
            let (radius, middle) = (14.0 + 4.0 * larger, 20.0 + 3.0 * aside);
            let value = |flat: usize| {
                let [i, j, k] = grid.voxel_of(flat);
                let noise = (((flat * 7919 + phase * 104_729) % 1009) as f64 / 1009.0 - 0.5) * 40.0;
                (if (i as f64 - middle).hypot(j as f64 - 19.0) < radius { 200.0 } else { 60.0 } + noise + k as f64) as f32
            };
            Volume::new(grid.clone(), (0..grid.voxel_count()).map(value).collect()).unwrap()
        };
        let times_s = (0..order.len()).map(|n| 0.06 * n as f64).collect();
        CineSequence::new(order.iter().map(frame).collect(), times_s, 0.06 * order.len() as f64).unwrap()
    }

    #[test]
    fn a_beat_in_order_is_left_alone() {
        let order: Vec<usize> = (0..12).collect();
        assert!(frame_warnings(&beating(&order)).is_empty());
        assert!(frame_warnings(&beating(&order[..4])).is_empty());
    }

    #[test]
    fn a_frame_out_of_order_and_a_corrupt_one_are_named() {
        let misplaced = frame_warnings(&beating(&[0, 1, 2, 6, 3, 4, 5, 7, 8, 9, 10, 11]));
        assert!(misplaced[0].starts_with("frame 3 "), "{misplaced:?}");
        let cine = beating(&(0..12).collect::<Vec<_>>());
        let mut frames = cine.frames().to_vec();
        let scrambled = frames[8].values().iter().rev().map(|value| value * 0.3).collect();
        frames[8] = Volume::new(cine.grid().clone(), scrambled).unwrap();
        let corrupt = frame_warnings(&CineSequence::new(frames, cine.times_s().to_vec(), cine.period_s()).unwrap());
        assert!(corrupt.len() == 1 && corrupt[0].starts_with("frame 8 "), "{corrupt:?}");
    }

    /// Any two frames are named when they are exchanged.
    #[test]
    fn two_exchanged_frames_are_named() {
        for one in 0..12 {
            for other in one + 1..12 {
                let mut order: Vec<usize> = (0..12).collect();
                order.swap(one, other);
                let warnings = frame_warnings(&beating(&order));
                let words = format!("frames {one} and {other} ");
                assert!(warnings.iter().any(|w| w.starts_with(&words)), "{one} {other}: {warnings:?}");
            }
        }
    }
}
