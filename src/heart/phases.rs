//! When the valves open and shut, to a fraction of a step, and how long the phases between last, [Billet2009] §2.

use serde::{Deserialize, Serialize};

use super::{CurveRow, VentricleCurve};
use crate::anatomy::Ventricle;
use crate::circulation::Phase;

/// A phase of a ventricle begins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PhaseEvent {
    /// When, s.
    pub time_s: f64,
    /// The phase that begins.
    pub begins: Phase,
}

/// The changes of phase of a ventricle, ascending in time.
///
/// Within the step that changes the phase, the time is where the pressure across the valve that moves passes through zero on the line
/// between the two rows.
pub fn phase_events(curves: &[CurveRow], ventricle: Ventricle) -> Vec<PhaseEvent> {
    let rows: Vec<(f64, VentricleCurve)> = curves.iter().filter_map(|row| Some((row.time_s, row.ventricle(ventricle)?))).collect();
    let changes = rows.windows(2).filter(|pair| pair[0].1.phase != pair[1].1.phase);
    changes
        .map(|pair| {
            let ((start_s, before), (end_s, after)) = (pair[0], pair[1]);
            let drive = driving_pressure(after.phase);
            let (from_kpa, to_kpa) = (drive(&before), drive(&after));
            let fraction = if from_kpa == to_kpa { 1.0 } else { (from_kpa / (from_kpa - to_kpa)).clamp(0.0, 1.0) };
            PhaseEvent { time_s: start_s + (end_s - start_s) * fraction, begins: after.phase }
        })
        .collect()
}

/// The pressure across the valve whose movement begins a phase, kPa.
fn driving_pressure(begins: Phase) -> fn(&VentricleCurve) -> f64 {
    match begins {
        Phase::Ejection | Phase::IsovolumetricRelaxation => |curve| curve.pressure_kpa - curve.arterial_pressure_kpa,
        Phase::Filling | Phase::IsovolumetricContraction => |curve| curve.atrial_pressure_kpa - curve.pressure_kpa,
    }
}

/// How long a phase lasts in all between two times, s, when `first` is the phase before the first event.
pub(super) fn phase_duration_s(events: &[PhaseEvent], first: Phase, phase: Phase, start_s: f64, end_s: f64) -> f64 {
    let clamped = |time_s: f64| time_s.clamp(start_s, end_s);
    let begins = std::iter::once((start_s, first)).chain(events.iter().map(|event| (clamped(event.time_s), event.begins)));
    let ends = events.iter().map(|event| clamped(event.time_s)).chain(std::iter::once(end_s));
    begins.zip(ends).filter(|((_, begun), _)| *begun == phase).map(|((from_s, _), to_s)| to_s - from_s).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(time_s: f64, phase: Phase, pressure_kpa: f64) -> CurveRow {
        CurveRow {
            time_s,
            phase_lv: Some(phase),
            volume_lv_ml: Some(100.0),
            pressure_lv_kpa: Some(pressure_kpa),
            pressure_aorta_kpa: Some(10.0),
            pressure_atrium_left_kpa: Some(1.0),
            flow_aorta_ml_per_s: Some(0.0),
            flow_mitral_ml_per_s: Some(0.0),
            ..CurveRow::empty(time_s)
        }
    }

    #[test]
    fn events_lie_where_the_valve_pressures_cross() {
        let curves = [
            row(0.00, Phase::Filling, 0.8),
            row(0.01, Phase::IsovolumetricContraction, 1.6),
            row(0.02, Phase::IsovolumetricContraction, 9.0),
            row(0.03, Phase::Ejection, 10.25),
            row(0.04, Phase::Ejection, 10.1),
            row(0.05, Phase::IsovolumetricRelaxation, 9.9),
            row(0.06, Phase::Filling, -1.0),
        ];
        let events = phase_events(&curves, Ventricle::Left);
        let expected = [0.0025, 0.028, 0.045, 0.05 + 0.01 * 8.9 / 10.9];
        assert_eq!(events.iter().map(|event| event.begins).collect::<Vec<_>>(), Phase::CYCLE);
        for (event, time_s) in events.iter().zip(expected) {
            assert!((event.time_s - time_s).abs() < 1e-12, "{event:?} {time_s}");
        }
        let duration = |phase| phase_duration_s(&events, Phase::Filling, phase, 0.0, 0.06);
        assert!((duration(Phase::Ejection) - 0.017).abs() < 1e-12);
        let sum: f64 = Phase::CYCLE.into_iter().map(duration).sum();
        assert!((sum - 0.06).abs() < 1e-12, "the phases fill the time");
        assert!(phase_events(&curves, Ventricle::Right).is_empty());
    }
}
