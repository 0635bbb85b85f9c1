//! The heart as the scanner sees it: wall, blood, and a continuation of both beyond the base plane.
//!
//! Scans do not end where the model does. Above its base the wall goes on, thinner, as atrium and outflow tract, and so does the blood.
//! The continuation hangs on the base and is held at its far end, as the atrial roof is: a point at height s above the base takes the
//! share 1 − s/L of the base's displacement, so the base is a place in a deforming image and not the edge of one.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::anatomy::Anatomy;
use crate::mesh::SurfaceTag;

/// Height over which the continued wall thins, mm.
const TAPER_HEIGHT_MM: f64 = 12.0;
/// Thickness of the continued wall relative to the wall at the base, beyond the taper.
const TAPERED_SHARE: f64 = 0.4;
/// Height of a layer of the continuation, mm.
const LAYER_HEIGHT_MM: f64 = 3.0;

/// A point that moves with vertices of the mesh: rest + carry · mean displacement of its anchors.
#[derive(Debug, Clone, PartialEq)]
struct CarriedPoint {
    anchors: Vec<usize>,
    carry: f64,
}

/// Tetrahedra and closed surfaces over the vertices of the mesh followed by carried points.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ImagedHeart {
    /// All points at rest, mm; those of the mesh first.
    pub(super) rest_mm: Vec<Vector3<f64>>,
    carried: Vec<CarriedPoint>,
    /// The myocardium of the model.
    pub(super) wall: Vec<[usize; 4]>,
    /// The wall beyond the base.
    pub(super) continuation: Vec<[usize; 4]>,
    /// Every cavity closed by its lid, oriented out of the blood.
    pub(super) cavities: Vec<Vec<[usize; 3]>>,
    /// Every cavity with the blood beyond its lid, oriented out of the blood.
    pub(super) pools: Vec<Vec<[usize; 3]>>,
}

/// The points of one layer, by the mesh vertex below them.
type Layer = BTreeMap<usize, usize>;

impl ImagedHeart {
    /// The heart with a continuation of `continuation_mm` beyond its base (0 for none).
    pub(super) fn new(anatomy: &Anatomy, continuation_mm: f64) -> Self {
        let mut heart = Self {
            rest_mm: anatomy.mesh.vertices_mm().to_vec(),
            carried: vec![],
            wall: anatomy.mesh.tetrahedra().to_vec(),
            continuation: vec![],
            cavities: vec![],
            pools: vec![],
        };
        let layers = heart.raise_layers(anatomy, continuation_mm);
        for triangle in anatomy.surface.triangles_with(SurfaceTag::Base) {
            for pair in layers.windows(2) {
                heart.continuation.extend(prism(triangle, &pair[0], &pair[1]));
            }
        }
        for (_, cavity) in &anatomy.cavities {
            let rim = cavity.rim();
            let (mut closed, mut pool) = (cavity.endocardium().to_vec(), cavity.endocardium().to_vec());
            let lid_centre = heart.carry(rim, 1.0, mean(rim, anatomy.mesh.vertices_mm()));
            closed.extend(edges(rim).map(|[a, b]| [lid_centre, a, b]));
            for pair in layers.windows(2) {
                let (lower, upper) = (&pair[0], &pair[1]);
                pool.extend(edges(rim).flat_map(|[a, b]| [[lower[&a], lower[&b], upper[&b]], [lower[&a], upper[&b], upper[&a]]]));
            }
            let roof = &layers[layers.len() - 1];
            let roof_centre =
                heart.carry(rim, if layers.len() > 1 { 0.0 } else { 1.0 }, mean_of(rim.iter().map(|v| heart.rest_mm[roof[v]])));
            pool.extend(edges(rim).map(|[a, b]| [roof_centre, roof[&a], roof[&b]]));
            heart.cavities.push(closed);
            heart.pools.push(pool);
        }
        heart
    }

    /// Where all points are when the mesh is at `position_mm`.
    pub(super) fn positions_mm(&self, position_mm: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let displacement = |vertex: &usize| position_mm[*vertex] - self.rest_mm[*vertex];
        let carried_rest = &self.rest_mm[self.rest_mm.len() - self.carried.len()..];
        let carried = self.carried.iter().zip(carried_rest);
        let moved = carried.map(|(point, rest)| rest + mean_of(point.anchors.iter().map(displacement)) * point.carry);
        position_mm.iter().copied().chain(moved).collect()
    }

    /// Stacks layers on the base; the first is the base itself.
    fn raise_layers(&mut self, anatomy: &Anatomy, continuation_mm: f64) -> Vec<Layer> {
        let rims: Vec<usize> = anatomy.cavities.iter().flat_map(|(_, cavity)| cavity.rim().iter().copied()).collect();
        let mut base = anatomy.surface.vertices_with(SurfaceTag::Base);
        base.extend(&rims);
        base.sort_unstable();
        base.dedup();
        let vertices_mm = anatomy.mesh.vertices_mm();
        let distance = |vertex: usize, rim: usize| (vertices_mm[vertex] - vertices_mm[rim]).norm_squared();
        let nearest = |vertex: usize| rims.iter().copied().min_by(|&a, &b| distance(vertex, a).total_cmp(&distance(vertex, b)));
        let roots: Vec<(usize, usize)> = base.iter().map(|&vertex| (vertex, nearest(vertex).unwrap_or(vertex))).collect();

        let mut layers = vec![base.iter().map(|&vertex| (vertex, vertex)).collect::<Layer>()];
        let layer_count = (continuation_mm / LAYER_HEIGHT_MM).ceil() as usize;
        for layer in 1..=layer_count {
            let share = layer as f64 / layer_count as f64;
            let height_mm = continuation_mm * share;
            let thickness = 1.0 - (1.0 - TAPERED_SHARE) * (height_mm / TAPER_HEIGHT_MM).min(1.0);
            let mut points = Layer::new();
            for &(vertex, rim) in &roots {
                let rest = vertices_mm[rim] + (vertices_mm[vertex] - vertices_mm[rim]) * thickness;
                points.insert(vertex, self.carry(&[vertex], 1.0 - share, rest + anatomy.axes.long_axis * height_mm));
            }
            layers.push(points);
        }
        layers
    }

    fn carry(&mut self, anchors: &[usize], carry: f64, rest_mm: Vector3<f64>) -> usize {
        self.carried.push(CarriedPoint { anchors: anchors.to_vec(), carry });
        self.rest_mm.push(rest_mm);
        self.rest_mm.len() - 1
    }
}

/// The edges of a closed loop.
fn edges(rim: &[usize]) -> impl Iterator<Item = [usize; 2]> + '_ {
    (0..rim.len()).map(|i| [rim[i], rim[(i + 1) % rim.len()]])
}

fn mean(vertices: &[usize], points: &[Vector3<f64>]) -> Vector3<f64> {
    mean_of(vertices.iter().map(|&vertex| points[vertex]))
}

fn mean_of(points: impl ExactSizeIterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let count = points.len() as f64;
    points.sum::<Vector3<f64>>() / count
}

/// The prism over a triangle as three tetrahedra; neighbouring prisms agree because the diagonals follow the numbering.
fn prism(mut triangle: [usize; 3], lower: &Layer, upper: &Layer) -> [[usize; 4]; 3] {
    triangle.sort_unstable();
    let [a, b, c] = triangle;
    [
        [lower[&a], lower[&b], lower[&c], upper[&c]],
        [lower[&a], lower[&b], upper[&b], upper[&c]],
        [lower[&a], upper[&a], upper[&b], upper[&c]],
    ]
}
