//! How the force of a cavity's pressure changes with the wall that it acts on.

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::Tangent;
use crate::mesh::Cavity;

/// Adds $-p\,\partial_y^2 V$ to a tangent. With $\partial_{y_a} V = \frac16 \sum (y_b - z) \times (y_c - z)$ about the lid's centre $z$,
/// the force on corner a changes by $\frac p6 (dy_b \times (y_c - z) + (y_b - z) \times dy_c)$, block by block, and on a vertex of the
/// rim by $\frac p6 (y_{next} - y_{last}) \times dz$; what $z$ passes on to the rim is the transpose of that.
pub(super) fn add_pressure_stiffness(cavity: &Cavity, position_mm: &[Vector3<f64>], pressure_kpa: f64, tangent: &mut Tangent) {
    let centre = cavity.lid_centre_mm(position_mm);
    for &[a, b, c] in cavity.endocardium() {
        for [i, j, k] in [[a, b, c], [b, c, a], [c, a, b]] {
            let crossed = [j, k].map(|vertex| (position_mm[vertex] - centre).cross_matrix() * (pressure_kpa / 6.0));
            tangent.add_stiffness(i, j, &crossed[1]);
            tangent.add_stiffness(i, k, &-crossed[0]);
        }
    }
    let rim = cavity.rim();
    let neighbours = rim.iter().cycle().skip(rim.len() - 1).zip(rim.iter().cycle().skip(1));
    let block = |(&last, &next): (&usize, &usize)| (position_mm[last] - position_mm[next]).cross_matrix() * (pressure_kpa / 6.0);
    let blocks: Vec<Matrix3<f64>> = neighbours.map(block).take(rim.len()).collect();
    tangent.add_mean_stiffness(rim, &blocks);
}

#[cfg(test)]
mod tests {
    use super::super::idealised_lv::IdealisedLv;
    use super::*;
    use crate::heart::{HeartModel, ModelSettings, Parameters};
    use crate::mechanics::{Kinematics, Linearisation};
    use std::sync::Arc;

    /// Everywhere, also at the rim, whose vertices carry the lid's centre: the force is a polynomial of second degree, so its central
    /// difference is exact.
    #[test]
    fn the_pressure_stiffness_is_the_derivative_of_the_pressure_force() {
        let anatomy = Arc::new(IdealisedLv { resolution: [6, 4, 1], ..IdealisedLv::default() }.anatomy());
        let settings = ModelSettings { kinematics: Kinematics::Corotational, ..ModelSettings::default() };
        let model = HeartModel::new(Arc::clone(&anatomy), Parameters::default(), settings).unwrap();
        let cavity = &anatomy.cavities[0].1;
        let position = anatomy.mesh.vertices_mm().to_vec();
        let change: Vec<Vector3<f64>> =
            (0..position.len()).map(|v| Vector3::new((3.0 * v as f64).sin(), (5.0 * v as f64).cos(), 0.4)).collect();
        let mut system = model.operator.empty_system();
        model.operator.assemble(&model.initial_state(0.0).motion, None, &mut system).unwrap();
        let mut product = |pressure_kpa: f64| {
            model.operator.linearise(&position, Linearisation::Exact, &mut system).unwrap();
            add_pressure_stiffness(cavity, &position, pressure_kpa, system.tangent.as_mut().unwrap());
            let mut product = vec![Vector3::zeros(); position.len()];
            model.operator.multiply(&system, &change, &mut product).unwrap();
            product
        };
        let (free, pressed) = (product(0.0), product(7.0));
        let force = |by: f64| {
            let mut force = vec![Vector3::zeros(); position.len()];
            let moved: Vec<_> = position.iter().zip(&change).map(|(y, d)| y + d * by).collect();
            cavity.add_gradient(&moved, 7.0, &mut force);
            force
        };
        let (plus, minus) = (force(1.0), force(-1.0));
        for vertex in 0..position.len() {
            let expected = (plus[vertex] - minus[vertex]) / 2.0;
            let found = free[vertex] - pressed[vertex];
            assert!((found - expected).norm() < 1e-9 * (1.0 + expected.norm()), "vertex {vertex}: {found:?} for {expected:?}");
        }
    }
}
