//! The local problem: the earliest arrival at one corner of a tetrahedron from its opposite face, \[Konukoglu2007\].
//!
//! With $T$ linear on the face and the front running straight inside the element,
//! $$T_w = \min_{\lambda \ge 0,\ \sum\lambda = 1}\ \sum_i \lambda_i T_i + \sqrt{e^T D^{-1} e}/v, \qquad e = x_w - \sum_i \lambda_i x_i.$$
//! The problem is convex. An inner minimiser solves $v^2\,p\cdot Dp = 1$ for $p = \sum_k T_k \nabla\varphi_k$, a quadratic in $T_w$, and is
//! the minimum exactly if its characteristic $Dp$ comes from inside the face (all weights $\lambda \ge 0$: causality). Otherwise the
//! minimum lies on one of those edges of the face across which the characteristic misses it. Signs of the quadratic tell beforehand,
//! without a root, whether the present time of the target can be beaten at all.

use nalgebra::Vector3;

use super::Conduction;
use crate::mesh::TetMesh;

/// Place of the pair (i, j) of corners among the six edges.
const EDGE: [[usize; 4]; 4] = [[usize::MAX, 0, 1, 2], [0, usize::MAX, 3, 4], [1, 3, usize::MAX, 5], [2, 4, 5, usize::MAX]];

/// What nearly every local problem of a tetrahedron needs, in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Element {
    /// $v^2\,\nabla\varphi_i\cdot D\nabla\varphi_j$ an edge, 1/s²; the diagonal is minus the sum of its row.
    coupling_per_s2: [f64; 6],
    /// The vertices at its corners.
    pub(super) vertices: [u32; 4],
}

/// Squared travel times along the edges of a tetrahedron, s²: what fronts along its edges need besides.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edges([f64; 6]);

/// An arrival at a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arrival {
    /// When, s.
    pub(super) time_s: f64,
    /// The weights λ of the corners it came through.
    pub(super) weights: [f64; 4],
}

/// What the inside of a face gives.
enum Inside {
    /// A causal arrival.
    Arrival(Arrival),
    /// Nothing through this face or its edges can beat the bound.
    TooLate,
    /// The characteristic misses the face across the sides opposite to a and to b.
    Misses { opposite_a: bool, opposite_b: bool },
}

/// A corner that the front may come through besides the one it is sought from.
#[derive(Clone, Copy)]
struct Side {
    corner: usize,
    /// Time after the corner sought from, s.
    delay_s: f64,
}

impl Element {
    pub(super) fn new(mesh: &TetMesh, conduction: &Conduction, tetrahedron: usize) -> Self {
        let gradients = shape_gradients(&mesh.corners_mm(tetrahedron));
        let vertices = mesh.tetrahedra()[tetrahedron].map(|vertex| vertex as u32);
        let mut coupling_per_s2 = [0.0; 6];
        for i in 0..3 {
            for j in i + 1..4 {
                coupling_per_s2[EDGE[i][j]] = conduction.flux(tetrahedron, &gradients[i], &gradients[j]);
            }
        }
        Self { coupling_per_s2, vertices }
    }

    /// The earliest arrival at corner `target` through points that use corner `from`, if it beats `bound_s`. Infinite times are
    /// corners not reached yet.
    pub(super) fn arrive(&self, edges: &Edges, times_s: &[f64; 4], target: usize, from: usize, bound_s: f64) -> Option<Arrival> {
        if self.is_within_height(times_s, target, bound_s) {
            return None;
        }
        // Relative to the corner the front comes from, so that large clock times cost no digits.
        let bound_s = bound_s - times_s[from];
        let [a, b] = remaining(target, from).map(|corner| Side { corner, delay_s: times_s[corner] - times_s[from] });
        let arrival = match (a.delay_s.is_finite(), b.delay_s.is_finite()) {
            (true, true) => match self.through_face(target, from, a, b, bound_s) {
                Inside::Arrival(arrival) => Some(arrival),
                Inside::TooLate => None,
                Inside::Misses { opposite_a, opposite_b } => {
                    let along_a = opposite_b.then(|| edges.through_edge(target, from, a, bound_s)).flatten();
                    let along_b = opposite_a.then(|| edges.through_edge(target, from, b, bound_s)).flatten();
                    match (along_a, along_b) {
                        (Some(first), Some(second)) => Some(if second.time_s < first.time_s { second } else { first }),
                        (first, second) => first.or(second),
                    }
                }
            },
            (true, false) => edges.through_edge(target, from, a, bound_s),
            (false, true) => edges.through_edge(target, from, b, bound_s),
            (false, false) => Some(edges.through_corner(target, from)),
        };
        arrival
            .filter(|arrival| arrival.time_s < bound_s)
            .map(|arrival| Arrival { time_s: times_s[from] + arrival.time_s, weights: arrival.weights })
    }

    /// Whether the bound leaves less time after the earliest corner of the face than the way from its plane takes, $1/\sqrt{k_{ww}}$.
    fn is_within_height(&self, times_s: &[f64; 4], target: usize, bound_s: f64) -> bool {
        let others = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]][target];
        let [i, j, k] = others;
        let left_s = bound_s - times_s[i].min(times_s[j]).min(times_s[k]);
        let k_ww = -(self.coupling(target, i) + self.coupling(target, j) + self.coupling(target, k));
        left_s <= 0.0 || left_s * left_s * k_ww <= 1.0
    }

    fn coupling(&self, i: usize, j: usize) -> f64 {
        self.coupling_per_s2[EDGE[i][j]]
    }

    /// Through the inside of the face (from, a, b).
    fn through_face(&self, target: usize, from: usize, a: Side, b: Side, bound_s: f64) -> Inside {
        let (k_wf, k_wa, k_wb) = (self.coupling(target, from), self.coupling(target, a.corner), self.coupling(target, b.corner));
        let (k_fa, k_fb, k_ab) = (self.coupling(from, a.corner), self.coupling(from, b.corner), self.coupling(a.corner, b.corner));
        let (t_a, t_b) = (a.delay_s, b.delay_s);
        let (k_ww, k_aa, k_bb) = (-(k_wf + k_wa + k_wb), -(k_wa + k_fa + k_ab), -(k_wb + k_fb + k_ab));
        let (flux_f, flux_a, flux_b) = (k_fa * t_a + k_fb * t_b, k_aa * t_a + k_ab * t_b, k_ab * t_a + k_bb * t_b);
        // k_ww T² + 2 linear T + constant = 0
        let linear = k_wa * t_a + k_wb * t_b;
        let constant = t_a * flux_a + t_b * flux_b - 1.0;
        let discriminant = linear * linear - k_ww * constant;
        if discriminant.is_nan() || discriminant <= 0.0 {
            return Inside::Misses { opposite_a: true, opposite_b: true };
        }
        if k_ww * bound_s <= -linear || (k_ww * bound_s + 2.0 * linear) * bound_s + constant <= 0.0 {
            return Inside::TooLate;
        }
        let root = discriminant.sqrt();
        let time_s = (root - linear) / k_ww;
        let (m_f, m_a, m_b) = (-k_wf * time_s - flux_f, -k_wa * time_s - flux_a, -k_wb * time_s - flux_b);
        if m_f < 0.0 || m_a < 0.0 || m_b < 0.0 {
            return Inside::Misses { opposite_a: m_a < 0.0, opposite_b: m_b < 0.0 };
        }
        let mut weights = [0.0; 4];
        weights[from] = m_f / root;
        weights[a.corner] = m_a / root;
        weights[b.corner] = m_b / root;
        Inside::Arrival(Arrival { time_s, weights })
    }
}

impl Edges {
    pub(super) fn new(mesh: &TetMesh, conduction: &Conduction, tetrahedron: usize) -> Self {
        let corners_mm = mesh.corners_mm(tetrahedron);
        let metric = conduction.metric(tetrahedron);
        let squared_s2 = |[i, j]: [usize; 2]| metric.squared_s2(&(corners_mm[j] - corners_mm[i]));
        Self([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]].map(squared_s2))
    }

    /// Through the edge (from, a), or through the corner `from` if that is earlier, unless the bound cannot be beaten. (The way through the
    /// corner a alone is the business of the front that leaves a.)
    fn through_edge(&self, target: usize, from: usize, a: Side, bound_s: f64) -> Option<Arrival> {
        let (l_f, l_a, l_fa) = (self.squared(target, from), self.squared(target, a.corner), self.squared(from, a.corner));
        let between = 0.5 * (l_f + l_a - l_fa);
        let area = l_f * l_a - between * between;
        // l_fa T² − 2 half T + constant = 0, as for the face but times the squared area.
        let half = (l_f - between) * a.delay_s;
        let constant = l_f * a.delay_s * a.delay_s - area;
        let discriminant = half * half - l_fa * constant;
        if discriminant.is_nan() || discriminant <= 0.0 {
            return Some(self.through_corner(target, from));
        }
        if l_fa * bound_s <= half || (l_fa * bound_s - 2.0 * half) * bound_s + constant <= 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        let time_s = (half + root) / l_fa;
        let (m_f, m_a) = (l_a * time_s - between * (time_s - a.delay_s), l_f * (time_s - a.delay_s) - between * time_s);
        if m_f < 0.0 {
            return None;
        }
        if m_a < 0.0 {
            return Some(self.through_corner(target, from));
        }
        let mut weights = [0.0; 4];
        weights[from] = m_f / root;
        weights[a.corner] = m_a / root;
        Some(Arrival { time_s, weights })
    }

    fn through_corner(&self, target: usize, from: usize) -> Arrival {
        let mut weights = [0.0; 4];
        weights[from] = 1.0;
        Arrival { time_s: self.squared(target, from).sqrt(), weights }
    }

    fn squared(&self, i: usize, j: usize) -> f64 {
        self.0[EDGE[i][j]]
    }
}

/// The two corners that are neither `i` nor `j`.
fn remaining(i: usize, j: usize) -> [usize; 2] {
    const REMAINING: [[usize; 2]; 6] = [[2, 3], [1, 3], [1, 2], [0, 3], [0, 2], [0, 1]];
    REMAINING[EDGE[i][j]]
}

/// ∇φ of the four linear shape functions, 1/mm.
fn shape_gradients(corners_mm: &[Vector3<f64>; 4]) -> [Vector3<f64>; 4] {
    let [a, b, c, d] = corners_mm;
    let (u, v, w) = (b - a, c - a, d - a);
    let six_volumes = u.cross(&v).dot(&w);
    let (g1, g2, g3) = (v.cross(&w) / six_volumes, w.cross(&u) / six_volumes, u.cross(&v) / six_volumes);
    [-(g1 + g2 + g3), g1, g2, g3]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> (TetMesh, [Vector3<f64>; 4]) {
        let corners = [[0.1, 0.0, 0.0], [2.0, 0.2, 0.1], [0.3, 1.7, -0.2], [0.6, 0.7, 1.4]].map(Vector3::from);
        (TetMesh::new(corners.to_vec(), vec![[0, 1, 2, 3]]).unwrap(), corners)
    }

    /// The minimum over the whole face by brute force.
    fn earliest_by_search(corners: &[Vector3<f64>; 4], times: &[f64; 4], conduction: &Conduction) -> f64 {
        let count = 400;
        let mut earliest = f64::INFINITY;
        for i in 0..=count {
            for j in 0..=count - i {
                let (s, t) = (f64::from(i) / f64::from(count), f64::from(j) / f64::from(count));
                let point = corners[0] * (1.0 - s - t) + corners[1] * s + corners[2] * t;
                let time = times[0] * (1.0 - s - t) + times[1] * s + times[2] * t;
                earliest = earliest.min(time + conduction.travel_time_s(0, &(corners[3] - point)));
            }
        }
        earliest
    }

    #[test]
    fn the_local_update_is_the_minimum_over_the_face() {
        let (mesh, corners) = tetrahedron();
        for sample in 0..200 {
            let angle = f64::from(sample);
            let fibre = Vector3::new(angle.sin(), (1.7 * angle).cos(), (0.6 * angle).sin());
            let conduction = Conduction::new(vec![500.0], [1.0, 0.25, 0.11][sample as usize % 3], vec![fibre]).unwrap();
            let (element, edges) = (Element::new(&mesh, &conduction, 0), Edges::new(&mesh, &conduction, 0));
            let times = [0.0, 2e-3 * (2.3 * angle).sin(), 3e-3 * (3.1 * angle).cos(), f64::INFINITY];
            let arrivals = (0..3).filter_map(|from| element.arrive(&edges, &times, 3, from, f64::MAX));
            let earliest = arrivals.map(|arrival| arrival.time_s).fold(f64::INFINITY, f64::min);
            let searched = earliest_by_search(&corners, &times, &conduction);
            assert!((0.0..2e-7).contains(&(searched - earliest + 1e-14)), "sample {sample}: {earliest} s, by search {searched} s");
        }
    }

    #[test]
    fn the_weights_reproduce_the_arrival() {
        let (mesh, corners) = tetrahedron();
        let conduction = Conduction::new(vec![500.0], 0.2, vec![Vector3::new(1.0, 2.0, 0.5)]).unwrap();
        let (element, edges) = (Element::new(&mesh, &conduction, 0), Edges::new(&mesh, &conduction, 0));
        for times in [[0.0, 1e-4, 2e-4, 0.0], [0.0, 2e-3, 1e-4, 0.0], [0.0, 3e-3, 4e-3, 0.0]] {
            let arrival = element.arrive(&edges, &times, 3, 0, f64::MAX).unwrap();
            let through: Vector3<f64> = (0..3).map(|i| corners[i] * arrival.weights[i]).sum();
            let start: f64 = (0..3).map(|i| times[i] * arrival.weights[i]).sum();
            let expected = start + conduction.travel_time_s(0, &(corners[3] - through));
            assert!((arrival.time_s - expected).abs() < 1e-15, "{} s, by its weights {expected} s", arrival.time_s);
            assert!((arrival.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}
