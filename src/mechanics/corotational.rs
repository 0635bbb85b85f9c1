//! Large rotations at one point: the linear material in the frame of its polar rotation, with its consistent tangent.
//!
//! The deformation gradient, its second index in fibre axes, is $F = RU$ with R a rotation and U symmetric \[Higham1986\]. The energy a
//! unit volume is that of linear elasticity of the stretch, and of the fibre's tension (a second Piola–Kirchhoff stress, as in
//! \[Land2015\], so that the nominal tension falls with the fibre's length and no tension can pull a fibre through itself):
//!
//! $$\psi(F) = \tfrac a2 (U - \bar U) : D : (U - \bar U) + \tfrac{\sigma_C}2 |F e_f|^2 + \tfrac{\kappa_V}2 (\det F - 1)^2 + \kappa\, b(\det F)$$
//!
//! Rotations cost nothing, and where they are small it is linear elasticity. Damping of a time step makes the tissue stiffer, $a > 1$,
//! about a stretch $\bar U$ between rest and where the step begins, see [`PointLaw`]. The linear material keeps tr U, which at large strain is
//! not the volume: $\kappa_V$, which is not damped, keeps the volume itself. The last term holds tetrahedra open that have lost
//! half their volume, which a linear material would let collapse; with $x = \det F / J_0$
//!
//! $$b = -\ln x + (x - 1) - \tfrac12 (x - 1)^2 \quad (x < 1), \qquad b = 0 \quad (x \ge 1).$$

use nalgebra::{Matrix3, Matrix3x6, Matrix6, SMatrix, Vector3, Vector6};

use super::TransverseIsotropy;

/// Passes of the polar iteration; it converges quadratically, in five or six from any physiological strain.
const POLAR_LIMIT: usize = 40;

/// J₀, the part of its volume below which a tetrahedron is held open.
const GUARDED_VOLUME: f64 = 0.5;

/// Least eigenvalue of a stretching that was not convex, beside its largest.
const LEAST_CONVEX: f64 = 1e-3;

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
    /// κ_V, kPa.
    pub(super) volume_stiffness_kpa: f64,
}

impl PointLaw<'_> {
    /// $\tfrac{\kappa_V}2 (J - 1)^2 + \kappa\,b$, kPa.
    fn volume_energy_kpa(&self, jacobian: f64) -> f64 {
        let x = jacobian / GUARDED_VOLUME;
        let guard = if x < 1.0 { x - 1.0 - x.ln() - (x - 1.0).powi(2) / 2.0 } else { 0.0 };
        self.volume_stiffness_kpa / 2.0 * (jacobian - 1.0).powi(2) + self.material.bulk_kpa() * guard
    }

    /// Its first and second derivative by J, kPa; None where both terms are off.
    fn volume_derivatives_kpa(&self, jacobian: f64) -> Option<(f64, f64)> {
        let kept = self.volume_stiffness_kpa;
        let (first, second) = (kept * (jacobian - 1.0), kept);
        let x = jacobian / GUARDED_VOLUME;
        if x >= 1.0 {
            return (kept > 0.0).then_some((first, second));
        }
        let scale = self.material.bulk_kpa() / GUARDED_VOLUME;
        Some((first + scale * (2.0 - 1.0 / x - x), second + scale / GUARDED_VOLUME * (1.0 / (x * x) - 1.0)))
    }
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
    /// ψ, kPa (= mN·mm/mm³).
    pub(super) energy_kpa: f64,
    /// T = a D : (U − Ū) and the volume's share, kPa.
    biot_kpa: Matrix3<f64>,
    /// G⁻¹ with G = tr(U) I − U, see [`Polar::spin`].
    spin: Matrix3<f64>,
    /// n = G⁻¹ ax(U T − T U), kPa; zero where T and U share their axes.
    twist_kpa: Vector3<f64>,
    /// First and second derivative of κ_V/2 (J − 1)² + κ b by J, kPa; None where both are off.
    volume_kpa: Option<(f64, f64)>,
}

/// Three changes of the deformation gradient in columns: the stretching dU (xx, yy, zz, yz, xz, xy), then the spin ω in its rotated frame.
pub(super) type Changes = SMatrix<f64, 9, 3>;

/// The second derivative of the energy as a form in [`Changes`], kPa.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SecondDerivative {
    /// dU : ∂T/∂U : dU.
    stretching_kpa: Matrix6<f64>,
    coupling_kpa: Matrix3x6<f64>,
    spin_kpa: Matrix3<f64>,
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
            let next = rotation * 0.5 + cofactor * (0.5 / determinant);
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
        cofactor * generator.column(0).dot(&cofactor.column(0)).recip()
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
        let strain = stretch - law.rest_stretch;
        let mut biot_kpa = law.material.stress_kpa(&strain) * law.stiffening;
        let mut energy_kpa = strain.dot(&biot_kpa) / 2.0 + stretch.column(0).norm_squared() * law.tension_kpa / 2.0;
        let spin = polar.spin();
        let twist_kpa = spin * axial(&(stretch * biot_kpa - biot_kpa * stretch));
        let cofactor = cofactor(stretch);
        let jacobian = stretch.column(0).dot(&cofactor.column(0));
        let volume_kpa = law.volume_derivatives_kpa(jacobian);
        if let Some((slope, _)) = volume_kpa {
            energy_kpa += law.volume_energy_kpa(jacobian);
            biot_kpa += cofactor * slope;
        }
        Some(Self { polar, energy_kpa, biot_kpa, spin, twist_kpa, volume_kpa })
    }

    /// First Piola–Kirchhoff stress $P = \partial\psi/\partial F$, kPa: $R\,(T + [n]_\times)$ of the stretch, where $[n]_\times$ is
    /// what its spin works against if T and U do not share their axes (anisotropic tissue), and $\sigma_C F e_f e_f^\top$ of the fibre.
    /// T has the volume's $(\kappa_V (J - 1) + \kappa b')\,\mathrm{cof}\,U$, which shares the axes of U.
    pub(super) fn stress_kpa(&self, law: PointLaw<'_>) -> Matrix3<f64> {
        let mut local = self.biot_kpa + self.twist_kpa.cross_matrix();
        local.set_column(0, &(local.column(0) + self.polar.stretch.column(0) * law.tension_kpa));
        self.polar.rotation * local
    }

    /// $d^2\psi = dU : \partial_U T : dU + 2\,\omega\cdot C(dU) + \omega\cdot W\omega$, of the stretch with
    /// $C(dU) = \mathrm{ax}(dU\,T - T\,dU) + dU\,n - n\,\mathrm{tr}\,dU$ and
    /// $W = \mathrm{tr}(TU) I - \mathrm{sym}(TU) - \mathrm{sym}([n]_\times U)$; of the fibre
    /// $\sigma_C |\omega \times U e_f + dU e_f|^2$.
    pub(super) fn second_derivative(&self, law: PointLaw<'_>) -> SecondDerivative {
        let (t, n, u) = (&self.biot_kpa, &self.twist_kpa, &self.polar.stretch);
        let (yz, xz, xy) = (t[(1, 2)], t[(0, 2)], t[(0, 1)]);
        let mut coupling_kpa = Matrix3x6::from_columns(&[
            Vector3::new(0.0, xz - n.y, -xy - n.z),
            Vector3::new(-yz - n.x, 0.0, xy - n.z),
            Vector3::new(yz - n.x, -xz - n.y, 0.0),
            Vector3::new(t[(1, 1)] - t[(2, 2)], n.z - xy, n.y + xz),
            Vector3::new(xy + n.z, t[(2, 2)] - t[(0, 0)], n.x - yz),
            Vector3::new(n.y - xz, yz + n.x, t[(0, 0)] - t[(1, 1)]),
        ]);
        let product = (t + n.cross_matrix()) * u;
        let mut spin_kpa = Matrix3::identity() * product.trace() - (product + product.transpose()) / 2.0;
        let mut stretching_kpa = Matrix6::zeros();
        stretching_kpa.fixed_view_mut::<3, 3>(0, 0).copy_from(&(law.material.normal_kpa() * law.stiffening));
        let shear = law.material.shear_kpa();
        for (index, place) in [(1, 2), (0, 2), (0, 1)].into_iter().enumerate() {
            stretching_kpa[(3 + index, 3 + index)] = shear[place] * (4.0 * law.stiffening);
        }
        if let Some((slope, curvature)) = self.volume_kpa {
            let c = cofactor(u);
            let volume = Vector6::new(c[(0, 0)], c[(1, 1)], c[(2, 2)], 2.0 * c[(1, 2)], 2.0 * c[(0, 2)], 2.0 * c[(0, 1)]);
            stretching_kpa += volume * volume.transpose() * curvature + second_derivative_of_determinant(u) * slope;
        }
        let fibre = u.column(0).into_owned();
        spin_kpa += (Matrix3::identity() * fibre.norm_squared() - fibre * fibre.transpose()) * law.tension_kpa;
        let crossed = fibre.cross_matrix() * law.tension_kpa;
        // dU e_f is made of xx, xy and xz.
        for (axis, index) in [0, 5, 4].into_iter().enumerate() {
            stretching_kpa[(index, index)] += law.tension_kpa;
            coupling_kpa.set_column(index, &(coupling_kpa.column(index) + crossed.column(axis)));
        }
        SecondDerivative { stretching_kpa, coupling_kpa, spin_kpa }
    }

    /// The changes that `eᵢ gᵀ` are, for the three axes of the world.
    pub(super) fn changes(&self, gradient: &Vector3<f64>) -> Changes {
        let (u, g) = (&self.polar.stretch, gradient);
        let spins = self.spin * g.cross_matrix();
        let mut changes = Changes::zeros();
        for axis in 0..3 {
            let spin = spins.column(axis);
            let [x, y, z] = [0, 1, 2].map(|column| spin.cross(&u.column(column)));
            let mut stretching = Vector6::new(-x.x, -y.y, -z.z, -(z.y + y.z) / 2.0, -(z.x + x.z) / 2.0, -(y.x + x.y) / 2.0);
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            stretching[axis] += g[axis];
            stretching[3 + next] += g[last] / 2.0;
            stretching[3 + last] += g[next] / 2.0;
            changes.fixed_view_mut::<6, 1>(0, axis).copy_from(&stretching);
            changes.fixed_view_mut::<3, 1>(6, axis).copy_from(&spin);
        }
        changes * self.polar.rotation.transpose()
    }
}

impl SecondDerivative {
    /// The form applied to changes: what second ones are multiplied with.
    pub(super) fn times(&self, changes: &Changes) -> Changes {
        let (stretching, spin) = (changes.fixed_rows::<6>(0), changes.fixed_rows::<3>(6));
        let mut product = Changes::zeros();
        product.fixed_rows_mut::<6>(0).copy_from(&(self.stretching_kpa * stretching + self.coupling_kpa.tr_mul(&spin)));
        product.fixed_rows_mut::<3>(6).copy_from(&(self.coupling_kpa * stretching + self.spin_kpa * spin));
        product
    }

    /// The nearest form by its spin that is nowhere negative; this one where it is not. The stretching costs energy, $D \succ 0$ (but
    /// where a guarded volume says otherwise), so a form is positive where its Schur complement is, $S = W - C D^{-1} C^\top$ of three
    /// rows: the negative eigenvalues of S go \[Teran2005\].
    pub(super) fn convex_part(mut self) -> Self {
        let cholesky = self.stretching_kpa.cholesky().or_else(|| {
            let mut eigen = self.stretching_kpa.symmetric_eigen();
            let least = eigen.eigenvalues.amax() * LEAST_CONVEX;
            eigen.eigenvalues.apply(|value| *value = value.max(least));
            self.stretching_kpa = eigen.recompose();
            self.stretching_kpa.cholesky()
        });
        let Some(cholesky) = cholesky else { return self };
        let schur = self.spin_kpa - self.coupling_kpa * cholesky.solve(&self.coupling_kpa.transpose());
        if schur.cholesky().is_none() {
            let mut eigen = schur.symmetric_eigen();
            eigen.eigenvalues.apply(|value| *value = -value.min(0.0));
            self.spin_kpa += eigen.recompose();
        }
        self
    }
}

/// $d^2 \det U = 2\,U : \mathrm{cof}(dU)$ as a form in the stretching.
fn second_derivative_of_determinant(u: &Matrix3<f64>) -> Matrix6<f64> {
    let mut form = Matrix6::zeros();
    for axis in 0..3 {
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        form[(next, last)] = u[(axis, axis)];
        form[(3 + axis, 3 + axis)] = -2.0 * u[(axis, axis)];
        form[(axis, 3 + axis)] = -2.0 * u[(next, last)];
        form[(3 + next, 3 + last)] = 2.0 * u[(next, last)];
        (form[(last, next)], form[(3 + axis, axis)]) = (form[(next, last)], form[(axis, 3 + axis)]);
        form[(3 + last, 3 + next)] = form[(3 + next, 3 + last)];
    }
    form
}

/// The s of a skew matrix $[s]_\times$.
fn axial(skew: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)])
}

/// $\det(A)\,A^{-\top}$.
fn cofactor(matrix: &Matrix3<f64>) -> Matrix3<f64> {
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
        let law =
            PointLaw { material: &material, stiffening: 1.0, rest_stretch: &rest_stretch, tension_kpa: 0.0, volume_stiffness_kpa: 0.0 };
        let turn = Rotation3::from_euler_angles(0.3, 1.4, -0.8);
        let point = DeformedPoint::new(&(turn * GRADIENT), law).unwrap();
        let gradient = Vector3::new(0.3, -0.5, 0.7);
        let changes = point.changes(&gradient);
        for axis in 0..3 {
            let expected = point.polar.stretching(&(Vector3::ith(axis, 1.0) * gradient.transpose()));
            let s = changes.column(axis);
            let found = Matrix3::new(s[0], s[5], s[4], s[5], s[1], s[3], s[4], s[3], s[2]);
            assert!((found - expected).norm() < 1e-14);
        }
    }
}
