//! The beats of a rhythm one by one, own and extra ones alike, each from its depolarisation to the next.

use super::{CurveRow, Depolarisation, HeartRhythm, VentricleCurve};
use crate::anatomy::Ventricle;
use crate::units::mmhg_from_kpa;

/// One beat of one ventricle, from a depolarisation of the heart to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EachBeat {
    /// The depolarisation.
    pub depolarisation: Depolarisation,
    /// When the next one starts, or the simulation ends, s.
    pub end_s: f64,
    /// Largest volume before the pressure peaks, mL.
    pub end_diastolic_volume_ml: f64,
    /// Smallest volume after that, mL.
    pub end_systolic_volume_ml: f64,
    /// Largest pressure, mmHg.
    pub pressure_peak_mmhg: f64,
}

impl EachBeat {
    /// The beats whose depolarisations start within the curves; none for a ventricle that the heart does not have.
    pub fn of_rhythm(curves: &[CurveRow], rhythm: &HeartRhythm, ventricle: Ventricle) -> Vec<Self> {
        let rows: Vec<(f64, VentricleCurve)> = curves.iter().filter_map(|row| Some((row.time_s, row.ventricle(ventricle)?))).collect();
        let (Some(&(first_s, _)), Some(&(last_s, _))) = (rows.first(), rows.last()) else { return vec![] };
        let depolarisations = rhythm.depolarisations(first_s, last_s);
        let ends_s = depolarisations.iter().skip(1).map(|next| next.start_s).chain(std::iter::once(last_s));
        depolarisations.iter().zip(ends_s).filter_map(|(&depolarisation, end_s)| Self::within(&rows, depolarisation, end_s)).collect()
    }

    /// SV, mL.
    pub fn stroke_volume_ml(&self) -> f64 {
        self.end_diastolic_volume_ml - self.end_systolic_volume_ml
    }

    fn within(rows: &[(f64, VentricleCurve)], depolarisation: Depolarisation, end_s: f64) -> Option<Self> {
        let from = rows.partition_point(|(time_s, _)| *time_s < depolarisation.start_s);
        let to = rows.partition_point(|(time_s, _)| *time_s <= end_s);
        let beat = rows.get(from..to)?;
        let (peak, _) = beat.iter().enumerate().max_by(|(_, a), (_, b)| a.1.pressure_kpa.total_cmp(&b.1.pressure_kpa))?;
        let (filled, end_diastole) = beat[..=peak].iter().enumerate().max_by(|(_, a), (_, b)| a.1.volume_ml.total_cmp(&b.1.volume_ml))?;
        let end_systolic_volume_ml = beat[filled..].iter().map(|(_, curve)| curve.volume_ml).fold(f64::INFINITY, f64::min);
        Some(Self {
            depolarisation,
            end_s,
            end_diastolic_volume_ml: end_diastole.1.volume_ml,
            end_systolic_volume_ml,
            pressure_peak_mmhg: mmhg_from_kpa(beat[peak].1.pressure_kpa),
        })
    }
}
