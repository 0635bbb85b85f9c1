//! The labelled slices of a heart: cleaned, checked for an open wall, ordered from apex to base.

use nalgebra::Vector2;

use super::{ApexEnd, FieldOptions, HeartCodes};
use crate::image::{ImageError, LabelMap};

/// A slice whose left cavity touches the background along more of its outline than this has an open wall; a right cavity that does so over
/// all slices has none labelled.
const OPEN_FRACTION_MAX: f64 = 0.1;

/// Pixels by which the region surpasses the margin asked for, so that outlines can be smoothed in it.
const REGION_RESERVE_PIXELS: isize = 4;

/// What to do about a left ventricle without a wall.
const REMEDY: &str = "; correct the labels or choose the slices, or set wall_thickness_lv_mm to have a wall grown where none is labelled";

/// One slice; masks are i fastest on the region's pixels.
#[derive(Debug)]
pub(super) struct LabelledSlice {
    /// Index k in the label map.
    pub(super) index: usize,
    /// The left blood; `None` in a slice of wall alone, beyond the cavity's apex.
    pub(super) cavity: Option<Vec<bool>>,
    /// The right blood; `None` below its apex, and everywhere if it is not asked for.
    pub(super) cavity_rv: Option<Vec<bool>>,
    /// Blood and labelled wall: what the epicardium encloses.
    pub(super) outline: Vec<bool>,
}

impl LabelledSlice {
    /// Outline without blood.
    pub(super) fn wall(&self) -> Vec<bool> {
        let is_blood = |flat: usize| [&self.cavity, &self.cavity_rv].into_iter().flatten().any(|mask| mask[flat]);
        (0..self.outline.len()).map(|flat| self.outline[flat] && !is_blood(flat)).collect()
    }
}

/// The usable slices from apex to base on a common region of pixels.
#[derive(Debug)]
pub(super) struct SliceStack {
    pub(super) slices: Vec<LabelledSlice>,
    /// Pixels of the region along i and j.
    pub(super) shape: [usize; 2],
    /// Index (i, j) in the label map of the region's first pixel; may lie outside of the map.
    pub(super) first_pixel: [isize; 2],
    pub(super) spacing_mm: Vector2<f64>,
    /// Thickness of the wall to be grown around the left cavity, mm, if it has no labelled one.
    pub(super) grown_lv_mm: Option<f64>,
    /// The same of the right cavity.
    pub(super) grown_rv_mm: Option<f64>,
    pub(super) warnings: Vec<String>,
}

impl SliceStack {
    /// Finds, cleans, checks and orders the slices.
    pub(super) fn from_labels(labels: &LabelMap, codes: &HeartCodes, options: &FieldOptions) -> Result<Self, ImageError> {
        let unusable = |reason: String| Err(ImageError::UnusableMask { reason });
        let mut warnings = Vec::new();
        let region = Region::around(labels, codes, options, &mut warnings)?;
        let has_rv = codes.cavity_rv.is_some();
        let mut slices = Vec::new();
        for index in region.slices.clone() {
            slices.extend(clean_slice(&RawSlice::of(&region, labels, index, codes), region.shape, &mut warnings));
        }
        if let Some(code) = codes.cavity_rv.filter(|_| slices.iter().all(|slice| slice.cavity_rv.is_none())) {
            return unusable(format!("no slice with a left ventricle holds a right cavity (label {code})"));
        }
        order_from_apex(&mut slices, options.apex, &mut warnings);
        drop_open_ends(&mut slices, has_rv, options.wall_thickness_lv_mm.is_some(), region.shape, &mut warnings)?;
        if slices.iter().filter(|slice| slice.cavity.is_some()).count() < 2 {
            let (cavity, wall) = (codes.cavity_lv, codes.wall_lv);
            return unusable(format!("fewer than two slices hold a cavity (label {cavity}) within a closed wall (label {wall}){REMEDY}"));
        }
        if let Some(code) = codes.cavity_rv
            && slices.iter().filter(|slice| slice.cavity_rv.is_some()).count() < 2
        {
            return unusable(format!("fewer than two slices with a closed left ventricle hold a right cavity (label {code})"));
        }
        let left = Opening::of(&slices, region.shape, |slice| slice.cavity.as_deref());
        let grown_lv_mm = options.wall_thickness_lv_mm.filter(|_| left.walled < left.slices);
        let right = Opening::of(&slices, region.shape, |slice| slice.cavity_rv.as_deref());
        let grown_rv_mm = (right.fraction > OPEN_FRACTION_MAX).then_some(options.wall_thickness_rv_mm);
        for (name, opening, grown_mm) in [("left", left, grown_lv_mm), ("right", right, grown_rv_mm)] {
            warnings.extend(grown_mm.and_then(|_| opening.warning(name)));
        }
        report_gaps(&slices, &mut warnings);
        let spacing_mm = labels.grid().spacing_mm().xy();
        Ok(Self { slices, shape: region.shape, first_pixel: region.first_pixel, spacing_mm, grown_lv_mm, grown_rv_mm, warnings })
    }
}

struct Region {
    slices: std::ops::Range<usize>,
    shape: [usize; 2],
    first_pixel: [isize; 2],
}

impl Region {
    fn around(labels: &LabelMap, codes: &HeartCodes, options: &FieldOptions, warnings: &mut Vec<String>) -> Result<Self, ImageError> {
        let shape = labels.grid().shape();
        let slices = options.slices.clone().unwrap_or(0..shape[2]);
        let slices = slices.start..slices.end.min(shape[2]);
        let all = codes.all();
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for index in slices.clone() {
            for flat in 0..shape[0] * shape[1] {
                let at = [flat % shape[0], flat / shape[0]];
                if all.contains(&labels.at([at[0], at[1], index])) {
                    for axis in 0..2 {
                        low[axis] = low[axis].min(at[axis]);
                        high[axis] = high[axis].max(at[axis]);
                    }
                }
            }
        }
        if low[0] == usize::MAX {
            let (cavity, wall) = (codes.cavity_lv, codes.wall_lv);
            let reason = format!("no voxel of slices {slices:?} has the label {cavity} (cavity) or {wall} (wall)");
            return Err(ImageError::UnusableMask { reason });
        }
        if (0..2).any(|axis| low[axis] == 0 || high[axis] + 1 == shape[axis]) {
            warnings.push("the labels touch the border of the image: the heart may be cut off".into());
        }
        let spacing_mm = labels.grid().spacing_mm();
        let margin = |axis: usize| (options.reach_mm(codes) / spacing_mm[axis]).ceil() as isize + REGION_RESERVE_PIXELS;
        let first_pixel = [0, 1].map(|axis| low[axis] as isize - margin(axis));
        let shape = [0, 1].map(|axis| (high[axis] - low[axis] + 1) + 2 * margin(axis) as usize);
        Ok(Self { slices, shape, first_pixel })
    }

    fn mask(&self, labels: &LabelMap, index: usize, is_counted: impl Fn(u8) -> bool) -> Vec<bool> {
        let whole = labels.grid().shape();
        let is_coded = |flat: usize| {
            let i = self.first_pixel[0] + (flat % self.shape[0]) as isize;
            let j = self.first_pixel[1] + (flat / self.shape[0]) as isize;
            let within = i >= 0 && j >= 0 && (i as usize) < whole[0] && (j as usize) < whole[1];
            within && is_counted(labels.at([i as usize, j as usize, index]))
        };
        (0..self.shape[0] * self.shape[1]).map(is_coded).collect()
    }
}

/// The pixels of one slice as they are labelled.
struct RawSlice {
    index: usize,
    cavity: Vec<bool>,
    cavity_rv: Vec<bool>,
    wall: Vec<bool>,
}

impl RawSlice {
    fn of(region: &Region, labels: &LabelMap, index: usize, codes: &HeartCodes) -> Self {
        Self {
            index,
            cavity: region.mask(labels, index, |code| code == codes.cavity_lv),
            cavity_rv: region.mask(labels, index, |code| Some(code) == codes.cavity_rv),
            wall: region.mask(labels, index, |code| codes.walls().contains(&code)),
        }
    }
}

/// Keeps the largest connected parts and fills their holes; `None` for a slice without a left ventricle.
fn clean_slice(raw: &RawSlice, shape: [usize; 2], warnings: &mut Vec<String>) -> Option<LabelledSlice> {
    let index = raw.index;
    let Some(left) = largest_part(&either(&raw.cavity, &raw.wall), shape) else {
        if raw.cavity_rv.contains(&true) {
            warnings.push(format!("slice {index}: a right ventricle without a left one; the slice was left out"));
        }
        return None;
    };
    let cavity = largest_part(&both(&raw.cavity, &left), shape).map(|part| filled(&part, shape));
    let right = largest_part(&raw.cavity_rv, shape);
    let outline = match &right {
        Some(right) => either(&left, &joined_to(right, &either(&raw.cavity_rv, &raw.wall), shape)),
        None => left,
    };
    let labelled = either(&either(&raw.cavity, &raw.cavity_rv), &raw.wall);
    let lost = count(&labelled) - count(&both(&labelled, &outline));
    if lost > 0 {
        warnings.push(format!("slice {index}: {lost} labelled pixels apart from the ventricle were left out"));
    }
    let is_left = |flat: usize| raw.wall[flat] || cavity.as_ref().is_some_and(|cavity| cavity[flat]);
    let cavity_rv =
        right.map(|right| filled(&right, shape).into_iter().enumerate().map(|(flat, inside)| inside && !is_left(flat)).collect());
    Some(LabelledSlice { index, cavity_rv, outline: filled(&outline, shape), cavity })
}

fn either(a: &[bool], b: &[bool]) -> Vec<bool> {
    a.iter().zip(b).map(|(&a, &b)| a || b).collect()
}

fn both(a: &[bool], b: &[bool]) -> Vec<bool> {
    a.iter().zip(b).map(|(&a, &b)| a && b).collect()
}

fn order_from_apex(slices: &mut [LabelledSlice], apex: ApexEnd, warnings: &mut Vec<String>) {
    let areas: Vec<usize> = slices.iter().filter_map(|slice| slice.cavity.as_deref().map(count)).collect();
    let end_area = |areas: &[usize]| areas.iter().take(2).sum::<usize>();
    let reversed: Vec<usize> = areas.iter().rev().copied().collect();
    let (first, last) = (end_area(&areas), end_area(&reversed));
    let is_last = match apex {
        ApexEnd::FirstSlice => false,
        ApexEnd::LastSlice => true,
        ApexEnd::Detect => {
            if first.max(last) * 4 < first.min(last) * 5 {
                warnings.push(format!(
                    "the cavity is about as large at both ends of the slices ({first} and {last} pixels in two slices): check which is the apex"
                ));
            }
            last < first
        }
    };
    if is_last {
        slices.reverse();
    }
}

/// Drops slices with an open or missing wall from both ends, unless a wall is grown, and from the basal end also those that do not show every
/// cavity.
fn drop_open_ends(
    slices: &mut Vec<LabelledSlice>,
    has_rv: bool,
    lv_may_be_open: bool,
    shape: [usize; 2],
    warnings: &mut Vec<String>,
) -> Result<(), ImageError> {
    let defect = |slice: &LabelledSlice| {
        let open = slice.cavity.as_ref().map_or(0.0, |cavity| open_fraction(&open_edges(cavity, &slice.outline, shape)));
        (!lv_may_be_open && open > OPEN_FRACTION_MAX)
            .then(|| format!("slice {}: the wall is open along {:.0} % of the cavity", slice.index, 100.0 * open))
    };
    while let Some(last) = slices.last() {
        let reason = match (&last.cavity, &last.cavity_rv) {
            (None, _) => Some(format!("slice {}: wall without a cavity at the base", last.index)),
            (_, None) if has_rv => Some(format!("slice {}: no right cavity at the base", last.index)),
            _ => defect(last),
        };
        let Some(reason) = reason else { break };
        warnings.push(format!("{reason}; the slice was left out"));
        slices.pop();
    }
    while let Some(reason) = slices.first().and_then(defect) {
        warnings.push(format!("{reason}; the slice was left out"));
        slices.remove(0);
    }
    let cavity_begins = slices.iter().position(|slice| slice.cavity.is_some()).unwrap_or(slices.len());
    let rv_begins = slices.iter().position(|slice| slice.cavity_rv.is_some()).unwrap_or(slices.len());
    for (place, slice) in slices.iter().enumerate().skip(cavity_begins) {
        let gap = |name: &str| Some(format!("slice {}: the {name}cavity is missing between slices that have one", slice.index));
        let missing = match (&slice.cavity, &slice.cavity_rv) {
            (None, _) => gap(""),
            (_, None) if place > rv_begins => gap("right "),
            _ => None,
        };
        if let Some(reason) = missing.or_else(|| defect(slice)) {
            return Err(ImageError::UnusableMask { reason: format!("{reason}{REMEDY}") });
        }
    }
    Ok(())
}

/// How far the wall around a cavity is open.
struct Opening {
    /// Share of the cavity's outline, over all slices, that touches the background.
    fraction: f64,
    /// The slices that show the cavity.
    slices: usize,
    /// Those of them in which it has a wall.
    walled: usize,
}

impl Opening {
    fn of(slices: &[LabelledSlice], shape: [usize; 2], cavity: fn(&LabelledSlice) -> Option<&[bool]>) -> Self {
        let edges_of = |slice: &LabelledSlice| cavity(slice).map(|cavity| open_edges(cavity, &slice.outline, shape));
        let edges: Vec<[usize; 2]> = slices.iter().filter_map(edges_of).collect();
        let total = edges.iter().fold([0, 0], |[all, open], edges| [all + edges[0], open + edges[1]]);
        let walled = edges.iter().filter(|edges| open_fraction(edges) <= OPEN_FRACTION_MAX).count();
        Self { fraction: open_fraction(&total), slices: edges.len(), walled }
    }

    /// What to say where a wall is grown although there is one in places.
    fn warning(&self, name: &str) -> Option<String> {
        let Self { slices, walled, .. } = self;
        (*walled > 0).then(|| format!("the {name} ventricle has a labelled wall in {walled} of {slices} slices only: it is grown in all"))
    }
}

fn report_gaps(slices: &[LabelledSlice], warnings: &mut Vec<String>) {
    for pair in slices.windows(2) {
        if pair[0].index.abs_diff(pair[1].index) > 1 {
            warnings.push(format!("no labels between slices {} and {}: the shape was interpolated", pair[0].index, pair[1].index));
        }
    }
}

/// The number of pixels of a mask.
pub(super) fn count(mask: &[bool]) -> usize {
    mask.iter().filter(|&&inside| inside).count()
}

/// The four neighbours of a pixel within a slice.
fn neighbours(flat: usize, shape: [usize; 2]) -> impl Iterator<Item = usize> {
    let (i, j) = (flat % shape[0], flat / shape[0]);
    let candidates = [
        (i > 0).then(|| flat - 1),
        (i + 1 < shape[0]).then(|| flat + 1),
        (j > 0).then(|| flat - shape[0]),
        (j + 1 < shape[1]).then(|| flat + shape[0]),
    ];
    candidates.into_iter().flatten()
}

/// The pixels reached from `seed` through pixels where `open` holds; marks them in `seen`.
fn flood(seed: usize, open: impl Fn(usize) -> bool, shape: [usize; 2], seen: &mut [bool]) -> Vec<usize> {
    let mut reached = vec![seed];
    seen[seed] = true;
    let mut next = 0;
    while next < reached.len() {
        for neighbour in neighbours(reached[next], shape) {
            if !seen[neighbour] && open(neighbour) {
                seen[neighbour] = true;
                reached.push(neighbour);
            }
        }
        next += 1;
    }
    reached
}

fn largest_part(mask: &[bool], shape: [usize; 2]) -> Option<Vec<bool>> {
    let mut seen = vec![false; mask.len()];
    let mut largest: Vec<usize> = Vec::new();
    for seed in 0..mask.len() {
        if mask[seed] && !seen[seed] {
            let part = flood(seed, |flat| mask[flat], shape, &mut seen);
            if part.len() > largest.len() {
                largest = part;
            }
        }
    }
    let mut part = vec![false; mask.len()];
    largest.iter().for_each(|&flat| part[flat] = true);
    (!largest.is_empty()).then_some(part)
}

/// The mask with its holes: everything that background from the region's corner does not reach.
fn filled(mask: &[bool], shape: [usize; 2]) -> Vec<bool> {
    let mut outside = vec![false; mask.len()];
    flood(0, |flat| !mask[flat], shape, &mut outside);
    outside.into_iter().map(|outside| !outside).collect()
}

/// The pixels of `within` that are joined to `seeds`.
fn joined_to(seeds: &[bool], within: &[bool], shape: [usize; 2]) -> Vec<bool> {
    let mut seen = vec![false; within.len()];
    for seed in (0..seeds.len()).filter(|&flat| seeds[flat]) {
        if !seen[seed] {
            flood(seed, |flat| within[flat], shape, &mut seen);
        }
    }
    seen
}

/// The pixel edges of a cavity's outline, and those of them that touch neither cavity nor wall.
fn open_edges(cavity: &[bool], outline: &[bool], shape: [usize; 2]) -> [usize; 2] {
    let (mut edges, mut open) = (0_usize, 0_usize);
    for flat in (0..cavity.len()).filter(|&flat| cavity[flat]) {
        for neighbour in neighbours(flat, shape).filter(|&n| !cavity[n]) {
            edges += 1;
            open += usize::from(!outline[neighbour]);
        }
    }
    [edges, open]
}

fn open_fraction(&[edges, open]: &[usize; 2]) -> f64 {
    open as f64 / edges.max(1) as f64
}
