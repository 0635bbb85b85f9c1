//! The volume curve of a left ventricle and its landmarks, from a table, from labels of every frame, or from the images themselves,
//! \[Billet2009\] §6.2.

mod figures;
mod table;

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::RunError;
use super::cine::StudyCine;
use super::drawn_heart::DrawnHeart;
use super::plan::{AnatomySource, ImageSource, ImagesPlan, LabelsPlan, Plan, VolumeSource};
use crate::heart::Parameter;
use crate::image::{
    CavityContours, CineSequence, CineTiming, CurvePoint, ImageError, VolumeCurve, follow_cavity, read_label_maps, read_nifti,
};
use crate::report::{create_folder, write_csv};
use crate::units::MS_PER_S;

/// Weight λ of the second differences in the smooth curve.
const SMOOTHING: f64 = 0.5;

/// Where a volume curve comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum CurveSource {
    /// A study: its `images.volumes`, or its cine followed from the labels of its anatomy.
    Study(Box<Plan>),
    /// A label map of every frame.
    Labels {
        /// 4-D NIfTI.
        path: PathBuf,
        /// Trigger times and heart periods, JSON; the header's where absent.
        timing: Option<PathBuf>,
        /// Code of the left cavity.
        code: u8,
        /// Code of the right one; its curve is not known where absent.
        code_right: Option<u8>,
        /// Slices (index k) that count; all where absent.
        slices: Option<Range<usize>>,
    },
    /// A CSV file with the columns `time_s` and `volume_lv_ml`, and where known `volume_rv_ml`.
    Table {
        /// The file.
        path: PathBuf,
        /// Heart period.
        period_s: f64,
    },
}

/// A curve as measured, and what it was followed on.
struct Measured {
    curve: VolumeCurve,
    right: Option<VolumeCurve>,
    followed: Option<(CineSequence, CavityContours)>,
    source: &'static str,
    warnings: Vec<String>,
}

/// A row of `volumes.csv`.
#[derive(Serialize)]
struct VolumeRow {
    frame: usize,
    time_s: f64,
    volume_lv_ml: f64,
    volume_lv_smooth_ml: f64,
    volume_rv_ml: Option<f64>,
    volume_rv_smooth_ml: Option<f64>,
}

impl Measured {
    /// The smooth curves of the left and, where it is known, the right ventricle; of equal strokes where asked for.
    fn smoothed(&self, match_strokes: bool) -> Result<(VolumeCurve, Option<VolumeCurve>), ImageError> {
        match &self.right {
            Some(right) if match_strokes => {
                VolumeCurve::smoothed_to_equal_strokes(&self.curve, right, SMOOTHING).map(|(left, right)| (left, Some(right)))
            }
            right => Ok((self.curve.smoothed(SMOOTHING)?, right.as_ref().map(|right| right.smoothed(SMOOTHING)).transpose()?)),
        }
    }
}

/// Measures a volume curve, smooths it, writes `volumes.csv`, `volumes.png` and, where it was followed on images, `contours.png` into a
/// folder, and says what was found in a few lines.
///
/// # Errors
/// [`RunError::Image`] for what cannot be read or followed, [`RunError::NothingToFit`] for a study without images,
/// [`RunError::Report`] for files that cannot be written.
pub fn measure_volumes(source: &CurveSource, folder: &Path) -> Result<Vec<String>, RunError> {
    let measured = match source {
        CurveSource::Study(plan) => of_study(plan)?,
        CurveSource::Labels { path, timing, code, code_right, slices } => {
            let timing = timing.as_deref().map(CineTiming::from_sidecar).transpose()?.unwrap_or_default();
            let image = read_nifti(path)?;
            let times = timing.resolve(image.frames.len(), image.start_s, image.step_s);
            let (times_s, period_s) = times.map_err(|reason| ImageError::Unusable { path: path.clone(), reason })?;
            of_labels(path, *code, *code_right, slices.clone(), times_s, period_s)?
        }
        CurveSource::Table { path, period_s } => of_table(path, *period_s)?,
    };
    let (smooth, smooth_right) = measured.smoothed(match_strokes(source))?;
    create_folder(folder)?;
    let row = |frame: usize| VolumeRow {
        frame,
        time_s: smooth.times_s()[frame],
        volume_lv_ml: measured.curve.volumes_ml()[frame],
        volume_lv_smooth_ml: smooth.volumes_ml()[frame],
        volume_rv_ml: measured.right.as_ref().map(|right| right.volumes_ml()[frame]),
        volume_rv_smooth_ml: smooth_right.as_ref().map(|right| right.volumes_ml()[frame]),
    };
    write_csv(&folder.join("volumes.csv"), &(0..smooth.times_s().len()).map(row).collect::<Vec<_>>())?;
    figures::curve(&folder.join("volumes.png"), &measured.curve, &smooth)?;
    if let Some((cine, contours)) = &measured.followed {
        figures::contours(&folder.join("contours.png"), cine, contours, &smooth)?;
    }
    let warnings = measured.warnings.iter().map(|warning| format!("warning: {warning}"));
    let right = smooth_right.iter().map(|right| format!("RV: {}", landmarks(right)));
    Ok([format!("LV volumes {}", measured.source), landmarks(&smooth)].into_iter().chain(right).chain(warnings).collect())
}

fn match_strokes(source: &CurveSource) -> bool {
    match source {
        CurveSource::Study(plan) => matches!(&plan.images, Some(ImageSource::Cine(images)) if images.match_stroke_volumes),
        CurveSource::Labels { .. } | CurveSource::Table { .. } => false,
    }
}

/// The smooth volume curves of a study's left and, where it is measured, right ventricle.
///
/// # Errors
/// As [`measure_volumes`].
pub(super) fn smooth_curves(plan: &Plan) -> Result<(VolumeCurve, Option<VolumeCurve>), RunError> {
    let matched = matches!(&plan.images, Some(ImageSource::Cine(images)) if images.match_stroke_volumes);
    Ok(of_study(plan)?.smoothed(matched)?)
}

fn landmarks(curve: &VolumeCurve) -> String {
    let at = |point: CurvePoint| format!("{:.1} mL at {:.0} ms (frame {})", point.volume_ml, point.time_s * MS_PER_S, point.frame);
    let diastasis = curve.mid_diastole();
    let seen = if diastasis.pause_seen { "" } else { ", placed by its usual time: the curve shows no pause" };
    format!(
        "EDV {}, ESV {}, EF {:.1} %; diastasis {}{seen}",
        at(curve.end_diastole()),
        at(curve.end_systole()),
        100.0 * curve.ejection_fraction(),
        at(diastasis.point)
    )
}

/// The volume curve of a study's left ventricle as measured.
///
/// # Errors
/// As [`measure_volumes`].
pub(super) fn measured_curve(plan: &Plan) -> Result<VolumeCurve, RunError> {
    of_study(plan).map(|measured| measured.curve)
}

fn of_study(plan: &Plan) -> Result<Measured, RunError> {
    let Some(ImageSource::Cine(images)) = &plan.images else { return Err(RunError::NothingToFit) };
    let period_s = plan.written.contains(&Parameter::HeartPeriod.into()).then_some(plan.parameters[Parameter::HeartPeriod]);
    let drawn = match &plan.anatomy.source {
        AnatomySource::Labels(drawn) => Some(drawn),
        _ => None,
    };
    let study = StudyCine::read(images, period_s, drawn)?;
    let (times_s, period_s) = (study.cine.times_s().to_vec(), study.cine.period_s());
    match (&images.volumes, &plan.anatomy.source) {
        (VolumeSource::Labels { path, code, code_right, slices }, _) => {
            of_labels(path, *code, *code_right, slices.clone(), times_s, period_s)
        }
        (VolumeSource::Table(path), _) => of_table(path, period_s),
        (VolumeSource::Images, AnatomySource::Labels(drawn)) => of_images(images, study, drawn),
        (VolumeSource::Images, _) => Err(RunError::NothingToFit),
    }
}

fn of_images(images: &ImagesPlan, study: StudyCine, drawn: &LabelsPlan) -> Result<Measured, RunError> {
    let DrawnHeart { labels, codes, warnings: odd } = study.read_heart(drawn)?;
    let contours = follow_cavity(&study.cine, &labels, codes.cavity_lv, drawn.frame)?;
    let curve = VolumeCurve::new(study.cine.times_s().to_vec(), contours.volumes_ml(), study.cine.period_s())?;
    let moved = if images.correct_slice_shifts { ", slices moved into one breath-hold" } else { "" };
    let mut warnings = study.warnings;
    warnings.extend(odd);
    let slices: Vec<usize> = contours.slices.iter().map(|slice| slice.slice).collect();
    if let [first, .., last] = slices.as_slice() {
        warnings
            .push(format!("slices {first} to {last} count, as the labels have them: a base that moves through slices is not seen{moved}"));
    }
    Ok(Measured { curve, right: None, followed: Some((study.cine, contours)), source: "followed on the images", warnings })
}

fn of_labels(
    path: &Path,
    left: u8,
    right: Option<u8>,
    slices: Option<Range<usize>>,
    times_s: Vec<f64>,
    period_s: f64,
) -> Result<Measured, RunError> {
    let maps = read_label_maps(path)?;
    let slices = slices.unwrap_or(0..usize::MAX);
    let of = |code: u8| VolumeCurve::from_label_maps(&maps, code, slices.clone(), times_s.clone(), period_s);
    let (curve, right) = (of(left)?, right.map(of).transpose()?);
    Ok(Measured { curve, right, followed: None, source: "counted in the labels of every frame", warnings: Vec::new() })
}

fn of_table(path: &Path, period_s: f64) -> Result<Measured, RunError> {
    let table::Columns { times_s, left_ml, right_ml } = table::read(path)?;
    let right = right_ml.map(|volumes_ml| VolumeCurve::new(times_s.clone(), volumes_ml, period_s)).transpose()?;
    let curve = VolumeCurve::new(times_s, left_ml, period_s)?;
    Ok(Measured { curve, right, followed: None, source: "from a table", warnings: Vec::new() })
}
