//! From a label map on thick slices to smooth signed-distance fields of a ventricle (\[Billet2009\] §3).
//!
//! Every slice's labels become an outline without staircase and the exact distances to it (`outline`); the slices are cleaned and ordered
//! from apex to base (`slices`), joined along their axis and closed by a rounded apex (`stack`), and the result is made a true
//! distance (`redistance`) on an isotropic grid whose axes are those of the slices. The base is a plane parallel to the slices.

mod measure;
mod outline;
mod redistance;
mod slices;
mod stack;

use std::ops::Range;

use nalgebra::{Matrix4, Vector2, Vector3};
use rayon::prelude::*;

use super::{Grid, ImageError, LabelMap, Volume};
pub use measure::enclosed_volume_ml;
use slices::{LabelledSlice, SliceStack, count};
use stack::{CapLength, ShapeStack};

/// A plane through `point_mm` with a unit `normal`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// A point of the plane, world mm.
    pub point_mm: Vector3<f64>,
    /// Unit normal, world axes.
    pub normal: Vector3<f64>,
}

impl Plane {
    /// Signed distance, mm: positive on the side to which the normal points.
    pub fn signed_distance_mm(&self, position_mm: &Vector3<f64>) -> f64 {
        self.normal.dot(&(position_mm - self.point_mm))
    }
}

/// The codes of one ventricle in a label map; two different ones, not 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VentricleCodes {
    /// Blood of the ventricle.
    pub cavity: u8,
    /// Its wall.
    pub wall: u8,
}

/// Which end of the slices is the apex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ApexEnd {
    /// The end with the smaller cavity.
    #[default]
    Detect,
    /// The labelled slice with the lowest index.
    FirstSlice,
    /// The labelled slice with the highest index.
    LastSlice,
}

/// Where the ventricle is cut at the base, parallel to the slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BaseCut {
    /// Half a slice beyond the mid-plane of the most basal labelled slice: the labels' whole volume is kept.
    #[default]
    OuterFace,
    /// The mid-plane of the most basal labelled slice: nothing is extrapolated.
    MidSlice,
}

/// How fields are made from labels.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldOptions {
    /// Spacing of the fields' isotropic grid, mm; `None` is the finer in-plane spacing of the labels.
    pub spacing_mm: Option<f64>,
    /// Slices (index k) that are looked at; `None` is all of them.
    pub slices: Option<Range<usize>>,
    /// Which end is the apex.
    pub apex: ApexEnd,
    /// Where the base is cut.
    pub base: BaseCut,
    /// The wall is nowhere thinner, mm: where it would be, the cavity gives way.
    pub wall_thickness_min_mm: f64,
    /// By how much the grid surpasses the ventricle on every side, mm.
    pub margin_mm: f64,
}

impl Default for FieldOptions {
    fn default() -> Self {
        let (apex, base) = (ApexEnd::default(), BaseCut::default());
        Self { spacing_mm: None, slices: None, apex, base, wall_thickness_min_mm: 2.0, margin_mm: 8.0 }
    }
}

/// One ventricle as implicit functions on one isotropic grid: signed distances in mm, negative inside, to be sampled trilinearly.
///
/// The myocardium is {epicardium < 0} ∖ {cavity < 0}, below the base plane. Both fields are closed at the apex, continue unchanged beyond
/// the base plane (so that the cut is the plane's alone) and are positive on the whole border of the grid except where it lies beyond
/// the base plane; outside the grid everything is outside the ventricle. A layer of grid nodes lies on the base plane.
#[derive(Debug, Clone)]
pub struct VentricleFields {
    /// Signed distance to the endocardium, mm: negative in the blood.
    pub cavity: Volume,
    /// Signed distance to the epicardium, mm: negative in blood and wall.
    pub epicardium: Volume,
    /// Where the ventricle is cut at the base; the normal points out of the ventricle, towards the atria.
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

/// Sizes of labels and fields.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldReport {
    /// Index k of the most apical slice with a cavity, and of the most basal.
    pub apical_slice: usize,
    /// Index k of the most basal slice.
    pub basal_slice: usize,
    /// Blood in the slices used, by counting voxels, mL.
    pub labelled_cavity_ml: f64,
    /// Wall in the slices used, by counting voxels, mL.
    pub labelled_wall_ml: f64,
    /// Blood within the fields, mL.
    pub cavity_ml: f64,
    /// Wall within the fields, mL.
    pub wall_ml: f64,
    /// Distance between the tips of cavity and epicardium, mm.
    pub apical_wall_mm: f64,
}

/// Builds the fields of one ventricle from its labels.
///
/// # Errors
/// [`ImageError::UnusableMask`] if codes or options are senseless, labels are missing, or the wall is open between closed slices.
pub fn ventricle_fields(labels: &LabelMap, codes: &VentricleCodes, options: &FieldOptions) -> Result<VentricleFields, ImageError> {
    check_options(labels, codes, options)?;
    let stack = SliceStack::from_labels(labels, codes, options)?;
    let mut warnings = stack.warnings.clone();
    let frame = SliceFrame::new(labels.grid(), &stack, options);
    let [cavity, epicardium] = shapes(&stack, &frame, labels, options, &mut warnings);
    let lattice = Lattice::new(&frame, &stack, cavity.tip_height_mm().min(epicardium.tip_height_mm()), options)?;
    let mut cavity_mm = lattice.fill(&cavity);
    let epicardium_mm = lattice.fill(&epicardium);
    let thinned = keep_wall(&mut cavity_mm, &epicardium_mm, options.wall_thickness_min_mm, lattice.step_mm);
    if thinned > 0 {
        let least_mm = options.wall_thickness_min_mm;
        warnings
            .push(format!("the wall was thinner than {least_mm} mm at {thinned} grid nodes of the endocardium; the cavity was drawn back"));
    }
    let base_plane = frame.base_plane();
    let to_volume = |values: Vec<f64>| Volume::new(lattice.grid.clone(), values.into_iter().map(|v| v as f32).collect());
    let (cavity_field, epicardium_field) = (to_volume(cavity_mm)?, to_volume(epicardium_mm)?);
    let voxel_ml = labels.grid().voxel_volume_mm3() / 1000.0;
    let pixels = |mask: fn(&LabelledSlice) -> usize| stack.slices.iter().map(mask).sum::<usize>() as f64 * voxel_ml;
    let labelled_cavity_ml = pixels(|slice| slice.cavity.as_deref().map_or(0, count));
    let cavity_ml = enclosed_volume_ml(&cavity_field, &base_plane);
    let report = FieldReport {
        apical_slice: stack.slices.iter().find(|slice| slice.cavity.is_some()).map_or(0, |slice| slice.index),
        basal_slice: stack.slices.last().map_or(0, |slice| slice.index),
        labelled_cavity_ml,
        labelled_wall_ml: pixels(|slice| count(&slice.outline)) - labelled_cavity_ml,
        cavity_ml,
        wall_ml: enclosed_volume_ml(&epicardium_field, &base_plane) - cavity_ml,
        apical_wall_mm: cavity.tip_height_mm() - epicardium.tip_height_mm(),
    };
    let apex_mm = frame.to_world_mm(frame.centre_of(&stack.slices[0].outline), epicardium.tip_height_mm());
    let long_axis = frame.axis;
    Ok(VentricleFields { cavity: cavity_field, epicardium: epicardium_field, base_plane, apex_mm, long_axis, report, warnings })
}

fn check_options(labels: &LabelMap, codes: &VentricleCodes, options: &FieldOptions) -> Result<(), ImageError> {
    let unusable = |reason: String| Err(ImageError::UnusableMask { reason });
    if codes.cavity == 0 || codes.wall == 0 || codes.cavity == codes.wall {
        return unusable(format!("the labels {} (cavity) and {} (wall) must differ from each other and from 0", codes.cavity, codes.wall));
    }
    let spacing_mm = labels.grid().spacing_mm();
    let step_mm = options.spacing_mm.unwrap_or(spacing_mm.x.min(spacing_mm.y));
    if !(step_mm > 0.05 && step_mm < 20.0) {
        return unusable(format!("a grid spacing of {step_mm} mm is not usable"));
    }
    let lengths = [options.margin_mm, options.wall_thickness_min_mm];
    if !lengths.iter().all(|mm| (0.0..=100.0).contains(mm)) || options.margin_mm < 2.0 * step_mm {
        return unusable(format!(
            "margin {} mm and least wall thickness {} mm must be 0 to 100 mm, the margin at least two grid steps ({} mm)",
            options.margin_mm,
            options.wall_thickness_min_mm,
            2.0 * step_mm
        ));
    }
    Ok(())
}

/// The slices' own coordinates: pixels of the region, and height in mm along the axis from the most apical slice to the base.
struct SliceFrame<'a> {
    grid: &'a Grid,
    shape: [usize; 2],
    first_pixel: [isize; 2],
    first_index: f64,
    /// Slice indices per mm of height, signed.
    index_per_mm: f64,
    /// Unit vector of rising height.
    axis: Vector3<f64>,
    /// Heights of the slices, ascending.
    heights_mm: Vec<f64>,
    base_height_mm: f64,
}

impl<'a> SliceFrame<'a> {
    fn new(grid: &'a Grid, stack: &SliceStack, options: &FieldOptions) -> Self {
        let indices: Vec<f64> = stack.slices.iter().map(|slice| slice.index as f64).collect();
        let direction = (indices[indices.len() - 1] - indices[0]).signum();
        let gap_mm = grid.spacing_mm().z;
        let column = grid.voxel_to_world().fixed_view::<3, 1>(0, 2).into_owned();
        let heights_mm: Vec<f64> = indices.iter().map(|index| (index - indices[0]).abs() * gap_mm).collect();
        let top_mm = heights_mm[heights_mm.len() - 1];
        let base_height_mm = match options.base {
            BaseCut::OuterFace => top_mm + 0.5 * gap_mm,
            BaseCut::MidSlice => top_mm,
        };
        Self {
            grid,
            shape: stack.shape,
            first_pixel: stack.first_pixel,
            first_index: indices[0],
            index_per_mm: direction / gap_mm,
            axis: column * (direction / gap_mm),
            heights_mm,
            base_height_mm,
        }
    }

    fn to_world_mm(&self, pixel: Vector2<f64>, height_mm: f64) -> Vector3<f64> {
        let [first_i, first_j] = self.first_pixel.map(|n| n as f64);
        self.grid.to_world_mm(&Vector3::new(first_i + pixel.x, first_j + pixel.y, self.first_index + self.index_per_mm * height_mm))
    }

    fn centre_of(&self, mask: &[bool]) -> Vector2<f64> {
        let pixel = |flat: usize| Vector2::new((flat % self.shape[0]) as f64, (flat / self.shape[0]) as f64);
        let sum: Vector2<f64> = (0..mask.len()).filter(|&flat| mask[flat]).map(pixel).sum();
        sum / count(mask).max(1) as f64
    }

    fn base_plane(&self) -> Plane {
        let column = |axis: usize| self.grid.voxel_to_world().fixed_view::<3, 1>(0, axis).into_owned();
        let across = column(0).cross(&column(1)).normalize();
        let normal = if across.dot(&self.axis) < 0.0 { -across } else { across };
        let middle = Vector2::new(0.5 * self.shape[0] as f64, 0.5 * self.shape[1] as f64);
        Plane { point_mm: self.to_world_mm(middle, self.base_height_mm), normal }
    }
}

/// Cavity and epicardium between and beyond their slices.
fn shapes(
    stack: &SliceStack,
    frame: &SliceFrame<'_>,
    labels: &LabelMap,
    options: &FieldOptions,
    warnings: &mut Vec<String>,
) -> [ShapeStack; 2] {
    let gap_mm = labels.grid().spacing_mm().z;
    let pixel_mm2 = stack.spacing_mm.x * stack.spacing_mm.y;
    let cavity_begins = stack.slices.iter().position(|slice| slice.cavity.is_some()).unwrap_or(0);
    let masks: [Vec<&[bool]>; 2] = [
        stack.slices.iter().filter_map(|slice| slice.cavity.as_deref()).collect(),
        stack.slices.iter().map(|slice| slice.outline.as_slice()).collect(),
    ];
    let areas_mm2 = [0, 1].map(|n| masks[n].iter().map(|mask| count(mask) as f64 * pixel_mm2).collect::<Vec<f64>>());
    let heights_mm = [&frame.heights_mm[cavity_begins..], &frame.heights_mm[..]];
    let mut caps_mm = [0.0; 2];
    // A next slice without labels shows that the apex lies before it; without a next slice it may lie a little further.
    let apical_index = stack.slices[0].index;
    let has_next = if frame.index_per_mm > 0.0 { apical_index > 0 } else { apical_index + 1 < labels.grid().shape()[2] };
    let longest_mm = if has_next { gap_mm } else { 1.5 * gap_mm };
    for (n, name) in ["cavity", "epicardium"].into_iter().enumerate() {
        let cap = CapLength::from_areas(&areas_mm2[n], heights_mm[n][1] - heights_mm[n][0], longest_mm);
        if let Some(reason) = cap.limited {
            warnings.push(format!("apex of the {name}: it {reason}; closed {:.1} mm beyond its last slice's mid-plane", cap.length_mm));
        }
        caps_mm[n] = cap.length_mm;
    }
    // The wall at the tip keeps half of the thickness that it has around the most apical cavity.
    let radius_mm = |area: f64| (area / std::f64::consts::PI).sqrt();
    let beside_mm = radius_mm(areas_mm2[1][cavity_begins]) - radius_mm(areas_mm2[0][0]);
    let tip_wall_mm = (0.5 * beside_mm).max(options.wall_thickness_min_mm);
    let tips_mm = [heights_mm[0][0] - caps_mm[0], heights_mm[1][0] - caps_mm[1]];
    if tips_mm[0] - tips_mm[1] < tip_wall_mm {
        caps_mm[1] += tip_wall_mm - (tips_mm[0] - tips_mm[1]);
        warnings.push(format!("the wall at the apex came out thinner than {tip_wall_mm:.1} mm; the epicardium was extended to that"));
    }
    [0, 1].map(|n| {
        let distances = |mask: &&[bool]| outline::signed_distance_mm(stack.shape, mask, stack.spacing_mm);
        let fields = masks[n].par_iter().map(distances).collect();
        ShapeStack::new(heights_mm[n].to_vec(), fields, &areas_mm2[n], caps_mm[n], frame.base_height_mm)
    })
}

/// The isotropic grid of the fields and where its nodes lie in the slices' coordinates.
struct Lattice {
    grid: Grid,
    step_mm: f64,
    pixels_per_step: Vector2<f64>,
    first_height_mm: f64,
}

impl Lattice {
    fn new(frame: &SliceFrame<'_>, stack: &SliceStack, tip_height_mm: f64, options: &FieldOptions) -> Result<Self, ImageError> {
        let step_mm = options.spacing_mm.unwrap_or(stack.spacing_mm.min());
        let layers_below = ((frame.base_height_mm - tip_height_mm + options.margin_mm) / step_mm).ceil();
        let layers_above = (options.margin_mm / step_mm).ceil();
        let first_height_mm = frame.base_height_mm - layers_below * step_mm;
        let nodes = |axis: usize| ((stack.shape[axis] - 1) as f64 * stack.spacing_mm[axis] / step_mm).floor() as usize + 1;
        let shape = [nodes(0), nodes(1), (layers_below + layers_above) as usize + 1];
        let column = |axis: usize| frame.grid.voxel_to_world().fixed_view::<3, 1>(0, axis).normalize() * step_mm;
        let mut voxel_to_world = Matrix4::identity();
        for (n, vector) in
            [column(0), column(1), frame.axis * step_mm, frame.to_world_mm(Vector2::zeros(), first_height_mm)].iter().enumerate()
        {
            voxel_to_world.fixed_view_mut::<3, 1>(0, n).copy_from(vector);
        }
        let pixels_per_step = Vector2::repeat(step_mm).component_div(&stack.spacing_mm);
        Ok(Self { grid: Grid::new(shape, voxel_to_world)?, step_mm, pixels_per_step, first_height_mm })
    }

    /// Signed distances (mm) to a shape at all nodes.
    fn fill(&self, shape: &ShapeStack) -> Vec<f64> {
        let [ni, nj, nk] = self.grid.shape();
        let layer = |k: usize| {
            let height_mm = self.first_height_mm + k as f64 * self.step_mm;
            let node = move |flat: usize| {
                let pixel = Vector2::new((flat % ni) as f64, (flat / ni) as f64).component_mul(&self.pixels_per_step);
                shape.value_mm(pixel, height_mm)
            };
            (0..ni * nj).map(node).collect::<Vec<f64>>()
        };
        let mut values: Vec<f64> = (0..nk).into_par_iter().map(layer).collect::<Vec<_>>().concat();
        redistance::to_signed_distance_mm(&mut values, self.grid.shape(), self.step_mm);
        values
    }
}

/// Draws the cavity back to {epicardium < −thickness}; the number of nodes next to the endocardium where that changed something.
fn keep_wall(cavity_mm: &mut [f64], epicardium_mm: &[f64], thickness_mm: f64, step_mm: f64) -> usize {
    let mut changed = 0;
    for (cavity, epicardium) in cavity_mm.iter_mut().zip(epicardium_mm) {
        let inner = epicardium + thickness_mm;
        if inner > *cavity {
            changed += usize::from(cavity.abs() < step_mm || inner.abs() < step_mm && *cavity < 0.0);
            *cavity = inner;
        }
    }
    changed
}

#[cfg(test)]
mod tests;
