//! The activation map: times, the stencils they came from, and their derivative in the speeds.

use nalgebra::Vector3;

use super::march::March;
use super::ray::RayLeg;
use super::{ActivationError, Conduction};
use crate::mesh::TetMesh;

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
#[derive(Debug, Clone, PartialEq)]
pub enum Stencil {
    /// The vertex is an onset, and nothing reached it earlier.
    Onset {
        /// Its number in the list of onsets.
        onset: usize,
    },
    /// td = onset time + travel times along a straight ray.
    Ray {
        /// The onset the ray comes from.
        onset: usize,
        /// The tetrahedra it crosses.
        legs: Vec<RayLeg>,
    },
    /// A front waited here until the vertex had recovered from the beat before.
    Recovery,
    /// td = Σ wᵢ tdᵢ + travel time inside a tetrahedron.
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

/// How the neighbourhood of an onset is solved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ActivationSettings {
    /// How far straight rays reach around a single onset (one without onsets next to it); zero is the march alone. Starting at a
    /// distance r the march errs by $O(h\log(R/r))$, h the mean edge and R the diagonal of the mesh. `None` is $2\sqrt{Rh}$, which
    /// leaves less than half of the error of a march from the point where the medium is uniform or changes slowly. Where the speed
    /// changes many-fold over few elements the march errs to both sides, and taking away the delay alone can leave more.
    pub ray_length_mm: Option<f64>,
}

/// Depolarisation times td of all vertices and the stencils they came from.
#[derive(Debug, Clone, PartialEq)]
pub struct ActivationMap {
    pub(super) times_s: Vec<f64>,
    pub(super) stencils: Vec<Stencil>,
}

/// Solves the eikonal equation from the onsets. Several onsets may start at different times; fronts that meet stop each other, and an
/// onset that is reached before its own time is overrun.
///
/// # Errors
/// [`ActivationError`] if there is no onset, an onset or a field does not fit the mesh, or a part of the mesh cannot be reached.
pub fn activate(mesh: &TetMesh, conduction: &Conduction, onsets: &[Onset]) -> Result<ActivationMap, ActivationError> {
    activate_with(mesh, conduction, onsets, &ActivationSettings::default())
}

/// [`activate`] with settings of one's own.
///
/// # Errors
/// As [`activate`].
pub fn activate_with(
    mesh: &TetMesh,
    conduction: &Conduction,
    onsets: &[Onset],
    settings: &ActivationSettings,
) -> Result<ActivationMap, ActivationError> {
    check(mesh, conduction, onsets)?;
    let mut march = March::new(mesh, conduction);
    march.start(conduction, onsets, &(0..onsets.len()).collect::<Vec<_>>(), settings);
    march.run();
    march.finish(conduction, onsets)
}

pub(super) fn check(mesh: &TetMesh, conduction: &Conduction, onsets: &[Onset]) -> Result<(), ActivationError> {
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
        tangent_s(self, &|_, stencil| slowing_s(stencil, log_speed_rate), onset_rate_s, &|_| 0.0)
    }

    /// Derivative of td (s, one a vertex) by the anisotropy ratio ρ of the conduction that the map was solved with, from these onsets on
    /// this mesh. Exact and with kinks as [`ActivationMap::tangent_s`]: along a straight offset e the travel time T has
    /// $\partial T/\partial\rho = -(|e|^2 - (f \cdot e)^2)/(2 \rho^2 v^2 T)$.
    pub fn anisotropy_tangent_s(&self, mesh: &TetMesh, conduction: &Conduction, onsets: &[Onset]) -> Vec<f64> {
        let at = |vertex: usize| mesh.vertices_mm().get(vertex).copied().unwrap_or_default();
        let travel_rate_s = |vertex: usize, stencil: &Stencil| match stencil {
            Stencil::Onset { .. } | Stencil::Recovery => 0.0,
            Stencil::Ray { onset, legs } => {
                let offset_mm = at(vertex) - onsets.get(*onset).map_or_else(Vector3::zeros, |onset| at(onset.vertex));
                legs.iter().map(|leg| leg.travel_s * conduction.log_time_by_anisotropy(leg.tetrahedron, &offset_mm)).sum()
            }
            Stencil::Arrival { tetrahedron, vertices, weights, travel_s } => {
                let from_mm: Vector3<f64> = vertices.iter().zip(weights).map(|(&vertex, weight)| at(vertex) * *weight).sum();
                travel_s * conduction.log_time_by_anisotropy(*tetrahedron, &(at(vertex) - from_mm))
            }
        };
        tangent_s(self, &travel_rate_s, &[], &|_| 0.0)
    }
}

/// How the time from a stencil's vertices to its own changes with the logarithms of the speeds, s.
pub(super) fn slowing_s(stencil: &Stencil, log_speed_rate: &[f64]) -> f64 {
    match stencil {
        Stencil::Onset { .. } | Stencil::Recovery => 0.0,
        Stencil::Ray { legs, .. } => -legs.iter().map(|leg| leg.travel_s * entry(log_speed_rate, leg.tetrahedron)).sum::<f64>(),
        Stencil::Arrival { tetrahedron, travel_s, .. } => -travel_s * entry(log_speed_rate, *tetrahedron),
    }
}

/// Rates that are missing count as zero.
fn entry(rates: &[f64], index: usize) -> f64 {
    rates.get(index).copied().unwrap_or(0.0)
}

/// [`ActivationMap::tangent_s`] where the time from a stencil's vertices to its own changes at the rate `travel_rate_s`, and vertices
/// recover at times that change at the rate `recovery_rate_s`.
pub(super) fn tangent_s(
    map: &ActivationMap,
    travel_rate_s: &dyn Fn(usize, &Stencil) -> f64,
    onset_rate_s: &[f64],
    recovery_rate_s: &dyn Fn(usize) -> f64,
) -> Vec<f64> {
    let mut order: Vec<usize> = (0..map.times_s.len()).collect();
    order.sort_unstable_by(|&a, &b| map.times_s[a].total_cmp(&map.times_s[b]));
    let mut tangent_s = vec![0.0_f64; map.times_s.len()];
    // Nearly all stencils look back in time, so the first sweep is nearly always final; the others settle the rest.
    for _ in 0..TANGENT_SWEEP_LIMIT {
        let (mut change_s, mut largest_s) = (0.0_f64, 0.0_f64);
        for &vertex in &order {
            let stencil = &map.stencils[vertex];
            let start_s = match stencil {
                Stencil::Onset { onset } | Stencil::Ray { onset, .. } => entry(onset_rate_s, *onset),
                Stencil::Recovery => recovery_rate_s(vertex),
                Stencil::Arrival { vertices, weights, .. } => vertices.iter().zip(weights).map(|(&v, w)| w * tangent_s[v]).sum(),
            };
            let value_s = start_s + travel_rate_s(vertex, stencil);
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

/// The vertex nearest to a point, the first of equals; `None` only for an empty list.
pub fn nearest_vertex(vertices_mm: &[Vector3<f64>], point_mm: &Vector3<f64>) -> Option<usize> {
    let distance = |vertex: usize| (vertices_mm[vertex] - point_mm).norm_squared();
    (0..vertices_mm.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
}
