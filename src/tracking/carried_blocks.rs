//! Blocks that deform with the tissue: matched from where the tracked heart carries them and as it deforms them.
//!
//! A block of the reference image that straddles the base is a bad likeness of itself at end-systole: the wall below it has thickened,
//! turned and drawn in, what lies above it has not. Compared as it was, it is found where the images have deformed least, which is up
//! along the valve (5 mm too high in study 07). So each voxel of the block is taken from where its tissue came from, $X + F^{-1} s$, and
//! voxels beyond the base, whose deformation no model knows, are left out. Blood and surroundings can be dimmed to the wall's own range: a block
//! whose edges do not quite fit is found where they fit best, whatever the texture says.

use std::ops::RangeInclusive;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::appearance::quantile;
use super::block_matching::{check, highest_variance, trust};
use super::blocks::{Block, Match, deformed_block, search};
use super::pyramid::Pyramid;
use super::tissue_mask::TissueMask;
use super::{BlockMatchingSettings, TrackingError};
use crate::image::{CineSequence, Volume};
use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};

/// Carried blocks are searched this many voxels around the place that is expected.
const REACH_VOXELS: f64 = 3.0;

/// How the tissue around some vertices of a mesh is carried and deformed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Carrier {
    vertices: Vec<usize>,
    /// Of all vertices of the mesh.
    rest_mm: Vec<Vector3<f64>>,
    /// The vertices around each, with their weights.
    near: Vec<Vec<(usize, f64)>>,
}

/// Displacements (mm) and $F^{-1}$ by place.
pub(super) type Carried = (Vec<Vector3<f64>>, Vec<Matrix3<f64>>);

impl Carrier {
    /// The deformation at each of `vertices` is that of the vertices within `reach_mm`, nearer ones counting more:
    /// $F = (\sum w\, \Delta y \Delta x^\top + \epsilon I)(\sum w\, \Delta x \Delta x^\top + \epsilon I)^{-1}$, $w = (1 - |\Delta x|^2/r^2)^2$.
    pub(super) fn new(rest_mm: &[Vector3<f64>], vertices: Vec<usize>, reach_mm: f64) -> Self {
        let near = |&vertex: &usize| {
            let weight =
                |other: usize| (other, (1.0 - (rest_mm[other] - rest_mm[vertex]).norm_squared() / reach_mm.powi(2)).max(0.0).powi(2));
            (0..rest_mm.len()).filter(|&other| other != vertex).map(weight).filter(|(_, weight)| *weight > 0.0).collect()
        };
        let near = vertices.par_iter().map(near).collect();
        Self { vertices, rest_mm: rest_mm.to_vec(), near }
    }

    pub(super) fn vertices(&self) -> &[usize] {
        &self.vertices
    }

    pub(super) fn centres_mm(&self) -> Vec<Vector3<f64>> {
        self.vertices.iter().map(|&vertex| self.rest_mm[vertex]).collect()
    }

    /// Where a mesh at `now_mm` has carried them.
    pub(super) fn carry(&self, now_mm: &[Vector3<f64>]) -> Carried {
        let displacement = self.vertices.iter().map(|&vertex| now_mm[vertex] - self.rest_mm[vertex]);
        let inverse = self.vertices.iter().zip(&self.near).map(|(&vertex, near)| inverse_gradient(&self.rest_mm, now_mm, vertex, near));
        (displacement.collect(), inverse.collect())
    }
}

/// $F^{-1}$ at a vertex; the identity where F cannot be inverted. A small ε keeps directions without neighbours as they were.
fn inverse_gradient(rest_mm: &[Vector3<f64>], now_mm: &[Vector3<f64>], vertex: usize, near: &[(usize, f64)]) -> Matrix3<f64> {
    const REGULARISATION: f64 = 0.01;
    let (mut moved, mut still) = (Matrix3::zeros(), Matrix3::zeros());
    for &(other, weight) in near {
        let (before, now) = (rest_mm[other] - rest_mm[vertex], now_mm[other] - now_mm[vertex]);
        moved += now * before.transpose() * weight;
        still += before * before.transpose() * weight;
    }
    let kept = Matrix3::identity() * (REGULARISATION * still.trace() / 3.0);
    (moved + kept).try_inverse().map_or_else(Matrix3::identity, |inverse| (still + kept) * inverse)
}

/// The plane of the base at rest: nothing is known of how the tissue beyond it deforms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BasePlane {
    point_mm: Vector3<f64>,
    normal: Vector3<f64>,
}

impl BasePlane {
    /// The mean plane of the base; nothing of a mesh without one.
    pub(super) fn of(surface: &TaggedSurface, position_mm: &[Vector3<f64>]) -> Option<Self> {
        let area_mm2 = surface.vertex_area_vectors_mm2(SurfaceTag::Base, position_mm);
        let total: f64 = area_mm2.iter().map(Vector3::norm).sum();
        let point_mm = area_mm2.iter().zip(position_mm).map(|(area, point)| point * area.norm()).sum::<Vector3<f64>>() / total;
        let normal = area_mm2.iter().sum::<Vector3<f64>>().try_normalize(0.0)?;
        Some(Self { point_mm, normal })
    }

    fn height_mm(&self, point_mm: &Vector3<f64>) -> f64 {
        (point_mm - self.point_mm).dot(&self.normal)
    }
}

/// The intensities of a wall at rest: $m \pm w\,\sigma$ of the values at the centres of its tetrahedra, m their median and σ 1.4826 times the median
/// distance from it, which is the standard deviation of a normal distribution. Nothing where the image shows none of it.
pub(super) fn wall_intensities(image: &Volume, mesh: &TetMesh, window: f64) -> Option<RangeInclusive<f32>> {
    const DEVIATION_OF_MEDIAN: f64 = 1.4826;
    let centre_mm = |corners: &[usize; 4]| corners.iter().map(|&corner| mesh.vertices_mm()[corner]).sum::<Vector3<f64>>() / 4.0;
    let values: Vec<f64> = mesh.tetrahedra().iter().filter_map(|corners| image.sample(&centre_mm(corners))).collect();
    let middle = quantile(values.iter().copied(), 0.5);
    let reach = window * DEVIATION_OF_MEDIAN * quantile(values.iter().map(|value| (value - middle).abs()), 0.5);
    (!values.is_empty()).then_some((middle - reach) as f32..=(middle + reach) as f32)
}

/// What is known of the wall at rest around carried blocks.
#[derive(Default)]
pub(super) struct WallAtRest {
    pub(super) plane: Option<BasePlane>,
    pub(super) tissue: Option<TissueMask>,
    /// Intensities beyond it count as its ends.
    pub(super) intensities: Option<RangeInclusive<f32>>,
}

impl WallAtRest {
    fn seen(&self, image: Pyramid) -> Pyramid {
        match &self.intensities {
            Some(range) => image.clipped(range),
            None => image,
        }
    }
}

/// The blocks of the reference frame around some places, to be found again in other frames, each from where it is carried and deformed as
/// the tissue is, without what lies beyond the base or outside the wall.
pub(super) struct CarriedBlocks<'a> {
    cine: &'a CineSequence,
    settings: BlockMatchingSettings,
    wall: WallAtRest,
    centres_mm: Vec<Vector3<f64>>,
    reference: Pyramid,
    usable: Vec<bool>,
    neighbours: Vec<Vec<usize>>,
}

impl<'a> CarriedBlocks<'a> {
    /// The blocks around `centres_mm`.
    ///
    /// # Errors
    /// As [`super::match_base`].
    pub(super) fn new(
        cine: &'a CineSequence,
        reference_frame: usize,
        centres_mm: Vec<Vector3<f64>>,
        wall: WallAtRest,
        settings: BlockMatchingSettings,
    ) -> Result<Self, TrackingError> {
        check(&settings)?;
        let radius = settings.block_radius_voxels;
        let side_mm = settings.voxel_mm * (2 * radius + 2) as f64;
        let image = &cine.frames()[reference_frame % cine.frames().len()];
        let reference = wall.seen(Pyramid::around(image, &centres_mm, side_mm, settings.voxel_mm, 1));
        let neighbours = neighbours_within(&centres_mm, settings.voxel_mm * (2 * radius + 1) as f64);
        let mut blocks = Self { cine, settings, wall, centres_mm, reference, usable: Vec::new(), neighbours };
        let places = 0..blocks.centres_mm.len();
        let still: Vec<Vec<Block>> =
            places.into_par_iter().map(|place| blocks.block(place, &Matrix3::identity()).into_iter().collect()).collect();
        blocks.usable = highest_variance(&still, settings.variance_share);
        if blocks.usable.iter().all(|&is_usable| !is_usable) {
            return Err(TrackingError::BaseNotCovered { vertex_count: blocks.centres_mm.len() });
        }
        Ok(blocks)
    }

    fn block(&self, place: usize, inverse: &Matrix3<f64>) -> Option<Block> {
        let centre_mm = &self.centres_mm[place];
        let WallAtRest { plane, tissue, .. } = &self.wall;
        let highest_mm = plane.map_or(f64::INFINITY, |plane| plane.height_mm(centre_mm).max(0.0) + 1e-3);
        let is_below = |point_mm: &Vector3<f64>| plane.is_none_or(|plane| plane.height_mm(point_mm) <= highest_mm);
        let counts = |point_mm: &Vector3<f64>| is_below(point_mm) && tissue.as_ref().is_none_or(|tissue| tissue.holds(point_mm));
        deformed_block(&self.reference.levels()[0], centre_mm, inverse, self.settings.block_radius_voxels, counts)
    }

    /// Displacements (mm) of the blocks in a frame and how far each is to be trusted, which its neighbours decide: see [`agreement`].
    pub(super) fn find(&self, frame: usize, (carried_mm, inverse): &Carried) -> (Vec<Vector3<f64>>, Vec<f64>) {
        let BlockMatchingSettings { voxel_mm, block_radius_voxels, similarity, range_mm, trimmed_share, .. } = self.settings;
        let range_mm = range_mm.min(REACH_VOXELS * voxel_mm);
        let greatest_mm = carried_mm.iter().map(Vector3::norm).fold(0.0, f64::max);
        let reach_mm = greatest_mm + range_mm + voxel_mm * (block_radius_voxels + 2) as f64;
        let moving = self.wall.seen(Pyramid::around(&self.cine.frames()[frame], &self.centres_mm, reach_mm, voxel_mm, 1));
        let find = |place: usize| {
            let block = [self.block(place, &inverse[place]).filter(|_| self.usable[place])?];
            search(&block, &moving, &self.centres_mm[place], &carried_mm[place], (similarity, range_mm))
        };
        let places = 0..self.centres_mm.len();
        let found: Vec<Option<Match>> = places.clone().into_par_iter().map(find).collect();
        let beside: Vec<_> =
            found.iter().zip(carried_mm).map(|(found, carried)| found.map(|m| (m.displacement_mm - carried, m.similarity))).collect();
        let (common_mm, trust) = agreement(&beside, &self.neighbours, trimmed_share);
        let chosen = |place: usize| match found[place].filter(|_| trust[place] > 0.0) {
            Some(own) => (own.displacement_mm, own.similarity * trust[place]),
            None => (carried_mm[place] + common_mm[place], 0.0),
        };
        places.map(chosen).unzip()
    }
}

/// For each point those within a distance, itself among them.
fn neighbours_within(points: &[Vector3<f64>], distance_mm: f64) -> Vec<Vec<usize>> {
    let near = |point: &Vector3<f64>| (0..points.len()).filter(|&other| (points[other] - point).norm() < distance_mm).collect();
    points.par_iter().map(near).collect()
}

/// The mean of a place's neighbours, weighted by similarity and trust, and the trust of each by its distance from that mean.
fn agreement(beside: &[Option<(Vector3<f64>, f64)>], neighbours: &[Vec<usize>], share: f64) -> (Vec<Vector3<f64>>, Vec<f64>) {
    const ROUNDS: usize = 3;
    let mut trust: Vec<f64> = beside.iter().map(|found| if found.is_some() { 1.0 } else { 0.0 }).collect();
    let mut common = vec![Vector3::zeros(); beside.len()];
    for _ in 0..ROUNDS {
        let mean = |near: &Vec<usize>| {
            let seen = near.iter().filter_map(|&n| beside[n].map(|(shift_mm, similarity)| (shift_mm, similarity * trust[n])));
            let (sum, mass) =
                seen.fold((Vector3::zeros(), 0.0), |(sum, mass), (shift_mm, weight)| (sum + shift_mm * weight, mass + weight));
            if mass > 0.0 { sum / mass } else { Vector3::zeros() }
        };
        common = neighbours.par_iter().map(mean).collect();
        trust = self::trust(beside.iter().zip(&common).map(|(found, common)| found.map(|(shift, _)| (shift - common).norm())), share);
    }
    (common, trust)
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{image, slab, waves};
    use super::super::{BlockShape, Similarity, match_base};
    use super::*;
    use crate::mesh::{TaggedSurface, TetMesh};

    const HALF_MM: f64 = 34.0;
    const EVERY: BlockMatchingSettings = BlockMatchingSettings {
        similarity: Similarity::Ssd,
        voxel_mm: 1.5,
        block_radius_voxels: 4,
        levels: 3,
        range_mm: 6.0,
        variance_share: 1.0,
        trimmed_share: 1.0,
        shape: BlockShape::Carried,
        window: None,
    };

    /// Points of a lattice of 4 mm within 16 mm, those within 10 mm of the middle first.
    fn lattice() -> (Vec<Vector3<f64>>, usize) {
        let side = || (-4..=4).map(|n| 4.0 * f64::from(n));
        let mut points: Vec<Vector3<f64>> =
            side().flat_map(|z| side().flat_map(move |y| side().map(move |x| Vector3::new(x, y, z)))).collect();
        points.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
        let inner = points.iter().take_while(|p| p.norm() < 10.0).count();
        (points, inner)
    }

    fn two_frames(first: impl Fn(Vector3<f64>) -> f64, second: impl Fn(Vector3<f64>) -> f64) -> CineSequence {
        let frames = vec![
            image(Vector3::repeat(HALF_MM), Vector3::repeat(1.5), first),
            image(Vector3::repeat(HALF_MM), Vector3::repeat(1.5), second),
        ];
        CineSequence::new(frames, vec![0.0, 0.4], 0.8).unwrap()
    }

    /// RMS distance from the truth of where blocks around some places are found in the second frame.
    fn rms_mm(found: &[Vector3<f64>], truth: impl Fn(usize) -> Vector3<f64>) -> f64 {
        let errors: Vec<f64> = found.iter().enumerate().map(|(place, d)| (d - truth(place)).norm()).collect();
        crate::numerics::root_mean_square(&errors)
    }

    fn carried(
        cine: &CineSequence,
        rest: &[Vector3<f64>],
        now: &[Vector3<f64>],
        count: usize,
        plane: Option<BasePlane>,
    ) -> Vec<Vector3<f64>> {
        let carrier = Carrier::new(rest, (0..count).collect(), EVERY.deformation_reach_mm());
        CarriedBlocks::new(cine, 0, carrier.centres_mm(), WallAtRest { plane, ..WallAtRest::default() }, EVERY)
            .unwrap()
            .find(1, &carrier.carry(now))
            .0
    }

    /// Tissue that turns by 35° and thickens by a quarter is lost to blocks as they were; blocks that a motion 1.5 mm beside the truth
    /// carries and deforms find it to a quarter of a voxel.
    #[test]
    fn blocks_that_deform_with_the_tissue_find_it_where_stiff_ones_do_not() {
        let gradient =
            nalgebra::Rotation3::from_euler_angles(0.0, 0.0, 0.6).matrix() * Matrix3::from_diagonal(&Vector3::new(1.25, 0.9, 0.9));
        let (inverse, pattern) = (gradient.try_inverse().unwrap(), waves(11));
        let cine = two_frames(&pattern, |p| pattern(inverse * p));
        let (rest, count) = lattice();
        let beside = Vector3::new(1.0, -0.8, 0.8);
        let expected: Vec<Vector3<f64>> = rest.iter().map(|x| gradient * x + beside).collect();
        let truth = |place: usize| gradient * rest[place] - rest[place];
        let stiff = match_base(&cine, 0, &(0..count).collect::<Vec<_>>(), &rest, &EVERY).unwrap();
        let (with, without) = (rms_mm(&carried(&cine, &rest, &expected, count, None), truth), rms_mm(&stiff.displacement_mm()[1], truth));
        assert!(with < 0.4 && without > 1.0, "{with} mm carried, {without} mm stiff");
    }

    /// Tissue that slides by 2.2 mm along a wavy edge to bright blood: whole blocks are held by the edge, which has not moved; dimmed ones
    /// find the tissue to half a voxel.
    #[test]
    fn texture_that_slides_along_an_edge_is_found_when_the_edge_is_dimmed() {
        let pattern = waves(5);
        let scene = |p: Vector3<f64>, slid_mm: f64| {
            let is_blood = p.x > 2.0 * (p.y / 2.5).sin();
            if is_blood { 400.0 } else { 100.0 + 0.1 * pattern(p - Vector3::y() * slid_mm) }
        };
        let cine = two_frames(|p| scene(p, 0.0), |p| scene(p, 2.2));
        let centres: Vec<Vector3<f64>> =
            (0..48).map(|n| Vector3::new(-4.0, 4.0 * f64::from(n % 8) - 14.0, 4.0 * f64::from(n / 8) - 10.0)).collect();
        let still: Carried = (vec![Vector3::zeros(); centres.len()], vec![Matrix3::identity(); centres.len()]);
        let error = |intensities| {
            let wall = WallAtRest { intensities, ..WallAtRest::default() };
            let settings = BlockMatchingSettings { similarity: Similarity::Ncc, ..EVERY };
            rms_mm(&CarriedBlocks::new(&cine, 0, centres.clone(), wall, settings).unwrap().find(1, &still).0, |_| Vector3::y() * 2.2)
        };
        let (dimmed, whole) = (error(Some(84.0..=116.0)), error(None));
        assert!(dimmed < 0.75 && whole > 2.0 * dimmed, "{dimmed} mm dimmed, {whole} mm whole");
    }

    /// Of intensities that rise evenly from 440 to 560 the median is 500 and σ 1.4826 × 30; a twentieth of blood within the wall hardly counts.
    #[test]
    fn the_range_of_a_wall_is_that_of_its_bulk() {
        let (mesh, _) = slab(20, |p| p * 20.0);
        let seen = image(Vector3::repeat(34.0), Vector3::repeat(1.0), |p| if p.y > 18.0 { 5000.0 } else { 500.0 + 3.0 * p.x });
        let range = wall_intensities(&seen, &mesh, 2.0).unwrap();
        let expected = 2.0 * 1.4826 * 30.0;
        assert!(
            (f64::from(*range.start()) + expected - 500.0).abs() < 12.0 && (f64::from(*range.end()) - expected - 500.0).abs() < 12.0,
            "{range:?}"
        );
    }

    /// Below a base at z = 0 the tissue rises by 2.2 mm, above it nothing moves: without what lies beyond the base blocks find it
    /// to a quarter of a voxel.
    #[test]
    fn what_lies_beyond_the_base_does_not_hold_it_back() {
        let pattern = waves(5);
        let cine = two_frames(&pattern, |p| if p.z > 2.2 { pattern(p) } else { pattern(p - Vector3::z() * 2.2) });
        let ring: Vec<Vector3<f64>> = (0..16)
            .map(|n| f64::from(n) * std::f64::consts::FRAC_PI_8)
            .map(|a| Vector3::new(10.0 * a.cos(), 10.0 * a.sin(), 0.0))
            .collect();
        let mesh = TetMesh::new(vec![Vector3::zeros(), Vector3::y(), Vector3::x(), -Vector3::z()], vec![[0, 1, 2, 3]]).unwrap();
        let tags =
            mesh.boundary_triangles().iter().map(|t| if t.contains(&3) { SurfaceTag::Epicardium } else { SurfaceTag::Base }).collect();
        let plane = BasePlane::of(&TaggedSurface::new(&mesh, tags).unwrap(), mesh.vertices_mm()).unwrap();
        let error = |plane| rms_mm(&carried(&cine, &ring, &ring, 16, plane), |_| Vector3::z() * 2.2);
        let (cut, whole) = (error(Some(plane)), error(None));
        assert!(cut < 0.375 && whole > 2.0 * cut, "{cut} mm cut, {whole} mm whole");
    }
}
