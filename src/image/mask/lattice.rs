//! The grid on which shapes between slices become distances, and the thinnest wall that it keeps.

use nalgebra::{Matrix4, Vector2};
use rayon::prelude::*;

use super::frame::SliceFrame;
use super::shapes::HeartShapes;
use super::slices::SliceStack;
use super::stack::ShapeStack;
use super::{FieldOptions, redistance};
use crate::image::{Grid, ImageError};
use crate::numerics::rounded_max;

/// The isotropic grid of the fields and where its nodes lie in the slices' coordinates.
pub(super) struct Lattice {
    pub(super) grid: Grid,
    pub(super) step_mm: f64,
    pixels_per_step: Vector2<f64>,
    first_height_mm: f64,
}

impl Lattice {
    pub(super) fn new(
        frame: &SliceFrame<'_>,
        stack: &SliceStack,
        tip_height_mm: f64,
        reach_mm: f64,
        options: &FieldOptions,
    ) -> Result<Self, ImageError> {
        let step_mm = options.spacing_mm.unwrap_or(stack.spacing_mm.min());
        let layers_below = ((frame.base_height_mm - tip_height_mm + reach_mm) / step_mm).ceil();
        let layers_above = (reach_mm / step_mm).ceil();
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

    /// Signed distances to all shapes of a heart, with the walls that are grown.
    pub(super) fn fill_all(&self, shapes: &HeartShapes, stack: &SliceStack) -> NodeDistances {
        let cavity_mm = self.fill(&shapes.cavity);
        let cavity_rv_mm = shapes.cavity_rv.as_ref().map(|shape| self.fill(shape));
        let mut epicardium_mm = self.fill(&shapes.outline);
        let is_grown = stack.grown_lv_mm.or(stack.grown_rv_mm).is_some();
        let labelled_mm = is_grown.then(|| epicardium_mm.clone());
        if let Some(thickness_mm) = stack.grown_lv_mm {
            // What is labelled of this wall lies along the grown one: rounded where they meet, it would be thicker than either.
            grow_wall(&mut epicardium_mm, &cavity_mm, thickness_mm, 0.0);
        }
        if let (Some(right_mm), Some(thickness_mm)) = (&cavity_rv_mm, stack.grown_rv_mm) {
            grow_wall(&mut epicardium_mm, right_mm, thickness_mm, thickness_mm);
        }
        NodeDistances { cavity_mm, cavity_rv_mm, epicardium_mm, labelled_mm }
    }
}

/// Signed distances at the nodes of a lattice, mm.
pub(super) struct NodeDistances {
    pub(super) cavity_mm: Vec<f64>,
    pub(super) cavity_rv_mm: Option<Vec<f64>>,
    pub(super) epicardium_mm: Vec<f64>,
    /// What is labelled, where the epicardium was grown beyond it.
    pub(super) labelled_mm: Option<Vec<f64>>,
}

/// Draws the cavity back to {epicardium < −thickness}; the number of nodes next to the endocardium where that changed something.
pub(super) fn keep_wall(cavity_mm: &mut [f64], epicardium_mm: &[f64], thickness_mm: f64, step_mm: f64) -> usize {
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

/// Draws the right cavity back to where the left one is at least `thickness_mm` away; the number of nodes next to its endocardium where
/// that changed something.
pub(super) fn keep_septum(right_mm: &mut [f64], left_mm: &[f64], thickness_mm: f64, step_mm: f64) -> usize {
    let outside_left_mm: Vec<f64> = left_mm.iter().map(|distance| -distance).collect();
    keep_wall(right_mm, &outside_left_mm, thickness_mm, step_mm)
}

/// Grows a wall of `thickness_mm` around a cavity: the union of what is labelled and of all that lies so near to the cavity, rounded
/// where the two meet by a radius of at most that thickness, so that the wall is just as thick elsewhere.
fn grow_wall(outline_mm: &mut [f64], cavity_mm: &[f64], thickness_mm: f64, rounding_mm: f64) {
    for (outline, cavity) in outline_mm.iter_mut().zip(cavity_mm) {
        *outline = -rounded_max(-*outline, thickness_mm - cavity, rounding_mm);
    }
}
