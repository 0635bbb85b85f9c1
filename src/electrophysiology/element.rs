//! The local problem: the earliest arrival at one corner of a tetrahedron from its opposite face, \[Konukoglu2007\].
//!
//! With $T$ linear on the face and the front running straight inside the element,
//! $$T_w = \min_{\lambda \ge 0,\ \sum\lambda = 1}\ \sum_i \lambda_i T_i + \sqrt{e^T D^{-1} e}/v, \qquad e = x_w - \sum_i \lambda_i x_i.$$
//! The problem is convex. An inner minimiser solves $v^2\,p\cdot Dp = 1$ for $p = \sum_k T_k \nabla\varphi_k$, a quadratic in $T_w$, and is
//! the minimum exactly if its characteristic $Dp$ comes from inside the face (all weights $\lambda \ge 0$: causality). Otherwise the
//! minimum lies on an edge of the face or on a corner.

use nalgebra::Vector3;

use super::Conduction;

/// Place of the pair (i, j) of corners among the six edges.
const EDGE: [[usize; 4]; 4] = [[usize::MAX, 0, 1, 2], [0, usize::MAX, 3, 4], [1, 3, usize::MAX, 5], [2, 4, 5, usize::MAX]];

/// What the local problem needs of a tetrahedron, in units of time only.
#[derive(Debug, Clone, Copy)]
pub(super) struct Element {
    /// $v^2\,\nabla\varphi_i\cdot D\nabla\varphi_j$ an edge, 1/s²; the diagonal is minus the sum of its row.
    coupling_per_s2: [f64; 6],
    /// Squared travel time along an edge, s².
    edge_s2: [f64; 6],
}

/// An arrival at a corner: time after the reference and the weights of the face it came through, one a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arrival {
    pub(super) time_s: f64,
    pub(super) weights: [f64; 4],
}

impl Element {
    pub(super) fn new(corners_mm: [Vector3<f64>; 4], conduction: &Conduction, tetrahedron: usize) -> Self {
        let gradients = shape_gradients(&corners_mm);
        let mut element = Self { coupling_per_s2: [0.0; 6], edge_s2: [0.0; 6] };
        for i in 0..3 {
            for j in i + 1..4 {
                let edge = EDGE[i][j];
                element.coupling_per_s2[edge] = conduction.flux(tetrahedron, &gradients[i], &gradients[j]);
                element.edge_s2[edge] = conduction.squared_travel_time_s2(tetrahedron, &(corners_mm[j] - corners_mm[i]));
            }
        }
        element
    }

    /// The earliest arrival at corner `target` through points that use corner `from`, if it beats `bound_s`. Infinite times are
    /// corners not reached yet.
    pub(super) fn arrive(&self, times_s: &[f64; 4], target: usize, from: usize, bound_s: f64) -> Option<Arrival> {
        let [a, b] = remaining(target, from);
        // Relative to the corner the front comes from, so that large clock times cost no digits.
        let (early_s, bound_s) = (times_s[from], bound_s - times_s[from]);
        let (time_a, time_b) = (times_s[a] - early_s, times_s[b] - early_s);
        let arrival = if time_a.is_finite() && time_b.is_finite() {
            match self.through_face(target, from, a, time_a, b, time_b) {
                Some(arrival) => Some(arrival),
                None => {
                    let [first, second] = [(a, time_a), (b, time_b)].map(|(c, time)| self.through_edge(target, from, c, time));
                    Some(if second.time_s < first.time_s { second } else { first })
                }
            }
        } else if time_a.is_finite() {
            Some(self.through_edge(target, from, a, time_a))
        } else if time_b.is_finite() {
            Some(self.through_edge(target, from, b, time_b))
        } else {
            Some(self.through_corner(target, from))
        };
        arrival.filter(|arrival| arrival.time_s < bound_s).map(|arrival| Arrival { time_s: early_s + arrival.time_s, ..arrival })
    }

    /// Causal arrival through the inside of the face (from, a, b); times relative to `from`.
    fn through_face(&self, target: usize, from: usize, a: usize, time_a: f64, b: usize, time_b: f64) -> Option<Arrival> {
        let k = |i: usize, j: usize| self.coupling_per_s2[EDGE[i][j]];
        let (k_wf, k_wa, k_wb) = (k(target, from), k(target, a), k(target, b));
        let (k_fa, k_fb, k_ab) = (k(from, a), k(from, b), k(a, b));
        let k_ww = -(k_wf + k_wa + k_wb);
        let k_aa = -(k_wa + k_fa + k_ab);
        let k_bb = -(k_wb + k_fb + k_ab);
        // k_ww T² + 2 linear T + constant = 0
        let linear = k_wa * time_a + k_wb * time_b;
        let constant = k_aa * time_a * time_a + k_bb * time_b * time_b + 2.0 * k_ab * time_a * time_b - 1.0;
        let discriminant = linear * linear - k_ww * constant;
        if discriminant.is_nan() || discriminant <= 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        let time_s = (root - linear) / k_ww;
        let flux_from = k_wf * time_s + k_fa * time_a + k_fb * time_b;
        let flux_a = k_wa * time_s + k_aa * time_a + k_ab * time_b;
        let flux_b = k_wb * time_s + k_ab * time_a + k_bb * time_b;
        if flux_from > 0.0 || flux_a > 0.0 || flux_b > 0.0 {
            return None;
        }
        let mut weights = [0.0; 4];
        weights[from] = -flux_from / root;
        weights[a] = -flux_a / root;
        weights[b] = -flux_b / root;
        Some(Arrival { time_s, weights })
    }

    /// Arrival through the edge (from, a), or through the corner `from` if that is earlier. (Through the corner `a` alone is the
    /// business of the front that leaves `a`.)
    fn through_edge(&self, target: usize, from: usize, a: usize, time_a: f64) -> Arrival {
        // T(s) = s T_a + sqrt(α s² + 2 β s + γ) for the point from + s (a − from).
        let alpha = self.edge_s2[EDGE[from][a]];
        let gamma = self.edge_s2[EDGE[from][target]];
        let beta = 0.5 * (self.edge_s2[EDGE[a][target]] - gamma - alpha);
        let across = alpha - time_a * time_a;
        if across > 0.0 {
            let area = (alpha * gamma - beta * beta).max(0.0);
            let share = (-beta - time_a * (area / across).sqrt()) / alpha;
            if share > 0.0 && share < 1.0 {
                let mut weights = [0.0; 4];
                weights[from] = 1.0 - share;
                weights[a] = share;
                return Arrival { time_s: (-beta * time_a + (area * across).sqrt()) / alpha, weights };
            }
        }
        self.through_corner(target, from)
    }

    fn through_corner(&self, target: usize, from: usize) -> Arrival {
        let mut weights = [0.0; 4];
        weights[from] = 1.0;
        Arrival { time_s: self.edge_s2[EDGE[from][target]].sqrt(), weights }
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
        let corners = [[0.1, 0.0, 0.0], [2.0, 0.2, 0.1], [0.3, 1.7, -0.2], [0.6, 0.7, 1.4]].map(Vector3::from);
        for sample in 0..200 {
            let angle = f64::from(sample);
            let fibre = Vector3::new(angle.sin(), (1.7 * angle).cos(), (0.6 * angle).sin());
            let conduction = Conduction::new(vec![500.0], [1.0, 0.25, 0.11][sample as usize % 3], vec![fibre]).unwrap();
            let element = Element::new(corners, &conduction, 0);
            let times = [0.0, 2e-3 * (2.3 * angle).sin(), 3e-3 * (3.1 * angle).cos(), f64::INFINITY];
            let arrivals = (0..3).filter_map(|from| element.arrive(&times, 3, from, f64::INFINITY));
            let earliest = arrivals.map(|arrival| arrival.time_s).fold(f64::INFINITY, f64::min);
            let searched = earliest_by_search(&corners, &times, &conduction);
            assert!((0.0..2e-7).contains(&(searched - earliest + 1e-14)), "sample {sample}: {earliest} s, by search {searched} s");
        }
    }

    #[test]
    fn the_weights_reproduce_the_arrival() {
        let corners = [[0.1, 0.0, 0.0], [2.0, 0.2, 0.1], [0.3, 1.7, -0.2], [0.6, 0.7, 1.4]].map(Vector3::from);
        let conduction = Conduction::new(vec![500.0], 0.2, vec![Vector3::new(1.0, 2.0, 0.5)]).unwrap();
        let element = Element::new(corners, &conduction, 0);
        for times in [[0.0, 1e-4, 2e-4, 0.0], [0.0, 2e-3, 1e-4, 0.0], [0.0, 3e-3, 4e-3, 0.0]] {
            let arrival = element.arrive(&times, 3, 0, f64::INFINITY).unwrap();
            let through: Vector3<f64> = (0..3).map(|i| corners[i] * arrival.weights[i]).sum();
            let start: f64 = (0..3).map(|i| times[i] * arrival.weights[i]).sum();
            let expected = start + conduction.travel_time_s(0, &(corners[3] - through));
            assert!((arrival.time_s - expected).abs() < 1e-15, "{} s, by its weights {expected} s", arrival.time_s);
            assert!((arrival.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}
