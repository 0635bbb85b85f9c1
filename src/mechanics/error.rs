//! What can be wrong with the mechanics of a heart.

use crate::numerics::LinearSolveError;

/// A material, a mesh or a step that cannot be computed with, with the place and the amount.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum MechanicsError {
    /// A property is not a number or out of its range.
    #[error("{property} = {value} is not allowed: it must be {requirement}")]
    Property { property: &'static str, value: f64, requirement: &'static str },
    /// The engineering constants do not make a positive definite stiffness.
    #[error(
        "the elastic constants are not positive definite: 1 − ν − 2ν²E_t/E_f = {determinant:.4} must exceed 0 \
         (E_f {fibre_stiffness_kpa} kPa, E_t {transverse_stiffness_kpa} kPa, ν {poisson_ratio}); lower ν or E_t/E_f"
    )]
    Indefinite { determinant: f64, fibre_stiffness_kpa: f64, transverse_stiffness_kpa: f64, poisson_ratio: f64 },
    /// A field has the wrong number of entries.
    #[error("{field}: {found} entries where {expected} are needed")]
    FieldSize { field: &'static str, expected: usize, found: usize },
    /// The fibre axes of a tetrahedron are not orthonormal.
    #[error("the fibre axes of tetrahedron {tetrahedron} are not orthonormal (defect {defect:.2e}); normalise them")]
    FibreAxes { tetrahedron: usize, defect: f64 },
    /// A tetrahedron is flat or inside out, so its rotation is not defined.
    #[error("tetrahedron {tetrahedron} is flat or inside out in the deformed mesh; shorten the step, or stiffen the tissue")]
    InvertedElement { tetrahedron: usize },
    /// A system of the wrong kinematics, or one that was not linearised, is solved.
    #[error(
        "the step system is not linearised: corotational kinematics need trial positions before they are solved, and a system of their own"
    )]
    NotLinearised,
    /// A tangent is not positive definite.
    #[error("the tangent of the step is not positive definite; shorten the step, or stiffen the tissue")]
    NotConvex,
    /// The linear system of a step could not be solved.
    #[error("the step system could not be solved: {0}")]
    Solve(#[from] LinearSolveError),
}
