//! A ventricle's cavity followed through the beat on short-axis slices, from its labels on one frame: an active contour in polar
//! coordinates, solved by dynamic programming (\[Amini1990\]).
//!
//! On every slice the contour is the radius r(θ, t) about the labels' centre that minimises
//!
//! $$ E = \sum_{\theta,t} D_{\theta t}\big(r(\theta,t)\big) + \alpha \sum (r_{\theta+1} - r_\theta)^2 + \beta \sum (r_{t+1} - r_t)^2 , $$
//!
//! round the circle and round the beat. D asks for blood inside and wall outside, and for the reference frame's own profile across the
//! boundary (`rays.rs`). What is left between labels and contour on the reference frame, such as papillary muscles that
//! an expert counts to the cavity, is added to every frame: the curve keeps the convention of the labels.

mod rays;
mod ring;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::{CineSequence, Grid, ImageError, LabelMap};
use rays::{Rays, SliceSeed};

/// Rays a slice.
const ANGLES: usize = 48;

/// Distance between samples of a ray, mm.
const STEP_MM: f64 = 0.5;

/// Cavities smaller than this on a slice are left out, mm².
const AREA_MIN_MM2: f64 = 15.0;

/// Labels may lie off the image's slices by this share of their distance.
const OFF_SLICE: f64 = 0.25;

/// The cavity's contour on every slice that the labels show it on, at every frame.
#[derive(Debug, Clone, PartialEq)]
pub struct CavityContours {
    /// Its slices, index k ascending.
    pub slices: Vec<CavitySlice>,
    slice_distance_mm: f64,
}

/// The contour on one slice.
#[derive(Debug, Clone, PartialEq)]
pub struct CavitySlice {
    /// Index k of the cine.
    pub slice: usize,
    /// Centre of the rays, mm along the image's i and j axes from the first voxel.
    pub centre_mm: [f64; 2],
    /// Frames × angles: distance of the contour from the centre, mm; the angles are even, from the i axis towards the j axis.
    pub radii_mm: Vec<Vec<f64>>,
}

/// Follows the voxels of `code`, labelled on `reference_frame`, through all frames. Labels and images may lie on different grids with the
/// same slices.
///
/// # Errors
/// [`ImageError::UnusableMask`] if there is no such code or frame, the labels lie between the image's slices or outside of it, or the cavity is not
/// brighter than what surrounds it.
pub fn follow_cavity(cine: &CineSequence, labels: &LabelMap, code: u8, reference_frame: usize) -> Result<CavityContours, ImageError> {
    let unusable = |reason: String| ImageError::UnusableMask { reason };
    if reference_frame >= cine.frames().len() {
        return Err(unusable(format!("they were drawn on frame {reference_frame}, but the cine has {} frames", cine.frames().len())));
    }
    let seeds = seeds(cine.grid(), labels, code).map_err(unusable)?;
    let follow = |seed: &SliceSeed| {
        let rays = Rays::new(cine, seed, reference_frame)?;
        let steps = ring::least_energy(&rays.cost);
        let convention_mm: Vec<f64> = (0..ANGLES).map(|n| seed.radius_mm[n] - STEP_MM * steps[reference_frame][n] as f64).collect();
        let radius_mm = |(step, own): (&usize, &f64)| (STEP_MM * *step as f64 + own).max(0.0);
        let radii_mm = steps.iter().map(|frame| frame.iter().zip(&convention_mm).map(radius_mm).collect()).collect();
        Ok(CavitySlice { slice: seed.slice, centre_mm: seed.centre_mm, radii_mm })
    };
    let slices = seeds.par_iter().map(follow).collect::<Result<Vec<_>, String>>().map_err(unusable)?;
    Ok(CavityContours { slices, slice_distance_mm: cine.grid().spacing_mm().z })
}

impl CavityContours {
    /// Volume at every frame, mL: area times slice distance, summed over the slices.
    pub fn volumes_ml(&self) -> Vec<f64> {
        let frame_count = self.slices.first().map_or(0, |slice| slice.radii_mm.len());
        let area_mm2 = |frame: usize| self.slices.iter().map(|slice| slice.area_mm2(frame)).sum::<f64>();
        (0..frame_count).map(|frame| area_mm2(frame) * self.slice_distance_mm / 1000.0).collect()
    }
}

impl CavitySlice {
    /// Area at a frame, mm².
    pub fn area_mm2(&self, frame: usize) -> f64 {
        let radii_mm = &self.radii_mm[frame];
        let products = radii_mm.iter().zip(radii_mm.iter().cycle().skip(1)).map(|(a, b)| a * b);
        0.5 * (std::f64::consts::TAU / radii_mm.len() as f64).sin() * products.sum::<f64>()
    }

    /// The closed contour at a frame: mm along the image's i and j axes from the first voxel.
    pub fn outline_mm(&self, frame: usize) -> Vec<[f64; 2]> {
        let radii_mm = &self.radii_mm[frame];
        let point = |n: usize| {
            let (sine, cosine) = angle(n % radii_mm.len(), radii_mm.len()).sin_cos();
            let radius_mm = radii_mm[n % radii_mm.len()];
            [self.centre_mm[0] + radius_mm * cosine, self.centre_mm[1] + radius_mm * sine]
        };
        (0..=radii_mm.len()).map(point).collect()
    }
}

fn angle(n: usize, count: usize) -> f64 {
    std::f64::consts::TAU * n as f64 / count as f64
}

/// Centre and radii of the labels on every slice of the image that they show the cavity on.
fn seeds(grid: &Grid, labels: &LabelMap, code: u8) -> Result<Vec<SliceSeed>, String> {
    let [.., nk] = grid.shape();
    let mut sums = vec![(0.0, Vector3::zeros()); nk];
    for (flat, _) in labels.labels().iter().enumerate().filter(|(_, label)| **label == code) {
        let voxel = labels.grid().voxel_of(flat).map(|n| n as f64);
        let at = grid.to_voxel(&labels.grid().to_world_mm(&Vector3::from(voxel)));
        let slice = at.z.round();
        if (at.z - slice).abs() > OFF_SLICE {
            return Err(format!("they lie between the slices of the cine (at {:.2} slices); draw them on the cine's own slices", at.z));
        }
        let inside = slice >= 0.0 && slice < nk as f64 && (0..2).all(|axis| at[axis] > -0.5 && at[axis] < grid.shape()[axis] as f64 - 0.5);
        if !inside {
            return Err(format!("code {code} lies outside the cine at voxel ({:.1}, {:.1}, {:.1})", at.x, at.y, at.z));
        }
        let sum = &mut sums[slice as usize];
        *sum = (sum.0 + 1.0, sum.1 + at);
    }
    let label_mm = labels.grid().spacing_mm();
    let is_large = |count: f64| count * label_mm.x * label_mm.y >= AREA_MIN_MM2;
    let found = sums.iter().enumerate().filter(|(_, (count, _))| is_large(*count));
    let seeds: Vec<SliceSeed> = found.map(|(slice, (count, sum))| SliceSeed::new(grid, labels, code, slice, sum / *count)).collect();
    if seeds.is_empty() {
        return Err(format!("no slice shows code {code} on {AREA_MIN_MM2} mm² or more"));
    }
    Ok(seeds)
}

#[cfg(test)]
mod tests;
