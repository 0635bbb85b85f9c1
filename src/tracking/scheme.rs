//! The image force of one vertex in four schemes of time integration, \[Billet2009\] §4.2, eq. 2 and 3.
//!
//! With N the mesh normal, N' the image normal, cos β = N·N', s the distance from Y to Z along N, and a small displacement dY,
//! the boundary point moves by B dY. The construction of \[Billet2009\] (the line through Y + dY along N meets the plane through Z
//! with normal N') has the derivative
//! $$ B = I - \frac{N N'^T}{N \cdot N'}, $$
//! whereas eq. 3 prints $(I - N' N'^T)(I - N N^T)/\cos^2\beta$. The two agree on span{N, N'}; along $t = N \times N'$ the printed
//! form gives $1/\cos^2\beta$ where the construction gives 1, so that $I - B$ has the eigenvalue $-\tan^2\beta$ there: a spring
//! that pushes away, unstable once $2\gamma\tan^2\beta$ exceeds what holds the vertex ($k + c/h$). Hence the names: `Published`
//! is kept for comparison only.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::BoundaryTarget;

/// How the image force enters the step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ForceScheme {
    /// The force of the beginning of the step; lags behind the image.
    Explicit,
    /// Implicit with B as printed in eq. 3.
    Published,
    /// Implicit with the exact derivative of the construction; not symmetric.
    Exact,
    /// Implicit, the force of the energy γ s²; symmetric and positive.
    #[default]
    Variational,
}

/// What one vertex adds to the step system: force (mN) and stiffness (mN/mm), the unknown being the position at the step's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexLoad {
    /// Added to F.
    pub force_mn: Vector3<f64>,
    /// Added to K̃.
    pub stiffness_mn_per_mm: Matrix3<f64>,
}

impl ForceScheme {
    /// B = ∂Z/∂Y as this scheme sees it; zero for the explicit scheme, whose Z stands still and whose stiffness is not used.
    pub fn target_derivative(self, normal: &Vector3<f64>, image_normal: &Vector3<f64>) -> Matrix3<f64> {
        let cos_beta = normal.dot(image_normal);
        let identity = Matrix3::identity();
        match self {
            Self::Explicit => Matrix3::zeros(),
            Self::Published => {
                (identity - image_normal * image_normal.transpose()) * (identity - normal * normal.transpose()) / (cos_beta * cos_beta)
            }
            Self::Exact => identity - normal * image_normal.transpose() / cos_beta,
            Self::Variational => identity - image_normal * image_normal.transpose() / (cos_beta * cos_beta),
        }
    }

    /// The load of a vertex at `position_mm` (Y at the beginning of the step) with the gain γ in mN/mm (per area × area × confidence).
    ///
    /// Explicit: F = 2γ(Z − Y). Published, exact: K = 2γ(I − B), F = 2γ(Z − Y) + K Y. Variational, from the energy γ s²:
    /// F = 2γ s N'/cos β + K Y, K = 2γ N' N'ᵀ/cos²β.
    pub fn load(self, target: &BoundaryTarget, position_mm: &Vector3<f64>, gain_mn_per_mm: f64) -> VertexLoad {
        let BoundaryTarget { normal, image_normal, signed_distance_mm, .. } = target;
        let pull = match self {
            Self::Explicit | Self::Published | Self::Exact => normal * *signed_distance_mm,
            Self::Variational => image_normal * (*signed_distance_mm / normal.dot(image_normal)),
        };
        if self == Self::Explicit {
            return VertexLoad { force_mn: pull * (2.0 * gain_mn_per_mm), stiffness_mn_per_mm: Matrix3::zeros() };
        }
        let stiffness = (Matrix3::identity() - self.target_derivative(normal, image_normal)) * (2.0 * gain_mn_per_mm);
        VertexLoad { force_mn: pull * (2.0 * gain_mn_per_mm) + stiffness * position_mm, stiffness_mn_per_mm: stiffness }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NORMAL: Vector3<f64> = Vector3::new(0.0, 0.0, 1.0);

    /// An image normal at an angle β to [`NORMAL`], and tan²β.
    fn oblique(beta_deg: f64) -> (Vector3<f64>, f64) {
        let beta = beta_deg.to_radians();
        (Vector3::new(0.6 * beta.sin(), 0.8 * beta.sin(), beta.cos()), beta.tan().powi(2))
    }

    /// The construction of \[Billet2009\] itself: the line through Y along N meets the plane through the origin with the image normal.
    fn target_of(position_mm: &Vector3<f64>, image_normal: &Vector3<f64>) -> BoundaryTarget {
        let signed_distance_mm = -image_normal.dot(position_mm) / image_normal.dot(&NORMAL);
        BoundaryTarget {
            vertex: 0,
            point_mm: position_mm + NORMAL * signed_distance_mm,
            normal: NORMAL,
            image_normal: *image_normal,
            signed_distance_mm,
            confidence: 1.0,
            area_mm2: 1.0,
        }
    }

    /// On span{N, N'} the printed B and the exact one agree; along t = N × N' the printed one has 1/cos²β for 1, so I − B has the
    /// eigenvalue −tan²β.
    #[test]
    fn the_printed_b_has_the_eigenvalue_minus_tan_squared_across() {
        let (image_normal, tan_squared) = oblique(35.0);
        let published = ForceScheme::Published.target_derivative(&NORMAL, &image_normal);
        let exact = ForceScheme::Exact.target_derivative(&NORMAL, &image_normal);
        let across = NORMAL.cross(&image_normal).normalize();
        for within in [NORMAL, image_normal] {
            assert!(((published - exact) * within).norm() < 1e-12);
        }
        assert!((published * across - across * (1.0 + tan_squared)).norm() < 1e-12);
        assert!((exact * across - across).norm() < 1e-12);
        let stiffness = Matrix3::identity() - published;
        assert!((stiffness * across + across * tan_squared).norm() < 1e-12);
    }

    /// The exact and the published step predict the boundary point of the construction after any displacement (exact) or any
    /// displacement in span{N, N'} (published): F − K Y⁺ = 2γ(Z(Y⁺) − Y⁺).
    #[test]
    fn the_exact_load_predicts_the_construction_at_the_end_of_the_step() {
        let (image_normal, _) = oblique(40.0);
        let (start, end) = (Vector3::new(1.0, -2.0, 3.0), Vector3::new(1.7, -1.1, 2.2));
        let load = ForceScheme::Exact.load(&target_of(&start, &image_normal), &start, 0.7);
        let predicted = load.force_mn - load.stiffness_mn_per_mm * end;
        let true_force = (target_of(&end, &image_normal).point_mm - end) * 1.4;
        assert!((predicted - true_force).norm() < 1e-12);
    }

    #[test]
    fn the_variational_stiffness_is_symmetric_and_positive_and_derives_from_its_energy() {
        let (image_normal, _) = oblique(50.0);
        let (start, end) = (Vector3::new(1.0, -2.0, 3.0), Vector3::new(1.7, -1.1, 2.2));
        let load = ForceScheme::Variational.load(&target_of(&start, &image_normal), &start, 0.7);
        let stiffness = load.stiffness_mn_per_mm;
        assert_eq!(stiffness, stiffness.transpose());
        assert!(stiffness.symmetric_eigenvalues().min() > -1e-12);
        let energy = |at: Vector3<f64>| 0.7 * target_of(&at, &image_normal).signed_distance_mm.powi(2);
        let force = load.force_mn - stiffness * end;
        let direction = Vector3::new(0.3, 0.9, -0.4);
        let remainder = |h: f64| (energy(end + direction * h) - energy(end) + force.dot(&direction) * h).abs();
        assert!((remainder(1e-2) / remainder(1e-3) - 100.0).abs() < 0.1, "the Taylor remainder must be of second order");
    }

    /// A vertex with stiffness k and dashpot c held by its spring alone, backward Euler: (k + c/h) Y⁺ + K Y⁺ = c/h Y + F.
    /// With 2γ tan²β = 1.5 (k + c/h) the published scheme throws it sideways; exact and variational bring it to rest.
    #[test]
    fn only_the_published_scheme_is_unstable() {
        let (image_normal, tan_squared) = oblique(40.0);
        let (spring, dashpot_over_step) = (1.0, 4.0);
        let gain = 1.5 * (spring + dashpot_over_step) / (2.0 * tan_squared);
        let final_distance = |scheme: ForceScheme| {
            let mut position_mm = Vector3::new(0.1, 0.2, -0.1);
            for _ in 0..60 {
                let load = scheme.load(&target_of(&position_mm, &image_normal), &position_mm, gain);
                let system = Matrix3::identity() * (spring + dashpot_over_step) + load.stiffness_mn_per_mm;
                position_mm = system.try_inverse().unwrap() * (position_mm * dashpot_over_step + load.force_mn);
            }
            position_mm.norm()
        };
        assert!(final_distance(ForceScheme::Published) > 1e3);
        assert!(final_distance(ForceScheme::Exact) < 1e-3);
        assert!(final_distance(ForceScheme::Variational) < 1e-3);
    }
}
