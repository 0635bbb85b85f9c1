//! What each file is, told by its ending and its voxels.

use std::path::{Path, PathBuf};

use super::labels::{LabelledBeat, best_frame, codes_of};
use super::{DraftInputs, InitError, MaskFiles};
use crate::image::{
    CineSequence, CineTiming, HeartCodes, ImageSummary, LabelMap, read_cine_source, read_label_map, read_label_maps, read_nifti, summarise,
};
use crate::mesh::io::read_mesh_file;

/// Everything that is known of the inputs.
#[derive(Debug, Default)]
pub(super) struct Findings {
    pub(super) cine: Option<CineFinding>,
    /// Label maps; the one that the heart is built from comes first.
    pub(super) labels: Vec<LabelFinding>,
    pub(super) masks: Option<MaskFiles>,
    pub(super) timing: Option<PathBuf>,
    pub(super) volumes: Option<PathBuf>,
    pub(super) mesh: Option<MeshFinding>,
    /// Frame of the heart that is drawn, and whether it was looked for.
    pub(super) frame: FrameFinding,
}

/// Which frame of the cine a heart was drawn on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum FrameFinding {
    /// There is no cine, or its times make no beat.
    #[default]
    Unknown,
    /// The user said so.
    Told(usize),
    /// Blood and wall differ most there.
    Fits(usize),
    /// Of labels of every frame, the one of the largest cavity, which is end-diastole.
    Largest(usize),
}

impl FrameFinding {
    /// The frame; the first where nothing is known.
    pub(super) fn frame(self) -> usize {
        match self {
            Self::Unknown => 0,
            Self::Told(frame) | Self::Fits(frame) | Self::Largest(frame) => frame,
        }
    }
}

/// A cine.
#[derive(Debug)]
pub(super) struct CineFinding {
    pub(super) path: PathBuf,
    pub(super) summary: ImageSummary,
    /// None where its times make no beat.
    cine: Option<CineSequence>,
}

/// A label map, of one frame or of every one.
#[derive(Debug)]
pub(super) struct LabelFinding {
    pub(super) path: PathBuf,
    pub(super) codes: DrawnCodes,
    /// The map; of several that at end-diastole.
    map: LabelMap,
    /// The cavity through the beat where there are several.
    pub(super) beat: Option<LabelledBeat>,
    /// Frame of a map of one frame.
    pub(super) frame: Option<usize>,
    cavity_ml: f64,
}

impl LabelFinding {
    /// Whether it has labels of several frames.
    pub(super) fn is_of_every_frame(&self) -> bool {
        self.beat.is_some()
    }
}

/// What the codes of a label map seem to mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DrawnCodes {
    /// Blood alone; a wall has to be grown.
    Blood(u8),
    /// Blood within a wall, and perhaps a right ventricle.
    Heart(HeartCodes),
}

impl DrawnCodes {
    pub(super) fn cavity_lv(self) -> u8 {
        match self {
            Self::Blood(code) => code,
            Self::Heart(codes) => codes.cavity_lv,
        }
    }
}

/// A mesh made elsewhere.
#[derive(Debug)]
pub(super) struct MeshFinding {
    pub(super) path: PathBuf,
    pub(super) tetrahedra: usize,
    pub(super) unit: &'static str,
    pub(super) surface_fields: Vec<String>,
    pub(super) fibre_field: Option<String>,
}

impl Findings {
    pub(super) fn new(inputs: &DraftInputs) -> Result<Self, InitError> {
        let timing = inputs.files.iter().find(|path| ending(path) == "json").cloned();
        let known = timing.as_deref().map(CineTiming::from_sidecar).transpose()?.unwrap_or_default();
        let mut findings = Self { timing, masks: inputs.masks.clone(), ..Self::default() };
        for path in &inputs.files {
            findings.add(path, &known)?;
        }
        findings.check(inputs)?;
        findings.labels.sort_by(|a, b| b.rank().total_cmp(&a.rank()));
        findings.find_frames(inputs.frame)?;
        Ok(findings)
    }

    fn add(&mut self, path: &Path, timing: &CineTiming) -> Result<(), InitError> {
        let two = |what, one: &Path| InitError::Two { what, one: one.into(), other: path.into() };
        match ending(path).as_str() {
            "json" => match &self.timing {
                Some(first) if first != path => Err(two("trigger times", first)),
                _ => Ok(()),
            },
            "csv" => match self.volumes.replace(path.into()) {
                Some(first) => Err(two("volume curves", &first)),
                None => Ok(()),
            },
            "vtu" | "vtk" | "msh" => match self.mesh.replace(mesh_of(path)?) {
                Some(first) => Err(two("meshes", &first.path)),
                None => Ok(()),
            },
            _ if path.is_dir() => self.add_cine(path, timing),
            _ => self.add_image(path, timing),
        }
    }

    fn add_image(&mut self, path: &Path, timing: &CineTiming) -> Result<(), InitError> {
        let image = read_nifti(path)?;
        let summary = ImageSummary::of_frames("", &image.frames, &[]);
        if !summary.labels.is_empty() {
            self.labels.push(labels_of(path)?);
            return Ok(());
        }
        if image.frames.len() > 1 {
            return self.add_cine(path, timing);
        }
        let [low, high] = summary.intensity_range;
        let reason = format!("its one frame is neither a beat nor a label map (values {low} to {high})");
        Err(InitError::Useless { file: path.into(), reason })
    }

    fn add_cine(&mut self, path: &Path, timing: &CineTiming) -> Result<(), InitError> {
        if let Some(first) = &self.cine {
            return Err(InitError::Two { what: "cines", one: first.path.clone(), other: path.into() });
        }
        let summaries = summarise(path, timing)?;
        let slices = |summary: &ImageSummary| summary.shape[2];
        let Some(summary) = summaries.into_iter().rev().max_by_key(slices) else {
            return Err(InitError::Useless { file: path.into(), reason: "it holds no image".into() });
        };
        let cine = read_cine_source(path, timing).ok().map(|reading| reading.cine);
        self.cine = Some(CineFinding { path: path.into(), summary, cine });
        Ok(())
    }

    /// Refuses what makes no study.
    fn check(&self, inputs: &DraftInputs) -> Result<(), InitError> {
        let is_drawn = self.masks.is_some() || !self.labels.is_empty();
        let useless = |file: &Path, reason: &str| Err(InitError::Useless { file: file.into(), reason: reason.into() });
        match (&self.cine, &self.mesh, is_drawn) {
            (_, Some(mesh), true) => useless(&mesh.path, "the heart has one shape; take the mesh or the labels away"),
            (Some(_), Some(mesh), false) => useless(&mesh.path, "images need labels that were drawn on them, in place of a mesh"),
            (Some(cine), None, false) => Err(InitError::NoHeart { cine: cine.path.clone() }),
            (None, None, false) => match inputs.files.first() {
                Some(file) => useless(file, "there is neither a cine nor labels nor a mesh beside it"),
                None => Err(InitError::Nothing),
            },
            (None, _, _) => match self.volumes.as_ref().or(self.timing.as_ref()) {
                Some(file) => useless(file, "there is no cine beside it"),
                None => Ok(()),
            },
            (Some(_), None, true) => Ok(()),
        }
    }

    /// On which frames the heart and the labels that judge it were drawn.
    fn find_frames(&mut self, told: Option<usize>) -> Result<(), InitError> {
        let cine = self.cine.as_ref().and_then(|cine| cine.cine.as_ref());
        let fitting = |blood: &LabelMap, code: Option<u8>| cine.and_then(|cine| best_frame(cine, blood, code));
        for labels in self.labels.iter_mut().filter(|labels| labels.beat.is_none()) {
            labels.frame = fitting(&labels.map, Some(labels.codes.cavity_lv()));
        }
        self.frame = match (told, &self.masks, self.labels.first()) {
            (Some(frame), _, _) => FrameFinding::Told(frame),
            (None, Some(masks), _) => {
                fitting(&read_label_map(&masks.endocardium_lv)?, None).map_or(FrameFinding::Unknown, FrameFinding::Fits)
            }
            (None, None, Some(labels)) => match (&labels.beat, labels.frame) {
                (Some(beat), _) => FrameFinding::Largest(beat.end_diastole()),
                (None, Some(frame)) => FrameFinding::Fits(frame),
                (None, None) => FrameFinding::Unknown,
            },
            (None, None, None) => FrameFinding::Unknown,
        };
        Ok(())
    }
}

impl LabelFinding {
    /// Which of several maps the heart is built from: one with a wall, then the one with the largest cavity.
    fn rank(&self) -> f64 {
        let wall = if matches!(self.codes, DrawnCodes::Heart(_)) { 1e6 } else { 0.0 };
        wall + self.cavity_ml
    }
}

fn ending(path: &Path) -> String {
    path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

fn labels_of(path: &Path) -> Result<LabelFinding, InitError> {
    let useless = |reason: &str| InitError::Useless { file: path.into(), reason: reason.into() };
    let mut maps = read_label_maps(path)?;
    let fullest = maps.iter().max_by_key(|map| map.labels().iter().filter(|&&code| code != 0).count());
    let codes = fullest.and_then(codes_of).ok_or_else(|| useless("its labels are empty"))?;
    let beat = LabelledBeat::new(&maps, codes.cavity_lv());
    let (frame, is_of_every_frame) = (beat.end_diastole(), maps.len() > 1);
    let cavity_ml = beat.volumes_ml.get(frame).copied().ok_or_else(|| useless("it holds no frame"))?;
    let map = maps.swap_remove(frame);
    Ok(LabelFinding { path: path.into(), codes, map, beat: is_of_every_frame.then_some(beat), frame: None, cavity_ml })
}

fn mesh_of(path: &Path) -> Result<MeshFinding, InitError> {
    let file = read_mesh_file(path)?;
    let along = |axis: usize| {
        let range = file.points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[axis]), high.max(p[axis])));
        range.1 - range.0
    };
    let extent = (0..3).map(along).fold(0.0, f64::max);
    let unit = if extent < 1.0 {
        "m"
    } else if extent < 40.0 {
        "cm"
    } else {
        "mm"
    };
    let is_fibre = |name: &&String| name.to_lowercase().starts_with("fib");
    let fibre_field = file.tetrahedron_fields.keys().chain(file.point_fields.keys()).find(is_fibre).cloned();
    let surface_fields = file.triangle_fields.keys().cloned().collect();
    Ok(MeshFinding { path: path.into(), tetrahedra: file.tetrahedra.len(), unit, surface_fields, fibre_field })
}
