//! What can be typed.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use crate::study::Overrides;

/// From cine MRI to a personalised, beating, electromechanical heart.
#[derive(Debug, Parser)]
#[command(name = "cardiotwin", version, after_help = EXIT_CODES)]
pub(super) struct Arguments {
    #[command(subcommand)]
    pub(super) command: Command,
}

const EXIT_CODES: &str = "\
Exit codes: 0 done; 1 a run failed; 2 a study file or an argument is wrong; 130 stopped by Ctrl-C (what was found is written).";

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Run a study and write its results
    Run(RunArguments),
    /// Say what a study would do, or what is wrong with its file
    Check(StudyArguments),
    /// Say what an image shows: grid, spacing, orientation, frames, times, labels, and what is odd about it
    Info(InfoArguments),
    /// List every parameter of the model: name, unit, default, range, meaning, source
    Parameters,
}

#[derive(Debug, Args)]
pub(super) struct RunArguments {
    #[command(flatten)]
    pub(super) study: StudyArguments,
    /// Threads; all cores where absent. Results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) threads: Option<u16>,
    /// Say nothing but warnings, errors and results
    #[arg(short, long)]
    pub(super) quiet: bool,
}

#[derive(Debug, Args)]
pub(super) struct InfoArguments {
    /// A NIfTI file (.nii, .nii.gz) or a folder of DICOM files
    #[arg(value_name = "PATH")]
    pub(super) path: PathBuf,
    /// Trigger times and heart periods beside the image, as images.timing of a study
    #[arg(long, value_name = "JSON")]
    pub(super) timing: Option<PathBuf>,
    /// Print JSON in place of a table
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, Args)]
pub(super) struct StudyArguments {
    /// The study file
    #[arg(value_name = "STUDY.toml")]
    study: PathBuf,
    /// Folder of the results, in place of output.directory
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Folder of the data, in place of the study file's `data`
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Set a key of the study file, such as mechanics.step_s=0.005; may be repeated
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    settings: Vec<String>,
}

impl StudyArguments {
    /// The study file and what the command line changes in it.
    pub(super) fn into_parts(self) -> (PathBuf, Overrides) {
        (self.study, Overrides { data: self.data, output: self.output, settings: self.settings })
    }
}
