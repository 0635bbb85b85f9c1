//! The cine of a study as its file asks for it: NIfTI or DICOM, its slices moved into one breath-hold on request, further views at its
//! heart period.

use std::ops::Range;
use std::path::Path;

use super::drawn_heart::DrawnHeart;
use super::plan::{ImagesPlan, LabelsPlan};
use crate::image::{
    CineReading, CineSequence, CineTiming, ImageError, LabelMap, SliceShifts, cine_warnings, correct_label_shifts, correct_slice_shifts,
    estimate_slice_shifts, read_cine_source, read_label_maps, read_views,
};
use crate::units::MS_PER_S;

/// Slices displaced by more than this are reported where they are not corrected, mm.
const SHIFT_REPORTED_MM: f64 = 2.5;

/// Heart periods of two breath-holds that differ by more than this share are reported.
const PERIOD_REPORTED: f64 = 0.01;

/// A cine, and how its slices were moved.
pub(super) struct StudyCine {
    pub(super) cine: CineSequence,
    pub(super) warnings: Vec<String>,
    /// By how much the slices were displaced before they were moved back; none where they were left.
    corrected: Option<SliceShifts>,
}

impl StudyCine {
    /// Reads the cine of a plan; `period_s` wins over the files' heart period. Slice shifts are looked for around the heart that was `drawn`.
    pub(super) fn read(plan: &ImagesPlan, period_s: Option<f64>, drawn: Option<&LabelsPlan>) -> Result<Self, ImageError> {
        let mut timing = timing_of(plan.timing.as_deref())?;
        timing.period_s = period_s.or(timing.period_s);
        timing.start_s = plan.first_frame_s.or(timing.start_s);
        let CineReading { cine, mut warnings } = read_cine_source(&plan.cine, &timing)?;
        warnings.extend(cine_warnings(&cine));
        let heart = drawn.map(DrawnHeart::read).transpose()?;
        let shifts = estimate_slice_shifts(&cine, heart.as_ref().map(|heart| &heart.labels));
        let greatest_mm = shifts.greatest_mm();
        if !plan.correct_slice_shifts {
            if greatest_mm > SHIFT_REPORTED_MM {
                warnings.push(format!(
                    "slices seem to lie up to {greatest_mm:.1} mm beside their neighbours; look at `cardiotwin info`, and if they do, set \
                     images.correct_slice_shifts"
                ));
            }
            return Ok(Self { cine, warnings, corrected: None });
        }
        let unknown = match shifts.not_estimable() {
            slices if slices.is_empty() => String::new(),
            slices => format!("; of slices {slices:?} nothing can be told, they were left"),
        };
        warnings.push(format!("slices were moved back by up to {greatest_mm:.1} mm into one breath-hold{unknown}"));
        Ok(Self { cine: correct_slice_shifts(&cine, &shifts)?, warnings, corrected: Some(shifts) })
    }

    /// The labels that were drawn on one frame of the cine as it was scanned, moved with its slices; see [`read_labels`].
    pub(super) fn read_labels(&self, path: &Path, frame: usize, slices: Option<&Range<usize>>) -> Result<LabelMap, ImageError> {
        Ok(self.moved(read_labels(path, frame, slices)?))
    }

    /// The heart of a plan, which was drawn on the cine as it was scanned, moved with its slices.
    pub(super) fn read_heart(&self, plan: &LabelsPlan) -> Result<DrawnHeart, ImageError> {
        let drawn = DrawnHeart::read(plan)?;
        Ok(DrawnHeart { labels: self.moved(drawn.labels), ..drawn })
    }

    /// The labels of every frame of the cine, moved with its slices.
    pub(super) fn read_labels_of_every_frame(&self, path: &Path, slices: Option<&Range<usize>>) -> Result<Vec<LabelMap>, ImageError> {
        let maps = read_label_maps(path)?;
        let (found, expected) = (maps.len(), self.cine.frames().len());
        if found != expected {
            let reason = format!("it has labels of {found} frames, the cine has {expected}; name the frame that one map was drawn on");
            return Err(ImageError::Unusable { path: path.into(), reason });
        }
        Ok(maps.into_iter().map(|labels| self.moved(within(labels, slices))).collect())
    }

    fn moved(&self, labels: LabelMap) -> LabelMap {
        match &self.corrected {
            Some(shifts) => correct_label_shifts(&labels, self.cine.grid(), shifts),
            None => labels,
        }
    }

    /// The long-axis views of a plan, phase by phase at the heart period of this cine.
    pub(super) fn read_long_axis(&self, plan: &ImagesPlan) -> Result<Vec<CineReading>, ImageError> {
        let Some(path) = &plan.long_axis else { return Ok(Vec::new()) };
        let period_s = self.cine.period_s();
        let at_own_period = |CineReading { cine, mut warnings }: CineReading| {
            if (cine.period_s() / period_s - 1.0).abs() > PERIOD_REPORTED {
                let [own_ms, common_ms] = [cine.period_s(), period_s].map(|s| s * MS_PER_S);
                warnings.push(format!("long axis: a heart period of {own_ms:.0} ms, brought to {common_ms:.0} ms phase by phase"));
            }
            Ok(CineReading { cine: cine.at_period(period_s)?, warnings })
        };
        read_views(path, &timing_of(plan.long_axis_timing.as_deref())?)?.into_iter().map(at_own_period).collect()
    }
}

/// The labels of a 3-D file, or those of one frame of a 4-D file, in the slices that count (all where none are named).
pub(super) fn read_labels(path: &Path, frame: usize, slices: Option<&Range<usize>>) -> Result<LabelMap, ImageError> {
    let mut maps = read_label_maps(path)?;
    let found = maps.len();
    let place = if found == 1 { 0 } else { frame };
    if place >= found {
        let reason = format!("it has labels of {found} frames, counted from 0, but frame {frame} is asked for");
        return Err(ImageError::Unusable { path: path.into(), reason });
    }
    Ok(within(maps.swap_remove(place), slices))
}

/// Labels without those of the slices that do not count.
fn within(labels: LabelMap, slices: Option<&Range<usize>>) -> LabelMap {
    match slices {
        Some(slices) => labels.slices(slices.clone()),
        None => labels,
    }
}

fn timing_of(sidecar: Option<&Path>) -> Result<CineTiming, ImageError> {
    Ok(sidecar.map(CineTiming::from_sidecar).transpose()?.unwrap_or_default())
}
