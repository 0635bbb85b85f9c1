//! Cavities and epicardium between and beyond their slices, and the wall that they leave at the apex.

use rayon::prelude::*;

use super::FieldOptions;
use super::frame::SliceFrame;
use super::outline;
use super::slices::{SliceStack, count};
use super::stack::{CapLength, ShapeStack};
use crate::image::LabelMap;

/// The shapes of a heart as level sets of slice coordinates.
pub(super) struct HeartShapes {
    pub(super) cavity: ShapeStack,
    /// Everything labelled: both cavities and the walls.
    pub(super) outline: ShapeStack,
    pub(super) cavity_rv: Option<ShapeStack>,
    /// Thickness of the wall to be grown around the left cavity, mm.
    grown_lv_mm: Option<f64>,
}

/// The slices of one shape, from its own apex to the base.
struct Masks<'a> {
    masks: Vec<&'a [bool]>,
    heights_mm: &'a [f64],
    areas_mm2: Vec<f64>,
}

impl<'a> Masks<'a> {
    fn new(masks: Vec<&'a [bool]>, heights_mm: &'a [f64], pixel_mm2: f64) -> Self {
        let areas_mm2 = masks.iter().map(|mask| count(mask) as f64 * pixel_mm2).collect();
        // A shape goes on to the base: its slices are the last ones.
        let heights_mm = &heights_mm[heights_mm.len() - masks.len()..];
        Self { masks, heights_mm, areas_mm2 }
    }

    fn cap_mm(&self, name: &str, longest_mm: f64, warnings: &mut Vec<String>) -> f64 {
        let cap = CapLength::from_areas(&self.areas_mm2, self.heights_mm[1] - self.heights_mm[0], longest_mm);
        if let Some(reason) = cap.limited {
            warnings.push(format!("apex of the {name}: it {reason}; closed {:.1} mm beyond its last slice's mid-plane", cap.length_mm));
        }
        cap.length_mm
    }

    fn stacked(&self, cap_mm: f64, stack: &SliceStack, frame: &SliceFrame<'_>) -> ShapeStack {
        let distances = |mask: &&[bool]| outline::signed_distance_mm(stack.shape, mask, stack.spacing_mm);
        let fields = self.masks.par_iter().map(distances).collect();
        ShapeStack::new(self.heights_mm.to_vec(), fields, &self.areas_mm2, cap_mm, frame.base_height_mm)
    }
}

impl HeartShapes {
    /// Joins the slices of every shape and closes it at the apex.
    pub(super) fn between(
        stack: &SliceStack,
        frame: &SliceFrame<'_>,
        labels: &LabelMap,
        options: &FieldOptions,
        warnings: &mut Vec<String>,
    ) -> Self {
        let gap_mm = labels.grid().spacing_mm().z;
        let pixel_mm2 = stack.spacing_mm.x * stack.spacing_mm.y;
        let of = |masks| Masks::new(masks, &frame.heights_mm, pixel_mm2);
        let cavity = of(stack.slices.iter().filter_map(|slice| slice.cavity.as_deref()).collect());
        let whole = of(stack.slices.iter().map(|slice| slice.outline.as_slice()).collect());
        let right: Vec<&[bool]> = stack.slices.iter().filter_map(|slice| slice.cavity_rv.as_deref()).collect();
        let right = (!right.is_empty()).then(|| of(right));
        // A next slice without labels shows that the apex lies before it; without a next slice it may lie a little further.
        let apical_index = stack.slices[0].index;
        let has_next = if frame.index_per_mm > 0.0 { apical_index > 0 } else { apical_index + 1 < labels.grid().shape()[2] };
        let longest_mm = if has_next { gap_mm } else { 1.5 * gap_mm };
        let cavity_cap_mm = cavity.cap_mm("cavity", longest_mm, warnings);
        let mut whole_cap_mm = whole.cap_mm("epicardium", longest_mm, warnings);
        // The wall at the tip keeps half of the thickness that it has around the most apical cavity.
        let cavity_begins = stack.slices.len() - cavity.masks.len();
        let right_mm2 = stack.slices[cavity_begins].cavity_rv.as_deref().map_or(0.0, |mask| count(mask) as f64 * pixel_mm2);
        let radius_mm = |area: f64| (area / std::f64::consts::PI).sqrt();
        let beside_mm = radius_mm(whole.areas_mm2[cavity_begins] - right_mm2) - radius_mm(cavity.areas_mm2[0]);
        let tip_wall_mm = (0.5 * beside_mm).max(options.wall_thickness_min_mm);
        let tips_mm = [cavity.heights_mm[0] - cavity_cap_mm, whole.heights_mm[0] - whole_cap_mm];
        if stack.grown_lv_mm.is_none() && tips_mm[0] - tips_mm[1] < tip_wall_mm {
            whole_cap_mm += tip_wall_mm - (tips_mm[0] - tips_mm[1]);
            warnings.push(format!("the wall at the apex came out thinner than {tip_wall_mm:.1} mm; the epicardium was extended to that"));
        }
        Self {
            cavity: cavity.stacked(cavity_cap_mm, stack, frame),
            outline: whole.stacked(whole_cap_mm, stack, frame),
            cavity_rv: right.map(|right| {
                let cap_mm = right.cap_mm("right cavity", gap_mm, warnings);
                right.stacked(cap_mm, stack, frame)
            }),
            grown_lv_mm: stack.grown_lv_mm,
        }
    }

    /// Height of the epicardium's tip below the left cavity, mm.
    pub(super) fn apex_height_mm(&self) -> f64 {
        let labelled_mm = self.outline.tip_height_mm();
        self.grown_lv_mm.map_or(labelled_mm, |thickness_mm| labelled_mm.min(self.cavity.tip_height_mm() - thickness_mm))
    }

    /// Height of the lowest tip of what is labelled, mm.
    pub(super) fn tip_height_mm(&self) -> f64 {
        let tips = [Some(&self.cavity), Some(&self.outline), self.cavity_rv.as_ref()];
        tips.into_iter().flatten().map(ShapeStack::tip_height_mm).fold(f64::INFINITY, f64::min)
    }
}
