//! How the balance of forces changes with a property of the tissue or of what holds it.
//!
//! At the end of a step $M\ddot y + C\dot y + K(y - x) + S(y - a) = F$. Where the properties change, so do the matrices, and what the
//! motion as it is then lacks is the force
//!
//! $$-\big(dM\,\ddot y + dC\,\dot y + dK\,(y - x) + dS\,(y - a)\big), \qquad C = \alpha M + \beta K + D.$$

use nalgebra::{Matrix3, Vector3};

use super::myocardium::check_size;
use super::springs::SurfaceSprings;
use super::{MechanicsError, MotionState, Myocardium};
use crate::numerics::BlockMatrix;

/// dM, dC, dK and dS a unit of something that the properties depend on.
#[derive(Debug, Clone)]
pub struct PassiveRate {
    /// dK, mN/mm; None where it is zero.
    stiffness: Option<BlockMatrix>,
    damping_stiffness_s: f64,
    /// dM a vertex, kg; None where it is zero.
    mass_kg: Option<Vec<f64>>,
    damping_mass_per_s: f64,
    base: Option<SurfaceSprings>,
    pericardium_springs: Option<SurfaceSprings>,
    pericardium_dashpots: Option<SurfaceSprings>,
}

impl PassiveRate {
    /// The difference quotient of two tissues of one mesh, `width` apart in what their properties depend on. The matrices are
    /// polynomials or quotients of polynomials of the properties: a central difference of relative width w is exact to about w².
    pub fn between(lower: &Myocardium, upper: &Myocardium, width: f64) -> Self {
        let scale = width.recip();
        let mass_kg: Vec<f64> = upper.vertex_mass_kg().iter().zip(lower.vertex_mass_kg()).map(|(u, l)| (u - l) * scale).collect();
        let differ = |a: &BlockMatrix, b: &BlockMatrix| a.blocks() != b.blocks();
        let stiffness = differ(upper.stiffness(), lower.stiffness()).then(|| {
            let mut rate = BlockMatrix::zeros(std::sync::Arc::clone(upper.stiffness().pattern()));
            rate.add_scaled(scale, upper.stiffness());
            rate.add_scaled(-scale, lower.stiffness());
            rate
        });
        Self {
            stiffness,
            damping_stiffness_s: (upper.properties().damping_stiffness_s - lower.properties().damping_stiffness_s) * scale,
            mass_kg: mass_kg.iter().any(|mass| *mass != 0.0).then_some(mass_kg),
            damping_mass_per_s: (upper.properties().damping_mass_per_s - lower.properties().damping_mass_per_s) * scale,
            base: spring_rate(lower.base(), upper.base(), scale),
            pericardium_springs: spring_rate(lower.pericardium_springs(), upper.pericardium_springs(), scale),
            pericardium_dashpots: spring_rate(lower.pericardium_dashpots(), upper.pericardium_dashpots(), scale),
        }
    }

    /// Adds the force that the motion at a step's end lacks in linear kinematics, mN. `base_anchor_mm` as in
    /// [`StepOperator::assemble`](super::StepOperator::assemble).
    ///
    /// # Errors
    /// [`MechanicsError::FieldSize`] if a field has the wrong number of entries.
    pub fn add_force(
        &self,
        tissue: &Myocardium,
        end: &MotionState,
        base_anchor_mm: Option<&[Vector3<f64>]>,
        force_mn: &mut [Vector3<f64>],
    ) -> Result<(), MechanicsError> {
        check_size("positions, one a vertex", tissue.vertex_count(), end.position_mm.len())?;
        check_size("forces, one a vertex", tissue.vertex_count(), force_mn.len())?;
        let velocity = &end.velocity_mm_per_s;
        if let Some(stiffness) = &self.stiffness {
            let beta_s = tissue.properties().damping_stiffness_s;
            let strained = end.position_mm.iter().zip(tissue.rest_mm()).zip(velocity);
            let strained: Vec<Vector3<f64>> = strained.map(|((y, x), v)| y - x + v * beta_s).collect();
            stiffness.multiply_add(-1.0, &strained, force_mn);
        }
        if self.damping_stiffness_s != 0.0 {
            tissue.stiffness().multiply_add(-self.damping_stiffness_s, velocity, force_mn);
        }
        self.add_outer_force(tissue, end, base_anchor_mm, force_mn)
    }

    /// The part of [`PassiveRate::add_force`] of mass, damping of the mass, springs and dashpots: all of it but the internal forces, in
    /// either kinematics.
    ///
    /// # Errors
    /// As [`PassiveRate::add_force`].
    pub fn add_outer_force(
        &self,
        tissue: &Myocardium,
        end: &MotionState,
        base_anchor_mm: Option<&[Vector3<f64>]>,
        force_mn: &mut [Vector3<f64>],
    ) -> Result<(), MechanicsError> {
        let velocity = &end.velocity_mm_per_s;
        if let Some(mass_kg) = &self.mass_kg {
            let alpha_per_s = tissue.properties().damping_mass_per_s;
            for (((force, mass), a), v) in force_mn.iter_mut().zip(mass_kg).zip(&end.acceleration_mm_per_s2).zip(velocity) {
                *force -= (a + v * alpha_per_s) * *mass;
            }
        }
        if self.damping_mass_per_s != 0.0 {
            for ((force, mass), v) in force_mn.iter_mut().zip(tissue.vertex_mass_kg()).zip(velocity) {
                *force -= v * (self.damping_mass_per_s * mass);
            }
        }
        if let Some(base) = &self.base {
            if let Some(anchor_mm) = base_anchor_mm {
                check_size("base anchors, one a base vertex", base.vertices.len(), anchor_mm.len())?;
            }
            for (index, (vertex, block)) in base.iter().enumerate() {
                let anchor = base_anchor_mm.map_or(tissue.rest_mm()[vertex], |anchor_mm| anchor_mm[index]);
                force_mn[vertex] -= block * (end.position_mm[vertex] - anchor);
            }
        }
        for (vertex, block) in self.pericardium_springs.iter().flat_map(SurfaceSprings::iter) {
            force_mn[vertex] -= block * (end.position_mm[vertex] - tissue.rest_mm()[vertex]);
        }
        for (vertex, block) in self.pericardium_dashpots.iter().flat_map(SurfaceSprings::iter) {
            force_mn[vertex] -= block * velocity[vertex];
        }
        Ok(())
    }
}

fn spring_rate(lower: &SurfaceSprings, upper: &SurfaceSprings, scale: f64) -> Option<SurfaceSprings> {
    let blocks: Vec<Matrix3<f64>> = upper.blocks.iter().zip(&lower.blocks).map(|(u, l)| (u - l) * scale).collect();
    blocks.iter().any(|block| *block != Matrix3::zeros()).then(|| SurfaceSprings { vertices: upper.vertices.clone(), blocks })
}
