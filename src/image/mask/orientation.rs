//! How labels lie: which axis the slices follow, one set of voxels stored in several orders, and a base plane across the slices.

use std::borrow::Cow;

use nalgebra::{Matrix4, Vector3};

use super::Plane;
use super::frame::SliceFrame;
use crate::image::{Grid, ImageError, LabelMap, Volume};

/// Voxels this much longer along i or j than along k say that the slices follow that axis.
const SLICE_RATIO: f64 = 1.5;

/// Voxel centres this far apart, in voxels, are the same voxel.
const SAME_VOXEL: f64 = 0.05;

/// The base plane may lean by this much against the slices: cos 60°.
const LEAN_COSINE_MIN: f64 = 0.5;

/// The base plane may reach this far beyond the labels without a word, mm.
const EXTRAPOLATION_REPORTED_MM: f64 = 1.0;

/// The labels with their slices along k: the axis of the longest voxel edge.
pub(super) fn slices_along_k(labels: &LabelMap) -> Result<(Cow<'_, LabelMap>, Vec<String>), ImageError> {
    let spacing_mm = labels.grid().spacing_mm();
    let axis = if spacing_mm.x > spacing_mm.y { 0 } else { 1 };
    if spacing_mm[axis] <= SLICE_RATIO * spacing_mm.z {
        return Ok((Cow::Borrowed(labels), Vec::new()));
    }
    let order = [(axis + 1) % 3, (axis + 2) % 3, axis];
    let whole = labels.grid();
    let shape = order.map(|axis| whole.shape()[axis]);
    let mut map = Matrix4::identity();
    for (column, &from) in order.iter().chain(&[3]).enumerate() {
        map.set_column(column, &whole.voxel_to_world().column(from));
    }
    let grid = Grid::new(shape, map)?;
    let label = |flat| {
        let place = grid.voxel_of(flat);
        let mut voxel = [0; 3];
        (0..3).for_each(|n| voxel[order[n]] = place[n]);
        labels.at(voxel)
    };
    let turned = (0..grid.voxel_count()).map(label).collect();
    let name = ["i", "j"][axis];
    let warning = format!("the voxels are longest along {name} ({:.1} mm): the slices are taken to follow that axis", spacing_mm[axis]);
    Ok((Cow::Owned(LabelMap::new(grid, turned)?), vec![warning]))
}

/// The same voxels in the order of another grid; none if they are not the same ones.
pub(super) fn in_order_of(labels: &LabelMap, grid: &Grid) -> Result<Option<LabelMap>, ImageError> {
    if labels.grid().voxel_count() != grid.voxel_count() {
        return Ok(None);
    }
    let place = |flat: usize| {
        let position_mm = grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|n| n as f64)));
        let voxel = labels.grid().to_voxel(&position_mm);
        let nearest = voxel.map(f64::round);
        let is_there = (0..3).all(|axis| nearest[axis] >= 0.0 && nearest[axis] < labels.grid().shape()[axis] as f64);
        (is_there && (voxel - nearest).amax() < SAME_VOXEL).then(|| labels.at([nearest.x, nearest.y, nearest.z].map(|x| x as usize)))
    };
    let ordered: Option<Vec<u8>> = (0..grid.voxel_count()).map(place).collect();
    ordered.map(|ordered| LabelMap::new(grid.clone(), ordered)).transpose()
}

/// A plane of one's own with its normal out of the heart.
pub(super) fn towards_base(plane: Plane, axis: &Vector3<f64>) -> Result<Plane, ImageError> {
    let cosine = plane.normal.dot(&axis.normalize());
    if cosine.abs() < LEAN_COSINE_MIN {
        let lean_deg = cosine.abs().acos().to_degrees();
        let reason = format!("the base plane leans by {lean_deg:.0}° against the slices; it must cut the ventricles across, within 60°");
        return Err(ImageError::UnusableMask { reason });
    }
    Ok(Plane { normal: plane.normal * cosine.signum(), ..plane })
}

/// Refuses a base plane that leaves nothing of the heart, or that lies so far beyond the labels that the fields end before it.
pub(super) fn check_base(epicardium: &Volume, base: &Plane, frame: &SliceFrame<'_>, warnings: &mut Vec<String>) -> Result<(), ImageError> {
    let grid = epicardium.grid();
    let last_layer = grid.shape()[2] - 1;
    let labels_end = frame.base_plane();
    let (mut beyond_mm, mut is_open, mut kept, mut inside) = (0.0_f64, false, 0_usize, 0_usize);
    for flat in (0..grid.voxel_count()).filter(|&flat| epicardium.values()[flat] < 0.0) {
        let voxel = grid.voxel_of(flat);
        let position_mm = grid.to_world_mm(&Vector3::from(voxel.map(|n| n as f64)));
        let is_within_labels = labels_end.signed_distance_mm(&position_mm) <= 0.0;
        inside += usize::from(is_within_labels);
        if base.signed_distance_mm(&position_mm) < 0.0 {
            kept += usize::from(is_within_labels);
            beyond_mm = beyond_mm.max(labels_end.signed_distance_mm(&position_mm));
            is_open |= voxel[2] == last_layer;
        }
    }
    let unusable = |reason: String| Err(ImageError::UnusableMask { reason });
    if is_open {
        return unusable("the base plane lies beyond the labels; move it towards the apex, or label more slices".to_string());
    }
    if 10 * kept < inside {
        return unusable(
            "the base plane leaves less than a tenth of the heart; check its point, in world coordinates (RAS, mm)".to_string(),
        );
    }
    if beyond_mm > EXTRAPOLATION_REPORTED_MM {
        warnings.push(format!("the base plane reaches up to {beyond_mm:.1} mm beyond the labels: the walls are continued straight there"));
    }
    Ok(())
}
