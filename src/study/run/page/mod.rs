//! `report.html` of a run: what its files hold, put into sections for whoever reads it first. Nothing is computed that the files do not say.

mod beat;
mod motion;
mod personal;
mod prediction;
mod tracking;
mod wall;
mod words;

pub(super) use beat::{beat_section, key_figures, misfit_figures};
pub(super) use motion::{Colouring, Frames, motion_section, resting_heart};
pub(super) use personal::{personal_sections, told};
pub(super) use prediction::prediction_section;
pub(super) use tracking::tracking_section;
pub(super) use wall::wall_section;

use serde::Serialize;

use super::error::RunError;
use crate::report::html::{Block, KeyFigure, Page, Section, Table, write_page};
use crate::report::remove;
use crate::study::{Plan, Status};

/// What every report opens with, and the record it closes with.
pub(super) struct Account<'a, R: Serialize> {
    pub(super) status: Status,
    /// What was found, a sentence a line.
    pub(super) headlines: &'a [String],
    pub(super) warnings: &'a [String],
    pub(super) key_figures: Vec<KeyFigure>,
    /// What `summary.json` holds.
    pub(super) record: &'a R,
}

/// Writes `report.html` into the folder of a run: the account of it, then its sections; slices and mesh are shown at the frames. Where the
/// plan wants no report, one that an earlier run left is taken away: it would pass for this one's.
pub(super) fn leave_page<R: Serialize>(
    plan: &Plan,
    account: Account<R>,
    sections: Vec<Section>,
    frame_times_s: Vec<f64>,
) -> Result<(), RunError> {
    let file = plan.output.directory.join("report.html");
    if !plan.output.report {
        return Ok(remove(&file)?);
    }
    let mut opening = Vec::new();
    if !account.key_figures.is_empty() {
        opening.push(Block::KeyFigures(account.key_figures));
    }
    if !account.headlines.is_empty() {
        opening.push(Block::List(account.headlines.to_vec()));
    }
    if !account.warnings.is_empty() {
        opening.push(Block::Text("What to keep in mind when reading this:".into()));
        opening.push(Block::Warnings(account.warnings.to_vec()));
    }
    let record = Table::of_record("summary.json", account.record);
    let all = Section {
        title: "All figures".into(),
        blocks: vec![
            Block::Text("The same numbers stand in summary.json and in the CSV files beside this report.".into()),
            Block::Folded("Everything that summary.json says".into(), vec![Block::Table(record)]),
        ],
    };
    let first = Section { title: "In short".into(), blocks: opening };
    let page = Page {
        title: words::title(plan),
        question: words::question(plan).into(),
        status: words::status(plan.kind, account.status),
        sections: std::iter::once(first).chain(sections).chain([all]).collect(),
        frame_times_s,
        provenance: words::provenance(&plan.provenance),
    };
    Ok(write_page(&file, &page)?)
}

/// A section with a table of rows, as a CSV file has them.
pub(super) fn table_section<R: Serialize>(title: &str, caption: &str, rows: &[R]) -> Section {
    let blocks = if rows.is_empty() { Vec::new() } else { vec![Block::Table(Table::of_rows(caption, rows))] };
    Section { title: title.into(), blocks }
}
