//! How fast the depolarisation runs: speed, anisotropy and fibres, one a tetrahedron.

use nalgebra::Vector3;

use super::ActivationError;

/// Speed $v$ along the fibre, ratio $\rho$ of squared speeds across and along it, and the fibre: $D = \rho I + (1 - \rho) f f^T$.
#[derive(Debug, Clone, PartialEq)]
pub struct Conduction {
    speed_mm_per_s: Vec<f64>,
    anisotropy_ratio: f64,
    fibres: Vec<Vector3<f64>>,
}

impl Conduction {
    /// Checks and keeps the conduction of a mesh; `speed_mm_per_s` (along the fibre) and `fibres` (any length but zero) have one
    /// entry a tetrahedron.
    ///
    /// # Errors
    /// [`ActivationError`] names the first entry that is not positive and finite, or says that the numbers differ.
    pub fn new(speed_mm_per_s: Vec<f64>, anisotropy_ratio: f64, mut fibres: Vec<Vector3<f64>>) -> Result<Self, ActivationError> {
        if speed_mm_per_s.len() != fibres.len() {
            let (speed_count, fibre_count) = (speed_mm_per_s.len(), fibres.len());
            return Err(ActivationError::FieldCount { speed_count, fibre_count, tetrahedron_count: speed_count });
        }
        if !(anisotropy_ratio > 0.0 && anisotropy_ratio <= 1.0) {
            return Err(ActivationError::BadRatio { ratio: anisotropy_ratio });
        }
        if let Some(tetrahedron) = speed_mm_per_s.iter().position(|&v| !(v > 0.0 && v.is_finite())) {
            return Err(ActivationError::BadSpeed { tetrahedron, speed_mm_per_s: speed_mm_per_s[tetrahedron] });
        }
        for (tetrahedron, fibre) in fibres.iter_mut().enumerate() {
            let norm = fibre.norm();
            if !(norm > 0.0 && norm.is_finite()) {
                return Err(ActivationError::BadFibre { tetrahedron });
            }
            *fibre /= norm;
        }
        Ok(Self { speed_mm_per_s, anisotropy_ratio, fibres })
    }

    /// Speed along the fibre, mm/s, one a tetrahedron.
    pub fn speed_mm_per_s(&self) -> &[f64] {
        &self.speed_mm_per_s
    }

    /// Squared speed across over squared speed along the fibre.
    pub fn anisotropy_ratio(&self) -> f64 {
        self.anisotropy_ratio
    }

    /// Unit fibres, one a tetrahedron.
    pub fn fibres(&self) -> &[Vector3<f64>] {
        &self.fibres
    }

    /// The travel time (s) along a straight `offset_mm` inside a tetrahedron: $\sqrt{e^T D^{-1} e} / v$.
    pub fn travel_time_s(&self, tetrahedron: usize, offset_mm: &Vector3<f64>) -> f64 {
        self.metric(tetrahedron).squared_s2(offset_mm).sqrt()
    }

    /// d ln T/dρ of the travel time T along a straight `offset_mm` inside a tetrahedron.
    pub(super) fn log_time_by_anisotropy(&self, tetrahedron: usize, offset_mm: &Vector3<f64>) -> f64 {
        let squared_s2 = self.metric(tetrahedron).squared_s2(offset_mm);
        if squared_s2 <= 0.0 {
            return 0.0;
        }
        let across_mm2 = offset_mm.norm_squared() - self.fibres[tetrahedron].dot(offset_mm).powi(2);
        -across_mm2 / (2.0 * (self.anisotropy_ratio * self.speed_mm_per_s[tetrahedron]).powi(2) * squared_s2)
    }

    /// The metric of travel times in a tetrahedron.
    pub(super) fn metric(&self, tetrahedron: usize) -> Metric<'_> {
        let squared_slowness = self.speed_mm_per_s[tetrahedron].powi(2).recip();
        let across = squared_slowness / self.anisotropy_ratio;
        Metric { fibre: &self.fibres[tetrahedron], across_s2_per_mm2: across, along_less_across_s2_per_mm2: squared_slowness - across }
    }

    /// $v^2\, a \cdot D b$, the product of two slownesses (per mm) in the metric of the eikonal equation.
    pub(super) fn flux(&self, tetrahedron: usize, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        let fibre = &self.fibres[tetrahedron];
        let rho = self.anisotropy_ratio;
        (rho * a.dot(b) + (1.0 - rho) * fibre.dot(a) * fibre.dot(b)) * self.speed_mm_per_s[tetrahedron].powi(2)
    }
}

/// $D^{-1}/v^2 = (\rho^{-1} I + (1 - \rho^{-1}) f f^T)/v^2$.
pub(super) struct Metric<'a> {
    fibre: &'a Vector3<f64>,
    across_s2_per_mm2: f64,
    along_less_across_s2_per_mm2: f64,
}

impl Metric<'_> {
    /// Squared travel time along a straight line, s².
    pub(super) fn squared_s2(&self, offset_mm: &Vector3<f64>) -> f64 {
        self.across_s2_per_mm2 * offset_mm.norm_squared() + self.along_less_across_s2_per_mm2 * self.fibre.dot(offset_mm).powi(2)
    }
}
