//! A multi-front, label-correcting march over the tetrahedra.
//!
//! The earliest vertex of the front is taken off and its tetrahedra are solved for their other corners; whoever is reached earlier than
//! before goes (back) on the front. With isotropy this is fast marching; with anisotropy a vertex may be taken off before all it depends
//! on is known, and putting it back is the recursive correction of \[Konukoglu2007\] (their CHANGED list) in one queue. What is reached
//! is the fixed point of a monotone map from above, so it depends neither on the numbering nor on the order of the visits.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::element::{Edges, Element};
use super::front::Front;
use super::ray::{Holders, trace};
use super::{ActivationError, ActivationMap, ActivationSettings, Conduction, Onset, Stencil};
use crate::mesh::TetMesh;

/// Relative fall of a time below which it counts as unchanged; well above rounding, far below any error of the mesh.
const UNCHANGED: f64 = 1e-13;

/// Visits of a vertex after which [`UNCHANGED`] doubles with every further one. On meshes of hearts hardly any vertex comes so far; where the
/// fibres turn by a large angle from one tetrahedron to the next, stencils depend on each other in circles that converge slowly.
const PATIENCE: u8 = 6;

/// Where a tentative time came from.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    Nowhere,
    Onset(u32),
    Ray(u32),
    Recovery,
    Tetrahedron(u32),
}

/// The march in progress.
pub(super) struct March<'a> {
    mesh: &'a TetMesh,
    elements: Vec<Element>,
    edges: Vec<Edges>,
    holders: VertexHolders,
    times_s: Vec<f64>,
    sources: Vec<Source>,
    visits: Vec<u8>,
    /// Time before which a vertex cannot be depolarised, s.
    recovered_s: Vec<f64>,
    front: Front,
}

impl<'a> March<'a> {
    pub(super) fn new(mesh: &'a TetMesh, conduction: &Conduction) -> Self {
        let count = mesh.vertex_count();
        Self {
            mesh,
            elements: (0..mesh.tetrahedron_count()).map(|t| Element::new(mesh, conduction, t)).collect(),
            edges: (0..mesh.tetrahedron_count()).map(|t| Edges::new(mesh, conduction, t)).collect(),
            holders: VertexHolders::new(mesh),
            times_s: vec![f64::INFINITY; count],
            sources: vec![Source::Nowhere; count],
            visits: vec![0; count],
            recovered_s: vec![f64::NEG_INFINITY; count],
            front: Front::new(count),
        }
    }

    /// Lets no vertex be depolarised before it has recovered.
    pub(super) fn hold_until(&mut self, recovered_s: &[f64]) {
        self.recovered_s.copy_from_slice(recovered_s);
    }

    /// Puts the `chosen` ones of the onsets on the front, and around every single one what straight rays reach.
    pub(super) fn start(&mut self, conduction: &Conduction, onsets: &[Onset], chosen: &[usize], settings: &ActivationSettings) {
        for &onset in chosen {
            self.reach(onsets[onset].vertex, onsets[onset].time_s, Source::Onset(onset as u32));
        }
        let length_mm = settings.ray_length_mm.unwrap_or_else(|| 2.0 * (diagonal_mm(self.mesh) * mean_edge_mm(self.mesh)).sqrt());
        if length_mm > 0.0 {
            self.cast_rays(conduction, onsets, chosen, length_mm);
        }
    }

    /// Marches until nothing changes any more.
    pub(super) fn run(&mut self) {
        while let Some(vertex) = self.front.pop() {
            self.leave(vertex);
        }
    }

    /// Gives a vertex a time if it has none as early; not before it has recovered.
    fn reach(&mut self, vertex: usize, arrival_s: f64, source: Source) {
        let recovered_s = self.recovered_s[vertex];
        let (time_s, source) = if arrival_s < recovered_s { (recovered_s, Source::Recovery) } else { (arrival_s, source) };
        if time_s < self.times_s[vertex] {
            self.times_s[vertex] = time_s;
            self.sources[vertex] = source;
            self.front.advance(vertex, time_s);
        }
    }

    /// Starts the vertices around every single onset by straight rays.
    fn cast_rays(&mut self, conduction: &Conduction, onsets: &[Onset], chosen: &[usize], length_mm: f64) {
        let mut is_onset = vec![false; self.mesh.vertex_count()];
        chosen.iter().for_each(|&onset| is_onset[onsets[onset].vertex] = true);
        for &onset in chosen {
            let Onset { vertex: start, time_s } = onsets[onset];
            let is_beside = |(t, _): &(u32, u8)| self.mesh.tetrahedra()[*t as usize].iter().any(|&v| v != start && is_onset[v]);
            if self.holders.of(start).iter().any(is_beside) {
                continue;
            }
            for vertex in self.vertices_around(start, length_mm) {
                if let Some(legs) = trace(self.mesh, &self.holders, conduction, start, vertex) {
                    self.reach(vertex, time_s + legs.iter().map(|leg| leg.travel_s).sum::<f64>(), Source::Ray(onset as u32));
                }
            }
        }
    }

    /// The vertices connected to one within a distance, without itself, in order of connection.
    fn vertices_around(&self, centre: usize, distance_mm: f64) -> Vec<usize> {
        let position_mm = self.mesh.vertices_mm();
        let mut found = vec![centre];
        let mut is_found = BTreeSet::from([centre]);
        let mut next = 0;
        while next < found.len() {
            for tetrahedron in self.holders.tetrahedra_of(found[next]) {
                for vertex in self.mesh.tetrahedra()[tetrahedron] {
                    if (position_mm[vertex] - position_mm[centre]).norm() <= distance_mm && is_found.insert(vertex) {
                        found.push(vertex);
                    }
                }
            }
            next += 1;
        }
        found.split_off(1)
    }

    /// Carries the front from a vertex to the other corners of its tetrahedra.
    fn leave(&mut self, vertex: usize) {
        self.visits[vertex] = self.visits[vertex].saturating_add(1);
        for holder in self.holders.range(vertex) {
            let (tetrahedron, from) = self.holders.entries[holder];
            let vertices = self.elements[tetrahedron as usize].vertices.map(|vertex| vertex as usize);
            let mut times_s = vertices.map(|vertex| self.times_s[vertex]);
            for target in (0..4).filter(|&corner| corner != from as usize) {
                let bound_s = self.time_to_beat_s(vertices[target], times_s[target]);
                let (element, edges) = (&self.elements[tetrahedron as usize], &self.edges[tetrahedron as usize]);
                if let Some(arrival) = element.arrive(edges, &times_s, target, from as usize, bound_s) {
                    self.reach(vertices[target], arrival.time_s, Source::Tetrahedron(tetrahedron));
                    times_s[target] = self.times_s[vertices[target]];
                }
            }
        }
    }

    fn time_to_beat_s(&self, vertex: usize, time_s: f64) -> f64 {
        if !time_s.is_finite() {
            return f64::MAX;
        }
        let doublings = self.visits[vertex].saturating_sub(PATIENCE).min(60);
        let unchanged = UNCHANGED * (1_u64 << doublings) as f64;
        time_s - unchanged * time_s.abs()
    }

    pub(super) fn finish(self, conduction: &Conduction, onsets: &[Onset]) -> Result<ActivationMap, ActivationError> {
        let unreached = || self.times_s.iter().enumerate().filter(|&(_, time_s)| !time_s.is_finite()).map(|(vertex, _)| vertex);
        if let Some(vertex) = unreached().next() {
            return Err(ActivationError::Unreachable { vertex, unreached_count: unreached().count() });
        }
        let stencils = (0..self.mesh.vertex_count()).filter_map(|vertex| self.stencil_of(conduction, onsets, vertex)).collect();
        Ok(ActivationMap { times_s: self.times_s, stencils })
    }

    /// None only for a vertex that was never reached.
    fn stencil_of(&self, conduction: &Conduction, onsets: &[Onset], vertex: usize) -> Option<Stencil> {
        match self.sources[vertex] {
            Source::Nowhere => None,
            Source::Recovery => Some(Stencil::Recovery),
            Source::Onset(onset) => Some(Stencil::Onset { onset: onset as usize }),
            Source::Ray(onset) => {
                let legs = trace(self.mesh, &self.holders, conduction, onsets[onset as usize].vertex, vertex)?;
                Some(Stencil::Ray { onset: onset as usize, legs })
            }
            Source::Tetrahedron(tetrahedron) => self.arrival_at(vertex, tetrahedron as usize),
        }
    }

    fn arrival_at(&self, vertex: usize, tetrahedron: usize) -> Option<Stencil> {
        let corners = self.mesh.tetrahedra()[tetrahedron];
        let times_s = corners.map(|v| self.times_s[v]);
        let target = corners.iter().position(|&v| v == vertex)?;
        let face = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]][target];
        let arrivals =
            face.iter().filter_map(|&from| self.elements[tetrahedron].arrive(&self.edges[tetrahedron], &times_s, target, from, f64::MAX));
        let arrival = arrivals.min_by(|a, b| a.time_s.total_cmp(&b.time_s))?;
        let carried_s: f64 = face.iter().map(|&corner| arrival.weights[corner] * (times_s[corner] - arrival.time_s)).sum();
        let weights = face.map(|corner| arrival.weights[corner]);
        Some(Stencil::Arrival { tetrahedron, vertices: face.map(|corner| corners[corner]), weights, travel_s: -carried_s })
    }
}

fn diagonal_mm(mesh: &TetMesh) -> f64 {
    let corner = |start: f64, pick: fn(f64, f64) -> f64| mesh.vertices_mm().iter().fold(Vector3::repeat(start), |c, p| c.zip_map(p, pick));
    (corner(f64::NEG_INFINITY, f64::max) - corner(f64::INFINITY, f64::min)).norm()
}

fn mean_edge_mm(mesh: &TetMesh) -> f64 {
    let pairs = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
    let edges = |t: usize| {
        let corners = mesh.corners_mm(t);
        pairs.map(|[a, b]| (corners[a] - corners[b]).norm()).iter().sum::<f64>() / 6.0
    };
    (0..mesh.tetrahedron_count()).map(edges).sum::<f64>() / mesh.tetrahedron_count() as f64
}

/// The tetrahedra of every vertex with the vertex's corner in each, one vertex after the other.
struct VertexHolders {
    /// Start of each vertex's entries, and one past the last.
    starts: Vec<u32>,
    entries: Vec<(u32, u8)>,
}

impl VertexHolders {
    fn new(mesh: &TetMesh) -> Self {
        let mut starts = vec![0_u32; mesh.vertex_count() + 1];
        for &vertex in mesh.tetrahedra().iter().flatten() {
            starts[vertex + 1] += 1;
        }
        for vertex in 0..mesh.vertex_count() {
            starts[vertex + 1] += starts[vertex];
        }
        let mut next = starts.clone();
        let mut entries = vec![(0, 0); 4 * mesh.tetrahedron_count()];
        for (tetrahedron, corners) in mesh.tetrahedra().iter().enumerate() {
            for (corner, &vertex) in corners.iter().enumerate() {
                entries[next[vertex] as usize] = (tetrahedron as u32, corner as u8);
                next[vertex] += 1;
            }
        }
        Self { starts, entries }
    }

    fn range(&self, vertex: usize) -> std::ops::Range<usize> {
        self.starts[vertex] as usize..self.starts[vertex + 1] as usize
    }

    fn of(&self, vertex: usize) -> &[(u32, u8)] {
        &self.entries[self.range(vertex)]
    }
}

impl Holders for VertexHolders {
    fn tetrahedra_of(&self, vertex: usize) -> impl Iterator<Item = usize> + '_ {
        self.of(vertex).iter().map(|&(tetrahedron, _)| tetrahedron as usize)
    }
}
