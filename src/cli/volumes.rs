//! `cardiotwin volumes`: the volume curve of a study's images, of labels of every frame, or of a table.

use std::path::PathBuf;

use super::arguments::VolumesArguments;
use super::exit::Exit;
use super::print;
use crate::image::ImageError;
use crate::study::{Config, CurveSource, Overrides, Plan, measure_volumes};

/// Measures a volume curve, leaves its files and prints its landmarks.
pub(super) fn measure(arguments: VolumesArguments) -> anyhow::Result<Exit> {
    let (source, folder) = source_of(arguments)?;
    let lines = measure_volumes(&source, &folder)?;
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    print(&format!("{text}results are in {}\n", folder.display()))?;
    Ok(Exit::Done)
}

fn source_of(arguments: VolumesArguments) -> anyhow::Result<(CurveSource, PathBuf)> {
    let VolumesArguments { path, output, data, settings, timing, code, code_right, slices, period_s } = arguments;
    let folder = output.clone().unwrap_or_else(|| "volumes".into());
    let has_ending = |ending: &str| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending));
    if has_ending("toml") {
        let plan = Plan::new(&Config::read(&path, Overrides { data, output: output.clone(), settings })?)?;
        let folder = output.unwrap_or_else(|| plan.output.directory.clone());
        return Ok((CurveSource::Study(Box::new(plan)), folder));
    }
    if has_ending("csv") {
        let Some(period_s) = period_s else {
            return Err(ImageError::Unusable { path, reason: "its heart period is not known; give --period-s".into() }.into());
        };
        return Ok((CurveSource::Table { path, period_s }, folder));
    }
    let slices = slices.map(|ends| ends[0]..ends[1] + 1);
    Ok((CurveSource::Labels { path, timing, code, code_right, slices }, folder))
}
