//! Mechanics against closed forms: thick sphere, bar, cantilever, breathing mode, and what the assembly must conserve.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking, and may show its figures")]

use std::sync::Arc;

use cardiotwin::mechanics::{ContractionLaw, MotionState, Myocardium, PassiveProperties, StepOperator, StepSolver};
use cardiotwin::mesh::{SurfaceTag, TaggedSurface, TetMesh};
use nalgebra::{Matrix3, Rotation3, Vector3};

mod meshes;

use meshes::{OUTER_MM, block, sphere};

/// No springs, no damping; stiffnesses and density as given.
fn bare(stiffness_kpa: f64, poisson_ratio: f64) -> PassiveProperties {
    PassiveProperties {
        fibre_stiffness_kpa: stiffness_kpa,
        transverse_stiffness_kpa: stiffness_kpa,
        poisson_ratio,
        density_kg_per_mm3: 1e-6,
        damping_mass_per_s: 0.0,
        damping_stiffness_s: 0.0,
        base_stiffness_normal_kpa_per_mm: 0.0,
        base_stiffness_isotropic_kpa_per_mm: 0.0,
        pericardium_stiffness_kpa_per_mm: 0.0,
        pericardium_damping_kpa_s_per_mm: 0.0,
    }
}

fn straight_fibres(mesh: &TetMesh) -> Vec<Matrix3<f64>> {
    vec![Matrix3::identity(); mesh.tetrahedron_count()]
}

/// One undamped step so long that inertia does not count: the static displacement under a balanced load.
fn static_displacement(tissue: Myocardium, force_mn: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    displacement_after(tissue, force_mn, 10.0)
}

/// (K + M/h²)⁻¹ F: where one undamped step takes the tissue at rest.
fn displacement_after(tissue: Myocardium, force_mn: &[Vector3<f64>], step_s: f64) -> Vec<Vector3<f64>> {
    let rest = tissue.rest_mm().to_vec();
    let operator = StepOperator::new(Arc::new(tissue), step_s).unwrap();
    let mut system = operator.empty_system();
    operator.assemble(&MotionState::at_rest(rest.clone()), None, &mut system).unwrap();
    system.force_mn.iter_mut().zip(force_mn).for_each(|(sum, f)| *sum += f);
    let mut position = rest.clone();
    StepSolver::default().solve(&operator, &system, &mut position, &mut []).unwrap();
    position.iter().zip(&rest).map(|(y, x)| y - x).collect()
}

/// Mean outward displacement of a spherical surface.
fn mean_radial_mm(surface: &TaggedSurface, tag: SurfaceTag, rest: &[Vector3<f64>], displacement: &[Vector3<f64>]) -> f64 {
    let vertices = surface.vertices_with(tag);
    vertices.iter().map(|&v| displacement[v].dot(&rest[v].normalize())).sum::<f64>() / vertices.len() as f64
}

/// Displacements of the inner and outer surface under an inner pressure of 1 kPa, E = 10 kPa.
fn lame_mm(edge: usize, poisson_ratio: f64) -> [f64; 2] {
    let (mesh, surface) = sphere(edge, edge / 2);
    let tissue = Myocardium::new(&mesh, &surface, &straight_fibres(&mesh), &bare(10.0, poisson_ratio)).unwrap();
    let area = surface.vertex_area_vectors_mm2(SurfaceTag::EndocardiumLv, mesh.vertices_mm());
    let force: Vec<Vector3<f64>> = area.iter().map(|a| -a).collect();
    let displacement = static_displacement(tissue, &force);
    [SurfaceTag::EndocardiumLv, SurfaceTag::Epicardium].map(|tag| mean_radial_mm(&surface, tag, mesh.vertices_mm(), &displacement))
}

/// Second order in the edge length, and what two meshes extrapolate to is the closed form of Lamé.
#[test]
fn a_thick_sphere_under_pressure_converges_to_lame_at_second_order() {
    for (poisson_ratio, exact) in [(0.3, [3.130_16, 2.107_22]), (0.45, [2.995_13, 1.655_68])] {
        let (coarse, fine) = (lame_mm(6, poisson_ratio), lame_mm(12, poisson_ratio));
        for side in 0..2 {
            let errors = [coarse[side], fine[side]].map(|u| u / exact[side] - 1.0);
            let order = (errors[0] / errors[1]).log2();
            let extrapolated = (4.0 * fine[side] - coarse[side]) / 3.0 / exact[side] - 1.0;
            println!("ν {poisson_ratio} side {side}: errors {errors:?}, order {order:.2}, extrapolated {extrapolated:.5}");
            assert!(order > 1.6, "order {order}, errors {errors:?}");
            assert!(extrapolated.abs() < 0.01, "extrapolated error {extrapolated}");
        }
    }
}

/// The stress (σ/2)(I − r̂r̂ᵀ), σ = 1 kPa, as two families of crossing fibres on a free sphere.
#[test]
fn a_free_sphere_under_active_stress_shrinks_as_the_closed_form() {
    let inner_mm = |edge: usize, poisson_ratio: f64| {
        let (mesh, surface) = sphere(edge, edge / 2);
        let axes = |second: usize| -> Vec<Matrix3<f64>> {
            (0..mesh.tetrahedron_count())
                .map(|t| {
                    let radial = mesh.corners_mm(t).iter().sum::<Vector3<f64>>().normalize();
                    let across = radial.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
                    let tangents = [across, radial.cross(&across)];
                    Matrix3::from_columns(&[tangents[second], tangents[1 - second], radial])
                })
                .collect()
        };
        let mut force = vec![Vector3::zeros(); mesh.vertex_count()];
        for second in 0..2 {
            let tissue = Myocardium::new(&mesh, &surface, &axes(second), &bare(10.0, poisson_ratio)).unwrap();
            tissue.add_contraction_force(&vec![0.5; mesh.tetrahedron_count()], &mut force).unwrap();
        }
        let tissue = Myocardium::new(&mesh, &surface, &straight_fibres(&mesh), &bare(10.0, poisson_ratio)).unwrap();
        let displacement = static_displacement(tissue, &force);
        mean_radial_mm(&surface, SurfaceTag::EndocardiumLv, mesh.vertices_mm(), &displacement)
    };
    for (poisson_ratio, exact) in [(0.3, -1.193_61), (0.45, -1.042_88)] {
        let (coarse, fine) = (inner_mm(6, poisson_ratio), inner_mm(12, poisson_ratio));
        let extrapolated = (4.0 * fine - coarse) / 3.0 / exact - 1.0;
        println!("ν {poisson_ratio}: errors {} {}, extrapolated {extrapolated}", coarse / exact - 1.0, fine / exact - 1.0);
        assert!((fine / exact - 1.0).abs() < (coarse / exact - 1.0).abs() / 3.0);
        assert!(extrapolated.abs() < 0.01);
    }
}

/// A homogeneous body under uniform fibre stress strains uniformly, ε_f = −s/E_f and ε_t = ν s/E_f: exact for linear tetrahedra.
#[test]
fn a_free_bar_under_fibre_stress_strains_exactly() {
    let (mesh, surface) = block(Vector3::new(20.0, 7.0, 5.0), [5, 3, 2]);
    let axes = *Rotation3::from_euler_angles(0.3, -0.7, 1.1).matrix();
    let properties = PassiveProperties { transverse_stiffness_kpa: 12.0, ..bare(30.0, 0.4) };
    let tissue = Myocardium::new(&mesh, &surface, &vec![axes; mesh.tetrahedron_count()], &properties).unwrap();
    let stress_kpa = 2.0;
    let mut force = vec![Vector3::zeros(); mesh.vertex_count()];
    tissue.add_contraction_force(&vec![stress_kpa; mesh.tetrahedron_count()], &mut force).unwrap();
    let displacement = static_displacement(tissue, &force);
    let principal = Vector3::new(-stress_kpa / 30.0, 0.4 * stress_kpa / 30.0, 0.4 * stress_kpa / 30.0);
    let strain = axes * Matrix3::from_diagonal(&principal) * axes.transpose();
    // The strain is what edges between any two vertices see, whatever the rigid motion: eᵀ ε e = e·Δu.
    for (vertex, (x, u)) in mesh.vertices_mm().iter().zip(&displacement).enumerate().skip(1) {
        let (edge, change) = (x - mesh.vertices_mm()[0], u - displacement[0]);
        let error = edge.dot(&change) - edge.dot(&(strain * edge));
        assert!(error.abs() < 1e-6 * edge.norm_squared(), "vertex {vertex}: {error}");
    }
}

/// Tip deflection 0.400 mm of 100 × 10 × 10 mm, E 100 kPa, under 0.1 mN (beam theory; shear adds 0.6 %): linear tetrahedra are
/// too stiff in bending, and approach it at second order. Stiff base springs are the clamp.
#[test]
fn a_cantilever_approaches_beam_theory() {
    let tip_mm = |refinement: usize| {
        let (mesh, surface) = block(Vector3::new(100.0, 10.0, 10.0), [16 * refinement, 2 * refinement, 2 * refinement]);
        let properties = PassiveProperties { base_stiffness_isotropic_kpa_per_mm: 1e5, ..bare(100.0, 0.0) };
        let tissue = Myocardium::new(&mesh, &surface, &straight_fibres(&mesh), &properties).unwrap();
        let tip: Vec<usize> = (0..mesh.vertex_count()).filter(|&v| mesh.vertices_mm()[v].x == 100.0).collect();
        let mut force = vec![Vector3::zeros(); mesh.vertex_count()];
        tip.iter().for_each(|&v| force[v].z = 0.1 / tip.len() as f64);
        let displacement = static_displacement(tissue, &force);
        tip.iter().map(|&v| displacement[v].z).sum::<f64>() / tip.len() as f64
    };
    let (coarse, fine) = (tip_mm(2), tip_mm(4));
    let extrapolated = (4.0 * fine - coarse) / 3.0;
    println!("tip {coarse} {fine} mm, extrapolated {extrapolated}");
    assert!(coarse < fine && fine < 0.4);
    assert!((extrapolated / 0.4 - 1.0).abs() < 0.03, "extrapolated {extrapolated} mm");
}

/// Rayleigh's quotient after one inverse iteration from a uniform inflation, shifted by (1/h)² so that the rigid motions that
/// an uneven mesh excites are not amplified: the breathing mode of the free sphere.
#[test]
fn the_breathing_mode_has_the_closed_form_frequency() {
    for (poisson_ratio, exact_hz) in [(0.3, 28.669), (0.45, 32.828)] {
        let hz = [6, 12].map(|edge| {
            let (mesh, surface) = sphere(edge, edge / 2);
            let tissue = Myocardium::new(&mesh, &surface, &straight_fibres(&mesh), &bare(10.0, poisson_ratio)).unwrap();
            let inertia: Vec<Vector3<f64>> =
                mesh.vertices_mm().iter().zip(tissue.vertex_mass_kg()).map(|(x, m)| x.normalize() * *m).collect();
            let (stiffness, mass_kg) = (tissue.stiffness().clone(), tissue.vertex_mass_kg().to_vec());
            let mode = displacement_after(tissue, &inertia, 0.005);
            let mut elastic = mode.clone();
            stiffness.multiply(&mode, &mut elastic);
            let energy: f64 = mode.iter().zip(&elastic).map(|(u, f)| u.dot(f)).sum();
            let kinetic: f64 = mode.iter().zip(&mass_kg).map(|(u, m)| u.norm_squared() * m).sum();
            (energy / kinetic).sqrt() / std::f64::consts::TAU
        });
        let extrapolated = (4.0 * hz[1] - hz[0]) / 3.0 / exact_hz - 1.0;
        println!("ν {poisson_ratio}: {hz:?} Hz, extrapolated error {extrapolated}");
        assert!((hz[1] / exact_hz - 1.0).abs() < (hz[0] / exact_hz - 1.0).abs() / 2.5);
        assert!(extrapolated.abs() < 0.005);
    }
}

#[test]
fn rigid_motions_cost_no_energy_and_mass_is_density_times_volume() {
    let (mesh, surface) = sphere(4, 2);
    let properties = PassiveProperties { transverse_stiffness_kpa: 12.0, ..bare(30.0, 0.4) };
    let axes = vec![*Rotation3::from_euler_angles(0.3, -0.7, 1.1).matrix(); mesh.tetrahedron_count()];
    let tissue = Myocardium::new(&mesh, &surface, &axes, &properties).unwrap();
    for mode in 0..6 {
        let unit = Vector3::ith(mode % 3, 1.0);
        let motion: Vec<Vector3<f64>> = mesh.vertices_mm().iter().map(|x| if mode < 3 { unit } else { unit.cross(x) }).collect();
        let mut force = motion.clone();
        tissue.stiffness().multiply(&motion, &mut force);
        let scale = 30.0 * OUTER_MM * motion.iter().map(Vector3::norm).fold(0.0, f64::max);
        assert!(force.iter().all(|f| f.norm() < 1e-12 * scale), "mode {mode}");
    }
    let mass_kg: f64 = tissue.vertex_mass_kg().iter().sum();
    assert!((mass_kg / (mesh.total_volume_mm3() * 1e-6) - 1.0).abs() < 1e-12);
}

/// F_C = −∂E/∂u of E = Σ V σ f·(∂u/∂x) f, with the displacement gradient found from edges, not from shape functions.
#[test]
fn the_contraction_force_is_minus_the_gradient_of_its_energy() {
    let (mesh, surface) = block(Vector3::new(6.0, 5.0, 4.0), [2, 2, 1]);
    let law = ContractionLaw {
        peak_kpa: 90.0,
        contraction_rate_per_s: 10.0,
        relaxation_rate_per_s: 25.0,
        action_potential_duration_s: 0.3,
        period_s: 0.8,
    };
    let axes: Vec<Matrix3<f64>> =
        (0..mesh.tetrahedron_count()).map(|t| *Rotation3::from_euler_angles(t as f64, 0.2, 0.7 * t as f64).matrix()).collect();
    let stress: Vec<f64> = (0..mesh.tetrahedron_count()).map(|t| law.stress_kpa(0.2, 0.003 * t as f64)).collect();
    let energy = |displacement: &[Vector3<f64>]| -> f64 {
        let element = |t: usize| {
            let corners = mesh.tetrahedra()[t];
            let x = corners.map(|v| mesh.vertices_mm()[v]);
            let u = corners.map(|v| displacement[v]);
            let edges = Matrix3::from_columns(&[x[1] - x[0], x[2] - x[0], x[3] - x[0]]);
            let changes = Matrix3::from_columns(&[u[1] - u[0], u[2] - u[0], u[3] - u[0]]);
            let fibre = axes[t].column(0).into_owned();
            edges.determinant() / 6.0 * stress[t] * fibre.dot(&(changes * edges.try_inverse().unwrap() * fibre))
        };
        (0..mesh.tetrahedron_count()).map(element).sum()
    };
    let tissue = Myocardium::new(&mesh, &surface, &axes, &bare(30.0, 0.4)).unwrap();
    let mut force = vec![Vector3::zeros(); mesh.vertex_count()];
    tissue.add_contraction_force(&stress, &mut force).unwrap();
    let zero = vec![Vector3::zeros(); mesh.vertex_count()];
    for vertex in 0..mesh.vertex_count() {
        for axis in 0..3 {
            let mut moved = zero.clone();
            moved[vertex][axis] = 1.0;
            let difference = energy(&moved) - energy(&zero);
            assert!((force[vertex][axis] + difference).abs() < 1e-9 * stress[0] * 30.0);
        }
    }
}
