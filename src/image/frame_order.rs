//! Frames that do not belong where they stand: a corrupt one, or one that got out of order.

use rayon::prelude::*;

use super::CineSequence;
use super::timing::median;

/// A frame that differs this many times as much from both its neighbours as they do from each other, and more than frames usually do, is odd.
const ODD: f64 = 1.15;

/// At most about this many voxels are compared.
const VOXELS_MAX: usize = 200_000;

/// Frames that resemble neither of their neighbours although those resemble each other, in words. A heart that moves on carries every frame
/// further from the one before the last, and noise tells no pair of frames from another.
pub(super) fn frame_warnings(cine: &CineSequence) -> Vec<String> {
    let count = cine.frames().len();
    if count < 5 {
        return Vec::new();
    }
    let stride = cine.grid().voxel_count().div_ceil(VOXELS_MAX);
    let difference = |one: usize, other: usize| {
        let (a, b) = (cine.frames()[one].values(), cine.frames()[other % count].values());
        let squares: f64 = a.iter().zip(b).step_by(stride).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        squares.sqrt()
    };
    let next: Vec<f64> = (0..count).into_par_iter().map(|frame| difference(frame, frame + 1)).collect();
    let usual = median(next.clone());
    let is_odd = |&frame: &usize| {
        let least = next[frame].min(next[(frame + count - 1) % count]);
        least > usual && least > ODD * difference((frame + count - 1) % count, frame + 1)
    };
    let words = |frame| format!("frame {frame} resembles neither of its neighbours, which resemble each other: corrupt, or out of order?");
    (0..count).filter(is_odd).map(words).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Grid, Volume};
    use nalgebra::Vector3;

    /// A disc that shrinks and grows, in noise; `order` says which phase each frame shows.
    fn beating(order: &[usize]) -> CineSequence {
        let grid = Grid::axis_aligned([40, 40, 2], Vector3::zeros(), Vector3::repeat(1.5)).unwrap();
        let frame = |&phase: &usize| {
            let radius = 14.0 + 4.0 * (std::f64::consts::TAU * phase as f64 / 12.0).cos();
            let value = |flat: usize| {
                let [i, j, k] = grid.voxel_of(flat);
                let noise = (((flat * 7919 + phase * 104_729) % 1009) as f64 / 1009.0 - 0.5) * 40.0;
                (if (i as f64 - 20.0).hypot(j as f64 - 19.0) < radius { 200.0 } else { 60.0 } + noise + k as f64) as f32
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
        assert!(misplaced.len() == 1 && misplaced[0].starts_with("frame 3 "), "{misplaced:?}");
        let cine = beating(&(0..12).collect::<Vec<_>>());
        let mut frames = cine.frames().to_vec();
        let scrambled = frames[8].values().iter().rev().map(|value| value * 0.3).collect();
        frames[8] = Volume::new(cine.grid().clone(), scrambled).unwrap();
        let corrupt = frame_warnings(&CineSequence::new(frames, cine.times_s().to_vec(), cine.period_s()).unwrap());
        assert!(corrupt.len() == 1 && corrupt[0].starts_with("frame 8 "), "{corrupt:?}");
    }
}
