//! Isosurface stuffing: tetrahedra of bounded dihedral angle inside an implicit function, \[Labelle2007\].
//!
//! Lattice points are inside, outside or on the surface; an edge from inside to outside has a cut point. A lattice point with a cut
//! point closer than α edge lengths is moved onto it ("warped"), so that no short edges are left; the tetrahedra that still cross the
//! surface are then replaced by a stencil of their inner part.

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector3;
use rayon::prelude::*;

use super::lattice::Lattice;
use super::stencils::Stencils;
use super::{AnatomyError, LevelSet};

/// Warping thresholds α as a fraction of the edge, for edges of h and √3/2 h: the pair of \[Labelle2007\] table 1 that guarantees the
/// largest least dihedral angle, 10.78°.
const ALPHA_LONG: f64 = 0.249_99;
const ALPHA_SHORT: f64 = 0.411_89;

/// Tetrahedra with what is known of their vertices.
#[derive(Debug, Clone)]
pub(super) struct StuffedMesh {
    pub(super) vertices_mm: Vec<Vector3<f64>>,
    pub(super) tetrahedra: Vec<[usize; 4]>,
    /// Whether the vertex lies on the zero level set.
    pub(super) is_on_surface: Vec<bool>,
    /// Whether the vertex lies in the base plane.
    pub(super) is_in_plane: Vec<bool>,
}

impl StuffedMesh {
    /// Numbers the vertices anew without those that no tetrahedron has.
    pub(super) fn drop_unused_vertices(&mut self) {
        let mut is_used = vec![false; self.vertices_mm.len()];
        self.tetrahedra.iter().flatten().for_each(|&vertex| is_used[vertex] = true);
        let new_number: Vec<usize> = is_used
            .iter()
            .scan(0, |count, &used| {
                *count += usize::from(used);
                Some(*count - usize::from(used))
            })
            .collect();
        self.tetrahedra.iter_mut().flatten().for_each(|vertex| *vertex = new_number[*vertex]);
        retain_used(&mut self.vertices_mm, &is_used);
        retain_used(&mut self.is_on_surface, &is_used);
        retain_used(&mut self.is_in_plane, &is_used);
    }
}

fn retain_used<T>(values: &mut Vec<T>, is_used: &[bool]) {
    let mut used = is_used.iter();
    values.retain(|_| used.next().copied().unwrap_or(false));
}

/// Stuffs the inside of `level` (negative inside) with the tetrahedra of `lattice`.
///
/// With `rooms`, which numbers the parts of the outside (the blood of each ventricle, the chest), no two of them will touch and the surface
/// will be a manifold, at the price of the angle bound where the inside is thinner than about two lattice spacings.
pub(super) fn stuff(lattice: &Lattice, level: &LevelSet, rooms: Option<&RoomOf>) -> Result<StuffedMesh, AnatomyError> {
    let mut stuffing = Stuffing::sample(lattice, level, rooms)?;
    if rooms.is_some() {
        stuffing.hold_thin_walls(level);
        stuffing.close_clefts(level);
        stuffing.fill_pockets(level);
    }
    stuffing.cut_edges(level);
    stuffing.warp(level);
    let mesh = stuffing.fill();
    if mesh.tetrahedra.is_empty() {
        return Err(AnatomyError::NothingInside { edge_length_mm: lattice.spacing_mm() });
    }
    Ok(mesh)
}

/// The least volume that warping may leave a tetrahedron, as a fraction of a lattice tetrahedron's.
const LEAST_FLATNESS: f64 = 0.02;

/// Tells the part of the outside that an outer point lies in.
pub(super) type RoomOf<'a> = dyn Fn(&Vector3<f64>) -> u8 + Sync + 'a;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Inside,
    Surface,
    Outside,
}

pub(super) struct Stuffing<'a> {
    pub(super) lattice: &'a Lattice,
    pub(super) position_mm: Vec<Vector3<f64>>,
    pub(super) level: Vec<f64>,
    pub(super) side: Vec<Side>,
    /// The part of the outside; meaningless for points that are not outside.
    pub(super) room: Vec<u8>,
    guards_topology: bool,
    /// Lattice edges from inside to outside, lower point first, and their cut points.
    edges: Vec<[usize; 2]>,
    cuts_mm: Vec<Vector3<f64>>,
}

impl<'a> Stuffing<'a> {
    fn sample(lattice: &'a Lattice, level: &LevelSet, rooms: Option<&RoomOf>) -> Result<Self, AnatomyError> {
        let count = lattice.point_count();
        let position_mm: Vec<Vector3<f64>> = (0..count).map(|point| lattice.position_mm(point)).collect();
        // A point exactly on the surface counts as just inside; its cut points are at itself, and it will be moved there.
        let value = |p: &Vector3<f64>| match level(p) {
            0.0 => -f64::MIN_POSITIVE,
            value => value,
        };
        let level: Vec<f64> = position_mm.par_iter().map(value).collect();
        if let Some(point) = level.iter().position(|value| !value.is_finite()) {
            return Err(AnatomyError::NonFiniteLevel { position_mm: position_mm[point] });
        }
        let side = level.iter().map(|&value| {
            if value < 0.0 {
                Side::Inside
            } else if value > 0.0 {
                Side::Outside
            } else {
                Side::Surface
            }
        });
        let side = side.collect();
        let room = rooms.map_or_else(|| vec![0; count], |room| position_mm.par_iter().map(room).collect());
        Ok(Self { lattice, position_mm, level, side, room, guards_topology: rooms.is_some(), edges: vec![], cuts_mm: vec![] })
    }

    fn crosses(&self, a: usize, b: usize) -> bool {
        matches!((self.side[a], self.side[b]), (Side::Inside, Side::Outside) | (Side::Outside, Side::Inside))
    }

    fn cut_edges(&mut self, level: &LevelSet) {
        let mut edges = vec![];
        self.lattice.for_each_tetrahedron(|corners| {
            for i in 0..3 {
                for j in i + 1..4 {
                    let (a, b) = (corners[i], corners[j]);
                    if self.crosses(a, b) {
                        edges.push([a.min(b), a.max(b)]);
                    }
                }
            }
        });
        edges.sort_unstable();
        edges.dedup();
        let ends = |&[a, b]: &[usize; 2]| ((self.position_mm[a], self.level[a]), (self.position_mm[b], self.level[b]));
        self.cuts_mm = edges.par_iter().map(|edge| root_between(level, ends(edge))).collect();
        self.edges = edges;
    }

    /// Moves lattice points onto cut points that are too near, in the order of the points; a point of the base plane stays in it. Where
    /// the wall is so thin that this would open or pinch it the point stays, at the price of the angle bound there.
    fn warp(&mut self, level: &LevelSet) {
        let touching = self.edges_at_points();
        let stars = self.stars(touching.keys());
        for (&point, edges) in &touching {
            let star = &stars[&point];
            let live: Vec<usize> = edges.iter().copied().filter(|&edge| self.is_live(edge) && self.is_too_near(point, edge)).collect();
            let Some((target, room)) = self.target(point, &live, level) else {
                continue;
            };
            let is_safe = || self.surface_may_pass(point, room, star) && self.stays_upright(point, &target, star, LEAST_FLATNESS);
            if !self.guards_topology || is_safe() {
                self.position_mm[point] = target;
                self.side[point] = Side::Surface;
                self.room[point] = room;
            }
        }
    }

    /// Where a point is to be moved, given the edges whose cut points are too near, and the room outside that surface.
    fn target(&self, point: usize, edges: &[usize], level: &LevelSet) -> Option<(Vector3<f64>, u8)> {
        let is_in_plane = self.lattice.is_in_plane(point);
        let distance = |edge: &usize| (self.cuts_mm[*edge] - self.position_mm[point]).norm_squared();
        let nearest = |edges: &mut dyn Iterator<Item = usize>| edges.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let room = |edge: usize| self.edges[edge].into_iter().find(|&end| self.side[end] == Side::Outside).map_or(0, |end| self.room[end]);
        let is_admissible = |edge: &usize| !is_in_plane || self.edges[*edge].iter().all(|&end| self.lattice.is_in_plane(end));
        if let Some(edge) = nearest(&mut edges.iter().copied().filter(is_admissible)) {
            return Some((self.cuts_mm[edge], room(edge)));
        }
        let edge = nearest(&mut edges.iter().copied())?;
        Some((self.slide_in_plane(point, level)?, room(edge)))
    }

    /// For every end of a cut edge its cut edges.
    fn edges_at_points(&self) -> BTreeMap<usize, Vec<usize>> {
        let mut touching: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (edge, ends) in self.edges.iter().enumerate() {
            for &point in ends {
                touching.entry(point).or_default().push(edge);
            }
        }
        touching
    }

    /// The tetrahedra that hold each of some points.
    pub(super) fn stars<'b>(&self, points: impl Iterator<Item = &'b usize>) -> HashMap<usize, Vec<[usize; 4]>> {
        let mut stars: HashMap<usize, Vec<[usize; 4]>> = points.map(|&point| (point, vec![])).collect();
        self.lattice.for_each_tetrahedron(|corners| {
            for point in corners {
                if let Some(star) = stars.get_mut(&point) {
                    star.push(corners);
                }
            }
        });
        stars
    }

    /// Whether all tetrahedra of a star keep at least the fraction `flatness` of a lattice tetrahedron's volume if its point moves.
    pub(super) fn stays_upright(&self, point: usize, place: &Vector3<f64>, star: &[[usize; 4]], flatness: f64) -> bool {
        let flat = flatness / 12.0 * self.lattice.spacing_mm().powi(3);
        star.iter().all(|corners| {
            let [a, b, c, d] = corners.map(|p| if p == point { *place } else { self.position_mm[p] });
            (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0 > flat
        })
    }

    /// Whether the surface towards a room may be led through a lattice point without a change of topology: the inner points around it
    /// hang together, and so do the outer ones; in the base plane also those of the plane alone; and every tetrahedron that reaches
    /// across to another surface still has an inner point.
    fn surface_may_pass(&self, point: usize, room: u8, star: &[[usize; 4]]) -> bool {
        let spans_emptily = |corners: &[usize; 4]| {
            let is_inside = |&&p: &&usize| p != point && self.side[p] == Side::Inside;
            let is_elsewhere = |&&p: &&usize| p != point && self.side[p] != Side::Inside && self.room[p] != room;
            corners.iter().find(is_elsewhere).is_some() && corners.iter().find(is_inside).is_none()
        };
        if star.iter().any(spans_emptily) {
            return false;
        }
        let in_plane: &[bool] = if self.lattice.is_in_plane(point) { &[false, true] } else { &[false] };
        let holds = |side: Side, only_in_plane: bool| {
            hang_together(star, &|p| p != point && self.side[p] == side && (!only_in_plane || self.lattice.is_in_plane(p)))
        };
        in_plane.iter().all(|&only_in_plane| holds(Side::Inside, only_in_plane) && holds(Side::Outside, only_in_plane))
    }

    fn is_live(&self, edge: usize) -> bool {
        self.edges[edge].iter().all(|&end| self.side[end] != Side::Surface)
    }

    fn is_too_near(&self, point: usize, edge: usize) -> bool {
        let [a, b] = self.edges[edge];
        let length_mm = (self.position_mm[a] - self.position_mm[b]).norm();
        let alpha = if length_mm > 0.9 * self.lattice.spacing_mm() { ALPHA_LONG } else { ALPHA_SHORT };
        (self.cuts_mm[edge] - self.position_mm[point]).norm() < alpha * length_mm
    }

    /// Newton's iteration on the level set within the base plane, for a point whose nearest cut point is below the plane.
    fn slide_in_plane(&self, point: usize, level: &LevelSet) -> Option<Vector3<f64>> {
        let spacing_mm = self.lattice.spacing_mm();
        let start = self.position_mm[point];
        let end = super::surface_point(level, &start, Some(&self.lattice.plane_normal()), 1e-3 * spacing_mm)?;
        ((end - start).norm() < ALPHA_SHORT * spacing_mm).then_some(end)
    }

    fn fill(self) -> StuffedMesh {
        let cut_of: HashMap<[usize; 2], usize> =
            self.edges.iter().enumerate().filter(|&(edge, _)| self.is_live(edge)).map(|(edge, &ends)| (ends, edge)).collect();
        let mut cells = Stencils { stuffing: &self, cut_of: &cut_of, tetrahedra: vec![] };
        self.lattice.for_each_tetrahedron(|corners| cells.add(corners));
        let tetrahedra = cells.tetrahedra;
        self.number(tetrahedra)
    }

    /// Numbers the vertices in use: lattice points first, then cut points (numbered from the point count on in `tetrahedra`).
    fn number(&self, mut tetrahedra: Vec<[usize; 4]>) -> StuffedMesh {
        let mut used: Vec<usize> = tetrahedra.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let new_number: HashMap<usize, usize> = used.iter().enumerate().map(|(new, &old)| (old, new)).collect();
        for vertex in tetrahedra.iter_mut().flatten() {
            *vertex = new_number[vertex];
        }
        let lattice = self.lattice;
        let is_cut = |vertex: usize| vertex >= self.position_mm.len();
        let in_plane = |vertex: usize| match vertex.checked_sub(self.position_mm.len()) {
            Some(edge) => self.edges[edge].iter().all(|&end| lattice.is_in_plane(end)),
            None => lattice.is_in_plane(vertex),
        };
        StuffedMesh {
            vertices_mm: used.iter().map(|&vertex| self.vertex_mm(vertex)).collect(),
            is_on_surface: used.iter().map(|&vertex| is_cut(vertex) || self.side[vertex] == Side::Surface).collect(),
            is_in_plane: used.iter().map(|&vertex| in_plane(vertex)).collect(),
            tetrahedra,
        }
    }

    /// Position of a lattice point, or of a cut point (numbered from the point count on).
    pub(super) fn vertex_mm(&self, vertex: usize) -> Vector3<f64> {
        vertex.checked_sub(self.position_mm.len()).map_or_else(|| self.position_mm[vertex], |edge| self.cuts_mm[edge])
    }
}

/// Whether the points of a star that count form one connected group.
pub(super) fn hang_together(star: &[[usize; 4]], counts: &dyn Fn(usize) -> bool) -> bool {
    let mut groups: Vec<Vec<usize>> = vec![];
    for corners in star {
        let mut merged: Vec<usize> = corners.iter().copied().filter(|&p| counts(p)).collect();
        if merged.is_empty() {
            continue;
        }
        groups.retain(|group| {
            let is_apart = group.iter().all(|p| !merged.contains(p));
            if !is_apart {
                merged.extend(group.iter().filter(|&p| !corners.contains(p)));
            }
            is_apart
        });
        groups.push(merged);
    }
    groups.len() == 1
}

/// The zero of `level` on a segment between two points of different sign, by the Illinois variant of the false position.
fn root_between(level: &LevelSet, ends: ((Vector3<f64>, f64), (Vector3<f64>, f64))) -> Vector3<f64> {
    let ((start, mut at_low), (end, mut at_high)) = ends;
    let (mut low, mut high) = (0.0, 1.0);
    let mut last_side = 0;
    let mut root = 0.5;
    for _ in 0..40 {
        root = (low * at_high - high * at_low) / (at_high - at_low);
        let value = level(&start.lerp(&end, root));
        if value == 0.0 || high - low < 1e-9 {
            break;
        }
        let side = if (value < 0.0) == (at_low < 0.0) { -1 } else { 1 };
        let moved = if side < 0 { root - low } else { high - root };
        if side < 0 {
            (low, at_low) = (root, value);
            if last_side == side {
                at_high *= 0.5;
            }
        } else {
            (high, at_high) = (root, value);
            if last_side == side {
                at_low *= 0.5;
            }
        }
        if moved < 1e-9 {
            break;
        }
        last_side = side;
    }
    start.lerp(&end, root)
}
