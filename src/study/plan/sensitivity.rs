//! `[sensitivity]`: which inputs are moved, over which ranges, by which design, and which figures of the beat are looked at.

use super::images::ImageSource;
use super::personalisation::{FreeParameter, PersonalisationPlan, Regions};
use super::phantom::ModelAnatomy;
use super::words;
use crate::heart::{Parameter, Parameters, Part, RegionalParameter};
use crate::sensitivity::{Design, LocalDesign, MorrisDesign, ScreeningInput, SensitivityError, SobolDesign, Spacing};
use crate::study::Config;
use crate::study::figure::{BEAT_FIGURES, RECOVERED, TRACKING_FIGURES, TRUTH_FIGURES, segment_figure};
use crate::study::identity::document_hash;
use crate::study::reader::{Choice, TableReader};
use crate::study::shard::Shard;

words! {
    /// How the inputs are moved.
    SensitivityMethod {
        /// One at a time by a little, about the study's own values.
        Local = "local",
        /// One at a time by much, from random places.
        Morris = "morris",
        /// All at once, for shares of variance.
        Sobol = "sobol",
    }
}

impl SensitivityPlan {
    /// Whether parameters are found in every run.
    pub fn finds_parameters(&self) -> bool {
        self.outputs.iter().any(|name| name.starts_with(RECOVERED))
    }
}

impl Choice for Spacing {
    const WORDS: &'static [(&'static str, Self)] = &[("linear", Self::Linear), ("logarithmic", Self::Logarithmic)];
}

/// A sensitivity study.
#[derive(Debug, Clone, PartialEq)]
pub struct SensitivityPlan {
    /// `method`.
    pub method: SensitivityMethod,
    /// `seed`: of paths, scrambling and bootstrap.
    pub seed: u64,
    /// `[[sensitivity.input]]`.
    pub inputs: Vec<ScreeningInput>,
    /// `outputs`: figures by their names.
    pub outputs: Vec<String>,
    /// The points at which the heart is run, from `step`, `paths`, `levels`, `rows` and `pairs`.
    pub design: Design,
    /// The part of the runs that is done here; all where none.
    pub shard: Option<Shard>,
    /// Hash of the study file's meaning but for what it writes where.
    pub(in crate::study) document_hash: u64,
}

pub(super) fn read(config: &Config, table: TableReader, parameters: &Parameters) -> Option<SensitivityPlan> {
    let method = table.choice("method", SensitivityMethod::Morris);
    let seed = table.count("seed", 0..=i64::MAX, 1) as u64;
    let step = table.number("step", 1e-6..=0.5, 0.01);
    let (paths, levels) = (table.count("paths", 2..=1_000_000, 10), table.count("levels", 2..=1000, 4));
    let (rows, pairs) = (table.count("rows", 8..=65536, 64), table.flag("pairs", false));
    let inputs: Vec<ScreeningInput> = table.tables("input").into_iter().filter_map(read_input).collect();
    let outputs = table.texts("outputs").unwrap_or_default();
    if !table.is_written() {
        table.close();
        return None;
    }
    if inputs.is_empty() {
        table.missing("input", "[[sensitivity.input]] with name, lower and upper, once for each parameter that is moved");
    }
    for (number, input) in inputs.iter().enumerate() {
        if inputs[..number].iter().any(|other| other.parameter() == input.parameter()) {
            table.problem("input", format!("has {} twice", input.parameter().name()), "take one of the two away");
        }
    }
    check_outputs(&table, &outputs);
    let base: Vec<f64> = inputs.iter().map(|input| parameters[input.parameter()]).collect();
    let design = match method {
        SensitivityMethod::Local => LocalDesign::new(&inputs, &base, step).map(Design::Local),
        SensitivityMethod::Morris => MorrisDesign::new(inputs.len(), paths, levels, seed).map(Design::Morris),
        SensitivityMethod::Sobol => SobolDesign::new(inputs.len(), rows, pairs, seed).map(Design::Sobol),
    };
    let of_method = match method {
        SensitivityMethod::Local => "step",
        SensitivityMethod::Morris => "levels",
        SensitivityMethod::Sobol => "rows",
    };
    let said = |error: SensitivityError| table.problem(of_method, format!("makes no design: {error}"), "choose another value");
    let design = if inputs.is_empty() { None } else { design.map_err(said).ok() };
    table.close();
    Some(SensitivityPlan { method, seed, inputs, outputs, design: design?, shard: None, document_hash: document_hash(config) })
}

fn read_input(table: TableReader) -> Option<ScreeningInput> {
    let name = table.text("name");
    let known = name.and_then(Parameter::from_name);
    match (name, known) {
        (None, _) => table.missing("name", "the name of a parameter, as `cardiotwin parameters` lists them"),
        (Some(_), None) => table.problem("name", "is no parameter", "choose one that `cardiotwin parameters` lists"),
        _ => {}
    }
    let spec = known.map(Parameter::spec);
    let range = spec.map_or(f64::MIN..=f64::MAX, |spec| spec.lower..=spec.upper);
    let (lower, upper) = (table.optional_number("lower", range.clone()), table.optional_number("upper", range));
    for key in ["lower", "upper"].into_iter().filter(|key| !table.has(key)) {
        table.missing(key, "an end of the range over which the parameter is moved");
    }
    let spacing = table.choice("spacing", Spacing::Linear);
    let part = table.text("part");
    let place = known.and_then(|parameter| place_of(&table, parameter, part));
    let input = place.zip(lower.zip(upper)).map(|(place, (lower, upper))| ScreeningInput::new(place, lower, upper, spacing));
    if let Some(Err(error)) = &input {
        table.problem("lower", "makes no range", error.to_string());
    }
    table.close();
    input?.ok()
}

/// The parameter in the `part` named, in the whole heart where none is.
fn place_of(table: &TableReader, parameter: Parameter, part: Option<&str>) -> Option<RegionalParameter> {
    let Some(name) = part else { return Some(parameter.into()) };
    let place = Part::from_name(name).and_then(|part| RegionalParameter::new(parameter, part));
    if place.is_none() {
        let parts: Vec<_> = RegionalParameter::parts_of(parameter).into_iter().map(Part::name).collect();
        let remedy = if parts.is_empty() {
            "take it away: the parameter has one value".into()
        } else {
            format!("choose one of {}", parts.join(", "))
        };
        table.problem("part", format!("is no part in which {} has a value of its own", parameter.spec().name), remedy);
    }
    place
}

fn check_outputs(table: &TableReader, outputs: &[String]) {
    if outputs.is_empty() {
        table.missing("outputs", "the names of figures in brackets, such as [\"ejection_fraction_lv\"]");
    }
    let plain = || [BEAT_FIGURES, TRACKING_FIGURES, TRUTH_FIGURES].into_iter().flatten();
    for (number, name) in outputs.iter().enumerate() {
        if segment_figure(name).is_none() && !name.starts_with(RECOVERED) && !plain().any(|known| known == name) {
            let near = plain().min_by_key(|known| strsim::damerau_levenshtein(name, known)).map_or("", |near| near);
            let remedy = format!("did you mean \"{near}\"? all names are in docs/many_runs.md");
            table.problem("outputs", format!("has \"{name}\", which is no figure of a beat"), remedy);
        }
        if outputs[..number].contains(name) {
            table.problem("outputs", format!("has \"{name}\" twice"), "take one of the two away");
        }
    }
}

/// What the study as a whole must have for its inputs and outputs.
pub(super) fn check(
    root: &TableReader,
    plan: &SensitivityPlan,
    images: Option<&ImageSource>,
    personalisation: Option<&PersonalisationPlan>,
) {
    for name in plan.outputs.iter().filter_map(|name| name.strip_prefix(RECOVERED)) {
        let is_free = |free: &FreeParameter| free.parameter.spec().name == name && free.regions == Regions::Whole && !free.fixed;
        if images.is_none() || !personalisation.is_some_and(|wanted| wanted.parameters.iter().any(is_free)) {
            let remedy = "write images and [personalisation] with that parameter free, in the whole heart";
            root.problem("sensitivity.outputs", format!("has \"{RECOVERED}{name}\", which nothing here finds"), remedy);
        }
    }
    let asks = |names: &[&str]| plan.outputs.iter().find(|name| names.contains(&name.as_str()));
    if let (Some(name), None) = (asks(TRACKING_FIGURES).or(asks(TRUTH_FIGURES)), images) {
        let what = format!("has \"{name}\", which needs images to track");
        root.problem("sensitivity.outputs", what, "write [phantom] or [images], or take it away");
    }
    let has_truth = matches!(images, Some(ImageSource::Phantom(phantom)) if phantom.anatomy == ModelAnatomy::Truth);
    if let (Some(name), Some(_), false) = (asks(TRUTH_FIGURES), images, has_truth) {
        let what = format!("has \"{name}\", which needs a truth to compare with");
        root.problem("sensitivity.outputs", what, "write [phantom] with anatomy = \"truth\", or take it away");
    }
    if images.is_some() && plan.inputs.iter().any(|input| input.parameter() == Parameter::HeartPeriod.into()) {
        root.problem("sensitivity.input", "moves heart_period_s, which the images set", "take it away");
    }
}
