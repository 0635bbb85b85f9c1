//! How long the ventricles take to be depolarised: what the QRS complex shows of the activation.

use crate::anatomy::{Anatomy, Region};
use crate::electrophysiology::ActivationMap;

/// Times from the first to the last depolarisation, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActivationTimes {
    /// Of the whole heart: the QRS duration.
    pub total_s: f64,
    /// Of the left ventricle with the septum.
    pub left_s: f64,
    /// Of the right ventricle's free wall, where there is one.
    pub right_s: Option<f64>,
}

impl ActivationTimes {
    /// Reads the times off an activation map.
    pub fn new(anatomy: &Anatomy, activation: &ActivationMap) -> Self {
        let span_s = |is_part: &dyn Fn(Region) -> bool| {
            let parts = anatomy.mesh.tetrahedra().iter().zip(&anatomy.regions).filter(|(_, region)| is_part(**region));
            let times_s = parts.flat_map(|(corners, _)| corners.map(|vertex| activation.times_s()[vertex]));
            let (first_s, last_s) = times_s.fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), t| (first.min(t), last.max(t)));
            (first_s <= last_s).then_some(last_s - first_s)
        };
        let right_s = span_s(&|region| region == Region::FreeWallRv);
        let left_s = span_s(&|region| region != Region::FreeWallRv).unwrap_or(0.0);
        Self { total_s: span_s(&|_| true).unwrap_or(0.0), left_s, right_s }
    }
}
