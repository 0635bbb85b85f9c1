//! What one time step costs: the free step beside the triangular solves it rests on, and steps with image stiffness.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "criterion's macros, and a bench that fails loudly")]

use std::hint::black_box;
use std::sync::Arc;

use cardiotwin::heart::HeartModel;
use cardiotwin::mechanics::{MotionState, Myocardium, StepOperator, StepSolver, StepSystem};
use cardiotwin::mesh::{SurfaceTag, TaggedSurface};
use cardiotwin::numerics::{CholeskyFactor, CholeskyWorkspace};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::{Rotation3, Vector3};

mod hearts;

const GAIN_KPA_PER_MM: f64 = 1.0;

/// 2γ N_img N_imgᵀ/cos²β (variational) or 2γ N N_imgᵀ/(N·N_img) (exact) on every boundary vertex, image normals turning with time.
fn load(surface: &TaggedSurface, tissue: &Myocardium, is_symmetric: bool, time_s: f64, system: &mut StepSystem) {
    for tag in [SurfaceTag::EndocardiumLv, SurfaceTag::Epicardium] {
        let area = surface.vertex_area_vectors_mm2(tag, tissue.rest_mm());
        for (vertex, area_mm2) in area.iter().enumerate().filter(|(_, a)| a.norm() > 0.0) {
            let normal = area_mm2.normalize();
            let phase = vertex as f64 + 10.0 * time_s;
            let image_normal = Rotation3::new(Vector3::new(phase.sin(), (2.0 * phase).cos(), (3.0 * phase).sin()) * 0.2) * normal;
            let cosine = normal.dot(&image_normal);
            let gain = 2.0 * GAIN_KPA_PER_MM * area_mm2.norm();
            let block = if is_symmetric {
                image_normal * image_normal.transpose() * (gain / (cosine * cosine))
            } else {
                normal * image_normal.transpose() * (gain / cosine)
            };
            system.stiffness_mn_per_mm[vertex] += block;
            system.force_mn[vertex] += block * (tissue.rest_mm()[vertex] + normal * (2.0 * time_s.sin()));
        }
    }
}

fn gradients(surface: &TaggedSurface, tissue: &Myocardium) -> Vec<Vec<Vector3<f64>>> {
    [SurfaceTag::EndocardiumLv, SurfaceTag::Epicardium].map(|tag| surface.vertex_area_vectors_mm2(tag, tissue.rest_mm())).to_vec()
}

/// A run of steps that starts at rest; gives the iterations and refactorisations.
fn tracked_steps(surface: &TaggedSurface, operator: &StepOperator, is_symmetric: bool, step_count: usize) -> (usize, usize) {
    let tissue = operator.myocardium();
    let mut solver = StepSolver::default();
    let mut state = MotionState::at_rest(tissue.rest_mm().to_vec());
    let mut system = operator.empty_system();
    let mut responses = gradients(surface, tissue);
    let (mut iterations, mut refactorisations) = (0, 0);
    for step in 0..step_count {
        operator.assemble(&state, None, &mut system).unwrap();
        load(surface, tissue, is_symmetric, (step + 1) as f64 * operator.step_s(), &mut system);
        responses.clone_from(&gradients(surface, tissue));
        let mut position = state.position_mm.clone();
        let report = solver.solve(operator, &system, &mut position, &mut responses).unwrap();
        iterations += report.iteration_count;
        refactorisations += usize::from(report.was_refactorised);
        state = operator.advance(&state, position);
    }
    (iterations, refactorisations)
}

/// The whole free step beside the triangular solves of as many right-hand sides (goal: at most 1.3 times them), and the step of a left
/// ventricle with its valves, which has two.
fn print_free_step(surface: &TaggedSurface, operator: &StepOperator, model: &HeartModel) {
    let tissue = operator.myocardium();
    let mut memory = CholeskyWorkspace::<f64>::default();
    let factor = CholeskyFactor::new(Arc::clone(tissue.structure()), operator.matrix(), &mut memory).unwrap();
    let loads = gradients(surface, tissue);
    let mut columns = [vec![tissue.rest_mm().to_vec()], loads.clone()].concat();
    let stress_kpa = vec![30.0; tissue.tetrahedron_count()];
    let (mut solver, mut system, mut responses) = (StepSolver::default(), operator.empty_system(), loads.clone());
    let mut state = MotionState::at_rest(tissue.rest_mm().to_vec());
    let (still, mut other) = (state.clone(), operator.empty_system());
    let (mut workspace, mut heart) = (model.workspace(), model.initial_state(0.0));
    let solves = move || factor.solve_in_place(black_box(&mut columns), &mut memory).unwrap();
    let free = move || {
        operator.assemble(&state, None, &mut system).unwrap();
        tissue.add_contraction_force(&stress_kpa, &mut system.force_mn).unwrap();
        let mut position = state.position_mm.clone();
        responses.clone_from(&loads);
        solver.solve(operator, &system, &mut position, &mut responses).unwrap();
        state = operator.advance(&state, position);
    };
    let assembly = move || operator.assemble(&still, None, black_box(&mut other)).unwrap();
    let ventricle = move || heart = model.step(&heart, &[], &mut workspace).unwrap().state;
    hearts::print_in_turn(
        &format!("{} vertices", tissue.vertex_count()),
        15,
        vec![
            ("three triangular solves", Box::new(solves)),
            ("free step, three solves", Box::new(free)),
            ("its right-hand side", Box::new(assembly)),
            ("left ventricle, two solves", Box::new(ventricle)),
        ],
    );
}

fn step(criterion: &mut Criterion<hearts::ProcessorTime>) {
    let mut group = criterion.benchmark_group("step");
    for (_, edge_length_mm) in &hearts::SIZES[..2] {
        let anatomy = hearts::left_ventricle(*edge_length_mm);
        let (surface, operator) = (&anatomy.surface, hearts::step_operator(&anatomy));
        let model = hearts::heart(*edge_length_mm);
        print_free_step(surface, &operator, &model);
        let (mut workspace, mut state) = (model.workspace(), model.initial_state(0.0));
        let vertices = anatomy.mesh.vertex_count();
        group.bench_function(BenchmarkId::new("left_ventricle", vertices), |bencher| {
            bencher.iter(|| state = model.step(&state, &[], &mut workspace).unwrap().state);
        });
        for (name, is_symmetric) in [("ten_tracked_steps_symmetric", true), ("ten_tracked_steps_nonsymmetric", false)] {
            let (iterations, refactorisations) = tracked_steps(surface, &operator, is_symmetric, 10);
            println!("{name}: {iterations} iterations, {refactorisations} factorisations");
            group.bench_function(BenchmarkId::new(name, vertices), |bencher| {
                bencher.iter(|| tracked_steps(surface, &operator, is_symmetric, 10));
            });
        }
    }
    group.finish();
}

criterion_group! { name = benches; config = hearts::criterion(); targets = step }
criterion_main!(benches);
