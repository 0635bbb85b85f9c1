//! A study as meant: every value present, in its range and in house units, every file found.

mod anatomy;
mod beats;
mod comparison;
mod images;
mod labels;
mod mesh_file;
mod model;
mod output;
mod personalisation;
mod phantom;
mod prediction;
mod sensitivity;
mod tracking;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

pub use anatomy::{AnatomyPlan, AnatomySource, FibrePlan, IdealisedLv};
pub use beats::{Beats, BeatsPlan};
pub use comparison::ComparisonPlan;
pub use images::{ImageSource, ImagesPlan, ReferenceLabels, VolumeSource};
pub use labels::{LabelSource, LabelsPlan};
pub use mesh_file::{LengthUnit, MeshPlan, MeshSource};
pub use model::{KinematicsPlan, ModelPlan, OnsetPlan, OnsetSite, SitePlan, TimeSchemePlan};
pub use output::OutputPlan;
pub use personalisation::{
    BoundaryData, DataPlan, FreeParameter, Intervals, OrderPlan, PersonalisationPlan, Regions, Tangents, Ties, VolumeData,
};
pub use phantom::{ContractionPlan, ModelAnatomy, PhantomPlan};
pub use prediction::{OWN_ONSET, PredictionPlan};
pub use sensitivity::{SensitivityMethod, SensitivityPlan};
pub use tracking::{BaseMode, GainChoice, TrackingPlan, WallMode};

use super::provenance::Provenance;
use super::reader::{Choice, Reader, TableReader};
use super::{Config, StudyError};
use crate::heart::{Parameters, RegionalParameter, Section};

/// Defines an enum whose values are words of the study file.
macro_rules! words {
    ($(#[$doc:meta])* $name:ident { $($(#[$value_doc:meta])* $value:ident = $word:literal,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
        pub enum $name { $($(#[$value_doc])* #[serde(rename = $word)] $value,)* }

        impl $crate::study::reader::Choice for $name {
            const WORDS: &'static [(&'static str, Self)] = &[$(($word, Self::$value)),*];
        }
    };
}
pub(super) use words;

words! {
    /// What a study does.
    Kind {
        /// The heart at rest alone: its mesh and its contours on the images.
        Mesh = "mesh",
        /// The free heart: beats without data.
        Simulate = "simulate",
        /// The proactive heart follows images with fixed parameters, \[Billet2009\] §4–5.
        Track = "track",
        /// Makes images of a heart and leaves them with their truth, \[Billet2009\] §6.1.
        Phantom = "phantom",
        /// Tracks a synthetic heart by every force scheme, \[Billet2009\] §6.1.
        CompareSchemes = "compare_schemes",
        /// Tracks the same images with a free base, springs and block matching, \[Billet2009\] §6.2.
        CompareBases = "compare_bases",
        /// Tracks, then finds parameters from the motion.
        Personalise = "personalise",
        /// Runs the heart at many points of its parameters: which of them matter.
        Sensitivity = "sensitivity",
        /// Finds the same parameters from the same motion by several solvers.
        CompareSolvers = "compare_solvers",
    }
}

impl Kind {
    /// Whether parameters are sought.
    pub fn finds_parameters(self) -> bool {
        matches!(self, Self::Personalise | Self::CompareSolvers)
    }
}

/// A study, ready to run.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// What it does.
    pub kind: Kind,
    /// The heart at rest.
    pub anatomy: AnatomyPlan,
    /// The images it is compared with; none for a free heart.
    pub images: Option<ImageSource>,
    /// Every parameter of the model: as written, or its default.
    pub parameters: Parameters,
    /// The parameters that the study file writes.
    pub written: BTreeSet<RegionalParameter>,
    /// Time stepping and onset.
    pub model: ModelPlan,
    /// How many beats.
    pub simulation: BeatsPlan,
    /// How images pull on the heart.
    pub tracking: TrackingPlan,
    /// Time steps and gains of [`Kind::CompareSchemes`].
    pub comparison: Option<ComparisonPlan>,
    /// What is to be found; none unless the kind is [`Kind::Personalise`].
    pub personalisation: Option<PersonalisationPlan>,
    /// Which parameters are moved; none unless the kind is [`Kind::Sensitivity`].
    pub sensitivity: Option<SensitivityPlan>,
    /// Onsets that the heart is run with besides its own, with the parameters found or `parameters_from`.
    pub predictions: Vec<PredictionPlan>,
    /// `parameters_from`: the `parameters.csv` of an earlier personalisation, whose findings stand in `parameters`.
    pub parameters_from: Option<PathBuf>,
    /// Where results go.
    pub output: OutputPlan,
    /// What was asked for, for the record.
    pub provenance: Provenance,
}

impl Plan {
    /// Validates a study file whole.
    ///
    /// # Errors
    /// [`StudyError::Invalid`] with everything that is wrong.
    pub fn new(config: &Config) -> Result<Self, StudyError> {
        let reader = Reader::new(config);
        let plan = read(config, &reader);
        let problems = reader.into_problems();
        match plan {
            Some(plan) if problems.is_empty() => Ok(plan),
            _ => Err(StudyError::Invalid { file: config.file().to_path_buf(), problems }),
        }
    }

    /// Every file that the study reads.
    pub fn input_files(&self) -> Vec<PathBuf> {
        let mut files = Vec::new();
        match &self.anatomy.source {
            AnatomySource::Labels(drawn) => files.extend(drawn.source.files().into_iter().map(Path::to_path_buf)),
            AnatomySource::Mesh(mesh) => files.extend(mesh.source.files()),
            AnatomySource::IdealisedLv(_) | AnatomySource::IdealisedBiventricle { .. } => {}
        }
        if let Some(ImageSource::Cine(images)) = &self.images {
            files.push(images.cine.clone());
            files.extend([&images.timing, &images.long_axis, &images.long_axis_timing].into_iter().flatten().cloned());
            match &images.volumes {
                VolumeSource::Labels { path, .. } | VolumeSource::Table(path) => files.push(path.clone()),
                VolumeSource::Images => {}
            }
            files.extend(images.validation.iter().map(|labels| labels.path.clone()));
        }
        files.extend(self.tracking.base_motion.clone());
        files.extend(self.parameters_from.clone());
        files
    }
}

/// Reads all tables; a plan may come out although there are problems, and is then thrown away.
fn read(config: &Config, reader: &Reader) -> Option<Plan> {
    let root = reader.root();
    let kind = root.optional_choice::<Kind>("kind");
    if !root.has("kind") {
        root.missing("kind", &format!("one of {}", Kind::WORDS.iter().map(|(word, _)| *word).collect::<Vec<_>>().join(", ")));
    }
    let data = root.text("data");
    if (data.is_some() || config.overrides.data.is_some()) && !config.data_folder().is_dir() {
        let what = format!("names no folder: {} does not exist", config.data_folder().display());
        root.problem("data", what, "give the folder of the data with --data DIR");
    }
    let mut parameters = Parameters::default();
    let mut written = BTreeSet::new();

    let anatomy = anatomy::read(root.table("anatomy"));
    let phantom = phantom::read(root.table("phantom"));
    let images = images::read(root.table("images"));
    let model = model::read(&root, &mut parameters, &mut written);
    let simulation = beats::read(root.table("simulation"));
    let circulation = root.table(Section::Circulation.key());
    circulation.parameters(Section::Circulation, &mut parameters, &mut written);
    circulation.close();
    let tracking = tracking::read(root.table("tracking"), &mut parameters, &mut written);
    let parameters_from = prediction::read_found(&root, &mut parameters, &mut written);
    let predictions = prediction::read(&root);
    let comparison = comparison::read(root.table("comparison"));
    let personalisation = personalisation::read(root.table("personalisation"), &parameters);
    let sensitivity = sensitivity::read(config, root.table("sensitivity"), &parameters);
    let output = output::read(config, root.table("output"));

    let images = images_of(&root, kind, &anatomy, images, phantom);
    if let Some(ImageSource::Phantom(phantom)) = &images {
        check_tolerances(&root, phantom, personalisation.as_ref());
    }
    if let Some(sensitivity) = &sensitivity {
        sensitivity::check(&root, sensitivity, images.as_ref(), personalisation.as_ref());
    }
    if let Some(wanted) = &personalisation {
        check_truth(&root, images.as_ref(), &wanted.data);
    }
    let follows_images = match kind {
        Some(Kind::Phantom | Kind::Track | Kind::Personalise | Kind::CompareSolvers) => true,
        Some(Kind::Sensitivity) => images.is_some(),
        _ => false,
    };
    if follows_images && matches!(simulation.beats, Beats::Periodic(_)) {
        root.problem("simulation.beats", "needs a heart without images", "write a number of beats");
    }
    if comparison.is_some() && kind != Some(Kind::CompareSchemes) {
        root.problem("comparison", "is of no use here", "write kind = \"compare_schemes\", or take the table away");
    }
    let finds_in_runs = sensitivity.as_ref().is_some_and(SensitivityPlan::finds_parameters);
    match (kind, &personalisation) {
        (Some(Kind::Personalise | Kind::CompareSolvers), None) => {
            root.missing("personalisation", "[personalisation] with a [[personalisation.parameter]] for each free parameter")
        }
        // What was found is used here, and the study that found it may stand as it is.
        (Some(kind), Some(_)) if !kind.finds_parameters() && !finds_in_runs && parameters_from.is_none() => {
            root.problem("personalisation", "is of no use here", "write kind = \"personalise\", or take the table away")
        }
        _ => {}
    }
    match (kind, root.has("sensitivity")) {
        (Some(Kind::Sensitivity), false) => {
            root.missing("sensitivity", "[sensitivity] with outputs and a [[sensitivity.input]] for each parameter that is moved")
        }
        (Some(kind), true) if kind != Kind::Sensitivity => {
            root.problem("sensitivity", "is of no use here", "write kind = \"sensitivity\", or take the table away")
        }
        _ => {}
    }
    if !predictions.is_empty() && !matches!(kind, Some(Kind::Simulate | Kind::Personalise)) {
        root.problem("prediction", "is of no use here", "write kind = \"simulate\" or \"personalise\", or take it away");
    }
    root.close();
    Some(Plan {
        kind: kind?,
        anatomy,
        images,
        parameters,
        written,
        model,
        simulation,
        tracking,
        comparison,
        personalisation,
        sensitivity,
        predictions,
        parameters_from,
        output,
        provenance: Provenance::new(config),
    })
}

/// Exactly one source of images for the kinds that need one.
fn images_of(
    root: &TableReader,
    kind: Option<Kind>,
    anatomy: &AnatomyPlan,
    cine: Option<ImagesPlan>,
    phantom: Option<PhantomPlan>,
) -> Option<ImageSource> {
    let is_lv = matches!(anatomy.source, AnatomySource::IdealisedLv(_));
    let has_labels = matches!(anatomy.source, AnatomySource::Labels(_));
    match (cine, phantom) {
        (Some(_), Some(_)) => {
            root.problem("phantom", "stands beside [images]", "images are either read ([images]) or made ([phantom]): take one away");
            None
        }
        (None, Some(_)) if !anatomy.source.is_idealised() && kind != Some(Kind::Phantom) => {
            let remedy = "write [anatomy.idealised_lv] or [anatomy.idealised_biventricle] as its only shape";
            root.problem("phantom", "needs a heart that is known exactly", remedy);
            None
        }
        (None, Some(phantom)) if phantom.contraction.is_some() && (!is_lv || kind.is_some_and(Kind::finds_parameters)) => {
            let remedy = "write [anatomy.idealised_lv] and kind = \"phantom\" or \"track\", or take the table away";
            root.problem("phantom.contraction", "moves the idealised left ventricle, and has no parameters to be found", remedy);
            None
        }
        (Some(_), None) if kind == Some(Kind::Phantom) => {
            root.problem("images", "are made here", "write [phantom] in place of [images]");
            None
        }
        (Some(_), None) if !has_labels => {
            root.problem("images", "need labels that were drawn on them", "write labels in [anatomy], or [phantom] in place of [images]");
            None
        }
        (Some(_), None) if kind == Some(Kind::CompareSchemes) => {
            root.problem("images", "have no truth to compare with", "write [phantom] in place of [images]");
            None
        }
        (Some(images), None) => Some(ImageSource::Cine(images)),
        (None, Some(phantom)) => Some(ImageSource::Phantom(phantom)),
        (None, None) if kind == Some(Kind::Phantom) => {
            root.missing("phantom", "[phantom], which says how the heart is imaged");
            None
        }
        (None, None)
            if matches!(kind, Some(Kind::Track | Kind::CompareSchemes | Kind::CompareBases | Kind::Personalise | Kind::CompareSolvers)) =>
        {
            root.missing("images", "[images] with a cine, or [phantom] to make one");
            None
        }
        (None, None) => None,
    }
}

/// The truth is known of phantoms alone; its surfaces only where the model has the phantom's mesh.
fn check_truth(root: &TableReader, images: Option<&ImageSource>, data: &DataPlan) {
    let has_truth = matches!(images, Some(ImageSource::Phantom(_)));
    let has_mesh = matches!(images, Some(ImageSource::Phantom(phantom)) if phantom.anatomy == ModelAnatomy::Truth);
    let remedy = "write \"tracked\", or make the images by [phantom]";
    if data.volumes == Some(VolumeData::Truth) && !has_truth {
        root.problem("personalisation.volumes", "has no truth", remedy);
    }
    if data.boundary == BoundaryData::Truth && !has_mesh {
        root.problem("personalisation.boundary", "has no truth on the model's mesh", remedy);
    }
}

/// A tolerance is stated for a parameter that is found.
fn check_tolerances(root: &TableReader, phantom: &PhantomPlan, personalisation: Option<&PersonalisationPlan>) {
    let is_free = |parameter| personalisation.is_some_and(|plan| plan.parameters.iter().any(|free| free.parameter == parameter));
    for (&parameter, _) in phantom.tolerances.iter().filter(|&(&parameter, _)| !is_free(parameter)) {
        let key = format!("phantom.tolerance.{}", parameter.spec().name);
        root.problem(&key, "is stated for a parameter that is not free", "add it as [[personalisation.parameter]], or take it away");
    }
}

#[cfg(test)]
mod tests;
