//! How the forces of the data change with where a step begins and with their gains: what tangents of tracked hearts need.
//!
//! A vertex is pulled by $w\,G(o, a)$ a unit of gain, where $o$ is its position, $a$ the area vector of its surface there (so the normal
//! N), and $w = 1/(1 + d^2)$ with $d = (s - \bar s)/l$ its agreement with its neighbours' average. Z and the confidence of the edge are
//! implicit functions of o and a: the derivative of G, s and the edge's confidence c by them is found once a step for every vertex by
//! central differences along the six directions, in which the crossing is followed and not searched anew. The averages
//! $\bar s = S(cs)/S(c)$ are linear in the masses that S spreads along the surface.
//!
//! So the derivatives include all confidences. They are one-sided where the image has kinks (the trilinear interpolant at the faces between
//! voxels, a confidence at the ends of its range), and know nothing of jumps from one edge to another.

use nalgebra::{SMatrix, SVector, Vector3};
use rayon::prelude::*;

use super::base_force::BaseForce;
use super::image_force::{ImageForce, SurfaceGain};
use super::{BoundaryTarget, ForceScheme, ImageInstant};
use crate::mechanics::{LoadTangent, TakenStep};
use crate::mesh::{SurfaceTag, TaggedSurface};

/// How far a vertex is moved for a difference, mm.
const REACH_MM: f64 = 1e-3;

/// How far an area vector is turned or stretched for a difference, relative to its length.
const REACH_OF_AREA: f64 = 1e-4;

/// Rounds of the secant that follows a crossing.
const SECANT_LIMIT: usize = 12;

/// The derivative of [`ImageForce`] in one step.
pub(super) struct ImageTangent<'a> {
    surface: &'a TaggedSurface,
    taken: TakenStep<'a>,
    surfaces: Vec<SurfaceTangent<'a>>,
}

/// One surface of it.
struct SurfaceTangent<'a> {
    tag: SurfaceTag,
    gain_kpa_per_mm: f64,
    neighbours: &'a [Vec<usize>],
    agreement_mm: f64,
    agreement_rounds: usize,
    vertices: &'a [usize],
    /// A vertex of the surface that has a target, in its place.
    places: Vec<Option<PlaceTangent>>,
    /// S(c), S(cs) a place.
    masses: [Vec<f64>; 2],
}

/// One vertex of it.
struct PlaceTangent {
    here: Pull,
    /// Derivative of [`Pull`] by o and a.
    by_place: SMatrix<f64, 5, 6>,
    is_held_out: bool,
}

/// G a unit of gain (mN at the step's end), s and c.
type Pull = SVector<f64, 5>;

impl<'a> ImageTangent<'a> {
    pub(super) fn new(force: &'a ImageForce<'a>, taken: &TakenStep<'a>) -> Self {
        let image_time_s = if force.scheme == ForceScheme::Explicit { taken.time_s } else { taken.time_s + taken.step_s };
        let instant = ImageInstant::new(force.cine, image_time_s);
        let surfaces = force.surfaces().iter().map(|one| SurfaceTangent::new(force, one, taken, &instant)).collect();
        Self { surface: force.surface, taken: *taken, surfaces }
    }
}

impl LoadTangent for ImageTangent<'_> {
    fn add_force(&self, position_rate_mm: &[Vector3<f64>], gain_rate: &dyn Fn(SurfaceTag) -> f64, force_mn: &mut [Vector3<f64>]) {
        for one in &self.surfaces {
            let gain_rate = gain_rate(one.tag);
            if one.gain_kpa_per_mm > 0.0 {
                let area_rate_mm2 = area_rates_mm2(self.surface, one.tag, &self.taken.state.position_mm, position_rate_mm);
                one.add_force(position_rate_mm, &area_rate_mm2, gain_rate, force_mn);
            } else if gain_rate != 0.0 {
                one.add_force(&[], &[], gain_rate, force_mn);
            }
        }
    }
}

impl<'a> SurfaceTangent<'a> {
    fn new(force: &ImageForce<'_>, one: &'a SurfaceGain, taken: &TakenStep<'_>, instant: &ImageInstant) -> Self {
        let (search, position_mm) = (&one.search, &taken.state.position_mm);
        let appearance = search.appearance();
        let found = search.find(force.surface, position_mm, instant);
        let area_mm2 = force.surface.vertex_area_vectors_mm2(appearance.tag, position_mm);
        let tangent = |target: &BoundaryTarget| {
            let (vertex, place) = (target.vertex, appearance.vertices.binary_search(&target.vertex).ok()?);
            let pull = |origin_mm: &Vector3<f64>, area_mm2: &Vector3<f64>| {
                let normal = area_mm2.try_normalize(0.0)?;
                let near_mm = target.signed_distance_mm;
                let (distance_mm, image_normal, confidence) = search.follow(place, origin_mm, &normal, near_mm, instant)?;
                let there = BoundaryTarget { normal, image_normal, signed_distance_mm: distance_mm, confidence, ..*target };
                let load = force.scheme.load(&there, origin_mm, area_mm2.norm() * confidence);
                let force_mn = load.force_mn - load.stiffness_mn_per_mm * taken.end_mm[vertex];
                Some(Pull::new(force_mn.x, force_mn.y, force_mn.z, distance_mm, confidence))
            };
            let here = pull(&position_mm[vertex], &area_mm2[vertex])?;
            let by_place = by_place(pull, &position_mm[vertex], &area_mm2[vertex]);
            Some((place, PlaceTangent { here, by_place, is_held_out: force.is_held_out(vertex) }))
        };
        let tangents: Vec<_> = found.targets.par_iter().map(tangent).collect();
        let mut places: Vec<Option<PlaceTangent>> = appearance.vertices.iter().map(|_| None).collect();
        for (place, tangent) in tangents.into_iter().flatten() {
            places[place] = Some(tangent);
        }
        let settings = search.settings();
        let of = |value: fn(&Pull) -> f64| places.iter().map(|place| place.as_ref().map_or(0.0, |place| value(&place.here))).collect();
        let [confidence, moment]: [Vec<f64>; 2] = [of(|pull| pull[4]), of(|pull| pull[3] * pull[4])];
        let spread = |masses| spread(masses, &appearance.neighbours, settings.agreement_rounds);
        Self {
            tag: appearance.tag,
            gain_kpa_per_mm: one.gain_kpa_per_mm,
            neighbours: &appearance.neighbours,
            agreement_mm: settings.agreement_mm,
            agreement_rounds: settings.agreement_rounds,
            vertices: &appearance.vertices,
            masses: [spread(confidence), spread(moment)],
            places,
        }
    }

    /// Empty rates are zero.
    fn add_force(&self, position_rate: &[Vector3<f64>], area_rate: &[Vector3<f64>], gain_rate: f64, force_mn: &mut [Vector3<f64>]) {
        let rate_of = |(place, &vertex): (&Option<PlaceTangent>, &usize)| match (place, position_rate.get(vertex), area_rate.get(vertex)) {
            (Some(place), Some(o), Some(a)) => place.by_place * SVector::<f64, 6>::new(o.x, o.y, o.z, a.x, a.y, a.z),
            _ => Pull::zeros(),
        };
        let rates: Vec<Pull> = self.places.iter().zip(self.vertices).map(rate_of).collect();
        let spread = |masses| spread(masses, self.neighbours, self.agreement_rounds);
        let confidence_rates = spread(rates.iter().map(|rate| rate[4]).collect());
        let moment_rate = |(place, rate): (&Option<PlaceTangent>, &Pull)| {
            place.as_ref().map_or(0.0, |place| rate[3] * place.here[4] + place.here[3] * rate[4])
        };
        let moment_rates = spread(self.places.iter().zip(&rates).map(moment_rate).collect());
        let [confidences, moments] = &self.masses;
        for (index, (place, rate)) in self.places.iter().zip(&rates).enumerate() {
            let Some(place) = place.as_ref().filter(|place| !place.is_held_out && confidences[index] > 0.0) else { continue };
            let average_mm = moments[index] / confidences[index];
            let average_rate_mm = (moment_rates[index] - average_mm * confidence_rates[index]) / confidences[index];
            let apart = (place.here[3] - average_mm) / self.agreement_mm;
            let share = (1.0 + apart * apart).recip();
            let share_rate = -2.0 * apart * share * share * (rate[3] - average_rate_mm) / self.agreement_mm;
            let (pull, pull_rate) = (place.here.fixed_rows::<3>(0), rate.fixed_rows::<3>(0));
            force_mn[self.vertices[index]] += (pull_rate * share + pull * share_rate) * self.gain_kpa_per_mm + pull * (share * gain_rate);
        }
    }
}

/// The derivative by central differences; zero along a direction in which the edge is lost on a side.
fn by_place(
    pull: impl Fn(&Vector3<f64>, &Vector3<f64>) -> Option<Pull>,
    origin_mm: &Vector3<f64>,
    area_mm2: &Vector3<f64>,
) -> SMatrix<f64, 5, 6> {
    let mut derivative = SMatrix::<f64, 5, 6>::zeros();
    let area_reach_mm2 = REACH_OF_AREA * area_mm2.norm();
    for axis in 0..3 {
        let (shift, turn) = (Vector3::ith(axis, REACH_MM), Vector3::ith(axis, area_reach_mm2));
        if let (Some(after), Some(before)) = (pull(&(origin_mm + shift), area_mm2), pull(&(origin_mm - shift), area_mm2)) {
            derivative.set_column(axis, &((after - before) / (2.0 * REACH_MM)));
        }
        if let (Some(after), Some(before)) = (pull(origin_mm, &(area_mm2 + turn)), pull(origin_mm, &(area_mm2 - turn))) {
            derivative.set_column(3 + axis, &((after - before) / (2.0 * area_reach_mm2)));
        }
    }
    derivative
}

/// The root of a height near a distance by the secant, mm.
pub(super) fn follow_crossing(near_mm: f64, height: impl Fn(f64) -> Option<f64>) -> Option<f64> {
    let (mut last_mm, mut at_mm) = (near_mm - REACH_MM, near_mm);
    let (mut last, mut value) = (height(last_mm)?, height(at_mm)?);
    for _ in 0..SECANT_LIMIT {
        let step_mm = -value * (at_mm - last_mm) / (value - last);
        if !step_mm.is_finite() {
            break;
        }
        (last_mm, last) = (at_mm, value);
        at_mm += step_mm;
        value = height(at_mm)?;
        if step_mm.abs() < 1e-12 {
            break;
        }
    }
    Some(at_mm)
}

/// Masses spread along a surface: every round each place takes the mean of itself and its neighbours.
fn spread(mut masses: Vec<f64>, neighbours: &[Vec<usize>], rounds: usize) -> Vec<f64> {
    for _ in 0..rounds {
        let mean = |(own, list): (&f64, &Vec<usize>)| (own + list.iter().map(|&n| masses[n]).sum::<f64>()) / (list.len() + 1) as f64;
        masses = masses.iter().zip(neighbours).map(mean).collect();
    }
    masses
}

/// How the area vectors of a surface change: they are of second degree in the positions, so the central difference is exact.
fn area_rates_mm2(
    surface: &TaggedSurface,
    tag: SurfaceTag,
    position_mm: &[Vector3<f64>],
    position_rate_mm: &[Vector3<f64>],
) -> Vec<Vector3<f64>> {
    let moved = |by: f64| {
        let moved: Vec<Vector3<f64>> = position_mm.iter().zip(position_rate_mm).map(|(y, rate)| y + rate * by).collect();
        surface.vertex_area_vectors_mm2(tag, &moved)
    };
    // A change of 1 mm at most keeps the digits.
    let largest = position_rate_mm.iter().map(Vector3::amax).fold(0.0, f64::max);
    let by = if largest > 0.0 { largest.recip() } else { 1.0 };
    moved(by).into_iter().zip(moved(-by)).map(|(after, before)| (after - before) / (2.0 * by)).collect()
}

/// The derivative of [`BaseForce`] in one step: $F = 2\gamma c\,P\,r$ with $r = Z - Y^{t+h}$ and $P = a a^\top/|a|$ or $|a| I$.
pub(super) struct BaseTangent<'a> {
    pub(super) force: &'a BaseForce<'a>,
    pub(super) taken: TakenStep<'a>,
}

impl LoadTangent for BaseTangent<'_> {
    fn add_force(&self, position_rate_mm: &[Vector3<f64>], gain_rate: &dyn Fn(SurfaceTag) -> f64, force_mn: &mut [Vector3<f64>]) {
        let Self { force, taken } = self;
        let (gain, gain_rate) = (force.gain_kpa_per_mm, gain_rate(SurfaceTag::Base));
        let position_mm = &taken.state.position_mm;
        let area_mm2 = force.surface.vertex_area_vectors_mm2(SurfaceTag::Base, position_mm);
        let area_rate_mm2 = area_rates_mm2(force.surface, SurfaceTag::Base, position_mm, position_rate_mm);
        for (place, &vertex) in force.matches.vertices().iter().enumerate() {
            let (displacement_mm, confidence) = force.matches.at(place, taken.time_s + taken.step_s);
            let way_mm = (force.reference_mm[vertex] + displacement_mm - taken.end_mm[vertex]) * (2.0 * confidence);
            let (area, rate) = (area_mm2[vertex], area_rate_mm2[vertex]);
            let Some(normal) = area.try_normalize(0.0) else { continue };
            let (pull, pull_rate) = force.projection.pull(&normal, &area, &rate, &way_mm);
            force_mn[vertex] += pull_rate * gain + pull * gain_rate;
        }
    }
}

impl super::BaseProjection {
    /// P r and its derivative where the area vector changes at `rate`.
    fn pull(self, normal: &Vector3<f64>, area: &Vector3<f64>, rate: &Vector3<f64>, way: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        match self {
            Self::Full => (way * area.norm(), way * normal.dot(rate)),
            Self::Normal => {
                let along = normal.dot(way);
                (area * along, rate * along + normal * rate.dot(way) - normal * (along * normal.dot(rate)))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DVector, Matrix3};

    use super::super::fixtures::{image, slab, step, still};
    use super::super::{AppearanceSettings, BaseMatches, BaseProjection, BoundarySearch, BoundarySettings, SurfaceAppearance};
    use super::*;
    use crate::mechanics::{MotionState, StepLoad, StepSystem};
    use crate::mesh::TetMesh;
    use crate::numerics::TaylorTest;

    /// A patch of a spherical shell of inner radius 20 mm; the slab's top is the inner face.
    fn patch() -> (TetMesh, TaggedSurface) {
        slab(8, |p| Vector3::new(0.6 * p.y, 0.6 * p.x, 1.0).normalize() * (20.0 + 8.0 * (1.0 - p.z)))
    }

    /// What a load exerts at the end of a step of 0.1 s from time 0, mN.
    fn exerted(load: &dyn StepLoad, position_mm: Vec<Vector3<f64>>, end_mm: &[Vector3<f64>]) -> DVector<f64> {
        let (force_mn, stiffness_mn_per_mm) = (vec![Vector3::zeros(); end_mm.len()], vec![Matrix3::zeros(); end_mm.len()]);
        let mut system = StepSystem { force_mn, stiffness_mn_per_mm, tangent: None };
        load.add_to(&MotionState::at_rest(position_mm), 0.0, 0.1, &mut system);
        let forces = system.force_mn.iter().zip(&system.stiffness_mn_per_mm).zip(end_mm).map(|((f, k), y)| f - k * y);
        DVector::from_vec(forces.flat_map(|f| [f.x, f.y, f.z]).collect())
    }

    fn wavy(count: usize, size_mm: f64) -> Vec<Vector3<f64>> {
        (0..count).map(|v| Vector3::new((1.7 * v as f64).sin(), (2.3 * v as f64).cos(), (0.9 * v as f64).sin()) * size_mm).collect()
    }

    /// Along a change of all positions and of the gain together.
    fn taylor<L: StepLoad>(mesh: &TetMesh, tag: SurfaceTag, reach: f64, load: impl Fn(f64) -> L) -> TaylorTest {
        let start: Vec<_> = mesh.vertices_mm().iter().zip(wavy(mesh.vertex_count(), 0.3)).map(|(x, w)| x * 0.97 + w).collect();
        let end: Vec<_> = start.iter().map(|y| y * 0.99).collect();
        let rate = wavy(start.len(), 1.0);
        let state = MotionState::at_rest(start.clone());
        let taken = TakenStep { state: &state, time_s: 0.0, step_s: 0.1, end_mm: &end };
        let here = load(0.0);
        let mut slope = vec![Vector3::zeros(); start.len()];
        let gain_rate = |of: SurfaceTag| if of == tag { 2.0 } else { 0.0 };
        here.tangent(&taken).unwrap().add_force(&rate, &gain_rate, &mut slope);
        let slope = DVector::from_vec(slope.iter().flat_map(|f| [f.x, f.y, f.z]).collect());
        let run = |by: &DVector<f64>| {
            let moved = start.iter().zip(&rate).map(|(y, rate)| y + rate * by[0]).collect();
            Ok::<_, ()>(exerted(&load(2.0 * by[0]), moved, &end))
        };
        TaylorTest::run(run, &DVector::zeros(1), &DVector::repeat(1, 1.0), &slope, reach, 4).unwrap()
    }

    /// Bright blood within an ellipsoid that the patch is oblique to; one in nine vertices is held out. The second-order remainder is of
    /// reaches within which few vertices cross from voxel to voxel.
    #[test]
    fn the_image_force_passes_the_taylor_test_in_every_scheme() {
        let (mesh, surface) = patch();
        let seen = |axes: Vector3<f64>| {
            still(image(Vector3::repeat(34.0), Vector3::repeat(1.0), move |p| {
                100.0 + 400.0 * step(18.0 * (1.0 - p.component_div(&axes).norm()), 2.0)
            }))
        };
        let (reference, moved) = (seen(Vector3::repeat(20.0)), seen(Vector3::new(17.0, 23.0, 18.5)));
        let tag = SurfaceTag::EndocardiumLv;
        let sides = AppearanceSettings::default();
        let appearance =
            SurfaceAppearance::learn(&surface, tag, mesh.vertices_mm(), (&ImageInstant::new(&reference, 0.0), 0.0), &sides).unwrap();
        let search = BoundarySearch::new(appearance, sides, BoundarySettings::default()).unwrap();
        let held_out: Vec<bool> = (0..mesh.vertex_count()).map(|vertex| vertex % 9 == 0).collect();
        for scheme in [ForceScheme::Explicit, ForceScheme::Published, ForceScheme::Exact, ForceScheme::Variational] {
            let load = |more: f64| {
                let surfaces = vec![SurfaceGain { search: search.clone(), gain_kpa_per_mm: 5.0 + more }];
                ImageForce::new(&moved, &surface, surfaces, scheme, held_out.clone()).unwrap()
            };
            let test = taylor(&mesh, tag, 2.5e-3, load);
            assert!((test.order() - 2.0).abs() < 0.25, "{scheme:?}: order {}, {test:?}", test.order());
        }
    }

    #[test]
    fn the_base_force_passes_the_taylor_test_in_both_projections() {
        let (mesh, surface) = patch();
        let vertices = surface.vertices_with(SurfaceTag::Base);
        let displacements = vec![wavy(vertices.len(), 2.0), wavy(vertices.len(), -1.0)];
        let confidence = vec![(0..vertices.len()).map(|v| 0.5 + 0.4 * (v as f64).sin()).collect(); 2];
        let matches = BaseMatches::new(vertices, vec![0.0, 0.4], 0.8, displacements, confidence);
        for projection in [BaseProjection::Normal, BaseProjection::Full] {
            let load = |more: f64| BaseForce::new(&surface, &matches, mesh.vertices_mm(), projection, 5.0 + more).unwrap();
            let test = taylor(&mesh, SurfaceTag::Base, 0.05, load);
            assert!((test.order() - 2.0).abs() < 0.1, "{projection:?}: order {}, {test:?}", test.order());
        }
    }
}
