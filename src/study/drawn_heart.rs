//! The labels or masks of a study's anatomy, as one label map.

use std::path::Path;

use super::cine::read_labels;
use super::plan::{LabelSource, LabelsPlan};
use crate::image::{HeartCodes, ImageError, LabelMap, labels_of_masks};

/// A heart as it was drawn.
pub(super) struct DrawnHeart {
    pub(super) labels: LabelMap,
    /// What the labels mean.
    pub(super) codes: HeartCodes,
    /// What was odd about them, in words.
    pub(super) warnings: Vec<String>,
}

impl DrawnHeart {
    /// Reads the files of a plan, the slices that count alone.
    pub(super) fn read(plan: &LabelsPlan) -> Result<Self, ImageError> {
        let read = |path: &Path| read_labels(path, plan.frame, plan.slices.as_ref());
        let (labels, warnings) = match &plan.source {
            LabelSource::Map { path, .. } => (read(path)?, Vec::new()),
            LabelSource::Masks { epicardium, endocardium_lv, endocardium_rv } => {
                let right = endocardium_rv.as_deref().map(read).transpose()?;
                labels_of_masks(&read(epicardium)?, &read(endocardium_lv)?, right.as_ref())?
            }
        };
        Ok(Self { labels, codes: plan.source.codes(), warnings })
    }
}
