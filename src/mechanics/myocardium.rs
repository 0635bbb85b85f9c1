//! The passive and active mechanics of one mesh at rest: $M\ddot Y + C\dot Y + K(Y - x) = F$, \[Billet2009\] §2.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::base_distance::BaseDistance;
use super::corotational::PointLaw;
use super::element::Element;
use super::springs::SurfaceSprings;
use super::{MechanicsError, PassiveProperties, TransverseIsotropy};
use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};
use crate::numerics::{BlockMatrix, BlockPattern, CholeskyStructure};

/// How far fibre axes may be from orthonormal.
const AXES_TOLERANCE: f64 = 1e-6;

/// Everything of the tissue that is constant while it moves.
///
/// | symbol | here |
/// |---|---|
/// | K | [`stiffness`](Self::stiffness), linear elasticity of the tissue |
/// | M | [`vertex_mass_kg`](Self::vertex_mass_kg), lumped: a quarter of each tetrahedron to its corners |
/// | C | α M + β K and the pericardial dashpots |
/// | Robin terms | base springs towards their anchors, pericardial springs towards the rest position |
/// | F_C | [`add_contraction_force`](Self::add_contraction_force) |
#[derive(Debug, Clone)]
pub struct Myocardium {
    properties: PassiveProperties,
    rest_mm: Vec<Vector3<f64>>,
    tetrahedra: Vec<[usize; 4]>,
    /// −V f (f·∇N_a), mm²: the force at corner a of a unit fibre tension.
    contraction_mm2: Vec<[Vector3<f64>; 4]>,
    /// w a tetrahedron: 1 in muscle, 0 in the fibrous ring of the valves.
    muscle_shares: Vec<f64>,
    materials: Vec<TransverseIsotropy>,
    elements: Vec<Element>,
    structure: Arc<CholeskyStructure>,
    stiffness: BlockMatrix,
    vertex_mass_kg: Vec<f64>,
    base: SurfaceSprings,
    pericardium_springs: SurfaceSprings,
    pericardium_dashpots: SurfaceSprings,
}

impl Myocardium {
    /// Assembles a mesh at rest. `fibre_axes` has one orthonormal matrix a tetrahedron, its first column along the fibre.
    ///
    /// # Errors
    /// [`MechanicsError::Property`] or [`MechanicsError::Indefinite`] for properties that make no tissue,
    /// [`MechanicsError::FieldSize`] or [`MechanicsError::FibreAxes`] for fibre axes that do not fit the mesh.
    pub fn new(
        mesh: &TetMesh,
        surface: &TaggedSurface,
        fibre_axes: &[Matrix3<f64>],
        properties: &PassiveProperties,
    ) -> Result<Self, MechanicsError> {
        let pattern = Arc::new(BlockPattern::from_neighbours(&mesh.vertex_neighbours()));
        let structure = Arc::new(CholeskyStructure::new(pattern)?);
        Self::with_structure(structure, mesh, surface, fibre_axes, properties)
    }

    /// The same tissue with other properties; the ordering of the unknowns is kept.
    ///
    /// # Errors
    /// As [`Myocardium::new`].
    pub fn with_properties(
        &self,
        mesh: &TetMesh,
        surface: &TaggedSurface,
        fibre_axes: &[Matrix3<f64>],
        properties: &PassiveProperties,
    ) -> Result<Self, MechanicsError> {
        if mesh.tetrahedra() != self.tetrahedra {
            let (expected, found) = (self.tetrahedra.len(), mesh.tetrahedron_count());
            return Err(MechanicsError::FieldSize { field: "tetrahedra of the mesh this myocardium was made of", expected, found });
        }
        Self::with_structure(Arc::clone(&self.structure), mesh, surface, fibre_axes, properties)
    }

    fn with_structure(
        structure: Arc<CholeskyStructure>,
        mesh: &TetMesh,
        surface: &TaggedSurface,
        fibre_axes: &[Matrix3<f64>],
        properties: &PassiveProperties,
    ) -> Result<Self, MechanicsError> {
        properties.check()?;
        let (e_f, e_t) = (properties.fibre_stiffness_kpa, properties.transverse_stiffness_kpa);
        let muscle = TransverseIsotropy::new(e_f, e_t, properties.poisson_ratio)?;
        check_axes(mesh, fibre_axes)?;
        let from_base = if properties.depend_on_base_distance() { BaseDistance::new(mesh, surface) } else { None };
        let muscle_shares = match &from_base {
            Some(distance) => distance.muscle_shares(mesh.tetrahedra(), properties.valve_ring_height_mm),
            None => vec![1.0; mesh.tetrahedron_count()],
        };
        let materials = with_valve_ring(&muscle, properties, &muscle_shares)?;
        let mut stiffness = BlockMatrix::zeros(Arc::clone(structure.pattern()));
        let mut vertex_mass_kg = vec![0.0; mesh.vertex_count()];
        let mut contraction_mm2 = Vec::with_capacity(mesh.tetrahedron_count());
        let mut elements = Vec::with_capacity(mesh.tetrahedron_count());
        for (tetrahedron, (corners, axes)) in mesh.tetrahedra().iter().zip(fibre_axes).enumerate() {
            let volume_mm3 = mesh.volume_mm3(tetrahedron);
            let gradients = shape_gradients(&mesh.corners_mm(tetrahedron));
            add_element_stiffness(
                &mut stiffness,
                corners,
                &gradients,
                axes,
                volume_mm3,
                &materials[tetrahedron],
                properties.volume_stiffness_kpa,
            )?;
            elements.push(Element::new(&gradients, axes, volume_mm3));
            let fibre = axes.column(0).into_owned();
            contraction_mm2.push(gradients.map(|gradient| fibre * (-volume_mm3 * fibre.dot(&gradient))));
            for &vertex in corners {
                vertex_mass_kg[vertex] += properties.density_kg_per_mm3 * volume_mm3 / 4.0;
            }
        }
        let rest_mm = mesh.vertices_mm().to_vec();
        let springs = |tag, normal, isotropic| SurfaceSprings::new(surface, tag, &rest_mm, normal, isotropic);
        let mut pericardium_springs = springs(SurfaceTag::Epicardium, properties.pericardium_stiffness_kpa_per_mm, 0.0);
        if let Some(distance) = &from_base {
            pericardium_springs.grade(&distance.grading(properties.pericardium_base_share));
        }
        Ok(Self {
            base: springs(SurfaceTag::Base, properties.base_stiffness_normal_kpa_per_mm, properties.base_stiffness_isotropic_kpa_per_mm),
            pericardium_springs,
            pericardium_dashpots: springs(SurfaceTag::Epicardium, properties.pericardium_damping_kpa_s_per_mm, 0.0),
            properties: *properties,
            tetrahedra: mesh.tetrahedra().to_vec(),
            rest_mm,
            contraction_mm2,
            muscle_shares,
            materials,
            elements,
            structure,
            stiffness,
            vertex_mass_kg,
        })
    }

    /// The properties it was made with.
    pub fn properties(&self) -> &PassiveProperties {
        &self.properties
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.rest_mm.len()
    }

    /// Number of tetrahedra.
    pub fn tetrahedron_count(&self) -> usize {
        self.tetrahedra.len()
    }

    /// Rest positions x, mm.
    pub fn rest_mm(&self) -> &[Vector3<f64>] {
        &self.rest_mm
    }

    /// Vertices held by base springs, ascending; moving anchors are given in this order.
    pub fn base_vertices(&self) -> &[usize] {
        &self.base.vertices
    }

    /// Share of muscle a tetrahedron: 1, and less in the fibrous ring of the valves, which does not contract.
    pub fn muscle_shares(&self) -> &[f64] {
        &self.muscle_shares
    }

    /// K, the stiffness of the tissue without springs, kPa·mm (= mN/mm).
    pub fn stiffness(&self) -> &BlockMatrix {
        &self.stiffness
    }

    /// Lumped mass a vertex, kg.
    pub fn vertex_mass_kg(&self) -> &[f64] {
        &self.vertex_mass_kg
    }

    /// Ordering and shape of the factors of this tissue's matrices.
    pub fn structure(&self) -> &Arc<CholeskyStructure> {
        &self.structure
    }

    /// Adds F_C, mN, of one fibre tension σC (kPa) a tetrahedron: the force at corner a is $-V\sigma_C\, f (f\cdot\nabla N_a)$,
    /// what the stress $\sigma_C f \otimes f$ exerts on its vertices, \[Billet2009\] §2.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries.
    pub fn add_contraction_force(&self, stress_kpa: &[f64], force_mn: &mut [Vector3<f64>]) -> Result<(), MechanicsError> {
        check_size("contraction stresses, one a tetrahedron", self.tetrahedra.len(), stress_kpa.len())?;
        check_size("forces, one a vertex", self.rest_mm.len(), force_mn.len())?;
        let contracting = self.tetrahedra.iter().zip(&self.contraction_mm2).zip(stress_kpa).filter(|(_, stress)| **stress != 0.0);
        for ((corners, gradient_mm2), stress) in contracting {
            for (&vertex, unit) in corners.iter().zip(gradient_mm2) {
                force_mn[vertex] += unit * *stress;
            }
        }
        Ok(())
    }

    /// Elastic energy of the tissue and its springs with anchors at rest, mJ·10⁻³ (= mN·mm).
    pub fn elastic_energy_mn_mm(&self, position_mm: &[Vector3<f64>]) -> f64 {
        let displacement: Vec<Vector3<f64>> = position_mm.iter().zip(&self.rest_mm).map(|(y, x)| y - x).collect();
        let mut force = vec![Vector3::zeros(); displacement.len()];
        self.stiffness.multiply(&displacement, &mut force);
        for (vertex, block) in self.base.iter().chain(self.pericardium_springs.iter()) {
            force[vertex] += block * displacement[vertex];
        }
        displacement.iter().zip(&force).map(|(u, f)| u.dot(f)).sum::<f64>() / 2.0
    }

    /// Corners of the tetrahedra.
    pub(super) fn tetrahedra(&self) -> &[[usize; 4]] {
        &self.tetrahedra
    }

    /// The tetrahedra as corotational kinematics see them.
    pub(super) fn elements(&self) -> &[Element] {
        &self.elements
    }

    /// The passive material of a tetrahedron.
    pub(super) fn material(&self, tetrahedron: usize) -> &TransverseIsotropy {
        &self.materials[tetrahedron]
    }

    /// Energy of the tissue at rest of motion in corotational kinematics, mN·mm: its stretch and the tension σC (kPa a tetrahedron) of
    /// its fibres; no springs.
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] for fields of the wrong size, [`MechanicsError::InvertedElement`] for a tetrahedron that is flat or
    /// inside out.
    pub fn corotational_energy_mn_mm(&self, position_mm: &[Vector3<f64>], tension_kpa: &[f64]) -> Result<f64, MechanicsError> {
        check_size("tensions, one a tetrahedron", self.elements.len(), tension_kpa.len())?;
        check_size("positions, one a vertex", self.rest_mm.len(), position_mm.len())?;
        let rest_stretch = Matrix3::identity();
        let energy = |(tetrahedron, element): (usize, &Element)| {
            let law = PointLaw {
                material: self.material(tetrahedron),
                stiffening: 1.0,
                rest_stretch: &rest_stretch,
                tension_kpa: tension_kpa[tetrahedron],
                volume_stiffness_kpa: self.properties.volume_stiffness_kpa,
            };
            let corners_mm = self.tetrahedra[tetrahedron].map(|corner| position_mm[corner]);
            element.force(law, corners_mm).map(|force| force.energy_mn_mm).ok_or(MechanicsError::InvertedElement { tetrahedron })
        };
        self.elements.iter().enumerate().map(energy).sum()
    }

    /// Base springs.
    pub(super) fn base(&self) -> &SurfaceSprings {
        &self.base
    }

    /// Pericardial springs.
    pub(super) fn pericardium_springs(&self) -> &SurfaceSprings {
        &self.pericardium_springs
    }

    /// Pericardial dashpots.
    pub(super) fn pericardium_dashpots(&self) -> &SurfaceSprings {
        &self.pericardium_dashpots
    }
}

pub(super) fn check_size(field: &'static str, expected: usize, found: usize) -> Result<(), MechanicsError> {
    if expected == found { Ok(()) } else { Err(MechanicsError::FieldSize { field, expected, found }) }
}

fn check_axes(mesh: &TetMesh, fibre_axes: &[Matrix3<f64>]) -> Result<(), MechanicsError> {
    check_size("fibre axes, one a tetrahedron", mesh.tetrahedron_count(), fibre_axes.len())?;
    for (tetrahedron, axes) in fibre_axes.iter().enumerate() {
        let defect = (axes.transpose() * axes - Matrix3::identity()).norm();
        if defect.is_nan() || defect > AXES_TOLERANCE {
            return Err(MechanicsError::FibreAxes { tetrahedron, defect });
        }
    }
    Ok(())
}

/// ∇N_a of the four corners, 1/mm: the rows of the inverse of the edge matrix, and minus their sum for the first corner.
fn shape_gradients(corners: &[Vector3<f64>; 4]) -> [Vector3<f64>; 4] {
    let [a, b, c, d] = corners;
    let (u, v, w) = (b - a, c - a, d - a);
    let determinant = u.cross(&v).dot(&w);
    let (gb, gc, gd) = (v.cross(&w) / determinant, w.cross(&u) / determinant, u.cross(&v) / determinant);
    [-(gb + gc + gd), gb, gc, gd]
}

/// The material of every tetrahedron: muscle everywhere, and beside it what it lacks of muscle in the ring's stiffness.
fn with_valve_ring(
    muscle: &TransverseIsotropy,
    properties: &PassiveProperties,
    muscle_shares: &[f64],
) -> Result<Vec<TransverseIsotropy>, MechanicsError> {
    let stiffness_kpa = properties.valve_ring_stiffness_kpa;
    if stiffness_kpa == 0.0 {
        return Ok(vec![*muscle; muscle_shares.len()]);
    }
    let ring = TransverseIsotropy::new(stiffness_kpa, stiffness_kpa, properties.poisson_ratio)?;
    Ok(muscle_shares.iter().map(|share| muscle.with_share(1.0 - share, &ring)).collect())
}

fn add_element_stiffness(
    stiffness: &mut BlockMatrix,
    corners: &[usize; 4],
    gradients: &[Vector3<f64>; 4],
    axes: &Matrix3<f64>,
    volume_mm3: f64,
    material: &TransverseIsotropy,
    volume_stiffness_kpa: f64,
) -> Result<(), MechanicsError> {
    let local = gradients.map(|gradient| axes.transpose() * gradient);
    for (a, &row) in corners.iter().enumerate() {
        for (b, &column) in corners.iter().enumerate() {
            let of_volume = local[a] * local[b].transpose() * volume_stiffness_kpa;
            let block = axes * ((material.stiffness_block(&local[a], &local[b]) + of_volume) * volume_mm3) * axes.transpose();
            if !stiffness.add_block(row, column, &block) {
                return Err(MechanicsError::FieldSize { field: "neighbours in the matrix pattern", expected: 4, found: b });
            }
        }
    }
    Ok(())
}
