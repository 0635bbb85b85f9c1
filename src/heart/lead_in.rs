//! From rest to the start of a simulation: the steps that a heart takes first where its depolarisation comes before the start.
//!
//! The mesh rests while no tissue contracts. A study starts at the image that the mesh was drawn on, and some tissue may have been
//! depolarised before that: its stress $\sigma_C(t_0) > 0$ of \[Billet2009\] eq. 1 would then come upon the resting heart at once, as a blow
//! that raises the pressure by thousands of mmHg/s in the first step. So such a heart rests at its first depolarisation $t_d < t_0$ and takes
//! whole steps up to $t_0$ without data, while the arteries keep their initial pressure. Its valves being shut, it starts from the volume
//! of the mesh, and from the pressure that it has built up by then.

use super::{HeartModel, HeartState, StepError, StepOutcome, StepWorkspace, VentricleState};

/// Where a heart rests, and how far that is from the start.
pub(super) struct LeadIn {
    /// The heart at rest, whole steps before the start.
    pub(super) rest: HeartState,
    /// Steps from there to the start.
    pub(super) step_count: usize,
    /// The vertex whose depolarisation comes first, where that decides when the heart rests.
    pub(super) first_vertex: Option<usize>,
}

impl LeadIn {
    /// The atrial pressures of the rest are those at the first depolarisation, so that they do not jump where the onset passes from one
    /// step to the next.
    pub(super) fn new(model: &HeartModel, start_time_s: f64) -> Self {
        let times_s = model.activation().times_s().iter().copied().enumerate();
        let first = times_s.min_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, first_s)| *first_s < start_time_s);
        let Some((vertex, first_s)) = first else {
            return Self { rest: model.initial_state(start_time_s), step_count: 0, first_vertex: None };
        };
        let step_s = model.settings.step_s;
        let step_count = ((start_time_s - first_s) / step_s - 1e-9).ceil().max(0.0);
        let rest = model.state_at_rest(start_time_s - step_count * step_s, first_s);
        Self { rest, step_count: step_count as usize, first_vertex: Some(vertex) }
    }

    /// Takes the steps and shows each, with the state before it.
    ///
    /// # Errors
    /// What a step or `show` fails with.
    pub(super) fn run<E: From<StepError>>(
        self,
        model: &HeartModel,
        workspace: &mut StepWorkspace,
        mut show: impl FnMut(&HeartState, &StepOutcome, &StepWorkspace) -> Result<(), E>,
    ) -> Result<HeartState, E> {
        let mut state = self.rest;
        let arteries_kpa: Vec<f64> = state.ventricles.iter().map(|ventricle| ventricle.capacitor_pressure_kpa).collect();
        for _ in 0..self.step_count {
            let outcome = model.step(&state, &[], workspace)?;
            show(&state, &outcome, workspace)?;
            state = outcome.state;
            for (ventricle, rest) in state.ventricles.iter_mut().zip(&arteries_kpa) {
                hold_artery(ventricle, *rest);
            }
        }
        Ok(state)
    }
}

/// Gives the artery back the p_C (or its derivative) that it had before the step.
pub(super) fn hold_artery(ventricle: &mut VentricleState, capacitor_pressure_kpa: f64) {
    ventricle.arterial_pressure_kpa += capacitor_pressure_kpa - ventricle.capacitor_pressure_kpa;
    ventricle.capacitor_pressure_kpa = capacitor_pressure_kpa;
}

impl HeartModel {
    /// The heart at the start of a simulation: at rest, or, if depolarisation comes before, what has become by then of the heart that
    /// rested when the first tissue was depolarised.
    ///
    /// # Errors
    /// The [`StepError`] of a step on the way.
    pub fn state_at_start(&self, start_time_s: f64, workspace: &mut StepWorkspace) -> Result<HeartState, StepError> {
        LeadIn::new(self, start_time_s).run(self, workspace, |_, _, _| Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;
    use std::sync::Arc;

    use super::*;
    use crate::anatomy::Ventricle;
    use crate::circulation::Phase;
    use crate::heart::idealised_lv::IdealisedLv;
    use crate::heart::{BeatObservables, ModelSettings, Parameter, Parameters, SimulationPlan, Trajectory, simulate};

    const ONSET_S: f64 = 0.01;

    fn beat(onset_s: f64, start_time_s: f64) -> Trajectory {
        let anatomy = Arc::new(IdealisedLv { resolution: [12, 6, 1], ..IdealisedLv::default() }.anatomy());
        let parameters = Parameters::default().with(Parameter::OnsetTime, onset_s).unwrap();
        let model = HeartModel::new(anatomy, parameters, ModelSettings::default()).unwrap();
        let plan = SimulationPlan { start_time_s, end_time_s: 0.4, frame_times_s: vec![0.06, 0.3] };
        simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap()
    }

    /// Without the steps before the start the contraction of 30 ms comes at once: 3,000 mmHg/s and more.
    #[test]
    fn a_heart_depolarised_before_the_start_beats_as_if_it_had_started_then() {
        let (early, late) = (beat(ONSET_S, ONSET_S), beat(ONSET_S, ONSET_S + 0.03));
        let rows = early.curves.iter().filter(|row| row.time_s > ONSET_S + 0.03 - 1e-9);
        // Afterwards the pressures that the arteries have by then differ.
        let contracting: Vec<_> = rows.zip(&late.curves).take_while(|(row, _)| row.phase_lv != Some(Phase::Ejection)).collect();
        assert!(contracting.len() > 3, "{}", contracting.len());
        for (one, other) in contracting {
            assert!((one.time_s - other.time_s).abs() < 1e-12);
            assert!((one.pressure_lv_kpa.unwrap() - other.pressure_lv_kpa.unwrap()).abs() < 1e-5, "{one:?} {other:?}");
            assert!((one.volume_lv_ml.unwrap() - other.volume_lv_ml.unwrap()).abs() < 1e-4, "{one:?} {other:?}");
        }
        let rate = |beat: &Trajectory, start_s| {
            BeatObservables::of_beat(&beat.curves, Ventricle::Left, start_s, 0.3).unwrap().pressure_rate_max_mmhg_per_s
        };
        assert!(rate(&late, ONSET_S + 0.03) <= rate(&early, ONSET_S) * 1.001, "{} mmHg/s", rate(&late, ONSET_S + 0.03));
    }

    /// Where one more step is needed before the start the beat must not jump, or no search could go by its derivatives.
    #[test]
    fn the_beat_does_not_jump_where_the_onset_passes_a_step_or_the_start() {
        let start_s = 0.03;
        for edge_s in [start_s, start_s - 0.005] {
            let [before, after] = [-1e-7, 1e-7].map(|by| beat(edge_s + by, start_s));
            for (one, other) in before.frames.iter().zip(&after.frames) {
                assert!((one.volume_ml[0] - other.volume_ml[0]).abs() < 2e-3, "{} {} mL", one.volume_ml[0], other.volume_ml[0]);
            }
        }
    }
}
