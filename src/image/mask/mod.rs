//! From a label map on thick slices to smooth signed-distance fields of one ventricle or two (\[Billet2009\] §3).
//!
//! Every slice's labels become an outline without staircase and the exact distances to it (`outline`); the slices are cleaned and ordered
//! from apex to base (`slices`), joined along their axis and closed by a rounded apex (`stack`, `shapes`), and the result is made a true
//! distance (`redistance`) on an isotropic grid whose axes are those of the slices (`lattice`). A right cavity without a labelled wall gets
//! one, a left one if that is asked for. The base is a plane, parallel to the slices unless another one is given.

mod frame;
mod lattice;
mod measure;
mod options;
mod orientation;
mod outline;
mod redistance;
mod shapes;
mod slices;
mod stack;
mod three_masks;

use nalgebra::Vector3;

use super::{ImageError, LabelMap, Volume};
use frame::SliceFrame;
use lattice::{Lattice, NodeDistances, keep_septum, keep_wall};
pub use measure::enclosed_volume_ml;
pub use options::{ApexEnd, BaseCut, FieldOptions, HeartCodes, Plane};
use shapes::HeartShapes;
use slices::{LabelledSlice, SliceStack};
pub use three_masks::{MASK_CODES, labels_of_masks};

/// One ventricle or two as implicit functions on one isotropic grid: signed distances in mm, negative inside, to be sampled trilinearly.
///
/// The myocardium is {epicardium < 0} without the cavities, below the base plane. All fields are closed at the apex, continue unchanged
/// beyond the labels (so that the cut is the plane's alone) and are positive on the whole border of the grid except where it lies beyond
/// the base plane; outside the grid everything is outside the heart. Where the base is parallel to the slices, a layer of grid nodes lies
/// on it.
#[derive(Debug, Clone)]
pub struct HeartFields {
    /// Signed distance to the left endocardium, mm: negative in the blood.
    pub cavity_lv: Volume,
    /// The same of the right ventricle, if it was asked for.
    pub cavity_rv: Option<Volume>,
    /// Signed distance to the epicardium, mm: negative in blood and wall.
    pub epicardium: Volume,
    /// Where the heart is cut at the base; the normal points out of the heart, towards the atria.
    pub base_plane: Plane,
    /// Tip of the epicardium, world mm.
    pub apex_mm: Vector3<f64>,
    /// Unit vector from apex to base along the slice axis.
    pub long_axis: Vector3<f64>,
    /// Sizes to compare with the labels.
    pub report: FieldReport,
    /// What was assumed or left out, in words.
    pub warnings: Vec<String>,
}

/// Sizes of labels and fields, of what lies below the base plane.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldReport {
    /// Index k of the most apical slice with a cavity, and of the most basal.
    pub apical_slice: usize,
    /// Index k of the most basal slice.
    pub basal_slice: usize,
    /// Left blood in the slices used, by counting voxels, mL.
    pub labelled_cavity_lv_ml: f64,
    /// Right blood, likewise.
    pub labelled_cavity_rv_ml: Option<f64>,
    /// Wall in the slices used, by counting voxels, mL.
    pub labelled_wall_ml: f64,
    /// Left blood within the fields, mL.
    pub cavity_lv_ml: f64,
    /// Right blood within the fields, mL.
    pub cavity_rv_ml: Option<f64>,
    /// Wall within the fields, mL.
    pub wall_ml: f64,
    /// The part of it that was grown around cavities without a wall, mL.
    pub grown_wall_ml: f64,
    /// Distance between the tips of cavity and epicardium, mm.
    pub apical_wall_mm: f64,
}

/// Builds the fields of a heart from its labels.
///
/// # Errors
/// [`ImageError::UnusableMask`] if codes or options are senseless, labels are missing, the left wall is open between closed slices, or the
/// base plane does not cut the heart across.
pub fn heart_fields(labels: &LabelMap, codes: &HeartCodes, options: &FieldOptions) -> Result<HeartFields, ImageError> {
    let (labels, mut warnings) = orientation::slices_along_k(labels)?;
    let labels = labels.as_ref();
    options.check(labels, codes)?;
    let stack = SliceStack::from_labels(labels, codes, options)?;
    warnings.extend(stack.warnings.iter().cloned());
    let frame = SliceFrame::new(labels.grid(), &stack, options);
    let shapes = HeartShapes::between(&stack, &frame, labels, options, &mut warnings);
    let lattice = Lattice::new(&frame, &stack, shapes.tip_height_mm(), options.reach_mm(codes), options)?;
    let base_plane = match options.base {
        BaseCut::Plane(plane) => orientation::towards_base(plane, &frame.axis)?,
        BaseCut::OuterFace | BaseCut::MidSlice => frame.base_plane(),
    };
    let layers = lattice.fill_all(&shapes, &stack);
    let NodeDistances { mut cavity_mm, cavity_rv_mm, epicardium_mm, labelled_mm } = layers;
    let least_mm = options.wall_thickness_min_mm;
    let mut report_thin = |count: usize, wall: &str, blood: &str| {
        if count > 0 {
            let nodes = format!("at {count} grid nodes of the endocardium");
            warnings.push(format!("the {wall} was thinner than {least_mm} mm {nodes}; the {blood} was drawn back"));
        }
    };
    let least_lv_mm = least_mm.min(stack.grown_lv_mm.unwrap_or(least_mm));
    report_thin(keep_wall(&mut cavity_mm, &epicardium_mm, least_lv_mm, lattice.step_mm), "wall", "cavity");
    let cavity_rv_mm = cavity_rv_mm.map(|mut right_mm| {
        let least_rv_mm = least_mm.min(stack.grown_rv_mm.unwrap_or(least_mm));
        let least_septum_mm = least_mm.max(stack.grown_lv_mm.unwrap_or(least_mm));
        report_thin(keep_septum(&mut right_mm, &cavity_mm, least_septum_mm, lattice.step_mm), "septum", "right cavity");
        report_thin(keep_wall(&mut right_mm, &epicardium_mm, least_rv_mm, lattice.step_mm), "right wall", "right cavity");
        right_mm
    });
    let to_volume = |values: Vec<f64>| Volume::new(lattice.grid.clone(), values.into_iter().map(|v| v as f32).collect());
    let (cavity_lv, epicardium) = (to_volume(cavity_mm)?, to_volume(epicardium_mm)?);
    let (cavity_rv, labelled) = (cavity_rv_mm.map(to_volume).transpose()?, labelled_mm.map(to_volume).transpose()?);
    orientation::check_base(&epicardium, &base_plane, &frame, &mut warnings)?;
    let counted = |mask: fn(&LabelledSlice) -> Vec<bool>| frame.volume_below_ml(&stack, &base_plane, mask);
    let enclosed = |field: &Volume| enclosed_volume_ml(field, &base_plane);
    let (cavity_lv_ml, cavity_rv_ml, hull_ml) = (enclosed(&cavity_lv), cavity_rv.as_ref().map(enclosed), enclosed(&epicardium));
    let report = FieldReport {
        apical_slice: stack.slices.iter().find(|slice| slice.cavity.is_some()).map_or(0, |slice| slice.index),
        basal_slice: stack.slices.last().map_or(0, |slice| slice.index),
        labelled_cavity_lv_ml: counted(|slice| slice.cavity.clone().unwrap_or_default()),
        labelled_cavity_rv_ml: cavity_rv.as_ref().map(|_| counted(|slice| slice.cavity_rv.clone().unwrap_or_default())),
        labelled_wall_ml: counted(LabelledSlice::wall),
        cavity_lv_ml,
        cavity_rv_ml,
        wall_ml: hull_ml - cavity_lv_ml - cavity_rv_ml.unwrap_or(0.0),
        grown_wall_ml: labelled.as_ref().map_or(0.0, |labelled| hull_ml - enclosed(labelled)),
        apical_wall_mm: shapes.cavity.tip_height_mm() - shapes.apex_height_mm(),
    };
    let apex_mm = frame.to_world_mm(frame.centre_of(&stack.slices[0].outline), shapes.apex_height_mm());
    let long_axis = frame.axis;
    Ok(HeartFields { cavity_lv, cavity_rv, epicardium, base_plane, apex_mm, long_axis, report, warnings })
}

#[cfg(test)]
mod tests;
