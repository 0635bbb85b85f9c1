//! What a clinician reads off a beat: volumes, ejection fraction, pressures, phase durations.

use serde::{Deserialize, Serialize};

use super::phases::phase_duration_s;
use super::{CurveRow, PhaseEvent, VentricleCurve, phase_events};
use crate::anatomy::Ventricle;
use crate::circulation::Phase;
use crate::units::{MS_PER_S, mmhg_from_kpa};

/// One beat of one ventricle in figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BeatObservables {
    /// EDV, the largest volume, mL.
    pub end_diastolic_volume_ml: f64,
    /// ESV, the smallest volume, mL.
    pub end_systolic_volume_ml: f64,
    /// SV = EDV − ESV, mL.
    pub stroke_volume_ml: f64,
    /// EF = SV / EDV.
    pub ejection_fraction: f64,
    /// Largest pressure, mmHg.
    pub pressure_peak_mmhg: f64,
    /// Pressure at the start of contraction, mmHg.
    pub pressure_end_diastolic_mmhg: f64,
    /// Largest rise of pressure, mmHg/s.
    pub pressure_rate_max_mmhg_per_s: f64,
    /// Largest arterial pressure, mmHg.
    pub arterial_pressure_systolic_mmhg: f64,
    /// Smallest arterial pressure, mmHg.
    pub arterial_pressure_diastolic_mmhg: f64,
    /// Duration of isovolumetric contraction, ms.
    pub isovolumetric_contraction_ms: f64,
    /// Duration of ejection, ms.
    pub ejection_ms: f64,
    /// Duration of isovolumetric relaxation, ms.
    pub isovolumetric_relaxation_ms: f64,
    /// Duration of filling, ms.
    pub filling_ms: f64,
}

impl BeatObservables {
    /// The figures of the rows with `start_s` < t ≤ `start_s` + `period_s`; `None` if the ventricle has fewer than two rows there.
    ///
    /// Durations lie between the events of [`phase_events`], which resolve fractions of a step.
    pub fn of_beat(curves: &[CurveRow], ventricle: Ventricle, start_s: f64, period_s: f64) -> Option<Self> {
        let tolerance_s = 1e-9 * period_s.abs().max(1.0);
        let inside = |time_s: f64| time_s > start_s + tolerance_s && time_s <= start_s + period_s + tolerance_s;
        let first = curves.iter().position(|row| inside(row.time_s))?;
        let count = curves[first..].iter().take_while(|row| inside(row.time_s)).count();
        // The row before the beat starts its first step.
        let rows = &curves[first.saturating_sub(1)..first + count];
        let beat: Vec<(f64, VentricleCurve)> = rows.iter().filter_map(|row| Some((row.time_s, row.ventricle(ventricle)?))).collect();
        let events = phase_events(rows, ventricle);
        if beat.len() < 2 { None } else { Some(Self::of_rows(&beat, &events)) }
    }

    fn of_rows(beat: &[(f64, VentricleCurve)], events: &[PhaseEvent]) -> Self {
        let largest = |value: fn(&VentricleCurve) -> f64| beat.iter().map(|(_, c)| value(c)).fold(f64::NEG_INFINITY, f64::max);
        let smallest = |value: fn(&VentricleCurve) -> f64| beat.iter().map(|(_, c)| value(c)).fold(f64::INFINITY, f64::min);
        let (first_s, last_s) = (beat[0].0, beat[beat.len() - 1].0);
        let duration_ms = |phase: Phase| phase_duration_s(events, beat[0].1.phase, phase, first_s, last_s) * MS_PER_S;
        let rate = |pair: &[(f64, VentricleCurve)]| (pair[1].1.pressure_kpa - pair[0].1.pressure_kpa) / (pair[1].0 - pair[0].0);
        let contraction = beat.windows(2).find(|p| p[1].1.phase == Phase::IsovolumetricContraction && p[0].1.phase == Phase::Filling);
        let end_diastolic_kpa = contraction.map_or(beat[0].1.pressure_kpa, |pair| pair[0].1.pressure_kpa);
        let (end_diastolic_volume_ml, end_systolic_volume_ml) = (largest(|c| c.volume_ml), smallest(|c| c.volume_ml));
        let stroke_volume_ml = end_diastolic_volume_ml - end_systolic_volume_ml;
        Self {
            end_diastolic_volume_ml,
            end_systolic_volume_ml,
            stroke_volume_ml,
            ejection_fraction: stroke_volume_ml / end_diastolic_volume_ml,
            pressure_peak_mmhg: mmhg_from_kpa(largest(|c| c.pressure_kpa)),
            pressure_end_diastolic_mmhg: mmhg_from_kpa(end_diastolic_kpa),
            pressure_rate_max_mmhg_per_s: mmhg_from_kpa(beat.windows(2).map(rate).fold(f64::NEG_INFINITY, f64::max)),
            arterial_pressure_systolic_mmhg: mmhg_from_kpa(largest(|c| c.arterial_pressure_kpa)),
            arterial_pressure_diastolic_mmhg: mmhg_from_kpa(smallest(|c| c.arterial_pressure_kpa)),
            isovolumetric_contraction_ms: duration_ms(Phase::IsovolumetricContraction),
            ejection_ms: duration_ms(Phase::Ejection),
            isovolumetric_relaxation_ms: duration_ms(Phase::IsovolumetricRelaxation),
            filling_ms: duration_ms(Phase::Filling),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heart::HeartState;
    use crate::heart::VentricleState;
    use crate::mechanics::MotionState;
    use crate::units::kpa_from_mmhg;

    /// A beat of trapezia: 140 mL to 56 mL, 8 to 120 mmHg in 50 ms, 124 while it ejects, and phases of 50, 300, 100 and 350 ms in steps of 10 ms. It fills at
    /// 4 mmHg from an atrium of 8 mmHg.
    fn trapezoidal_beat() -> Vec<CurveRow> {
        let row = |step: i32| {
            let t = f64::from(step) * 0.01;
            let (phase, volume_ml, pressure_mmhg) = match step {
                ..=0 => (Phase::Filling, 140.0, 4.0),
                1..=5 => (Phase::IsovolumetricContraction, 140.0, 8.0 + 112.0 * t / 0.05),
                6..=35 => (Phase::Ejection, 140.0 - 84.0 * (t - 0.05) / 0.3, 124.0),
                36..=45 => (Phase::IsovolumetricRelaxation, 56.0, 120.0 - 112.0 * (t - 0.35) / 0.1),
                _ => (Phase::Filling, 56.0 + 84.0 * (t - 0.45) / 0.35, 4.0),
            };
            let ventricle = VentricleState {
                ventricle: Ventricle::Left,
                volume_mm3: volume_ml * 1000.0,
                pressure_kpa: kpa_from_mmhg(pressure_mmhg),
                capacitor_pressure_kpa: 11.0,
                arterial_pressure_kpa: kpa_from_mmhg(120.0),
                atrial_pressure_kpa: kpa_from_mmhg(8.0),
                outflow_ml_per_s: 0.0,
                inflow_ml_per_s: 0.0,
                phase,
                rest_pressure_kpa: 1.0,
            };
            let motion = MotionState::at_rest(vec![]);
            HeartState { time_s: t, motion, ventricles: vec![ventricle] }.curve_row()
        };
        (-20..=100).map(row).collect()
    }

    #[test]
    fn a_beat_of_known_shape_is_read_as_it_is() {
        let beat = BeatObservables::of_beat(&trapezoidal_beat(), Ventricle::Left, 0.0, 0.8).unwrap();
        // In the first step the pressure rises from 4 to 30.4 mmHg and passes the atrium's.
        let shut_ms = 10.0 * 4.0 / 26.4;
        // In the first step of relaxation it falls from 124 to 108.8 mmHg and passes the artery's 120.
        let late_ms = 10.0 * 4.0 / 15.2;
        let expected = [
            (beat.end_diastolic_volume_ml, 140.0),
            (beat.end_systolic_volume_ml, 56.0),
            (beat.ejection_fraction, 0.6),
            (beat.pressure_peak_mmhg, 124.0),
            (beat.pressure_end_diastolic_mmhg, 4.0),
            (beat.pressure_rate_max_mmhg_per_s, 2640.0),
            (beat.isovolumetric_contraction_ms, 50.0 - shut_ms),
            (beat.ejection_ms, 300.0 + late_ms),
            (beat.isovolumetric_relaxation_ms, 100.0 - late_ms),
            (beat.filling_ms, 350.0 + shut_ms),
        ];
        for (found, expected) in expected {
            assert!((found - expected).abs() < 1e-9 * expected, "{found} {expected}");
        }
    }

    #[test]
    fn a_ventricle_that_is_not_there_has_no_beat() {
        assert_eq!(BeatObservables::of_beat(&trapezoidal_beat(), Ventricle::Right, 0.0, 0.8), None);
        assert_eq!(BeatObservables::of_beat(&trapezoidal_beat(), Ventricle::Left, 5.0, 0.8), None);
    }
}
