//! Slices of one orientation, sorted by position and phase, as a cine sequence on one grid.

use nalgebra::{Matrix4, Vector3};

use super::instance::Instance;
use crate::image::phases::{CommonPhases, mixed};
use crate::image::timing::{median, slice_periods_ms};
use crate::image::{CineSequence, CineTiming, Grid, Volume};

/// Slices nearer to each other than this are at the same place, mm.
const SAME_PLACE_MM: f64 = 0.5;

/// Slices may lie off their regular places by this share of their distance.
const IRREGULAR: f64 = 0.1;

/// All instants of one slice, in order of time.
struct Slice<'a> {
    height_mm: f64,
    instances: Vec<&'a Instance>,
}

impl Slice<'_> {
    fn images(&self) -> Vec<&[f32]> {
        self.instances.iter().map(|instance| instance.values.as_slice()).collect()
    }
}

/// A cine on one grid and what was assumed.
pub(super) struct Assembled {
    pub(super) cine: CineSequence,
    pub(super) warnings: Vec<String>,
}

/// Whether two instances belong to one stack: same axes, spacing and size.
pub(super) fn are_parallel(a: &Instance, b: &Instance) -> bool {
    const COSINE: f64 = 0.9999;
    let same_axes = (0..2).all(|n| a.axes[n].dot(&b.axes[n]) > COSINE);
    same_axes && a.shape == b.shape && (0..2).all(|n| (a.spacing_mm[n] / b.spacing_mm[n] - 1.0).abs() < 1e-3)
}

/// Assembles parallel instances (at least one).
pub(super) fn assemble(instances: &[Instance], timing: &CineTiming) -> Result<Assembled, String> {
    let mut warnings = Vec::new();
    let slices = sorted_slices(instances, &mut warnings)?;
    let timing = StackTiming::of(&slices, timing, &mut warnings)?;
    let (grid, places) = regular_grid(&slices, &mut warnings)?;
    let frame_count = timing.times_s.len();
    // Slices × frames, every slice at the common phases.
    let by_slice: Vec<Vec<Vec<f32>>> = slices.iter().enumerate().map(|(n, slice)| timing.phases.resampled(n, &slice.images())).collect();
    let frame = |frame: usize| {
        let mut values = Vec::with_capacity(grid.voxel_count());
        for k in 0..grid.shape()[2] {
            values.extend(slice_at(k, &places, |slice| &by_slice[slice][frame]));
        }
        Volume::new(grid.clone(), values).map_err(|error| error.to_string())
    };
    let frames = (0..frame_count).map(frame).collect::<Result<Vec<_>, _>>()?;
    let cine = CineSequence::new(frames, timing.times_s, timing.period_s).map_err(|error| error.to_string())?;
    Ok(Assembled { cine, warnings })
}

/// Slices by height along the normal, each in order of time; of several series at one place the largest in the stack is kept.
fn sorted_slices<'a>(instances: &'a [Instance], warnings: &mut Vec<String>) -> Result<Vec<Slice<'a>>, String> {
    let normal = instances[0].normal();
    let height_mm = |instance: &Instance| normal.dot(&instance.position_mm);
    let mut sorted: Vec<&Instance> = instances.iter().collect();
    sorted.sort_by(|a, b| height_mm(a).total_cmp(&height_mm(b)));
    let mut slices: Vec<Slice<'_>> = Vec::new();
    for instance in sorted {
        let height_mm = height_mm(instance);
        match slices.last_mut() {
            Some(slice) if height_mm - slice.height_mm < SAME_PLACE_MM => slice.instances.push(instance),
            _ => slices.push(Slice { height_mm, instances: vec![instance] }),
        }
    }
    let size = |series: &str| instances.iter().filter(|instance| instance.series == series).count();
    for (n, slice) in slices.iter_mut().enumerate() {
        let largest = slice.instances.iter().map(|i| (size(&i.series), i.series.clone())).max().unwrap_or_default().1;
        let before = slice.instances.len();
        slice.instances.retain(|instance| instance.series == largest);
        if slice.instances.len() < before {
            warnings.push(format!("slice {n}: {} images of other series at the same place were left out", before - slice.instances.len()));
        }
        let time = |instance: &Instance| (instance.trigger_ms.unwrap_or(0.0), instance.number);
        slice.instances.sort_by(|a, b| time(a).0.total_cmp(&time(b).0).then(time(a).1.cmp(&time(b).1)));
        let before = slice.instances.len();
        slice.instances.dedup_by(|later, earlier| later.trigger_ms.is_some() && later.trigger_ms == earlier.trigger_ms);
        if slice.instances.len() < before {
            warnings.push(format!("slice {n}: {} images with a trigger time already met were left out", before - slice.instances.len()));
        }
    }
    let counts: Vec<usize> = slices.iter().map(|slice| slice.instances.len()).collect();
    let usual = usual_count(&counts);
    for (n, &count) in counts.iter().enumerate().filter(|(_, count)| **count != usual) {
        warnings.push(format!("slice {n} has {count} frames where most have {usual}"));
    }
    if usual < 2 {
        return Err("it shows one instant only; a cine has several".into());
    }
    // A slice of few frames says too little about the beat to be brought onto the phases of the others.
    slices.retain(|slice| 2 * slice.instances.len() > usual);
    Ok(slices)
}

fn usual_count(counts: &[usize]) -> usize {
    let met = |count: usize| counts.iter().filter(|&&other| other == count).count();
    counts.iter().copied().max_by_key(|&count| (met(count), count)).unwrap_or(0)
}

/// When the frames of a stack were taken.
struct StackTiming {
    times_s: Vec<f64>,
    period_s: f64,
    phases: CommonPhases,
}

impl StackTiming {
    fn of(slices: &[Slice<'_>], timing: &CineTiming, warnings: &mut Vec<String>) -> Result<Self, String> {
        let counts: Vec<usize> = slices.iter().map(|slice| slice.instances.len()).collect();
        let usual = usual_count(&counts);
        let all_triggered = slices.iter().all(|slice| slice.instances.iter().all(|instance| instance.trigger_ms.is_some()));
        if !all_triggered {
            // Without trigger times frames are taken as evenly spread, in the order of their numbers.
            let spread = |count: usize| (0..count).map(|n| n as f64 / count as f64).collect::<Vec<f64>>();
            let nominal: Vec<f64> = slices.iter().filter_map(|slice| slice.instances[0].period_ms).collect();
            let step_s = (!nominal.is_empty()).then(|| median(nominal) / 1000.0 / usual as f64);
            warnings.push("trigger times are missing: the frames were taken as evenly spread over the beat".into());
            let (times_s, period_s) = timing.resolve(usual, 0.0, step_s)?;
            let phases = CommonPhases { common: spread(usual), own: counts.into_iter().map(spread).collect() };
            return Ok(Self { times_s, period_s, phases });
        }
        let trigger_ms: Vec<Vec<f64>> =
            slices.iter().map(|slice| slice.instances.iter().filter_map(|instance| instance.trigger_ms).collect()).collect();
        let nominal: Vec<f64> = slices.iter().filter_map(|slice| slice.instances[0].period_ms).collect();
        let usual_slices: Vec<Vec<f64>> = trigger_ms.iter().filter(|times| times.len() == usual).cloned().collect();
        let nominal = if nominal.len() == slices.len() && usual_slices.len() == slices.len() { nominal } else { Vec::new() };
        let found = CineTiming::from_trigger_times_ms(&usual_slices, &nominal)?;
        warnings.extend(found.warnings.iter().cloned());
        let found_period_s = found.period_s.unwrap_or(1.0);
        let common: Vec<f64> = found.frame_times_s.iter().flatten().map(|time_s| time_s / found_period_s).collect();
        let period_s = timing.period_s.unwrap_or(found_period_s);
        let times = CineTiming {
            period_s: Some(period_s),
            frame_times_s: timing.frame_times_s.clone().or_else(|| Some(common.iter().map(|phase| phase * period_s).collect())),
            ..CineTiming::default()
        };
        let (times_s, period_s) = times.resolve(usual, 0.0, None)?;
        let periods_ms = slice_periods_ms(&trigger_ms, &nominal);
        let own = trigger_ms.iter().zip(&periods_ms).map(|(times, period)| times.iter().map(|t| t / period).collect()).collect();
        let phases = CommonPhases { common, own };
        let unfit = phases.unfit_slices();
        if !unfit.is_empty() {
            warnings.push(format!("slices {unfit:?} were taken at other phases of the beat: interpolated in time"));
        }
        Ok(Self { times_s, period_s, phases })
    }
}

/// The grid of a stack and the index k of every slice; slices missing between others leave a gap in the indices.
fn regular_grid(slices: &[Slice<'_>], warnings: &mut Vec<String>) -> Result<(Grid, Vec<usize>), String> {
    let first = slices[0].instances[0];
    let positions: Vec<Vector3<f64>> = slices.iter().map(|slice| slice.instances[0].position_mm).collect();
    let gaps_mm: Vec<f64> = slices.windows(2).map(|pair| pair[1].height_mm - pair[0].height_mm).collect();
    let mut places = vec![0];
    let step_mm = if gaps_mm.is_empty() { first.thickness_mm.unwrap_or(1.0) } else { median(gaps_mm.clone()) };
    for (n, gap_mm) in gaps_mm.iter().enumerate() {
        let steps = (gap_mm / step_mm).round();
        if steps < 1.0 || (gap_mm - steps * step_mm).abs() > IRREGULAR * step_mm {
            return Err(format!("slices {n} and {} are {gap_mm:.2} mm apart where others are {step_mm:.2} mm: no regular stack", n + 1));
        }
        if steps > 1.0 {
            warnings.push(format!("{} slices are missing between slices {n} and {}: interpolated", steps - 1.0, n + 1));
        }
        places.push(places[n] + steps as usize);
    }
    let last = places[places.len() - 1];
    let along = if last == 0 { first.normal() * step_mm } else { (positions[positions.len() - 1] - positions[0]) / last as f64 };
    for (n, position) in positions.iter().enumerate() {
        let off_mm = (position - positions[0] - along * places[n] as f64).norm();
        if off_mm > IRREGULAR * step_mm {
            return Err(format!("slice {n} lies {off_mm:.2} mm off its place in a regular stack"));
        }
    }
    let mut affine = Matrix4::identity();
    for (n, column) in [first.axes[0] * first.spacing_mm[0], first.axes[1] * first.spacing_mm[1], along, positions[0]].iter().enumerate() {
        affine.fixed_view_mut::<3, 1>(0, n).copy_from(column);
    }
    let grid = Grid::new([first.shape[0], first.shape[1], last + 1], affine).map_err(|error| error.to_string())?;
    Ok((grid, places))
}

/// The slice at index k, linear between its neighbours where it is missing.
fn slice_at<'a>(k: usize, places: &[usize], values: impl Fn(usize) -> &'a Vec<f32>) -> Vec<f32> {
    let above = places.partition_point(|&place| place < k).min(places.len() - 1);
    if places[above] == k {
        return values(above).clone();
    }
    let below = above - 1;
    let weight = (k - places[below]) as f32 / (places[above] - places[below]) as f32;
    mixed(values(below), values(above), weight)
}
