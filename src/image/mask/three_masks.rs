//! Three binary masks, epicardium and both endocardia (\[Billet2009\] §3), as one label map.

use super::HeartCodes;
use super::orientation::in_order_of;
use crate::image::{Grid, ImageError, LabelMap};

/// Codes of a label map made of masks; both walls share one.
pub const MASK_CODES: HeartCodes = HeartCodes { cavity_lv: 1, wall_lv: 2, cavity_rv: Some(3), wall_rv: None };

/// This share of a left cavity may lie outside the epicardium.
const OUTSIDE_MAX: f64 = 0.05;

/// Joins masks (0 outside, any other number inside): what the epicardium encloses (wall and blood), left blood and right blood. The masks may
/// store their voxels in different orders. An epicardium that does not enclose the right blood leaves its wall to be grown.
///
/// # Errors
/// [`ImageError::UnusableMask`] if a mask is empty, lies on another grid, or the cavities are not where they should be.
pub fn labels_of_masks(
    epicardium: &LabelMap,
    cavity_lv: &LabelMap,
    cavity_rv: Option<&LabelMap>,
) -> Result<(LabelMap, Vec<String>), ImageError> {
    let grid = epicardium.grid();
    let mut warnings = Vec::new();
    let mut inside = |name, mask: &LabelMap| on_grid(name, mask, grid, &mut warnings);
    let (epicardium, left) = (inside("epicardium", epicardium)?, inside("left endocardium", cavity_lv)?);
    let right = cavity_rv.map(|mask| inside("right endocardium", mask)).transpose()?;
    let share = |is_odd: &dyn Fn(usize) -> bool, of: &[bool]| {
        let (all, odd) = (0..of.len()).filter(|&n| of[n]).fold((0_usize, 0_usize), |(all, odd), n| (all + 1, odd + usize::from(is_odd(n))));
        odd as f64 / all as f64
    };
    let unusable = |reason: String| Err(ImageError::UnusableMask { reason });
    let outside = share(&|n| !epicardium[n], &left);
    if outside > OUTSIDE_MAX {
        let percent = 100.0 * outside;
        return unusable(format!("{percent:.0} % of the left endocardium lies outside the epicardium; check which mask is which"));
    }
    if outside > 0.0 {
        warnings.push(format!("{:.1} % of the left endocardium lies outside the epicardium: it counts as inside", 100.0 * outside));
    }
    if let Some(right) = &right {
        let common = share(&|n| left[n], right);
        if common > OUTSIDE_MAX {
            return unusable(format!(
                "{:.0} % of the right endocardium lies within the left one; check which mask is which",
                100.0 * common
            ));
        }
    }
    let is_right = |n: usize| right.as_ref().is_some_and(|right| right[n]);
    let code = |n: usize| match (left[n], is_right(n), epicardium[n]) {
        (true, _, _) => MASK_CODES.cavity_lv,
        (_, true, _) => MASK_CODES.cavity_rv.unwrap_or_default(),
        (_, _, true) => MASK_CODES.wall_lv,
        _ => 0,
    };
    Ok((LabelMap::new(grid.clone(), (0..grid.voxel_count()).map(code).collect())?, warnings))
}

/// The voxels of a mask in the order of a grid.
fn on_grid(name: &str, mask: &LabelMap, grid: &Grid, warnings: &mut Vec<String>) -> Result<Vec<bool>, ImageError> {
    let unusable = |reason: String| Err(ImageError::UnusableMask { reason });
    if mask.labels().iter().all(|&value| value == 0) {
        return unusable(format!("the mask of the {name} is empty"));
    }
    let is_inside = |labels: &[u8]| labels.iter().map(|&value| value != 0).collect();
    if mask.grid() == grid {
        return Ok(is_inside(mask.labels()));
    }
    let Some(ordered) = in_order_of(mask, grid)? else {
        let of = |grid: &Grid| {
            let ([i, j, k], mm) = (grid.shape(), grid.spacing_mm());
            format!("{i} × {j} × {k} voxels of {:.2} × {:.2} × {:.2} mm", mm.x, mm.y, mm.z)
        };
        let (own, other) = (of(mask.grid()), of(grid));
        return unusable(format!(
            "the mask of the {name} lies on another grid than the epicardium ({own}; {other}); resample one onto the voxels of the other"
        ));
    };
    if mask.grid().shape() != grid.shape() || (mask.grid().voxel_to_world() - grid.voxel_to_world()).amax() > 1e-3 {
        warnings.push(format!("the mask of the {name} stores its voxels in another order: it was turned"));
    }
    Ok(is_inside(ordered.labels()))
}
