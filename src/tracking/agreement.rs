//! How well a tracked cavity agrees with an expert's labels: Dice overlap and mean distance of contours, slice by slice.

use nalgebra::Vector3;

use super::section::{Contour, inside_slice};
use crate::image::LabelMap;
use crate::mesh::Cavity;
use crate::units::ml_from_mm3;

/// One slice of the comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SliceAgreement {
    /// Slice number, 0-based.
    pub k: usize,
    /// Voxels inside the mesh's cavity.
    pub mesh_voxels: usize,
    /// Voxels with the expert's code.
    pub label_voxels: usize,
    /// Voxels in both.
    pub common_voxels: usize,
    /// Mean of the two directed mean distances between the contours in the slice, mm; nothing where either is missing.
    pub mean_distance_mm: Option<f64>,
}

/// A cavity against labels.
#[derive(Debug, Clone, PartialEq)]
pub struct CavityAgreement {
    /// Dice coefficient over the slices that carry the label: 2 |A ∩ B| / (|A| + |B|).
    pub dice: f64,
    /// Dice coefficient over all slices of the grid, of which experts may have left out some.
    pub dice_all_slices: f64,
    /// Mean of the slices' contour distances, mm; nothing if no slice has both contours.
    pub mean_distance_mm: Option<f64>,
    /// Cavity volume of the mesh in the labelled slices, mL.
    pub mesh_volume_ml: f64,
    /// Volume of the label, mL.
    pub label_volume_ml: f64,
    /// The slices that carry the label or meet the mesh.
    pub slices: Vec<SliceAgreement>,
}

impl CavityAgreement {
    /// Compares the cavity (endocardium and lid) of a mesh at `position_mm` with the voxels of `code`. Voxel centres decide.
    pub fn new(cavity: &Cavity, position_mm: &[Vector3<f64>], labels: &LabelMap, code: u8) -> Self {
        let (closed, points_mm) = closed_surface(cavity, position_mm);
        let grid = labels.grid();
        let [ni, nj, nk] = grid.shape();
        let slices: Vec<SliceAgreement> = (0..nk)
            .map(|k| {
                let inside = inside_slice(&closed, &points_mm, grid, k);
                let labelled = &labels.labels()[ni * nj * k..ni * nj * (k + 1)];
                let common_voxels = inside.iter().zip(labelled).filter(|&(&is_in, &label)| is_in && label == code).count();
                let mesh = Contour::of_surface(cavity.endocardium(), position_mm, grid, k);
                let expert = Contour::of_label(labels, code, k);
                SliceAgreement {
                    k,
                    mesh_voxels: inside.iter().filter(|&&is_in| is_in).count(),
                    label_voxels: labelled.iter().filter(|&&label| label == code).count(),
                    common_voxels,
                    mean_distance_mm: mesh.mean_distance_mm(&expert).zip(expert.mean_distance_mm(&mesh)).map(|(a, b)| 0.5 * (a + b)),
                }
            })
            .filter(|slice| slice.mesh_voxels + slice.label_voxels > 0)
            .collect();
        let labelled: Vec<&SliceAgreement> = slices.iter().filter(|slice| slice.label_voxels > 0).collect();
        let distances: Vec<f64> = labelled.iter().filter_map(|slice| slice.mean_distance_mm).collect();
        let volume_ml = |count: usize| ml_from_mm3(count as f64 * grid.voxel_volume_mm3());
        Self {
            dice: dice(labelled.iter().copied()),
            dice_all_slices: dice(slices.iter()),
            mean_distance_mm: (!distances.is_empty()).then(|| distances.iter().sum::<f64>() / distances.len() as f64),
            mesh_volume_ml: volume_ml(labelled.iter().map(|slice| slice.mesh_voxels).sum()),
            label_volume_ml: volume_ml(labelled.iter().map(|slice| slice.label_voxels).sum()),
            slices,
        }
    }
}

/// Zero where there is nothing at all.
fn dice<'a>(slices: impl Iterator<Item = &'a SliceAgreement>) -> f64 {
    let (common, both) = slices.fold((0, 0), |(c, b), s| (c + s.common_voxels, b + s.mesh_voxels + s.label_voxels));
    if both == 0 { 0.0 } else { 2.0 * common as f64 / both as f64 }
}

/// The cavity's endocardium and the fan of its lid, with the fan's centre as a last point.
fn closed_surface(cavity: &Cavity, position_mm: &[Vector3<f64>]) -> (Vec<[usize; 3]>, Vec<Vector3<f64>>) {
    let mut points_mm = position_mm.to_vec();
    points_mm.push(cavity.lid_centre_mm(position_mm));
    let (rim, centre) = (cavity.rim(), position_mm.len());
    let fan = (0..rim.len()).map(|n| [centre, rim[n], rim[(n + 1) % rim.len()]]);
    (cavity.endocardium().iter().copied().chain(fan).collect(), points_mm)
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::slab;
    use super::*;
    use crate::image::Grid;
    use crate::mesh::SurfaceTag;

    /// A bowl: half a spherical shell, open towards +z, of inner radius `radius_mm`.
    fn bowl(radius_mm: f64) -> (Cavity, Vec<Vector3<f64>>) {
        let (mesh, surface) = slab(24, |p| {
            // The square onto the disc (Shirley), the disc onto the half sphere.
            let (r, phi) = if p.x.abs() > p.y.abs() { (p.x, p.y / p.x) } else { (p.y, 2.0 - p.x / p.y) };
            let phi = if r == 0.0 { 0.0 } else { phi } * std::f64::consts::FRAC_PI_4;
            let theta = r.abs() * std::f64::consts::FRAC_PI_2;
            let (x, y) = (r.signum() * phi.cos() * theta.sin(), r.signum() * phi.sin() * theta.sin());
            Vector3::new(x, y, -theta.cos()) * (radius_mm + 6.0 * (1.0 - p.z))
        });
        (Cavity::new(&surface, SurfaceTag::EndocardiumLv).unwrap(), mesh.vertices_mm().to_vec())
    }

    fn ball_labels(radius_mm: f64, from_z_mm: f64, to_z_mm: f64) -> LabelMap {
        let grid = Grid::axis_aligned([121, 121, 9], Vector3::new(-30.0, -30.0, -32.5), Vector3::new(0.5, 0.5, 5.0)).unwrap();
        let label = |flat| {
            let p = grid.to_world_mm(&Vector3::from(grid.voxel_of(flat).map(|n| n as f64)));
            u8::from(p.norm() < radius_mm && (from_z_mm..to_z_mm).contains(&p.z))
        };
        let labels = (0..grid.voxel_count()).map(label).collect();
        LabelMap::new(grid, labels).unwrap()
    }

    /// Concentric spheres of 20 and 17 mm: Dice and contour distances against their closed forms in each slice, within the voxels' error.
    #[test]
    fn concentric_spheres_agree_as_geometry_says() {
        let (cavity, position_mm) = bowl(20.0);
        let agreement = CavityAgreement::new(&cavity, &position_mm, &ball_labels(17.0, -30.0, 0.0), 1);
        let slice_radii = |radius: f64| (0..4).map(move |n| (radius.powi(2) - (2.5_f64 + 5.0 * f64::from(n)).powi(2)).max(0.0));
        let label_area: f64 = slice_radii(17.0).sum();
        let labelled_mesh_area: f64 = slice_radii(20.0).zip(slice_radii(17.0)).filter(|s| s.1 > 0.0).map(|s| s.0).sum();
        let expected = 2.0 * label_area / (label_area + labelled_mesh_area);
        assert!((agreement.dice - expected).abs() < 0.005, "{} against {expected}", agreement.dice);
        for slice in agreement.slices.iter().filter(|slice| slice.label_voxels > 0) {
            let z = 5.0 * slice.k as f64 - 32.5;
            let expected = (400.0 - z * z).sqrt() - (289.0 - z * z).sqrt();
            assert!(
                (slice.mean_distance_mm.unwrap() - expected).abs() < 0.25,
                "slice {}: {:?}, {expected}",
                slice.k,
                slice.mean_distance_mm
            );
        }
        assert!(agreement.dice_all_slices <= agreement.dice);
    }

    /// A cavity against its own voxels overlaps fully, and lies within a quarter of a voxel.
    #[test]
    fn a_cavity_agrees_with_itself() {
        let (cavity, position_mm) = bowl(20.0);
        let agreement = CavityAgreement::new(&cavity, &position_mm, &ball_labels(20.0, -30.0, 0.0), 1);
        assert!(agreement.dice > 0.99, "{}", agreement.dice);
        assert!(agreement.mean_distance_mm.unwrap() < 0.15, "{:?}", agreement.mean_distance_mm);
        assert!((agreement.mesh_volume_ml / agreement.label_volume_ml - 1.0).abs() < 0.01);
    }

    #[test]
    fn labels_elsewhere_have_no_overlap() {
        let (cavity, position_mm) = bowl(20.0);
        let away: Vec<_> = position_mm.iter().map(|p| p + Vector3::repeat(300.0)).collect();
        let agreement = CavityAgreement::new(&cavity, &away, &ball_labels(17.0, -30.0, 0.0), 1);
        assert_eq!((agreement.dice, agreement.mean_distance_mm), (0.0, None));
    }
}
