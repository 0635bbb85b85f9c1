//! Blocks matched while the heart beats: at every frame from where the tracked heart carries them, \[Billet2009\] §5.

use std::sync::{Mutex, PoisonError};

use super::carried_blocks::{CarriedBlocks, Carrier};
use super::wall_force::WallForce;
use super::{BaseForce, BaseMatches, BaseProjection, TrackingError};
use crate::mechanics::{MotionState, StepLoad, StepSystem};
use crate::mesh::{TaggedSurface, TetMesh};

/// What the matches draw.
#[derive(Debug, Clone, Copy)]
pub(super) enum Drawn {
    /// The base.
    Base { projection: BaseProjection, gain_kpa_per_mm: f64 },
    /// All of the wall.
    Wall { gain_kpa_per_mm2: f64 },
}

/// The force of [`BaseForce`] or [`WallForce`] towards matches that are made on the way: when the heart passes a frame its blocks, as it has carried and
/// deformed them until then, are looked for in the next, and it is drawn from the one match to the other until it arrives there.
///
/// It has no tangent. A match depends on where the heart stood when it was made, through a search whose best place jumps from voxel to voxel,
/// so no derivative that holds it fixed would be that of the run: tangents are refused, and finite differences go through the matches.
pub(super) struct ProactiveBlocks<'a> {
    mesh: &'a TetMesh,
    surface: &'a TaggedSurface,
    carrier: Carrier,
    blocks: CarriedBlocks<'a>,
    drawn: Drawn,
    /// Time (s) and index of the frames in the order of the beat, the reference frame first.
    frames: Vec<(f64, usize)>,
    found: Mutex<(usize, BaseMatches)>,
}

impl<'a> ProactiveBlocks<'a> {
    /// The load on a mesh that beats through `frames`, whose cine has one period of `period_s` from `times_s[0]` on.
    pub(super) fn new(
        (mesh, surface): (&'a TetMesh, &'a TaggedSurface),
        carrier: Carrier,
        blocks: CarriedBlocks<'a>,
        drawn: Drawn,
        frames: Vec<(f64, usize)>,
        (times_s, period_s): (&[f64], f64),
    ) -> Result<Self, TrackingError> {
        let still = vec![vec![nalgebra::Vector3::zeros(); carrier.vertices().len()]; times_s.len()];
        let unsure = vec![vec![0.0; carrier.vertices().len()]; times_s.len()];
        let matches = BaseMatches::new(carrier.vertices().to_vec(), times_s.to_vec(), period_s, still, unsure);
        let load = Self { mesh, surface, carrier, blocks, drawn, frames, found: Mutex::new((0, matches)) };
        load.with_force(&load.found.lock().unwrap_or_else(PoisonError::into_inner).1, |_| ())?;
        Ok(load)
    }

    /// All matches that were made.
    pub(super) fn into_matches(self) -> BaseMatches {
        self.found.into_inner().unwrap_or_else(PoisonError::into_inner).1
    }

    fn with_force(&self, matches: &BaseMatches, then: impl FnOnce(&dyn StepLoad)) -> Result<(), TrackingError> {
        match self.drawn {
            Drawn::Base { projection, gain_kpa_per_mm } => {
                then(&BaseForce::new(self.surface, matches, self.mesh.vertices_mm(), projection, gain_kpa_per_mm)?);
            }
            Drawn::Wall { gain_kpa_per_mm2 } => then(&WallForce::new(self.mesh, matches, gain_kpa_per_mm2)?),
        }
        Ok(())
    }
}

impl StepLoad for ProactiveBlocks<'_> {
    fn add_to(&self, state: &MotionState, time_s: f64, step_s: f64, system: &mut StepSystem) {
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let (matched, matches) = &mut *found;
        let rounding_s = 1e-9 * step_s;
        // The frame before the end of the step, and the one after it, must be known.
        while *matched < self.frames.len() && (*matched == 0 || self.frames[*matched - 1].0 < time_s + step_s - rounding_s) {
            let (_, frame) = self.frames[*matched];
            let (displacement_mm, confidence) = self.blocks.find(frame, &self.carrier.carry(&state.position_mm));
            matches.set(frame, displacement_mm, confidence);
            *matched += 1;
        }
        // The settings were checked by the constructor.
        let _ = self.with_force(matches, |force| force.add_to(state, time_s, step_s, system));
    }
}
