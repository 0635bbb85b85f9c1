//! Large rotations at one point: the linear material in the frame of its polar rotation, with its consistent tangent.
//!
//! The deformation gradient, its second index in fibre axes, is $F = RU$ with R a rotation and U symmetric \[Higham1986\]. The energy a
//! unit volume is that of linear elasticity of the stretch, and of the fibre's tension (a second Piola–Kirchhoff stress, as in
//! \[Land2015\], so that the nominal tension falls with the fibre's length and no tension can pull a fibre through itself):
//!
//! $$\psi(F) = \tfrac a2 (U - \bar U) : D : (U - \bar U) + \tfrac{\sigma_C}2 |F e_f|^2 + \kappa\, b(\det F)$$
//!
//! Rotations cost nothing, and where they are small it is linear elasticity. Damping of a time step makes the tissue stiffer, $a > 1$,
//! about a stretch $\bar U$ between rest and where the step begins, see [`PointLaw`]. The last term holds tetrahedra open that have lost
//! half their volume, which a linear material would let collapse; with $x = \det F / J_0$
//!
//! $$b = -\ln x + (x - 1) - \tfrac12 (x - 1)^2 \quad (x < 1), \qquad b = 0 \quad (x \ge 1).$$

use nalgebra::{Matrix3, Matrix3x6, Vector3, Vector6};

use super::TransverseIsotropy;

/// Passes of the polar iteration; it converges quadratically, in five or six from any physiological strain.
const POLAR_LIMIT: usize = 40;

/// J₀, the part of its volume below which a tetrahedron is held open.
const GUARDED_VOLUME: f64 = 0.5;

/// What a point obeys during one step.
///
/// Rayleigh damping of the stretch, $\beta D : \dot U$, with $\dot U = c\,(U - U_c)$ for a time scheme whose velocity is affine in the
/// position, adds up with $D : (U - I)$ to $a D : (U - \bar U)$, where $a = 1 + \beta c$ and $\bar U = (I + \beta c\,U_c)/a$. It damps
/// strain in the rotating frame and leaves rotation alone.
#[derive(Debug, Clone, Copy)]
pub(super) struct PointLaw<'a> {
    pub(super) material: &'a TransverseIsotropy,
    /// a.
    pub(super) stiffening: f64,
    /// Ū.
    pub(super) rest_stretch: &'a Matrix3<f64>,
    /// σC, kPa.
    pub(super) tension_kpa: f64,
}

/// R and U.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Polar {
    pub(super) rotation: Matrix3<f64>,
    pub(super) stretch: Matrix3<f64>,
}

/// A deformed point: what its stress and the stress's derivative are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DeformedPoint {
    polar: Polar,
    jacobian: f64,
    /// T = a D : (U − Ū), kPa.
    biot_kpa: Matrix3<f64>,
    /// G⁻¹ with G = tr(U) I − U, see [`Polar::spin`].
    spin: Matrix3<f64>,
    /// n = G⁻¹ ax(U T − T U), kPa; zero where T and U share their axes.
    twist_kpa: Vector3<f64>,
}

/// The second derivative of the energy of the stretch as a form in the stretching dU (xx, yy, zz, yz, xz, xy) and the spin ω.
#[derive(Debug, Clone, Copy)]
pub(super) struct SecondDerivative {
    normal_kpa: Matrix3<f64>,
    /// Of yz, xz and xy.
    shear_kpa: Vector3<f64>,
    coupling_kpa: Matrix3x6<f64>,
    geometric_kpa: Matrix3<f64>,
}

/// A change of the deformation gradient in the rotated frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Change {
    stretching: Vector6<f64>,
    spin: Vector3<f64>,
}

impl Polar {
    /// None if the gradient is flat, turned inside out or not finite. Newton's iteration $R \leftarrow (R + R^{-\top})/2$.
    pub(super) fn new(gradient: &Matrix3<f64>) -> Option<Self> {
        let mut rotation = *gradient;
        for _ in 0..POLAR_LIMIT {
            let cofactor = cofactor(&rotation);
            let determinant = rotation.column(0).dot(&cofactor.column(0));
            if determinant.is_nan() || determinant <= 0.0 {
                return None;
            }
            let next = (rotation + cofactor / determinant) / 2.0;
            let change = (next - rotation).norm_squared();
            rotation = next;
            // What is left is of the order of the change's square.
            if change < 1e-16 {
                let product = rotation.transpose() * gradient;
                return Some(Self { rotation, stretch: (product + product.transpose()) / 2.0 });
            }
        }
        None
    }

    /// G⁻¹, which takes the axial vector of $R^\top dF - dF^\top R$ to the spin of R. U is positive, so G can be inverted.
    fn spin(&self) -> Matrix3<f64> {
        let generator = Matrix3::identity() * self.stretch.trace() - self.stretch;
        let cofactor = cofactor(&generator);
        cofactor / generator.column(0).dot(&cofactor.column(0))
    }

    /// dU along dF: with $R^\top dF = \Omega U + dU$, the spin Ω takes up the skew part.
    pub(super) fn stretching(&self, change: &Matrix3<f64>) -> Matrix3<f64> {
        let turned = self.rotation.transpose() * change;
        let spin = (self.spin() * axial(&(turned - turned.transpose()))).cross_matrix();
        let stretching = turned - spin * self.stretch;
        (stretching + stretching.transpose()) / 2.0
    }
}

impl DeformedPoint {
    /// None if the gradient is flat, turned inside out or not finite.
    pub(super) fn new(gradient: &Matrix3<f64>, law: PointLaw<'_>) -> Option<Self> {
        let polar = Polar::new(gradient)?;
        let stretch = &polar.stretch;
        let biot_kpa = law.material.stress_kpa(&(stretch - law.rest_stretch)) * law.stiffening;
        let spin = polar.spin();
        let twist_kpa = spin * axial(&(stretch * biot_kpa - biot_kpa * stretch));
        Some(Self { polar, jacobian: gradient.determinant(), biot_kpa, spin, twist_kpa })
    }

    /// ψ, kPa (= mN·mm/mm³).
    pub(super) fn energy_kpa(&self, law: PointLaw<'_>) -> f64 {
        let elastic = (self.polar.stretch - law.rest_stretch).component_mul(&self.biot_kpa).sum() / 2.0;
        let fibre = self.polar.stretch.column(0).norm_squared() * law.tension_kpa / 2.0;
        let x = self.jacobian / GUARDED_VOLUME;
        let guard = if x < 1.0 { law.material.bulk_kpa() * (x - 1.0 - x.ln() - (x - 1.0).powi(2) / 2.0) } else { 0.0 };
        elastic + fibre + guard
    }

    /// First Piola–Kirchhoff stress $P = \partial\psi/\partial F$, kPa: $R\,(T + [n]_\times)$ of the stretch, where $[n]_\times$ is
    /// what its spin works against if T and U do not share their axes (anisotropic tissue), $\sigma_C F e_f e_f^\top$ of the fibre, and
    /// $\kappa b'\,\mathrm{cof} F$.
    pub(super) fn stress_kpa(&self, law: PointLaw<'_>) -> Matrix3<f64> {
        let mut local = self.biot_kpa + self.twist_kpa.cross_matrix();
        local.set_column(0, &(local.column(0) + self.polar.stretch.column(0) * law.tension_kpa));
        if self.jacobian < GUARDED_VOLUME {
            local += cofactor(&self.polar.stretch) * self.guard(law).0;
        }
        self.polar.rotation * local
    }

    /// R and U.
    pub(super) fn polar(&self) -> &Polar {
        &self.polar
    }

    /// $\kappa\,\partial b/\partial J$ and $\kappa\,\partial^2 b/\partial J^2$, kPa; None where the tetrahedron needs no guard.
    pub(super) fn guard_derivatives(&self, law: PointLaw<'_>) -> Option<(f64, f64)> {
        (self.jacobian < GUARDED_VOLUME).then(|| self.guard(law))
    }

    fn guard(&self, law: PointLaw<'_>) -> (f64, f64) {
        let x = self.jacobian / GUARDED_VOLUME;
        let scale = law.material.bulk_kpa() / GUARDED_VOLUME;
        (scale * (2.0 - 1.0 / x - x), scale / GUARDED_VOLUME * (1.0 / (x * x) - 1.0))
    }

    /// $d^2\psi = dU : aD : dU + 2\,\omega\cdot C(dU) + \omega\cdot W\omega$ of the stretch, with
    /// $C(dU) = \mathrm{ax}(dU\,T - T\,dU) + dU\,n - n\,\mathrm{tr}\,dU$ and
    /// $W = \mathrm{tr}(TU) I - \mathrm{sym}(TU) - \mathrm{sym}([n]_\times U)$.
    pub(super) fn second_derivative(&self, law: PointLaw<'_>) -> SecondDerivative {
        let (t, n, u) = (&self.biot_kpa, &self.twist_kpa, &self.polar.stretch);
        let (yz, xz, xy) = (t[(1, 2)], t[(0, 2)], t[(0, 1)]);
        let coupling_kpa = Matrix3x6::from_columns(&[
            Vector3::new(0.0, xz - n.y, -xy - n.z),
            Vector3::new(-yz - n.x, 0.0, xy - n.z),
            Vector3::new(yz - n.x, -xz - n.y, 0.0),
            Vector3::new(t[(1, 1)] - t[(2, 2)], n.z - xy, n.y + xz),
            Vector3::new(xy + n.z, t[(2, 2)] - t[(0, 0)], n.x - yz),
            Vector3::new(n.y - xz, yz + n.x, t[(0, 0)] - t[(1, 1)]),
        ]);
        let product = (t + n.cross_matrix()) * u;
        let geometric_kpa = Matrix3::identity() * product.trace() - (product + product.transpose()) / 2.0;
        let shear = law.material.shear_kpa();
        SecondDerivative {
            normal_kpa: law.material.normal_kpa() * law.stiffening,
            shear_kpa: Vector3::new(shear[(1, 2)], shear[(0, 2)], shear[(0, 1)]) * (4.0 * law.stiffening),
            coupling_kpa,
            geometric_kpa,
        }
    }

    /// The change that `R e gᵀ` is, for the axis e of the rotated frame.
    pub(super) fn change(&self, axis: usize, gradient: &Vector3<f64>) -> Change {
        let (u, g, mut crossed) = (&self.polar.stretch, gradient, Vector3::zeros());
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        (crossed[next], crossed[last]) = (g[last], -g[next]);
        let spin = self.spin * crossed;
        let [x, y, z] = [0, 1, 2].map(|column| spin.cross(&u.column(column)));
        let mut stretching = Vector6::new(-x.x, -y.y, -z.z, -(z.y + y.z) / 2.0, -(z.x + x.z) / 2.0, -(y.x + x.y) / 2.0);
        stretching[axis] += g[axis];
        stretching[3 + next] += g[last] / 2.0;
        stretching[3 + last] += g[next] / 2.0;
        Change { stretching, spin }
    }
}

impl SecondDerivative {
    /// The form applied to one change: what a second one is multiplied with.
    pub(super) fn times(&self, change: &Change) -> Change {
        let normal = self.normal_kpa * change.stretching.fixed_rows::<3>(0);
        let shear = self.shear_kpa.component_mul(&change.stretching.fixed_rows::<3>(3));
        let mut stretching = self.coupling_kpa.tr_mul(&change.spin);
        for i in 0..3 {
            stretching[i] += normal[i];
            stretching[3 + i] += shear[i];
        }
        Change { stretching, spin: self.coupling_kpa * change.stretching + self.geometric_kpa * change.spin }
    }
}

impl Change {
    pub(super) fn dot(&self, other: &Self) -> f64 {
        self.stretching.dot(&other.stretching) + self.spin.dot(&other.spin)
    }
}

/// The s of a skew matrix $[s]_\times$.
fn axial(skew: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)])
}

/// $\det(A)\,A^{-\top}$.
pub(super) fn cofactor(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let [x, y, z] = [0, 1, 2].map(|column| matrix.column(column));
    Matrix3::from_columns(&[y.cross(&z), z.cross(&x), x.cross(&y)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    const GRADIENT: Matrix3<f64> = Matrix3::new(1.1, 0.2, -0.1, 0.0, 0.9, 0.15, 0.1, 0.05, 1.2);

    #[test]
    fn the_polar_rotation_and_the_stretch_make_up_the_gradient() {
        for scale in [1e-3, 0.3, 1.0, 40.0] {
            let gradient = GRADIENT * scale;
            let polar = Polar::new(&gradient).unwrap();
            assert!((polar.rotation.transpose() * polar.rotation - Matrix3::identity()).norm() < 1e-13);
            assert!((polar.rotation * polar.stretch - gradient).norm() < 1e-13 * scale.max(1.0));
            assert!(polar.stretch.symmetric_eigenvalues().min() > 0.0);
        }
    }

    #[test]
    fn a_stretching_is_the_derivative_of_the_stretch_and_none_for_a_spin() {
        let polar = Polar::new(&GRADIENT).unwrap();
        let change = Matrix3::new(0.3, -0.8, 0.1, 0.5, 0.2, 0.7, -0.4, 0.9, -0.6);
        let step = 1e-6;
        let at = |by: f64| Polar::new(&(GRADIENT + change * by)).unwrap().stretch;
        assert!(((at(step) - at(-step)) / (2.0 * step) - polar.stretching(&change)).norm() < 1e-9);
        let spin = Vector3::new(0.4, -1.0, 0.3).cross_matrix();
        assert!(polar.stretching(&(spin * GRADIENT)).norm() < 1e-14);
    }

    #[test]
    fn a_gradient_that_is_flat_inside_out_or_infinite_is_refused() {
        let flat = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0);
        for bad in [flat, -GRADIENT, Matrix3::zeros(), Matrix3::repeat(f64::NAN), GRADIENT * f64::INFINITY] {
            assert!(Polar::new(&bad).is_none());
        }
    }

    #[test]
    fn an_axis_of_a_change_is_that_of_the_tensor_it_stands_for() {
        let material = TransverseIsotropy::new(50.0, 15.0, 0.4).unwrap();
        let rest_stretch = Matrix3::identity();
        let law = PointLaw { material: &material, stiffening: 1.0, rest_stretch: &rest_stretch, tension_kpa: 0.0 };
        let turn = Rotation3::from_euler_angles(0.3, 1.4, -0.8);
        let point = DeformedPoint::new(&(turn * GRADIENT), law).unwrap();
        let gradient = Vector3::new(0.3, -0.5, 0.7);
        for axis in 0..3 {
            let change = point.polar().rotation * Vector3::ith(axis, 1.0) * gradient.transpose();
            let expected = point.polar().stretching(&change);
            let s = point.change(axis, &gradient).stretching;
            let found = Matrix3::new(s[0], s[5], s[4], s[5], s[1], s[3], s[4], s[3], s[2]);
            assert!((found - expected).norm() < 1e-14);
        }
    }
}
