//! What the codes of a label map mean, and which frame of a cine it was drawn on, read off the voxels.

use super::files::DrawnCodes;
use crate::image::{CineSequence, HeartCodes, LabelMap, Volume};
use crate::numerics::mean;

/// A code with fewer voxels than this share of all that is drawn is a speck.
const SPECK: f64 = 0.005;

/// A right ventricle is at least this large beside the left one.
const RIGHT_TO_LEFT: f64 = 0.1;

/// What the codes seem to mean: of all, the one that touches the background least, for its size, is the left ventricle's blood; the one that it
/// touches most is its wall; a third one, if it touches that wall, is the right ventricle's blood. None for empty labels.
pub(super) fn codes_of(map: &LabelMap) -> Option<DrawnCodes> {
    let drawn = map.labels().iter().filter(|&&code| code != 0).count();
    let codes: Vec<u8> = (1..=u8::MAX).filter(|&code| map.count(code) as f64 > SPECK * drawn as f64 && drawn > 0).collect();
    let touching = faces(map);
    let between = |a: u8, b: u8| touching[usize::from(a) * 256 + usize::from(b)] as f64;
    let open = |code: &u8| between(*code, 0) / (1..=u8::MAX).chain([0]).map(|other| between(*code, other)).sum::<f64>().max(1.0);
    let cavity_lv = codes.iter().copied().min_by(|a, b| open(a).total_cmp(&open(b)))?;
    let others = || codes.iter().copied().filter(|&code| code != cavity_lv);
    let Some(wall_lv) = others().max_by(|&a, &b| between(cavity_lv, a).total_cmp(&between(cavity_lv, b))) else {
        return Some(DrawnCodes::Blood(cavity_lv));
    };
    let is_right = |code: &u8| {
        *code != wall_lv && between(*code, wall_lv) > 0.0 && map.count(*code) as f64 > RIGHT_TO_LEFT * map.count(cavity_lv) as f64
    };
    let cavity_rv = others().filter(is_right).max_by_key(|&code| map.count(code));
    Some(DrawnCodes::Heart(HeartCodes { cavity_lv, wall_lv, cavity_rv, wall_rv: None }))
}

/// Faces between voxels of two codes within the slices, at 256 a + b and at 256 b + a.
fn faces(map: &LabelMap) -> Vec<u32> {
    let [ni, nj, nk] = map.grid().shape();
    let mut touching = vec![0_u32; 256 * 256];
    let mut touch = |a: u8, b: u8| {
        if a != b {
            touching[usize::from(a) * 256 + usize::from(b)] += 1;
            touching[usize::from(b) * 256 + usize::from(a)] += 1;
        }
    };
    for k in 0..nk {
        for j in 0..nj {
            for i in 0..ni {
                let own = map.at([i, j, k]);
                if i + 1 < ni {
                    touch(own, map.at([i + 1, j, k]));
                }
                if j + 1 < nj {
                    touch(own, map.at([i, j + 1, k]));
                }
            }
        }
    }
    touching
}

/// A slice whose cavity follows that of the middle ventricle through the beat shows the ventricle (correlation).
const FOLLOWS: f64 = 0.7;

/// One that changes less than this within a frame, of its mean, holds still, and shows the ventricle if it does not do the opposite. Labels that
/// have left the ventricle for the atrium, the aorta or nothing at all do neither.
const STILL: f64 = 0.5;

/// The cavity in labels of every frame: which slices show the ventricle, and its volume on them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LabelledBeat {
    /// First and last slice that show the ventricle, where some do not.
    pub(super) slices: Option<[usize; 2]>,
    /// Volume of the cavity in those slices at every frame, mL.
    pub(super) volumes_ml: Vec<f64>,
}

impl LabelledBeat {
    /// Goes from the slice of the largest cavity towards base and apex while slices show the ventricle. Frames without labels do not count; where
    /// fewer than four have any, all slices are kept.
    pub(super) fn new(maps: &[LabelMap], code: u8) -> Self {
        let areas = areas(maps, code);
        let voxel_ml = maps.first().map_or(0.0, |map| map.grid().voxel_volume_mm3() / 1000.0);
        let on = |slices: Option<[usize; 2]>| {
            let [first, last] = slices.unwrap_or([0, areas.len().saturating_sub(1)]);
            let volume = |frame: usize| voxel_ml * areas.iter().take(last + 1).skip(first).map(|slice| slice[frame]).sum::<f64>();
            Self { slices, volumes_ml: (0..maps.len()).map(volume).collect() }
        };
        let found = on(ventricle(&areas));
        // A slice that the base enters in systole alone is empty at end-diastole, and need not be left out.
        let is_left_out = |slice: usize| found.slices.is_some_and(|[first, last]| !(first..=last).contains(&slice));
        let end_diastole = found.end_diastole();
        if (0..areas.len()).any(|slice| is_left_out(slice) && areas[slice][end_diastole] > 0.0) { found } else { on(None) }
    }

    /// The frame of the largest cavity; the first of several.
    pub(super) fn end_diastole(&self) -> usize {
        let larger = |best: usize, (frame, volume): (usize, &f64)| if *volume > self.volumes_ml[best] { frame } else { best };
        self.volumes_ml.iter().enumerate().fold(0, larger)
    }

    /// The labelled frame of the smallest cavity.
    pub(super) fn end_systole(&self) -> usize {
        let labelled = self.volumes_ml.iter().enumerate().filter(|(_, volume)| **volume > 0.0);
        labelled.min_by(|(_, a), (_, b)| a.total_cmp(b)).map_or(0, |(frame, _)| frame)
    }
}

/// Voxels of the cavity by slice and frame.
fn areas(maps: &[LabelMap], code: u8) -> Vec<Vec<f64>> {
    let Some([ni, nj, nk]) = maps.first().map(|map| map.grid().shape()) else { return Vec::new() };
    let area =
        |map: &LabelMap, k: usize| (0..nj).flat_map(|j| (0..ni).map(move |i| [i, j, k])).filter(|&v| map.at(v) == code).count() as f64;
    (0..nk).map(|k| maps.iter().map(|map| area(map, k)).collect()).collect()
}

/// First and last slice of the ventricle; none where that cannot be told.
fn ventricle(areas: &[Vec<f64>]) -> Option<[usize; 2]> {
    const LEAST_FRAMES: usize = 4;
    let labelled: Vec<usize> = (0..areas.first()?.len()).filter(|&frame| areas.iter().any(|slice| slice[frame] > 0.0)).collect();
    if labelled.len() < LEAST_FRAMES {
        return None;
    }
    let curve = |slice: usize| labelled.iter().map(|&frame| areas[slice][frame]).collect::<Vec<f64>>();
    let drawn: Vec<usize> = (0..areas.len()).filter(|&slice| mean(&curve(slice)) > 0.0).collect();
    let middle = &drawn[drawn.len() / 3..(2 * drawn.len()).div_ceil(3)];
    let core: Vec<f64> = (0..labelled.len()).map(|n| middle.iter().map(|&slice| curve(slice)[n]).sum()).collect();
    let is_ventricle = |&slice: &usize| {
        let own = curve(slice);
        let jump = own.iter().zip(own.iter().cycle().skip(1)).map(|(now, next)| (now - next).abs()).fold(0.0, f64::max);
        let follows = correlation(&own, &core);
        follows >= FOLLOWS || (follows >= 0.0 && jump <= STILL * mean(&own))
    };
    let start = middle.iter().copied().max_by(|&a, &b| mean(&curve(a)).total_cmp(&mean(&curve(b))))?;
    let last = drawn.iter().copied().filter(|&slice| slice >= start).take_while(is_ventricle).last()?;
    let first = drawn.iter().rev().copied().filter(|&slice| slice <= start).take_while(is_ventricle).last()?;
    // Slices beyond what is drawn stay in.
    Some([if drawn.first() == Some(&first) { 0 } else { first }, if drawn.last() == Some(&last) { areas.len() - 1 } else { last }])
}

/// Pearson's correlation; 0 where one of both does not change.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - mean_a) * (b - mean_b)).sum::<f64>();
    let size = |sample: &[f64], mean: f64| sample.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
    let sizes = (size(a, mean_a) * size(b, mean_b)).sqrt();
    if sizes > 0.0 { product(a, b) / sizes } else { 0.0 }
}

/// The frame on which the blood (voxels of `code`; any but 0 where none) differs most from what is just around it in the slice, in standard
/// deviations: outlines fit the frame that they were drawn on. None where labels and images do not lie in one place.
pub(super) fn best_frame(cine: &CineSequence, labels: &LabelMap, code: Option<u8>) -> Option<usize> {
    let (inside, around) = (voxels_of(cine, labels, code, false), voxels_of(cine, labels, code, true));
    let contrast = |frame: &Volume| {
        let [(mean_in, variance_in), (mean_out, variance_out)] = [&inside, &around].map(|voxels| moments(frame, voxels));
        (mean_in - mean_out) / (variance_in + variance_out).max(f64::MIN_POSITIVE).sqrt()
    };
    if inside.is_empty() || around.is_empty() {
        return None;
    }
    let contrasts = cine.frames().iter().map(contrast).enumerate().filter(|(_, contrast)| contrast.is_finite());
    contrasts.max_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(frame, _)| frame)
}

/// Voxels of the cine at labelled blood, or at the ring of two voxels around it in each slice.
fn voxels_of(cine: &CineSequence, labels: &LabelMap, code: Option<u8>, is_ring: bool) -> Vec<[usize; 3]> {
    const RING: usize = 2;
    let [ni, nj, nk] = labels.grid().shape();
    let is_blood = |voxel: [usize; 3]| code.map_or(labels.at(voxel) != 0, |code| labels.at(voxel) == code);
    let near = |n: usize, count: usize| n.saturating_sub(RING)..(n + RING + 1).min(count);
    let mut found = Vec::new();
    for voxel in (0..nk).flat_map(|k| (0..nj).flat_map(move |j| (0..ni).map(move |i| [i, j, k]))) {
        let [i, j, k] = voxel;
        let wanted = match (is_blood(voxel), is_ring) {
            (is_blood, false) => is_blood,
            (true, true) => false,
            (false, true) => near(i, ni).any(|i| is_blood([i, j, k])) || near(j, nj).any(|j| is_blood([i, j, k])),
        };
        if wanted {
            let world_mm = labels.grid().to_world_mm(&nalgebra::Vector3::new(i as f64, j as f64, k as f64));
            let place = cine.grid().to_voxel(&world_mm).map(f64::round);
            let is_within = (0..3).all(|axis| (0.0..cine.grid().shape()[axis] as f64).contains(&place[axis]));
            found.extend(is_within.then(|| [place.x as usize, place.y as usize, place.z as usize]));
        }
    }
    found
}

/// Mean and variance of an image at some voxels.
fn moments(frame: &Volume, voxels: &[[usize; 3]]) -> (f64, f64) {
    let values = || voxels.iter().map(|&voxel| f64::from(frame.at(voxel)));
    let count = voxels.len() as f64;
    let mean = values().sum::<f64>() / count;
    (mean, values().map(|value| (value - mean).powi(2)).sum::<f64>() / count)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::image::Grid;

    fn grid() -> Grid {
        Grid::axis_aligned([40, 30, 4], Vector3::new(-3.0, 8.0, 1.0), Vector3::new(1.5, 1.5, 8.0)).unwrap()
    }

    /// Rings of a left ventricle of inner radius `radius`, with a right one beside, in these codes.
    fn heart(radius: f64, blood: u8, wall: u8, right: u8) -> LabelMap {
        let code = |flat| {
            let [i, j, _] = grid().voxel_of(flat);
            let (x, y) = (i as f64 - 14.0, j as f64 - 15.0);
            match x.hypot(y) {
                r if r < radius => blood,
                r if r < 10.0 => wall,
                _ if (x - 12.0).hypot(y) < 8.0 => right,
                _ => 0,
            }
        };
        LabelMap::new(grid(), (0..grid().voxel_count()).map(code).collect()).unwrap()
    }

    #[test]
    fn codes_are_told_by_who_touches_whom_whatever_their_numbers() {
        let with_right = |codes: [u8; 3]| codes_of(&heart(6.0, codes[0], codes[1], codes[2]));
        for [cavity_lv, wall_lv, right] in [[1, 2, 3], [3, 2, 1], [40, 200, 7]] {
            let expected = HeartCodes { cavity_lv, wall_lv, cavity_rv: Some(right), wall_rv: None };
            assert_eq!(with_right([cavity_lv, wall_lv, right]), Some(DrawnCodes::Heart(expected)));
        }
        assert_eq!(codes_of(&heart(6.0, 1, 2, 0)), Some(DrawnCodes::Heart(HeartCodes::left(1, 2))));
        assert_eq!(codes_of(&heart(6.0, 5, 0, 0)), Some(DrawnCodes::Blood(5)));
        assert_eq!(codes_of(&heart(6.0, 0, 0, 0)), None);
    }

    /// A ventricle of 60 to 30 mL over eight frames in six slices, and above it two slices whose labels have gone astray: they are larger in systole.
    #[test]
    fn labels_above_the_ventricle_do_not_make_end_diastole() {
        let grid = Grid::axis_aligned([40, 30, 8], Vector3::zeros(), Vector3::new(2.0, 2.0, 8.0)).unwrap();
        let contraction = [0.9, 1.0, 0.8, 0.6, 0.5, 0.6, 0.75, 0.85];
        let map = |stray: bool, share: f64| {
            let code = |flat| {
                let [i, j, k] = grid.voxel_of(flat);
                let astray = stray && k >= 6;
                let radius = if astray { 15.0 * (1.4 - share) } else { (k as f64 + 4.0) * share.sqrt() };
                u8::from((i as f64 - 20.0).hypot(j as f64 - 15.0) < radius)
            };
            LabelMap::new(grid.clone(), (0..grid.voxel_count()).map(code).collect()).unwrap()
        };
        let beat = |stray: bool| LabelledBeat::new(&contraction.map(|share| map(stray, share)), 1);
        assert_eq!((beat(false).slices, beat(false).end_diastole(), beat(false).end_systole()), (None, 1, 4));
        assert_eq!((beat(true).slices, beat(true).end_diastole(), beat(true).end_systole()), (Some([0, 5]), 1, 4));
        // Two frames of a beat say nothing of how it goes on.
        let empty = || LabelMap::new(grid.clone(), vec![0; grid.voxel_count()]).unwrap();
        let two = LabelledBeat::new(&[empty(), map(false, 1.0), empty(), map(false, 0.5)], 1);
        assert_eq!((two.slices, two.end_diastole(), two.end_systole()), (None, 1, 3));
    }

    #[test]
    fn outlines_are_given_back_to_the_frame_that_they_were_drawn_on() {
        let radii = [8.0, 7.0, 6.0, 5.0, 6.5, 7.5];
        let image = |radius: f64| {
            let brightness = |(n, &code): (usize, &u8)| match code {
                1 => 200.0 + (n % 7) as f32,
                2 => 80.0 + (n % 5) as f32,
                _ => 40.0 + (n % 3) as f32,
            };
            Volume::new(grid(), heart(radius, 1, 2, 0).labels().iter().enumerate().map(brightness).collect()).unwrap()
        };
        let times_s = (0..radii.len()).map(|n| 0.1 * n as f64).collect();
        let cine = CineSequence::new(radii.map(image).to_vec(), times_s, 0.6).unwrap();
        for (frame, radius) in radii.into_iter().enumerate() {
            assert_eq!(best_frame(&cine, &heart(radius, 1, 2, 0), Some(1)), Some(frame));
        }
        let elsewhere = Grid::axis_aligned([4, 4, 2], Vector3::repeat(900.0), Vector3::repeat(1.0)).unwrap();
        assert_eq!(best_frame(&cine, &LabelMap::new(elsewhere, vec![1; 32]).unwrap(), Some(1)), None);
    }
}
