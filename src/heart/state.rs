//! What changes while the heart beats, and the row of `curves.csv` that shows it.

use serde::{Deserialize, Serialize};

use crate::anatomy::Ventricle;
use crate::circulation::Phase;
use crate::mechanics::MotionState;
use crate::units::ml_from_mm3;

/// One ventricle and the artery behind it at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VentricleState {
    /// Which one.
    pub ventricle: Ventricle,
    /// Cavity volume V, mm³.
    pub volume_mm3: f64,
    /// Cavity pressure p, kPa.
    pub pressure_kpa: f64,
    /// Pressure p_C over the compliance of its artery, kPa.
    pub capacitor_pressure_kpa: f64,
    /// Arterial pressure p_C + Z q_out, kPa.
    pub arterial_pressure_kpa: f64,
    /// Atrial pressure, kPa.
    pub atrial_pressure_kpa: f64,
    /// Flow into the artery during the step that led here, mL/s.
    pub outflow_ml_per_s: f64,
    /// Flow from the atrium during the step that led here, mL/s.
    pub inflow_ml_per_s: f64,
    /// Phase during the step that led here.
    pub phase: Phase,
    /// Pressure under which the mesh rests (prestress), kPa.
    pub rest_pressure_kpa: f64,
}

/// The heart at an instant; a value that can be kept, copied and gone back to.
#[derive(Debug, Clone, PartialEq)]
pub struct HeartState {
    /// Time, s; 0 is the trigger of the first beat, negative times come before it.
    pub time_s: f64,
    /// Position and velocity of every vertex.
    pub motion: MotionState,
    /// One entry a ventricle, left first.
    pub ventricles: Vec<VentricleState>,
}

impl HeartState {
    /// The state of a ventricle, if the heart has it.
    pub fn ventricle(&self, ventricle: Ventricle) -> Option<&VentricleState> {
        self.ventricles.iter().find(|state| state.ventricle == ventricle)
    }

    /// The row of `curves.csv` of this instant.
    pub fn curve_row(&self) -> CurveRow {
        let (left, right) = (self.ventricle(Ventricle::Left), self.ventricle(Ventricle::Right));
        let of = |state: Option<&VentricleState>, value: fn(&VentricleState) -> f64| state.map(value);
        CurveRow {
            time_s: self.time_s,
            phase_lv: left.map(|state| state.phase),
            phase_rv: right.map(|state| state.phase),
            volume_lv_ml: of(left, |state| ml_from_mm3(state.volume_mm3)),
            volume_rv_ml: of(right, |state| ml_from_mm3(state.volume_mm3)),
            pressure_lv_kpa: of(left, |state| state.pressure_kpa),
            pressure_rv_kpa: of(right, |state| state.pressure_kpa),
            pressure_aorta_kpa: of(left, |state| state.arterial_pressure_kpa),
            pressure_pulmonary_kpa: of(right, |state| state.arterial_pressure_kpa),
            pressure_atrium_left_kpa: of(left, |state| state.atrial_pressure_kpa),
            pressure_atrium_right_kpa: of(right, |state| state.atrial_pressure_kpa),
            flow_aorta_ml_per_s: of(left, |state| state.outflow_ml_per_s),
            flow_pulmonary_ml_per_s: of(right, |state| state.outflow_ml_per_s),
            flow_mitral_ml_per_s: of(left, |state| state.inflow_ml_per_s),
            flow_tricuspid_ml_per_s: of(right, |state| state.inflow_ml_per_s),
        }
    }
}

/// A row of `curves.csv`; columns of a ventricle that the heart does not have are empty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the columns of the file, units last")]
pub struct CurveRow {
    pub time_s: f64,
    pub phase_lv: Option<Phase>,
    pub phase_rv: Option<Phase>,
    pub volume_lv_ml: Option<f64>,
    pub volume_rv_ml: Option<f64>,
    pub pressure_lv_kpa: Option<f64>,
    pub pressure_rv_kpa: Option<f64>,
    pub pressure_aorta_kpa: Option<f64>,
    pub pressure_pulmonary_kpa: Option<f64>,
    pub pressure_atrium_left_kpa: Option<f64>,
    pub pressure_atrium_right_kpa: Option<f64>,
    pub flow_aorta_ml_per_s: Option<f64>,
    pub flow_pulmonary_ml_per_s: Option<f64>,
    pub flow_mitral_ml_per_s: Option<f64>,
    pub flow_tricuspid_ml_per_s: Option<f64>,
}

/// The columns of one ventricle in a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VentricleCurve {
    /// Phase.
    pub phase: Phase,
    /// Cavity volume, mL.
    pub volume_ml: f64,
    /// Cavity pressure, kPa.
    pub pressure_kpa: f64,
    /// Arterial pressure, kPa.
    pub arterial_pressure_kpa: f64,
    /// Atrial pressure, kPa.
    pub atrial_pressure_kpa: f64,
    /// Flow into the artery, mL/s.
    pub outflow_ml_per_s: f64,
    /// Flow from the atrium, mL/s.
    pub inflow_ml_per_s: f64,
}

impl CurveRow {
    /// A row without ventricles.
    #[cfg(test)]
    pub(super) fn empty(time_s: f64) -> Self {
        let state = HeartState { time_s, motion: MotionState::at_rest(Vec::new()), ventricles: Vec::new() };
        state.curve_row()
    }

    /// The columns of one ventricle, if it has them.
    pub fn ventricle(&self, ventricle: Ventricle) -> Option<VentricleCurve> {
        let left = ventricle == Ventricle::Left;
        let of = |lv, rv| if left { lv } else { rv };
        Some(VentricleCurve {
            phase: if left { self.phase_lv } else { self.phase_rv }?,
            volume_ml: of(self.volume_lv_ml, self.volume_rv_ml)?,
            pressure_kpa: of(self.pressure_lv_kpa, self.pressure_rv_kpa)?,
            arterial_pressure_kpa: of(self.pressure_aorta_kpa, self.pressure_pulmonary_kpa)?,
            atrial_pressure_kpa: of(self.pressure_atrium_left_kpa, self.pressure_atrium_right_kpa)?,
            outflow_ml_per_s: of(self.flow_aorta_ml_per_s, self.flow_pulmonary_ml_per_s)?,
            inflow_ml_per_s: of(self.flow_mitral_ml_per_s, self.flow_tricuspid_ml_per_s)?,
        })
    }
}
