//! Closes the clefts of a cavity that are narrower than the lattice, so that no strand of wall crosses the blood.
//!
//! The blood of a room is grown from its deepest point in the base plane, deepest points first, and a lattice point is added only if the
//! topology stays that of a cup: around it the points already grown hang together, and so do the others (a simple point). What
//! remains are the tips of clefts, where the lattice would see strands; they are moved into the wall.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::LevelSet;
use super::stuffing::{Side, Stuffing, hang_together};

impl Stuffing<'_> {
    /// Moves into the wall the outer points of every cavity that its growth does not reach.
    pub(super) fn close_clefts(&mut self, level: &LevelSet) {
        let last_room = self.room.iter().copied().max().unwrap_or(0);
        for room in 1..=last_room {
            let unreached = self.unreached(room);
            self.move_into_wall(&unreached, level);
        }
    }

    /// The outer points of a room that cannot be added to its cup.
    fn unreached(&self, room: u8) -> Vec<usize> {
        let is_member = |point: usize| self.side[point] == Side::Outside && self.room[point] == room;
        let members: Vec<usize> = (0..self.side.len()).filter(|&point| is_member(point)).collect();
        let in_plane = members.iter().copied().filter(|&point| self.lattice.is_in_plane(point));
        let Some(seed) = in_plane.max_by(|&a, &b| self.level[a].total_cmp(&self.level[b])) else {
            return vec![];
        };
        let stars = self.stars(members.iter());
        let mut is_grown = vec![false; self.side.len()];
        // Levels are positive here, and so their bits are in their order.
        let rank = |point: usize| (self.level[point].to_bits(), Reverse(point));
        let mut queue = BinaryHeap::from([rank(seed)]);
        while let Some((_, Reverse(point))) = queue.pop() {
            if is_grown[point] || (point != seed && !self.is_simple(point, &stars[&point], &is_grown)) {
                continue;
            }
            is_grown[point] = true;
            let mut around: Vec<usize> = stars[&point].iter().flatten().copied().collect();
            around.sort_unstable();
            around.dedup();
            queue.extend(around.into_iter().filter(|&other| is_member(other) && !is_grown[other]).map(rank));
        }
        members.into_iter().filter(|&point| !is_grown[point]).collect()
    }

    /// Whether a point can be added to the grown ones without a change of topology, in space and in the base plane.
    fn is_simple(&self, point: usize, star: &[[usize; 4]], is_grown: &[bool]) -> bool {
        let in_plane: &[bool] = if self.lattice.is_in_plane(point) { &[false, true] } else { &[false] };
        in_plane.iter().all(|&only_in_plane| {
            let counts = |p: usize| p != point && (!only_in_plane || self.lattice.is_in_plane(p));
            [true, false].into_iter().all(|grown| hang_together(star, &|p| counts(p) && is_grown[p] == grown))
        })
    }
}
