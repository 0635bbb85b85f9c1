//! How far slices lie beside their neighbours, from the images alone: windows around the heart are registered from slice to slice.
//!
//! With $o_k$ the offset at which slice k + 1 resembles slice k most, the shifts s obey
//!
//! $$ s_k - \tfrac12 (s_{k-1} + s_{k+1}) = \tfrac12 (o_{k-1} - o_k) = d_k , $$
//!
//! in which the steady drift of an oblique heart cancels. Errors of d grow into smooth curves of s, and a linear drift is invisible: of the
//! shifts that explain d the sparse ones are taken, min ‖A s − d‖² + μ Σ |s_k| by iteratively reweighted least squares, as few slices are
//! displaced and most lie right. A slice counts as estimable where both its neighbours resemble it well, and two halves of the beat agree.

use nalgebra::{DMatrix, DVector, Vector2, Vector3};
use rayon::prelude::*;

use super::SliceShifts;
use crate::image::{CineSequence, LabelMap};

/// Offsets beyond this are not looked for, mm.
const REACH_MM: f64 = 12.0;

/// At most this many frames are compared, spread over the beat; every second one belongs to the other half.
const FRAMES_MAX: usize = 4;

/// Distance from the heart's centre at which the window falls to 0.6, mm: beyond it are organs that the breath moves otherwise.
const WINDOW_MM: f64 = 45.0;

/// Pixels compared are at least this far apart, mm.
const PIXEL_MM: f64 = 1.2;

/// Correlation below which neighbouring slices do not show the same.
const LEAST_LIKENESS: f64 = 0.6;

/// Two halves of the beat may put a slice this far apart, mm.
const SPREAD_MM: f64 = 2.0;

/// Where the temporal deviation is below this share of its maximum, an image says nothing about where the heart is.
const MOVING_SHARE: f64 = 0.25;

/// Price μ of a shift, mm: an isolated shift comes out smaller by a third of it.
const PRICE_MM: f64 = 0.2;

/// Shifts below this are as good as none, mm.
const NEGLIGIBLE_MM: f64 = 0.05;

const REWEIGHTINGS: usize = 30;

/// Estimates the shift of every slice. The heart is looked for where `heart` is not zero, on each of its slices, and where the images change in time
/// without it. The outermost slices, and all of fewer than three, are not estimable.
pub fn estimate_slice_shifts(cine: &CineSequence, heart: Option<&LabelMap>) -> SliceShifts {
    let slice_count = cine.grid().shape()[2];
    if slice_count < 3 {
        return SliceShifts { shift_mm: vec![None; slice_count] };
    }
    let centres = heart.and_then(|labels| labelled_centres(cine, labels)).unwrap_or_else(|| vec![moving_centre(cine); slice_count]);
    let pair = |slice: usize| pair_offset_mm(cine, slice, (centres[slice] + centres[slice + 1]) * 0.5);
    let pairs: Vec<Option<Vector2<f64>>> = (0..slice_count - 1).into_par_iter().map(pair).collect();
    let offset = |slice: usize| Some((pairs[slice - 1]? - pairs[slice]?) * 0.5);
    let offsets: Vec<(usize, Vector2<f64>)> = (1..slice_count - 1).filter_map(|slice| Some((slice, offset(slice)?))).collect();
    let shifts = sparse_shifts(&offsets, slice_count);
    let mut shift_mm = vec![None; slice_count];
    for (slice, _) in offsets {
        shift_mm[slice] = Some(shifts[slice]);
    }
    SliceShifts { shift_mm }
}

/// Centre of the labels on every slice, mm along i and j from the first voxel; slices without labels take that of the nearest one with them.
fn labelled_centres(cine: &CineSequence, labels: &LabelMap) -> Option<Vec<Vector2<f64>>> {
    let grid = cine.grid();
    let slice_count = grid.shape()[2];
    let mut sums = vec![(0.0, Vector2::zeros()); slice_count];
    for (flat, _) in labels.labels().iter().enumerate().filter(|(_, label)| **label != 0) {
        let at = grid.to_voxel(&labels.grid().to_world_mm(&Vector3::from(labels.grid().voxel_of(flat).map(|n| n as f64))));
        if at.z > -0.5 && at.z.round() < slice_count as f64 {
            let sum = &mut sums[at.z.round().max(0.0) as usize];
            *sum = (sum.0 + 1.0, sum.1 + at.xy().component_mul(&grid.spacing_mm().xy()));
        }
    }
    let seen: Vec<usize> = (0..slice_count).filter(|&slice| sums[slice].0 > 0.0).collect();
    let nearest = |slice: usize| seen.iter().copied().min_by_key(|other| other.abs_diff(slice)).map(|slice| sums[slice].1 / sums[slice].0);
    (0..slice_count).map(nearest).collect()
}

/// Where most of what changes in time is gathered, mm along i and j from the first voxel: the mode of the temporal deviation over all slices.
fn moving_centre(cine: &CineSequence) -> Vector2<f64> {
    const WIDTH_MM: f64 = 40.0;
    const ROUNDS: usize = 12;
    let ni = cine.grid().shape()[0];
    let spacing_mm = cine.grid().spacing_mm().xy();
    let weights = moving_weights(cine);
    let place = |pixel: usize| Vector2::new((pixel % ni) as f64, (pixel / ni) as f64).component_mul(&spacing_mm);
    let mean = |weight: &dyn Fn(usize) -> f64| {
        let terms = (0..weights.len()).map(|pixel| (weight(pixel), place(pixel)));
        let (mass, moment) = terms.fold((0.0, Vector2::zeros()), |(mass, moment), (weight, at)| (mass + weight, moment + at * weight));
        if mass > 0.0 { moment / mass } else { place(weights.len() / 2) }
    };
    let start = mean(&|pixel| weights[pixel]);
    (0..ROUNDS)
        .fold(start, |centre, _| mean(&|pixel| weights[pixel] * (-0.5 * (place(pixel) - centre).norm_squared() / WIDTH_MM.powi(2)).exp()))
}

/// How much each pixel column changes in time, mean over the slices; 0 where little.
fn moving_weights(cine: &CineSequence) -> Vec<f64> {
    let [ni, nj, nk] = cine.grid().shape();
    let count = cine.frames().len() as f64;
    let deviation = |flat: usize| {
        let (sum, squares) = cine.frames().iter().fold((0.0, 0.0), |(sum, squares), frame| {
            let value = f64::from(frame.values()[flat]);
            (sum + value, squares + value * value)
        });
        (squares / count - (sum / count).powi(2)).max(0.0).sqrt()
    };
    let column = |pixel: usize| (0..nk).map(|k| deviation(pixel + ni * nj * k)).sum::<f64>() / nk as f64;
    let deviations: Vec<f64> = (0..ni * nj).into_par_iter().map(column).collect();
    let threshold = MOVING_SHARE * deviations.iter().copied().fold(0.0, f64::max);
    deviations.into_iter().map(|deviation| (deviation - threshold).max(0.0)).collect()
}

/// Offset (mm) at which the slice after `slice` resembles it most, around `centre_mm`; none if nothing there is alike, or the halves of the beat disagree.
fn pair_offset_mm(cine: &CineSequence, slice: usize, centre_mm: Vector2<f64>) -> Option<Vector2<f64>> {
    let spacing_mm = cine.grid().spacing_mm().xy();
    let reach = spacing_mm.map(|mm| (REACH_MM / mm).floor().max(1.0) as isize);
    let window = window(cine, centre_mm);
    let frame_count = cine.frames().len();
    let frames: Vec<usize> = (0..FRAMES_MAX.min(frame_count)).map(|n| n * frame_count / FRAMES_MAX.min(frame_count)).collect();
    let mut scores = [Scores::new(reach), Scores::new(reach), Scores::new(reach)];
    for (place, j) in (-reach.y..=reach.y).enumerate() {
        for i in -reach.x..=reach.x {
            let at = place * scores[0].width + (i + reach.x) as usize;
            for (n, &frame) in frames.iter().enumerate() {
                let alike = likeness(cine, frame, slice, &window, [i, j]);
                scores[n % 2].values[at] += alike;
                scores[2].values[at] += alike / frames.len() as f64;
            }
        }
    }
    let [one, other, both] = scores.map(|scores| scores.peak());
    let (offset, likeness) = both?;
    let apart = (one?.0 - other?.0).component_mul(&spacing_mm).norm();
    (likeness >= LEAST_LIKENESS && apart <= SPREAD_MM).then(|| offset.component_mul(&spacing_mm))
}

/// Pixels around the heart with their weights.
fn window(cine: &CineSequence, centre_mm: Vector2<f64>) -> Vec<([isize; 2], f64)> {
    const CUT: f64 = 0.02;
    let [ni, nj, _] = cine.grid().shape();
    let spacing_mm = cine.grid().spacing_mm().xy();
    let stride = spacing_mm.map(|mm| (PIXEL_MM / mm).round().max(1.0) as usize);
    let weight = |i: usize, j: usize| {
        let offset = Vector2::new(i as f64, j as f64).component_mul(&spacing_mm) - centre_mm;
        (-0.5 * (offset.norm_squared() / WINDOW_MM.powi(2)).powi(2)).exp()
    };
    let pixels = (0..nj).step_by(stride.y).flat_map(|j| (0..ni).step_by(stride.x).map(move |i| (i, j)));
    pixels.map(|(i, j)| ([i as isize, j as isize], weight(i, j))).filter(|(_, weight)| *weight > CUT).collect()
}

/// Weighted correlation of a slice with the one after it, taken `offset` pixels on, in one frame.
fn likeness(cine: &CineSequence, frame: usize, slice: usize, window: &[([isize; 2], f64)], offset: [isize; 2]) -> f64 {
    let [ni, nj, _] = cine.grid().shape();
    let values = cine.frames()[frame].values();
    let (here, next) = (&values[ni * nj * slice..ni * nj * (slice + 1)], &values[ni * nj * (slice + 1)..ni * nj * (slice + 2)]);
    let mut sums = [0.0; 6];
    for &([i, j], weight) in window {
        let (other_i, other_j) = (i + offset[0], j + offset[1]);
        if other_i < 0 || other_j < 0 || other_i >= ni as isize || other_j >= nj as isize {
            continue;
        }
        let reference = f64::from(here[i as usize + ni * j as usize]);
        let value = f64::from(next[other_i as usize + ni * other_j as usize]);
        let terms = [1.0, reference, value, reference * reference, value * value, reference * value];
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
    }
    let [mass, r, v, rr, vv, rv] = sums;
    let spread = ((rr * mass - r * r) * (vv * mass - v * v)).max(0.0).sqrt();
    if spread > 0.0 { (rv * mass - r * v) / spread } else { 0.0 }
}

/// Likeness at every offset within reach.
struct Scores {
    reach: Vector2<isize>,
    width: usize,
    values: Vec<f64>,
}

impl Scores {
    fn new(reach: Vector2<isize>) -> Self {
        let [width, height] = [reach.x, reach.y].map(|reach| 2 * reach as usize + 1);
        Self { reach, width, values: vec![0.0; width * height] }
    }

    /// The offset (pixels) of the greatest value, between pixels by parabolas, and that value; none at the edge of what was looked at.
    fn peak(&self) -> Option<(Vector2<f64>, f64)> {
        let best = (0..self.values.len()).fold(0, |best, n| if self.values[n] > self.values[best] { n } else { best });
        let (i, j) = ((best % self.width) as isize, (best / self.width) as isize);
        if i == 0 || j == 0 || i == 2 * self.reach.x || j == 2 * self.reach.y {
            return None;
        }
        let vertex = |step: usize| vertex(self.values[best - step], self.values[best], self.values[best + step]);
        let finer = Vector2::new(vertex(1), vertex(self.width));
        Some((Vector2::new((i - self.reach.x) as f64, (j - self.reach.y) as f64) + finer, self.values[best]))
    }
}

/// Where the parabola through three values at −1, 0, 1 has its maximum.
fn vertex(before: f64, centre: f64, after: f64) -> f64 {
    let curvature = before - 2.0 * centre + after;
    if curvature < 0.0 { (0.5 * (before - after) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}

/// The sparse shifts that explain the offsets of some inner slices.
fn sparse_shifts(offsets: &[(usize, Vector2<f64>)], slice_count: usize) -> Vec<Vector2<f64>> {
    let mut equations = DMatrix::zeros(offsets.len(), slice_count);
    for (row, (slice, _)) in offsets.iter().enumerate() {
        equations.fixed_view_mut::<1, 3>(row, slice - 1).copy_from_slice(&[-0.5, 1.0, -0.5]);
    }
    let normal = equations.transpose() * &equations;
    let along = |axis: usize| {
        let rhs = equations.transpose() * DVector::from_iterator(offsets.len(), offsets.iter().map(|(_, offset)| offset[axis]));
        let mut shifts = DVector::from_element(slice_count, 1.0);
        for _ in 0..REWEIGHTINGS {
            let prices = shifts.map(|shift: f64| 0.5 * PRICE_MM / (shift.abs() + NEGLIGIBLE_MM));
            let Some(factor) = (&normal + DMatrix::from_diagonal(&prices)).cholesky() else { break };
            shifts = factor.solve(&rhs);
        }
        shifts
    };
    let (i, j) = (along(0), along(1));
    (0..slice_count).map(|slice| Vector2::new(i[slice], j[slice])).collect()
}
