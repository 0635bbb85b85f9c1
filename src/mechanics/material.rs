//! The passive myocardium: transversely isotropic linear elasticity about the fibre, from engineering constants.

use nalgebra::{Matrix3, Vector3};

use super::MechanicsError;

/// Passive properties of the tissue and of its surroundings, the same everywhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassiveProperties {
    /// Young's modulus E_f along the fibre, kPa.
    pub fibre_stiffness_kpa: f64,
    /// Young's modulus E_t across the fibre, kPa.
    pub transverse_stiffness_kpa: f64,
    /// Poisson's ratio ν: contraction across over stretch along the fibre, and within the cross-section.
    pub poisson_ratio: f64,
    /// Resistance κ to a change of volume beyond that of the elastic constants: κ/2 (J − 1)² a unit volume (in linear kinematics
    /// κ/2 (tr ε)²), kPa.
    pub volume_stiffness_kpa: f64,
    /// Mass density, kg/mm³.
    pub density_kg_per_mm3: f64,
    /// Rayleigh damping α on the mass, 1/s.
    pub damping_mass_per_s: f64,
    /// Rayleigh damping β on the tissue's stiffness (not on springs), s.
    pub damping_stiffness_s: f64,
    /// Base springs along the base's normal, kPa/mm.
    pub base_stiffness_normal_kpa_per_mm: f64,
    /// Base springs in all directions, kPa/mm.
    pub base_stiffness_isotropic_kpa_per_mm: f64,
    /// Pericardial springs along the epicardial normal, kPa/mm.
    pub pericardium_stiffness_kpa_per_mm: f64,
    /// Pericardial dashpots along the epicardial normal, kPa·s/mm.
    pub pericardium_damping_kpa_s_per_mm: f64,
    /// Pericardial springs at the base relative to those at the apex; between them linear in the distance to the base.
    pub pericardium_base_share: f64,
    /// Height of the fibrous ring of the valves below the base, mm; 0 is none.
    pub valve_ring_height_mm: f64,
    /// Young's modulus that the ring has beyond the muscle's, isotropic, kPa.
    pub valve_ring_stiffness_kpa: f64,
}

impl PassiveProperties {
    /// Whether they differ from place to place.
    pub(super) fn depend_on_base_distance(&self) -> bool {
        self.valve_ring_height_mm > 0.0 || self.pericardium_base_share < 1.0
    }

    /// Checks every value but the elastic constants, which [`TransverseIsotropy::new`] checks.
    pub(super) fn check(&self) -> Result<(), MechanicsError> {
        let (value, property) = (self.density_kg_per_mm3, "density_kg_per_mm3");
        if !(value.is_finite() && value > 0.0) {
            return Err(MechanicsError::Property { property, value, requirement: "finite and positive" });
        }
        let (value, property) = (self.pericardium_base_share, "pericardium_base_share");
        if !(0.0..=1.0).contains(&value) {
            return Err(MechanicsError::Property { property, value, requirement: "between 0 and 1" });
        }
        let not_negative = [
            ("volume_stiffness_kpa", self.volume_stiffness_kpa),
            ("damping_mass_per_s", self.damping_mass_per_s),
            ("damping_stiffness_s", self.damping_stiffness_s),
            ("base_stiffness_normal_kpa_per_mm", self.base_stiffness_normal_kpa_per_mm),
            ("base_stiffness_isotropic_kpa_per_mm", self.base_stiffness_isotropic_kpa_per_mm),
            ("pericardium_stiffness_kpa_per_mm", self.pericardium_stiffness_kpa_per_mm),
            ("pericardium_damping_kpa_s_per_mm", self.pericardium_damping_kpa_s_per_mm),
            ("valve_ring_height_mm", self.valve_ring_height_mm),
            ("valve_ring_stiffness_kpa", self.valve_ring_stiffness_kpa),
        ];
        for (property, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(MechanicsError::Property { property, value, requirement: "finite and not negative" });
            }
        }
        Ok(())
    }
}

/// Elastic stiffness in fibre axes (first axis along the fibre), the inverse of the compliance
///
/// $$\varepsilon_f = \frac{\sigma_f - \nu(\sigma_s + \sigma_n)}{E_f}, \quad
/// \varepsilon_s = \frac{\sigma_s - \nu\sigma_n}{E_t} - \frac{\nu\sigma_f}{E_f}, \quad
/// \gamma_{fs} = \frac{\sigma_{fs}}{G_f}, \quad \gamma_{sn} = \frac{2(1+\nu)\,\sigma_{sn}}{E_t}$$
///
/// with Saint-Venant's shear along the fibre, $1/G_f = (1+2\nu)/E_f + 1/E_t$ \[Lekhnitskii1963\], which is
/// $2(1+\nu)/E$ where $E_f = E_t$.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransverseIsotropy {
    normal_kpa: Matrix3<f64>,
    /// G_ij off the diagonal, zero on it.
    shear_kpa: Matrix3<f64>,
}

impl TransverseIsotropy {
    /// From Young's moduli along and across the fibre, kPa, and Poisson's ratio.
    ///
    /// # Errors
    /// [`MechanicsError::Property`] for moduli that are not positive or ν outside (−1, 0.5);
    /// [`MechanicsError::Indefinite`] unless 1 − ν − 2ν²E_t/E_f > 0.
    pub fn new(fibre_stiffness_kpa: f64, transverse_stiffness_kpa: f64, poisson_ratio: f64) -> Result<Self, MechanicsError> {
        let (e_f, e_t, nu) = (fibre_stiffness_kpa, transverse_stiffness_kpa, poisson_ratio);
        for (property, value) in [("fibre_stiffness_kpa", e_f), ("transverse_stiffness_kpa", e_t)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(MechanicsError::Property { property, value, requirement: "finite and positive" });
            }
        }
        if !(nu > -1.0 && nu < 0.5) {
            return Err(MechanicsError::Property {
                property: "poisson_ratio",
                value: nu,
                requirement: "between −1 and 0.5, both excluded",
            });
        }
        let ratio = e_t / e_f;
        let determinant = 1.0 - nu - 2.0 * nu * nu * ratio;
        if determinant <= 0.0 {
            return Err(MechanicsError::Indefinite { determinant, fibre_stiffness_kpa, transverse_stiffness_kpa, poisson_ratio });
        }
        let along = e_f * (1.0 - nu) / determinant;
        let coupling = e_t * nu / determinant;
        let across = e_t * (1.0 - nu * nu * ratio) / ((1.0 + nu) * determinant);
        let within = e_t * (nu + nu * nu * ratio) / ((1.0 + nu) * determinant);
        let shear_f = 1.0 / ((1.0 + 2.0 * nu) / e_f + 1.0 / e_t);
        let shear_t = e_t / (2.0 * (1.0 + nu));
        Ok(Self {
            normal_kpa: Matrix3::new(along, coupling, coupling, coupling, across, within, coupling, within, across),
            shear_kpa: Matrix3::new(0.0, shear_f, shear_f, shear_f, 0.0, shear_t, shear_f, shear_t, 0.0),
        })
    }

    /// This material and a share of another in one place: their stresses add up.
    pub(super) fn with_share(&self, share: f64, other: &Self) -> Self {
        Self { normal_kpa: self.normal_kpa + other.normal_kpa * share, shear_kpa: self.shear_kpa + other.shear_kpa * share }
    }

    /// Stiffness of normal strains in fibre axes, kPa.
    pub(super) fn normal_kpa(&self) -> Matrix3<f64> {
        self.normal_kpa
    }

    /// Shear moduli G_ij off the diagonal, kPa.
    pub(super) fn shear_kpa(&self) -> &Matrix3<f64> {
        &self.shear_kpa
    }

    /// Stiffness against a change of volume without a change of shape, kPa.
    pub(super) fn bulk_kpa(&self) -> f64 {
        self.normal_kpa.sum() / 9.0
    }

    /// Stress in fibre axes, kPa, of a small symmetric strain in fibre axes.
    pub fn stress_kpa(&self, strain: &Matrix3<f64>) -> Matrix3<f64> {
        let normal = self.normal_kpa * strain.diagonal();
        Matrix3::from_diagonal(&normal) + 2.0 * self.shear_kpa.component_mul(strain)
    }

    /// $B_a^\top D B_b$ a unit volume, kPa/mm² for shape gradients in fibre axes, 1/mm:
    /// the force at corner a an displacement of corner b causes.
    pub(super) fn stiffness_block(&self, gradient_a: &Vector3<f64>, gradient_b: &Vector3<f64>) -> Matrix3<f64> {
        let product = gradient_a.component_mul(gradient_b);
        let normal = self.normal_kpa.component_mul(&(gradient_a * gradient_b.transpose()));
        let crossed = self.shear_kpa.component_mul(&(gradient_b * gradient_a.transpose()));
        normal + crossed + Matrix3::from_diagonal(&(self.shear_kpa * product))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stiffness_is_the_inverse_of_the_compliance() {
        let (e_f, e_t, nu) = (55.0, 21.0, 0.42);
        let material = TransverseIsotropy::new(e_f, e_t, nu).unwrap();
        let compliance = Matrix3::new(1.0 / e_f, -nu / e_f, -nu / e_f, -nu / e_f, 1.0 / e_t, -nu / e_t, -nu / e_f, -nu / e_t, 1.0 / e_t);
        let stress = Matrix3::new(3.0, 0.4, -0.7, 0.4, -2.0, 0.9, -0.7, 0.9, 1.5);
        let mut strain = Matrix3::from_diagonal(&(compliance * stress.diagonal()));
        let half_compliance_fibre = ((1.0 + 2.0 * nu) / e_f + 1.0 / e_t) / 2.0;
        let half_compliance_across = (1.0 + nu) / e_t;
        for (i, j, half_compliance) in [(0, 1, half_compliance_fibre), (0, 2, half_compliance_fibre), (1, 2, half_compliance_across)] {
            strain[(i, j)] = half_compliance * stress[(i, j)];
            strain[(j, i)] = strain[(i, j)];
        }
        assert!((material.stress_kpa(&strain) - stress).norm() < 1e-12);
    }

    #[test]
    fn equal_moduli_are_isotropic() {
        let (e, nu) = (10.0, 0.3);
        let material = TransverseIsotropy::new(e, e, nu).unwrap();
        let strain = Matrix3::new(0.01, 0.002, -0.004, 0.002, -0.02, 0.003, -0.004, 0.003, 0.005);
        let (lambda, mu) = (e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu)));
        let expected = Matrix3::identity() * (lambda * strain.trace()) + strain * (2.0 * mu);
        assert!((material.stress_kpa(&strain) - expected).norm() < 1e-13);
    }

    #[test]
    fn constants_that_are_not_positive_definite_are_refused_with_the_bound() {
        assert!(matches!(TransverseIsotropy::new(15.0, 60.0, 0.4), Err(MechanicsError::Indefinite { .. })));
        assert!(matches!(TransverseIsotropy::new(15.0, 10.0, 0.5), Err(MechanicsError::Property { .. })));
        assert!(matches!(TransverseIsotropy::new(f64::NAN, 10.0, 0.4), Err(MechanicsError::Property { .. })));
    }
}
