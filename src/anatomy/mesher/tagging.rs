//! Endocardium, epicardium and base of a stuffed wall, and the checks that each is one clean patch.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use nalgebra::Vector3;

use super::{StuffedMesh, WallShape};
use crate::anatomy::{Anatomy, AnatomyError};
use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};

/// Drops all tetrahedra but the largest set joined by triangles, and the vertices left unused.
pub(super) fn keep_largest_piece(mesh: &mut StuffedMesh) {
    let pieces = pieces_by(&mesh.tetrahedra, |&[a, b, c, d]| [[b, c, d], [a, c, d], [a, b, d], [a, b, c]].map(sorted).to_vec());
    let mut sizes = BTreeMap::new();
    for &piece in &pieces {
        *sizes.entry(piece).or_insert(0_usize) += 1;
    }
    let largest = sizes.iter().max_by_key(|&(&piece, &size)| (size, std::cmp::Reverse(piece))).map_or(0, |(&piece, _)| piece);
    let mut kept = pieces.iter().map(|&piece| piece == largest);
    mesh.tetrahedra.retain(|_| kept.next().unwrap_or(false));
    mesh.drop_unused_vertices();
}

/// Tags the boundary of a wall. Triangles with all corners in the base plane are base; the rest falls into connected sheets, and each
/// sheet as a whole belongs to the surface whose level set is nearest to zero for most of its triangles.
pub(super) fn tag_wall(stuffed: StuffedMesh, shape: &WallShape) -> Result<(TetMesh, TaggedSurface), AnatomyError> {
    let StuffedMesh { vertices_mm, tetrahedra, is_in_plane, .. } = stuffed;
    let mesh = TetMesh::new(vertices_mm, tetrahedra)?;
    let triangles = mesh.boundary_triangles();
    let is_base = |triangle: &[usize; 3]| triangle.iter().all(|&vertex| is_in_plane[vertex]);
    let side: Vec<[usize; 3]> = triangles.iter().copied().filter(|t| !is_base(t)).collect();
    let sheets = pieces_by(&side, edges_of);
    let mut votes: BTreeMap<usize, BTreeMap<SurfaceTag, usize>> = BTreeMap::new();
    let mut first_triangle = BTreeMap::new();
    for (triangle, &sheet) in side.iter().zip(&sheets) {
        let centre = triangle.iter().map(|&v| mesh.vertices_mm()[v]).sum::<Vector3<f64>>() / 3.0;
        *votes.entry(sheet).or_default().entry(nearest_surface(shape, &centre)).or_insert(0) += 1;
        first_triangle.entry(sheet).or_insert(centre);
    }
    let mut tag_of_sheet = BTreeMap::new();
    for (&sheet, votes) in &votes {
        tag_of_sheet.insert(sheet, elect(votes, first_triangle[&sheet])?);
    }
    let mut sheet_tags = sheets.iter().map(|sheet| tag_of_sheet[sheet]);
    let tags = triangles.iter().map(|t| if is_base(t) { SurfaceTag::Base } else { sheet_tags.next().unwrap_or(SurfaceTag::Epicardium) });
    let surface = TaggedSurface::new(&mesh, tags.collect())?;
    check_surface(&mesh, &surface, shape)?;
    Ok((mesh, surface))
}

/// The surface whose level set is nearest to zero.
fn nearest_surface(shape: &WallShape, position_mm: &Vector3<f64>) -> SurfaceTag {
    let epicardium = ((shape.epicardium)(position_mm).abs(), SurfaceTag::Epicardium);
    let cavities = shape.cavities.iter().map(|(ventricle, cavity)| (cavity(position_mm).abs(), ventricle.endocardium()));
    cavities.fold(epicardium, |nearest, other| if other.0 < nearest.0 { other } else { nearest }).1
}

/// The tag with the majority of a sheet; a sheet without a clear one is two surfaces that run into each other.
fn elect(votes: &BTreeMap<SurfaceTag, usize>, position_mm: Vector3<f64>) -> Result<SurfaceTag, AnatomyError> {
    let triangle_count: usize = votes.values().sum();
    let (&tag, &count) = votes.iter().max_by_key(|&(_, &count)| count).unwrap_or((&SurfaceTag::Epicardium, &0));
    if 10 * count >= 9 * triangle_count {
        return Ok(tag);
    }
    let epicardial = votes.get(&SurfaceTag::Epicardium).copied().unwrap_or(0);
    Err(AnatomyError::PerforatedWall { triangle_count, endocardial: triangle_count - epicardial, epicardial, position_mm })
}

/// Each surface is there in one piece and manifold, and every cavity can be closed.
fn check_surface(mesh: &TetMesh, surface: &TaggedSurface, shape: &WallShape) -> Result<(), AnatomyError> {
    let mut wanted = vec![(SurfaceTag::Epicardium, "epicardium"), (SurfaceTag::Base, "base")];
    for (ventricle, _) in &shape.cavities {
        let tag = ventricle.endocardium();
        wanted.push((tag, if tag == SurfaceTag::EndocardiumRv { "right endocardium" } else { "left endocardium" }));
    }
    for (tag, name) in wanted {
        let triangles: Vec<[usize; 3]> = surface.triangles_with(tag).collect();
        let piece_count = pieces_by(&triangles, edges_of).into_iter().collect::<BTreeSet<_>>().len();
        if piece_count != 1 {
            return Err(AnatomyError::SurfacePieces { surface: name, piece_count });
        }
    }
    if let Some(vertex) = pinched_vertex(surface.triangles()) {
        return Err(AnatomyError::PinchedSurface { vertex, position_mm: mesh.vertices_mm()[vertex] });
    }
    Anatomy::close_cavities(surface)?;
    Ok(())
}

/// A vertex of a closed surface whose triangles do not form one closed fan.
fn pinched_vertex(triangles: &[[usize; 3]]) -> Option<usize> {
    // For every vertex the edges opposite to it, from → to; in a fan they form one cycle.
    let mut links: BTreeMap<usize, Vec<(usize, usize)>> = BTreeMap::new();
    for &[a, b, c] in triangles {
        for (vertex, from, to) in [(a, b, c), (b, c, a), (c, a, b)] {
            links.entry(vertex).or_default().push((from, to));
        }
    }
    links.into_iter().find(|(_, link)| !is_one_cycle(link)).map(|(vertex, _)| vertex)
}

fn is_one_cycle(link: &[(usize, usize)]) -> bool {
    let next: HashMap<usize, usize> = link.iter().copied().collect();
    let start = link[0].0;
    let mut vertex = start;
    for step in 1..=link.len() {
        match next.get(&vertex) {
            Some(&following) => vertex = following,
            None => return false,
        }
        if vertex == start {
            return step == link.len();
        }
    }
    false
}

fn edges_of(&[a, b, c]: &[usize; 3]) -> Vec<[usize; 2]> {
    vec![[a.min(b), a.max(b)], [b.min(c), b.max(c)], [c.min(a), c.max(a)]]
}

fn sorted(mut triangle: [usize; 3]) -> [usize; 3] {
    triangle.sort_unstable();
    triangle
}

/// For every cell the number of its piece (that of the piece's first cell), two cells that share a facet being of one piece.
fn pieces_by<C, F: std::hash::Hash + Eq>(cells: &[C], facets: impl Fn(&C) -> Vec<F>) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..cells.len()).collect();
    let mut holder = HashMap::new();
    for (cell, content) in cells.iter().enumerate() {
        for facet in facets(content) {
            let other = *holder.entry(facet).or_insert(cell);
            let (a, b) = (root(&mut parent, cell), root(&mut parent, other));
            parent[a.max(b)] = a.min(b);
        }
    }
    (0..cells.len()).map(|cell| root(&mut parent, cell)).collect()
}

fn root(parent: &mut [usize], mut cell: usize) -> usize {
    while parent[cell] != cell {
        parent[cell] = parent[parent[cell]];
        cell = parent[cell];
    }
    cell
}
