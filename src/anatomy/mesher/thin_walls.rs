//! Keeps walls closed that are thinner than the lattice is wide.
//!
//! A lattice edge from the blood to the outside with no point in the wall would leave a hole. Wherever there is one, the end that is
//! nearer to the middle of the wall is moved there. No tetrahedron then sees both sides, so each surface is a manifold.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::LevelSet;
use super::stuffing::{Side, Stuffing};

/// How far a point may be moved, in lattice spacings.
const REACH: f64 = 0.6;

/// Steps in which the way to the wall is searched.
const STEPS: u32 = 48;

/// What is tried, in turn: the place between the surfaces of the wall (0 the nearer, 1 the farther), and the least volume of the
/// tetrahedra around as a fraction of the lattice's.
const ROUNDS: [(f64, f64); 5] = [(0.5, 0.1), (0.25, 0.1), (0.75, 0.1), (0.5, 0.02), (0.2, 0.02)];

impl Stuffing<'_> {
    /// Moves points into walls that the lattice would miss, the nearest first.
    pub(super) fn hold_thin_walls(&mut self, level: &LevelSet) {
        let through = self.edges_through_the_wall();
        let mut partners: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for &[a, b] in &through {
            partners.entry(a).or_default().push(b);
            partners.entry(b).or_default().push(a);
        }
        let stars = self.stars(partners.keys());
        for (share, flatness) in ROUNDS {
            let mut moves: Vec<(f64, usize, Vector3<f64>)> = vec![];
            for (&point, others) in partners.iter().filter(|&(&point, others)| self.is_open(point, others)) {
                let toward = |other: &usize| self.position_mm[*other] - self.position_mm[point];
                let ways = std::iter::once(self.way_to_wall(point, level)).chain(others.iter().map(toward));
                let places = ways.filter_map(|way| self.place_in_wall(point, &way, share, level));
                moves.extend(places.map(|place| ((place - self.position_mm[point]).norm(), point, place)));
            }
            moves.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (_, point, place) in moves {
                if self.is_open(point, &partners[&point]) && self.stays_upright(point, &place, &stars[&point], flatness) {
                    self.position_mm[point] = place;
                    self.level[point] = level(&place);
                    self.side[point] = Side::Inside;
                }
            }
        }
    }

    /// Moves into the wall the outer points that the lattice cuts off from the rest of their room, in space or in the base plane: the tip of
    /// a cleft between two walls, which would become a bubble or a second hole in the base.
    pub(super) fn fill_pockets(&mut self, level: &LevelSet) {
        for only_in_plane in [false, true] {
            let pockets = self.pockets(only_in_plane);
            self.move_into_wall(&pockets, level);
        }
    }

    /// Moves points to the nearest place in the wall that is within reach.
    pub(super) fn move_into_wall(&mut self, points: &[usize], level: &LevelSet) {
        let stars = self.stars(points.iter());
        for &point in points {
            let ways = self.ways_to_wall(point, level);
            for (share, flatness) in ROUNDS {
                let places = ways.iter().filter_map(|way| self.place_in_wall(point, way, share, level));
                let upright = places.filter(|place| self.stays_upright(point, place, &stars[&point], flatness));
                let distance = |place: &Vector3<f64>| (place - self.position_mm[point]).norm();
                if let Some(place) = upright.min_by(|a, b| distance(a).total_cmp(&distance(b))) {
                    self.position_mm[point] = place;
                    self.level[point] = level(&place);
                    self.side[point] = Side::Inside;
                    break;
                }
            }
        }
    }

    /// Outer points that are not in the largest connected part of their room, counting all points or those of the base plane.
    fn pockets(&self, only_in_plane: bool) -> Vec<usize> {
        let counts = |p: usize| self.side[p] == Side::Outside && (!only_in_plane || self.lattice.is_in_plane(p));
        let mut parent: Vec<usize> = (0..self.side.len()).collect();
        self.lattice.for_each_tetrahedron(|corners| {
            for i in 0..3 {
                for j in i + 1..4 {
                    let (a, b) = (corners[i], corners[j]);
                    if counts(a) && counts(b) && self.room[a] == self.room[b] {
                        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
                        parent[a.max(b)] = a.min(b);
                    }
                }
            }
        });
        let members: Vec<usize> = (0..self.side.len()).filter(|&p| counts(p)).collect();
        let mut sizes: BTreeMap<(u8, usize), usize> = BTreeMap::new();
        for &p in &members {
            *sizes.entry((self.room[p], root(&mut parent, p))).or_insert(0) += 1;
        }
        let mut largest: BTreeMap<u8, (usize, usize)> = BTreeMap::new();
        for (&(room, part), &size) in &sizes {
            let best = largest.entry(room).or_insert((size, part));
            if size > best.0 {
                *best = (size, part);
            }
        }
        members.into_iter().filter(|&p| largest.get(&self.room[p]).is_some_and(|&(_, part)| root(&mut parent, p) != part)).collect()
    }

    fn edges_through_the_wall(&self) -> Vec<[usize; 2]> {
        let mut through = vec![];
        self.lattice.for_each_tetrahedron(|corners| {
            for i in 0..3 {
                for j in i + 1..4 {
                    let (a, b) = (corners[i], corners[j]);
                    let are_outside = self.side[a] == Side::Outside && self.side[b] == Side::Outside;
                    if are_outside && self.room[a] != self.room[b] {
                        through.push([a.min(b), a.max(b)]);
                    }
                }
            }
        });
        through.sort_unstable();
        through.dedup();
        through
    }

    /// Whether a point is still outside and joined through the wall to another that is.
    fn is_open(&self, point: usize, others: &[usize]) -> bool {
        self.side[point] == Side::Outside && others.iter().any(|&other| self.side[other] == Side::Outside)
    }

    /// Down the slope of the level set, and along the axes.
    fn ways_to_wall(&self, point: usize, level: &LevelSet) -> Vec<Vector3<f64>> {
        let axes = (0..3).flat_map(|axis| [Vector3::ith(axis, 1.0), Vector3::ith(axis, -1.0)]);
        std::iter::once(self.way_to_wall(point, level)).chain(axes).collect()
    }

    /// Down the slope of the level set.
    fn way_to_wall(&self, point: usize, level: &LevelSet) -> Vector3<f64> {
        -super::gradient(level, &self.position_mm[point], 0.01 * self.lattice.spacing_mm())
    }

    /// The place at `share` of the first stretch of wall on the way from a point, if it is within reach.
    fn place_in_wall(&self, point: usize, way: &Vector3<f64>, share: f64, level: &LevelSet) -> Option<Vector3<f64>> {
        let normal = self.lattice.plane_normal();
        let way = if self.lattice.is_in_plane(point) { way - normal * normal.dot(way) } else { *way };
        let step = way.try_normalize(1e-9)? * (2.0 * REACH * self.lattice.spacing_mm() / f64::from(STEPS));
        let at = |n: u32| self.position_mm[point] + step * f64::from(n);
        let first = (1..=STEPS).find(|&n| level(&at(n)) < 0.0)?;
        let last = (first..=STEPS).take_while(|&n| level(&at(n)) < 0.0).last()?;
        let place = self.position_mm[point] + step * (f64::from(first) + share * f64::from(last - first));
        let is_within_reach = (place - self.position_mm[point]).norm() < REACH * self.lattice.spacing_mm();
        (is_within_reach && level(&place) < 0.0).then_some(place)
    }
}

fn root(parent: &mut [usize], mut point: usize) -> usize {
    while parent[point] != point {
        parent[point] = parent[parent[point]];
        point = parent[point];
    }
    point
}
