//! Slices that were taken at other phases of the beat than the rest, brought onto common phases.
//!
//! A scanner takes slice after slice, each in beats of its own length. As phases φ = t/RR of each slice's own period the frames of most
//! slices coincide; where a slice's do not, its images at the common phases are interpolated linearly between its own, round the beat.

/// A slice whose frames lie off the common phases by more than this share of a frame step is interpolated.
const SAME_PHASE: f64 = 0.1;

/// The phases (0 to 1 of the beat) at which all slices are wanted, and those at which each was taken; ascending, within one beat.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CommonPhases {
    pub(super) common: Vec<f64>,
    /// Of every slice.
    pub(super) own: Vec<Vec<f64>>,
}

impl CommonPhases {
    /// Whether a slice's frames are at the common phases as they are.
    pub(super) fn fits(&self, slice: usize) -> bool {
        let own = &self.own[slice];
        let step = 1.0 / self.common.len() as f64;
        own.len() == self.common.len() && own.iter().zip(&self.common).all(|(a, b)| (a - b).abs() < SAME_PHASE * step)
    }

    /// The slices that have to be interpolated.
    pub(super) fn unfit_slices(&self) -> Vec<usize> {
        (0..self.own.len()).filter(|&slice| !self.fits(slice)).collect()
    }

    /// The frames of a slice at the common phases.
    pub(super) fn resampled(&self, slice: usize, frames: &[&[f32]]) -> Vec<Vec<f32>> {
        if self.fits(slice) {
            return frames.iter().map(|frame| frame.to_vec()).collect();
        }
        let own = &self.own[slice];
        let at = |phase: f64| {
            let wrapped = own[0] + (phase - own[0]).rem_euclid(1.0);
            let earlier = own.partition_point(|&p| p <= wrapped).max(1) - 1;
            let later = (earlier + 1) % own.len();
            let gap = if later == 0 { own[0] + 1.0 - own[earlier] } else { own[later] - own[earlier] };
            let weight = ((wrapped - own[earlier]) / gap.max(1e-9)).clamp(0.0, 1.0) as f32;
            mixed(frames[earlier], frames[later], weight)
        };
        self.common.iter().map(|&phase| at(phase)).collect()
    }
}

/// (1 − w) a + w b, pixel by pixel.
pub(super) fn mixed(first: &[f32], second: &[f32], weight: f32) -> Vec<f32> {
    first.iter().zip(second).map(|(a, b)| a + weight * (b - a)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_late_slice_is_interpolated_round_the_beat_and_the_others_are_left() {
        let common: Vec<f64> = (0..20).map(|n| (f64::from(n) + 0.5) / 20.0).collect();
        let late: Vec<f64> = common.iter().map(|phase| phase + 0.02).collect();
        let phases = CommonPhases { common: common.clone(), own: vec![common.clone(), late.clone()] };
        assert_eq!(phases.unfit_slices(), [1]);
        let frames: Vec<[f32; 1]> = late.iter().map(|phase| [(TAU * phase).sin() as f32]).collect();
        let frames: Vec<&[f32]> = frames.iter().map(<[f32; 1]>::as_slice).collect();
        for (frame, phase) in phases.resampled(1, &frames).iter().zip(&common) {
            // Linear interpolation over a twentieth of a sine: at most (2π/20)²/8 off.
            assert!((f64::from(frame[0]) - (TAU * phase).sin()).abs() < 0.0125, "{phase}");
        }
        assert_eq!(phases.resampled(0, &frames)[3], frames[3]);
    }
}
