//! `[output]`: where results go and how much of them.

use std::path::{Component, Path, PathBuf};

use crate::study::Config;
use crate::study::reader::TableReader;

/// Where results go.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputPlan {
    /// `directory`, from the folder of the study file; `-o` replaces it. A folder `results` beside the study file where absent.
    pub directory: PathBuf,
    /// `meshes`: whether the beating mesh is written (`heart.pvd` and its VTU files).
    pub meshes: bool,
    /// `figures`: whether figures are drawn.
    pub figures: bool,
    /// `report`: whether `report.html` is written.
    pub report: bool,
    /// `montage_slices`: slices of the montage.
    pub montage_slices: usize,
    /// `montage_times`: times of the montage.
    pub montage_times: usize,
}

pub(super) fn read(config: &Config, table: TableReader) -> OutputPlan {
    let written = shortened(&config.folder().join(table.text("directory").unwrap_or("results")));
    let plan = OutputPlan {
        directory: config.overrides.output.clone().unwrap_or(written),
        meshes: table.flag("meshes", true),
        figures: table.flag("figures", true),
        report: table.flag("report", true),
        montage_slices: table.count("montage_slices", 1..=12, 3),
        montage_times: table.count("montage_times", 1..=12, 6),
    };
    if plan.directory.is_file() {
        table.problem("directory", format!("names a file: {}", plan.directory.display()), "name a folder, or give one with -o DIR");
    }
    table.close();
    plan
}

/// The path without the folders that it enters only to leave them again.
fn shortened(path: &Path) -> PathBuf {
    let mut short = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir if matches!(short.components().next_back(), Some(Component::Normal(_))) => drop(short.pop()),
            other => short.push(other),
        }
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detours_are_cut_and_the_way_up_is_kept() {
        assert_eq!(shortened(Path::new("studies/01/../../results/01")), Path::new("results/01"));
        assert_eq!(shortened(Path::new("../a/./../../b")), Path::new("../../b"));
    }
}
