//! `[personalisation]`: which parameters are free, within what, and what they are fitted to.

use super::words;
use crate::heart::{Parameter, Parameters, RegionalParameter};
use crate::study::reader::TableReader;

words! {
    /// In how many parts of the heart a parameter is found.
    Regions {
        /// One value for the whole heart.
        Whole = "whole",
        /// One for the left ventricle, one for the right, one for scar, as far as the heart has them.
        Ventricles = "ventricles",
        /// One for each AHA segment of the left ventricle.
        AhaSegments = "aha_segments",
    }
}

/// A parameter to be found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeParameter {
    /// `name`.
    pub parameter: Parameter,
    /// `regions`.
    pub regions: Regions,
    /// `neighbour_sd`: standard deviation of the difference between neighbouring segments, relative where the parameter is positive.
    pub neighbour_sd: f64,
    /// `lower`: smallest value; the physical one where absent.
    pub lower: f64,
    /// `upper`: largest value; the physical one where absent.
    pub upper: f64,
    /// `start`: start value; from the data or the model's value where absent.
    pub start: Option<f64>,
    /// `prior_mean`: centre of the prior; the model's value where absent.
    pub prior_mean: f64,
    /// `prior_sd`: its standard deviation, in the parameter's unit; no prior where absent.
    pub prior_sd: Option<f64>,
    /// `fixed`: kept at its start and listed as such.
    pub fixed: bool,
}

words! {
    /// The volume curve that parameters are fitted to.
    VolumeData {
        /// The cavities of the tracked heart.
        Tracked = "tracked",
        /// Measured without the model: `images.volumes`, or the cavity followed on the images.
        Measured = "measured",
    }
}

/// What is to be found.
#[derive(Debug, Clone, PartialEq)]
pub struct PersonalisationPlan {
    /// `[[personalisation.parameter]]`.
    pub parameters: Vec<FreeParameter>,
    /// `volumes`; measured where `images.volumes` is written and this is not.
    pub volumes: Option<VolumeData>,
    /// `sigma_volume_ml`: standard deviation of the measured volumes.
    pub sigma_volume_ml: f64,
    /// `sigma_boundary_mm`: standard deviation of the boundary points.
    pub sigma_boundary_mm: f64,
    /// `max_iterations`: of Gauss–Newton.
    pub max_iterations: usize,
    /// `tolerance`: the search ends when a step changes no parameter by more than this, relative to its range.
    pub tolerance: f64,
}

pub(super) fn read(table: TableReader, parameters: &Parameters) -> Option<PersonalisationPlan> {
    let free: Vec<_> = table.tables("parameter").into_iter().filter_map(|table| read_parameter(table, parameters)).collect();
    let plan = table.is_written().then(|| PersonalisationPlan {
        parameters: free,
        volumes: table.optional_choice("volumes"),
        sigma_volume_ml: table.number("sigma_volume_ml", 0.01..=100.0, 3.0),
        sigma_boundary_mm: table.number("sigma_boundary_mm", 0.01..=50.0, 1.5),
        max_iterations: table.count("max_iterations", 1..=1000, 12),
        tolerance: table.number("tolerance", 1e-8..=0.1, 1e-3),
    });
    if let Some(plan) = &plan {
        check_parameters(&table, &plan.parameters);
    }
    table.close();
    plan
}

fn check_parameters(table: &TableReader, parameters: &[FreeParameter]) {
    if !table.has("parameter") {
        table.missing("parameter", "[[personalisation.parameter]] for each free parameter");
    }
    if !parameters.is_empty() && parameters.iter().all(|one| one.fixed) {
        table.problem("parameter", "leaves nothing to be found: all of them are fixed", "take away `fixed = true` from one");
    }
    for (number, free) in parameters.iter().enumerate() {
        if parameters[..number].iter().any(|other| other.parameter == free.parameter) {
            table.problem(&format!("parameter[{number}].name"), "stands twice", "free each parameter once");
        }
    }
}

fn read_parameter(table: TableReader, parameters: &Parameters) -> Option<FreeParameter> {
    if !table.has("name") {
        table.missing("name", "the name of a parameter; `cardiotwin parameters` lists them");
    }
    let name = table.text("name");
    let parameter = name.and_then(Parameter::from_name);
    if let (Some(name), None) = (name, parameter) {
        let near = Parameter::ALL.iter().map(|p| (strsim::damerau_levenshtein(name, p.spec().name), p.spec().name)).min();
        let remedy = near.map_or(String::new(), |(_, near)| format!("did you mean \"{near}\"? "));
        table.problem("name", "is no parameter", format!("{remedy}`cardiotwin parameters` lists them"));
    }
    let (lowest, highest) = parameter.map_or((f64::MIN, f64::MAX), |p| (p.spec().lower, p.spec().upper));
    let lower = table.number("lower", lowest..=highest, lowest);
    let upper = table.number("upper", lowest..=highest, highest);
    if lower >= upper {
        table.problem("lower", "is not below upper", format!("choose less than {upper}"));
    }
    let inside = lower..=upper.max(lower);
    let model = parameter.map_or(lower, |p| parameters[p]);
    let free = FreeParameter {
        parameter: parameter.unwrap_or(Parameter::ALL[0]),
        regions: table.choice("regions", Regions::Whole),
        neighbour_sd: table.number("neighbour_sd", 1e-6..=1e6, 0.3),
        lower,
        upper,
        start: table.optional_number("start", inside),
        prior_mean: table.number("prior_mean", lowest..=highest, model),
        prior_sd: table.optional_number("prior_sd", 1e-12..=1e12),
        fixed: table.flag("fixed", false),
    };
    check_regions(&table, &free, parameter);
    table.close();
    parameter.map(|_| free)
}

fn check_regions(table: &TableReader, free: &FreeParameter, parameter: Option<Parameter>) {
    let parts = parameter.map(RegionalParameter::parts_of).unwrap_or_default();
    let is_possible = match free.regions {
        Regions::Whole => true,
        Regions::Ventricles => parts.contains(&crate::heart::Part::Scar),
        Regions::AhaSegments => !parts.is_empty(),
    };
    if !is_possible && parameter.is_some() {
        table.problem("regions", "is not for this parameter", "docs/study_file.md says which parameters have values by region");
    }
    if table.has("neighbour_sd") && free.regions != Regions::AhaSegments {
        table.problem("neighbour_sd", "is of segments alone", "write regions = \"aha_segments\", or take it away");
    }
}
