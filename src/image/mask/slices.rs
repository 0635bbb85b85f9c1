//! The labelled slices of a ventricle: cleaned, checked for an open wall, ordered from apex to base.

use nalgebra::Vector2;

use super::{ApexEnd, FieldOptions, VentricleCodes};
use crate::image::{ImageError, LabelMap};

/// A slice whose cavity touches the background along more of its outline than this has an open wall.
const OPEN_FRACTION_MAX: f64 = 0.1;

/// Pixels by which the region surpasses the margin asked for, so that outlines can be smoothed in it.
const REGION_RESERVE_PIXELS: isize = 4;

/// One slice; masks are i fastest on the region's pixels.
#[derive(Debug)]
pub(super) struct LabelledSlice {
    /// Index k in the label map.
    pub(super) index: usize,
    /// The blood; `None` in a slice of wall alone, beyond the cavity's apex.
    pub(super) cavity: Option<Vec<bool>>,
    /// Blood and wall: what the epicardium encloses.
    pub(super) outline: Vec<bool>,
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
    pub(super) warnings: Vec<String>,
}

impl SliceStack {
    /// Finds, cleans, checks and orders the slices.
    pub(super) fn from_labels(labels: &LabelMap, codes: &VentricleCodes, options: &FieldOptions) -> Result<Self, ImageError> {
        let unusable = |reason: String| ImageError::UnusableMask { reason };
        let mut warnings = Vec::new();
        let region = Region::around(labels, codes, options, &mut warnings)?;
        let mut slices = Vec::new();
        for index in region.slices.clone() {
            let (cavity, outline) = (region.mask(labels, index, &[codes.cavity]), region.mask(labels, index, &[codes.cavity, codes.wall]));
            slices.extend(clean_slice(index, cavity, outline, region.shape, &mut warnings));
        }
        order_from_apex(&mut slices, options.apex, &mut warnings);
        drop_open_ends(&mut slices, region.shape, &mut warnings)?;
        if slices.iter().filter(|slice| slice.cavity.is_some()).count() < 2 {
            return Err(unusable(format!(
                "fewer than two slices hold a cavity (label {}) within a closed wall (label {})",
                codes.cavity, codes.wall
            )));
        }
        report_gaps(&slices, &mut warnings);
        let spacing_mm = labels.grid().spacing_mm().xy();
        Ok(Self { slices, shape: region.shape, first_pixel: region.first_pixel, spacing_mm, warnings })
    }
}

struct Region {
    slices: std::ops::Range<usize>,
    shape: [usize; 2],
    first_pixel: [isize; 2],
}

impl Region {
    fn around(labels: &LabelMap, codes: &VentricleCodes, options: &FieldOptions, warnings: &mut Vec<String>) -> Result<Self, ImageError> {
        let shape = labels.grid().shape();
        let slices = options.slices.clone().unwrap_or(0..shape[2]);
        let slices = slices.start..slices.end.min(shape[2]);
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for index in slices.clone() {
            for flat in 0..shape[0] * shape[1] {
                let at = [flat % shape[0], flat / shape[0]];
                let label = labels.at([at[0], at[1], index]);
                if label != 0 && (label == codes.cavity || label == codes.wall) {
                    for axis in 0..2 {
                        low[axis] = low[axis].min(at[axis]);
                        high[axis] = high[axis].max(at[axis]);
                    }
                }
            }
        }
        if low[0] == usize::MAX {
            let reason = format!("no voxel of slices {slices:?} has the label {} (cavity) or {} (wall)", codes.cavity, codes.wall);
            return Err(ImageError::UnusableMask { reason });
        }
        if (0..2).any(|axis| low[axis] == 0 || high[axis] + 1 == shape[axis]) {
            warnings.push("the labels touch the border of the image: the ventricle may be cut off".into());
        }
        let spacing_mm = labels.grid().spacing_mm();
        let margin = |axis: usize| (options.margin_mm / spacing_mm[axis]).ceil() as isize + REGION_RESERVE_PIXELS;
        let first_pixel = [0, 1].map(|axis| low[axis] as isize - margin(axis));
        let shape = [0, 1].map(|axis| (high[axis] - low[axis] + 1) + 2 * margin(axis) as usize);
        Ok(Self { slices, shape, first_pixel })
    }

    fn mask(&self, labels: &LabelMap, index: usize, codes: &[u8]) -> Vec<bool> {
        let whole = labels.grid().shape();
        let is_coded = |flat: usize| {
            let i = self.first_pixel[0] + (flat % self.shape[0]) as isize;
            let j = self.first_pixel[1] + (flat / self.shape[0]) as isize;
            let within = i >= 0 && j >= 0 && (i as usize) < whole[0] && (j as usize) < whole[1];
            within && codes.contains(&labels.at([i as usize, j as usize, index]))
        };
        (0..self.shape[0] * self.shape[1]).map(is_coded).collect()
    }
}

/// Keeps the largest connected parts and fills their holes; `None` for an empty slice.
fn clean_slice(
    index: usize,
    cavity: Vec<bool>,
    outline: Vec<bool>,
    shape: [usize; 2],
    warnings: &mut Vec<String>,
) -> Option<LabelledSlice> {
    let outline_part = largest_part(&outline, shape)?;
    let lost = count(&outline) - count(&outline_part);
    if lost > 0 {
        warnings.push(format!("slice {index}: {lost} labelled pixels apart from the ventricle were left out"));
    }
    let kept_cavity: Vec<bool> = cavity.iter().zip(&outline_part).map(|(&a, &b)| a && b).collect();
    let cavity = largest_part(&kept_cavity, shape).map(|part| filled(&part, shape));
    Some(LabelledSlice { index, cavity, outline: filled(&outline_part, shape) })
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

/// Drops slices with an open or missing wall from both ends, and wall without cavity from the basal end.
fn drop_open_ends(slices: &mut Vec<LabelledSlice>, shape: [usize; 2], warnings: &mut Vec<String>) -> Result<(), ImageError> {
    let defect = |slice: &LabelledSlice| {
        let open = slice.cavity.as_ref().map_or(0.0, |cavity| open_fraction(cavity, &slice.outline, shape));
        (open > OPEN_FRACTION_MAX).then(|| format!("slice {}: the wall is open along {:.0} % of the cavity", slice.index, 100.0 * open))
    };
    while let Some(last) = slices.last() {
        let reason =
            if last.cavity.is_none() { Some(format!("slice {}: wall without a cavity at the base", last.index)) } else { defect(last) };
        let Some(reason) = reason else { break };
        warnings.push(format!("{reason}; the slice was left out"));
        slices.pop();
    }
    while let Some(reason) = slices.first().and_then(defect) {
        warnings.push(format!("{reason}; the slice was left out"));
        slices.remove(0);
    }
    let cavity_begins = slices.iter().position(|slice| slice.cavity.is_some()).unwrap_or(slices.len());
    for slice in &slices[cavity_begins..] {
        let missing = slice.cavity.is_none().then(|| format!("slice {}: the cavity is missing between slices that have one", slice.index));
        if let Some(reason) = missing.or_else(|| defect(slice)) {
            return Err(ImageError::UnusableMask { reason: format!("{reason}; correct the labels or choose the slices") });
        }
    }
    Ok(())
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

/// The part of the cavity's pixel edges that touches neither cavity nor wall.
fn open_fraction(cavity: &[bool], outline: &[bool], shape: [usize; 2]) -> f64 {
    let (mut edges, mut open) = (0_usize, 0_usize);
    for flat in (0..cavity.len()).filter(|&flat| cavity[flat]) {
        for neighbour in neighbours(flat, shape).filter(|&n| !cavity[n]) {
            edges += 1;
            open += usize::from(!outline[neighbour]);
        }
    }
    open as f64 / edges.max(1) as f64
}
