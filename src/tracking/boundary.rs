//! The boundary points: for each surface vertex the nearest sub-voxel point of the image boundary along its normal, \[Billet2009\] §4.1.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::appearance::{side_intensity, weighted_average};
use super::force_tangents::follow_crossing;
use super::{AppearanceSettings, ImageInstant, SurfaceAppearance, TrackingError};
use crate::mesh::{SurfaceTag, TaggedSurface};

/// How boundary points are searched and trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundarySettings {
    /// Search range along the normal to either side, mm.
    pub range_mm: f64,
    /// Distance between samples of the profile, mm; crossings are refined within it.
    pub sample_mm: f64,
    /// Full confidence up to this angle β between mesh and image normal, degrees.
    pub angle_full_deg: f64,
    /// No confidence from this angle on, degrees.
    pub angle_none_deg: f64,
    /// Distance from the neighbours' average at which confidence has fallen to a half, mm.
    pub agreement_mm: f64,
    /// Rounds of averaging along the surface that make the neighbours' average.
    pub agreement_rounds: usize,
    /// Error of the interpolation between slices at which confidence has fallen to a half, mm.
    pub slice_error_mm: f64,
    /// Distance between the slices as acquired, along the k axis of the grid, mm; of the grid itself if nothing is said. To be given
    /// for images that were resampled.
    pub slice_distance_mm: Option<f64>,
}

impl Default for BoundarySettings {
    fn default() -> Self {
        Self {
            range_mm: 8.0,
            sample_mm: 1.0,
            angle_full_deg: 45.0,
            angle_none_deg: 60.0,
            agreement_mm: 2.0,
            agreement_rounds: 4,
            slice_error_mm: 1.0,
            slice_distance_mm: None,
        }
    }
}

/// A boundary point $Z_i = Y_i + s N_i$ found for a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryTarget {
    /// The mesh vertex.
    pub vertex: usize,
    /// Z, mm.
    pub point_mm: Vector3<f64>,
    /// Unit outward normal N of the mesh at the vertex.
    pub normal: Vector3<f64>,
    /// Unit normal of the image boundary at Z, turned to the side of N.
    pub image_normal: Vector3<f64>,
    /// s, mm: positive where the boundary lies outward of the mesh.
    pub signed_distance_mm: f64,
    /// Confidence c in 0..=1.
    pub confidence: f64,
    /// Area of the vertex, mm².
    pub area_mm2: f64,
}

/// The boundary points of one surface at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceTargets {
    /// The surface.
    pub tag: SurfaceTag,
    /// Number of vertices of the surface.
    pub vertex_count: usize,
    /// The points found, ascending in the vertex.
    pub targets: Vec<BoundaryTarget>,
}

/// The search on one surface, with what was learnt on the reference frame.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundarySearch {
    appearance: SurfaceAppearance,
    sides: AppearanceSettings,
    settings: BoundarySettings,
}

impl BoundarySearch {
    /// A search for the surface of `appearance`, learnt with `sides`.
    ///
    /// # Errors
    /// [`TrackingError::SettingOutOfRange`].
    pub fn new(appearance: SurfaceAppearance, sides: AppearanceSettings, settings: BoundarySettings) -> Result<Self, TrackingError> {
        TrackingError::check_setting("range_mm", settings.range_mm, 0.1, 100.0)?;
        TrackingError::check_setting("sample_mm", settings.sample_mm, 0.01, settings.range_mm)?;
        TrackingError::check_setting("angle_full_deg", settings.angle_full_deg, 0.0, 89.0)?;
        TrackingError::check_setting("angle_none_deg", settings.angle_none_deg, settings.angle_full_deg, 89.0)?;
        TrackingError::check_setting("agreement_mm", settings.agreement_mm, 1e-3, f64::INFINITY)?;
        TrackingError::check_setting("slice_error_mm", settings.slice_error_mm, 1e-3, f64::INFINITY)?;
        Ok(Self { appearance, sides, settings })
    }

    /// What was learnt on the reference frame.
    pub fn appearance(&self) -> &SurfaceAppearance {
        &self.appearance
    }

    /// The boundary points of a mesh at `position_mm` in the image of one instant.
    ///
    /// Candidates of a vertex are the crossings of its level ℓ in the learnt sense (dark to bright or bright to dark) whose
    /// gradient norm exceeds the threshold. The nearest to the mesh is taken first; then, once, the nearest to the average of
    /// the neighbours' points, so that a vertex does not jump to a papillary muscle alone.
    pub fn find(&self, surface: &TaggedSurface, position_mm: &[Vector3<f64>], instant: &ImageInstant) -> SurfaceTargets {
        let area_mm2 = surface.vertex_area_vectors_mm2(self.appearance.tag, position_mm);
        let vertices = &self.appearance.vertices;
        let candidates: Vec<Vec<Candidate>> = vertices
            .par_iter()
            .enumerate()
            .map(|(place, &vertex)| match area_mm2[vertex].try_normalize(0.0) {
                Some(normal) => self.candidates(place, &position_mm[vertex], &normal, instant),
                None => Vec::new(),
            })
            .collect();
        let mut chosen: Vec<Option<&Candidate>> = candidates.iter().map(|list| nearest(list, 0.0)).collect();
        let average = self.neighbours_average(&chosen);
        for (place, choice) in chosen.iter_mut().enumerate() {
            *choice = nearest(&candidates[place], average[place].unwrap_or(0.0));
        }
        let average = self.neighbours_average(&chosen);
        let target = |place: usize| {
            let candidate = chosen[place]?;
            let apart = (candidate.distance_mm - average[place]?) / self.settings.agreement_mm;
            let (vertex, area_mm2) = (vertices[place], area_mm2[vertices[place]].norm());
            Some(BoundaryTarget {
                vertex,
                point_mm: position_mm[vertex] + candidate.normal * candidate.distance_mm,
                normal: candidate.normal,
                image_normal: candidate.image_normal,
                signed_distance_mm: candidate.distance_mm,
                confidence: candidate.confidence / (1.0 + apart * apart),
                area_mm2,
            })
        };
        let targets = (0..vertices.len()).filter_map(target).collect();
        SurfaceTargets { tag: self.appearance.tag, vertex_count: vertices.len(), targets }
    }

    /// How it searches.
    pub(super) fn settings(&self) -> &BoundarySettings {
        &self.settings
    }

    /// s, N' and the edge's confidence (without its neighbours') of the crossing near a distance along a normal.
    pub(super) fn follow(
        &self,
        place: usize,
        origin_mm: &Vector3<f64>,
        normal: &Vector3<f64>,
        near_mm: f64,
        instant: &ImageInstant,
    ) -> Option<(f64, Vector3<f64>, f64)> {
        let level = self.appearance.level[place];
        let distance_mm = follow_crossing(near_mm, |distance_mm| Some(instant.value(&(origin_mm + normal * distance_mm))? - level))?;
        let found = self.judge(place, origin_mm, normal, distance_mm, instant)?;
        Some((found.distance_mm, found.image_normal, found.confidence))
    }

    /// All crossings of the level along the normal of one vertex, by rising distance along it.
    fn candidates(&self, place: usize, origin_mm: &Vector3<f64>, normal: &Vector3<f64>, instant: &ImageInstant) -> Vec<Candidate> {
        let sense = self.appearance.contrast[place].signum();
        let level = self.appearance.level[place];
        let half_count = (self.settings.range_mm / self.settings.sample_mm).round() as i32;
        let line = instant.line(origin_mm, normal);
        let height = |distance_mm: f64| Some(sense * (line.value(distance_mm)? - level));
        let mut found = Vec::new();
        let mut before: Option<(f64, f64)> = None;
        for sample in -half_count..=half_count {
            let distance_mm = f64::from(sample) * self.settings.sample_mm;
            let after = height(distance_mm).map(|h| (distance_mm, h));
            if let (Some(low), Some(high)) = (before, after)
                && low.1 < 0.0
                && high.1 >= 0.0
                && let Some(distance_mm) = refine_crossing(low, high, height)
            {
                found.extend(self.judge(place, origin_mm, normal, distance_mm, instant));
            }
            before = after;
        }
        found
    }

    /// Confidence of a crossing, or nothing if its gradient is too weak or too oblique:
    /// $c = c_\text{edge}\, c_\text{contrast}\, c_\beta\, c_\text{slice}$, each in 0..=1.
    fn judge(
        &self,
        place: usize,
        origin_mm: &Vector3<f64>,
        normal: &Vector3<f64>,
        distance_mm: f64,
        instant: &ImageInstant,
    ) -> Option<Candidate> {
        let SurfaceAppearance { contrast, contrast_median, gradient_threshold_per_mm, inner_span_mm, .. } = &self.appearance;
        let point_mm = origin_mm + normal * distance_mm;
        let gradient_per_mm = instant.gradient_per_mm(&point_mm)?;
        let slices = instant.resolution(self.settings.slice_distance_mm);
        if gradient_per_mm.norm() < gradient_threshold_per_mm * slices.sharpness(normal) {
            return None;
        }
        let image_normal = gradient_per_mm.normalize() * contrast[place].signum();
        let angle = self.angle_confidence(normal.dot(&image_normal));
        if angle <= 0.0 {
            return None;
        }
        let inner = side_intensity(instant, &point_mm, &-normal, inner_span_mm[place])?;
        let outer = side_intensity(instant, &point_mm, normal, self.sides.outer_span_mm())?;
        let edge = ((outer - inner) / contrast[place]).clamp(0.0, 1.0);
        let learnt = (contrast[place].abs() / contrast_median).min(1.0);
        let blend = slices.blend_error_mm(normal) / self.settings.slice_error_mm;
        let confidence = edge * learnt * angle / (1.0 + blend * blend);
        (confidence > 0.0).then_some(Candidate { distance_mm, normal: *normal, image_normal, confidence })
    }

    /// 1 up to `angle_full_deg`, falling linearly in cos β to 0 at `angle_none_deg`.
    fn angle_confidence(&self, cos_beta: f64) -> f64 {
        let (full, none) = (self.settings.angle_full_deg.to_radians().cos(), self.settings.angle_none_deg.to_radians().cos());
        if cos_beta >= full { 1.0 } else { ((cos_beta - none) / (full - none)).max(0.0) }
    }

    fn neighbours_average(&self, chosen: &[Option<&Candidate>]) -> Vec<Option<f64>> {
        let values: Vec<f64> = chosen.iter().map(|c| c.map_or(0.0, |c| c.distance_mm)).collect();
        let weights: Vec<f64> = chosen.iter().map(|c| c.map_or(0.0, |c| c.confidence)).collect();
        weighted_average(&values, &weights, &self.appearance.neighbours, self.settings.agreement_rounds)
    }
}

#[derive(Debug, Clone, Copy)]
struct Candidate {
    distance_mm: f64,
    normal: Vector3<f64>,
    image_normal: Vector3<f64>,
    confidence: f64,
}

fn nearest(candidates: &[Candidate], distance_mm: f64) -> Option<&Candidate> {
    candidates.iter().min_by(|a, b| (a.distance_mm - distance_mm).abs().total_cmp(&(b.distance_mm - distance_mm).abs()))
}

/// The root between two samples of opposite sign, by the Illinois variant of regula falsi.
fn refine_crossing(low: (f64, f64), high: (f64, f64), height: impl Fn(f64) -> Option<f64>) -> Option<f64> {
    const TOLERANCE_MM: f64 = 1e-4;
    let (mut low, mut high) = (low, high);
    let mut side = 0;
    for _ in 0..40 {
        if high.0 - low.0 < TOLERANCE_MM {
            break;
        }
        let at = (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1);
        let value = height(at)?;
        if value.abs() <= 1e-12 * (high.1 - low.1) {
            return Some(at);
        }
        if value < 0.0 {
            low = (at, value);
            if side == -1 {
                high.1 *= 0.5;
            }
            side = -1;
        } else {
            high = (at, value);
            if side == 1 {
                low.1 *= 0.5;
            }
            side = 1;
        }
    }
    Some((low.0 * high.1 - high.0 * low.1) / (high.1 - low.1))
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{image, slab, step, still};
    use super::super::{ForceScheme, SurfaceAppearance};
    use super::*;
    use crate::image::CineSequence;
    use crate::mesh::TetMesh;

    const RADIUS_MM: f64 = 20.0;

    /// A patch of a spherical shell of inner radius `radius_mm`, 8 mm thick; the slab's top becomes the inner face, so that blood
    /// lies towards the origin.
    fn patch(radius_mm: f64) -> (TetMesh, TaggedSurface) {
        slab(8, |p| {
            let direction = Vector3::new(0.6 * p.y, 0.6 * p.x, 1.0).normalize();
            direction * (radius_mm + 8.0 * (1.0 - p.z))
        })
    }

    /// Bright blood within a sphere, dark wall around it.
    fn ball(radius_mm: f64, spacing_mm: f64) -> CineSequence {
        still(image(Vector3::repeat(40.0), Vector3::repeat(spacing_mm), |p| 100.0 + 400.0 * step(radius_mm - p.norm(), 1.0)))
    }

    fn search_on(reference: &CineSequence, mesh: &TetMesh, surface: &TaggedSurface) -> BoundarySearch {
        let sides = AppearanceSettings::default();
        let instant = ImageInstant::new(reference, 0.0);
        let tag = SurfaceTag::EndocardiumLv;
        let appearance = SurfaceAppearance::learn(surface, tag, mesh.vertices_mm(), (&instant, 0.0), &sides).unwrap();
        BoundarySearch::new(appearance, sides, BoundarySettings::default()).unwrap()
    }

    /// Learnt on a ball of 20 mm, the boundary of a ball of 17 mm is found 3 mm inward of the mesh, to a twentieth of a voxel.
    #[test]
    fn a_known_displacement_is_found_to_a_twentieth_of_a_voxel() {
        let (mesh, surface) = patch(RADIUS_MM);
        let search = search_on(&ball(RADIUS_MM, 1.5), &mesh, &surface);
        assert!((search.appearance().fraction - 0.5).abs() < 0.05, "{}", search.appearance().fraction);
        let moved = ball(17.0, 1.5);
        let found = search.find(&surface, mesh.vertices_mm(), &ImageInstant::new(&moved, 0.0));
        assert_eq!(found.targets.len(), found.vertex_count);
        let interior = found.targets.iter().filter(|t| t.normal.dot(&-mesh.vertices_mm()[t.vertex].normalize()) > 0.999);
        let mut counted = 0;
        for target in interior {
            counted += 1;
            assert!((target.signed_distance_mm - 3.0).abs() < 0.075, "{} mm", target.signed_distance_mm);
            assert!(target.image_normal.dot(&target.normal) > 0.99 && target.confidence > 0.3, "{target:?}");
        }
        assert!(counted > 40, "{counted}");
    }

    /// On a frame without any edge nothing is invented, and a surface without contrast cannot be learnt.
    #[test]
    fn a_uniform_image_has_no_boundary() {
        let (mesh, surface) = patch(RADIUS_MM);
        let uniform = still(image(Vector3::repeat(40.0), Vector3::repeat(2.0), |_| 300.0));
        let search = search_on(&ball(RADIUS_MM, 1.5), &mesh, &surface);
        assert!(search.find(&surface, mesh.vertices_mm(), &ImageInstant::new(&uniform, 0.0)).targets.is_empty());
        let instant = ImageInstant::new(&uniform, 0.0);
        let sides = AppearanceSettings::default();
        let error = SurfaceAppearance::learn(&surface, SurfaceTag::EndocardiumLv, mesh.vertices_mm(), (&instant, 0.3), &sides);
        assert!(matches!(error, Err(TrackingError::NoContrast { .. })), "{error:?}");
    }

    /// An image elsewhere in the world is refused by name.
    #[test]
    fn an_image_that_does_not_cover_the_mesh_is_refused() {
        let (mesh, surface) = patch(RADIUS_MM);
        let away: Vec<_> = mesh.vertices_mm().iter().map(|v| v + Vector3::repeat(500.0)).collect();
        let reference = ball(RADIUS_MM, 2.0);
        let instant = ImageInstant::new(&reference, 0.0);
        let error = SurfaceAppearance::learn(&surface, SurfaceTag::EndocardiumLv, &away, (&instant, 0.0), &AppearanceSettings::default());
        assert!(matches!(error, Err(TrackingError::NotCovered { covered: 0, .. })), "{error:?}");
    }

    /// The one candidate that a vertex at `origin_mm` sees along a fixed normal.
    fn only_candidate(search: &BoundarySearch, origin_mm: &Vector3<f64>, normal: &Vector3<f64>, instant: &ImageInstant) -> Candidate {
        let found = search.candidates(0, origin_mm, normal, instant);
        assert_eq!(found.len(), 1, "at {origin_mm:?}");
        found[0]
    }

    /// B of the exact scheme is the derivative of the search itself: on an oblique plane and on an ellipsoid, by central
    /// differences of the found Z. The image normal comes from differences over a voxel, so the two agree to the square of the
    /// voxel over the edge width; 1.5 % here. The published B is off by tan²β along N × N'.
    #[test]
    fn the_exact_b_is_the_derivative_of_the_search() {
        let (mesh, surface) = patch(RADIUS_MM);
        let search = search_on(&ball(RADIUS_MM, 1.5), &mesh, &surface);
        let plane_normal = Vector3::new(0.2, 0.5, -0.8).normalize();
        let axes = Vector3::new(14.0, 19.0, 24.0);
        let plane = move |p: Vector3<f64>| plane_normal.dot(&p);
        let ellipsoid = move |p: Vector3<f64>| 15.0 * (1.0 - p.component_div(&axes).norm());
        let normal = Vector3::new(-0.2, 0.1, -1.0).normalize();
        let plane_case = (&plane as &dyn Fn(Vector3<f64>) -> f64, Vector3::new(1.0, 2.0, 3.0));
        for (distance, origin_mm) in [plane_case, (&ellipsoid, Vector3::new(4.0, 8.0, 22.0))] {
            let volume = still(image(Vector3::repeat(35.0), Vector3::repeat(0.7), |p| 100.0 + 400.0 * step(distance(p), 2.0)));
            let instant = ImageInstant::new(&volume, 0.0);
            let at = |origin_mm: Vector3<f64>| origin_mm + normal * only_candidate(&search, &origin_mm, &normal, &instant).distance_mm;
            let image_normal = only_candidate(&search, &origin_mm, &normal, &instant).image_normal;
            let width_mm = 0.7;
            let mut differences = nalgebra::Matrix3::zeros();
            for axis in 0..3 {
                let mut shift = Vector3::zeros();
                shift[axis] = width_mm;
                differences.set_column(axis, &((at(origin_mm + shift) - at(origin_mm - shift)) / (2.0 * width_mm)));
            }
            let exact = ForceScheme::Exact.target_derivative(&normal, &image_normal);
            assert!((exact - differences).norm() < 0.015 * exact.norm(), "{exact} against {differences}");
            let across = normal.cross(&image_normal).normalize();
            let published = ForceScheme::Published.target_derivative(&normal, &image_normal);
            let tan_squared = normal.dot(&image_normal).powi(-2) - 1.0;
            assert!(tan_squared > 0.05, "the case must be oblique, tan²β = {tan_squared}");
            assert!(((differences * across).dot(&across) - 1.0).abs() < 0.015);
            assert!(((published * across).dot(&across) - 1.0 - tan_squared).abs() < 1e-9);
        }
    }

    /// The variational force is minus the derivative of γ s², with s from the search itself on an ellipsoid, and its stiffness is
    /// the second derivative where the boundary is flat.
    #[test]
    fn the_variational_force_derives_from_its_energy() {
        let (mesh, surface) = patch(RADIUS_MM);
        let search = search_on(&ball(RADIUS_MM, 1.5), &mesh, &surface);
        let axes = Vector3::new(14.0, 19.0, 24.0);
        let ellipsoid = |p: Vector3<f64>| 15.0 * (1.0 - p.component_div(&axes).norm());
        let volume = still(image(Vector3::repeat(35.0), Vector3::repeat(0.7), |p| 100.0 + 400.0 * step(ellipsoid(p), 2.0)));
        let instant = ImageInstant::new(&volume, 0.0);
        let (origin_mm, normal) = (Vector3::new(4.0, 8.0, 22.0), Vector3::new(-0.2, 0.1, -1.0).normalize());
        let candidate = only_candidate(&search, &origin_mm, &normal, &instant);
        let gain = 2.5;
        let energy = |at: Vector3<f64>| gain * only_candidate(&search, &at, &normal, &instant).distance_mm.powi(2);
        let target = BoundaryTarget {
            vertex: 0,
            point_mm: origin_mm + normal * candidate.distance_mm,
            normal,
            image_normal: candidate.image_normal,
            signed_distance_mm: candidate.distance_mm,
            confidence: 1.0,
            area_mm2: 1.0,
        };
        let load = ForceScheme::Variational.load(&target, &origin_mm, gain);
        let force = load.force_mn - load.stiffness_mn_per_mm * origin_mm;
        let width_mm = 0.35;
        for axis in 0..3 {
            let mut shift = Vector3::zeros();
            shift[axis] = width_mm;
            let slope = (energy(origin_mm + shift) - energy(origin_mm - shift)) / (2.0 * width_mm);
            assert!((force[axis] + slope).abs() < 0.02 * force.norm(), "axis {axis}: {} against {}", force[axis], -slope);
        }
    }
}
