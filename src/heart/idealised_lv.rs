//! A truncated-ellipsoid left ventricle on a structured mesh, for the tests of this room.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Vector3};

use crate::anatomy::{Anatomy, HeartAxes, Region};
use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};

/// Size and resolution of the ventricle: apex at the bottom, base cut at a height above the equator, septum towards +x.
#[derive(Debug, Clone, Copy)]
pub(super) struct IdealisedLv {
    /// Equatorial endocardial radius, mm.
    pub(super) radius_mm: f64,
    /// Endocardial semi-axis along z, mm.
    pub(super) half_length_mm: f64,
    /// Thickness of the wall, mm.
    pub(super) wall_mm: f64,
    /// Height of the base over the equator, mm.
    pub(super) base_height_mm: f64,
    /// Sectors, rings and layers.
    pub(super) resolution: [usize; 3],
    /// Helix angle at the endocardium; minus it at the epicardium, degrees.
    pub(super) helix_deg: f64,
}

impl Default for IdealisedLv {
    fn default() -> Self {
        Self { radius_mm: 27.0, half_length_mm: 62.0, wall_mm: 9.5, base_height_mm: 20.0, resolution: [16, 8, 2], helix_deg: 80.0 }
    }
}

impl IdealisedLv {
    /// Meshes it and finds everything that an anatomy holds.
    pub(super) fn anatomy(&self) -> Anatomy {
        let [sectors, rings, layers] = self.resolution;
        let sheet = surface_triangles(sectors, rings);
        let per_layer = 1 + sectors * rings;
        let mut vertices = vec![];
        let mut depth = vec![];
        for layer in 0..=layers {
            let s = layer as f64 / layers as f64;
            vertices.extend((0..per_layer).map(|node| self.position(s, node)));
            depth.extend(std::iter::repeat_n(s, per_layer));
        }
        let mut tetrahedra = vec![];
        for layer in 0..layers {
            for &triangle in &sheet {
                tetrahedra.extend(extruded(triangle, layer * per_layer, (layer + 1) * per_layer).map(|tet| oriented(tet, &vertices)));
            }
        }
        let mesh = TetMesh::new(vertices, tetrahedra).unwrap();
        let layer_of = |vertex: usize| vertex / per_layer;
        let tags = mesh
            .boundary_triangles()
            .iter()
            .map(|triangle| match triangle {
                t if t.iter().all(|&v| layer_of(v) == 0) => SurfaceTag::EndocardiumLv,
                t if t.iter().all(|&v| layer_of(v) == layers) => SurfaceTag::Epicardium,
                _ => SurfaceTag::Base,
            })
            .collect();
        let surface = TaggedSurface::new(&mesh, tags).unwrap();
        self.assemble(mesh, surface, depth)
    }

    fn assemble(&self, mesh: TetMesh, surface: TaggedSurface, transmural_depth: Vec<f64>) -> Anatomy {
        let cavities = Anatomy::close_cavities(&surface).unwrap();
        let (mut heart_axes, mut fibre_axes, mut aha_segments, mut regions) = (vec![], vec![], vec![], vec![]);
        for (tetrahedron, corners) in mesh.tetrahedra().iter().enumerate() {
            let centre = mesh.corners_mm(tetrahedron).iter().sum::<Vector3<f64>>() / 4.0;
            let s = corners.iter().map(|&v| transmural_depth[v]).sum::<f64>() / 4.0;
            let axes = self.local_axes(s, &centre);
            let angle = (self.helix_deg * (1.0 - 2.0 * s)).to_radians();
            let fibre = axes.column(0) * angle.cos() + axes.column(1) * angle.sin();
            let sheet = axes.column(2).into_owned();
            fibre_axes.push(Matrix3::from_columns(&[fibre, sheet, fibre.cross(&sheet)]));
            heart_axes.push(axes);
            let segment = self.aha_segment(&centre);
            aha_segments.push(segment);
            regions.push(if [2, 3, 8, 9, 14].contains(&segment) { Region::Septum } else { Region::FreeWallLv });
        }
        let axes =
            HeartAxes { base_centre_mm: Vector3::z() * self.base_height_mm, long_axis: Vector3::z(), septal_direction: Vector3::x() };
        Anatomy { mesh, surface, cavities, transmural_depth, fibre_axes, heart_axes, regions, aha_segments, axes }
    }

    fn position(&self, s: f64, node: usize) -> Vector3<f64> {
        let (radius, half_length) = (self.radius_mm + s * self.wall_mm, self.half_length_mm + s * self.wall_mm);
        if node == 0 {
            return Vector3::new(0.0, 0.0, -half_length);
        }
        let [sectors, rings, _] = self.resolution;
        let (ring, sector) = ((node - 1) / sectors + 1, (node - 1) % sectors);
        let polar_end = (-self.base_height_mm / half_length).acos();
        let polar = polar_end * ring as f64 / rings as f64;
        let around = TAU * sector as f64 / sectors as f64;
        Vector3::new(radius * polar.sin() * around.cos(), radius * polar.sin() * around.sin(), -half_length * polar.cos())
    }

    /// Columns circumferential, longitudinal (to the base), radial (outward).
    fn local_axes(&self, s: f64, point: &Vector3<f64>) -> Matrix3<f64> {
        let (radius, half_length) = (self.radius_mm + s * self.wall_mm, self.half_length_mm + s * self.wall_mm);
        let radial = Vector3::new(point.x / radius.powi(2), point.y / radius.powi(2), point.z / half_length.powi(2)).normalize();
        let circumferential = Vector3::z().cross(&radial).normalize();
        Matrix3::from_columns(&[circumferential, radial.cross(&circumferential), radial])
    }

    fn aha_segment(&self, point: &Vector3<f64>) -> u8 {
        let depth = (self.base_height_mm - point.z) / (self.base_height_mm + self.half_length_mm);
        let turn = point.y.atan2(point.x).rem_euclid(TAU);
        let sector = |count: usize, first_half: f64| ((turn / TAU * count as f64 + first_half) as usize % count) as u8;
        match depth {
            d if d < 0.35 => 1 + (sector(6, 0.0) + 2) % 6,
            d if d < 0.7 => 7 + (sector(6, 0.0) + 2) % 6,
            d if d < 0.93 => 13 + (sector(4, 0.5) + 1) % 4,
            _ => 17,
        }
    }
}

/// A disc of rings of sectors around node 0, diagonals alternating.
fn surface_triangles(sectors: usize, rings: usize) -> Vec<[usize; 3]> {
    let node = |ring: usize, sector: usize| if ring == 0 { 0 } else { 1 + (ring - 1) * sectors + sector % sectors };
    let mut triangles = vec![];
    for ring in 0..rings {
        for sector in 0..sectors {
            let [a, b, c, d] = [node(ring, sector), node(ring, sector + 1), node(ring + 1, sector + 1), node(ring + 1, sector)];
            match (ring, (ring + sector) % 2) {
                (0, _) => triangles.push([0, c, d]),
                (_, 0) => triangles.extend([[a, b, c], [a, c, d]]),
                _ => triangles.extend([[a, b, d], [b, c, d]]),
            }
        }
    }
    triangles
}

/// Three tetrahedra of the prism over a triangle; the staircase by ascending number makes neighbours meet.
fn extruded(mut triangle: [usize; 3], low: usize, high: usize) -> [[usize; 4]; 3] {
    triangle.sort_unstable();
    let [i, j, k] = triangle;
    [[i + low, j + low, k + low, k + high], [i + low, j + low, j + high, k + high], [i + low, i + high, j + high, k + high]]
}

fn oriented([a, b, c, d]: [usize; 4], vertices: &[Vector3<f64>]) -> [usize; 4] {
    let [p, q, r, s] = [a, b, c, d].map(|v| vertices[v]);
    if (q - p).cross(&(r - p)).dot(&(s - p)) > 0.0 { [a, b, c, d] } else { [a, c, b, d] }
}

#[test]
fn its_cavity_has_the_volume_of_a_truncated_ellipsoid() {
    let lv = IdealisedLv { resolution: [64, 32, 1], ..IdealisedLv::default() };
    let anatomy = lv.anatomy();
    let (r, c, z) = (lv.radius_mm, lv.half_length_mm, lv.base_height_mm);
    let exact = PI * r * r * (2.0 * c / 3.0 + z - z.powi(3) / (3.0 * c * c));
    let volume = anatomy.cavities[0].1.volume_mm3(anatomy.mesh.vertices_mm());
    assert!((volume / exact - 1.0).abs() < 5e-3, "{volume} {exact}");
}
