//! Steps that do not converge, taken in halves that end where they would have ended.

use std::sync::Arc;

use super::{HeartModel, HeartState, StepError, StepOutcome, StepWorkspace};
use crate::mechanics::{MechanicsError, StepLoad, StepOperator, StepSettings};

/// How often a step may be halved: down to a sixteenth.
const HALVING_LIMIT: usize = 4;

/// The same heart with half the step, and its memory.
#[derive(Debug)]
pub(super) struct FinerHeart {
    model: HeartModel,
    workspace: StepWorkspace,
}

impl FinerHeart {
    fn new(whole: &HeartModel, halving: usize) -> Result<Self, MechanicsError> {
        let mut model = whole.clone();
        model.settings.step_s /= 2.0;
        let step = StepSettings { step_s: model.settings.step_s, ..whole.operator.settings() };
        model.operator = Arc::new(StepOperator::with_settings(Arc::clone(whole.operator.myocardium()), step)?);
        let mut workspace = model.workspace();
        workspace.halving = halving;
        Ok(Self { model, workspace })
    }

    /// Whether it is finer than this one in its step only.
    fn is_of(&self, model: &HeartModel) -> bool {
        Arc::ptr_eq(self.model.operator.myocardium(), model.operator.myocardium())
            && self.model.parameters == model.parameters
            && self.model.settings.step_s == model.settings.step_s / 2.0
    }
}

impl HeartModel {
    /// The step in two halves, each of which may be halved again. Its flows are their means, so that they add up to the change of volume.
    ///
    /// # Errors
    /// `error`, that of the whole step, where no halves converge.
    pub(super) fn halved_step(
        &self,
        state: &HeartState,
        data: &[&dyn StepLoad],
        workspace: &mut StepWorkspace,
        error: StepError,
    ) -> Result<StepOutcome, StepError> {
        if workspace.halving == HALVING_LIMIT {
            return Err(error);
        }
        let mut finer = match workspace.finer.take().filter(|finer| finer.is_of(self)) {
            Some(finer) => finer,
            None => match FinerHeart::new(self, workspace.halving + 1) {
                Ok(finer) => Box::new(finer),
                Err(_) => return Err(error),
            },
        };
        let FinerHeart { model, workspace: memory } = &mut *finer;
        let halves = model.step(state, data, memory).and_then(|first| model.step(&first.state, data, memory).map(|second| [first, second]));
        workspace.finer = Some(finer);
        let Ok([first, mut second]) = halves else { return Err(error) };
        second.state.time_s = state.time_s + self.settings.step_s;
        for (end, middle) in second.state.ventricles.iter_mut().zip(&first.state.ventricles) {
            end.outflow_ml_per_s = (end.outflow_ml_per_s + middle.outflow_ml_per_s) / 2.0;
            end.inflow_ml_per_s = (end.inflow_ml_per_s + middle.inflow_ml_per_s) / 2.0;
        }
        second.solve.iteration_count += first.solve.iteration_count;
        Ok(StepOutcome {
            round_count: first.round_count + second.round_count,
            substep_count: first.substep_count + second.substep_count,
            volume_defect_ml: first.volume_defect_ml + second.volume_defect_ml,
            ..second
        })
    }
}
