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

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix4, Vector3};

    use super::*;

    const SHAPE: [usize; 3] = [12, 10, 4];

    /// Boxes side by side within a third: left blood, right blood, and what encloses both.
    fn boxes() -> [LabelMap; 3] {
        let mask = |low: [usize; 2], high: [usize; 2]| {
            let grid = Grid::axis_aligned(SHAPE, Vector3::new(5.0, -3.0, 1.0), Vector3::new(1.5, 1.5, 8.0)).unwrap();
            let is_inside = |flat| (0..2).all(|axis| (low[axis]..high[axis]).contains(&grid.voxel_of(flat)[axis]));
            let inside = (0..grid.voxel_count()).map(|flat| u8::from(is_inside(flat))).collect();
            LabelMap::new(grid, inside).unwrap()
        };
        [mask([1, 1], [11, 9]), mask([2, 2], [5, 8]), mask([7, 2], [10, 8])]
    }

    fn message(masks: [&LabelMap; 3]) -> String {
        labels_of_masks(masks[0], masks[1], Some(masks[2])).unwrap_err().to_string()
    }

    /// The same voxels, stored from the other end along every axis and with i and j exchanged.
    fn turned(mask: &LabelMap) -> LabelMap {
        let [ni, nj, nk] = SHAPE;
        let last = [ni, nj, nk].map(|n| (n - 1) as f64);
        let mut order = Matrix4::zeros();
        (order[(0, 1)], order[(1, 0)], order[(2, 2)], order[(3, 3)]) = (-1.0, -1.0, -1.0, 1.0);
        (order[(0, 3)], order[(1, 3)], order[(2, 3)]) = (last[0], last[1], last[2]);
        let grid = Grid::new([nj, ni, nk], mask.grid().voxel_to_world() * order).unwrap();
        let label = |flat| {
            let [j, i, k] = grid.voxel_of(flat);
            mask.at([ni - 1 - i, nj - 1 - j, nk - 1 - k])
        };
        LabelMap::new(grid.clone(), (0..grid.voxel_count()).map(label).collect()).unwrap()
    }

    #[test]
    fn masks_in_another_order_of_voxels_are_turned_and_said_so() {
        let [epicardium, left, right] = boxes();
        let (labels, warnings) = labels_of_masks(&epicardium, &left, Some(&right)).unwrap();
        assert!(warnings.is_empty());
        assert_eq!([1, 2, 3].map(|code| labels.count(code)), [3 * 6 * 4, (80 - 36) * 4, 3 * 6 * 4]);
        let (same, warnings) = labels_of_masks(&epicardium, &left, Some(&turned(&right))).unwrap();
        assert_eq!(same, labels);
        assert!(warnings.len() == 1 && warnings[0].contains("right endocardium stores its voxels in another order"), "{warnings:?}");
    }

    #[test]
    fn masks_that_are_empty_or_elsewhere_or_exchanged_are_refused() {
        let [epicardium, left, right] = boxes();
        let empty = left.slices(0..0);
        assert!(message([&epicardium, &left, &empty]).contains("the mask of the right endocardium is empty"));
        let coarse = Grid::axis_aligned([6, 5, 4], Vector3::zeros(), Vector3::new(3.0, 3.0, 8.0)).unwrap();
        let elsewhere = LabelMap::new(coarse, vec![1; 120]).unwrap();
        let words = message([&epicardium, &elsewhere, &right]);
        assert!(words.contains("left endocardium lies on another grid") && words.contains("3.00 × 3.00 × 8.00 mm"), "{words}");
        let shifted = Grid::axis_aligned(SHAPE, Vector3::new(6.0, -3.0, 1.0), Vector3::new(1.5, 1.5, 8.0)).unwrap();
        let shifted = LabelMap::new(shifted, left.labels().to_vec()).unwrap();
        assert!(message([&epicardium, &shifted, &right]).contains("another grid"));
        assert!(message([&left, &epicardium, &right]).contains("outside the epicardium; check which mask is which"));
        assert!(message([&epicardium, &left, &left]).contains("100 % of the right endocardium lies within the left one"));
    }
}
