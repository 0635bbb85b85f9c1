//! Rays from the centre of the cavity on one slice, and how well each place on them suits the boundary.
//!
//! With blood and wall of the reference frame as medians μ and deviations s (by the median deviation), a place r on a ray costs
//!
//! $$ D(r) = \overline{\min\!\big((\tfrac{\mu_b - I}{s_b})_+^2, 9\big)}\Big|_{r - 5}^{r} + \overline{\min\!\big((\tfrac{I - \mu_w}{s_w})_+^2, 9\big)}\Big|_{r}^{r + 4}
//!    + 9\, \overline{\min\!\big((\tfrac{I(r + u) - P(u)}{\mu_b - \mu_w})^2, 1\big)}\Big|_{u=-5}^{4} , $$
//!
//! lengths in mm: blood inside, wall outside, and the profile P that the ray has across the labels' boundary on the reference frame.

use super::{ANGLES, STEP_MM, angle};
use crate::image::timing::median;
use crate::image::{CineSequence, Grid, LabelMap, Volume};

use nalgebra::Vector3;

/// Samples looked at inside and outside of a boundary: 5 and 4 mm.
const INSIDE: usize = 10;
const OUTSIDE: usize = 8;

/// Deviations of intensity count no more than this, squared.
const DEVIATION_MAX: f64 = 9.0;

/// The deviations of blood and wall are at least this share of their contrast.
const DEVIATION_SHARE: f64 = 0.15;

/// The labelled cavity on one slice.
pub(super) struct SliceSeed {
    pub(super) slice: usize,
    pub(super) centre_mm: [f64; 2],
    /// Of the labels, by angle.
    pub(super) radius_mm: Vec<f64>,
}

impl SliceSeed {
    /// Radii of the labels about `centre` (voxels of the image).
    pub(super) fn new(grid: &Grid, labels: &LabelMap, code: u8, slice: usize, centre: Vector3<f64>) -> Self {
        let spacing = grid.spacing_mm();
        let centre_mm = [centre.x * spacing.x, centre.y * spacing.y];
        let reach_mm = 0.5 * (grid.shape()[0] as f64 * spacing.x).hypot(grid.shape()[1] as f64 * spacing.y);
        let radius_mm = |n: usize| {
            let (sine, cosine) = angle(n, ANGLES).sin_cos();
            let is_cavity = |radius_mm: f64| {
                let at = Vector3::new(
                    (centre_mm[0] + radius_mm * cosine) / spacing.x,
                    (centre_mm[1] + radius_mm * sine) / spacing.y,
                    slice as f64,
                );
                labels.at_position(&grid.to_world_mm(&at)) == Some(code)
            };
            // The outermost place: a hole in the labels is a papillary muscle.
            let fine_mm = 0.2 * STEP_MM;
            let outermost = (0..(reach_mm / fine_mm) as usize).rev().find(|&step| is_cavity(fine_mm * step as f64));
            outermost.map_or(0.0, |step| fine_mm * (step as f64 + 0.5))
        };
        Self { slice, centre_mm, radius_mm: (0..ANGLES).map(radius_mm).collect() }
    }
}

/// The cost of every place on every ray at every frame.
pub(super) struct Rays {
    /// Frames × angles × places.
    pub(super) cost: Vec<Vec<Vec<f64>>>,
}

/// Intensities of blood or wall.
struct Tissue {
    median: f64,
    deviation: f64,
}

impl Rays {
    pub(super) fn new(cine: &CineSequence, seed: &SliceSeed, reference_frame: usize) -> Result<Self, String> {
        let largest_mm = seed.radius_mm.iter().copied().fold(0.0, f64::max);
        // Room for the growth from end-systole to end-diastole.
        let places = ((1.3 * largest_mm + 6.0) / STEP_MM) as usize;
        let profiles = |frame: &Volume| (0..ANGLES).map(|n| profile(frame, seed, n, places + OUTSIDE)).collect::<Vec<_>>();
        let reference = profiles(&cine.frames()[reference_frame]);
        let boundary: Vec<f64> = seed.radius_mm.iter().map(|radius_mm| radius_mm / STEP_MM).collect();
        let (blood, wall) = tissues(&reference, &boundary);
        let contrast = blood.median - wall.median;
        if contrast <= 0.0 {
            return Err(format!(
                "on slice {} of frame {reference_frame} the cavity (median intensity {:.0}) is not brighter than its wall ({:.0}); \
                 were they drawn on another frame?",
                seed.slice, blood.median, wall.median
            ));
        }
        let [blood, wall] = [blood, wall].map(|tissue| Tissue { deviation: tissue.deviation.max(DEVIATION_SHARE * contrast), ..tissue });
        let across =
            |n: usize| (0..INSIDE + OUTSIDE + 1).map(|u| interpolated(&reference[n], boundary[n] + u as f64 - INSIDE as f64)).collect();
        let patterns: Vec<Vec<f64>> = (0..ANGLES).map(across).collect();
        let cost = |frame: &Volume| {
            let by_angle = profiles(frame).into_iter().zip(&patterns);
            by_angle.map(|(profile, pattern)| place_costs(&profile, pattern, &blood, &wall, places)).collect()
        };
        Ok(Self { cost: cine.frames().iter().map(cost).collect() })
    }
}

/// Intensities along a ray, bilinear in the slice; beyond the image that of its border.
fn profile(frame: &Volume, seed: &SliceSeed, n: usize, count: usize) -> Vec<f64> {
    let [ni, nj, _] = frame.grid().shape();
    let spacing = frame.grid().spacing_mm();
    let (sine, cosine) = angle(n, ANGLES).sin_cos();
    let at = |step: usize| {
        let radius_mm = STEP_MM * step as f64;
        let x = ((seed.centre_mm[0] + radius_mm * cosine) / spacing.x).clamp(0.0, (ni - 1) as f64);
        let y = ((seed.centre_mm[1] + radius_mm * sine) / spacing.y).clamp(0.0, (nj - 1) as f64);
        let (i, j) = (x as usize, y as usize);
        let (u, v) = (x - i as f64, y - j as f64);
        let value = |i: usize, j: usize| f64::from(frame.at([i.min(ni - 1), j.min(nj - 1), seed.slice]));
        let row = |j: usize| value(i, j) + u * (value(i + 1, j) - value(i, j));
        row(j) + v * (row(j + 1) - row(j))
    };
    (0..count).map(at).collect()
}

/// Blood within the boundary and wall around it, of all rays.
fn tissues(profiles: &[Vec<f64>], boundary: &[f64]) -> (Tissue, Tissue) {
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    for (profile, boundary) in profiles.iter().zip(boundary) {
        let edge = (boundary.ceil() as usize).min(profile.len() - OUTSIDE);
        inside.extend_from_slice(&profile[..edge]);
        outside.extend_from_slice(&profile[edge..edge + OUTSIDE]);
    }
    (Tissue::of(&inside), Tissue::of(&outside))
}

impl Tissue {
    fn of(values: &[f64]) -> Self {
        if values.is_empty() {
            return Self { median: 0.0, deviation: 0.0 };
        }
        let middle = median(values.to_vec());
        // 1.4826 makes the median deviation the standard deviation of a normal distribution.
        Self { median: middle, deviation: 1.4826 * median(values.iter().map(|value| (value - middle).abs()).collect()) }
    }
}

fn interpolated(profile: &[f64], at: f64) -> f64 {
    let at = at.clamp(0.0, (profile.len() - 1) as f64);
    let lower = (at as usize).min(profile.len() - 2);
    profile[lower] + (at - lower as f64) * (profile[lower + 1] - profile[lower])
}

fn place_costs(profile: &[f64], pattern: &[f64], blood: &Tissue, wall: &Tissue, places: usize) -> Vec<f64> {
    let squared = |deviation: f64| deviation.max(0.0).powi(2).min(DEVIATION_MAX);
    let no_blood: Vec<f64> = profile.iter().map(|value| squared((blood.median - value) / blood.deviation)).collect();
    let no_wall: Vec<f64> = profile.iter().map(|value| squared((value - wall.median) / wall.deviation)).collect();
    let contrast = blood.median - wall.median;
    let cost = |place: usize| {
        // Towards the centre the window is cut off; what is not there costs nothing.
        let inside = no_blood[place.saturating_sub(INSIDE)..place].iter().sum::<f64>() / INSIDE as f64;
        let outside = no_wall[place..place + OUTSIDE].iter().sum::<f64>() / OUTSIDE as f64;
        let unlike = |(u, expected): (usize, &f64)| {
            let value = profile[(place + u).saturating_sub(INSIDE).min(profile.len() - 1)];
            ((value - expected) / contrast).powi(2).min(1.0)
        };
        let differences: f64 = pattern.iter().enumerate().map(unlike).sum();
        inside + outside + DEVIATION_MAX * differences / pattern.len() as f64
    };
    (0..places).map(cost).collect()
}
