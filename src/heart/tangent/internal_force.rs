//! How the internal forces of corotational kinematics change with what a step begins with, with the contraction and with the tissue.
//!
//! Damping holds the stretch that the step began with, so the forces at its end, the positions there held fixed, depend on the state before
//! it. Central differences of the assembled forces, not of the simulation: one along the change of that state and of the contraction
//! together, one between two tissues.

use nalgebra::Vector3;

use super::super::HeartModel;
use super::rates::ModelRate;
use crate::mechanics::{MechanicsError, MotionState, StepSystem};

/// How far the difference along the state's change moves a vertex, mm; its error is of the square of this over the size of a tetrahedron.
const REACH_MM: f64 = 1e-4;

/// A change of contraction that counts as much as one of 1 mm, kPa.
const KPA_PER_MM: f64 = 100.0;

/// What the forces are of: a step that began with a state, and ended at positions under a tension.
#[derive(Clone, Copy)]
pub(super) struct InternalForce<'a> {
    pub(super) model: &'a HeartModel,
    pub(super) before: &'a MotionState,
    pub(super) end_mm: &'a [Vector3<f64>],
    /// σC a tetrahedron, kPa.
    pub(super) tension_kpa: &'a [f64],
}

/// Memory of the differences.
#[derive(Default)]
pub(super) struct ForceMemory {
    system: Option<StepSystem>,
    moved: Option<MotionState>,
    tension_kpa: Vec<f64>,
}

impl InternalForce<'_> {
    /// Subtracts their derivative from `force_mn`, where the state that the step begins with changes by `state_rate` and the tension by
    /// `tension_rate_kpa` (empty for not at all).
    pub(super) fn subtract_rate(
        &self,
        rate: &ModelRate,
        state_rate: &MotionState,
        tension_rate_kpa: &[f64],
        memory: &mut ForceMemory,
        force_mn: &mut [Vector3<f64>],
    ) -> Result<(), MechanicsError> {
        let ForceMemory { system, moved, tension_kpa } = memory;
        let system = system.get_or_insert_with(|| self.model.operator.empty_system());
        let operator = &self.model.operator;
        let reach = self.reach(state_rate, tension_rate_kpa);
        for by in [reach, -reach].into_iter().filter(|by| *by != 0.0) {
            let moved = moved.get_or_insert_with(|| self.before.clone());
            move_along(self.before, state_rate, by, moved);
            tension_kpa.clear();
            tension_kpa.extend_from_slice(self.tension_kpa);
            tension_kpa.iter_mut().zip(tension_rate_kpa).for_each(|(tension, rate)| *tension += rate * by);
            let forces = operator.internal_force_mn(operator.myocardium(), moved, tension_kpa, self.end_mm, system)?;
            force_mn.iter_mut().zip(forces).for_each(|(force, internal)| *force -= internal / (2.0 * by));
        }
        let Some((tissues, width)) = &rate.tissues else { return Ok(()) };
        for (tissue, sign) in tissues.iter().zip([-1.0, 1.0]) {
            let forces = operator.internal_force_mn(tissue, self.before, self.tension_kpa, self.end_mm, system)?;
            force_mn.iter_mut().zip(forces).for_each(|(force, internal)| *force -= internal * (sign / width));
        }
        Ok(())
    }

    /// How many units of the parameter the difference goes to either side; 0 where nothing changes.
    fn reach(&self, state_rate: &MotionState, tension_rate_kpa: &[f64]) -> f64 {
        let step_s = self.model.settings.step_s;
        let largest = |field: &[Vector3<f64>]| field.iter().map(Vector3::amax).fold(0.0, f64::max);
        let largest_mm = [
            largest(&state_rate.position_mm),
            largest(&state_rate.velocity_mm_per_s) * step_s,
            largest(&state_rate.acceleration_mm_per_s2) * step_s.powi(2),
            tension_rate_kpa.iter().fold(0.0_f64, |most, rate| most.max(rate.abs())) / KPA_PER_MM,
        ];
        let largest_mm = largest_mm.into_iter().fold(0.0, f64::max);
        if largest_mm > 0.0 { REACH_MM / largest_mm } else { 0.0 }
    }
}

fn move_along(from: &MotionState, along: &MotionState, by: f64, moved: &mut MotionState) {
    let write = |from: &[Vector3<f64>], along: &[Vector3<f64>], moved: &mut [Vector3<f64>]| {
        moved.iter_mut().zip(from.iter().zip(along)).for_each(|(moved, (from, along))| *moved = from + along * by);
    };
    write(&from.position_mm, &along.position_mm, &mut moved.position_mm);
    write(&from.velocity_mm_per_s, &along.velocity_mm_per_s, &mut moved.velocity_mm_per_s);
    write(&from.acceleration_mm_per_s2, &along.acceleration_mm_per_s2, &mut moved.acceleration_mm_per_s2);
    write(
        &from.algorithmic_acceleration_mm_per_s2,
        &along.algorithmic_acceleration_mm_per_s2,
        &mut moved.algorithmic_acceleration_mm_per_s2,
    );
}
