//! Harmonic functions on the wall: transmural depth and its gradient.

use nalgebra::Vector3;

use super::AnatomyError;
use crate::mesh::TetMesh;

/// Relative residual at which the conjugate gradients stop.
const TOLERANCE: f64 = 1e-10;

/// $\int \nabla\lambda_i\cdot\nabla\lambda_j$ of a mesh, by rows.
pub(super) struct Laplacian {
    row_start: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
    diagonal: Vec<f64>,
}

impl Laplacian {
    /// The P1 solution of $\Delta\varphi = 0$ with $\varphi$ given on some vertices and $\partial\varphi/\partial n = 0$ on the rest of the
    /// boundary. `fixed` has one entry a vertex, and so has the solution.
    ///
    /// # Errors
    /// [`AnatomyError::LaplaceStalled`] if the conjugate gradients do not converge, as when no value is given on a piece of the mesh.
    pub(super) fn solve(&self, fixed: &[Option<f64>]) -> Result<Vec<f64>, AnatomyError> {
        let mut solution: Vec<f64> = fixed.iter().map(|value| value.unwrap_or(0.0)).collect();
        let free: Vec<bool> = fixed.iter().map(Option::is_none).collect();
        let mut product = vec![0.0; solution.len()];
        self.multiply(&solution, &mut product);
        let mut residual: Vec<f64> = product.iter().zip(&free).map(|(p, &is_free)| if is_free { -p } else { 0.0 }).collect();
        let target = TOLERANCE * dot(&product, &product).sqrt();
        let mut direction = vec![0.0; solution.len()];
        let mut last_rho = 0.0;
        let iteration_limit = 10 * solution.len() + 100;
        for iterations in 0..=iteration_limit {
            let norm = dot(&residual, &residual).sqrt();
            if norm <= target {
                return Ok(solution);
            }
            if iterations == iteration_limit || !norm.is_finite() {
                return Err(AnatomyError::LaplaceStalled { iterations, residual: norm / target * TOLERANCE });
            }
            let preconditioned: Vec<f64> = residual.iter().zip(&self.diagonal).map(|(r, d)| r / d).collect();
            let rho = dot(&residual, &preconditioned);
            let beta = if iterations == 0 { 0.0 } else { rho / last_rho };
            last_rho = rho;
            for (d, z) in direction.iter_mut().zip(&preconditioned) {
                *d = z + beta * *d;
            }
            self.multiply(&direction, &mut product);
            for (p, &is_free) in product.iter_mut().zip(&free) {
                *p = if is_free { *p } else { 0.0 };
            }
            let alpha = rho / dot(&direction, &product);
            for vertex in 0..solution.len() {
                solution[vertex] += alpha * direction[vertex];
                residual[vertex] -= alpha * product[vertex];
            }
        }
        Ok(solution)
    }

    /// Assembles the matrix of a mesh.
    pub(super) fn of(mesh: &TetMesh) -> Self {
        let neighbours = mesh.vertex_neighbours();
        let mut row_start = vec![0];
        row_start.extend(neighbours.iter().scan(0, |end, row| {
            *end += row.len();
            Some(*end)
        }));
        let columns: Vec<usize> = neighbours.into_iter().flatten().collect();
        let mut matrix = Self { values: vec![0.0; columns.len()], diagonal: vec![0.0; mesh.vertex_count()], row_start, columns };
        for (tetrahedron, corners) in mesh.tetrahedra().iter().enumerate() {
            let volume_mm3 = mesh.volume_mm3(tetrahedron);
            let shapes = mesh.shape_gradients_per_mm(tetrahedron);
            for i in 0..4 {
                for j in 0..4 {
                    matrix.add(corners[i], corners[j], volume_mm3 * shapes[i].dot(&shapes[j]));
                }
            }
        }
        matrix
    }

    fn add(&mut self, row: usize, column: usize, value: f64) {
        if row == column {
            self.diagonal[row] += value;
            return;
        }
        let range = self.row_start[row]..self.row_start[row + 1];
        if let Ok(offset) = self.columns[range.clone()].binary_search(&column) {
            self.values[range.start + offset] += value;
        }
    }

    fn multiply(&self, x: &[f64], y: &mut [f64]) {
        for row in 0..y.len() {
            let range = self.row_start[row]..self.row_start[row + 1];
            let off_diagonal: f64 = range.map(|entry| self.values[entry] * x[self.columns[entry]]).sum();
            y[row] = self.diagonal[row] * x[row] + off_diagonal;
        }
    }
}

/// The gradient of a P1 function in each tetrahedron, 1/mm times its unit.
pub(super) fn gradients(mesh: &TetMesh, values: &[f64]) -> Vec<Vector3<f64>> {
    let gradient = |(tetrahedron, corners): (usize, &[usize; 4])| {
        let shapes = mesh.shape_gradients_per_mm(tetrahedron);
        corners.iter().zip(shapes).map(|(&vertex, shape)| shape * values[vertex]).sum()
    };
    mesh.tetrahedra().iter().enumerate().map(gradient).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::mesher::{MesherSettings, mesh_inside};

    /// A spherical shell, 0 at radius a and 1 at b: φ = (1/a − 1/r)/(1/a − 1/b).
    #[test]
    fn depth_of_a_spherical_shell_converges_to_the_harmonic_function() {
        let (a, b) = (20.0, 35.0);
        let shell = |p: &Vector3<f64>| (p.norm() - b).max(a - p.norm());
        let exact = |p: &Vector3<f64>| (1.0 / a - 1.0 / p.norm()) / (1.0 / a - 1.0 / b);
        let errors = [7.0, 3.5].map(|edge_length_mm| {
            let bounds = [Vector3::repeat(-36.0), Vector3::repeat(36.0)];
            let mesh = mesh_inside(&shell, &bounds, &MesherSettings::with_edge_length_mm(edge_length_mm)).unwrap();
            let mut fixed = vec![None; mesh.vertex_count()];
            for vertex in mesh.boundary_triangles().into_iter().flatten() {
                fixed[vertex] = Some(if mesh.vertices_mm()[vertex].norm() < 27.0 { 0.0 } else { 1.0 });
            }
            let depth = Laplacian::of(&mesh).solve(&fixed).unwrap();
            let squares: f64 = mesh.vertices_mm().iter().zip(&depth).map(|(p, d)| (d - exact(p)).powi(2)).sum();
            (squares / depth.len() as f64).sqrt()
        });
        assert!(errors[0] < 0.02 && errors[1] < errors[0] / 2.5, "{errors:?}");
    }

    #[test]
    fn a_linear_function_is_its_own_interpolant() {
        let ball = |p: &Vector3<f64>| p.norm() - 10.0;
        let bounds = [Vector3::repeat(-11.0), Vector3::repeat(11.0)];
        let mesh = mesh_inside(&ball, &bounds, &MesherSettings::with_edge_length_mm(4.0)).unwrap();
        let slope = Vector3::new(0.3, -0.7, 0.2);
        let linear: Vec<f64> = mesh.vertices_mm().iter().map(|p| slope.dot(p)).collect();
        let mut fixed = vec![None; mesh.vertex_count()];
        for vertex in mesh.boundary_triangles().into_iter().flatten() {
            fixed[vertex] = Some(linear[vertex]);
        }
        let solution = Laplacian::of(&mesh).solve(&fixed).unwrap();
        assert!(solution.iter().zip(&linear).all(|(s, l)| (s - l).abs() < 1e-8));
        assert!(gradients(&mesh, &linear).iter().all(|g| (g - slope).norm() < 1e-10));
    }
}
