//! The figures of one run by their names, those of a tracked beat among them.

use serde::Serialize;
use toml::{Table, Value};

use crate::heart::{HeartModel, Trajectory};
use crate::mesh::SurfaceTag;
use crate::numerics::root_mean_square;
use crate::study::figure::segment_figure;
use crate::study::run::clock::Clock;
use crate::study::run::discrepancy::work_magnitude_mj;
use crate::study::run::forward::deformation;
use crate::study::run::leave::BeatSummary;
use crate::study::run::synthetic::Truth;
use crate::study::run::track::{held_out_rms_mm, surface_rms_mm};
use crate::study::run::wall::segment_rows;
use crate::tracking::TrackedMotion;

/// What a tracked beat has beside a free one.
#[derive(Debug, Clone, Serialize)]
pub(super) struct TrackingFigures {
    /// Root mean square distance of the boundary points from all surfaces, over all frames.
    image_residual_mm: Option<f64>,
    image_residual_endocardium_lv_mm: Option<f64>,
    image_residual_epicardium_mm: Option<f64>,
    /// Of the points that pull on nothing.
    image_residual_held_out_mm: Option<f64>,
    /// Magnitudes of the work of the image forces, added up over the beat.
    image_work_mj: f64,
    /// Mean over the images of the root mean square distance of all vertices from the truth.
    tracking_rmse_mm: Option<f64>,
    /// Largest over the images.
    tracking_rmse_greatest_mm: Option<f64>,
    tracking_volume_rms_lv_ml: Option<f64>,
}

impl TrackingFigures {
    /// Of a motion, beside the truth if it is known vertex by vertex; the image that tracking starts from does not count.
    pub(super) fn new(motion: &TrackedMotion, truth: Option<&Truth>) -> Self {
        let pairs = || motion.trajectory.frames.iter().zip(truth.map_or(&[][..], |truth| &truth.frames)).skip(1);
        let rmse_mm = |found: &[nalgebra::Vector3<f64>], real: &[nalgebra::Vector3<f64>]| {
            let same_mesh = found.len() == real.len();
            same_mesh.then(|| root_mean_square(&found.iter().zip(real).map(|(f, r)| (f - r).norm()).collect::<Vec<_>>()))
        };
        let rmses_mm: Vec<f64> = pairs().filter_map(|(found, real)| rmse_mm(&found.position_mm, &real.position_mm)).collect();
        let volumes_ml: Vec<f64> = pairs().filter_map(|(found, real)| Some(found.volume_ml.first()? - real.volume_ml.first()?)).collect();
        let known = |sample: &[f64], value: f64| (!sample.is_empty()).then_some(value);
        let residuals_mm: Vec<f64> = motion.frames.iter().flat_map(|frame| frame.residuals.iter().map(|r| r.rms_mm)).collect();
        let held_out_mm: Vec<f64> =
            motion.frames.iter().flat_map(|frame| frame.residuals.iter().filter_map(|r| r.held_out_rms_mm)).collect();
        Self {
            image_residual_mm: known(&residuals_mm, root_mean_square(&residuals_mm)),
            image_residual_endocardium_lv_mm: surface_rms_mm(motion, SurfaceTag::EndocardiumLv),
            image_residual_epicardium_mm: surface_rms_mm(motion, SurfaceTag::Epicardium),
            image_residual_held_out_mm: known(&held_out_mm, held_out_rms_mm(motion)),
            image_work_mj: work_magnitude_mj(motion),
            tracking_rmse_mm: known(&rmses_mm, crate::numerics::mean(&rmses_mm)),
            tracking_rmse_greatest_mm: rmses_mm.iter().copied().max_by(f64::total_cmp),
            tracking_volume_rms_lv_ml: known(&volumes_ml, root_mean_square(&volumes_ml)),
        }
    }
}

/// All figures of a run, under the names that they have in its files.
pub(super) struct Figures {
    named: Table,
    segments: Vec<Table>,
}

impl Figures {
    pub(super) fn new(
        model: &HeartModel,
        beat: &BeatSummary,
        trajectory: &Trajectory,
        clock: &Clock,
        tracked: Option<&TrackingFigures>,
    ) -> Self {
        let mut named = as_table(beat);
        named.extend(tracked.map(as_table).unwrap_or_default());
        let deformation = deformation(model, trajectory, clock);
        let segments = deformation.map(|deformation| segment_rows(model, &deformation)).unwrap_or_default();
        Self { named, segments: segments.iter().map(as_table).collect() }
    }

    /// Adds figures of other sources.
    pub(super) fn extend(&mut self, figures: Vec<(String, f64)>) {
        self.named.extend(figures.into_iter().map(|(name, value)| (name, Value::Float(value))));
    }

    /// A figure; none where the heart does not have it.
    pub(super) fn value(&self, name: &str) -> Option<f64> {
        let found = match segment_figure(name) {
            Some((segment, figure)) => {
                let is_it = |row: &&Table| row.get("segment").and_then(Value::as_integer) == Some(segment.into());
                self.segments.iter().find(is_it)?.get(figure)
            }
            None => self.named.get(name),
        };
        found.and_then(|value| value.as_float().or_else(|| value.as_integer().map(|count| count as f64)))
    }
}

/// A record's fields by name; those that are absent are left out.
fn as_table<R: Serialize>(record: &R) -> Table {
    Table::try_from(record).unwrap_or_default()
}
