//! One linear tetrahedron under large rotations: its forces and their derivative.

use nalgebra::{Matrix3, Vector3};

use super::corotational::{DeformedPoint, PointLaw, Polar, SecondDerivative};

/// A tetrahedron at rest. The first corner's share of everything is minus that of the other three.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Element {
    /// ∇N of the last three corners in fibre axes, 1/mm.
    gradients: [Vector3<f64>; 3],
    volume_mm3: f64,
}

/// What a deformed element adds to the balance of forces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ElementForce {
    pub(super) energy_mn_mm: f64,
    /// The internal force $V P \nabla N_a$ at the last three corners, mN.
    pub(super) corners_mn: [Vector3<f64>; 3],
}

/// The same with its derivative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ElementTangent {
    pub(super) force: ElementForce,
    /// Its derivative by the positions of the last three corners, mN/mm: the blocks (1,1), (1,2), (1,3), (2,2), (2,3), (3,3).
    upper_mn_per_mm: [Matrix3<f64>; 6],
}

impl Element {
    /// `gradients`: ∇N of the four corners, 1/mm; `axes`: orthonormal, the first column along the fibre. The material does not change
    /// where the last column turns round, which makes any axes a rotation.
    pub(super) fn new(gradients: &[Vector3<f64>; 4], axes: &Matrix3<f64>, volume_mm3: f64) -> Self {
        let mut right_handed = *axes;
        if axes.determinant() < 0.0 {
            right_handed.column_mut(2).neg_mut();
        }
        let [_, b, c, d] = gradients.map(|gradient| right_handed.tr_mul(&gradient));
        Self { gradients: [b, c, d], volume_mm3 }
    }

    /// F of positions or Ḟ of velocities, the second index in fibre axes.
    pub(super) fn gradient_of(&self, [a, b, c, d]: [Vector3<f64>; 4]) -> Matrix3<f64> {
        let edges = [b - a, c - a, d - a];
        edges.iter().zip(&self.gradients).map(|(edge, gradient)| edge * gradient.transpose()).sum()
    }

    /// $U - \dot U/c$ where the tetrahedron is at `position_mm` with `velocity_mm_per_s`; None if it is flat or inside out.
    pub(super) fn past_stretch(
        &self,
        position_mm: [Vector3<f64>; 4],
        velocity_mm_per_s: [Vector3<f64>; 4],
        rate_per_s: f64,
    ) -> Option<Matrix3<f64>> {
        let polar = Polar::new(&self.gradient_of(position_mm))?;
        Some(polar.stretch - polar.stretching(&self.gradient_of(velocity_mm_per_s)) / rate_per_s)
    }

    /// Energy and internal force; None if the tetrahedron is flat or inside out.
    pub(super) fn force(&self, law: PointLaw<'_>, position_mm: [Vector3<f64>; 4]) -> Option<ElementForce> {
        Some(self.force_of(&DeformedPoint::new(&self.gradient_of(position_mm), law)?, law))
    }

    /// Force and its derivative; None if the tetrahedron is flat or inside out.
    pub(super) fn tangent(&self, law: PointLaw<'_>, position_mm: [Vector3<f64>; 4]) -> Option<ElementTangent> {
        self.tangent_of(law, position_mm, |form| form)
    }

    /// As [`Element::tangent`], of the convex part of the energy's second derivative; see [`SecondDerivative::convex_part`].
    pub(super) fn convex_tangent(&self, law: PointLaw<'_>, position_mm: [Vector3<f64>; 4]) -> Option<ElementTangent> {
        self.tangent_of(law, position_mm, SecondDerivative::convex_part)
    }

    fn tangent_of(
        &self,
        law: PointLaw<'_>,
        position_mm: [Vector3<f64>; 4],
        part: fn(SecondDerivative) -> SecondDerivative,
    ) -> Option<ElementTangent> {
        let point = DeformedPoint::new(&self.gradient_of(position_mm), law)?;
        let form = part(point.second_derivative(law));
        let changes = self.gradients.map(|gradient| point.changes(&gradient));
        let products = changes.map(|changes| form.times(&changes) * self.volume_mm3);
        let upper_mn_per_mm = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(a, b)| changes[a].tr_mul(&products[b]));
        Some(ElementTangent { force: self.force_of(&point, law), upper_mn_per_mm })
    }

    fn force_of(&self, point: &DeformedPoint, law: PointLaw<'_>) -> ElementForce {
        let stress_kpa = point.stress_kpa(law) * self.volume_mm3;
        let corners_mn = self.gradients.map(|gradient| stress_kpa * gradient);
        ElementForce { energy_mn_mm: point.energy_kpa * self.volume_mm3, corners_mn }
    }
}

impl ElementTangent {
    /// All sixteen blocks by rows of corners.
    pub(super) fn blocks_mn_per_mm(&self) -> [[Matrix3<f64>; 4]; 4] {
        let [bb, bc, bd, cc, cd, dd] = self.upper_mn_per_mm;
        let (cb, db, dc) = (bc.transpose(), bd.transpose(), cd.transpose());
        let (ba, ca, da) = (-(bb + bc + bd), -(cb + cc + cd), -(db + dc + dd));
        let (ab, ac, ad) = (ba.transpose(), ca.transpose(), da.transpose());
        [[-(ab + ac + ad), ab, ac, ad], [ba, bb, bc, bd], [ca, cb, cc, cd], [da, db, dc, dd]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanics::TransverseIsotropy;
    use crate::numerics::TaylorTest;
    use nalgebra::{DMatrix, DVector, Rotation3};

    const CORNERS: [Vector3<f64>; 4] =
        [Vector3::new(0.1, 0.0, 0.2), Vector3::new(2.0, 0.3, -0.1), Vector3::new(0.4, 1.7, 0.1), Vector3::new(0.2, 0.5, 2.2)];

    fn material() -> TransverseIsotropy {
        TransverseIsotropy::new(50.0, 15.0, 0.4).unwrap()
    }

    /// With the axes of the element.
    fn element(is_left_handed: bool) -> (Element, Matrix3<f64>) {
        let [a, b, c, d] = CORNERS;
        let inverse = Matrix3::from_columns(&[b - a, c - a, d - a]).try_inverse().unwrap().transpose();
        let [gb, gc, gd] = [0, 1, 2].map(|column| inverse.column(column).into_owned());
        let mut axes = *Rotation3::from_euler_angles(0.4, 1.0, -0.6).matrix();
        if is_left_handed {
            axes.column_mut(2).neg_mut();
        }
        (Element::new(&[-(gb + gc + gd), gb, gc, gd], &axes, 1.0 / inverse.determinant() / 6.0), axes)
    }

    /// Turned and deformed; the height of the last corner gives the volume.
    fn deformed(height: f64) -> [Vector3<f64>; 4] {
        let deformation = Matrix3::new(1.1, 0.2, -0.1, 0.0, 0.9, 0.15, 0.1, 0.05, height);
        CORNERS.map(|x| Rotation3::from_euler_angles(1.2, -0.5, 2.0) * (deformation * x) + Vector3::new(3.0, -40.0, 7.0))
    }

    fn flat(corners: &[Vector3<f64>; 4]) -> DVector<f64> {
        DVector::from_iterator(12, corners.iter().flat_map(|corner| corner.iter().copied()))
    }

    fn corners(flat: &DVector<f64>) -> [Vector3<f64>; 4] {
        [0, 1, 2, 3].map(|corner| flat.fixed_rows::<3>(3 * corner).into_owned())
    }

    fn dense(tangent: &ElementTangent) -> DMatrix<f64> {
        let blocks = tangent.blocks_mn_per_mm();
        DMatrix::from_fn(12, 12, |i, j| blocks[i / 3][j / 3][(i % 3, j % 3)])
    }

    fn all_forces([b, c, d]: [Vector3<f64>; 3]) -> DVector<f64> {
        flat(&[-(b + c + d), b, c, d])
    }

    /// Second order everywhere: stretched, squeezed to where its volume is guarded, damped, under tension.
    #[test]
    fn forces_derive_from_the_energy_and_the_tangent_from_the_forces() {
        let (material, (element, _)) = (material(), element(false));
        let past = Matrix3::new(0.95, 0.02, 0.0, 0.02, 1.08, -0.03, 0.0, -0.03, 1.01);
        for (height, stiffening, tension_kpa, volume_stiffness_kpa) in
            [(1.2, 1.0, 0.0, 0.0), (1.2, 3.0, 80.0, 0.0), (1.2, 1.0, 80.0, 300.0), (0.3, 1.0, 25.0, 0.0), (0.3, 1.0, 25.0, 100.0)]
        {
            let law = PointLaw { material: &material, stiffening, rest_stretch: &past, tension_kpa, volume_stiffness_kpa };
            let base = flat(&deformed(height));
            let energy = |x: &DVector<f64>| element.force(law, corners(x)).map(|f| DVector::from_element(1, f.energy_mn_mm)).ok_or(());
            let force = |x: &DVector<f64>| element.force(law, corners(x)).map(|f| all_forces(f.corners_mn)).ok_or(());
            let tangent = element.tangent(law, corners(&base)).unwrap();
            let matrix = dense(&tangent);
            assert_eq!(all_forces(tangent.force.corners_mn), force(&base).unwrap());
            assert!((&matrix - matrix.transpose()).norm() < 1e-12 * matrix.norm());
            for seed in 0..4 {
                let direction = DVector::from_fn(12, |i, _| (1.7 * i as f64 + 2.3 * f64::from(seed)).sin());
                let slope = DVector::from_element(1, force(&base).unwrap().dot(&direction));
                let orders = [
                    TaylorTest::run(energy, &base, &direction, &slope, 0.02, 6).unwrap().order(),
                    TaylorTest::run(force, &base, &direction, &(&matrix * &direction), 0.01, 6).unwrap().order(),
                ];
                assert!(orders.iter().all(|order| (order - 2.0).abs() < 0.2), "{orders:?} at height {height}");
            }
        }
    }

    /// Where the tissue is squeezed its tangent has negative eigenvalues; the convex one has none, and is the same where there were none.
    #[test]
    fn a_convex_tangent_is_nowhere_negative_and_the_exact_one_where_that_is_convex() {
        let (material, (element, _)) = (material(), element(false));
        let rest_stretch = Matrix3::identity();
        let (mut exact_count, mut projected_count) = (0, 0);
        for height in [0.15, 0.3, 0.45, 0.7, 0.9, 1.0, 1.2, 1.6] {
            for (tension_kpa, volume_stiffness_kpa) in [(0.0, 0.0), (20.0, 0.0), (200.0, 0.0), (20.0, 150.0)] {
                let law = PointLaw { material: &material, stiffening: 1.0, rest_stretch: &rest_stretch, tension_kpa, volume_stiffness_kpa };
                let exact = dense(&element.tangent(law, deformed(height)).unwrap());
                let convex = dense(&element.convex_tangent(law, deformed(height)).unwrap());
                let (scale, least) = (exact.norm(), exact.symmetric_eigenvalues().min());
                let least_convex = convex.symmetric_eigenvalues().min();
                assert!(least_convex > -1e-12 * scale, "{least_convex} at height {height}, {tension_kpa} kPa");
                let apart = (&convex - &exact).norm() / scale;
                if least > -1e-12 * scale {
                    exact_count += 1;
                    assert!(apart < 1e-12, "{apart} apart at height {height}, {tension_kpa} kPa");
                } else {
                    projected_count += 1;
                    assert!(apart > 1e-12, "{least} was left at height {height}, {tension_kpa} kPa");
                }
            }
        }
        assert!(exact_count > 5 && projected_count > 5, "{exact_count} exact, {projected_count} projected");
    }

    #[test]
    fn at_rest_the_tangent_is_that_of_linear_elasticity() {
        let material = material();
        for is_left_handed in [false, true] {
            let (element, axes) = element(is_left_handed);
            let rest_stretch = Matrix3::identity();
            let law =
                PointLaw { material: &material, stiffening: 1.0, rest_stretch: &rest_stretch, tension_kpa: 0.0, volume_stiffness_kpa: 0.0 };
            let tangent = element.tangent(law, CORNERS).unwrap();
            let blocks = tangent.blocks_mn_per_mm();
            let right_handed = Matrix3::from_columns(&[axes.column(0), axes.column(1), axes.column(0).cross(&axes.column(1)).column(0)]);
            for (a, row) in blocks[1..].iter().enumerate() {
                for (b, block) in row[1..].iter().enumerate() {
                    let local = material.stiffness_block(&element.gradients[a], &element.gradients[b]) * element.volume_mm3;
                    assert!((right_handed * local * right_handed.transpose() - block).norm() < 1e-12);
                }
            }
            assert!(tangent.force.corners_mn.iter().all(|force| force.norm() < 1e-13));
        }
    }

    /// Forces turn with the tetrahedron, fibre and all.
    #[test]
    fn a_rotation_bears_no_force_and_turns_the_forces_along() {
        let (material, (element, _)) = (material(), element(false));
        let rest_stretch = Matrix3::identity();
        let law = |tension_kpa| PointLaw {
            material: &material,
            stiffening: 1.0,
            rest_stretch: &rest_stretch,
            tension_kpa,
            volume_stiffness_kpa: 40.0,
        };
        let turn = Rotation3::from_euler_angles(-2.0, 0.3, 1.4);
        let still = element.force(law(0.0), CORNERS.map(|x| turn * x)).unwrap().corners_mn;
        assert!(still.iter().all(|force| force.norm() < 1e-12));
        let plain = element.force(law(80.0), deformed(1.1)).unwrap().corners_mn;
        let turned = element.force(law(80.0), deformed(1.1).map(|x| turn * x)).unwrap().corners_mn;
        assert!(plain.iter().zip(&turned).all(|(p, t)| (turn * p - t).norm() < 1e-11));
    }

    #[test]
    fn a_past_stretch_is_the_one_that_the_velocity_left() {
        let (element, _) = element(false);
        let (rate_per_s, spin) = (200.0, Vector3::new(3.0, -1.0, 2.0));
        let here = deformed(1.1);
        let spinning = element.past_stretch(here, here.map(|y| spin.cross(&y)), rate_per_s).unwrap();
        let still = element.past_stretch(here, [Vector3::zeros(); 4], rate_per_s).unwrap();
        assert!((spinning - still).norm() < 1e-14, "a rigid spin has no past");
        let growing = element.past_stretch(here, here.map(|y| y * 0.5), rate_per_s).unwrap();
        assert!((growing - still * (1.0 - 0.5 / rate_per_s)).norm() < 1e-13);
    }
}
