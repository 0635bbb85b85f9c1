//! What a mesh file holds, before it is checked and becomes a mesh.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{Matrix3, Vector3};

use crate::mesh::{MeshError, SurfaceTag, TaggedSurface, TetMesh};

/// Values a point or a cell, as a file has them.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldArray {
    /// Numbers an entry.
    pub components: usize,
    /// The numbers, entry by entry.
    pub values: Vec<f64>,
}

impl FieldArray {
    /// The entries of a field of three components; `None` for another number.
    pub fn vectors(&self) -> Option<Vec<Vector3<f64>>> {
        (self.components == 3).then(|| self.values.chunks_exact(3).map(|v| Vector3::new(v[0], v[1], v[2])).collect())
    }
}

/// Points, tetrahedra and triangles of a file with their fields; other cells (points, lines) are left out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MeshFile {
    /// Positions in the file's unit of length.
    pub points: Vec<Vector3<f64>>,
    /// Tetrahedra.
    pub tetrahedra: Vec<[usize; 4]>,
    /// Triangles.
    pub triangles: Vec<[usize; 3]>,
    /// Fields of points by name.
    pub point_fields: BTreeMap<String, FieldArray>,
    /// Fields of tetrahedra by name.
    pub tetrahedron_fields: BTreeMap<String, FieldArray>,
    /// Fields of triangles by name.
    pub triangle_fields: BTreeMap<String, FieldArray>,
}

/// What the order of a tetrahedron's corners means in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Numbering {
    /// All tetrahedra are ordered alike, right- or left-handed; one that is not is inverted, an error.
    #[default]
    Oriented,
    /// Nothing, as where a program sorts the corners (FEniCS): each tetrahedron is turned to a positive volume. Overlaps are still found.
    Free,
}

/// The codes that stand for the surfaces in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TagCodes(pub BTreeMap<i64, SurfaceTag>);

impl Default for TagCodes {
    /// [`SurfaceTag::code`].
    fn default() -> Self {
        Self(SurfaceTag::ALL.into_iter().map(|tag| (i64::from(tag.code()), tag)).collect())
    }
}

impl MeshFile {
    /// The tetrahedra as a mesh in mm, one unit of the file being `mm_per_unit`. Points that only triangles or nothing use are not allowed.
    ///
    /// # Errors
    /// [`MeshError::ImplausibleSize`] if the mesh is then smaller than 10 mm or larger than 1 m, or what [`TetMesh::new`] finds.
    pub fn to_tet_mesh(&self, mm_per_unit: f64, numbering: Numbering) -> Result<TetMesh, MeshError> {
        let vertices_mm: Vec<Vector3<f64>> = self.points.iter().map(|p| p * mm_per_unit).collect();
        let low = vertices_mm.iter().fold(Vector3::repeat(f64::INFINITY), |low, p| low.inf(p));
        let high = vertices_mm.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |high, p| high.sup(p));
        let extent_mm = (high - low).max();
        if extent_mm.is_finite() && !(10.0..=1000.0).contains(&extent_mm) {
            return Err(MeshError::ImplausibleSize { extent_mm });
        }
        let is_inverted = |corners: &[usize; 4]| match corners.map(|v| vertices_mm.get(v)) {
            [Some(a), Some(b), Some(c), Some(d)] => (b - a).cross(&(c - a)).dot(&(d - a)) < 0.0,
            _ => false,
        };
        let turn = |&[a, b, c, d]: &[usize; 4]| [a, b, d, c];
        let tetrahedra = match numbering {
            Numbering::Oriented if self.tetrahedra.iter().all(is_inverted) => self.tetrahedra.iter().map(turn).collect(),
            Numbering::Oriented => self.tetrahedra.clone(),
            Numbering::Free => self.tetrahedra.iter().map(|corners| if is_inverted(corners) { turn(corners) } else { *corners }).collect(),
        };
        TetMesh::new(vertices_mm, tetrahedra)
    }

    /// The field of the triangles that by its name tells the surfaces apart: our own, or Gmsh's physical groups.
    pub fn surface_field(&self) -> &'static str {
        let usual = ["surface_tag", "physical", "gmsh:physical"];
        usual.into_iter().find(|name| self.triangle_fields.contains_key(*name)).unwrap_or(usual[0])
    }

    /// A field of directions, one a tetrahedron, from the tetrahedra's fields or else from the points'.
    ///
    /// Directions at points are averaged as vectors where their signs go on from point to point, so that fibres of +57° and −57° on the
    /// two sides of a wall of one tetrahedron meet at 0° and not, by the shorter way, at 90°; else as axes, whose signs mean nothing.
    ///
    /// # Errors
    /// [`MeshError::MissingField`] if neither has such a field of three components.
    pub fn directions(&self, name: &str) -> Result<Vec<Vector3<f64>>, MeshError> {
        let field = |fields: &BTreeMap<String, FieldArray>| fields.get(name).and_then(FieldArray::vectors);
        if let Some(directions) = field(&self.tetrahedron_fields) {
            return Ok(directions);
        }
        let at_points = field(&self.point_fields).ok_or_else(|| {
            let available = self.tetrahedron_fields.keys().chain(self.point_fields.keys()).cloned().collect();
            MeshError::MissingField { subject: "tetrahedra and points", name: name.into(), components: 3, available }
        })?;
        let missing = |&vertex: &usize| at_points.get(vertex).copied().unwrap_or_else(Vector3::zeros);
        let corners: Vec<_> = self.tetrahedra.iter().map(|corners| corners.each_ref().map(missing)).collect();
        let mean = if are_signs_meant(&corners) { mean_vector } else { mean_axis };
        Ok(corners.into_iter().map(mean).collect())
    }

    /// The tagged boundary of `mesh` from the file's triangles and the codes in their field `field`.
    ///
    /// # Errors
    /// [`MeshError::NoSurface`], [`MeshError::MissingField`], [`MeshError::UnknownTag`] for a code that `codes` does not have, [`MeshError::UntaggedTriangle`] for a
    /// boundary triangle that the file does not have.
    pub fn to_tagged_surface(&self, mesh: &TetMesh, field: &str, codes: &TagCodes) -> Result<TaggedSurface, MeshError> {
        if self.triangles.is_empty() {
            return Err(MeshError::NoSurface);
        }
        let available = || self.triangle_fields.keys().cloned().collect();
        let missing = || MeshError::MissingField { subject: "triangles", name: field.into(), components: 1, available: available() };
        let values = &self.triangle_fields.get(field).filter(|f| f.components == 1).ok_or_else(missing)?.values;
        let mut tag_of = HashMap::with_capacity(self.triangles.len());
        for (triangle, &value) in self.triangles.iter().zip(values) {
            tag_of.insert(sorted(*triangle), value.round() as i64);
        }
        let tag = |triangle: [usize; 3]| {
            let centre_mm = triangle.iter().map(|&v| mesh.vertices_mm()[v]).sum::<Vector3<f64>>() / 3.0;
            let code = *tag_of.get(&sorted(triangle)).ok_or(MeshError::UntaggedTriangle { vertices: triangle, centre_mm })?;
            codes.0.get(&code).copied().ok_or_else(|| MeshError::UnknownTag { code, known: codes.0.keys().copied().collect(), centre_mm })
        };
        let tags = mesh.boundary_triangles().into_iter().map(tag).collect::<Result<Vec<SurfaceTag>, MeshError>>()?;
        TaggedSurface::new(mesh, tags)
    }
}

/// Whether directions at the corners of tetrahedra go on from corner to corner: signs drawn by lot turn round along half of the edges,
/// a thin wall of crossing fibres along few.
fn are_signs_meant(corners: &[[Vector3<f64>; 4]]) -> bool {
    const TURNED_LIMIT: f64 = 0.25;
    let edges = corners.iter().flat_map(|&[a, b, c, d]| [(a, b), (a, c), (a, d), (b, c), (b, d), (c, d)]);
    let turned = edges.filter(|(one, other)| one.dot(other) < 0.0).count();
    (turned as f64) < TURNED_LIMIT * 6.0 * corners.len() as f64
}

/// The mean of vectors; their principal axis where they cancel out.
fn mean_vector(directions: [Vector3<f64>; 4]) -> Vector3<f64> {
    let mean = directions.iter().sum::<Vector3<f64>>() / 4.0;
    let longest = directions.iter().map(Vector3::norm).fold(0.0, f64::max);
    if mean.norm() > 1e-3 * longest { mean } else { mean_axis(directions) }
}

/// The principal axis of $\sum v v^\top$: the mean of directions whose sign means nothing.
fn mean_axis(directions: [Vector3<f64>; 4]) -> Vector3<f64> {
    let spread: Matrix3<f64> = directions.iter().map(|v| v * v.transpose()).sum();
    if !spread.iter().all(|s| s.is_finite()) {
        return Vector3::zeros();
    }
    let eigen = spread.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()) * eigen.eigenvalues.max().sqrt()
}

fn sorted(mut triangle: [usize; 3]) -> [usize; 3] {
    triangle.sort_unstable();
    triangle
}

/// Cells of several kinds as files list them; gives their fields to the tetrahedra and triangles among them.
#[derive(Debug, Default)]
pub(super) struct CellSorter {
    tetrahedra: Vec<[usize; 4]>,
    triangles: Vec<[usize; 3]>,
    tetrahedron_rows: Vec<usize>,
    triangle_rows: Vec<usize>,
    cell_count: usize,
}

impl CellSorter {
    /// Takes the next cell by its VTK type.
    pub(super) fn add(&mut self, vtk_type: i64, corners: &[usize]) -> Result<(), String> {
        let row = self.cell_count;
        self.cell_count += 1;
        match (vtk_type, corners) {
            (10, &[a, b, c, d]) => {
                self.tetrahedra.push([a, b, c, d]);
                self.tetrahedron_rows.push(row);
            }
            (5, &[a, b, c]) => {
                self.triangles.push([a, b, c]);
                self.triangle_rows.push(row);
            }
            (1..=4, _) => {}
            _ => return Err(format!("cell {row} has VTK type {vtk_type} and {} points; linear tetrahedra are needed", corners.len())),
        }
        Ok(())
    }

    pub(super) fn cell_count(&self) -> usize {
        self.cell_count
    }

    /// The entries of a cell field that belong to tetrahedra, and to triangles.
    pub(super) fn split(&self, field: &FieldArray) -> [FieldArray; 2] {
        [&self.tetrahedron_rows, &self.triangle_rows].map(|rows| {
            let n = field.components;
            let values = rows.iter().flat_map(|&row| field.values[row * n..(row + 1) * n].iter().copied()).collect();
            FieldArray { components: n, values }
        })
    }

    /// Everything into a file's content; `cell_fields` have one entry a cell.
    pub(super) fn finish(
        self,
        points: Vec<Vector3<f64>>,
        point_fields: BTreeMap<String, FieldArray>,
        cell_fields: &BTreeMap<String, FieldArray>,
    ) -> MeshFile {
        let mut file = MeshFile { points, point_fields, ..MeshFile::default() };
        for (name, field) in cell_fields {
            let [of_tetrahedra, of_triangles] = self.split(field);
            file.tetrahedron_fields.insert(name.clone(), of_tetrahedra);
            file.triangle_fields.insert(name.clone(), of_triangles);
        }
        (file.tetrahedra, file.triangles) = (self.tetrahedra, self.triangles);
        file
    }
}
