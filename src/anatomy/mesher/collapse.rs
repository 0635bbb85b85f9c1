//! Removes edges that are much shorter than the lattice's and spoil the tetrahedra around them, where thin walls kept the warping from
//! doing so.
//!
//! One end of a short edge is moved onto the other. That is done only if the topology stays as it is (link conditions of \[Dey1999\]), no
//! vertex leaves its surface, the base plane or its rim, and the tetrahedra around do not become worse.

use std::collections::BTreeSet;

use super::StuffedMesh;
use super::optimise::least_dihedral_sine;

/// Edges shorter than this fraction of the lattice spacing are removed if possible.
const SHORT: f64 = 0.4;

/// Edges with a tetrahedron below this least dihedral sine (30°) are removed if possible.
const POOR: f64 = 0.5;

/// Least dihedral sine (20°) that a collapse may leave behind even where it was better before.
const ACCEPTABLE: f64 = 0.342;

/// Collapses short edges, the shortest first; returns how many.
pub(super) fn collapse_short_edges(mesh: &mut StuffedMesh, spacing_mm: f64) -> usize {
    let mut work = Collapse::new(mesh);
    let mut count = 0;
    let mut edges = work.short_edges(SHORT * spacing_mm);
    while !edges.is_empty() {
        let before = count;
        for [a, b] in edges {
            let is_alive = work.holders[a].iter().any(|&t| work.mesh.tetrahedra[t].contains(&b));
            if is_alive && (work.try_collapse(a, b) || work.try_collapse(b, a)) {
                count += 1;
            }
        }
        edges = if count > before { work.short_edges(SHORT * spacing_mm) } else { vec![] };
    }
    let is_kept = work.is_kept;
    let mut kept = is_kept.iter();
    mesh.tetrahedra.retain(|_| kept.next().copied().unwrap_or(true));
    count
}

struct Collapse<'a> {
    mesh: &'a mut StuffedMesh,
    /// Tetrahedra at each vertex that are still there.
    holders: Vec<Vec<usize>>,
    is_kept: Vec<bool>,
}

impl<'a> Collapse<'a> {
    fn new(mesh: &'a mut StuffedMesh) -> Self {
        let mut holders = vec![vec![]; mesh.vertices_mm.len()];
        for (tetrahedron, corners) in mesh.tetrahedra.iter().enumerate() {
            corners.iter().for_each(|&vertex| holders[vertex].push(tetrahedron));
        }
        let is_kept = vec![true; mesh.tetrahedra.len()];
        Self { mesh, holders, is_kept }
    }

    /// The short edges of poor tetrahedra, the shortest first.
    fn short_edges(&self, limit_mm: f64) -> Vec<[usize; 2]> {
        let mut edges = BTreeSet::new();
        for (tetrahedron, corners) in self.mesh.tetrahedra.iter().enumerate() {
            if self.is_kept[tetrahedron] && least_dihedral_sine(corners.map(|v| self.mesh.vertices_mm[v])) < POOR {
                edges.extend(pairs(corners).map(|[a, b]| [a.min(b), a.max(b)]));
            }
        }
        let length = |&[a, b]: &[usize; 2]| (self.mesh.vertices_mm[a] - self.mesh.vertices_mm[b]).norm();
        let mut short: Vec<[usize; 2]> = edges.into_iter().filter(|edge| length(edge) < limit_mm).collect();
        short.sort_by(|a, b| length(a).total_cmp(&length(b)).then(a.cmp(b)));
        short
    }

    /// Moves `removed` onto `kept` if that is admissible.
    fn try_collapse(&mut self, removed: usize, kept: usize) -> bool {
        let (vanishing, moving): (Vec<usize>, Vec<usize>) =
            self.holders[removed].iter().partition(|&&t| self.mesh.tetrahedra[t].contains(&kept));
        let stays_on_its_own = self.stays_on_its_own(removed, kept);
        if !stays_on_its_own || !self.keeps_topology(removed, kept) || !self.keeps_quality(removed, kept, &moving) {
            return false;
        }
        for &tetrahedron in &vanishing {
            self.is_kept[tetrahedron] = false;
            for vertex in self.mesh.tetrahedra[tetrahedron] {
                self.holders[vertex].retain(|&t| t != tetrahedron);
            }
        }
        for &tetrahedron in &moving {
            for vertex in &mut self.mesh.tetrahedra[tetrahedron] {
                if *vertex == removed {
                    *vertex = kept;
                }
            }
            self.holders[kept].push(tetrahedron);
        }
        self.holders[removed].clear();
        true
    }

    /// A vertex of a surface stays on that surface, one of the base plane in the plane, one of a rim on the rim: the edge lies in them.
    fn stays_on_its_own(&self, removed: usize, kept: usize) -> bool {
        let mesh = &self.mesh;
        let (on_surface, in_plane) = (mesh.is_on_surface[removed], mesh.is_in_plane[removed]);
        if !on_surface && !in_plane {
            return true;
        }
        // The boundary triangles at the edge: those of one tetrahedron only. Base triangles have all corners in the plane.
        let thirds = self.boundary_triangles_at(removed, kept);
        let base_count = thirds.iter().filter(|&&third| [removed, kept, third].iter().all(|&v| mesh.is_in_plane[v])).count();
        match (on_surface, in_plane) {
            (true, true) => thirds.len() == 2 && base_count == 1,
            (true, false) => thirds.len() == 2 && base_count == 0,
            _ => thirds.len() == 2 && base_count >= 1,
        }
    }

    /// Third corners of the boundary triangles at an edge.
    fn boundary_triangles_at(&self, a: usize, b: usize) -> Vec<usize> {
        let around = self.holders[a].iter().map(|&t| self.mesh.tetrahedra[t]).filter(|corners| corners.contains(&b));
        let mut thirds: Vec<usize> = around.flatten().filter(|&v| v != a && v != b).collect();
        thirds.sort_unstable();
        thirds.chunk_by(|x, y| x == y).filter(|same| same.len() == 1).map(|same| same[0]).collect()
    }

    /// The links of both ends meet in the link of the edge alone, in the solid and in its boundary.
    fn keeps_topology(&self, a: usize, b: usize) -> bool {
        let (link_a, link_b) = (self.link(a), self.link(b));
        let mut edge_link = Link::default();
        for corners in self.holders[a].iter().map(|&t| self.mesh.tetrahedra[t]).filter(|corners| corners.contains(&b)) {
            let others: Vec<usize> = corners.into_iter().filter(|&v| v != a && v != b).collect();
            edge_link.vertices.extend(&others);
            edge_link.edges.insert([others[0].min(others[1]), others[0].max(others[1])]);
        }
        let solid = link_a.vertices.intersection(&link_b.vertices).all(|v| edge_link.vertices.contains(v))
            && link_a.edges.intersection(&link_b.edges).all(|e| edge_link.edges.contains(e));
        if !solid || link_a.boundary.is_empty() || link_b.boundary.is_empty() {
            return solid;
        }
        let thirds = self.boundary_triangles_at(a, b);
        let rim = |link: &Link| -> BTreeSet<usize> { link.boundary.iter().flatten().copied().collect() };
        let common_edge = link_a.boundary.intersection(&link_b.boundary).next();
        thirds.len() == 2 && rim(&link_a).intersection(&rim(&link_b)).all(|v| thirds.contains(v)) && common_edge.is_none()
    }

    fn link(&self, vertex: usize) -> Link {
        let mut link = Link::default();
        let mut triangles: Vec<[usize; 3]> = vec![];
        for &tetrahedron in &self.holders[vertex] {
            let mut others: Vec<usize> = self.mesh.tetrahedra[tetrahedron].into_iter().filter(|&v| v != vertex).collect();
            others.sort_unstable();
            triangles.push([others[0], others[1], others[2]]);
        }
        for &[a, b, c] in &triangles {
            link.vertices.extend([a, b, c]);
            for edge in [[a, b], [b, c], [a, c]] {
                // An edge of the link that one triangle of it has alone lies, with the vertex, in the boundary.
                if !link.edges.insert(edge) {
                    link.boundary.remove(&edge);
                } else {
                    link.boundary.insert(edge);
                }
            }
        }
        link
    }

    fn keeps_quality(&self, removed: usize, kept: usize, moving: &[usize]) -> bool {
        let sine = |corners: [usize; 4]| least_dihedral_sine(corners.map(|v| self.mesh.vertices_mm[v]));
        let worst = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::INFINITY, f64::min);
        let before = worst(&mut self.holders[removed].iter().map(|&t| sine(self.mesh.tetrahedra[t])));
        let moved = |t: usize| self.mesh.tetrahedra[t].map(|v| if v == removed { kept } else { v });
        let after = worst(&mut moving.iter().map(|&t| sine(moved(t))));
        after >= before.min(ACCEPTABLE)
    }
}

/// What surrounds a vertex or an edge: the vertices and edges opposite to it, and those of the edges that bound the link.
#[derive(Default)]
struct Link {
    vertices: BTreeSet<usize>,
    edges: BTreeSet<[usize; 2]>,
    boundary: BTreeSet<[usize; 2]>,
}

fn pairs(&[a, b, c, d]: &[usize; 4]) -> [[usize; 2]; 6] {
    [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]]
}
