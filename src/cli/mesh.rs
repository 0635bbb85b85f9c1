//! `cardiotwin mesh`: the heart at rest from labels, masks or a study, as a mesh with its tags, fibres and regions.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::Context;

use super::arguments::MeshArguments;
use super::exit::Exit;
use super::print;
use super::progress::TerminalProgress;
use crate::study::{Config, Overrides, Plan, Progress, RunContext, StudyError, mesh_heart};

/// Meshes a heart and prints what the mesh is worth.
pub(super) fn make(arguments: MeshArguments) -> anyhow::Result<Exit> {
    let MeshArguments { output, figures, json, talk, .. } = &arguments;
    let (output, figures, json, talk) = (output.clone(), figures.clone(), *json, *talk);
    let plan = plan_of(arguments)?;
    let progress = TerminalProgress::new(talk);
    let report = mesh_heart(&plan, &output, figures.as_deref(), &RunContext::new(&progress, &AtomicBool::new(false)))?;
    for warning in &report.warnings {
        progress.warning(warning);
    }
    if json {
        let text = serde_json::to_string_pretty(&report).context("cannot write the report as JSON")?;
        print(&format!("{text}\n"))?;
    } else {
        let text: String = report.lines().iter().map(|line| format!("{line}\n")).collect();
        print(&format!("{text}the mesh is in {}\n", output.display()))?;
    }
    Ok(Exit::Done)
}

fn plan_of(arguments: MeshArguments) -> Result<Plan, StudyError> {
    let MeshArguments { paths, edge_length_mm, data, mut settings, .. } = arguments;
    settings.extend(edge_length_mm.map(|edge| format!("anatomy.edge_length_mm={edge:?}")));
    let overrides = Overrides { data, output: None, settings };
    let is_study = |path: &PathBuf| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml"));
    match paths.as_slice() {
        [study] if is_study(study) => Plan::new(&Config::read(study, overrides)?),
        drawing => Plan::new(&Config::of_drawing(drawing, overrides)?),
    }
}
