//! What the tracking makes of a heart that is known: the fitted model's own beat is imaged and tracked as the patient was, \[Gourieroux1993\].
//!
//! $$ b = \hat d(\text{images of } m(\theta)) - m(\theta), \qquad \theta \leftarrow \arg\min \lVert d - b - m(\theta) \rVert $$
//!
//! Thick slices, voxels, a tracker that lags and a base that is matched late pull the data of the patient and those of the replica alike, so the difference b
//! of what is tracked and what is there belongs to the data. What the patient does and the model cannot do is not in the replica, nor is an error of the mesh,
//! which both share.

use serde::Serialize;

use super::calibration::{base_targets, calibration_trajectory, tracked_targets};
use super::clock::Clock;
use super::error::RunError;
use super::imaged_beat::{imaging, slice_sampling};
use super::measured::MeasuredVolumes;
use super::patient::{Patient, PatientImages};
use super::track::{Tracked, track_again};
use crate::heart::{HeartModel, Trajectory};
use crate::image::preprocess;
use crate::personalisation::{BoundaryResidual, GroupDistances};
use crate::phantom::{SyntheticCineSettings, synthetic_cine};
use crate::study::RunContext;
use crate::study::plan::{ImageSource, Plan};

/// How far what is tracked lies beyond what is there.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct TrackingBias {
    /// Volumes at the frames of the clock, mL, left ventricle first.
    volumes_ml: Vec<Vec<f64>>,
    /// Boundaries by frame and group.
    pub(super) boundary_mm: GroupDistances,
    /// The base by frame and axis.
    pub(super) base_mm: GroupDistances,
}

/// A row of `tracking_bias.csv`.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the columns of the file, units last")]
pub(super) struct BiasRow {
    replicas: usize,
    frame: usize,
    time_s: f64,
    volume_lv_ml: f64,
    endocardium_lv_mm: Option<f64>,
    epicardium_mm: Option<f64>,
}

/// The seed of a replica's textures and noise, which are not those of a phantom.
pub(super) fn replica_seed(seed: u64, number: usize) -> u64 {
    (seed << 32) + 1_000_000 + number as u64
}

/// Images the beat `fitted` of `model` on the patient's voxels, and tracks it with the heart and the gains that tracked the patient.
pub(super) fn track_replica(
    plan: &Plan,
    patient: &Patient,
    clock: &Clock,
    fitted: &Trajectory,
    tracked: &Tracked,
    seed: u64,
    context: &RunContext,
) -> Result<Tracked, RunError> {
    let Some(images) = &patient.images else { return Err(RunError::NothingToFit) };
    context.progress().stage("imaging the fitted heart", None);
    let (grid, prepared) = &images.acquired;
    let mut positions = vec![Vec::new(); images.cine.frames().len()];
    for (frame, state) in clock.frames.iter().zip(&fitted.frames).take(positions.len()) {
        positions[*frame].clone_from(&state.position_mm);
    }
    let settings = SyntheticCineSettings { seed, ..looks(plan, images) };
    let imaged = synthetic_cine(&patient.anatomy, &positions, images.cine.times_s(), images.cine.period_s(), grid, &settings)?;
    let images = PatientImages {
        cine: preprocess(&imaged.cine, prepared)?,
        long_axis: Vec::new(),
        slice_distance_mm: images.slice_distance_mm,
        acquired: images.acquired.clone(),
        reference_frame: images.reference_frame,
        validation: Vec::new(),
    };
    track_again(plan, patient, &images, &tracked.parameters, tracked, 1.0, context)
}

/// How the replica looks: as the phantom's images do, or as a scanner's usual ones of such slices.
fn looks(plan: &Plan, images: &PatientImages) -> SyntheticCineSettings {
    match &plan.images {
        Some(ImageSource::Phantom(phantom)) => imaging(phantom, images.acquired.0.shape()[2]),
        _ => SyntheticCineSettings {
            sampling: slice_sampling(images.slice_distance_mm, images.slice_distance_mm),
            ..SyntheticCineSettings::default()
        },
    }
}

impl TrackingBias {
    /// What `replica` was found to do beside what it does, `fitted`.
    pub(super) fn new(
        patient: &Patient,
        clock: &Clock,
        model: &HeartModel,
        fitted: &Trajectory,
        replica: &Tracked,
    ) -> Result<Self, RunError> {
        let anatomy = &patient.anatomy;
        let here = calibration_trajectory(model, fitted);
        let distances =
            |targets: Vec<_>| -> Result<GroupDistances, RunError> { Ok(BoundaryResidual::new(&targets, 1.0)?.distances_mm(&here)) };
        let frames = replica.motion.trajectory.frames.iter().zip(&fitted.frames);
        let difference = |(found, there): (&crate::heart::FrameState, &crate::heart::FrameState)| -> Vec<f64> {
            found.volume_ml.iter().zip(&there.volume_ml).map(|(found, there)| found - there).collect()
        };
        Ok(Self {
            volumes_ml: frames.map(difference).collect(),
            boundary_mm: distances(tracked_targets(anatomy, replica))?,
            base_mm: distances(base_targets(anatomy, clock, replica))?,
        })
    }

    /// The mean of several replicas, whose noise averages out.
    pub(super) fn mean(replicas: &[Self]) -> Self {
        let Some(first) = replicas.first() else { return Self::default() };
        let count = replicas.len() as f64;
        let volume = |frame: usize, ventricle: usize| replicas.iter().map(|one| one.volumes_ml[frame][ventricle]).sum::<f64>() / count;
        let frame = |(frame, ventricles): (usize, &Vec<f64>)| (0..ventricles.len()).map(|n| volume(frame, n)).collect();
        let grouped = |of: &dyn Fn(&Self) -> &GroupDistances| {
            let mut sums = std::collections::BTreeMap::<_, (f64, f64)>::new();
            for (&key, &distance_mm) in replicas.iter().flat_map(of) {
                let (sum_mm, count) = sums.get(&key).copied().unwrap_or_default();
                sums.insert(key, (sum_mm + distance_mm, count + 1.0));
            }
            sums.into_iter().map(|(key, (sum_mm, count))| (key, sum_mm / count)).collect()
        };
        Self {
            volumes_ml: first.volumes_ml.iter().enumerate().map(frame).collect(),
            boundary_mm: grouped(&|one| &one.boundary_mm),
            base_mm: grouped(&|one| &one.base_mm),
        }
    }

    /// Tracked volumes without the bias; others have none.
    pub(super) fn taken_off(&self, mut measured: MeasuredVolumes) -> MeasuredVolumes {
        if measured.is_tracked {
            let curves = [Some(&mut measured.left_ml), measured.right_ml.as_mut()];
            for (ventricle, curve) in curves.into_iter().flatten().enumerate() {
                for (volume_ml, bias_ml) in curve.iter_mut().zip(&self.volumes_ml) {
                    *volume_ml -= bias_ml.get(ventricle).copied().unwrap_or(0.0);
                }
            }
        }
        measured
    }

    /// The rows of `tracking_bias.csv`.
    pub(super) fn rows(&self, replicas: usize, clock: &Clock) -> Vec<BiasRow> {
        let surface = |frame: usize, number: u32| {
            let of_surface =
                self.boundary_mm.range((frame, number * 100)..(frame, (number + 1) * 100)).map(|(_, distance_mm)| *distance_mm);
            let distances: Vec<f64> = of_surface.collect();
            (!distances.is_empty()).then(|| crate::numerics::mean(&distances))
        };
        let row = |(frame, volumes_ml): (usize, &Vec<f64>)| BiasRow {
            replicas,
            frame: clock.frames.get(frame).copied().unwrap_or(frame),
            time_s: clock.times_s.get(frame).copied().unwrap_or(f64::NAN),
            volume_lv_ml: volumes_ml.first().copied().unwrap_or(f64::NAN),
            endocardium_lv_mm: surface(frame, 1),
            epicardium_mm: surface(frame, 3),
        };
        self.volumes_ml.iter().enumerate().map(row).collect()
    }
}
