//! What can be wrong with a circulation.

/// A circulation that cannot be set up or solved, with the place and the amount.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum CirculationError {
    /// A constant that must be positive (or not negative) and finite is not.
    #[error("{quantity} = {value} {unit} is not allowed; it must be finite and {requirement}")]
    Constant { quantity: &'static str, value: f64, unit: &'static str, requirement: &'static str },
    /// The parts of a valve problem disagree on the number of ventricles.
    #[error("{response_count} cavities answer, but there are {port_count} ventricles and {volume_count} volumes")]
    Count { response_count: usize, port_count: usize, volume_count: usize },
    /// The cavities do not yield to their pressures.
    #[error(
        "the cavity compliance is not positive definite (smallest diagonal entry {smallest_mm3_per_kpa} mm³/kPa), so no pressure can be found; \
         the mesh has most likely turned inside out: use a smaller step or a stiffer wall"
    )]
    IndefiniteCompliance { smallest_mm3_per_kpa: f64 },
}

/// Refuses constants that are not finite, negative, or (unless `or_zero`) zero.
pub(super) fn positive(quantity: &'static str, unit: &'static str, value: f64, or_zero: bool) -> Result<f64, CirculationError> {
    if value.is_finite() && (value > 0.0 || (or_zero && value == 0.0)) {
        return Ok(value);
    }
    let requirement = if or_zero { "not negative" } else { "positive" };
    Err(CirculationError::Constant { quantity, value, unit, requirement })
}
