//! The valve ring as somebody would mark it on long-axis views, with the errors of a hand.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::PhantomError;
use super::error::within;
use crate::anatomy::Anatomy;

/// Long-axis views, evenly turned about the long axis; each shows the ring twice.
const VIEW_COUNT: usize = 3;
/// Stream of the random numbers, apart from those of images and slices.
const STREAM: u64 = u64::MAX - 1;

/// Where the ring of the left ventricle's valves is marked on three long-axis views of the heart at `position_mm` (one a mesh vertex): six points,
/// mm, each with a normal error of standard deviation `sd_mm` along each axis. The same seed gives the same marks.
///
/// # Errors
/// [`PhantomError::Setting`] for a standard deviation outside 0 to 100 mm.
pub fn marked_valve_ring_mm(
    anatomy: &Anatomy,
    position_mm: &[Vector3<f64>],
    sd_mm: f64,
    seed: u64,
) -> Result<Vec<Vector3<f64>>, PhantomError> {
    within("the error of a mark in mm", sd_mm, [0.0, 100.0], "lie between 0 and 100 mm")?;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(STREAM);
    let Some((_, cavity)) = anatomy.cavities.first() else { return Ok(Vec::new()) };
    let centre_mm = cavity.lid_centre_mm(position_mm);
    let across = anatomy.axes.long_axis.cross(&anatomy.axes.septal_direction);
    let mut mark = |view: usize| {
        let angle_rad = std::f64::consts::PI * view as f64 / VIEW_COUNT as f64;
        let direction = anatomy.axes.septal_direction * angle_rad.cos() + across * angle_rad.sin();
        let share = |vertex: usize| (position_mm[vertex] - centre_mm).normalize().dot(&direction);
        let nearest = cavity.rim().iter().copied().max_by(|&a, &b| share(a).total_cmp(&share(b)))?;
        let error_mm = Vector3::from_fn(|_, _| sd_mm * Distribution::<f64>::sample(&StandardNormal, &mut random));
        Some(position_mm[nearest] + error_mm)
    };
    Ok((0..2 * VIEW_COUNT).filter_map(&mut mark).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::AnatomySettings;
    use crate::anatomy::mesher::MesherSettings;
    use crate::image::Plane;
    use crate::phantom::IdealisedLv;

    fn mean(marks: &[Vector3<f64>]) -> Vector3<f64> {
        marks.iter().sum::<Vector3<f64>>() / marks.len() as f64
    }

    /// Marks without errors lie on the ring, on all its sides; with errors their height has the deviation of a mean of six.
    #[test]
    fn marks_scatter_about_the_ring_as_stated() {
        let heart = IdealisedLv::default().build(&MesherSettings::with_edge_length_mm(9.0), &AnatomySettings::default()).unwrap();
        let rest_mm = heart.mesh.vertices_mm();
        let (centre_mm, axis) = (heart.cavities[0].1.lid_centre_mm(rest_mm), heart.axes.long_axis);
        let ring: Vec<_> = heart.cavities[0].1.rim().iter().map(|&vertex| rest_mm[vertex]).collect();
        let marks = marked_valve_ring_mm(&heart, rest_mm, 0.0, 1).unwrap();
        assert!(marks.iter().all(|mark| ring.contains(mark)), "{marks:?}");
        // Opposite ones are across the ring from each other, so that their mean is near its centre.
        let exact_mm = mean(&marks);
        assert!(marks.len() == 6 && (exact_mm - centre_mm).norm() < 3.0, "{exact_mm} {centre_mm}");
        let plane = Plane::through(&marks).unwrap();
        assert!(plane.normal.dot(&axis).abs() > 0.98, "{plane:?}");
        let heights = (0..400).map(|seed| {
            let marks = marked_valve_ring_mm(&heart, rest_mm, 1.5, seed).unwrap();
            (mean(&marks) - exact_mm).dot(&axis)
        });
        let heights: Vec<f64> = heights.collect();
        // 400 draws tell a deviation to 3.5 %.
        let sd_mm = crate::numerics::root_mean_square(&heights);
        assert!((sd_mm / (1.5 / 6.0_f64.sqrt()) - 1.0).abs() < 0.15, "{sd_mm} mm");
        assert!(marked_valve_ring_mm(&heart, rest_mm, f64::NAN, 1).is_err());
    }
}
