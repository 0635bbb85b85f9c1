//! The house units and every conversion at its edge.
//!
//! Inside: mm, s, kg, hence kPa for stress and pressure, mN for force, mm³ for volume.
//! Outside: mL for cavity volumes, mmHg for pressures shown to people, ms for phase durations.
//! A quantity carries its unit as the last part of its name (`_mm`, `_kpa`, `_ml`, `_s`).

/// mm³ in one mL.
pub const MM3_PER_ML: f64 = 1000.0;

/// kPa in one mmHg.
pub const KPA_PER_MMHG: f64 = 0.133_322_387_415;

/// ms in one s.
pub const MS_PER_S: f64 = 1000.0;

/// Volume in mL of a volume in mm³.
pub fn ml_from_mm3(volume_mm3: f64) -> f64 {
    volume_mm3 / MM3_PER_ML
}

/// Volume in mm³ of a volume in mL.
pub fn mm3_from_ml(volume_ml: f64) -> f64 {
    volume_ml * MM3_PER_ML
}

/// Pressure in mmHg of a pressure in kPa.
pub fn mmhg_from_kpa(pressure_kpa: f64) -> f64 {
    pressure_kpa / KPA_PER_MMHG
}

/// Pressure in kPa of a pressure in mmHg.
pub fn kpa_from_mmhg(pressure_mmhg: f64) -> f64 {
    pressure_mmhg * KPA_PER_MMHG
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One conversion end to end: a normal stroke work, 120 mmHg × 70 mL, is about 1.12 J.
    #[test]
    fn stroke_work_of_a_normal_heart_is_about_one_joule() {
        let work_kpa_mm3 = kpa_from_mmhg(120.0) * mm3_from_ml(70.0);
        let work_joule = work_kpa_mm3 * 1e3 * 1e-9;
        assert!((work_joule - 1.119_9).abs() < 1e-3, "{work_joule} J");
    }
}
