//! A recorded motion of the base, estimated once by block matching and replayed without images, \[Billet2009\] §5.

use nalgebra::Vector3;

use super::HeartError;

/// Positions of the base vertices (those of `TaggedSurface::vertices_with(Base)`, ascending) at the instants of one cycle; between
/// the instants they are interpolated linearly, and the cycle repeats.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseMotion {
    times_s: Vec<f64>,
    positions_mm: Vec<Vec<Vector3<f64>>>,
    period_s: f64,
}

impl BaseMotion {
    /// Keeps `positions_mm[instant][base vertex]` at ascending `times_s` that span less than one period.
    ///
    /// # Errors
    /// [`HeartError::BaseMotion`] if there is no instant, the times do not ascend within one period, numbers of vertices differ, or a
    /// value is not finite.
    pub fn new(times_s: Vec<f64>, positions_mm: Vec<Vec<Vector3<f64>>>, period_s: f64) -> Result<Self, HeartError> {
        let refuse = |reason: String| Err(HeartError::BaseMotion { reason });
        let (Some(&first_s), Some(&last_s), Some(first)) = (times_s.first(), times_s.last(), positions_mm.first()) else {
            return refuse("it has no instants".to_owned());
        };
        if times_s.len() != positions_mm.len() {
            return refuse(format!("{} times for {} instants", times_s.len(), positions_mm.len()));
        }
        let do_ascend = times_s.windows(2).all(|pair| pair[0] < pair[1]);
        if !(do_ascend && period_s.is_finite() && last_s - first_s < period_s) {
            return refuse(format!("times must ascend from {first_s} s within one period of {period_s} s, but end at {last_s} s"));
        }
        for (instant, positions) in positions_mm.iter().enumerate() {
            if positions.len() != first.len() {
                return refuse(format!("instant {instant} has {} vertices, the first has {}", positions.len(), first.len()));
            }
            if let Some(vertex) = positions.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
                return refuse(format!("vertex {vertex} of instant {instant} is not finite"));
            }
        }
        Ok(Self { times_s, positions_mm, period_s })
    }

    /// Number of base vertices.
    pub fn vertex_count(&self) -> usize {
        self.positions_mm[0].len()
    }

    /// Writes the positions (mm, one a base vertex) at any time.
    pub fn position_mm(&self, time_s: f64, position_mm: &mut Vec<Vector3<f64>>) {
        let first_s = self.times_s[0];
        let time_s = first_s + (time_s - first_s).rem_euclid(self.period_s);
        let after = self.times_s.partition_point(|&t| t <= time_s);
        let (before, start_s) = (after - 1, self.times_s[after - 1]);
        let (next, end_s) = if after < self.times_s.len() { (after, self.times_s[after]) } else { (0, first_s + self.period_s) };
        let weight = (time_s - start_s) / (end_s - start_s);
        position_mm.clear();
        let pairs = self.positions_mm[before].iter().zip(&self.positions_mm[next]);
        position_mm.extend(pairs.map(|(from, to)| from + (to - from) * weight));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_vertex(times_s: &[f64], heights_mm: &[f64]) -> Result<BaseMotion, HeartError> {
        BaseMotion::new(times_s.to_vec(), heights_mm.iter().map(|&z| vec![Vector3::new(0.0, 0.0, z)]).collect(), 0.8)
    }

    #[test]
    fn it_interpolates_linearly_and_repeats() {
        let motion = one_vertex(&[0.1, 0.3, 0.6], &[0.0, -10.0, -4.0]).unwrap();
        let mut position = vec![];
        for (time_s, expected) in [(0.1, 0.0), (0.2, -5.0), (0.45, -7.0), (0.75, -2.0), (0.85, -2.0 / 3.0), (-0.6, -5.0), (1.8, -5.0)] {
            motion.position_mm(time_s, &mut position);
            assert!((position[0].z - expected).abs() < 1e-12, "{time_s} s: {} mm", position[0].z);
        }
    }

    #[test]
    fn recordings_that_cannot_be_replayed_are_refused() {
        assert!(one_vertex(&[], &[]).is_err());
        assert!(one_vertex(&[0.1, 0.1], &[0.0, 1.0]).is_err());
        assert!(one_vertex(&[0.1, 0.95], &[0.0, 1.0]).is_err());
        assert!(one_vertex(&[0.1, 0.5], &[0.0, f64::NAN]).is_err());
    }
}
