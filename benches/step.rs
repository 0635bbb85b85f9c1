//! What one time step costs: factorisation, the free step, the step with image stiffness, at two mesh sizes.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "criterion's macros, and a bench that fails loudly")]

use std::hint::black_box;
use std::sync::Arc;

use cardiotwin::mechanics::{MotionState, Myocardium, PassiveProperties, StepOperator, StepSolver, StepSystem};
use cardiotwin::mesh::{SurfaceTag, TaggedSurface};
use cardiotwin::numerics::{CholeskyFactor, CholeskyWorkspace};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::{Matrix3, Rotation3, Vector3};

#[path = "../tests/meshes/mod.rs"]
mod meshes;

const PROPERTIES: PassiveProperties = PassiveProperties {
    fibre_stiffness_kpa: 30.0,
    transverse_stiffness_kpa: 20.0,
    poisson_ratio: 0.4,
    density_kg_per_mm3: 1.06e-6,
    damping_mass_per_s: 10.0,
    damping_stiffness_s: 0.01,
    base_stiffness_normal_kpa_per_mm: 2.5,
    base_stiffness_isotropic_kpa_per_mm: 2.5,
    pericardium_stiffness_kpa_per_mm: 0.0,
    pericardium_damping_kpa_s_per_mm: 0.005,
};
const STEP_S: f64 = 0.005;
const GAIN_KPA_PER_MM: f64 = 1.0;

/// A thick sphere of about 3,000, 10,000 or 15,000 vertices.
fn heart_sized(edge: usize) -> (TaggedSurface, Arc<Myocardium>) {
    let (mesh, surface) = meshes::sphere(edge, 4);
    let axes: Vec<Matrix3<f64>> =
        (0..mesh.tetrahedron_count()).map(|t| *Rotation3::from_euler_angles(0.1 * t as f64, 0.2, 0.3).matrix()).collect();
    let tissue = Myocardium::new(&mesh, &surface, &axes, &PROPERTIES).unwrap();
    (surface, Arc::new(tissue))
}

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
        load(surface, tissue, is_symmetric, (step + 1) as f64 * STEP_S, &mut system);
        responses.clone_from(&gradients(surface, tissue));
        let mut position = state.position_mm.clone();
        let report = solver.solve(operator, &system, &mut position, &mut responses).unwrap();
        iterations += report.iteration_count;
        refactorisations += usize::from(report.was_refactorised);
        state = operator.advance(&state, position);
    }
    (iterations, refactorisations)
}

fn step(criterion: &mut Criterion) {
    for edge in [10, 18, 22] {
        let (surface, tissue) = heart_sized(edge);
        let operator = StepOperator::new(Arc::clone(&tissue), STEP_S).unwrap();
        let vertices = tissue.vertex_count();
        println!("{vertices} vertices: {} entries of the factor", tissue.structure().stored_count());
        let mut group = criterion.benchmark_group("step");
        group.sample_size(10);
        let mut workspace = CholeskyWorkspace::<f64>::default();
        let mut factor = CholeskyFactor::new(Arc::clone(tissue.structure()), operator.matrix(), &mut workspace).unwrap();
        group.bench_function(BenchmarkId::new("factorise", vertices), |bencher| {
            bencher.iter(|| factor.refactorise(operator.matrix(), &mut workspace).unwrap());
        });
        let columns = vec![tissue.rest_mm().to_vec(); 3];
        let mut solved = columns.clone();
        group.bench_function(BenchmarkId::new("three_triangular_solves", vertices), |bencher| {
            bencher.iter(|| {
                solved.clone_from(&columns);
                factor.solve_in_place(black_box(&mut solved), &mut workspace).unwrap();
            });
        });
        let mut solver = StepSolver::default();
        let mut system = operator.empty_system();
        let mut state = MotionState::at_rest(tissue.rest_mm().to_vec());
        let loads = gradients(&surface, &tissue);
        let mut responses = loads.clone();
        group.bench_function(BenchmarkId::new("free_step", vertices), |bencher| {
            bencher.iter(|| {
                operator.assemble(&state, None, &mut system).unwrap();
                let mut position = state.position_mm.clone();
                responses.clone_from(&loads);
                solver.solve(&operator, &system, &mut position, &mut responses).unwrap();
                state = operator.advance(&state, position);
            });
        });
        for (name, is_symmetric) in [("ten_tracked_steps_symmetric", true), ("ten_tracked_steps_nonsymmetric", false)] {
            let (iterations, refactorisations) = tracked_steps(&surface, &operator, is_symmetric, 10);
            println!("{name}: {iterations} iterations, {refactorisations} factorisations");
            group.bench_function(BenchmarkId::new(name, vertices), |bencher| {
                bencher.iter(|| tracked_steps(&surface, &operator, is_symmetric, 10));
            });
        }
        group.finish();
    }
}

criterion_group!(benches, step);
criterion_main!(benches);
