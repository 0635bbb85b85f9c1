//! The image gains of a run: as written, or chosen from the images, for all surfaces at once or one surface after the other.

use nalgebra::Vector3;

use super::error::RunError;
use super::patient::PatientImages;
use super::track::{held_out_rms_mm, tracked_beat};
use crate::heart::{HeartModel, Parameter, Parameters};
use crate::mechanics::{ExplicitSpring, TimeScheme, explicit_spring_limit};
use crate::mesh::SurfaceTag;
use crate::personalisation::{GainChoice, GainSearch};
use crate::study::RunContext;
use crate::study::plan::GainChoice as Wanted;
use crate::tracking::{ForceScheme, TrackedMotion, TrackerSettings};

/// Gains that were chosen together: the same factor on what the study writes.
pub(super) struct ChosenGains {
    pub(super) gains: Vec<Parameter>,
    /// Factor, with everything that was tried.
    pub(super) choice: GainChoice,
}

/// The gains of the surfaces.
pub(super) const GAINS: [Parameter; 3] =
    [Parameter::ImageGainEndocardiumLv, Parameter::ImageGainEndocardiumRv, Parameter::ImageGainEpicardium];
/// Factors on the written gains between which the data choose.
pub(super) const GAIN_FACTORS: GainSearch = GainSearch { lower: 0.25, upper: 4.0, scan_count: 3, tolerance_decades: 0.6 };
/// The same for the discrepancy principle, which may want gains far from the written ones.
const DISCREPANCY_FACTORS: GainSearch = GainSearch { lower: 0.02, upper: 10.0, scan_count: 3, tolerance_decades: 0.05 };
/// Of the bound of explicit forces, what is left to a surface whose neighbours already use it up.
const LEAST_LEFT: f64 = 1e-3;
/// The held-out error may be this much larger than the least for a smaller gain, which leaves more to the model.
const HELD_OUT_SLACK: f64 = 1.1;

/// What gains are tried on.
pub(super) struct Trial<'a> {
    pub(super) images: &'a PatientImages,
    pub(super) settings: &'a TrackerSettings,
    pub(super) context: &'a RunContext<'a>,
}

/// The heart with the gains that the study wants, and what was tried for them. An unstable gain fails its trial and is not chosen.
pub(super) fn choose_gains(
    model: HeartModel,
    wanted: Wanted,
    noise_mm: f64,
    trial: &Trial,
) -> Result<(HeartModel, Vec<ChosenGains>), RunError> {
    if wanted != Wanted::Written {
        trial.context.progress().stage("choosing the image gains", None);
    }
    let has_right = model.anatomy().cavities.len() > 1;
    let all: Vec<Parameter> = GAINS.into_iter().filter(|&gain| has_right || gain != Parameter::ImageGainEndocardiumRv).collect();
    let groups: Vec<Vec<Parameter>> = match wanted {
        Wanted::Written => Vec::new(),
        Wanted::HeldOut | Wanted::Discrepancy => vec![all],
        Wanted::HeldOutBySurface => all.into_iter().map(|gain| vec![gain]).collect(),
    };
    let (mut model, mut chosen) = (model, Vec::new());
    for gains in groups {
        let choice = trial.choose(&model, &gains, wanted, noise_mm)?;
        model = model.with_parameters(scaled(model.parameters(), &gains, choice.gain)?)?;
        chosen.push(ChosenGains { gains, choice });
    }
    Ok((model, chosen))
}

impl Trial<'_> {
    /// The factor on some gains beyond which explicit forces are unstable on the heart at rest, all other gains as they are: what they
    /// leave of the bound. No other scheme has one.
    fn stable_factor(&self, model: &HeartModel, gains: &[Parameter]) -> Result<f64, RunError> {
        let is_euler = model.settings().time_scheme == TimeScheme::BackwardEuler;
        if self.settings.scheme != ForceScheme::Explicit || !is_euler {
            return Ok(f64::INFINITY);
        }
        let (surface, rest_mm) = (&model.anatomy().surface, model.tissue().rest_mm());
        let of = |gain: Parameter| {
            let areas_mm2 = surface.vertex_area_vectors_mm2(surface_of(gain), rest_mm);
            let gain_kpa_per_mm = model.parameters()[gain];
            let spring = move |(vertex, area_mm2): (usize, Vector3<f64>)| {
                let stiffness_mn_per_mm = 2.0 * gain_kpa_per_mm * area_mm2.norm();
                let direction = area_mm2.try_normalize(0.0)?;
                (stiffness_mn_per_mm > 0.0).then_some(ExplicitSpring { vertex, direction, stiffness_mn_per_mm })
            };
            areas_mm2.into_iter().enumerate().filter_map(spring).collect::<Vec<_>>()
        };
        let limit = |gains: &[Parameter]| -> Result<f64, RunError> {
            let springs: Vec<_> = gains.iter().flat_map(|&gain| of(gain)).collect();
            Ok(explicit_spring_limit(model.tissue(), model.settings().step_s, &springs)?)
        };
        let others: Vec<Parameter> = GAINS.into_iter().filter(|gain| !gains.contains(gain)).collect();
        let left = if others.is_empty() { 1.0 } else { (1.0 - 1.0 / limit(&others)?).max(LEAST_LEFT) };
        Ok(left * limit(gains)?)
    }

    /// One factor on some gains: the smallest that meets the boundary points that pull on nothing nearly as well as the best one, or that
    /// which leaves the points that do pull as far away as their noise.
    fn choose(&self, model: &HeartModel, gains: &[Parameter], wanted: Wanted, noise_mm: f64) -> Result<GainChoice, RunError> {
        let mut stopped = false;
        let judge = if wanted == Wanted::Discrepancy { boundary_rms_mm } else { held_out_rms_mm };
        let error_mm = |factor: f64| {
            let attempt = || -> Result<f64, RunError> {
                let model = model.with_parameters(scaled(model.parameters(), gains, factor)?)?;
                Ok(judge(&tracked_beat(&model, self.images, self.settings, self.context)?))
            };
            let found = attempt();
            stopped |= matches!(found, Err(RunError::Stopped));
            found.ok()
        };
        let limit = self.stable_factor(model, gains)?;
        let search = below(if wanted == Wanted::Discrepancy { DISCREPANCY_FACTORS } else { GAIN_FACTORS }, limit);
        let choice = match wanted {
            Wanted::Discrepancy => search.by_discrepancy(noise_mm, error_mm),
            _ => search.by_held_out(error_mm),
        };
        if stopped {
            return Err(RunError::Stopped);
        }
        let choice = choice?;
        Ok(if wanted == Wanted::Discrepancy { choice } else { smallest_of_the_good(choice, search) })
    }
}

/// The range up to a factor that is stable; a little below it, as the surfaces turn and stretch.
fn below(search: GainSearch, limit: f64) -> GainSearch {
    const MARGIN: f64 = 0.8;
    let upper = search.upper.min(MARGIN * limit);
    GainSearch { upper, lower: search.lower.min(upper * search.lower / search.upper), ..search }
}

fn smallest_of_the_good(mut choice: GainChoice, search: GainSearch) -> GainChoice {
    let good_enough = choice.evaluations.iter().filter(|tried| tried.residual_rms <= HELD_OUT_SLACK * choice.residual_rms);
    if let Some(smallest) = good_enough.min_by(|a, b| a.gain.total_cmp(&b.gain)).copied() {
        let is_end = |end: f64| (smallest.gain / end).ln().abs() < 1e-9;
        (choice.gain, choice.residual_rms) = (smallest.gain, smallest.residual_rms);
        choice.at_edge = is_end(search.lower) || is_end(search.upper);
    }
    choice
}

/// The surface whose gain a parameter is.
fn surface_of(gain: Parameter) -> SurfaceTag {
    match gain {
        Parameter::ImageGainEndocardiumLv => SurfaceTag::EndocardiumLv,
        Parameter::ImageGainEndocardiumRv => SurfaceTag::EndocardiumRv,
        _ => SurfaceTag::Epicardium,
    }
}

/// Some gains times `factor`.
fn scaled(parameters: &Parameters, gains: &[Parameter], factor: f64) -> Result<Parameters, RunError> {
    let mut scaled = parameters.clone();
    for &gain in gains {
        scaled.set(gain, parameters[gain] * factor)?;
    }
    Ok(scaled)
}

/// All image gains of endocardia and epicardium times `factor`.
pub(super) fn scaled_gains(parameters: &Parameters, factor: f64) -> Result<Parameters, RunError> {
    scaled(parameters, &GAINS, factor)
}

/// Root mean square distance of the points that pull, of all surfaces over all frames, mm.
pub(super) fn boundary_rms_mm(motion: &TrackedMotion) -> f64 {
    let values: Vec<f64> = motion.frames.iter().flat_map(|frame| frame.residuals.iter().map(|residual| residual.rms_mm)).collect();
    crate::numerics::root_mean_square(&values)
}
