//! The force that draws the inside of the wall along the blocks that match it: that of the base, \[Billet2009\] §5, on every vertex.

use nalgebra::{Matrix3, Vector3};

use super::{BaseMatches, BlockMatchingSettings, TrackingError};
use crate::mechanics::{MotionState, StepLoad, StepSystem};
use crate::mesh::TetMesh;

/// How block matches draw the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallSettings {
    /// How the blocks are matched.
    pub blocks: BlockMatchingSettings,
    /// Gain γ per volume, kPa/mm².
    pub gain_kpa_per_mm2: f64,
}

/// Springs, implicit in time, from the vertices of the wall to the places where their matches are: F = 2γ (Z − Y^{t+h}), γ the gain ×
/// confidence × a quarter of the volume of the tetrahedra around the vertex at rest.
#[derive(Debug, Clone)]
pub(super) struct WallForce<'a> {
    matches: &'a BaseMatches,
    reference_mm: &'a [Vector3<f64>],
    /// Gain × volume by place in the matches, mN/mm.
    gain_mn_per_mm: Vec<f64>,
}

impl<'a> WallForce<'a> {
    /// The load of matches on a mesh at its reference positions.
    ///
    /// # Errors
    /// [`TrackingError::SettingOutOfRange`] for a gain that is negative or not finite, [`TrackingError::BaseMatches`] if the matches
    /// name a vertex that the mesh does not have.
    pub(super) fn new(mesh: &'a TetMesh, matches: &'a BaseMatches, gain_kpa_per_mm2: f64) -> Result<Self, TrackingError> {
        TrackingError::check_setting("wall_gain_kpa_per_mm2", gain_kpa_per_mm2, 0.0, f64::MAX)?;
        matches.check_vertices(mesh.vertex_count())?;
        let mut volume_mm3 = vec![0.0; mesh.vertex_count()];
        for (tetrahedron, corners) in mesh.tetrahedra().iter().enumerate() {
            corners.iter().for_each(|&corner| volume_mm3[corner] += 0.25 * mesh.volume_mm3(tetrahedron));
        }
        let gain_mn_per_mm = matches.vertices().iter().map(|&vertex| gain_kpa_per_mm2 * volume_mm3[vertex]).collect();
        Ok(Self { matches, reference_mm: mesh.vertices_mm(), gain_mn_per_mm })
    }
}

impl StepLoad for WallForce<'_> {
    fn add_to(&self, _state: &MotionState, time_s: f64, step_s: f64, system: &mut StepSystem) {
        for (place, &vertex) in self.matches.vertices().iter().enumerate() {
            let (displacement_mm, confidence) = self.matches.at(place, time_s + step_s);
            let stiffness_mn_per_mm = 2.0 * self.gain_mn_per_mm[place] * confidence;
            system.force_mn[vertex] += (self.reference_mm[vertex] + displacement_mm) * stiffness_mn_per_mm;
            system.stiffness_mn_per_mm[vertex] += Matrix3::identity() * stiffness_mn_per_mm;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::slab;
    use super::*;

    /// A wall that stands at its matches is at peace; one millimetre beside them it is drawn by 2γ times its volume, whatever its state
    /// before.
    #[test]
    fn the_wall_is_drawn_by_twice_the_gain_times_its_volume() {
        let (mesh, _) = slab(3, |p| p * 10.0);
        let count = mesh.vertex_count();
        let shift = Vector3::new(0.4, -0.3, 0.2);
        let matches = BaseMatches::new((0..count).collect(), vec![0.0, 0.4], 0.8, vec![vec![shift; count]; 2], vec![vec![1.0; count]; 2]);
        let force = WallForce::new(&mesh, &matches, 0.5).unwrap();
        let drawn = |state_mm: Vec<Vector3<f64>>, beside: Vector3<f64>| {
            let mut system =
                StepSystem { force_mn: vec![Vector3::zeros(); count], stiffness_mn_per_mm: vec![Matrix3::zeros(); count], tangent: None };
            force.add_to(&MotionState::at_rest(state_mm), 0.0, 0.1, &mut system);
            let exerted = system.force_mn.iter().zip(&system.stiffness_mn_per_mm).zip(mesh.vertices_mm());
            exerted.map(|((force, stiffness), rest)| force - stiffness * (rest + shift + beside)).sum::<Vector3<f64>>()
        };
        let rest = mesh.vertices_mm().to_vec();
        assert!(drawn(rest.clone(), Vector3::zeros()).norm() < 1e-9);
        let expected = -2.0 * 0.5 * mesh.total_volume_mm3();
        assert!((drawn(rest.clone(), Vector3::x()).x / expected - 1.0).abs() < 1e-12);
        let moved = rest.iter().map(|x| x * 1.1).collect();
        let difference = (drawn(moved, Vector3::x()) - drawn(rest.clone(), Vector3::x())).norm();
        assert!(difference < 1e-9, "{difference}");
    }

    #[test]
    fn matches_of_another_mesh_and_gains_below_zero_are_refused() {
        let (mesh, _) = slab(2, |p| p * 10.0);
        let matches = BaseMatches::new(vec![99], vec![0.0], 0.8, vec![vec![Vector3::zeros()]], vec![vec![1.0]]);
        assert!(matches!(WallForce::new(&mesh, &matches, 1.0), Err(TrackingError::BaseMatches { .. })));
        assert!(matches!(WallForce::new(&mesh, &matches, -1.0), Err(TrackingError::SettingOutOfRange { .. })));
    }
}
