//! What can be typed.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use crate::study::{Overrides, Shard};

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
    /// Run one study for every patient of a table, side by side
    Cohort(CohortArguments),
    /// Gather what the parts of a sensitivity study or a cohort left (--shard) and read the whole; to do it again changes nothing
    Merge(StudyArguments),
    /// Write a commented study file for your images, label maps, masks or mesh
    Init(InitArguments),
    /// Say what a study would do, or what is wrong with its file
    Check(StudyArguments),
    /// Print the references of what a study uses, as BibTeX
    Cite(StudyArguments),
    /// Say what an image shows: grid, spacing, orientation, frames, times, labels, and what is odd about it
    Info(InfoArguments),
    /// Mesh the heart of a study, of a label map or of masks, and say what the mesh is worth
    Mesh(MeshArguments),
    /// Measure the volume curve of the left ventricle: end-diastole, end-systole, diastasis, ejection fraction
    Volumes(VolumesArguments),
    /// Move points with the heart of a finished run and write their paths
    Follow(FollowArguments),
    /// List every parameter of the model: name, unit, default, range, meaning, source
    Parameters,
    /// Print the completions of a shell: commands and options at the press of a key
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

impl Command {
    /// What this command says on stderr while it works; the usual where it has no say in that.
    pub(super) fn talk(&self) -> TalkArguments {
        match self {
            Self::Run(RunArguments { talk, .. }) | Self::Cohort(CohortArguments { talk, .. }) | Self::Mesh(MeshArguments { talk, .. }) => {
                *talk
            }
            _ => TalkArguments::default(),
        }
    }
}

/// What is said on stderr while the program works.
#[derive(Debug, Clone, Copy, Default, Args)]
pub(super) struct TalkArguments {
    /// Say nothing but warnings and errors
    #[arg(short, long, conflicts_with_all = ["verbose", "json_progress"])]
    pub(super) quiet: bool,
    /// Say first what will be done, and every ten seconds how far it is
    #[arg(short, long, conflicts_with = "json_progress")]
    pub(super) verbose: bool,
    /// Say everything as JSON on stderr, an object a line: stage, done, total, eta_s; warnings and errors too
    #[arg(long)]
    pub(super) json_progress: bool,
}

#[derive(Debug, Args)]
pub(super) struct InitArguments {
    /// Files in any order, told apart by what they hold: a cine (4D NIfTI or a folder of DICOM files), label maps (NIfTI, of one frame or of
    /// every frame), trigger times (.json), a volume curve (.csv); or a mesh alone (.vtu, .vtk, .msh)
    #[arg(value_name = "FILE")]
    pub(super) files: Vec<PathBuf>,
    /// In place of a label map: the mask of what the epicardium encloses
    #[arg(long, value_name = "MASK", requires = "endocardium_lv")]
    pub(super) epicardium: Option<PathBuf>,
    /// … the mask of the left ventricle's blood
    #[arg(long, value_name = "MASK", requires = "epicardium")]
    pub(super) endocardium_lv: Option<PathBuf>,
    /// … the mask of the right ventricle's blood
    #[arg(long, value_name = "MASK", requires = "epicardium")]
    pub(super) endocardium_rv: Option<PathBuf>,
    /// Frame of the cine that the labels were drawn on, from 0; looked for on the images where absent
    #[arg(long, value_name = "N")]
    pub(super) frame: Option<usize>,
    /// The study file to be written
    #[arg(short, long, value_name = "FILE", default_value = "study.toml")]
    pub(super) output: PathBuf,
    /// Write over a study file that is there already
    #[arg(long)]
    pub(super) force: bool,
}

#[derive(Debug, Args)]
pub(super) struct RunArguments {
    #[command(flatten)]
    pub(super) study: StudyArguments,
    /// Threads; all cores where absent. Results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) threads: Option<u16>,
    /// Of a sensitivity study: do the i-th of n parts of its runs alone, as one of several jobs
    #[arg(long, value_name = "I/N")]
    pub(super) shard: Option<Shard>,
    #[command(flatten)]
    pub(super) talk: TalkArguments,
}

#[derive(Debug, Args)]
pub(super) struct CohortArguments {
    /// The cohort file
    #[arg(value_name = "COHORT.toml")]
    pub(super) file: PathBuf,
    /// Folder of the results, in place of `directory`
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Threads; all cores where absent. Results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) threads: Option<u16>,
    /// Run the i-th of n parts of the patients alone, as one of several jobs
    #[arg(long, value_name = "I/N")]
    pub(super) shard: Option<Shard>,
    #[command(flatten)]
    pub(super) talk: TalkArguments,
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
pub(super) struct MeshArguments {
    /// A study file; a label map (NIfTI: 1 LV cavity, 2 wall, others by --set); or the masks of epicardium, left endocardium and, if there is
    /// one, right endocardium
    #[arg(value_name = "STUDY.toml|LABELS|MASK", required = true, num_args = 1..=3)]
    pub(super) paths: Vec<PathBuf>,
    /// The mesh: .vtu, .vtk or .msh
    #[arg(short, long, value_name = "FILE", default_value = "heart.vtu")]
    pub(super) output: PathBuf,
    /// Length of a tetrahedron's edge, mm; anatomy.edge_length_mm of the study where absent
    #[arg(long, value_name = "MM")]
    pub(super) edge_length_mm: Option<f64>,
    /// Of a study with images: draw the mesh's contours on their slices into this folder
    #[arg(long, value_name = "DIR")]
    pub(super) figures: Option<PathBuf>,
    /// Folder of the data, in place of the study file's `data`
    #[arg(long, value_name = "DIR")]
    pub(super) data: Option<PathBuf>,
    /// Set a key of the study, such as anatomy.code_cavity_rv=3; may be repeated
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    pub(super) settings: Vec<String>,
    /// Print JSON in place of a table
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    pub(super) talk: TalkArguments,
}

#[derive(Debug, Args)]
pub(super) struct VolumesArguments {
    /// A study file, a label map of every frame (4D NIfTI), or a CSV file with time_s and volume_lv_ml
    #[arg(value_name = "STUDY.toml|PATH")]
    pub(super) path: PathBuf,
    /// Folder of the results; that of the study, or `volumes`, where absent
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Of a study: folder of the data
    #[arg(long, value_name = "DIR")]
    pub(super) data: Option<PathBuf>,
    /// Of a study: set a key, as in `run`
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    pub(super) settings: Vec<String>,
    /// Of a label map: trigger times and heart periods, as images.timing of a study
    #[arg(long, value_name = "JSON")]
    pub(super) timing: Option<PathBuf>,
    /// Of a label map: code of the cavity
    #[arg(long, value_name = "CODE", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    pub(super) code: u8,
    /// Of a label map: code of the right cavity, whose curve is then found too
    #[arg(long, value_name = "CODE", value_parser = clap::value_parser!(u8).range(1..))]
    pub(super) code_right: Option<u8>,
    /// Of a label map: first and last slice that count, from 0
    #[arg(long, value_name = "FIRST..LAST", value_parser = slice_range)]
    pub(super) slices: Option<[usize; 2]>,
    /// Of a CSV file: heart period
    #[arg(long, value_name = "S")]
    pub(super) period_s: Option<f64>,
}

/// `3..10` as first and last.
fn slice_range(text: &str) -> Result<[usize; 2], String> {
    let ends = text.split_once("..").and_then(|(first, last)| Some([first.parse().ok()?, last.parse().ok()?]));
    ends.filter(|[first, last]: &[usize; 2]| first <= last && *last < usize::MAX)
        .ok_or_else(|| "write two whole numbers, such as 3..10".to_string())
}

#[derive(Debug, Args)]
pub(super) struct FollowArguments {
    /// Folder of a run that wrote its meshes; paths.csv is written there
    #[arg(value_name = "DIR")]
    pub(super) folder: PathBuf,
    /// CSV file with the columns point, x_mm, y_mm, z_mm: world coordinates (RAS)
    #[arg(long, value_name = "FILE")]
    pub(super) points: PathBuf,
    /// Frame of the cine that the points were drawn on; the one that the run starts from where absent
    #[arg(long, value_name = "N")]
    pub(super) frame: Option<usize>,
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
