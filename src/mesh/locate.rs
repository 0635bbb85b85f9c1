//! In which tetrahedron a point lies, and where in it; for points outside, the nearest.

use nalgebra::Vector3;

/// Tetrahedra in a leaf of the tree.
const LEAF_SIZE: usize = 8;

/// A place in a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    /// The tetrahedron.
    pub tetrahedron: usize,
    /// Barycentric weights of its corners: not negative, of sum 1. Their mean of the corners is the point, or the point of the mesh nearest
    /// to it.
    pub weights: [f64; 4],
    /// Distance from the point to the mesh, mm; 0 inside.
    pub distance_mm: f64,
}

/// A tree of boxes over the tetrahedra at given positions.
#[derive(Debug, Clone)]
pub struct TetLocator {
    corners_mm: Vec<[Vector3<f64>; 4]>,
    order: Vec<usize>,
    nodes: Vec<Node>,
}

#[derive(Debug, Clone)]
struct Node {
    low: Vector3<f64>,
    high: Vector3<f64>,
    content: Content,
}

#[derive(Debug, Clone)]
enum Content {
    Leaf { start: usize, end: usize },
    Branch { left: usize, right: usize },
}

impl TetLocator {
    /// A tree over tetrahedra (vertex numbers) at `position_mm`.
    pub fn new(tetrahedra: &[[usize; 4]], position_mm: &[Vector3<f64>]) -> Self {
        let corners_mm: Vec<[Vector3<f64>; 4]> = tetrahedra.iter().map(|corners| corners.map(|v| position_mm[v])).collect();
        let mut locator = Self { order: (0..corners_mm.len()).collect(), corners_mm, nodes: vec![] };
        if !locator.corners_mm.is_empty() {
            locator.grow(0, locator.order.len());
        }
        locator
    }

    /// The tetrahedron that holds a point or is nearest to it; `None` only for an empty mesh or a point that is not finite. Of several
    /// equally near the one with the lowest number.
    pub fn locate(&self, point_mm: &Vector3<f64>) -> Option<Location> {
        let mut best: Option<Location> = None;
        if !self.nodes.is_empty() && point_mm.iter().all(|x| x.is_finite()) {
            self.search(self.nodes.len() - 1, point_mm, &mut best);
        }
        best
    }

    /// Adds the node over `order[start..end]` after its children; returns its number.
    fn grow(&mut self, start: usize, end: usize) -> usize {
        let members = &self.order[start..end];
        let corners = members.iter().flat_map(|&t| self.corners_mm[t]);
        let (low, high) = corners
            .fold((Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)), |(low, high), p| (low.inf(&p), high.sup(&p)));
        let content = if end - start <= LEAF_SIZE {
            Content::Leaf { start, end }
        } else {
            let axis = (high - low).imax();
            let corners_mm = &self.corners_mm;
            let key = |t: usize| corners_mm[t].iter().map(|p| p[axis]).sum::<f64>();
            self.order[start..end].sort_unstable_by(|&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
            let middle = start.midpoint(end);
            let left = self.grow(start, middle);
            let right = self.grow(middle, end);
            Content::Branch { left, right }
        };
        self.nodes.push(Node { low, high, content });
        self.nodes.len() - 1
    }

    fn search(&self, node: usize, point: &Vector3<f64>, best: &mut Option<Location>) {
        let reach = |n: usize| (point - point.sup(&self.nodes[n].low).inf(&self.nodes[n].high)).norm();
        if best.is_some_and(|best| reach(node) > best.distance_mm) {
            return;
        }
        match self.nodes[node].content {
            Content::Leaf { start, end } => {
                for &tetrahedron in &self.order[start..end] {
                    let (weights, distance_mm) = nearest_in_tetrahedron(&self.corners_mm[tetrahedron], point);
                    let is_better =
                        best.is_none_or(|b| distance_mm < b.distance_mm || (distance_mm == b.distance_mm && tetrahedron < b.tetrahedron));
                    if is_better {
                        *best = Some(Location { tetrahedron, weights, distance_mm });
                    }
                }
            }
            Content::Branch { left, right } => {
                let (near, far) = if reach(left) <= reach(right) { (left, right) } else { (right, left) };
                self.search(near, point, best);
                self.search(far, point, best);
            }
        }
    }
}

/// Weights of the point of a tetrahedron nearest to `point`, and its distance.
fn nearest_in_tetrahedron(corners: &[Vector3<f64>; 4], point: &Vector3<f64>) -> ([f64; 4], f64) {
    let weights = barycentric(corners, point);
    if weights.iter().all(|&w| w >= 0.0) {
        return (weights, 0.0);
    }
    let mut nearest = ([0.0; 4], f64::INFINITY);
    for opposite in (0..4).filter(|&i| weights[i] < 0.0 || !weights[i].is_finite()) {
        let face: Vec<usize> = (0..4).filter(|&i| i != opposite).collect();
        let shares = nearest_in_triangle([corners[face[0]], corners[face[1]], corners[face[2]]], point);
        let mut weights = [0.0; 4];
        let mut place = Vector3::zeros();
        for (&corner, share) in face.iter().zip(shares) {
            weights[corner] = share;
            place += corners[corner] * share;
        }
        let distance = (point - place).norm();
        if distance < nearest.1 {
            nearest = (weights, distance);
        }
    }
    nearest
}

fn barycentric(&[a, b, c, d]: &[Vector3<f64>; 4], p: &Vector3<f64>) -> [f64; 4] {
    let (u, v, w, q) = (b - a, c - a, d - a, p - a);
    let six_volumes = u.cross(&v).dot(&w);
    let at_b = q.cross(&v).dot(&w) / six_volumes;
    let at_c = u.cross(&q).dot(&w) / six_volumes;
    let at_d = u.cross(&v).dot(&q) / six_volumes;
    [1.0 - at_b - at_c - at_d, at_b, at_c, at_d]
}

/// Distance of a point to a triangle, mm.
pub fn distance_to_triangle_mm(corners_mm: &[Vector3<f64>; 3], point_mm: &Vector3<f64>) -> f64 {
    let place: Vector3<f64> = corners_mm.iter().zip(nearest_in_triangle(*corners_mm, point_mm)).map(|(corner, share)| corner * share).sum();
    (point_mm - place).norm()
}

/// Weights of the point of a triangle nearest to `p`, by the regions of its corners, edges and face \[Ericson2005\] §5.1.5.
fn nearest_in_triangle([a, b, c]: [Vector3<f64>; 3], p: &Vector3<f64>) -> [f64; 3] {
    let (ab, ac, ap, bp, cp) = (b - a, c - a, p - a, p - b, p - c);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let at_c = d1 * d4 - d3 * d2;
    if at_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let share = d1 / (d1 - d3);
        return [1.0 - share, share, 0.0];
    }
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let at_b = d5 * d2 - d1 * d6;
    if at_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let share = d2 / (d2 - d6);
        return [1.0 - share, 0.0, share];
    }
    let at_a = d3 * d6 - d5 * d4;
    if at_a <= 0.0 && d4 >= d3 && d5 >= d6 {
        let share = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - share, share];
    }
    let sum = at_a + at_b + at_c;
    [at_a / sum, at_b / sum, at_c / sum]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    /// A block of 4 × 4 × 4 cubes of six tetrahedra each.
    fn block() -> (Vec<Vector3<f64>>, Vec<[usize; 4]>) {
        let n = 4;
        let at = |i: usize, j: usize, k: usize| i + (n + 1) * (j + (n + 1) * k);
        let mut points = vec![];
        let mut tetrahedra = vec![];
        for k in 0..=n {
            for j in 0..=n {
                points.extend((0..=n).map(|i| Vector3::new(i as f64, j as f64, k as f64)));
            }
        }
        for k in 0..n {
            for j in 0..n {
                for i in 0..n {
                    for [first, second] in [[0, 1], [1, 0], [0, 2], [2, 0], [1, 2], [2, 1]] {
                        let mut corner = [i, j, k];
                        corner[first] += 1;
                        let one = corner;
                        corner[second] += 1;
                        tetrahedra.push([
                            at(i, j, k),
                            at(one[0], one[1], one[2]),
                            at(corner[0], corner[1], corner[2]),
                            at(i + 1, j + 1, k + 1),
                        ]);
                    }
                }
            }
        }
        (points, tetrahedra)
    }

    #[test]
    fn points_inside_are_reproduced_and_points_outside_projected() {
        let (points, tetrahedra) = block();
        let locator = TetLocator::new(&tetrahedra, &points);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for _ in 0..2000 {
            let p = Vector3::from_fn(|_, _| random.random_range(-2.0..6.0));
            let found = locator.locate(&p).unwrap();
            let place: Vector3<f64> = tetrahedra[found.tetrahedron].iter().zip(found.weights).map(|(&v, w)| points[v] * w).sum();
            // The block is a box: the nearest point is the clamped one.
            let clamped = p.map(|x| x.clamp(0.0, 4.0));
            assert!((place - clamped).norm() < 1e-12, "{p} {place}");
            assert!((found.distance_mm - (p - clamped).norm()).abs() < 1e-12);
            assert!(found.weights.iter().all(|&w| w >= 0.0) && (found.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
        assert!(locator.locate(&Vector3::repeat(f64::NAN)).is_none());
        assert!(TetLocator::new(&[], &points).locate(&Vector3::zeros()).is_none());
    }
}
