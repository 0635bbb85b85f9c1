//! `kind = "simulate"`: the free heart.

use std::time::Instant;

use super::error::RunError;
use super::forward::{beat, heart_model, observables, step_count};
use super::leave::{BeatSummary, Summary, frame_rows, write_beat};
use super::patient::Patient;
use super::pictures;
use crate::mesh::MeshQuality;
use crate::report::write_json;
use crate::study::{Outcome, Plan, RunContext, Status};

#[derive(serde::Serialize)]
struct NoDetails {}

/// Beats the plan's heart and leaves its files.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let patient = Patient::new(plan, context)?;
    let clock = patient.clock(plan.model.beats);
    let model = heart_model(&plan.model, &patient.anatomy, patient.parameters.clone())?;
    context.progress().stage("beating", Some(step_count(&clock, plan.model.step_s)));
    let trajectory = beat(&model, &clock, &[], context)?;
    let status = if trajectory.stopped { Status::Stopped } else { Status::Converged };
    let found = observables(&trajectory, &clock);

    context.progress().stage("writing results", None);
    write_beat(plan, &model, &trajectory, &frame_rows(&clock, &trajectory, None, &[], &[]))?;
    if plan.output.figures {
        pictures::beat(plan, &clock, &trajectory, &[])?;
    }
    let beat = BeatSummary::new(&model, &found);
    let headlines = found.iter().map(|(ventricle, o)| {
        format!(
            "{ventricle:?} ventricle: EDV {:.1} mL, ESV {:.1} mL, EF {:.1} %, peak {:.0} mmHg",
            o.end_diastolic_volume_ml,
            o.end_systolic_volume_ml,
            100.0 * o.ejection_fraction,
            o.pressure_peak_mmhg
        )
    });
    let headlines = headlines.collect();
    let summary = Summary {
        kind: plan.kind,
        status,
        beat,
        details: NoDetails {},
        mesh: MeshQuality::of(&model.anatomy().mesh),
        warnings: &patient.warnings,
        wall_time_s: started.elapsed().as_secs_f64(),
        provenance: &plan.provenance,
    };
    write_json(&plan.output.directory.join("summary.json"), &summary)?;
    context.progress().finish();
    Ok(Outcome { status, directory: plan.output.directory.clone(), headlines })
}
