//! The stencils that replace a lattice tetrahedron by its part inside the surface.

use std::collections::HashMap;

use super::stuffing::{Side, Stuffing};

/// The stencils of \[Labelle2007\] figure 3. A quadrilateral that two tetrahedra share is divided by its own points alone: by the diagonal
/// through the cut point of the longer lattice edge, of equal edges the shorter diagonal.
pub(super) struct Stencils<'a> {
    pub(super) stuffing: &'a Stuffing<'a>,
    pub(super) cut_of: &'a HashMap<[usize; 2], usize>,
    pub(super) tetrahedra: Vec<[usize; 4]>,
}

impl Stencils<'_> {
    /// Adds the inner part of a lattice tetrahedron.
    pub(super) fn add(&mut self, corners: [usize; 4]) {
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
