//! The body-centred cubic lattice of the mesher, in full space or cut flat by the base plane.
//!
//! Two cubic grids of spacing h, the second in the centres of the first's cubes: "corners" and "centres". A tetrahedron joins two
//! adjacent centres to an edge of the face between them (two edges of h, four of √3/2 h). Below a base plane, the uppermost layer of
//! corners lies in the plane; the tetrahedra that stick out of it would be cut by it into exact halves, so the lattice ends with
//! these halves: the upper centre of each is replaced by the middle of the square face.

use nalgebra::{Matrix3, Vector3};

use super::AnatomyError;

/// Lattice points beyond this are refused, for memory's sake.
const POINT_LIMIT: usize = 60_000_000;

/// A lattice around a box.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    origin_mm: Vector3<f64>,
    axes: Matrix3<f64>,
    spacing_mm: f64,
    cubes: [usize; 3],
    is_cut: bool,
}

impl Lattice {
    /// A lattice around the box of corners `bounds_mm`; with `base` (a point and a unit normal), it ends at that plane.
    pub(super) fn around(
        bounds_mm: &[Vector3<f64>; 2],
        base: Option<(Vector3<f64>, Vector3<f64>)>,
        spacing_mm: f64,
    ) -> Result<Self, AnatomyError> {
        let axes = base.map_or_else(Matrix3::identity, |(_, normal)| frame_of(&normal));
        let anchor = base.map_or(bounds_mm[0], |(point, _)| point);
        let corners = (0..8).map(|c| Vector3::from_fn(|axis, _| bounds_mm[c >> axis & 1][axis]));
        let local: Vec<Vector3<f64>> = corners.map(|corner| axes.transpose() * (corner - anchor)).collect();
        let mut low = local.iter().fold(Vector3::repeat(f64::INFINITY), |low, p| low.inf(p));
        let mut high = local.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |high, p| high.sup(p));
        low -= Vector3::repeat(spacing_mm);
        high += Vector3::repeat(spacing_mm);
        if base.is_some() {
            high.z = 0.0;
        }
        let cubes: [usize; 3] = std::array::from_fn(|axis| ((high[axis] - low[axis]) / spacing_mm).ceil().max(1.0) as usize);
        // The lattice hangs from its upper end, so that the last layer of corners is exactly in the base plane.
        let local_origin = Vector3::from_fn(|axis, _| high[axis] - cubes[axis] as f64 * spacing_mm);
        let lattice = Self { origin_mm: anchor + axes * local_origin, axes, spacing_mm, cubes, is_cut: base.is_some() };
        let count = cubes.iter().try_fold(2_usize, |count, &n| count.checked_mul(n + 1)).unwrap_or(usize::MAX);
        if count > POINT_LIMIT {
            return Err(AnatomyError::TooFine { vertex_count: count, limit: POINT_LIMIT });
        }
        Ok(lattice)
    }

    pub(super) fn spacing_mm(&self) -> f64 {
        self.spacing_mm
    }

    /// The unit normal of the base plane (the third axis of the lattice where there is none).
    pub(super) fn plane_normal(&self) -> Vector3<f64> {
        self.axes.column(2).into_owned()
    }

    fn corner_count(&self) -> usize {
        self.cubes.iter().map(|n| n + 1).product()
    }

    fn centre_count(&self) -> usize {
        self.cubes.iter().product()
    }

    /// Number of lattice points: corners, centres, and the middles of the squares in the base plane.
    pub(super) fn point_count(&self) -> usize {
        self.corner_count() + self.centre_count() + if self.is_cut { self.cubes[0] * self.cubes[1] } else { 0 }
    }

    /// World position of a lattice point, mm.
    pub(super) fn position_mm(&self, point: usize) -> Vector3<f64> {
        let [nx, ny, nz] = self.cubes;
        let unflatten = |flat: usize, ni: usize, nj: usize| [flat % ni, flat / ni % nj, flat / (ni * nj)].map(|n| n as f64);
        let centres = point.wrapping_sub(self.corner_count());
        let local = if point < self.corner_count() {
            Vector3::from(unflatten(point, nx + 1, ny + 1))
        } else if centres < self.centre_count() {
            Vector3::from(unflatten(centres, nx, ny)) + Vector3::repeat(0.5)
        } else {
            let [i, j, _] = unflatten(centres - self.centre_count(), nx, ny);
            Vector3::new(i + 0.5, j + 0.5, nz as f64)
        };
        self.origin_mm + self.axes * (local * self.spacing_mm)
    }

    /// Whether a lattice point lies in the base plane.
    pub(super) fn is_in_plane(&self, point: usize) -> bool {
        let layer = (self.cubes[0] + 1) * (self.cubes[1] + 1);
        let is_top_corner = (layer * self.cubes[2]..self.corner_count()).contains(&point);
        self.is_cut && (is_top_corner || point >= self.corner_count() + self.centre_count())
    }

    fn corner(&self, [i, j, k]: [usize; 3]) -> usize {
        i + (self.cubes[0] + 1) * (j + (self.cubes[1] + 1) * k)
    }

    /// The centre of a cube, or the middle of its lower face if the cube is the one above the base plane.
    fn centre(&self, [i, j, k]: [usize; 3]) -> usize {
        let [nx, ny, nz] = self.cubes;
        let flat = i + nx * (j + ny * k.min(nz));
        self.corner_count() + flat
    }

    /// Calls `visit` with every tetrahedron, positively oriented.
    pub(super) fn for_each_tetrahedron(&self, mut visit: impl FnMut([usize; 4])) {
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let last = if axis == 2 && self.is_cut { self.cubes[axis] } else { self.cubes[axis] - 1 };
            for along in 1..=last {
                for a in 0..self.cubes[u] {
                    for b in 0..self.cubes[v] {
                        let mut upper = [0; 3];
                        (upper[axis], upper[u], upper[v]) = (along, a, b);
                        let mut lower = upper;
                        lower[axis] -= 1;
                        let (low, high) = (self.centre(lower), self.centre(upper));
                        let square = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[du, dv]| {
                            let mut corner = upper;
                            corner[u] += du;
                            corner[v] += dv;
                            self.corner(corner)
                        });
                        for edge in 0..4 {
                            visit([low, square[edge], square[(edge + 1) % 4], high]);
                        }
                    }
                }
            }
        }
    }
}

/// A right-handed orthonormal frame whose third column is `normal`.
fn frame_of(normal: &Vector3<f64>) -> Matrix3<f64> {
    let least = if normal.x.abs() <= normal.y.abs().min(normal.z.abs()) {
        Vector3::x()
    } else if normal.y.abs() <= normal.z.abs() {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let first = least.cross(normal).normalize();
    Matrix3::from_columns(&[first, normal.cross(&first), *normal])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tetrahedra_are_positive_and_fill_the_box_below_the_plane() {
        let normal = Vector3::new(1.0, 2.0, -0.5).normalize();
        let lattice = Lattice::around(&[Vector3::repeat(-4.0), Vector3::repeat(5.0)], Some((Vector3::zeros(), normal)), 1.5).unwrap();
        let mut volume = 0.0;
        lattice.for_each_tetrahedron(|corners| {
            let [a, b, c, d] = corners.map(|point| lattice.position_mm(point));
            let six = (b - a).cross(&(c - a)).dot(&(d - a));
            assert!(six > 0.0);
            volume += six / 6.0;
            for (point, position) in corners.iter().zip([a, b, c, d]) {
                let height = normal.dot(&position);
                assert!(height < 1e-12);
                assert_eq!(lattice.is_in_plane(*point), height.abs() < 1e-9);
            }
        });
        // All but the pyramids between the outermost centres and the five other faces of the box.
        let [nx, ny, nz] = lattice.cubes.map(|n| n as f64);
        let expected = (nx * ny * nz - (nx * ny + 2.0 * nx * nz + 2.0 * ny * nz) / 6.0) * 1.5_f64.powi(3);
        assert!((volume - expected).abs() < 1e-9 * expected, "{volume} {expected}");
    }
}
