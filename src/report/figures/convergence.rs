//! Cost over simulations, both on logarithmic axes, a curve a solver.

use std::path::Path;

use super::chart::{Axes, Curve, Look, Margins, Tick, decorate, draw_curves, headed, legend_of, plot};
use super::curves::decades;
use super::style::{padded, picture};
use crate::report::ReportError;

/// What several searches spent and reached.
#[derive(Debug, Clone, PartialEq)]
pub struct Convergence {
    /// Title.
    pub title: String,
    /// One curve a solver.
    pub solvers: Vec<SolverCurve>,
}

/// What one search spent and reached.
#[derive(Debug, Clone, PartialEq)]
pub struct SolverCurve {
    /// Name of the solver.
    pub name: String,
    /// Simulations with the cost they led to.
    pub points: Vec<(f64, f64)>,
}

/// Draws the searches.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn convergence(file: &Path, figure: &Convergence) -> Result<(), ReportError> {
    const LOOKS: [Look; 5] = [Look::Simulated, Look::Lateral, Look::Anterior, Look::Inferior, Look::Other];
    let logarithm = |&(spent, cost): &(f64, f64)| (spent > 0.0 && cost > 0.0 && cost.is_finite()).then(|| (spent.log10(), cost.log10()));
    let curve = |(solver, look): (&SolverCurve, &Look)| Curve {
        name: solver.name.clone(),
        look: *look,
        points: solver.points.iter().filter_map(logarithm).collect(),
    };
    let curves: Vec<Curve> = figure.solvers.iter().zip(LOOKS.iter().cycle()).map(curve).collect();
    let range = |of: fn(&(f64, f64)) -> f64| {
        let (low, high) = padded(curves.iter().flat_map(|curve| curve.points.iter().map(of)), 0.0, 0.0);
        (low.floor(), high.ceil().max(low.floor() + 1.0))
    };
    let (x, y) = (range(|point| point.0), range(|point| point.1));
    picture(file, "the convergence", (1200, 900), |area| {
        let below = headed(area, &figure.title, &legend_of(&curves))?;
        let axes = Axes { x_title: "simulations", y_title: "cost", x, y };
        let mut chart = plot(&below, &axes, &Margins::default())?;
        let whole: Vec<Tick> = decades(x.0 as i32, x.1 as i32);
        decorate(area, &chart, &axes, &whole, &decades(y.0 as i32, y.1 as i32))?;
        draw_curves(&mut chart, &curves)
    })
}
