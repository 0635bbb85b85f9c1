//! One run of a design: a free beat, or a tracked one where there are images, with other parameters; its figures, or how far it came.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use super::RunError;
use super::figures::{Figures, TrackingFigures};
use super::recovered::recovered;
use crate::circulation::Phase;
use crate::heart::{CurveRow, HeartModel, Parameter, Parameters, SimulationPlan, Trajectory, simulate, simulate_until_periodic};
use crate::sensitivity::to_parameters;
use crate::study::plan::{Beats, GainChoice, SensitivityPlan};
use crate::study::run::clock::Clock;
use crate::study::run::forward::heart_model;
use crate::study::run::leave::BeatSummary;
use crate::study::run::patient::Patient;
use crate::study::run::recorded_base::with_recorded_base;
use crate::study::run::track::{Tracked, tracker_settings};
use crate::study::{Plan, RunContext, Status};
use crate::tracking::{TrackerSettings, track};

/// What all runs share.
pub(super) struct Evaluator<'p> {
    plan: &'p Plan,
    wanted: &'p SensitivityPlan,
    patient: Patient,
    base: HeartModel,
    tracker: Option<TrackerSettings>,
}

/// A beat that was completed.
struct Beat {
    figures: Figures,
    status: Status,
    trajectory: Trajectory,
}

/// Where a run stood when it was last seen.
#[derive(Default)]
struct Reached {
    time_s: Option<f64>,
    phase: Option<Phase>,
}

impl<'p> Evaluator<'p> {
    /// The patient and the heart with the study's own parameters.
    pub(super) fn new(plan: &'p Plan, wanted: &'p SensitivityPlan, context: &RunContext) -> Result<Self, RunError> {
        let patient = Patient::new(plan, context)?;
        let base = with_recorded_base(plan, heart_model(&plan.model, &patient.anatomy, patient.parameters.clone())?)?;
        if plan.tracking.gains == GainChoice::HeldOut {
            context.progress().warning("the gains are those written: they are not chosen anew in every run");
        }
        let tracker = patient.images.as_ref().map(|images| tracker_settings(plan, &patient, images)).transpose()?;
        Ok(Self { plan, wanted, patient, base, tracker })
    }

    /// The fields of a row; none if it was stopped.
    pub(super) fn fields(&self, run: usize, stop: &AtomicBool) -> Option<Vec<String>> {
        let place = &self.wanted.design.points()[run];
        let mut reached = Reached::default();
        let beat = self.beat(place, &mut reached, stop);
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        let number = |value: f64| format!("{value:?}");
        let mut fields = vec![run.to_string()];
        fields.extend(self.wanted.inputs.iter().zip(place).map(|(input, &place)| number(input.value(place))));
        let outputs = self.wanted.outputs.iter().map(|name| beat.as_ref().ok()?.figures.value(name));
        fields.extend(outputs.map(|value| value.filter(|value| value.is_finite()).map(number).unwrap_or_default()));
        let phase = reached.phase.map_or("", Phase::name).to_string();
        let time = reached.time_s.map(number).unwrap_or_default();
        fields.extend(match beat {
            Ok(Beat { status, trajectory, .. }) => {
                let work = [trajectory.round_count.to_string(), number(trajectory.volume_defect_ml)];
                [status.word().to_string(), phase, time].into_iter().chain(work).chain([String::new()]).collect::<Vec<_>>()
            }
            Err(error) => vec![Status::Failed.word().into(), phase, time, String::new(), String::new(), one_line(&error)],
        });
        Some(fields)
    }

    fn beat(&self, place: &[f64], reached: &mut Reached, stop: &AtomicBool) -> Result<Beat, RunError> {
        let parameters = to_parameters(&self.patient.parameters, &self.wanted.inputs, place)?;
        let clock = self.clock(&parameters);
        let model = self.base.with_parameters(parameters)?;
        let mut observer = |_: &_, row: &CurveRow| {
            *reached = Reached { time_s: Some(row.time_s), phase: row.phase_lv.or(row.phase_rv) };
            if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        if let (Some(images), Some(tracker)) = (&self.patient.images, &self.tracker) {
            let motion = track(&model, &images.cine, tracker, &mut observer)?;
            let tracked = TrackingFigures::new(&motion, self.patient.truth.as_ref());
            let beat = BeatSummary::new(&model, &motion.trajectory, &clock);
            let mut figures = Figures::new(&model, &beat, &motion.trajectory, &clock, Some(&tracked));
            let mut status = Status::Converged;
            let tracked = Tracked { motion, parameters: model.parameters().clone(), gain_choices: Vec::new() };
            if let Some(wanted) = self.plan.personalisation.as_ref().filter(|_| !stop.load(Ordering::Relaxed)) {
                let found = recovered(self.plan, wanted, &self.patient, &model, &tracked, stop)?;
                figures.extend(found.values);
                status = found.status;
            }
            return Ok(Beat { figures, status, trajectory: tracked.motion.trajectory });
        }
        let (trajectory, clock, status) = match self.plan.simulation.beats {
            Beats::Count(_) => {
                let plan = SimulationPlan { start_time_s: clock.start_s, end_time_s: clock.end_s, frame_times_s: clock.times_s.clone() };
                (simulate(&model, &plan, &[], &mut observer)?, clock, Status::Converged)
            }
            Beats::Periodic(periodicity) => {
                let times_s: Vec<f64> = clock.times_s.iter().map(|time_s| time_s - clock.start_s).collect();
                let outcome = simulate_until_periodic(&model, clock.start_s, &times_s, periodicity, &[], &mut observer)?;
                let status = if outcome.is_periodic { Status::Converged } else { Status::IterationLimit };
                let clock = self.patient.clock_at(clock.period_s, outcome.beat_count);
                (Trajectory { curves: outcome.curves, ..outcome.last_beat }, clock, status)
            }
        };
        let beat = BeatSummary::new(&model, &trajectory, &clock);
        let figures = Figures::new(&model, &beat, &trajectory, &clock, None);
        Ok(Beat { figures, status, trajectory })
    }

    /// The clock of the beats of a run; a tracked one has one beat.
    fn clock(&self, parameters: &Parameters) -> Clock {
        let count = if self.patient.images.is_some() { 1 } else { self.plan.simulation.beats.count() };
        self.patient.clock_at(parameters[Parameter::HeartPeriod], count)
    }
}

fn one_line(error: &RunError) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
