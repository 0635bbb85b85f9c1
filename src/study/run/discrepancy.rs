//! What the images had to add to the model: distances to the boundary by surface and frame, and the work of image forces by region and
//! phase, the discrepancy that \[Billet2009\] §4.1 expects to fade as the model comes to fit.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::error::RunError;
use crate::anatomy::{Anatomy, Region};
use crate::circulation::Phase;
use crate::mesh::SurfaceTag;
use crate::report::write_csv;
use crate::tracking::{PhaseWork, TrackedMotion};

/// A row of `residuals.csv`: a surface in a frame.
#[derive(Debug, Clone, Serialize)]
struct ResidualRow {
    frame: usize,
    time_s: f64,
    surface: &'static str,
    vertex_count: usize,
    /// Vertices with a boundary point.
    found: usize,
    /// Mean signed distance, positive where the boundary lies outward of the mesh.
    mean_mm: f64,
    rms_mm: f64,
    held_out_rms_mm: Option<f64>,
}

/// A row of `work.csv`: a part of the wall in a phase of the left ventricle.
#[derive(Debug, Clone, Serialize)]
struct WorkRow {
    part: String,
    phase_lv: Phase,
    /// Work of the image forces on the wall; negative where they brake.
    work_uj: f64,
    /// Its magnitude, added up over steps and vertices: what pushes and brakes does not cancel.
    work_magnitude_uj: f64,
}

/// Writes `residuals.csv` and `work.csv`.
pub(super) fn write_discrepancy(folder: &Path, anatomy: &Anatomy, motion: &TrackedMotion) -> Result<(), RunError> {
    let residuals = motion.frames.iter().flat_map(|frame| {
        frame.residuals.iter().map(|residual| ResidualRow {
            frame: frame.frame,
            time_s: frame.time_s,
            surface: surface_name(residual.tag),
            vertex_count: residual.vertex_count,
            found: residual.found,
            mean_mm: residual.mean_mm,
            rms_mm: residual.rms_mm,
            held_out_rms_mm: residual.held_out_rms_mm,
        })
    });
    write_csv(&folder.join("residuals.csv"), &residuals.collect::<Vec<_>>())?;
    Ok(write_csv(&folder.join("work.csv"), &work_rows(anatomy, &motion.work))?)
}

/// Work of the image forces over the beat, magnitudes added up, mJ.
pub(super) fn work_magnitude_mj(motion: &TrackedMotion) -> f64 {
    motion.work.iter().map(|work| work.magnitude_uj).sum::<f64>() / 1000.0
}

/// Magnitudes of the work of the image forces by AHA segment, added up over the beat, mJ.
pub(super) fn segment_work_mj(anatomy: &Anatomy, motion: &TrackedMotion) -> Vec<(u8, f64)> {
    let number = |part: &str| part.strip_prefix("segment_")?.parse().ok();
    added_up_mj(anatomy, motion, number).into_iter().collect()
}

/// The same by region.
pub(super) fn region_work_mj(anatomy: &Anatomy, motion: &TrackedMotion) -> Vec<(String, f64)> {
    let name = |part: &str| (!part.starts_with("segment_")).then(|| part.to_owned());
    added_up_mj(anatomy, motion, name).into_iter().collect()
}

fn added_up_mj<K: Ord>(anatomy: &Anatomy, motion: &TrackedMotion, key: impl Fn(&str) -> Option<K>) -> BTreeMap<K, f64> {
    let mut sums = BTreeMap::new();
    for row in work_rows(anatomy, &motion.work) {
        if let Some(key) = key(&row.part) {
            *sums.entry(key).or_insert(0.0) += row.work_magnitude_uj / 1000.0;
        }
    }
    sums
}

fn surface_name(tag: SurfaceTag) -> &'static str {
    match tag {
        SurfaceTag::EndocardiumLv => "endocardium_lv",
        SurfaceTag::EndocardiumRv => "endocardium_rv",
        SurfaceTag::Epicardium => "epicardium",
        SurfaceTag::Base => "base",
    }
}

fn region_name(region: Region) -> &'static str {
    match region {
        Region::FreeWallLv => "free_wall_lv",
        Region::Septum => "septum",
        Region::FreeWallRv => "free_wall_rv",
        Region::Scar => "scar",
    }
}

/// The work by region, then by AHA segment. What is done on a vertex is shared out among its tetrahedra in proportion to their volume, so
/// that the regions add up to all of it.
fn work_rows(anatomy: &Anatomy, work: &[PhaseWork]) -> Vec<WorkRow> {
    let mut around: Vec<Vec<(usize, f64)>> = vec![Vec::new(); anatomy.mesh.vertex_count()];
    for (tetrahedron, corners) in anatomy.mesh.tetrahedra().iter().enumerate() {
        let volume_mm3 = anatomy.mesh.volume_mm3(tetrahedron);
        corners.iter().for_each(|&vertex| around[vertex].push((tetrahedron, volume_mm3)));
    }
    let mut regions: BTreeMap<(Region, usize), (Phase, [f64; 2])> = BTreeMap::new();
    let mut segments: BTreeMap<(u8, usize), (Phase, [f64; 2])> = BTreeMap::new();
    for one in work {
        let whole_mm3: f64 = around[one.vertex].iter().map(|(_, volume_mm3)| volume_mm3).sum();
        for &(tetrahedron, volume_mm3) in &around[one.vertex] {
            let parts = [one.work_uj, one.magnitude_uj].map(|part| part * volume_mm3 / whole_mm3);
            let add = |(_, sums): &mut (Phase, [f64; 2])| (0..2).for_each(|n| sums[n] += parts[n]);
            let (none, phase) = ((one.phase, [0.0; 2]), order(one.phase));
            add(regions.entry((anatomy.regions[tetrahedron], phase)).or_insert(none));
            if anatomy.aha_segments[tetrahedron] > 0 {
                add(segments.entry((anatomy.aha_segments[tetrahedron], phase)).or_insert(none));
            }
        }
    }
    let row =
        |part: String, (phase_lv, [work_uj, work_magnitude_uj]): (Phase, [f64; 2])| WorkRow { part, phase_lv, work_uj, work_magnitude_uj };
    let by_region = regions.into_iter().map(|((region, _), sums)| row(region_name(region).into(), sums));
    let by_segment = segments.into_iter().map(|((segment, _), sums)| row(format!("segment_{segment}"), sums));
    by_region.chain(by_segment).collect()
}

/// The phases in the order of the beat.
fn order(phase: Phase) -> usize {
    match phase {
        Phase::IsovolumetricContraction => 0,
        Phase::Ejection => 1,
        Phase::IsovolumetricRelaxation => 2,
        Phase::Filling => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::mesher::MesherSettings;
    use crate::anatomy::{AnatomySettings, IdealisedBiventricle};

    /// Regions add up to all the work in each phase, and segments to that of the left ventricle.
    #[test]
    fn the_parts_of_the_wall_share_the_work_out_whole() {
        let settings = AnatomySettings::default();
        let anatomy = IdealisedBiventricle::default().build(&MesherSettings::with_edge_length_mm(12.0), &settings).unwrap();
        let vertices = 0..anatomy.mesh.vertex_count();
        let work: Vec<PhaseWork> = [Phase::Ejection, Phase::Filling]
            .into_iter()
            .flat_map(|phase| vertices.clone().map(move |vertex| (phase, vertex)))
            .map(|(phase, vertex)| {
                let work_uj = (vertex as f64 * 0.7).sin() * if phase == Phase::Ejection { 2.0 } else { 1.0 };
                PhaseWork { phase, vertex, work_uj, magnitude_uj: work_uj.abs() }
            })
            .collect();
        let rows = work_rows(&anatomy, &work);
        for phase in [Phase::Ejection, Phase::Filling] {
            let all: f64 = work.iter().filter(|one| one.phase == phase).map(|one| one.work_uj).sum();
            let of = |is_part: fn(&str) -> bool| {
                let parts = rows.iter().filter(|row| row.phase_lv == phase && is_part(&row.part));
                parts.fold((0.0, 0.0), |(work, size), row| (work + row.work_uj, size + row.work_magnitude_uj))
            };
            let (regions, segments) = (of(|part| !part.starts_with("segment")), of(|part| part.starts_with("segment")));
            assert!((regions.0 - all).abs() < 1e-9, "{} of {all}", regions.0);
            assert!(0.0 < segments.1 && segments.1 < regions.1, "the right wall belongs to no segment");
        }
        assert_eq!(rows.first().map(|row| (row.part.as_str(), row.phase_lv)), Some(("free_wall_lv", Phase::Ejection)));
    }
}
