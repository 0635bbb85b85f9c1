//! Arteries, atria and valves; sees the heart only as an affine cavity response, [Billet2009] §2.

use nalgebra::{DMatrix, DVector};

/// How the cavities answer to their pressures within one step: V(p) = V₀ + C p, one entry a cavity (1 or 2).
#[derive(Debug, Clone, PartialEq)]
pub struct CavityResponse {
    /// Volumes at zero pressure, mm³.
    pub volume_mm3: DVector<f64>,
    /// Compliance, mm³/kPa; symmetric positive definite.
    pub compliance_mm3_per_kpa: DMatrix<f64>,
}
