//! Time schemes and damping of the step on single modes of a piece of tissue, against closed forms.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking, and may show its figures")]

use std::f64::consts::TAU;
use std::sync::Arc;

use cardiotwin::mechanics::{
    ExplicitSpring, MotionState, Myocardium, PassiveProperties, StepOperator, StepSolver, TimeScheme, explicit_spring_limit,
};
use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};

mod meshes;

const ANISOTROPIC: PassiveProperties = PassiveProperties {
    fibre_stiffness_kpa: 30.0,
    transverse_stiffness_kpa: 20.0,
    poisson_ratio: 0.4,
    density_kg_per_mm3: 1.06e-6,
    damping_mass_per_s: 0.0,
    damping_stiffness_s: 0.0,
    base_stiffness_normal_kpa_per_mm: 0.0,
    base_stiffness_isotropic_kpa_per_mm: 0.0,
    pericardium_stiffness_kpa_per_mm: 0.0,
    pericardium_damping_kpa_s_per_mm: 0.0,
    volume_stiffness_kpa: 0.0,
    pericardium_base_share: 1.0,
    valve_ring_height_mm: 0.0,
    valve_ring_stiffness_kpa: 0.0,
};

/// Tissue on springs at its base and around it, undamped.
const SPRUNG: PassiveProperties = PassiveProperties {
    base_stiffness_normal_kpa_per_mm: 2.5,
    base_stiffness_isotropic_kpa_per_mm: 0.25,
    pericardium_stiffness_kpa_per_mm: 0.075,
    ..ANISOTROPIC
};

/// A cube of 6 mm in 8 cells, its face x = 0 the base, the rest epicardium; fibres turn through it.
fn tissue(properties: &PassiveProperties) -> Arc<Myocardium> {
    let (mesh, surface) = meshes::block(Vector3::repeat(6.0), [2; 3]);
    let axes: Vec<Matrix3<f64>> =
        (0..mesh.tetrahedron_count()).map(|t| *Rotation3::from_euler_angles(0.1 * t as f64, 0.2, 0.3).matrix()).collect();
    Arc::new(Myocardium::new(&mesh, &surface, &axes, properties).unwrap())
}

/// A mode of undamped tissue: K u = ω² M u, uᵀM u = 1 kg.
struct Mode {
    tissue: Arc<Myocardium>,
    omega_per_s: f64,
    shape: Vec<Vector3<f64>>,
}

/// Position and velocity along a mode.
#[derive(Debug, Clone, Copy)]
struct Phase {
    q: f64,
    v: f64,
}

const AMPLITUDE: f64 = 1e-4;

impl Mode {
    /// All modes, slow to fast, by dense algebra.
    fn all(tissue: &Arc<Myocardium>) -> Vec<Self> {
        let count = tissue.vertex_count();
        // A step of 1 s adds M/h² to the stiffness, which is taken off again.
        let operator = StepOperator::new(Arc::clone(tissue), 1.0).unwrap();
        let (pattern, root_kg) = (operator.matrix().pattern(), tissue.vertex_mass_kg().iter().map(|m| m.sqrt()).collect::<Vec<_>>());
        let mut scaled = DMatrix::zeros(3 * count, 3 * count);
        for row in 0..count {
            for &column in pattern.columns_of(row) {
                let block = operator.matrix().blocks()[pattern.position(row, column).unwrap()] / (root_kg[row] * root_kg[column]);
                scaled.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&block);
            }
        }
        let eigen = scaled.symmetric_eigen();
        let shape = |mode: usize| (0..count).map(|v| eigen.eigenvectors.fixed_view::<3, 1>(3 * v, mode) / root_kg[v]).collect();
        let omega_per_s = |mode: usize| (eigen.eigenvalues[mode] - 1.0).max(0.0).sqrt();
        let mode = |mode: usize| Self { tissue: Arc::clone(tissue), omega_per_s: omega_per_s(mode), shape: shape(mode) };
        let mut modes: Vec<Self> = (0..3 * count).map(mode).collect();
        modes.sort_by(|a, b| a.omega_per_s.total_cmp(&b.omega_per_s));
        modes
    }

    fn along(&self, field: impl Iterator<Item = Vector3<f64>>) -> f64 {
        field.zip(&self.shape).zip(self.tissue.vertex_mass_kg()).map(|((u, shape), mass_kg)| u.dot(shape) * mass_kg).sum()
    }

    /// Lets `tissue`, which has this mode, go from the mode's shape, at rest but accelerating by `acceleration`; one phase a step, the
    /// start's first.
    fn release(&self, tissue: &Arc<Myocardium>, scheme: TimeScheme, step_s: f64, step_count: usize, acceleration: f64) -> Vec<Phase> {
        let operator = StepOperator::with_scheme(Arc::clone(tissue), step_s, scheme).unwrap();
        let rest_mm = tissue.rest_mm();
        let mut state = MotionState::at_rest(rest_mm.iter().zip(&self.shape).map(|(x, u)| x + u * AMPLITUDE).collect());
        state.acceleration_mm_per_s2 = self.shape.iter().map(|u| u * acceleration).collect();
        state.algorithmic_acceleration_mm_per_s2.clone_from(&state.acceleration_mm_per_s2);
        let mut system = operator.empty_system();
        let mut solver = StepSolver::default();
        let phase = |state: &MotionState| Phase {
            q: self.along(state.position_mm.iter().zip(rest_mm).map(|(y, x)| y - x)),
            v: self.along(state.velocity_mm_per_s.iter().copied()),
        };
        let mut phases = vec![phase(&state)];
        for _ in 0..step_count {
            operator.assemble(&state, None, &mut system).unwrap();
            let mut position_mm = state.position_mm.clone();
            solver.solve(&operator, &system, &mut position_mm, &mut []).unwrap();
            state = operator.advance(&state, position_mm);
            phases.push(phase(&state));
        }
        phases
    }

    /// As [`release`](Self::release) from the balance of forces, undamped: q̈ = −ω²q.
    fn released(&self, scheme: TimeScheme, step_s: f64, step_count: usize) -> Vec<Phase> {
        self.release(&self.tissue, scheme, step_s, step_count, -self.omega_per_s.powi(2) * AMPLITUDE)
    }

    /// Norm of (ωq, q̇).
    fn norm(&self, phase: Phase) -> f64 {
        (self.omega_per_s * phase.q).hypot(phase.v)
    }
}

const TRAPEZOIDAL: TimeScheme = TimeScheme::GeneralisedAlpha { spectral_radius: 1.0 };

/// The norm of (ωq, q̇) shrinks by 1/√(1 + (ωh)²) a step, and by nothing else.
#[test]
fn backward_euler_damps_every_mode_by_its_closed_form_factor() {
    let modes = Mode::all(&tissue(&SPRUNG));
    for mode in [&modes[0], &modes[20], &modes[60]] {
        for step_s in [0.001, 0.01] {
            let phases = mode.released(TimeScheme::BackwardEuler, step_s, 3);
            let expected = 1.0 / 1.0f64.hypot(mode.omega_per_s * step_s);
            for pair in phases.windows(2) {
                assert!((mode.norm(pair[1]) / mode.norm(pair[0]) / expected - 1.0).abs() < 1e-8, "ω {}, h {step_s}", mode.omega_per_s);
            }
        }
    }
}

/// No damping at any frequency, and the period longer as tan(ω'h/2) = ωh/2 has it.
#[test]
fn the_trapezoidal_rule_damps_no_mode_and_slows_it_as_its_closed_form() {
    let modes = Mode::all(&tissue(&SPRUNG));
    for mode in [&modes[0], &modes[20], &modes[60]] {
        for step_s in [0.001, 0.01] {
            let phases = mode.released(TRAPEZOIDAL, step_s, 40);
            let angle = 2.0 * (mode.omega_per_s * step_s / 2.0).atan();
            for (step, phase) in phases.iter().enumerate() {
                assert!((mode.norm(*phase) / mode.norm(phases[0]) - 1.0).abs() < 1e-8);
                assert!((phase.q / AMPLITUDE - (angle * step as f64).cos()).abs() < 1e-8, "ω {}, h {step_s}", mode.omega_per_s);
            }
        }
    }
}

#[test]
fn newmark_and_generalised_alpha_converge_at_second_order() {
    let mode = &Mode::all(&tissue(&SPRUNG))[3];
    let duration_s = 1.3 * TAU / mode.omega_per_s;
    let exact = AMPLITUDE * (mode.omega_per_s * duration_s).cos();
    let order = |scheme| {
        let error = |count| (mode.released(scheme, duration_s / count as f64, count)[count].q - exact).abs();
        (error(100) / error(200)).log2()
    };
    assert!((order(TimeScheme::BackwardEuler) - 1.0).abs() < 0.05);
    for spectral_radius in [0.0, 0.5, 0.8, 1.0] {
        let found = order(TimeScheme::GeneralisedAlpha { spectral_radius });
        assert!((found - 2.0).abs() < 0.05, "ρ∞ {spectral_radius}: order {found}");
    }
}

/// The amplification matrix of \[ChungHulbert1993\] for (q, h q̇, h² a) at Ω = ωh.
fn amplification(spectral_radius: f64, angle: f64) -> Matrix3<f64> {
    let alpha_mass = (2.0 * spectral_radius - 1.0) / (spectral_radius + 1.0);
    let alpha_force = spectral_radius / (spectral_radius + 1.0);
    let gamma = 0.5 - alpha_mass + alpha_force;
    let beta = (1.0 - alpha_mass + alpha_force).powi(2) / 4.0;
    let square = angle * angle;
    let after = Matrix3::new(1.0, 0.0, -beta, 0.0, 1.0, -gamma, (1.0 - alpha_force) * square, 0.0, 1.0 - alpha_mass);
    let before = Matrix3::new(1.0, 1.0, 0.5 - beta, 0.0, 1.0, 1.0 - gamma, -alpha_force * square, 0.0, -alpha_mass);
    after.try_inverse().unwrap() * before
}

/// By Cayley and Hamilton q⁺⁺⁺ = tr A q⁺⁺ − m q⁺ + det A q, m the sum of the principal minors: the motion has the amplification matrix of
/// the literature at every frequency, and that matrix leaves ρ∞ of the fastest modes.
#[test]
fn generalised_alpha_has_the_spectrum_of_chung_and_hulbert() {
    let modes = Mode::all(&tissue(&SPRUNG));
    for spectral_radius in [0.0, 0.3, 0.8, 1.0] {
        let scheme = TimeScheme::GeneralisedAlpha { spectral_radius };
        for (mode, step_s) in [(&modes[0], 0.002), (&modes[20], 0.005), (&modes[60], 0.02)] {
            let matrix = amplification(spectral_radius, mode.omega_per_s * step_s);
            let (trace, determinant) = (matrix.trace(), matrix.determinant());
            let minors = (trace * trace - (matrix * matrix).trace()) / 2.0;
            let phases = mode.released(scheme, step_s, 8);
            for four in phases.windows(4) {
                let expected = trace * four[2].q - minors * four[1].q + determinant * four[0].q;
                assert!((four[3].q - expected).abs() < 1e-8 * AMPLITUDE, "ρ∞ {spectral_radius}, ωh {}", mode.omega_per_s * step_s);
            }
        }
        let fastest = amplification(spectral_radius, 1e6).complex_eigenvalues().iter().map(|value| value.norm()).fold(0.0, f64::max);
        // A root of multiplicity three feels rounding by its cube root.
        assert!((fastest - spectral_radius).abs() < 1e-3, "{fastest} {spectral_radius}");
    }
}

/// With C = αM + βK a mode of the free tissue has the damping ratio ζ = α/(2ω) + βω/2: q̈ + 2ζω q̇ + ω² q = 0.
#[test]
fn rayleigh_damping_gives_every_mode_its_closed_form_ratio() {
    let (alpha_per_s, beta_s) = (50.0, 0.0002);
    let undamped = tissue(&ANISOTROPIC);
    let damped = tissue(&PassiveProperties { damping_mass_per_s: alpha_per_s, damping_stiffness_s: beta_s, ..ANISOTROPIC });
    let modes = Mode::all(&undamped);
    assert!(modes[5].omega_per_s < 1e-3 * modes[6].omega_per_s, "free tissue has six rigid motions");
    for mode in [&modes[6], &modes[20], &modes[60]] {
        let omega = mode.omega_per_s;
        let ratio = alpha_per_s / (2.0 * omega) + beta_s * omega / 2.0;
        let duration_s = 0.7 * TAU / omega;
        let damped_omega = omega * (1.0 - ratio * ratio).sqrt();
        let exact = (-ratio * omega * duration_s).exp()
            * ((damped_omega * duration_s).cos() + ratio * omega / damped_omega * (damped_omega * duration_s).sin());
        let error = |count: usize| {
            let phases = mode.release(&damped, TRAPEZOIDAL, duration_s / count as f64, count, -omega * omega * AMPLITUDE);
            phases[count].q / AMPLITUDE - exact
        };
        let (coarse, fine) = (error(100), error(200));
        println!("ω {omega:.1}/s, ζ {ratio:.4}: errors {coarse:.2e} {fine:.2e}");
        // Second order: what two steps extrapolate to is of fourth, (2π 0.7/100)⁴ ≈ 4e-6.
        assert!(((4.0 * fine - coarse) / 3.0).abs() < 1e-5 && (coarse / fine - 4.0).abs() < 0.2);
    }
}

/// A nearly rigid cube that slides in dashpots on its faces ±z, of area A each: m v̇ = −2 A c v. Backward Euler shrinks v by
/// 1 + 2 A c h/m a step.
#[test]
fn pericardial_dashpots_slow_the_heart_by_area_times_damping() {
    let (damping, step_s, side_mm) = (2e-5, 0.001, 6.0);
    let properties = PassiveProperties { pericardium_damping_kpa_s_per_mm: damping, ..meshes::bare(1e5, 0.3) };
    let operator = StepOperator::new(tissue(&properties), step_s).unwrap();
    let tissue = operator.myocardium();
    let mass_kg: f64 = tissue.vertex_mass_kg().iter().sum();
    let speed = |state: &MotionState| -> f64 {
        state.velocity_mm_per_s.iter().zip(tissue.vertex_mass_kg()).map(|(v, m)| v.z * m).sum::<f64>() / mass_kg
    };
    let mut state = MotionState::at_rest(tissue.rest_mm().to_vec());
    state.velocity_mm_per_s.fill(Vector3::z() * 100.0);
    let mut system = operator.empty_system();
    let factor = 1.0 + 2.0 * side_mm * side_mm * damping * step_s / mass_kg;
    assert!(factor > 1.005, "the dashpots must be felt: {factor}");
    for step in 1..=50 {
        operator.assemble(&state, None, &mut system).unwrap();
        let mut position_mm = state.position_mm.clone();
        StepSolver::default().solve(&operator, &system, &mut position_mm, &mut []).unwrap();
        state = operator.advance(&state, position_mm);
        let exact = 100.0 / factor.powi(step);
        assert!((speed(&state) / exact - 1.0).abs() < 1e-5, "step {step}: {} against {exact} mm/s", speed(&state));
    }
}

/// The bound of explicit image forces, against the gain at which a stepped piece of tissue is seen to break: springs of all sizes on a
/// face, with mass and stiffness damping, in small steps, where masses decide, and in large ones, where stiffness does.
#[test]
fn explicit_springs_break_at_the_bound_of_their_gain() {
    let damped = PassiveProperties { damping_mass_per_s: 10.0, damping_stiffness_s: 0.01, ..SPRUNG };
    let tissue = tissue(&damped);
    let on_a_face = (0..tissue.vertex_count()).filter(|&vertex| tissue.rest_mm()[vertex].z < 1e-9);
    let springs: Vec<ExplicitSpring> = on_a_face
        .enumerate()
        .map(|(number, vertex)| ExplicitSpring {
            vertex,
            direction: Vector3::new(0.3 * (number as f64).sin(), 0.2, -1.0).normalize(),
            stiffness_mn_per_mm: 1.0 + 0.4 * (1.7 * number as f64).cos(),
        })
        .collect();
    for step_s in [2e-4, 1e-3, 5e-3] {
        let limit = explicit_spring_limit(&tissue, step_s, &springs).unwrap();
        let operator = StepOperator::new(Arc::clone(&tissue), step_s).unwrap();
        // What many steps leave of an error of 1 µm, mm.
        let left_mm = |factor: f64| {
            let mut system = operator.empty_system();
            let mut solver = StepSolver::default();
            let mut position_mm = tissue.rest_mm().to_vec();
            springs.iter().for_each(|spring| position_mm[spring.vertex] += spring.direction * 1e-3);
            let mut state = MotionState::at_rest(position_mm);
            let mut size_mm = 0.0;
            for _ in 0..1200 {
                operator.assemble(&state, None, &mut system).unwrap();
                for spring in &springs {
                    let error_mm = spring.direction.dot(&(state.position_mm[spring.vertex] - tissue.rest_mm()[spring.vertex]));
                    system.force_mn[spring.vertex] -= spring.direction * (error_mm * factor * spring.stiffness_mn_per_mm);
                }
                let mut next_mm = state.position_mm.clone();
                solver.solve(&operator, &system, &mut next_mm, &mut []).unwrap();
                state = operator.advance(&state, next_mm);
                size_mm = state.position_mm.iter().zip(tissue.rest_mm()).map(|(y, x)| (y - x).norm()).fold(0.0, f64::max);
                if size_mm > 1e6 {
                    break;
                }
            }
            size_mm
        };
        let (below_mm, beyond_mm) = (left_mm(0.98 * limit), left_mm(1.04 * limit));
        assert!(below_mm < 1e-3, "h = {step_s} s: springs below the bound {limit} are unstable: {below_mm} mm");
        assert!(beyond_mm > 1.0, "h = {step_s} s: springs beyond the bound {limit} are stable: {beyond_mm} mm");
    }
}
