//! The activation map: a multi-front, label-correcting march over the tetrahedra, and its derivative.
//!
//! The earliest vertex of the front is taken off and its tetrahedra are solved for their other corners; whoever is reached earlier than
//! before goes (back) on the front. With isotropy this is fast marching; with anisotropy a vertex may be taken off before all it depends
//! on is known, and putting it back is the recursive correction of \[Konukoglu2007\] (their CHANGED list) in one queue. What is reached
//! is the fixed point of a monotone map from above, so it depends neither on the numbering nor on the order of the visits.

use nalgebra::Vector3;

use super::element::{Arrival, Element};
use super::front::Front;
use super::{ActivationError, Conduction};
use crate::mesh::TetMesh;

/// Relative fall of a time below which it counts as unchanged; well above rounding, far below any error of the mesh.
const UNCHANGED: f64 = 1e-13;

/// Sweeps after which the tangent of a map whose stencils depend on each other in circles is taken as it is.
const TANGENT_SWEEP_LIMIT: usize = 200;

/// A vertex where the depolarisation starts by itself, and when.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Onset {
    /// The vertex.
    pub vertex: usize,
    /// When it is depolarised, s.
    pub time_s: f64,
}

/// Where the time of a vertex came from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stencil {
    /// The vertex is an onset, and nothing reached it earlier.
    Onset {
        /// Its number in the list of onsets.
        onset: usize,
    },
    /// td = Σ wᵢ tdᵢ + travel time inside a tetrahedron; unused corners repeat a used one with weight 0.
    Arrival {
        /// The tetrahedron the front came through.
        tetrahedron: usize,
        /// Corners of the face it came through.
        vertices: [usize; 3],
        /// Their weights, ≥ 0, of sum 1.
        weights: [f64; 3],
        /// Time inside the tetrahedron, s.
        travel_s: f64,
    },
}

/// Depolarisation times td of all vertices and the stencils they came from.
#[derive(Debug, Clone, PartialEq)]
pub struct ActivationMap {
    times_s: Vec<f64>,
    stencils: Vec<Stencil>,
}

/// Solves the eikonal equation from the onsets. Several onsets may start at different times; fronts that meet stop each other, and an
/// onset that is reached before its own time is overrun.
///
/// # Errors
/// [`ActivationError`] if there is no onset, an onset or a field does not fit the mesh, or a part of the mesh cannot be reached.
pub fn activate(mesh: &TetMesh, conduction: &Conduction, onsets: &[Onset]) -> Result<ActivationMap, ActivationError> {
    check(mesh, conduction, onsets)?;
    let mut march = March::new(mesh, conduction);
    for (onset, &Onset { vertex, time_s }) in onsets.iter().enumerate() {
        if time_s < march.times_s[vertex] {
            march.reach(vertex, time_s, Source::Onset { onset: onset as u32 });
        }
    }
    while let Some(vertex) = march.front.pop() {
        march.leave(mesh, vertex);
    }
    march.finish(mesh)
}

fn check(mesh: &TetMesh, conduction: &Conduction, onsets: &[Onset]) -> Result<(), ActivationError> {
    let (speed_count, fibre_count) = (conduction.speed_mm_per_s().len(), conduction.fibres().len());
    let (vertex_count, tetrahedron_count) = (mesh.vertex_count(), mesh.tetrahedron_count());
    if speed_count != tetrahedron_count {
        return Err(ActivationError::FieldCount { speed_count, fibre_count, tetrahedron_count });
    }
    if onsets.is_empty() {
        return Err(ActivationError::NoOnset);
    }
    for (onset, &Onset { vertex, time_s }) in onsets.iter().enumerate() {
        if vertex >= vertex_count {
            return Err(ActivationError::OnsetOutOfRange { onset, vertex, vertex_count });
        }
        if !time_s.is_finite() {
            return Err(ActivationError::NonFiniteOnset { onset, time_s });
        }
    }
    Ok(())
}

/// Where a tentative time came from.
#[derive(Debug, Clone, Copy)]
enum Source {
    Nowhere,
    Onset { onset: u32 },
    Tetrahedron { tetrahedron: u32, weights: [f64; 4] },
}

/// The march in progress.
struct March {
    elements: Vec<Element>,
    /// Start of each vertex's holders, and one past the last.
    holder_starts: Vec<u32>,
    /// Tetrahedron and corner of every vertex's holders.
    holders: Vec<(u32, u8)>,
    times_s: Vec<f64>,
    sources: Vec<Source>,
    front: Front,
}

impl March {
    fn new(mesh: &TetMesh, conduction: &Conduction) -> Self {
        let elements = (0..mesh.tetrahedron_count()).map(|t| Element::new(mesh.corners_mm(t), conduction, t)).collect();
        let (holder_starts, holders) = holders_of(mesh);
        let vertex_count = mesh.vertex_count();
        let (times_s, sources) = (vec![f64::INFINITY; vertex_count], vec![Source::Nowhere; vertex_count]);
        Self { elements, holder_starts, holders, times_s, sources, front: Front::new(vertex_count) }
    }

    fn reach(&mut self, vertex: usize, time_s: f64, source: Source) {
        self.times_s[vertex] = time_s;
        self.sources[vertex] = source;
        self.front.advance(vertex, time_s);
    }

    /// Carries the front from a vertex to the other corners of its tetrahedra.
    fn leave(&mut self, mesh: &TetMesh, vertex: usize) {
        for holder in self.holder_starts[vertex] as usize..self.holder_starts[vertex + 1] as usize {
            let (tetrahedron, from) = self.holders[holder];
            let corners = &mesh.tetrahedra()[tetrahedron as usize];
            let element = self.elements[tetrahedron as usize];
            for target in (0..4).filter(|&corner| corner != from as usize) {
                let known_s = self.times_s[corners[target]];
                let bound_s = if known_s.is_finite() { known_s - UNCHANGED * known_s.abs() } else { known_s };
                let times_s = corners.map(|corner| self.times_s[corner]);
                if let Some(Arrival { time_s, weights }) = element.arrive(&times_s, target, from as usize, bound_s) {
                    self.reach(corners[target], time_s, Source::Tetrahedron { tetrahedron, weights });
                }
            }
        }
    }

    fn finish(self, mesh: &TetMesh) -> Result<ActivationMap, ActivationError> {
        let unreached = || self.times_s.iter().enumerate().filter(|&(_, time_s)| !time_s.is_finite()).map(|(vertex, _)| vertex);
        if let Some(vertex) = unreached().next() {
            return Err(ActivationError::Unreachable { vertex, unreached_count: unreached().count() });
        }
        let stencils = (0..mesh.vertex_count()).filter_map(|vertex| self.stencil_of(mesh, vertex)).collect();
        Ok(ActivationMap { times_s: self.times_s, stencils })
    }

    /// None only for a vertex that was never reached.
    fn stencil_of(&self, mesh: &TetMesh, vertex: usize) -> Option<Stencil> {
        let (tetrahedron, weights) = match self.sources[vertex] {
            Source::Nowhere => return None,
            Source::Onset { onset } => return Some(Stencil::Onset { onset: onset as usize }),
            Source::Tetrahedron { tetrahedron, weights } => (tetrahedron as usize, weights),
        };
        let corners = mesh.tetrahedra()[tetrahedron];
        let face = (0..4).filter(|&corner| corners[corner] != vertex);
        let (mut vertices, mut face_weights, mut start_s) = ([0; 3], [0.0; 3], 0.0);
        for (place, corner) in face.enumerate() {
            (vertices[place], face_weights[place]) = (corners[corner], weights[corner]);
            start_s += weights[corner] * (self.times_s[corners[corner]] - self.times_s[vertex]);
        }
        Some(Stencil::Arrival { tetrahedron, vertices, weights: face_weights, travel_s: -start_s })
    }
}

/// The tetrahedra of every vertex with the vertex's corner in each, one after the other, and where each vertex's begin.
fn holders_of(mesh: &TetMesh) -> (Vec<u32>, Vec<(u32, u8)>) {
    let mut starts = vec![0_u32; mesh.vertex_count() + 1];
    for &vertex in mesh.tetrahedra().iter().flatten() {
        starts[vertex + 1] += 1;
    }
    for vertex in 0..mesh.vertex_count() {
        starts[vertex + 1] += starts[vertex];
    }
    let mut next = starts.clone();
    let mut holders = vec![(0, 0); 4 * mesh.tetrahedron_count()];
    for (tetrahedron, corners) in mesh.tetrahedra().iter().enumerate() {
        for (corner, &vertex) in corners.iter().enumerate() {
            holders[next[vertex] as usize] = (tetrahedron as u32, corner as u8);
            next[vertex] += 1;
        }
    }
    (starts, holders)
}

impl ActivationMap {
    /// Depolarisation time td of every vertex, s.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Where every vertex's time came from.
    pub fn stencils(&self) -> &[Stencil] {
        &self.stencils
    }

    /// The first and the last depolarisation, s.
    pub fn span_s(&self) -> (f64, f64) {
        self.times_s.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), &t| (first.min(t), last.max(t)))
    }

    /// td at the centre of every tetrahedron, s: the mean of its corners.
    pub fn tetrahedron_times_s(&self, mesh: &TetMesh) -> Vec<f64> {
        mesh.tetrahedra().iter().map(|corners| corners.iter().map(|&v| self.times_s[v]).sum::<f64>() / 4.0).collect()
    }

    /// Directional derivative of td (s, one a vertex) when the logarithm of the speed of tetrahedron e changes at the rate
    /// `log_speed_rate[e]` and the time of onset o at `onset_rate_s[o]`.
    ///
    /// A travel time inside an element falls as 1/v and the weights are those of a minimum, so that
    /// $\dot t_d = \sum_i w_i\,\dot t_{d,i} - t_\mathrm{travel}\,\dot{\ln v}$ exactly, wherever td is differentiable at all (it has a kink
    /// where two fronts arrive together). Rates that are missing count as zero.
    pub fn tangent_s(&self, log_speed_rate: &[f64], onset_rate_s: &[f64]) -> Vec<f64> {
        let rate = |rates: &[f64], entry: usize| rates.get(entry).copied().unwrap_or(0.0);
        let mut order: Vec<usize> = (0..self.times_s.len()).collect();
        order.sort_unstable_by(|&a, &b| self.times_s[a].total_cmp(&self.times_s[b]));
        let mut tangent_s = vec![0.0_f64; self.times_s.len()];
        // Nearly all stencils look back in time, so the first sweep is nearly always final; the others settle the rest.
        for _ in 0..TANGENT_SWEEP_LIMIT {
            let (mut change_s, mut largest_s) = (0.0_f64, 0.0_f64);
            for &vertex in &order {
                let value_s = match self.stencils[vertex] {
                    Stencil::Onset { onset } => rate(onset_rate_s, onset),
                    Stencil::Arrival { tetrahedron, vertices, weights, travel_s } => {
                        let carried_s: f64 = vertices.iter().zip(&weights).map(|(&v, w)| w * tangent_s[v]).sum();
                        carried_s - travel_s * rate(log_speed_rate, tetrahedron)
                    }
                };
                change_s = change_s.max((value_s - tangent_s[vertex]).abs());
                largest_s = largest_s.max(value_s.abs());
                tangent_s[vertex] = value_s;
            }
            if change_s <= 1e-15 * largest_s {
                break;
            }
        }
        tangent_s
    }
}

/// The vertex nearest to a point, the first of equals; `None` only for an empty list.
pub fn nearest_vertex(vertices_mm: &[Vector3<f64>], point_mm: &Vector3<f64>) -> Option<usize> {
    let distance = |vertex: usize| (vertices_mm[vertex] - point_mm).norm_squared();
    (0..vertices_mm.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
}
