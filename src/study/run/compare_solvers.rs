//! `kind = "compare_solvers"`: the parameters of one heart, from one set of data, by several solvers, and what each of them spends.

use std::time::Instant;

use serde::Serialize;

use super::calibration::residual;
use super::error::RunError;
use super::page::{Account, leave_page};
use super::personal_tables::iteration_rows;
use super::personalise::status_of;
use super::replica::TrackingBias;
use super::scene::{Beginning, Scene, tracked_at_rest};
use super::search::{Found, Task, find, journal_of};
use crate::personalisation::{ParameterSpace, SearchMethod};
use crate::report::figures::{Convergence, SolverCurve, convergence};
use crate::report::html::{Block, Plot, Section, Table};
use crate::report::{write_csv, write_iterations, write_json};
use crate::study::{Choice, Kind, Outcome, Plan, Provenance, RunContext, Status};

/// A cost this part of the way down from the start to the best one of all counts as reached.
const NEARLY: f64 = 0.99;
/// The same, within what no data can tell: a tenth of a unit of log-likelihood above the best.
const INDISTINGUISHABLE: f64 = 0.1;

/// A row of `solvers.csv`.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the columns of the file, units last")]
struct SolverRow {
    solver: &'static str,
    status: &'static str,
    iterations: usize,
    simulations: f64,
    /// Simulations until 99 % of the way down was done; empty if it never was.
    simulations_to_nearly: Option<f64>,
    /// Simulations until the cost was within 0.1 of the best of all; empty if it never was.
    simulations_to_best: Option<f64>,
    cost: f64,
    /// What a pass with all tangents took by the clock, in simulations; empty where the solver asks for none.
    clocked_pass_cost: Option<f64>,
    wall_time_s: f64,
}

/// `summary.json`.
#[derive(Serialize)]
struct SolversSummary<'a> {
    kind: Kind,
    status: Status,
    free_parameters: Vec<String>,
    start_cost: f64,
    best_cost: f64,
    solvers: &'a [SolverRow],
    wall_time_s: f64,
    provenance: &'a Provenance,
}

/// Runs every solver of the plan and leaves its files.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let Some(wanted) = &plan.personalisation else { return Err(RunError::NothingToFit) };
    let (patient, tracked) = tracked_at_rest(plan, wanted, context)?;
    let clock = patient.clock(plan.simulation.beats.count());
    let Beginning { base, measured, space, .. } = Scene::new(plan, wanted, &patient, &clock)?.begin(&tracked, context)?;
    let residual = residual(&wanted.data, &patient, &clock, &measured, &tracked, &TrackingBias::default())?;
    let task = Task { wanted, base: &base, space: &space, clock: &clock, residual: &residual };
    let mut found = Vec::new();
    for &method in &wanted.solvers {
        let journal = journal_of(plan, method.word(), &plan.provenance)?;
        let begun = Instant::now();
        let one = find(&task, method, &space.initial(), Some(&journal), context)?;
        if context.is_stopped() {
            return Err(RunError::Stopped);
        }
        found.push((method, one, begun.elapsed().as_secs_f64()));
        journal.discard();
    }
    leave(plan, &space, &found, started)
}

fn leave(plan: &Plan, space: &ParameterSpace, found: &[(SearchMethod, Found, f64)], started: Instant) -> Result<Outcome, RunError> {
    let folder = &plan.output.directory;
    let costs = found.iter().map(|(_, one, _)| one.calibration.evaluation.cost());
    let best_cost = costs.fold(f64::INFINITY, f64::min);
    let start_cost = found.first().and_then(|(_, one, _)| one.calibration.records.first()).map_or(f64::NAN, |record| record.cost);
    let rows: Vec<SolverRow> = found.iter().map(|one| row(one, start_cost, best_cost)).collect();
    write_csv(&folder.join("solvers.csv"), &rows)?;
    for (method, one, _) in found {
        let file = folder.join(format!("iterations_{}.csv", method.word()));
        write_iterations(&file, &space.names(), &iteration_rows(&one.calibration.records, space))?;
    }
    let curve = |(method, one, _): &(SearchMethod, Found, f64)| {
        let reached = one.calibration.records.iter().filter(|record| record.cost.is_finite());
        SolverCurve { name: method.word().to_owned(), points: reached.map(|record| (record.spent, record.cost)).collect() }
    };
    let figure = Convergence { title: "Cost over simulations".into(), solvers: found.iter().map(curve).collect() };
    if plan.output.figures {
        convergence(&folder.join("convergence.png"), &figure)?;
    }
    let headlines = rows.iter().map(|row| {
        let reached = row.simulations_to_best.map_or("never".to_owned(), |count| format!("after {count:.0}"));
        format!(
            "{}: cost {:.4} with {:.0} simulations ({}), within 0.1 of the best {reached}",
            row.solver, row.cost, row.simulations, row.status
        )
    });
    let headlines: Vec<String> = headlines.collect();
    let status = found.first().map_or(Status::Failed, |(_, one, _)| status_of(&one.calibration.outcome));
    let summary = SolversSummary {
        kind: plan.kind,
        status,
        free_parameters: space.names(),
        start_cost,
        best_cost,
        solvers: &rows,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&folder.join("summary.json"), &summary)?;
    let blocks = vec![Block::Plot(Plot::from(&figure)), Block::Table(Table::of_rows("Every solver", &rows))];
    let account = Account { status, headlines: &headlines, warnings: &[], key_figures: Vec::new(), record: &summary };
    leave_page(plan, account, vec![Section { title: "The solvers side by side".into(), blocks }], Vec::new())?;
    Ok(Outcome { status, directory: folder.clone(), headlines })
}

fn row((method, one, wall_time_s): &(SearchMethod, Found, f64), start_cost: f64, best_cost: f64) -> SolverRow {
    let calibration = &one.calibration;
    let until = |cost: f64| calibration.records.iter().find(|record| record.cost <= cost).map(|record| record.spent);
    SolverRow {
        solver: method.word(),
        status: calibration.outcome.status(),
        iterations: calibration.records.len().saturating_sub(1),
        simulations: calibration.spent,
        simulations_to_nearly: until(start_cost - NEARLY * (start_cost - best_cost)),
        simulations_to_best: until(best_cost + INDISTINGUISHABLE),
        cost: calibration.evaluation.cost(),
        clocked_pass_cost: one.clocked_pass_cost,
        wall_time_s: *wall_time_s,
    }
}
