//! Isosurface stuffing: tetrahedra of bounded dihedral angle inside an implicit function, [Labelle2007].
//!
//! Lattice points are inside, outside or on the surface; an edge from inside to outside has a cut point. A lattice point with a cut
//! point closer than α edge lengths is moved onto it ("warped"), so that no short edges are left; the tetrahedra that still cross the
//! surface are then replaced by a stencil of their inner part.

use std::collections::HashMap;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::lattice::Lattice;
use super::{AnatomyError, LevelSet};

/// Warping thresholds α as a fraction of the edge, for edges of h and √3/2 h: the pair of [Labelle2007] table 1 that guarantees the
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

/// Stuffs the inside of `level` (negative inside) with the tetrahedra of `lattice`.
pub(super) fn stuff(lattice: &Lattice, level: &LevelSet) -> Result<StuffedMesh, AnatomyError> {
    let mut stuffing = Stuffing::sample(lattice, level)?;
    stuffing.cut_edges(level);
    stuffing.warp(level);
    let mesh = stuffing.fill();
    if mesh.tetrahedra.is_empty() {
        return Err(AnatomyError::NothingInside { edge_length_mm: lattice.spacing_mm() });
    }
    Ok(mesh)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Inside,
    Surface,
    Outside,
}

struct Stuffing<'a> {
    lattice: &'a Lattice,
    position_mm: Vec<Vector3<f64>>,
    level: Vec<f64>,
    side: Vec<Side>,
    /// Lattice edges from inside to outside, lower point first, and their cut points.
    edges: Vec<[usize; 2]>,
    cuts_mm: Vec<Vector3<f64>>,
}

impl<'a> Stuffing<'a> {
    fn sample(lattice: &'a Lattice, level: &LevelSet) -> Result<Self, AnatomyError> {
        let count = lattice.point_count();
        let position_mm: Vec<Vector3<f64>> = (0..count).map(|point| lattice.position_mm(point)).collect();
        let level: Vec<f64> = position_mm.par_iter().map(level).collect();
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
        Ok(Self { lattice, position_mm, level, side, edges: vec![], cuts_mm: vec![] })
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
        let touching = self.edges_and_links();
        let mut points: Vec<usize> = touching.keys().copied().collect();
        points.sort_unstable();
        for point in points {
            let (edges, link) = &touching[&point];
            let live = || edges.iter().copied().filter(|&edge| self.is_live(edge));
            if !live().any(|edge| self.is_too_near(point, edge)) || !self.surface_may_pass(point, link) {
                continue;
            }
            let target = if self.lattice.is_in_plane(point) {
                let inner = live().filter(|&edge| self.edges[edge].iter().all(|&end| self.lattice.is_in_plane(end)));
                self.nearest_cut(point, inner).or_else(|| self.slide_in_plane(point, level))
            } else {
                self.nearest_cut(point, live())
            };
            if let Some(target) = target {
                self.position_mm[point] = target;
                self.side[point] = Side::Surface;
            }
        }
    }

    /// For every end of a cut edge its cut edges, and its link: the triangles opposite to it in the tetrahedra that hold it.
    fn edges_and_links(&self) -> HashMap<usize, (Vec<usize>, Vec<[usize; 3]>)> {
        let mut touching: HashMap<usize, (Vec<usize>, Vec<[usize; 3]>)> = HashMap::new();
        for (edge, ends) in self.edges.iter().enumerate() {
            for &point in ends {
                touching.entry(point).or_default().0.push(edge);
            }
        }
        self.lattice.for_each_tetrahedron(|[a, b, c, d]| {
            for (point, triangle) in [(a, [b, c, d]), (b, [a, c, d]), (c, [a, b, d]), (d, [a, b, c])] {
                if let Some((_, link)) = touching.get_mut(&point) {
                    link.push(triangle);
                }
            }
        });
        touching
    }

    /// Whether the surface may be led through a lattice point without a change of topology: the inner points around it hang together,
    /// and so do the outer ones; in the base plane also those of the plane alone.
    fn surface_may_pass(&self, point: usize, link: &[[usize; 3]]) -> bool {
        let hangs_together = |side: Side, only_in_plane: bool| {
            let counts = |p: usize| self.side[p] == side && (!only_in_plane || self.lattice.is_in_plane(p));
            let mut groups: Vec<Vec<usize>> = vec![];
            for triangle in link {
                let mut merged: Vec<usize> = triangle.iter().copied().filter(|&p| counts(p)).collect();
                if merged.is_empty() {
                    continue;
                }
                groups.retain(|group| {
                    let is_apart = group.iter().all(|p| !merged.contains(p));
                    if !is_apart {
                        merged.extend(group.iter().filter(|&p| !triangle.contains(p)));
                    }
                    is_apart
                });
                groups.push(merged);
            }
            groups.len() == 1
        };
        let in_plane: &[bool] = if self.lattice.is_in_plane(point) { &[false, true] } else { &[false] };
        in_plane.iter().all(|&only| hangs_together(Side::Inside, only) && hangs_together(Side::Outside, only))
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

    fn nearest_cut(&self, point: usize, edges: impl Iterator<Item = usize>) -> Option<Vector3<f64>> {
        let too_near = edges.filter(|&edge| self.is_too_near(point, edge));
        let distance = |edge: &usize| (self.cuts_mm[*edge] - self.position_mm[point]).norm_squared();
        too_near.min_by(|a, b| distance(a).total_cmp(&distance(b))).map(|edge| self.cuts_mm[edge])
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

    fn vertex_mm(&self, vertex: usize) -> Vector3<f64> {
        vertex.checked_sub(self.position_mm.len()).map_or_else(|| self.position_mm[vertex], |edge| self.cuts_mm[edge])
    }
}

/// The stencils of [Labelle2007] figure 3. A quadrilateral that two tetrahedra share is divided by its own points alone: by the diagonal
/// through the cut point of the longer lattice edge, of equal edges the shorter diagonal.
struct Stencils<'a> {
    stuffing: &'a Stuffing<'a>,
    cut_of: &'a HashMap<[usize; 2], usize>,
    tetrahedra: Vec<[usize; 4]>,
}

impl Stencils<'_> {
    fn add(&mut self, corners: [usize; 4]) {
        let side = &self.stuffing.side;
        let on = |wanted: Side| -> Vec<usize> { corners.into_iter().filter(|&point| side[point] == wanted).collect() };
        let (inside, surface, outside) = (on(Side::Inside), on(Side::Surface), on(Side::Outside));
        match (&inside[..], &surface[..], &outside[..]) {
            ([], _, _) => {}
            (_, _, []) => self.push(corners),
            (&[p], _, _) => self.push(corners.map(|c| if self.stuffing.side[c] == Side::Outside { self.cut(p, c) } else { c })),
            (&[p, q], &[apex], &[n]) => {
                let (p_cut, q_cut) = (self.cut(p, n), self.cut(q, n));
                if self.divides_at_first(p, q, n) {
                    self.push([p, q, q_cut, apex]);
                    self.push([p, q_cut, p_cut, apex]);
                } else {
                    self.push([p, q, p_cut, apex]);
                    self.push([q, q_cut, p_cut, apex]);
                }
            }
            (&[p, q], [], &[m, n]) => {
                let first = [p, self.cut(p, m), self.cut(p, n)];
                let second = [q, self.cut(q, m), self.cut(q, n)];
                let (front, back) = (self.divides_at_first(p, q, m), !self.divides_at_first(p, q, n));
                let is_shorter = self.distance(first[1], second[2]) <= self.distance(first[2], second[1]);
                let middle = if front == back { !front } else { is_shorter };
                self.push_wedge(first, second, [front, middle, back]);
            }
            (&[p, q, r], _, &[n]) => {
                let cuts = [self.cut(p, n), self.cut(q, n), self.cut(r, n)];
                let division = [self.divides_at_first(p, q, n), self.divides_at_first(q, r, n), self.divides_at_first(r, p, n)];
                self.push_wedge([p, q, r], cuts, division);
            }
            _ => {}
        }
    }

    fn cut(&self, a: usize, b: usize) -> usize {
        self.stuffing.position_mm.len() + self.cut_of[&[a.min(b), a.max(b)]]
    }

    fn distance(&self, a: usize, b: usize) -> f64 {
        (self.stuffing.vertex_mm(a) - self.stuffing.vertex_mm(b)).norm_squared()
    }

    /// Whether the quadrilateral p, q, cut of q–n, cut of p–n is divided by the diagonal that begins in p.
    fn divides_at_first(&self, p: usize, q: usize, n: usize) -> bool {
        // Lattice edges are compared where they were before warping.
        let lattice_length = |a: usize| (self.stuffing.lattice.position_mm(a) - self.stuffing.lattice.position_mm(n)).norm();
        let (from_p, from_q) = (lattice_length(p), lattice_length(q));
        if (from_p - from_q).abs() > 0.01 * from_p {
            return from_q > from_p;
        }
        let (at_p, at_q) = (self.distance(p, self.cut(q, n)), self.distance(q, self.cut(p, n)));
        if at_p == at_q { p < q } else { at_p < at_q }
    }

    /// A wedge between triangles a and b; `division[i]` says that side i (between i and i + 1) is divided by a_i b_{i+1}, otherwise by
    /// a_{i+1} b_i. The three must not all be equal: such a wedge has no tetrahedra.
    fn push_wedge(&mut self, a: [usize; 3], b: [usize; 3], division: [bool; 3]) {
        let Some(i) = (0..3).find(|&i| division[i] && !division[(i + 2) % 3]) else {
            return;
        };
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        self.push([a[i], b[0], b[1], b[2]]);
        if division[j] {
            self.push([a[i], a[j], a[k], b[k]]);
            self.push([a[i], a[j], b[k], b[j]]);
        } else {
            self.push([a[i], a[j], a[k], b[j]]);
            self.push([a[i], a[k], b[k], b[j]]);
        }
    }

    /// Keeps a tetrahedron, positively oriented.
    fn push(&mut self, mut corners: [usize; 4]) {
        let [a, b, c, d] = corners.map(|vertex| self.stuffing.vertex_mm(vertex));
        if (b - a).cross(&(c - a)).dot(&(d - a)) < 0.0 {
            corners.swap(2, 3);
        }
        self.tetrahedra.push(corners);
    }
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
