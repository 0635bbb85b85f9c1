//! Simulated surfaces against image boundaries: mean signed normal distance a group (surface, segment, frame) over its standard deviation.
//!
//! $$ r_g = \frac{1}{\sigma_g}\,\frac{\sum_{i \in g} c_i\, n_i\cdot(z_i - y_i)}{\sum_{i \in g} c_i} $$
//!
//! A target is a plane (point z, normal n): sliding along it costs nothing, which is the aperture problem told honestly.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::{CalibrationTrajectory, Loss};
use crate::personalisation::{Cluster, PersonalisationError, Residual};

/// Where the image says that a surface vertex should be, at one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceTarget {
    /// Frame, an index of [`CalibrationTrajectory::frames`].
    pub frame: usize,
    /// Vertex, an index of [`super::CalibrationFrame::position_mm`].
    pub vertex: usize,
    /// A point of the boundary, mm.
    pub point_mm: Vector3<f64>,
    /// Normal of the boundary; normalised on entry.
    pub normal: Vector3<f64>,
    /// Confidence c ≥ 0.
    pub confidence: f64,
    /// Surface and segment, as any number: targets of one frame and group become one row.
    pub group: u32,
}

/// One row a frame and group.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundaryResidual {
    rows: Vec<BoundaryRow>,
    sd_mm: f64,
    loss: Loss,
}

/// Mean signed distances by frame and group, mm.
pub type GroupDistances = BTreeMap<(usize, u32), f64>;

#[derive(Debug, Clone, PartialEq)]
struct BoundaryRow {
    frame: usize,
    group: u32,
    /// Vertex, point and normal scaled by c/(σ Σc).
    terms: Vec<(usize, Vector3<f64>, Vector3<f64>)>,
    /// What the row is when the surface lies where it is seen.
    offset: f64,
}

impl BoundaryResidual {
    /// Groups `targets`; `sd_mm` is the standard deviation of a group's mean distance (boundary errors are correlated along a surface, so
    /// it does not shrink with the number of points). Groups without confidence have no row.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] if the standard deviation is not positive, a confidence is negative, or a target is not finite.
    pub fn new(targets: &[SurfaceTarget], sd_mm: f64) -> Result<Self, PersonalisationError> {
        if !(sd_mm.is_finite() && sd_mm > 0.0) {
            let remedy = "the standard deviation of a boundary must be positive";
            return Err(PersonalisationError::Setting { what: "boundary_sd_mm", value: sd_mm, remedy });
        }
        let mut groups: BTreeMap<(usize, u32), Vec<&SurfaceTarget>> = BTreeMap::new();
        for target in targets {
            if !(target.confidence.is_finite() && target.confidence >= 0.0) {
                let remedy = "must be finite and not negative";
                return Err(PersonalisationError::Setting { what: "confidence of a boundary", value: target.confidence, remedy });
            }
            let size = target.normal.norm();
            if !(size.is_finite() && size > 0.0 && target.point_mm.iter().all(|entry| entry.is_finite())) {
                let remedy = "a boundary needs a finite point and a normal that is not zero";
                return Err(PersonalisationError::Setting { what: "length of a boundary normal", value: size, remedy });
            }
            groups.entry((target.frame, target.group)).or_default().push(target);
        }
        let rows = groups.into_iter().filter_map(|((frame, group), members)| {
            let total: f64 = members.iter().map(|target| target.confidence).sum();
            let scaled = |target: &&SurfaceTarget| {
                let factor = target.confidence / (sd_mm * total);
                (target.vertex, target.point_mm, target.normal.normalize() * factor)
            };
            (total > 0.0).then(|| BoundaryRow { frame, group, terms: members.iter().map(scaled).collect(), offset: 0.0 })
        });
        Ok(Self { rows: rows.collect(), sd_mm, loss: Loss::Squares })
    }

    /// With another loss.
    #[must_use]
    pub fn with_loss(mut self, loss: Loss) -> Self {
        self.loss = loss;
        self
    }

    /// The same where boundaries are seen `bias_mm` beyond the surface that they belong to; groups that it does not name are seen without bias.
    #[must_use]
    pub fn less_bias(mut self, bias_mm: &GroupDistances) -> Self {
        for row in &mut self.rows {
            row.offset = bias_mm.get(&(row.frame, row.group)).map_or(0.0, |bias_mm| bias_mm / self.sd_mm);
        }
        self
    }

    /// How far every group's boundary lies beyond the surface of a trajectory.
    pub fn distances_mm(&self, trajectory: &CalibrationTrajectory) -> GroupDistances {
        let mut rows = vec![0.0; self.rows.len()];
        self.evaluate(trajectory, &mut rows);
        self.groups().zip(rows).map(|(group, row)| (group, row * self.sd_mm)).collect()
    }

    /// Frame and group of every row.
    pub fn groups(&self) -> impl ExactSizeIterator<Item = (usize, u32)> + '_ {
        self.rows.iter().map(|row| (row.frame, row.group))
    }
}

impl Residual<CalibrationTrajectory> for BoundaryResidual {
    fn row_count(&self) -> usize {
        self.rows.len()
    }

    fn evaluate(&self, trajectory: &CalibrationTrajectory, rows: &mut [f64]) {
        for (value, row) in rows.iter_mut().zip(&self.rows) {
            let distance = |&(vertex, point_mm, normal): &(usize, Vector3<f64>, Vector3<f64>)| {
                normal.dot(&(point_mm - trajectory.position_mm(row.frame, vertex)))
            };
            *value = row.terms.iter().map(distance).sum::<f64>() - row.offset;
        }
    }

    fn apply_tangent(&self, _: &CalibrationTrajectory, tangent: &CalibrationTrajectory, rows: &mut [f64]) {
        for (value, row) in rows.iter_mut().zip(&self.rows) {
            *value = -row.terms.iter().map(|&(vertex, _, normal)| normal.dot(&tangent.position_mm(row.frame, vertex))).sum::<f64>();
        }
    }

    fn write_losses(&self, losses: &mut [Loss]) {
        losses.fill(self.loss);
    }

    fn write_clusters(&self, clusters: &mut [Cluster]) {
        for (cluster, (frame, group)) in clusters.iter_mut().zip(self.groups()) {
            *cluster = Cluster { place: group, instant: frame as u32 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::personalisation::residuals::CalibrationFrame;
    use crate::personalisation::tangents::LinearTrajectory;

    fn target(frame: usize, vertex: usize, z: f64, confidence: f64, group: u32) -> SurfaceTarget {
        let normal = Vector3::new(0.0, 0.0, 2.0);
        SurfaceTarget { frame, vertex, point_mm: Vector3::new(5.0, 0.0, z), normal, confidence, group }
    }

    fn trajectory(heights: [[f64; 2]; 2]) -> CalibrationTrajectory {
        let frame = |heights: [f64; 2]| CalibrationFrame {
            position_mm: heights.iter().map(|&z| Vector3::new(z * z, 1.0, z)).collect(),
            ..CalibrationFrame::default()
        };
        CalibrationTrajectory { frames: heights.into_iter().map(frame).collect(), ..CalibrationTrajectory::default() }
    }

    /// Confidence-weighted mean of the normal distances; what slides along the plane is not seen.
    #[test]
    fn rows_are_mean_signed_distances_of_their_group() {
        let targets = [target(1, 0, 3.0, 1.0, 7), target(1, 1, 5.0, 3.0, 7), target(0, 0, 1.0, 1.0, 2), target(0, 1, 9.0, 0.0, 3)];
        let residual = BoundaryResidual::new(&targets, 0.5).unwrap();
        assert_eq!(residual.groups().collect::<Vec<_>>(), [(0, 2), (1, 7)]);
        let mut rows = [0.0; 2];
        residual.evaluate(&trajectory([[0.0, 0.0], [2.0, 1.0]]), &mut rows);
        assert!((rows[0] - 1.0 / 0.5).abs() < 1e-14);
        assert!((rows[1] - (1.0 * 1.0 + 3.0 * 4.0) / 4.0 / 0.5).abs() < 1e-14);
    }

    /// The residual is affine in the positions, so a difference quotient of any step gives its tangent.
    #[test]
    fn tangent_is_the_difference_quotient() {
        let targets = [target(1, 0, 3.0, 1.0, 7), target(1, 1, 5.0, 3.0, 7), target(0, 0, 1.0, 1.0, 2)];
        let residual = BoundaryResidual::new(&targets, 0.5).unwrap();
        let (here, there) = (trajectory([[0.0, 0.0], [2.0, 1.0]]), trajectory([[1.0, 0.5], [2.5, -1.0]]));
        let (mut at_here, mut at_there, mut along) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        residual.evaluate(&here, &mut at_here);
        residual.evaluate(&there, &mut at_there);
        residual.apply_tangent(&here, &there.difference_quotient(&here, 0.25), &mut along);
        for row in 0..2 {
            assert!(((at_there[row] - at_here[row]) / 0.25 - along[row]).abs() < 1e-12);
        }
    }

    /// Corrected by its own distances, a boundary leaves nothing to explain, and its tangent is what it was.
    #[test]
    fn a_known_bias_is_taken_off() {
        let targets = [target(1, 0, 3.0, 1.0, 7), target(1, 1, 5.0, 3.0, 7), target(0, 0, 1.0, 1.0, 2)];
        let (seen, here) = (BoundaryResidual::new(&targets, 0.5).unwrap(), trajectory([[0.0, 0.0], [2.0, 1.0]]));
        let bias_mm = seen.distances_mm(&here);
        assert!((bias_mm[&(1, 7)] - 3.25).abs() < 1e-14 && (bias_mm[&(0, 2)] - 1.0).abs() < 1e-14);
        let corrected = seen.clone().less_bias(&bias_mm);
        let mut rows = [1.0; 2];
        corrected.evaluate(&here, &mut rows);
        assert!(rows.iter().all(|row| row.abs() < 1e-14), "{rows:?}");
        let [mut before, mut after] = [[0.0; 2]; 2];
        seen.apply_tangent(&here, &here, &mut before);
        corrected.apply_tangent(&here, &here, &mut after);
        assert_eq!(before, after);
    }

    #[test]
    fn bad_targets_are_refused() {
        assert!(BoundaryResidual::new(&[], f64::NAN).is_err());
        assert!(BoundaryResidual::new(&[target(0, 0, 1.0, -1.0, 0)], 1.0).is_err());
        assert!(BoundaryResidual::new(&[target(0, 0, f64::NAN, 1.0, 0)], 1.0).is_err());
        let flat = SurfaceTarget { normal: Vector3::zeros(), ..target(0, 0, 1.0, 1.0, 0) };
        assert!(BoundaryResidual::new(&[flat], 1.0).is_err());
    }
}
