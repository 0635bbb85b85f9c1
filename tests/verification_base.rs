//! What depends on the distance to the base, the fibrous ring of the valves and the graded pericardium, against closed forms.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use cardiotwin::mechanics::{
    Kinematics, Linearisation, MechanicsError, MotionState, Myocardium, PassiveProperties, StepOperator, StepSettings, StepSolver,
    TimeScheme,
};
use cardiotwin::mesh::{SurfaceTag, TaggedSurface};
use nalgebra::{DMatrix, Matrix3, Vector3};

mod meshes;

const LENGTH_MM: f64 = 40.0;
const HEIGHT_MM: f64 = 15.0;
const MUSCLE_KPA: f64 = 20.0;
const RING_KPA: f64 = 200.0;

/// A bar along x with its base at x = 0 and fibres along it.
fn bar(refinement: usize, properties: &PassiveProperties) -> (Vec<Vector3<f64>>, Arc<Myocardium>) {
    let (mesh, surface) = meshes::block(Vector3::new(LENGTH_MM, 4.0, 4.0), [8 * refinement, refinement, refinement]);
    let axes = vec![Matrix3::identity(); mesh.tetrahedron_count()];
    (mesh.vertices_mm().to_vec(), Arc::new(Myocardium::new(&mesh, &surface, &axes, properties).unwrap()))
}

fn ringed() -> PassiveProperties {
    PassiveProperties { valve_ring_height_mm: HEIGHT_MM, valve_ring_stiffness_kpa: RING_KPA, ..meshes::bare(MUSCLE_KPA, 0.0) }
}

/// w at a distance from the base, mm.
fn muscle_share(distance_mm: f64) -> f64 {
    let s = (distance_mm / HEIGHT_MM).min(1.0);
    s * s * (3.0 - 2.0 * s)
}

#[test]
fn a_tetrahedron_is_muscle_by_the_distance_of_its_corners_to_the_base() {
    let (vertices_mm, tissue) = bar(2, &ringed());
    let (mesh, _) = meshes::block(Vector3::new(LENGTH_MM, 4.0, 4.0), [16, 2, 2]);
    for (corners, share) in mesh.tetrahedra().iter().zip(tissue.muscle_shares()) {
        let expected = corners.iter().map(|&vertex| muscle_share(vertices_mm[vertex].x)).sum::<f64>() / 4.0;
        assert!((share - expected).abs() < 1e-12, "{share} {expected}");
    }
    let all_muscle = |tissue: &Myocardium| tissue.muscle_shares().iter().all(|&share| share == 1.0);
    assert!(!all_muscle(&tissue) && all_muscle(&bar(2, &PassiveProperties { valve_ring_height_mm: 0.0, ..ringed() }).1));
}

/// Where nothing is tagged as base there is nothing that a ring could be around.
#[test]
fn a_mesh_without_a_base_has_no_ring() {
    let (mesh, surface) = meshes::block(Vector3::new(LENGTH_MM, 4.0, 4.0), [8, 1, 1]);
    let closed = TaggedSurface::new(&mesh, vec![SurfaceTag::Epicardium; surface.triangles().len()]).unwrap();
    let axes = vec![Matrix3::identity(); mesh.tetrahedron_count()];
    let [plain, ringed] = [meshes::bare(MUSCLE_KPA, 0.0), ringed()].map(|p| Myocardium::new(&mesh, &closed, &axes, &p).unwrap());
    assert!(plain.stiffness() == ringed.stiffness() && plain.muscle_shares() == ringed.muscle_shares());
}

/// λ g_a g_bᵀ + μ (g_b g_aᵀ + g_a·g_b I) a unit volume, written out for the ring alone.
#[test]
fn the_stiffness_is_the_muscles_and_what_is_ring_of_an_isotropic_one() {
    let (poisson_ratio, size_mm) = (0.3, Vector3::new(LENGTH_MM, 4.0, 4.0));
    let (mesh, surface) = meshes::block(size_mm, [8, 1, 1]);
    let axes = vec![Matrix3::identity(); mesh.tetrahedron_count()];
    let properties = PassiveProperties { transverse_stiffness_kpa: 8.0, ..meshes::bare(MUSCLE_KPA, poisson_ratio) };
    let with_ring = PassiveProperties { valve_ring_height_mm: HEIGHT_MM, valve_ring_stiffness_kpa: RING_KPA, ..properties };
    let [plain, ringed] = [properties, with_ring].map(|p| Myocardium::new(&mesh, &surface, &axes, &p).unwrap());
    let count = 3 * mesh.vertex_count();
    let mut expected = DMatrix::<f64>::zeros(count, count);
    let (lambda, mu) =
        (RING_KPA * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio)), RING_KPA / (2.0 * (1.0 + poisson_ratio)));
    for (t, corners) in mesh.tetrahedra().iter().enumerate() {
        let gradients = mesh.shape_gradients_per_mm(t);
        let weight = mesh.volume_mm3(t) * (1.0 - ringed.muscle_shares()[t]);
        for (&a, ga) in corners.iter().zip(&gradients) {
            for (&b, gb) in corners.iter().zip(&gradients) {
                let block = ga * gb.transpose() * lambda + (gb * ga.transpose() + Matrix3::identity() * ga.dot(gb)) * mu;
                let mut place = expected.fixed_view_mut::<3, 3>(3 * a, 3 * b);
                place += block * weight;
            }
        }
    }
    let mut unit = vec![Vector3::zeros(); mesh.vertex_count()];
    let (mut with, mut without) = (unit.clone(), unit.clone());
    for column in 0..count {
        unit.fill(Vector3::zeros());
        unit[column / 3][column % 3] = 1.0;
        ringed.stiffness().multiply(&unit, &mut with);
        plain.stiffness().multiply(&unit, &mut without);
        for (row, (w, p)) in with.iter().zip(&without).enumerate() {
            let found = w - p;
            let error = (0..3).map(|axis| (found[axis] - expected[(3 * row + axis, column)]).abs()).fold(0.0, f64::max);
            assert!(error < 1e-9 * expected.amax(), "{error} mN/mm at {row}, {column}");
        }
    }
}

/// Muscle and ring in series bear the same force, none: ε = −σ w / (E + (1 − w) E_ring) in linear kinematics, and in corotational ones,
/// where the fibre's nominal tension falls with its stretch, λ = 1/(1 + σ w / (E + (1 − w) E_ring)). The bar shortens by the integral.
#[test]
fn a_bar_that_contracts_beside_its_ring_shortens_as_the_closed_form() {
    let stress_kpa = 8.0;
    let strain = |x: f64, kinematics| {
        let share = muscle_share(x);
        let ratio = stress_kpa * share / (MUSCLE_KPA + (1.0 - share) * RING_KPA);
        if kinematics == Kinematics::Linear { -ratio } else { 1.0 / (1.0 + ratio) - 1.0 }
    };
    for kinematics in [Kinematics::Linear, Kinematics::Corotational] {
        let points = 10_000;
        let width_mm = LENGTH_MM / f64::from(points);
        let exact_mm: f64 = (0..points).map(|i| strain((f64::from(i) + 0.5) * width_mm, kinematics) * width_mm).sum();
        let [coarse, fine] = [2, 4].map(|refinement| shortening_mm(refinement, stress_kpa, kinematics) - exact_mm);
        assert!(fine.abs() < 0.005 * exact_mm.abs() && fine.abs() < 0.4 * coarse.abs(), "{coarse} {fine} mm off {exact_mm} mm");
    }
}

/// Mean displacement of the free end, held softly at the other.
fn shortening_mm(refinement: usize, stress_kpa: f64, kinematics: Kinematics) -> f64 {
    let held = PassiveProperties { base_stiffness_isotropic_kpa_per_mm: 1.0, ..ringed() };
    let (rest_mm, tissue) = bar(refinement, &held);
    let settings = StepSettings { step_s: 1e3, scheme: TimeScheme::BackwardEuler, kinematics };
    let operator = StepOperator::with_settings(Arc::clone(&tissue), settings).unwrap();
    let tension: Vec<f64> = tissue.muscle_shares().iter().map(|share| share * stress_kpa).collect();
    let mut system = operator.empty_system();
    operator.assemble(&MotionState::at_rest(rest_mm.clone()), None, &mut system).unwrap();
    operator.add_contraction(&tension, &mut system).unwrap();
    let mut solver = StepSolver::default();
    let mut position = rest_mm.clone();
    match kinematics {
        Kinematics::Linear => {
            solver.solve(&operator, &system, &mut position, &mut []).unwrap();
        }
        Kinematics::Corotational => {
            let mut correction = vec![rest_mm.clone()];
            for _ in 0..12 {
                operator.linearise(&position, Linearisation::Exact, &mut system).unwrap();
                operator.residual(&system, &mut correction[0]).unwrap();
                solver.correct(&operator, &system, &mut correction, 1e-10).unwrap();
                position.iter_mut().zip(&correction[0]).for_each(|(y, change)| *y += change);
            }
        }
    }
    let end: Vec<usize> = (0..rest_mm.len()).filter(|&vertex| rest_mm[vertex].x == LENGTH_MM).collect();
    let start: Vec<usize> = (0..rest_mm.len()).filter(|&vertex| rest_mm[vertex].x == 0.0).collect();
    let mean = |face: &[usize]| face.iter().map(|&vertex| (position[vertex] - rest_mm[vertex]).x).sum::<f64>() / face.len() as f64;
    mean(&end) - mean(&start)
}

/// The springs of two opposite faces, graded linearly from the base, against a shift across them: k A (1 + b)/2 each.
#[test]
fn a_graded_pericardium_holds_the_base_less() {
    let shift = Vector3::new(0.0, 0.3, 0.0);
    for at_base in [0.0, 0.25, 1.0] {
        let properties =
            PassiveProperties { pericardium_stiffness_kpa_per_mm: 0.7, pericardium_base_share: at_base, ..meshes::bare(MUSCLE_KPA, 0.3) };
        let (rest_mm, tissue) = bar(1, &properties);
        let moved: Vec<_> = rest_mm.iter().map(|x| x + shift).collect();
        let expected = 0.5 * 0.7 * 2.0 * LENGTH_MM * 4.0 * (1.0 + at_base) / 2.0 * shift.norm_squared();
        assert!((tissue.elastic_energy_mn_mm(&moved) / expected - 1.0).abs() < 1e-9);
    }
}

#[test]
fn a_share_beyond_one_and_a_height_below_zero_are_refused() {
    let (mesh, surface) = meshes::block(Vector3::new(LENGTH_MM, 4.0, 4.0), [8, 1, 1]);
    let axes = vec![Matrix3::identity(); mesh.tetrahedron_count()];
    let refused = |properties| matches!(Myocardium::new(&mesh, &surface, &axes, &properties), Err(MechanicsError::Property { .. }));
    assert!(refused(PassiveProperties { pericardium_base_share: 1.1, ..ringed() }));
    assert!(refused(PassiveProperties { valve_ring_height_mm: -1.0, ..ringed() }));
    assert!(refused(PassiveProperties { valve_ring_stiffness_kpa: f64::NAN, ..ringed() }));
}
