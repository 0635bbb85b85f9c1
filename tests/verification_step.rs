//! The step system: solves against dense algebra, and what repeated solves may depend on.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking, and may show its figures")]

use std::sync::Arc;

use cardiotwin::mechanics::{
    MechanicsError, MotionState, Myocardium, PassiveProperties, SolvePath, SolveSettings, StepOperator, StepSolver, StepSystem,
};
use cardiotwin::numerics::LinearSolveError;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

mod meshes;

const PROPERTIES: PassiveProperties = PassiveProperties {
    fibre_stiffness_kpa: 30.0,
    transverse_stiffness_kpa: 20.0,
    poisson_ratio: 0.4,
    density_kg_per_mm3: 1.06e-6,
    damping_mass_per_s: 10.0,
    damping_stiffness_s: 0.01,
    base_stiffness_normal_kpa_per_mm: 2.5,
    base_stiffness_isotropic_kpa_per_mm: 0.25,
    pericardium_stiffness_kpa_per_mm: 0.075,
    pericardium_damping_kpa_s_per_mm: 0.005,
    volume_stiffness_kpa: 0.0,
    pericardium_base_share: 1.0,
    valve_ring_height_mm: 0.0,
    valve_ring_stiffness_kpa: 0.0,
};

/// A block of `edge`³ cells of 3 mm, its face x = 0 the base, the rest epicardium; fibres turn through it.
fn tissue(edge: usize, properties: &PassiveProperties) -> Arc<Myocardium> {
    let (mesh, surface) = meshes::block(Vector3::repeat(3.0 * edge as f64), [edge; 3]);
    let axes: Vec<Matrix3<f64>> =
        (0..mesh.tetrahedron_count()).map(|t| *Rotation3::from_euler_angles(0.1 * t as f64, 0.2, 0.3).matrix()).collect();
    Arc::new(Myocardium::new(&mesh, &surface, &axes, properties).unwrap())
}

/// The stiffness block of a vertex.
type Block = &'static dyn Fn(usize) -> Matrix3<f64>;

fn wobble(vertex: usize) -> Vector3<f64> {
    let v = vertex as f64;
    Vector3::new(v.sin(), (1.7 * v).cos(), (0.3 * v).sin())
}

/// A moving state and the system of its next step with a surface stiffness of the given kind.
fn loaded_system(operator: &StepOperator, block: impl Fn(usize) -> Matrix3<f64>) -> (MotionState, StepSystem) {
    let rest = operator.myocardium().rest_mm();
    let mut state = MotionState::at_rest(rest.iter().enumerate().map(|(v, x)| x + wobble(v) * 0.05).collect());
    state.velocity_mm_per_s = (0..rest.len()).map(|v| wobble(v + 9) * 20.0).collect();
    let mut system = operator.empty_system();
    operator.assemble(&state, None, &mut system).unwrap();
    for vertex in (0..rest.len()).step_by(2) {
        let stiffness = block(vertex);
        system.stiffness_mn_per_mm[vertex] = stiffness;
        system.force_mn[vertex] += stiffness * (rest[vertex] + wobble(vertex + 3));
    }
    (state, system)
}

fn normal_spring(vertex: usize) -> Matrix3<f64> {
    let normal = wobble(vertex).normalize();
    normal * normal.transpose() * 40.0
}

/// 2γ(I − B) with B = I − N N_imgᵀ/(N·N_img), MODEL §7.
fn exact_image_block(vertex: usize) -> Matrix3<f64> {
    let normal = wobble(vertex).normalize();
    let image_normal = (normal + wobble(vertex + 1).normalize() * 0.3).normalize();
    normal * image_normal.transpose() * (40.0 / normal.dot(&image_normal))
}

fn dense_of(operator: &StepOperator, system: &StepSystem) -> DMatrix<f64> {
    let count = operator.myocardium().vertex_count();
    let pattern = operator.matrix().pattern();
    let mut dense = DMatrix::zeros(3 * count, 3 * count);
    for row in 0..count {
        for &column in pattern.columns_of(row) {
            let position = pattern.position(row, column).unwrap();
            dense.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&operator.matrix().blocks()[position]);
        }
        let mut diagonal = dense.fixed_view_mut::<3, 3>(3 * row, 3 * row);
        diagonal += system.stiffness_mn_per_mm[row];
    }
    dense
}

fn flat(field: &[Vector3<f64>]) -> DVector<f64> {
    DVector::from_iterator(3 * field.len(), field.iter().flat_map(|v| v.iter().copied()))
}

#[test]
fn every_path_agrees_with_dense_lu() {
    let operator = StepOperator::new(tissue(3, &PROPERTIES), 0.005).unwrap();
    let count = operator.myocardium().vertex_count();
    let paths: [(SolvePath, Block); 3] = [
        (SolvePath::Direct, &|_| Matrix3::zeros()),
        (SolvePath::ConjugateGradients, &normal_spring),
        (SolvePath::Gmres, &exact_image_block),
    ];
    for (path, block) in paths {
        let (state, system) = loaded_system(&operator, block);
        let gradient: Vec<Vector3<f64>> = (0..count).map(|v| wobble(v + 5)).collect();
        let mut position = state.position_mm.clone();
        let mut responses = vec![gradient.clone()];
        let mut solver =
            StepSolver::new(SolveSettings { relative_tolerance: 1e-11, response_tolerance: 1e-11, ..SolveSettings::default() });
        let report = solver.solve(&operator, &system, &mut position, &mut responses).unwrap();
        assert_eq!(report.path, path);
        let lu = dense_of(&operator, &system).lu();
        for (solution, rhs) in [(&position, &system.force_mn), (&responses[0], &gradient)] {
            let expected = lu.solve(&flat(rhs)).unwrap();
            assert!((flat(solution) - &expected).norm() < 1e-9 * expected.norm(), "{path:?}");
        }
    }
}

/// A position moved along a coarse response is off; settled, it is that of dense algebra again. A fine response needs no settling, and
/// neither does a small change.
#[test]
fn what_a_coarse_response_lacks_is_settled() {
    let operator = StepOperator::new(tissue(4, &PROPERTIES), 0.005).unwrap();
    let count = operator.myocardium().vertex_count();
    let gradient: Vec<Vector3<f64>> = (0..count).map(|v| wobble(v + 5) * 100.0).collect();
    for (path, block) in [(SolvePath::ConjugateGradients, &normal_spring as Block), (SolvePath::Gmres, &exact_image_block)] {
        let mut solver = StepSolver::new(SolveSettings { relative_tolerance: 1e-10, response_tolerance: 0.3, ..SolveSettings::default() });
        // A preconditioner that is not the matrix itself.
        let (state, mut system) = loaded_system(&operator, |vertex| block(vertex) * 5.0);
        solver.solve(&operator, &system, &mut state.position_mm.clone(), &mut []).unwrap();
        system.stiffness_mn_per_mm.iter_mut().for_each(|block| *block *= 0.05);
        let (mut position, mut responses) = (state.position_mm.clone(), vec![gradient.clone()]);
        let report = solver.solve(&operator, &system, &mut position, &mut responses).unwrap();
        assert!(report.path == path && !report.was_refactorised, "{report:?}");
        assert!(solver.responses_suffice([1e-12].into_iter()) && !solver.responses_suffice([3.0].into_iter()));
        for ((position, response), (force, gradient)) in
            position.iter_mut().zip(&responses[0]).zip(system.force_mn.iter_mut().zip(&gradient))
        {
            *position += response * 3.0;
            *force += gradient * 3.0;
        }
        let expected = dense_of(&operator, &system).lu().solve(&flat(&system.force_mn)).unwrap();
        let error = |position: &[Vector3<f64>]| (flat(position) - &expected).norm() / expected.norm();
        assert!(error(&position) > 1e-6, "{path:?}: {:e} is too good to show anything", error(&position));
        solver.settle(&operator, &system, &mut position).unwrap();
        assert!(error(&position) < 1e-8, "{path:?}: {:e}", error(&position));
    }
    let (state, system) = loaded_system(&operator, normal_spring);
    let mut solver = StepSolver::new(SolveSettings::default());
    solver.solve(&operator, &system, &mut state.position_mm.clone(), &mut [gradient]).unwrap();
    assert!(solver.responses_suffice([1e-3].into_iter()));
}

/// Symmetric blocks with negative eigenvalues make the sum indefinite: the answer must still be that of dense algebra.
#[test]
fn an_indefinite_system_falls_back_to_gmres() {
    let operator = StepOperator::new(tissue(2, &PROPERTIES), 0.005).unwrap();
    let (state, system) = loaded_system(&operator, |vertex| Matrix3::identity() * if vertex == 4 { -4e3 } else { 1.0 });
    let mut position = state.position_mm.clone();
    let report = StepSolver::default().solve(&operator, &system, &mut position, &mut []).unwrap();
    assert_eq!(report.path, SolvePath::Gmres);
    let expected = dense_of(&operator, &system).lu().solve(&flat(&system.force_mn)).unwrap();
    assert!((flat(&position) - &expected).norm() < 1e-6 * expected.norm());
}

/// A steady load must not cost more and more: the preconditioner of the first step serves the following ones.
#[test]
fn the_preconditioner_is_kept_while_it_serves_and_renewed_when_it_does_not() {
    let operator = StepOperator::new(tissue(6, &PROPERTIES), 0.005).unwrap();
    let settings = SolveSettings { excess_iterations: 4, ..SolveSettings::default() };
    let mut solver = StepSolver::new(settings);
    let mut solve = |gain: f64| {
        let (state, system) = loaded_system(&operator, |vertex| normal_spring(vertex) * gain);
        solver.solve(&operator, &system, &mut state.position_mm.clone(), &mut []).unwrap()
    };
    let first = solve(1.0);
    assert!(first.was_refactorised && first.iteration_count <= 2, "{first:?}");
    let near = solve(1.05);
    assert!(!near.was_refactorised && near.iteration_count <= 5, "{near:?}");
    let far = solve(50.0);
    assert!(!far.was_refactorised && far.iteration_count > 4, "{far:?}");
    let renewed = solve(50.0);
    assert!(renewed.was_refactorised && renewed.iteration_count <= 2, "{renewed:?}");
}

#[test]
fn a_solve_that_may_not_iterate_fails_with_its_residual_and_count() {
    let operator = StepOperator::new(tissue(3, &PROPERTIES), 0.005).unwrap();
    let mut solver = StepSolver::new(SolveSettings { iteration_limit: 2, ..SolveSettings::default() });
    let (state, system) = loaded_system(&operator, exact_image_block);
    let error = solver.solve(&operator, &system, &mut state.position_mm.clone(), &mut []).unwrap_err();
    let MechanicsError::Solve(LinearSolveError::NotConverged { relative_residual, iteration_count, .. }) = error else {
        panic!("{error}");
    };
    assert_eq!(iteration_count, 2);
    assert!(relative_residual > 1e-8 && relative_residual < 1.0);
}

#[test]
fn a_force_that_is_not_finite_is_an_error_on_every_path() {
    let operator = StepOperator::new(tissue(2, &PROPERTIES), 0.005).unwrap();
    let blocks: [Block; 3] = [&|_| Matrix3::zeros(), &normal_spring, &exact_image_block];
    for block in blocks {
        let (state, mut system) = loaded_system(&operator, block);
        system.force_mn[3].y = f64::NAN;
        let error = StepSolver::default().solve(&operator, &system, &mut state.position_mm.clone(), &mut []).unwrap_err();
        assert_eq!(error, MechanicsError::Solve(LinearSolveError::NotFinite { right_hand_side: 0 }));
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let operator = StepOperator::new(tissue(8, &PROPERTIES), 0.005).unwrap();
            let mut solver = StepSolver::default();
            [normal_spring, exact_image_block].map(|block| {
                let (state, system) = loaded_system(&operator, block);
                let mut position = state.position_mm.clone();
                solver.solve(&operator, &system, &mut position, &mut []).unwrap();
                position
            })
        })
    };
    assert_eq!(run(1), run(4));
}

/// Moving all anchors of a tissue that only the base holds moves the tissue: a rigid translation is the equilibrium.
#[test]
fn moving_anchors_carry_the_tissue_along() {
    let held = PassiveProperties { pericardium_stiffness_kpa_per_mm: 0.0, ..PROPERTIES };
    let operator = StepOperator::new(tissue(3, &held), 0.005).unwrap();
    let tissue = operator.myocardium();
    let shift = Vector3::new(1.0, -2.0, 0.5);
    let anchors: Vec<Vector3<f64>> = tissue.base_vertices().iter().map(|&v| tissue.rest_mm()[v] + shift).collect();
    let state = MotionState::at_rest(tissue.rest_mm().iter().map(|x| x + shift).collect());
    let mut system = operator.empty_system();
    operator.assemble(&state, Some(&anchors), &mut system).unwrap();
    let mut position = tissue.rest_mm().to_vec();
    StepSolver::default().solve(&operator, &system, &mut position, &mut []).unwrap();
    assert!(position.iter().zip(&state.position_mm).all(|(y, z)| (y - z).norm() < 1e-10));
    let wrong = operator.assemble(&state, Some(&anchors[1..]), &mut system);
    assert!(matches!(wrong, Err(MechanicsError::FieldSize { .. })));
}

#[test]
fn fields_of_the_wrong_size_and_bad_steps_are_refused() {
    let tissue = tissue(1, &PROPERTIES);
    for step_s in [0.0, -0.1, f64::NAN] {
        assert!(matches!(StepOperator::new(Arc::clone(&tissue), step_s), Err(MechanicsError::Property { property: "step_s", .. })));
    }
    let operator = StepOperator::new(Arc::clone(&tissue), 0.005).unwrap();
    let mut system = operator.empty_system();
    let short = MotionState::at_rest(vec![Vector3::zeros(); 3]);
    assert!(matches!(operator.assemble(&short, None, &mut system), Err(MechanicsError::FieldSize { .. })));
    let responses = &mut [vec![Vector3::zeros(); 2]];
    let outcome = StepSolver::default().solve(&operator, &system, &mut tissue.rest_mm().to_vec(), responses);
    assert!(matches!(outcome, Err(MechanicsError::FieldSize { .. })));
    assert!(matches!(tissue.add_contraction_force(&[1.0], &mut system.force_mn), Err(MechanicsError::FieldSize { .. })));
}
