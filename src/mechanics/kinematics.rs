//! Linear or corotational kinematics, and the part of a step's system that changes with the motion in the latter.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::corotational::PointLaw;
use super::element::{Element, ElementForce, ElementTangent};
use super::scheme::Coefficients;
use super::{MechanicsError, MotionState, Myocardium};
use crate::numerics::BlockMatrix;

/// How strain is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Kinematics {
    /// Small strain, as in \[Billet2009\]: one constant matrix and one factorisation, but a rotation counts as growth. Right for
    /// stiff walls and small twist, and for speed.
    #[default]
    Linear,
    /// The linear material in the frame of each tetrahedron's polar rotation, the fibre's tension along the deformed fibre: right
    /// where the wall turns, twists and bends, with the soft tissue that is measured. A step is a few rounds of Newton's method.
    Corotational,
}

/// Which second derivative of the energy a step is linearised with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Linearisation {
    /// The derivative of the forces: Newton's method.
    Exact,
    /// That of each tetrahedron without its negative eigenvalues, so that the sum is positive definite: rounds always go downhill.
    Convex,
}

/// Tetrahedra computed together before they are added, in order, to the system: bounds the memory of a parallel assembly, whose sums
/// do not depend on the number of threads.
const CHUNK: usize = 2048;

/// What is the same in all steps of corotational kinematics.
#[derive(Debug)]
pub(super) struct CorotationalConstants {
    /// Inertia, damping of the mass, dashpots and springs, mN/mm.
    pub(super) diagonal_mn_per_mm: Vec<Matrix3<f64>>,
    /// Where the blocks of a tetrahedron are in the matrix, by rows of corners.
    places: Vec<[u32; 16]>,
}

impl CorotationalConstants {
    pub(super) fn new(tissue: &Myocardium, diagonal_mn_per_mm: Vec<Matrix3<f64>>) -> Self {
        let pattern = tissue.stiffness().pattern();
        // Corners of a tetrahedron are neighbours, so every pair of them is in the pattern.
        let place = |row, column| pattern.position(row, column).and_then(|place| u32::try_from(place).ok()).unwrap_or(0);
        let places_of = |corners: &[usize; 4]| std::array::from_fn(|pair| place(corners[pair / 4], corners[pair % 4]));
        Self { diagonal_mn_per_mm, places: tissue.tetrahedra().iter().map(places_of).collect() }
    }
}

/// What corotational kinematics add to a step's system: internal forces and their tangent at trial positions.
#[derive(Debug, Clone, PartialEq)]
pub struct Tangent {
    /// σC a tetrahedron, kPa.
    tension_kpa: Vec<f64>,
    /// Ū a tetrahedron, see [`PointLaw`].
    rest_stretch: Vec<Matrix3<f64>>,
    /// a, see [`PointLaw`].
    stiffening: f64,
    /// Where the forces were last computed, mm.
    trial_mm: Vec<Vector3<f64>>,
    /// Internal forces there, mN.
    force_mn: Vec<Vector3<f64>>,
    /// Internal energy there, mN·mm.
    energy_mn_mm: f64,
    /// K̃, mN/mm, at the trial it was last linearised about.
    matrix: BlockMatrix,
    /// What K̃ has beside the blocks of the matrix.
    mean_stiffnesses: Vec<MeanStiffness>,
    is_linearised: bool,
    is_convex: bool,
    stretches: Vec<Option<Matrix3<f64>>>,
    forces: Vec<Option<ElementForce>>,
    tangents: Vec<Option<ElementTangent>>,
}

/// $K_{ij} = (S_i + S_j^\top)/n$ between all pairs of n vertices: of rank six, so it is kept apart from the matrix.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MeanStiffness {
    rows: Vec<(usize, Matrix3<f64>)>,
}

impl MeanStiffness {
    pub(super) fn multiply_add(&self, x: &[Vector3<f64>], product: &mut [Vector3<f64>]) {
        let scale = 1.0 / self.rows.len() as f64;
        let (mut mean, mut passed_on) = (Vector3::zeros(), Vector3::zeros());
        for (vertex, block) in &self.rows {
            mean += x[*vertex] * scale;
            passed_on += block.tr_mul(&x[*vertex]) * scale;
        }
        for (vertex, block) in &self.rows {
            product[*vertex] += block * mean + passed_on;
        }
    }
}

impl Tangent {
    pub(super) fn new(tissue: &Myocardium) -> Self {
        Self {
            tension_kpa: vec![0.0; tissue.tetrahedron_count()],
            rest_stretch: vec![Matrix3::identity(); tissue.tetrahedron_count()],
            stiffening: 1.0,
            trial_mm: vec![Vector3::zeros(); tissue.vertex_count()],
            force_mn: vec![Vector3::zeros(); tissue.vertex_count()],
            energy_mn_mm: 0.0,
            matrix: BlockMatrix::zeros(std::sync::Arc::clone(tissue.stiffness().pattern())),
            mean_stiffnesses: Vec::new(),
            is_linearised: false,
            is_convex: false,
            stretches: Vec::new(),
            forces: Vec::new(),
            tangents: Vec::new(),
        }
    }

    /// Begins a step from a state: the damping of the stretch, and no tension.
    pub(super) fn begin(&mut self, tissue: &Myocardium, state: &MotionState, scheme: &Coefficients) -> Result<(), MechanicsError> {
        self.tension_kpa.fill(0.0);
        let (damping_s, rate_per_s) = (tissue.properties().damping_stiffness_s, scheme.damping_factor());
        let share = damping_s * rate_per_s;
        self.stiffening = 1.0 + share;
        if share == 0.0 {
            self.rest_stretch.fill(Matrix3::identity());
            return Ok(());
        }
        let past = |(element, corners): (&Element, &[usize; 4])| {
            let ends = corners.map(|corner| scheme.extrapolated(state, corner));
            element.past_stretch(ends.map(|end| end.0), ends.map(|end| end.1), rate_per_s)
        };
        tissue.elements().par_iter().zip(tissue.tetrahedra()).map(past).collect_into_vec(&mut self.stretches);
        for (tetrahedron, (rest, past)) in self.rest_stretch.iter_mut().zip(&self.stretches).enumerate() {
            let past = past.ok_or(MechanicsError::InvertedElement { tetrahedron })?;
            *rest = (Matrix3::identity() + past * share) / self.stiffening;
        }
        Ok(())
    }

    /// Sets the tension σC, kPa a tetrahedron.
    pub(super) fn set_tension(&mut self, tension_kpa: &[f64]) {
        self.tension_kpa.copy_from_slice(tension_kpa);
    }

    /// Internal forces at trial positions; the matrix stays. An error leaves the forces undefined.
    pub(super) fn update_force(&mut self, tissue: &Myocardium, trial_mm: &[Vector3<f64>]) -> Result<(), MechanicsError> {
        let mut forces = std::mem::take(&mut self.forces);
        self.start_at(trial_mm);
        let result = self.chunks(tissue, &mut forces, Element::force, |this, corners, force| this.add_force(corners, force));
        self.forces = forces;
        result
    }

    /// Internal forces and their tangent at trial positions.
    pub(super) fn linearise(
        &mut self,
        tissue: &Myocardium,
        constants: &CorotationalConstants,
        trial_mm: &[Vector3<f64>],
        linearisation: Linearisation,
    ) -> Result<(), MechanicsError> {
        let mut tangents = std::mem::take(&mut self.tangents);
        self.start_at(trial_mm);
        self.matrix.clear();
        self.mean_stiffnesses.clear();
        let mut places = constants.places.iter();
        let of = match linearisation {
            Linearisation::Exact => Element::tangent,
            Linearisation::Convex => Element::convex_tangent,
        };
        let result = self.chunks(tissue, &mut tangents, of, |this, corners, tangent| {
            this.add_force(corners, &tangent.force);
            for (place, block) in places.next().into_iter().flatten().zip(tangent.blocks_mn_per_mm().as_flattened()) {
                this.matrix.add_block_at(*place as usize, block);
            }
        });
        constants.diagonal_mn_per_mm.iter().enumerate().for_each(|(vertex, block)| self.matrix.add_to_diagonal(vertex, block));
        self.tangents = tangents;
        self.is_linearised = result.is_ok();
        self.is_convex = linearisation == Linearisation::Convex;
        result
    }

    fn start_at(&mut self, trial_mm: &[Vector3<f64>]) {
        self.trial_mm.copy_from_slice(trial_mm);
        self.force_mn.fill(Vector3::zeros());
        self.energy_mn_mm = 0.0;
    }

    /// Computes something of every tetrahedron in parallel, chunk after chunk, and adds it in order.
    fn chunks<T: Send + Clone>(
        &mut self,
        tissue: &Myocardium,
        buffer: &mut Vec<Option<T>>,
        of: fn(&Element, PointLaw<'_>, [Vector3<f64>; 4]) -> Option<T>,
        mut add: impl FnMut(&mut Self, &[usize; 4], &T),
    ) -> Result<(), MechanicsError> {
        buffer.resize(CHUNK.min(tissue.elements().len()), None);
        for (elements, first) in tissue.elements().chunks(CHUNK).zip((0..).step_by(CHUNK)) {
            let corners = &tissue.tetrahedra()[first..first + elements.len()];
            let this = &*self;
            buffer.par_iter_mut().zip(elements).enumerate().with_min_len(64).for_each(|(index, (item, element))| {
                let law = PointLaw {
                    material: tissue.material(first + index),
                    stiffening: this.stiffening,
                    rest_stretch: &this.rest_stretch[first + index],
                    tension_kpa: this.tension_kpa[first + index],
                    volume_stiffness_kpa: tissue.properties().volume_stiffness_kpa,
                };
                *item = of(element, law, corners[index].map(|corner| this.trial_mm[corner]));
            });
            for (index, (corners, item)) in corners.iter().zip(buffer.iter()).enumerate() {
                let item = item.as_ref().ok_or(MechanicsError::InvertedElement { tetrahedron: first + index })?;
                add(self, corners, item);
            }
        }
        Ok(())
    }

    pub(super) fn is_linearised(&self) -> bool {
        self.is_linearised
    }

    pub(super) fn is_convex(&self) -> bool {
        self.is_convex
    }

    pub(super) fn trial_mm(&self) -> &[Vector3<f64>] {
        &self.trial_mm
    }

    pub(super) fn force_mn(&self) -> &[Vector3<f64>] {
        &self.force_mn
    }

    pub(super) fn energy_mn_mm(&self) -> f64 {
        self.energy_mn_mm
    }

    pub(super) fn matrix(&self) -> &BlockMatrix {
        &self.matrix
    }

    pub(super) fn mean_stiffnesses(&self) -> &[MeanStiffness] {
        &self.mean_stiffnesses
    }

    /// Adds to K̃ a stiffness between two vertices (mN/mm) of a force that changes with the motion, as a pressure's does; after
    /// [`StepOperator::linearise`](super::StepOperator::linearise), which starts afresh. Between vertices that no tetrahedron joins
    /// nothing is added.
    pub fn add_stiffness(&mut self, row: usize, column: usize, block: &Matrix3<f64>) {
        let _is_stored = self.matrix.add_block(row, column, block);
    }

    /// Adds to K̃ the stiffness of forces on `vertices` that change with the mean of these vertices, one block (mN/mm) each, and its
    /// transpose; as [`Tangent::add_stiffness`].
    pub fn add_mean_stiffness(&mut self, vertices: &[usize], blocks_mn_per_mm: &[Matrix3<f64>]) {
        self.mean_stiffnesses.push(MeanStiffness { rows: vertices.iter().copied().zip(blocks_mn_per_mm.iter().copied()).collect() });
    }

    fn add_force(&mut self, &[a, b, c, d]: &[usize; 4], element: &ElementForce) {
        self.energy_mn_mm += element.energy_mn_mm;
        for (corner, force) in [b, c, d].into_iter().zip(&element.corners_mn) {
            self.force_mn[corner] += force;
            self.force_mn[a] -= force;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanics::{PassiveProperties, TimeScheme};
    use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};
    use crate::numerics::TaylorTest;
    use nalgebra::{DVector, Rotation3};

    /// A cube of 4 mm cut around its centre, without springs; fibres differ from element to element.
    fn cube() -> Myocardium {
        let corner = |code: usize| Vector3::new((code & 1) as f64, (code >> 1 & 1) as f64, (code >> 2) as f64) * 4.0;
        let mut vertices: Vec<Vector3<f64>> = (0..8).map(corner).collect();
        vertices.push(Vector3::new(2.2, 1.9, 2.1));
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let tetrahedra = faces.iter().flat_map(|&[a, b, c, d]| [[a, c, b, 8], [a, d, c, 8]]).collect();
        let mesh = TetMesh::new(vertices, tetrahedra).unwrap();
        let surface = TaggedSurface::new(&mesh, vec![SurfaceTag::Epicardium; mesh.boundary_triangles().len()]).unwrap();
        let axes: Vec<_> = (0..12).map(|t| *Rotation3::from_euler_angles(f64::from(t), 0.4, -0.9).matrix()).collect();
        let properties = PassiveProperties {
            fibre_stiffness_kpa: 30.0,
            transverse_stiffness_kpa: 12.0,
            poisson_ratio: 0.4,
            volume_stiffness_kpa: 50.0,
            density_kg_per_mm3: 1e-6,
            damping_mass_per_s: 0.0,
            damping_stiffness_s: 0.01,
            base_stiffness_normal_kpa_per_mm: 0.0,
            base_stiffness_isotropic_kpa_per_mm: 0.0,
            pericardium_stiffness_kpa_per_mm: 0.0,
            pericardium_damping_kpa_s_per_mm: 0.0,
            pericardium_base_share: 1.0,
            valve_ring_height_mm: 0.0,
            valve_ring_stiffness_kpa: 0.0,
        };
        Myocardium::new(&mesh, &surface, &axes, &properties).unwrap()
    }

    fn constants(tissue: &Myocardium) -> CorotationalConstants {
        CorotationalConstants::new(tissue, vec![Matrix3::zeros(); tissue.vertex_count()])
    }

    fn bend(x: &Vector3<f64>) -> Vector3<f64> {
        let turn = Rotation3::from_euler_angles(0.8, -1.3, 0.4);
        turn * (x + Vector3::new((0.9 * x.y).sin(), 0.1 * x.z * x.x, (x.x + x.y).cos()) * 0.3) + Vector3::new(5.0, -3.0, 1.0)
    }

    fn flat(field: &[Vector3<f64>]) -> DVector<f64> {
        DVector::from_iterator(3 * field.len(), field.iter().flat_map(|v| v.iter().copied()))
    }

    fn field(flat: &DVector<f64>) -> Vec<Vector3<f64>> {
        flat.as_slice().chunks(3).map(Vector3::from_column_slice).collect()
    }

    #[test]
    fn internal_forces_are_the_gradient_of_the_energy_and_their_tangent_the_gradient_of_the_forces() {
        let tissue = cube();
        let position: Vec<_> = tissue.rest_mm().iter().map(bend).collect();
        let mut tangent = Tangent::new(&tissue);
        let tension: Vec<f64> = (0..12).map(|t| 20.0 + f64::from(t)).collect();
        tangent.set_tension(&tension);
        tangent.linearise(&tissue, &constants(&tissue), &position, Linearisation::Exact).unwrap();
        let energy = |x: &DVector<f64>| tissue.corotational_energy_mn_mm(&field(x), &tension).map(|e| DVector::from_element(1, e));
        let force = |x: &DVector<f64>| {
            let mut there = tangent.clone();
            there.update_force(&tissue, &field(x)).map(|()| flat(there.force_mn()))
        };
        let base = flat(&position);
        assert_eq!(force(&base).unwrap(), flat(tangent.force_mn()));
        for seed in 0..4 {
            let direction = DVector::from_fn(base.len(), |i, _| (1.7 * i as f64 + 2.3 * f64::from(seed)).sin());
            let slope = DVector::from_element(1, flat(tangent.force_mn()).dot(&direction));
            let mut product = field(&direction);
            tangent.matrix().multiply(&field(&direction), &mut product);
            let orders = [
                TaylorTest::run(energy, &base, &direction, &slope, 0.02, 6).unwrap().order(),
                TaylorTest::run(force, &base, &direction, &flat(&product), 0.01, 6).unwrap().order(),
            ];
            assert!(orders.iter().all(|order| (order - 2.0).abs() < 0.2), "{orders:?}");
        }
    }

    /// A step of a spinning body begins with no stretch to damp, in either scheme; βK at rest would brake it.
    #[test]
    fn damping_of_the_stretch_leaves_a_rigid_rotation_alone() {
        let tissue = cube();
        let spin = Vector3::new(2.0, -7.0, 4.0);
        let mut state = MotionState::at_rest(tissue.rest_mm().iter().map(|x| Rotation3::new(Vector3::new(0.4, 2.0, 1.0)) * x).collect());
        for (vertex, y) in state.position_mm.iter().enumerate() {
            state.velocity_mm_per_s[vertex] = spin.cross(y);
            state.acceleration_mm_per_s2[vertex] = spin.cross(&spin.cross(y));
        }
        state.algorithmic_acceleration_mm_per_s2.clone_from(&state.acceleration_mm_per_s2);
        let step_s = 0.005;
        for (scheme, largest) in [(TimeScheme::BackwardEuler, 1e-10), (TimeScheme::GeneralisedAlpha { spectral_radius: 0.5 }, 0.2)] {
            let mut tangent = Tangent::new(&tissue);
            tangent.begin(&tissue, &state, &scheme.coefficients(step_s).unwrap()).unwrap();
            let end: Vec<_> = state.position_mm.iter().map(|y| Rotation3::new(spin * step_s) * y).collect();
            tangent.update_force(&tissue, &end).unwrap();
            let strongest = tangent.force_mn().iter().map(Vector3::norm).fold(0.0, f64::max);
            let mut braked = state.velocity_mm_per_s.clone();
            tissue.stiffness().multiply(&state.velocity_mm_per_s, &mut braked);
            let braking = 0.01 * braked.iter().map(Vector3::norm).fold(0.0, f64::max);
            assert!(strongest < largest && braking > 3.0, "{strongest} mN, {braking} mN with βK at rest");
            let torque: Vector3<f64> = tangent.force_mn().iter().zip(&end).map(|(f, y)| y.cross(f)).sum();
            assert!(torque.norm() < 1e-10, "{torque} mN·mm");
        }
    }

    #[test]
    fn an_inverted_element_is_named() {
        let tissue = cube();
        let mut position = tissue.rest_mm().to_vec();
        position[8].x = 9.0;
        let error = Tangent::new(&tissue).update_force(&tissue, &position).unwrap_err();
        assert!(matches!(error, MechanicsError::InvertedElement { .. }), "{error}");
    }
}
