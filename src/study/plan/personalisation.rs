//! `[personalisation]`: which parameters are free, within what, and what they are fitted to.

use std::path::PathBuf;

use super::words;
use crate::heart::{Parameter, Parameters, RegionalParameter};
use crate::personalisation::SearchMethod;
use crate::study::reader::{Choice, TableReader};

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
        /// Those of the phantom's true heart.
        Truth = "truth",
        /// None.
        None = "none",
    }
}

words! {
    /// The surfaces that parameters are fitted to.
    BoundaryData {
        /// Boundaries that tracking found on the images.
        Tracked = "tracked",
        /// Those of the phantom's true heart.
        Truth = "truth",
        /// None.
        None = "none",
    }
}

words! {
    /// How derivatives of the beat are had.
    Tangents {
        /// The tangent-linear heart: all of them in one pass.
        Analytic = "analytic",
        /// A simulation each.
        FiniteDifferences = "finite_differences",
    }
}

words! {
    /// How alike neighbouring segments are taken to be.
    Ties {
        /// As `neighbour_sd` says, and the data as noisy as their `sigma_` say.
        Written = "written",
        /// Both as the data tell, \[MacKay1992\]; from what is written.
        Evidence = "evidence",
    }
}

words! {
    /// How intervals are had from the residuals that remain.
    Intervals {
        /// Rows of one segment, and rows of one frame, err together, \[Cameron2011\].
        Clusters = "clusters",
        /// Every row errs for itself.
        Residuals = "residuals",
    }
}

impl Choice for SearchMethod {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("gauss_newton", Self::GaussNewton),
        ("nelder_mead", Self::NelderMead),
        ("lbfgs", Self::Lbfgs),
        ("particle_swarm", Self::ParticleSwarm),
        ("cma_es", Self::CmaEs),
    ];
}

/// What parameters are fitted to, each part with the standard deviation that weighs it; a part without one is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct DataPlan {
    /// `volumes`; measured where `images.volumes` is written and this is not.
    pub volumes: Option<VolumeData>,
    /// `sigma_volume_ml`: standard deviation of the left ventricle's volumes.
    pub sigma_volume_ml: f64,
    /// `sigma_volume_rv_ml`: of the right one's; as the left's where they are measured, else left out.
    pub sigma_volume_rv_ml: Option<f64>,
    /// `boundary`.
    pub boundary: BoundaryData,
    /// `sigma_boundary_mm`: standard deviation of the boundary points.
    pub sigma_boundary_mm: f64,
    /// `sigma_base_mm`: standard deviation of the block-matched base's mean position.
    pub sigma_base_mm: Option<f64>,
    /// `pressures`: a table of cavity pressures.
    pub pressures: Option<PathBuf>,
    /// `sigma_pressure_kpa`: their standard deviation.
    pub sigma_pressure_kpa: f64,
    /// `activation_times`: a table of points with their depolarisation times.
    pub activation_times: Option<PathBuf>,
    /// `sigma_activation_s`: their standard deviation.
    pub sigma_activation_s: f64,
}

/// `[[personalisation.order]]`: a parameter that may not exceed another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderPlan {
    /// `smaller`.
    pub smaller: Parameter,
    /// `larger`.
    pub larger: Parameter,
}

/// What is to be found, from what, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct PersonalisationPlan {
    /// `[[personalisation.parameter]]`.
    pub parameters: Vec<FreeParameter>,
    /// `[[personalisation.order]]`.
    pub orders: Vec<OrderPlan>,
    /// `repolarised_margin_s`: the last muscle has repolarised this long before the next beat.
    pub repolarised_margin_s: Option<f64>,
    /// What parameters are fitted to.
    pub data: DataPlan,
    /// `solver`.
    pub solver: SearchMethod,
    /// `ties`: how alike neighbouring segments are.
    pub ties: Ties,
    /// `tangents`; differences where the heart has none.
    pub tangents: Tangents,
    /// `solvers`: of [`super::Kind::CompareSolvers`].
    pub solvers: Vec<SearchMethod>,
    /// `max_iterations`.
    pub max_iterations: usize,
    /// `max_simulations`: the search ends with the iteration that spends them.
    pub max_simulations: usize,
    /// `seed`: of the solvers that draw.
    pub seed: u64,
    /// `tolerance`: the search ends when a step changes no parameter by more than this, relative to its range.
    pub tolerance: f64,
    /// `rounds`: how often images are tracked and parameters found, each time with the heart of the time before and lower gains.
    pub rounds: usize,
    /// `gain_decay`: factor on the image gains from round to round.
    pub gain_decay: f64,
    /// `bias_rounds`: how often the fitted heart's own images are made and tracked, and parameters found again without what that shows of the
    /// tracking's bias.
    pub bias_rounds: usize,
    /// `intervals`: what the residuals are taken to tell.
    pub intervals: Intervals,
    /// `rest_frame`: the image of the end of diastole, at which the heart rests, if it was drawn on another one: tracking carries the mesh there.
    pub rest_frame: Option<usize>,
    /// `retrack`: whether the images are tracked once more with the heart that was found, for its discrepancy.
    pub retrack: bool,
    /// `profile`: parameters whose profile likelihood is drawn.
    pub profile: Vec<Parameter>,
}

pub(super) fn read(table: TableReader, parameters: &Parameters) -> Option<PersonalisationPlan> {
    let free: Vec<_> = table.tables("parameter").into_iter().filter_map(|table| read_parameter(table, parameters)).collect();
    let orders: Vec<_> = table.tables("order").into_iter().filter_map(read_order).collect();
    let solvers = table.words("solvers");
    let profile = read_profile(&table, &free);
    let plan = table.is_written().then(|| PersonalisationPlan {
        orders,
        repolarised_margin_s: table.optional_number("repolarised_margin_s", 0.0..=1.0),
        data: read_data(&table),
        solver: table.choice("solver", SearchMethod::GaussNewton),
        ties: table.choice("ties", Ties::Written),
        tangents: table.choice("tangents", Tangents::Analytic),
        solvers: solvers.unwrap_or_else(|| SearchMethod::WORDS.iter().map(|&(_, method)| method).collect()),
        max_iterations: table.count("max_iterations", 1..=100_000, 12),
        max_simulations: table.count("max_simulations", 1..=10_000_000, 1000),
        seed: table.count("seed", 0..=i64::MAX, 1) as u64,
        tolerance: table.number("tolerance", 1e-8..=0.1, 1e-3),
        rounds: table.count("rounds", 1..=10, 1),
        gain_decay: table.number("gain_decay", 0.01..=1.0, 0.5),
        bias_rounds: table.count("bias_rounds", 0..=20, 0),
        intervals: table.choice("intervals", Intervals::Residuals),
        rest_frame: table.optional_count("rest_frame", 0..=100_000),
        retrack: table.flag("retrack", true),
        profile,
        parameters: free,
    });
    if let Some(plan) = &plan {
        check_parameters(&table, &plan.parameters);
        if plan.ties == Ties::Evidence && plan.parameters.iter().all(|free| free.regions != Regions::AhaSegments) {
            table.problem("ties", "are of segments alone", "write regions = \"aha_segments\" for a parameter, or take it away");
        }
        let of_truth = (plan.data.volumes, plan.data.boundary);
        if of_truth == (Some(VolumeData::None), BoundaryData::None) && plan.data.pressures.is_none() && plan.data.activation_times.is_none()
        {
            table.problem(
                "boundary",
                "leaves nothing to fit to",
                "write volumes or boundary other than \"none\", or name pressures or activation_times",
            );
        }
    }
    table.close();
    plan
}

fn read_data(table: &TableReader) -> DataPlan {
    let data = DataPlan {
        volumes: table.optional_choice("volumes"),
        sigma_volume_ml: table.number("sigma_volume_ml", 0.001..=100.0, 3.0),
        sigma_volume_rv_ml: table.optional_number("sigma_volume_rv_ml", 0.001..=100.0),
        boundary: table.choice("boundary", BoundaryData::Tracked),
        sigma_boundary_mm: table.number("sigma_boundary_mm", 0.001..=50.0, 1.5),
        sigma_base_mm: table.optional_number("sigma_base_mm", 0.001..=50.0),
        pressures: table.data_file("pressures"),
        sigma_pressure_kpa: table.number("sigma_pressure_kpa", 0.001..=50.0, 0.5),
        activation_times: table.data_file("activation_times"),
        sigma_activation_s: table.number("sigma_activation_s", 1e-5..=1.0, 0.005),
    };
    for (key, is_used, of) in [
        ("sigma_pressure_kpa", data.pressures.is_some(), "pressures"),
        ("sigma_activation_s", data.activation_times.is_some(), "activation_times"),
    ] {
        if table.has(key) && !is_used {
            table.problem(key, format!("is of no use without {of}"), format!("write {of}, or take it away"));
        }
    }
    data
}

fn read_order(table: TableReader) -> Option<OrderPlan> {
    let named = |key: &'static str| {
        if !table.has(key) {
            table.missing(key, "the name of a parameter");
        }
        let parameter = Parameter::from_name(table.text(key)?);
        if parameter.is_none() {
            table.problem(key, "is no parameter", "`cardiotwin parameters` lists them");
        }
        parameter
    };
    let order = (named("smaller"), named("larger"));
    table.close();
    Some(OrderPlan { smaller: order.0?, larger: order.1? })
}

/// `profile`: names of free parameters.
fn read_profile(table: &TableReader, free: &[FreeParameter]) -> Vec<Parameter> {
    let names = table.texts("profile").unwrap_or_default();
    let is_free = |parameter: &Parameter| free.iter().any(|one| one.parameter == *parameter && !one.fixed);
    let found: Vec<Option<Parameter>> = names.iter().map(|name| Parameter::from_name(name).filter(is_free)).collect();
    if found.iter().any(Option::is_none) {
        table.problem("profile", "names a parameter that is not free", "name parameters of [[personalisation.parameter]]");
    }
    found.into_iter().flatten().collect()
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
