//! What the wall of the left ventricle does in the last beat: `segments.csv`, `strains.csv` and its part of `summary.json`.
//!
//! Strains are engineering strains of line elements that lie around, along and across the wall at rest, against end-diastole.

use std::path::Path;

use serde::Serialize;

use super::error::RunError;
use crate::heart::{BeatDeformation, Deformation, HeartModel};
use crate::report::write_csv;

/// The wall at end-systole, as `summary.json` names it.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs, reason = "the names are the keys of the file, units last")]
pub(super) struct WallSummary {
    pub(super) end_diastole_s: f64,
    pub(super) end_systole_s: f64,
    pub(super) strain_circumferential_lv: f64,
    pub(super) strain_longitudinal_lv: f64,
    pub(super) strain_radial_lv: f64,
    pub(super) wall_thickening_lv: f64,
    pub(super) twist_lv_deg: f64,
    pub(super) torsion_lv_deg_per_mm: f64,
    pub(super) base_descent_mm: f64,
}

impl WallSummary {
    pub(super) fn new(beat: &BeatDeformation) -> Self {
        let Deformation { strain, wall_thickening, twist_deg, torsion_deg_per_mm, base_descent_mm, .. } = beat.end_systole;
        Self {
            end_diastole_s: beat.end_diastole_s,
            end_systole_s: beat.end_systole_s,
            strain_circumferential_lv: strain.circumferential,
            strain_longitudinal_lv: strain.longitudinal,
            strain_radial_lv: strain.radial,
            wall_thickening_lv: wall_thickening,
            twist_lv_deg: twist_deg,
            torsion_lv_deg_per_mm: torsion_deg_per_mm,
            base_descent_mm,
        }
    }
}

/// A row of `segments.csv`: one AHA segment.
#[derive(Debug, Clone, Serialize)]
pub(super) struct SegmentRow {
    pub(super) segment: u8,
    /// Mean of the depolarisation times.
    pub(super) activation_time_s: f64,
    pub(super) strain_circumferential_end_systole: f64,
    pub(super) strain_longitudinal_end_systole: f64,
    pub(super) strain_radial_end_systole: f64,
    pub(super) strain_circumferential_peak: f64,
    pub(super) strain_longitudinal_peak: f64,
    pub(super) strain_radial_peak: f64,
    pub(super) strain_circumferential_peak_time_s: f64,
    pub(super) thickness_end_diastole_mm: f64,
    /// Relative, at end-systole.
    pub(super) thickening: f64,
}

/// A row of `strains.csv`: one AHA segment at a frame.
#[derive(Debug, Clone, Serialize)]
struct StrainRow {
    time_s: f64,
    segment: u8,
    strain_circumferential: f64,
    strain_longitudinal: f64,
    strain_radial: f64,
}

/// The rows of `segments.csv`.
pub(super) fn segment_rows(model: &HeartModel, beat: &BeatDeformation) -> Vec<SegmentRow> {
    let activation_s = segment_activation_s(model);
    let row = |at_end: &crate::heart::SegmentDeformation| {
        let peak = beat.peak_strain(at_end.segment)?;
        Some(SegmentRow {
            segment: at_end.segment,
            activation_time_s: activation_s[usize::from(at_end.segment)],
            strain_circumferential_end_systole: at_end.strain.circumferential,
            strain_longitudinal_end_systole: at_end.strain.longitudinal,
            strain_radial_end_systole: at_end.strain.radial,
            strain_circumferential_peak: peak.strain.circumferential,
            strain_longitudinal_peak: peak.strain.longitudinal,
            strain_radial_peak: peak.strain.radial,
            strain_circumferential_peak_time_s: peak.circumferential_time_s,
            thickness_end_diastole_mm: at_end.thickness_mm,
            thickening: at_end.relative_thickening(),
        })
    };
    beat.end_systole.segments.iter().filter_map(row).collect()
}

/// Writes `segments.csv` and `strains.csv`.
pub(super) fn write_wall(folder: &Path, model: &HeartModel, beat: &BeatDeformation) -> Result<(), RunError> {
    write_csv(&folder.join("segments.csv"), &segment_rows(model, beat))?;
    let strains = beat.times_s.iter().zip(&beat.frames).flat_map(|(&time_s, frame)| {
        frame.segments.iter().map(move |segment| StrainRow {
            time_s,
            segment: segment.segment,
            strain_circumferential: segment.strain.circumferential,
            strain_longitudinal: segment.strain.longitudinal,
            strain_radial: segment.strain.radial,
        })
    });
    Ok(write_csv(&folder.join("strains.csv"), &strains.collect::<Vec<_>>())?)
}

/// Mean depolarisation time of every AHA segment, weighted by volume; 0 where the anatomy does not have it.
fn segment_activation_s(model: &HeartModel) -> [f64; 18] {
    let (anatomy, times_s) = (model.anatomy(), model.activation().times_s());
    let (mut sums, mut volumes) = ([0.0; 18], [0.0; 18]);
    for (tetrahedron, (&segment, corners)) in anatomy.aha_segments.iter().zip(anatomy.mesh.tetrahedra()).enumerate() {
        let volume_mm3 = anatomy.mesh.volume_mm3(tetrahedron);
        let place = usize::from(segment).min(17);
        sums[place] += volume_mm3 * corners.iter().map(|&vertex| times_s[vertex]).sum::<f64>() / 4.0;
        volumes[place] += volume_mm3;
    }
    std::array::from_fn(|segment| if volumes[segment] > 0.0 { sums[segment] / volumes[segment] } else { 0.0 })
}
