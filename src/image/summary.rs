//! What an image is, for people: grid, spacing, orientation, frames, times, and what is odd about it.

use nalgebra::Vector3;

use super::frame_order::frame_warnings;
use super::timing::median;
use super::{CineSequence, Grid, Volume, estimate_slice_shifts};

/// Slice shifts above this are reported, mm.
const SHIFT_REPORTED_MM: f64 = 2.5;

/// A step longer than this many usual ones has lost frames.
const MISSING_FRAME: f64 = 1.6;

/// Frame steps that differ by more than this fraction are reported.
const UNEVEN_STEP: f64 = 0.1;

/// More different values than this are intensities, not labels.
const CODES_MAX: usize = 32;

/// An image in a few numbers.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ImageSummary {
    /// Name of the file or of the scanner's series.
    pub name: String,
    /// Voxels along i, j, k.
    pub shape: [usize; 3],
    /// Distance between voxel centres, mm.
    pub spacing_mm: [f64; 3],
    /// The world direction that each voxel axis is nearest to, one letter an axis: R(ight), L(eft), A(nterior), P(osterior), S(uperior),
    /// I(nferior).
    pub orientation: String,
    /// Largest angle between an axis and that direction, degrees.
    pub obliquity_deg: f64,
    /// World position of the centre, mm.
    pub centre_mm: [f64; 3],
    /// Number of frames.
    pub frame_count: usize,
    /// Frame times after the trigger, s; empty where they are not known.
    pub frame_times_s: Vec<f64>,
    /// Heart period, s, where it is known.
    pub period_s: Option<f64>,
    /// Smallest and largest value of all frames.
    pub intensity_range: [f64; 2],
    /// The codes of a label map; empty for an image of intensities.
    pub labels: Vec<LabelSummary>,
    /// How far each slice lies beside where its neighbours suggest, mm along i and j, none where that cannot be told; empty for labels.
    pub slice_shifts_mm: Vec<Option<[f64; 2]>>,
    /// What is odd, in words.
    pub warnings: Vec<String>,
}

/// One code of a label map.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct LabelSummary {
    /// The code.
    pub code: u8,
    /// Its volume at every frame, mL.
    pub volumes_ml: Vec<f64>,
}

impl ImageSummary {
    /// Summarises a cine sequence, or a label map at every frame; `warnings` of its reading come first.
    pub fn of_cine(name: &str, cine: &CineSequence, warnings: &[String]) -> Self {
        let mut summary = Self::of_frames(name, cine.frames(), warnings);
        summary.frame_times_s = cine.times_s().to_vec();
        summary.period_s = Some(cine.period_s());
        if summary.labels.is_empty() {
            summary.warnings.extend(cine_warnings(cine));
            let shifts = estimate_slice_shifts(cine, None);
            summary.warnings.extend(shifts.warnings(SHIFT_REPORTED_MM));
            summary.slice_shifts_mm = shifts.shift_mm.iter().map(|shift| shift.map(|shift| [shift.x, shift.y])).collect();
        } else {
            summary.warnings.extend(timing_warnings(cine));
        }
        summary
    }

    /// Summarises frames (at least one) whose times are not known.
    pub fn of_frames(name: &str, frames: &[Volume], warnings: &[String]) -> Self {
        let grid = frames[0].grid();
        let shape = grid.shape();
        let (orientation, obliquity_deg) = orientation(grid);
        let values = frames.iter().flat_map(|frame| frame.values()).map(|&v| f64::from(v));
        let intensity_range = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
        let labels = labels(frames);
        let mut warnings = warnings.to_vec();
        warnings.extend(geometry_warnings(grid));
        if labels.is_empty() {
            warnings.extend(blank_warnings(frames));
        }
        Self {
            name: name.to_string(),
            shape,
            spacing_mm: grid.spacing_mm().into(),
            orientation,
            obliquity_deg,
            centre_mm: grid.to_world_mm(&Vector3::from(shape.map(|n| 0.5 * (n as f64 - 1.0)))).into(),
            frame_count: frames.len(),
            frame_times_s: Vec::new(),
            period_s: None,
            intensity_range,
            labels,
            slice_shifts_mm: Vec::new(),
            warnings,
        }
    }
}

/// What is odd about the times and the order of a beat's frames, in words.
pub fn cine_warnings(cine: &CineSequence) -> Vec<String> {
    timing_warnings(cine).into_iter().chain(frame_warnings(cine)).collect()
}

/// The codes of a label map, background left out; none if the values are not a few small whole numbers.
fn labels(frames: &[Volume]) -> Vec<LabelSummary> {
    let voxel_ml = frames[0].grid().voxel_volume_mm3() / 1000.0;
    let mut counts = vec![vec![0_usize; frames.len()]; 256];
    for (frame, volume) in frames.iter().enumerate() {
        for value in volume.values() {
            if value.fract() != 0.0 || !(0.0..=255.0).contains(value) {
                return Vec::new();
            }
            counts[*value as usize][frame] += 1;
        }
    }
    let met = counts.iter().enumerate().filter(|(code, counts)| *code > 0 && counts.iter().any(|count| *count > 0));
    let summary = |(code, counts): (usize, &Vec<usize>)| LabelSummary {
        code: code as u8,
        volumes_ml: counts.iter().map(|count| *count as f64 * voxel_ml).collect(),
    };
    let labels: Vec<LabelSummary> = met.map(summary).collect();
    if labels.len() < CODES_MAX { labels } else { Vec::new() }
}

fn orientation(grid: &Grid) -> (String, f64) {
    const NAMES: [[char; 2]; 3] = [['R', 'L'], ['A', 'P'], ['S', 'I']];
    let mut letters = String::new();
    let mut obliquity_deg: f64 = 0.0;
    for axis in 0..3 {
        let direction = grid.voxel_to_world().fixed_view::<3, 1>(0, axis).normalize();
        let world = direction.iamax();
        letters.push(NAMES[world][usize::from(direction[world] < 0.0)]);
        obliquity_deg = obliquity_deg.max(direction[world].abs().min(1.0).acos().to_degrees());
    }
    (letters, obliquity_deg)
}

fn timing_warnings(cine: &CineSequence) -> Vec<String> {
    let times_s = cine.times_s();
    let wrap_s = times_s[0] + cine.period_s() - times_s[times_s.len() - 1];
    let steps_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let usual_s = median(steps_s.clone());
    let mut warnings = Vec::new();
    for (frame, step_s) in steps_s.iter().enumerate().filter(|(_, step_s)| **step_s > MISSING_FRAME * usual_s) {
        let missing = (step_s / usual_s).round() as usize - 1;
        warnings.push(format!("{missing} frame(s) seem to be missing after frame {frame}: a gap of {:.0} ms", 1000.0 * step_s));
    }
    if wrap_s > MISSING_FRAME * usual_s {
        let covered = 100.0 * (1.0 - (wrap_s - usual_s) / cine.period_s());
        warnings
            .push(format!("the frames cover {covered:.0} % of the beat; {:.0} ms at its end are not seen", 1000.0 * (wrap_s - usual_s)));
    }
    let (least_s, most_s) = steps_s.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), &step| (least.min(step), most.max(step)));
    if warnings.is_empty() && most_s - least_s > UNEVEN_STEP * most_s {
        warnings.push(format!("the time between frames varies from {:.1} to {:.1} ms", 1000.0 * least_s, 1000.0 * most_s));
    }
    warnings
}

/// Slices or frames that are of one value throughout.
fn blank_warnings(frames: &[Volume]) -> Vec<String> {
    let [ni, nj, nk] = frames[0].grid().shape();
    let is_blank = |values: &[f32]| values.iter().all(|value| *value == values[0]);
    let plane = |frame: &Volume, k: usize| is_blank(&frame.values()[ni * nj * k..ni * nj * (k + 1)]);
    let slices: Vec<usize> = (0..nk).filter(|&k| ni * nj > 1 && frames.iter().all(|frame| plane(frame, k))).collect();
    let blank: Vec<usize> = (0..frames.len()).filter(|&frame| ni * nj > 1 && is_blank(frames[frame].values())).collect();
    let named = |what: &str, which: &[usize]| (!which.is_empty()).then(|| format!("{what} {which:?} are blank"));
    named("slices", &slices).into_iter().chain(named("frames", &blank)).collect()
}

fn geometry_warnings(grid: &Grid) -> Vec<String> {
    const SHEAR: f64 = 0.02;
    const THICK_MM: f64 = 12.0;
    let axis = |n: usize| grid.voxel_to_world().fixed_view::<3, 1>(0, n).normalize();
    let shear = [(0, 1), (0, 2), (1, 2)].map(|(a, b)| axis(a).dot(&axis(b)).abs()).into_iter().fold(0.0, f64::max);
    let mut warnings = Vec::new();
    if shear > SHEAR {
        warnings.push(format!("the voxel axes are not at right angles (cosine {shear:.3})"));
    }
    if grid.spacing_mm().z > THICK_MM {
        warnings.push(format!("the slices are {:.1} mm apart: gaps?", grid.spacing_mm().z));
    }
    if grid.shape()[2] < 5 {
        warnings.push(format!("it has {} slices only", grid.shape()[2]));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Volume;
    use nalgebra::Matrix4;

    /// i to the left, j to the back, k up; sheared; four slices 13 mm apart.
    fn grid() -> Grid {
        Grid::new([3, 3, 4], Matrix4::new(-2.0, 0.0, 1.0, 5.0, 0.0, -2.0, 0.0, 6.0, 0.0, 0.0, 13.0, 7.0, 0.0, 0.0, 0.0, 1.0)).unwrap()
    }

    fn frame(value: impl Fn(usize) -> f32) -> Volume {
        Volume::new(grid(), (0..36).map(value).collect()).unwrap()
    }

    #[test]
    fn orientation_times_and_oddities_are_told() {
        let textured = |n: usize| if n / 9 == 2 { 0.5 } else { n as f32 + 0.5 };
        let frames = vec![frame(textured), frame(|_| 4.5), frame(textured), frame(textured)];
        let cine = CineSequence::new(frames, vec![0.0, 0.1, 0.3, 0.4], 0.8).unwrap();
        let summary = ImageSummary::of_cine("sax", &cine, &["first".into()]);
        assert_eq!((summary.name.as_str(), summary.orientation.as_str()), ("sax", "LPS"));
        assert!((summary.obliquity_deg - (1.0_f64 / 13.0).atan().to_degrees()).abs() < 1e-9);
        assert_eq!(summary.intensity_range, [0.5, 35.5]);
        assert_eq!(summary.centre_mm, [5.0 - 2.0 + 1.5, 4.0, 7.0 + 19.5]);
        assert_eq!((summary.frame_times_s.len(), summary.period_s, summary.labels.len()), (4, Some(0.8), 0));
        let expected = [
            "first",
            "right angles",
            "apart",
            "4 slices",
            "slices [2] are blank",
            "frames [1] are blank",
            "1 frame(s) seem to be missing after frame 1",
            "cover 62 %",
        ];
        assert!(summary.warnings.len() >= expected.len(), "{:?}", summary.warnings);
        for (warning, part) in summary.warnings.iter().zip(expected) {
            assert!(warning.contains(part), "{warning}, not {part}");
        }
    }

    #[test]
    fn a_label_map_is_told_by_its_codes_and_volumes() {
        let summary = ImageSummary::of_frames("labels", &[frame(|n| (n % 4) as f32), frame(|_| 2.0)], &[]);
        let voxel_ml = grid().voxel_volume_mm3() / 1000.0;
        let expected = [(1, [9.0, 0.0]), (2, [9.0, 36.0]), (3, [9.0, 0.0])];
        assert_eq!(summary.labels.len(), 3);
        for (label, (code, counts)) in summary.labels.iter().zip(expected) {
            assert_eq!(label.code, code);
            assert!((0..2).all(|frame| (label.volumes_ml[frame] - counts[frame] * voxel_ml).abs() < 1e-9));
        }
        assert!(ImageSummary::of_frames("image", &[frame(|n| n as f32 - 1.0)], &[]).labels.is_empty());
    }
}
