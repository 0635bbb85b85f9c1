//! Which voxels around a mesh at rest show its tissue.

use nalgebra::{Matrix3, Vector3};

use crate::mesh::TetMesh;

/// The wall and a margin of one voxel around it, which shows its surfaces. What lies farther out stands still or flows: blocks that hold it lag
/// behind the wall.
pub(super) struct TissueMask {
    origin_mm: Vector3<f64>,
    spacing_mm: f64,
    shape: [usize; 3],
    is_tissue: Vec<bool>,
}

impl TissueMask {
    /// The mask of a mesh in voxels of `spacing_mm`.
    pub(super) fn around(mesh: &TetMesh, spacing_mm: f64) -> Self {
        const MARGIN: f64 = 2.0;
        let vertices_mm = mesh.vertices_mm();
        let low = vertices_mm.iter().fold(Vector3::repeat(f64::INFINITY), |low, v| low.inf(v));
        let high = vertices_mm.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |high, v| high.sup(v));
        let origin_mm = low.add_scalar(-MARGIN * spacing_mm);
        let shape = [0, 1, 2].map(|axis| ((high[axis] - low[axis]) / spacing_mm + 2.0 * MARGIN).ceil() as usize + 1);
        let mut inside = Self { origin_mm, spacing_mm, shape, is_tissue: vec![false; shape.iter().product()] };
        for corners in mesh.tetrahedra() {
            inside.mark(corners.map(|corner| vertices_mm[corner]));
        }
        inside.grown()
    }

    /// Whether the voxel of a point shows tissue.
    pub(super) fn holds(&self, point_mm: &Vector3<f64>) -> bool {
        let index = ((point_mm - self.origin_mm) / self.spacing_mm).map(f64::round);
        let is_within = (0..3).all(|axis| index[axis] >= 0.0 && index[axis] < self.shape[axis] as f64);
        is_within && self.is_tissue[self.flat([0, 1, 2].map(|axis| index[axis] as usize))]
    }

    fn flat(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.shape[0] * (j + self.shape[1] * k)
    }

    /// Marks the voxels whose centres lie in a tetrahedron.
    fn mark(&mut self, corners: [Vector3<f64>; 4]) {
        const ROUNDING: f64 = 1e-9;
        let [a, b, c, d] = corners.map(|corner| (corner - self.origin_mm) / self.spacing_mm);
        let Some(to_weights) = Matrix3::from_columns(&[b - a, c - a, d - a]).try_inverse() else { return };
        let (low, high) = (a.inf(&b).inf(&c.inf(&d)), a.sup(&b).sup(&c.sup(&d)));
        let range = |axis: usize| low[axis].ceil() as usize..=high[axis].floor() as usize;
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let weights = to_weights * (Vector3::new(i as f64, j as f64, k as f64) - a);
                    if weights.min() > -ROUNDING && weights.sum() < 1.0 + ROUNDING {
                        let flat = self.flat([i, j, k]);
                        self.is_tissue[flat] = true;
                    }
                }
            }
        }
    }

    /// The same with every voxel that touches one of it by a face. The outermost voxels of the grid hold nothing.
    fn grown(self) -> Self {
        let steps = [1, self.shape[0], self.shape[0] * self.shape[1]];
        let touches = |flat: usize| {
            let beside = |step: &usize| [flat.checked_sub(*step), Some(flat + step)];
            self.is_tissue[flat] || steps.iter().flat_map(beside).flatten().any(|other| self.is_tissue.get(other).is_some_and(|&is| is))
        };
        let is_tissue = (0..self.is_tissue.len()).map(touches).collect();
        Self { is_tissue, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::slab;
    use super::*;

    /// Of points everywhere, those in the slab lie in the mask, those farther than two voxels from it do not.
    #[test]
    fn the_wall_is_tissue_and_what_lies_two_voxels_off_is_not() {
        let (mesh, _) = slab(3, |p| Vector3::new(15.0 * p.x + 2.0, 12.0 * p.y, 10.0 * p.z - 30.0));
        let mask = TissueMask::around(&mesh, 1.5);
        for n in 0..20_000 {
            let share = |prime: usize| ((n * prime) % 1009) as f64 / 1009.0 - 0.5;
            let point = Vector3::new(60.0 * share(397), 50.0 * share(613), 40.0 * share(727) - 25.0);
            let beyond = Vector3::new((point.x - 2.0).abs() - 15.0, point.y.abs() - 12.0, (point.z + 25.0).abs() - 5.0).max();
            let expected = if beyond <= 0.0 { Some(true) } else { (beyond > 3.0).then_some(false) };
            assert!(expected.is_none_or(|expected| mask.holds(&point) == expected), "{point} {beyond}");
        }
    }
}
