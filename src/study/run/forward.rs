//! Free beats: the plan's heart put together, run over its clock, and read off.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::clock::Clock;
use super::error::RunError;
use crate::anatomy::{Anatomy, Ventricle};
use crate::heart::{
    BeatDeformation, BeatObservables, ExtraStimulus, HeartModel, ModelSettings, OnsetSites, Parameters, SimulationPlan, Trajectory,
    simulate,
};
use crate::mechanics::{Kinematics, StepLoad};
use crate::study::RunContext;
use crate::study::plan::{KinematicsPlan, ModelPlan, OnsetPlan, OnsetSite, SitePlan};

/// The heart of a plan on an anatomy.
pub(super) fn heart_model(plan: &ModelPlan, anatomy: &Arc<Anatomy>, parameters: Parameters) -> Result<HeartModel, RunError> {
    let (onset_sites, extra_stimuli) = (onset_sites(&plan.onset), extra_stimuli(&plan.onset.sites));
    let kinematics = match plan.kinematics {
        KinematicsPlan::Linear => Kinematics::Linear,
        KinematicsPlan::Corotational => Kinematics::Corotational,
    };
    let &ModelPlan { step_s, time_scheme, .. } = plan;
    let settings = ModelSettings { step_s, time_scheme, kinematics, onset_sites, extra_stimuli, ..ModelSettings::default() };
    Ok(HeartModel::new(Arc::clone(anatomy), parameters, settings)?)
}

fn onset_sites(plan: &OnsetPlan) -> OnsetSites {
    let of_every_beat = plan.sites.iter().filter(|site| site.beat.is_none());
    let leads: Vec<_> = of_every_beat.map(|site| (site.position_mm, site.delay_s)).collect();
    let own = match plan.place {
        OnsetSite::Normal => OnsetSites::Normal,
        OnsetSite::LeftBundleBranchBlock => OnsetSites::LeftBundleBranchBlock,
        OnsetSite::RightApicalPacing => OnsetSites::RightApicalPacing,
        OnsetSite::BiventricularPacing => OnsetSites::BiventricularPacing,
        OnsetSite::Endocardium => OnsetSites::Endocardium,
        OnsetSite::Sites => return OnsetSites::Points(leads),
    };
    if leads.is_empty() { own } else { OnsetSites::Together(vec![own, OnsetSites::Points(leads)]) }
}

fn extra_stimuli(sites: &[SitePlan]) -> Vec<ExtraStimulus> {
    let extra =
        |site: &SitePlan| Some(ExtraStimulus { point_mm: site.position_mm, beat: site.beat?.saturating_sub(1), delay_s: site.delay_s });
    sites.iter().filter_map(extra).collect()
}

/// What is to be said of extra stimuli that come to nothing.
pub(super) fn blocked_stimuli(model: &HeartModel) -> Vec<String> {
    let words = |&stimulus: &usize| {
        let ExtraStimulus { beat, delay_s, .. } = model.settings().extra_stimuli.get(stimulus)?;
        Some(format!("the site of beat {}, {delay_s} s after its onset, finds refractory tissue and does nothing", beat + 1))
    };
    model.rhythm().blocked_stimuli().iter().filter_map(words).collect()
}

/// Beats `model` over `clock` under `loads`, telling how far it is and stopping when asked.
pub(super) fn beat(model: &HeartModel, clock: &Clock, loads: &[&dyn StepLoad], context: &RunContext) -> Result<Trajectory, RunError> {
    let plan = SimulationPlan { start_time_s: clock.start_s, end_time_s: clock.end_s, frame_times_s: clock.times_s.clone() };
    let mut done = 0;
    let mut observer = |_: &_, _: &_| {
        context.progress().step(done);
        done += 1;
        if context.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    Ok(simulate(model, &plan, loads, &mut observer)?)
}

/// Steps of a run over `clock`, for a progress bar.
pub(super) fn step_count(clock: &Clock, step_s: f64) -> u64 {
    ((clock.end_s - clock.start_s) / step_s).ceil().max(0.0) as u64
}

/// The last beat of a trajectory in figures, a ventricle each.
pub(super) fn observables(trajectory: &Trajectory, clock: &Clock) -> Vec<(Ventricle, BeatObservables)> {
    let of =
        |ventricle| BeatObservables::of_beat(&trajectory.curves, ventricle, clock.last_beat_s(), clock.period_s).map(|o| (ventricle, o));
    [Ventricle::Left, Ventricle::Right].into_iter().filter_map(of).collect()
}

/// What the wall does in the last beat of a trajectory; none without frames.
pub(super) fn deformation(model: &HeartModel, trajectory: &Trajectory, clock: &Clock) -> Option<BeatDeformation> {
    BeatDeformation::of_beat(model.anatomy(), &trajectory.frames, &trajectory.curves, clock.last_beat_s(), clock.period_s)
}

/// Volumes of the left ventricle at the frames, mL.
pub(super) fn frame_volumes_lv_ml(trajectory: &Trajectory) -> Vec<f64> {
    trajectory.frames.iter().filter_map(|frame| frame.volume_ml.first().copied()).collect()
}
