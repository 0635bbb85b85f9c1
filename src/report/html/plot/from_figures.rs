//! The charts of the page from the figures that are also drawn as PNG.

use super::Plot;
use crate::report::figures::{
    BeatCurves, Convergence, Curve, Look, LoopPoint, PressureVolumeLoop, SolverCurve, StrainPanel, TimeCurves, VolumeCurves,
};
use crate::units::KPA_PER_MMHG;

impl From<&TimeCurves> for Plot {
    fn from(figure: &TimeCurves) -> Self {
        Self::over_time(&figure.title, &figure.quantity, &figure.curves)
    }
}

impl From<&VolumeCurves> for Plot {
    fn from(figure: &VolumeCurves) -> Self {
        Self::over_time(&figure.title, format!("{} (mL)", figure.quantity), &figure.curves)
    }
}

/// The pressures.
impl From<&BeatCurves> for Plot {
    fn from(figure: &BeatCurves) -> Self {
        let plot = Self::over_time(&figure.title, "pressure (kPa)", &figure.pressures).with_phases(&figure.phases);
        Self { right: Some(("mmHg".into(), 1.0 / KPA_PER_MMHG)), ..plot }
    }
}

impl From<&StrainPanel> for Plot {
    fn from(panel: &StrainPanel) -> Self {
        let curves: Vec<Curve> = panel.curves.iter().map(|curve| Curve { points: percent(&curve.points), ..curve.clone() }).collect();
        Self::over_time(format!("{} strain", capitalised(&panel.direction)), "strain (%)", &curves)
    }
}

impl From<&PressureVolumeLoop> for Plot {
    fn from(figure: &PressureVolumeLoop) -> Self {
        let named = |point: &LoopPoint| (point.name.clone(), point.volume_ml, point.pressure_kpa);
        Self {
            title: figure.title.clone(),
            x_title: format!("{} volume (mL)", figure.ventricle),
            y_title: "pressure (kPa)".into(),
            right: Some(("mmHg".into(), 1.0 / KPA_PER_MMHG)),
            curves: figure.loops.clone(),
            points: figure.points.iter().map(named).collect(),
            ..Self::default()
        }
    }
}

impl From<&Convergence> for Plot {
    fn from(figure: &Convergence) -> Self {
        const LOOKS: [Look; 6] = [Look::Simulated, Look::Artery, Look::Truth, Look::Other, Look::Initial, Look::Inferior];
        let curve = |(n, solver): (usize, &SolverCurve)| Curve {
            name: solver.name.clone(),
            look: LOOKS[n % LOOKS.len()],
            points: solver.points.iter().copied().filter(|&(spent, cost)| spent > 0.0 && cost > 0.0).collect(),
        };
        Self {
            title: figure.title.clone(),
            x_title: "simulations".into(),
            y_title: "cost".into(),
            curves: figure.solvers.iter().enumerate().map(curve).collect(),
            is_logarithmic: [true, true],
            ..Self::default()
        }
    }
}

fn percent(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    points.iter().map(|&(x, y)| (x, 100.0 * y)).collect()
}

fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}
