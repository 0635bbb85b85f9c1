//! Corotational kinematics: finite strain and rotation against closed forms, through the step operator and its Newton corrections.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panicking, and may show its figures")]

use std::sync::Arc;

use cardiotwin::mechanics::{
    Kinematics, Linearisation, MechanicsError, MotionState, Myocardium, PassiveProperties, StepOperator, StepSettings, StepSolver,
    StepSystem, TimeScheme,
};
use cardiotwin::mesh::TetMesh;
use cardiotwin::numerics::TaylorTest;
use nalgebra::{DVector, Matrix3, Rotation3, Vector3};

mod meshes;

const BARE: PassiveProperties = PassiveProperties {
    fibre_stiffness_kpa: 30.0,
    transverse_stiffness_kpa: 12.0,
    poisson_ratio: 0.4,
    density_kg_per_mm3: 1e-6,
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

fn operator(tissue: &Arc<Myocardium>, step_s: f64, scheme: TimeScheme) -> StepOperator {
    let settings = StepSettings { step_s, scheme, kinematics: Kinematics::Corotational };
    StepOperator::with_settings(Arc::clone(tissue), settings).unwrap()
}

/// A block whose fibres differ from element to element, held at x = 0.
fn held_block(properties: &PassiveProperties) -> (TetMesh, Arc<Myocardium>) {
    let (mesh, surface) = meshes::block(Vector3::new(12.0, 9.0, 6.0), [4, 3, 2]);
    let axes: Vec<Matrix3<f64>> =
        (0..mesh.tetrahedron_count()).map(|t| *Rotation3::from_euler_angles(0.02 * t as f64, 0.2, 0.3).matrix()).collect();
    let tissue = Myocardium::new(&mesh, &surface, &axes, properties).unwrap();
    (mesh, Arc::new(tissue))
}

/// The system of a step from a state under fibre tension and dead forces.
fn loaded(operator: &StepOperator, state: &MotionState, stress_kpa: f64, load_mn: &[Vector3<f64>]) -> StepSystem {
    let mut system = operator.empty_system();
    operator.assemble(state, None, &mut system).unwrap();
    operator.add_contraction(&vec![stress_kpa; operator.myocardium().tetrahedron_count()], &mut system).unwrap();
    system.force_mn.iter_mut().zip(load_mn).for_each(|(sum, f)| *sum += f);
    system
}

/// Newton's rounds of one step; gives the end positions and how far each round moved the trial.
fn newton(operator: &StepOperator, state: &MotionState, system: &mut StepSystem) -> (Vec<Vector3<f64>>, Vec<f64>) {
    let mut solver = StepSolver::default();
    let mut trial = state.position_mm.clone();
    let mut columns = vec![trial.clone()];
    let mut moves = vec![];
    for _ in 0..30 {
        operator.linearise(&trial, Linearisation::Exact, system).unwrap();
        operator.residual(system, &mut columns[0]).unwrap();
        solver.correct(operator, system, &mut columns, 1e-9).unwrap();
        trial.iter_mut().zip(&columns[0]).for_each(|(y, correction)| *y += correction);
        moves.push(columns[0].iter().map(Vector3::norm).fold(0.0, f64::max));
        if moves.last().is_some_and(|moved| *moved < 1e-9) {
            break;
        }
    }
    (trial, moves)
}

fn flat(field: &[Vector3<f64>]) -> DVector<f64> {
    DVector::from_iterator(3 * field.len(), field.iter().flat_map(|v| v.iter().copied()))
}

fn field(flat: &DVector<f64>) -> Vec<Vector3<f64>> {
    flat.as_slice().chunks(3).map(Vector3::from_column_slice).collect()
}

/// A free homogeneous body that starts turned: along the fibre $E(\lambda - 1) + \sigma\lambda = 0$, across it
/// $\lambda_t - 1 = \nu(1 - \lambda)$, for any tension.
#[test]
fn a_turned_bar_under_a_large_fibre_tension_shortens_as_the_closed_form() {
    let (mesh, surface) = meshes::block(Vector3::new(20.0, 7.0, 5.0), [5, 3, 2]);
    let axes = *Rotation3::from_euler_angles(0.3, -0.7, 1.1).matrix();
    let tissue = Arc::new(Myocardium::new(&mesh, &surface, &vec![axes; mesh.tetrahedron_count()], &BARE).unwrap());
    let turn = Rotation3::from_euler_angles(1.5, 0.4, -2.2);
    let state = MotionState::at_rest(mesh.vertices_mm().iter().map(|x| turn * x).collect());
    for stress_kpa in [9.0, 20.0] {
        let operator = operator(&tissue, 1.0, TimeScheme::BackwardEuler);
        let mut system = loaded(&operator, &state, stress_kpa, &[]);
        let (position, moves) = newton(&operator, &state, &mut system);
        println!("moves {moves:?}");
        let along = BARE.fibre_stiffness_kpa / (BARE.fibre_stiffness_kpa + stress_kpa);
        let across = 1.0 + BARE.poisson_ratio * (1.0 - along);
        let stretch = axes * Matrix3::from_diagonal(&Vector3::new(along, across, across)) * axes.transpose();
        for (x, y) in mesh.vertices_mm().iter().zip(&position).skip(1) {
            let (edge, deformed) = (x - mesh.vertices_mm()[0], y - position[0]);
            assert!((deformed.norm() / (stretch * edge).norm() - 1.0).abs() < 1e-5);
        }
    }
}

/// A bar under fibre tension that resists a change of volume, ν = 0: with λ along, μ across and J = λ μ² the balance along and across is
/// E_f (λ − 1) + σ λ + κ (J − 1) μ² = 0 and E_t (μ − 1) + κ (J − 1) λ μ = 0; the more κ the less volume is lost.
#[test]
fn a_bar_that_contracts_keeps_its_volume_as_the_closed_form() {
    let stress_kpa = 20.0;
    let turn = *Rotation3::from_euler_angles(0.3, -0.7, 1.1).matrix();
    let (mesh, surface) = meshes::block(Vector3::new(20.0, 7.0, 5.0), [5, 3, 2]);
    let lost = [0.0, 100.0, 3000.0].map(|kappa_kpa| {
        let across_of = |along: f64| {
            root(|across| BARE.transverse_stiffness_kpa * (across - 1.0) + kappa_kpa * (along * across * across - 1.0) * along * across)
        };
        let along = root(|along| {
            let across = across_of(along);
            let pressure_kpa = kappa_kpa * (along * across * across - 1.0);
            BARE.fibre_stiffness_kpa * (along - 1.0) + stress_kpa * along + pressure_kpa * across * across
        });
        let across = across_of(along);
        let properties = PassiveProperties { poisson_ratio: 0.0, volume_stiffness_kpa: kappa_kpa, ..BARE };
        let tissue = Arc::new(Myocardium::new(&mesh, &surface, &vec![turn; mesh.tetrahedron_count()], &properties).unwrap());
        let operator = operator(&tissue, 1.0, TimeScheme::BackwardEuler);
        let residual_mn = |along: f64| {
            let stretch = turn * Matrix3::from_diagonal(&Vector3::new(along, across, across)) * turn.transpose();
            let state = MotionState::at_rest(mesh.vertices_mm().iter().map(|x| stretch * x).collect());
            let mut system = loaded(&operator, &state, stress_kpa, &[]);
            operator.update_force(&state.position_mm, &mut system).unwrap();
            let mut residual = state.position_mm.clone();
            operator.residual(&system, &mut residual).unwrap();
            flat(&residual).norm()
        };
        let (balanced, off) = (residual_mn(along), residual_mn(1.001 * along));
        assert!(balanced < 1e-6 * off, "{balanced} mN, {off} mN a thousandth beside it, with κ {kappa_kpa} kPa");
        1.0 - along * across * across
    });
    assert!((lost[0] - 0.4).abs() < 1e-9 && lost[1] < 0.15 && lost[2] < 0.01, "{lost:?}");
}

/// The root of a rising function between a third and three.
fn root(rising: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (1.0 / 3.0, 3.0);
    for _ in 0..80 {
        let middle = (low + high) / 2.0;
        if rising(middle) < 0.0 { low = middle } else { high = middle }
    }
    (low + high) / 2.0
}

/// A growth by s costs V κ/2 (s³ − 1)² more, and V κ/2 (3 (s − 1))² in linear kinematics.
#[test]
fn growth_costs_the_volume_stiffness_in_both_kinematics() {
    let (kappa_kpa, growth) = (70.0, 1.2);
    let [plain, stiff] = [0.0, kappa_kpa].map(|kappa| held_block(&PassiveProperties { volume_stiffness_kpa: kappa, ..BARE }));
    let volume_mm3 = 12.0 * 9.0 * 6.0;
    let grown: Vec<_> = plain.0.vertices_mm().iter().map(|x| x * growth).collect();
    let relaxed = vec![0.0; plain.0.tetrahedron_count()];
    let [linear, corotational] = [
        stiff.1.elastic_energy_mn_mm(&grown) - plain.1.elastic_energy_mn_mm(&grown),
        stiff.1.corotational_energy_mn_mm(&grown, &relaxed).unwrap() - plain.1.corotational_energy_mn_mm(&grown, &relaxed).unwrap(),
    ];
    let cost = |strain: f64| volume_mm3 * kappa_kpa / 2.0 * strain * strain;
    assert!((linear / cost(3.0 * (growth - 1.0)) - 1.0).abs() < 1e-9, "{linear}");
    assert!((corotational / cost(growth.powi(3) - 1.0) - 1.0).abs() < 1e-9, "{corotational}");
}

/// The balance of a whole step has the tangent it says, in both time schemes, damped and with springs.
#[test]
fn the_tangent_of_a_whole_step_leaves_a_second_order_remainder() {
    let held = PassiveProperties {
        volume_stiffness_kpa: 60.0,
        base_stiffness_isotropic_kpa_per_mm: 10.0,
        damping_stiffness_s: 0.01,
        damping_mass_per_s: 10.0,
        pericardium_stiffness_kpa_per_mm: 0.1,
        pericardium_damping_kpa_s_per_mm: 0.005,
        ..BARE
    };
    let (mesh, tissue) = held_block(&held);
    for scheme in [TimeScheme::BackwardEuler, TimeScheme::GeneralisedAlpha { spectral_radius: 0.6 }] {
        let operator = operator(&tissue, 0.01, scheme);
        let turn = Rotation3::from_euler_angles(0.2, -0.1, 0.4);
        let mut state = MotionState::at_rest(mesh.vertices_mm().iter().map(|x| turn * x + Vector3::new(0.0, 0.1 * x.x, 0.0)).collect());
        state.velocity_mm_per_s = mesh.vertices_mm().iter().map(|x| Vector3::new(x.y, -2.0 * x.x, x.z) * 3.0).collect();
        let mut system = loaded(&operator, &state, 40.0, &[]);
        system.stiffness_mn_per_mm[7] = Matrix3::new(20.0, 3.0, 0.0, 3.0, 5.0, 1.0, 0.0, 1.0, 4.0);
        let base = flat(&state.position_mm);
        let residual = |x: &DVector<f64>| {
            let (mut there, mut residual) = (system.clone(), state.position_mm.clone());
            operator.update_force(&field(x), &mut there)?;
            operator.residual(&there, &mut residual)?;
            Ok::<_, MechanicsError>(flat(&residual))
        };
        let mut linearised = system.clone();
        operator.linearise(&state.position_mm, Linearisation::Exact, &mut linearised).unwrap();
        for seed in 0..2 {
            let direction = DVector::from_fn(base.len(), |i, _| (1.7 * i as f64 + 2.3 * f64::from(seed)).sin());
            // The correction of A d is d, so the derivative is taken from the solver as well as from the operator.
            let step = 1e-3;
            let slope = (residual(&(&base + &direction * step)).unwrap() - residual(&(&base - &direction * step)).unwrap()) / (2.0 * step);
            let mut columns = vec![field(&-slope)];
            StepSolver::default().correct(&operator, &linearised, &mut columns, 1e-12).unwrap();
            assert!((flat(&columns[0]) - &direction).norm() < 1e-5 * direction.norm());
            let mut negative = field(&direction);
            operator.multiply(&linearised, &field(&direction), &mut negative).unwrap();
            let test = TaylorTest::run(residual, &base, &direction, &-flat(&negative), 0.02, 6).unwrap();
            assert!((test.order() - 2.0).abs() < 0.15, "{test:?}");
        }
    }
}

/// The last rounds square the error: the tangent is consistent.
#[test]
fn newton_converges_quadratically() {
    let held = PassiveProperties { base_stiffness_isotropic_kpa_per_mm: 10.0, damping_stiffness_s: 0.01, ..BARE };
    let (mesh, tissue) = held_block(&held);
    let operator = operator(&tissue, 0.01, TimeScheme::BackwardEuler);
    let state = MotionState::at_rest(mesh.vertices_mm().to_vec());
    let (_, moves) = newton(&operator, &state, &mut loaded(&operator, &state, 60.0, &[]));
    println!("moves {moves:?}");
    assert!(moves.len() <= 8, "{moves:?}");
    let late: Vec<f64> = moves.iter().copied().filter(|m| *m < 0.3 && *m > 1e-5).collect();
    assert!(late.len() >= 2);
    for pair in late.windows(2) {
        assert!(pair[1] < 0.5 * pair[0].powf(1.5), "{moves:?}");
    }
}

/// Both kinematics agree to second order in the load.
#[test]
fn small_strains_are_those_of_linear_kinematics() {
    let held = PassiveProperties { base_stiffness_isotropic_kpa_per_mm: 10.0, damping_stiffness_s: 0.01, ..BARE };
    let (mesh, tissue) = held_block(&held);
    let state = MotionState::at_rest(mesh.vertices_mm().to_vec());
    let difference = |amplitude: f64| {
        let load: Vec<_> = mesh.vertices_mm().iter().map(|x| Vector3::new(0.1 * x.y, x.x, 0.0) * amplitude).collect();
        let corotational = operator(&tissue, 0.01, TimeScheme::BackwardEuler);
        let (turned, _) = newton(&corotational, &state, &mut loaded(&corotational, &state, 20.0 * amplitude, &load));
        let linear = StepOperator::new(Arc::clone(&tissue), 0.01).unwrap();
        let system = loaded(&linear, &state, 20.0 * amplitude, &load);
        let mut straight = state.position_mm.clone();
        StepSolver::default().solve(&linear, &system, &mut straight, &mut []).unwrap();
        (flat(&turned) - flat(&straight)).norm()
    };
    let differences = [0.1, 0.05, 0.025].map(difference);
    println!("{differences:?} mm");
    for pair in differences.windows(2) {
        assert!(((pair[0] / pair[1]).log2() - 2.0).abs() < 0.1, "{differences:?}");
    }
}

/// A body at rest in another place and attitude stays there; linear kinematics would take its rotation for growth.
#[test]
fn a_turned_body_is_at_rest() {
    let (mesh, tissue) = held_block(&PassiveProperties { damping_stiffness_s: 0.01, ..BARE });
    let turn = Rotation3::from_euler_angles(0.4, 1.0, -0.5);
    let state = MotionState::at_rest(mesh.vertices_mm().iter().map(|x| turn * x + Vector3::repeat(30.0)).collect());
    let moved = |position: &[Vector3<f64>]| (flat(position) - flat(&state.position_mm)).amax();
    let corotational = operator(&tissue, 0.01, TimeScheme::BackwardEuler);
    let (position, _) = newton(&corotational, &state, &mut loaded(&corotational, &state, 0.0, &[]));
    assert!(moved(&position) < 1e-9, "moved {} mm", moved(&position));
    let linear = StepOperator::new(Arc::clone(&tissue), 0.01).unwrap();
    let mut position = state.position_mm.clone();
    StepSolver::default().solve(&linear, &loaded(&linear, &state, 0.0, &[]), &mut position, &mut []).unwrap();
    assert!(moved(&position) > 0.1, "linear kinematics moved {} mm only", moved(&position));
}

fn kinetic_energy(tissue: &Myocardium, state: &MotionState) -> f64 {
    tissue.vertex_mass_kg().iter().zip(&state.velocity_mm_per_s).map(|(m, v)| m * v.norm_squared() / 2.0).sum()
}

/// β damps strain and not rotation: a spin keeps its energy under it, step by step of the trapezoidal rule.
#[test]
fn a_spinning_body_keeps_its_energy_under_stiffness_damping() {
    let spin = Vector3::new(0.0, 0.0, 20.0);
    let kept = |properties: &PassiveProperties| {
        let (mesh, tissue) = held_block(properties);
        let operator = operator(&tissue, 0.005, TimeScheme::GeneralisedAlpha { spectral_radius: 1.0 });
        let centre = Vector3::new(6.0, 4.5, 3.0);
        let mut state = MotionState::at_rest(mesh.vertices_mm().to_vec());
        for (vertex, x) in mesh.vertices_mm().iter().enumerate() {
            state.velocity_mm_per_s[vertex] = spin.cross(&(x - centre));
            state.acceleration_mm_per_s2[vertex] = spin.cross(&spin.cross(&(x - centre)));
        }
        state.algorithmic_acceleration_mm_per_s2.clone_from(&state.acceleration_mm_per_s2);
        let start = kinetic_energy(&tissue, &state);
        for _ in 0..60 {
            let (position, _) = newton(&operator, &state, &mut loaded(&operator, &state, 0.0, &[]));
            state = operator.advance(&state, position);
        }
        kinetic_energy(&tissue, &state) / start
    };
    let (damped, free) = (kept(&PassiveProperties { damping_stiffness_s: 0.02, ..BARE }), kept(&BARE));
    println!("kinetic energy kept over nearly one turn: {damped} damped, {free} free");
    assert!((damped - 1.0).abs() < 2e-3 && (free - 1.0).abs() < 2e-3, "{damped} {free}");
}

/// Backward Euler with damping only ever takes energy out, also where a free body twists to and fro by large angles.
#[test]
fn the_energy_of_a_free_swing_decays() {
    let (mesh, tissue) = held_block(&PassiveProperties { damping_stiffness_s: 1e-4, ..BARE });
    let operator = operator(&tissue, 2e-4, TimeScheme::BackwardEuler);
    let mut state = MotionState::at_rest(mesh.vertices_mm().to_vec());
    let centre = Vector3::new(6.0, 4.5, 3.0);
    let swing = |x: &Vector3<f64>| Vector3::new(150.0 * (x.x - centre.x), 0.0, 0.0).cross(&(x - centre));
    state.velocity_mm_per_s = mesh.vertices_mm().iter().map(swing).collect();
    let relaxed = vec![0.0; mesh.tetrahedron_count()];
    let energy =
        |state: &MotionState| kinetic_energy(&tissue, state) + tissue.corotational_energy_mn_mm(&state.position_mm, &relaxed).unwrap();
    let (start, mut before, mut farthest) = (energy(&state), energy(&state), 0.0f64);
    for _ in 0..100 {
        let (position, _) = newton(&operator, &state, &mut loaded(&operator, &state, 0.0, &[]));
        state = operator.advance(&state, position);
        let after = energy(&state);
        assert!(after <= before, "{before} then {after} mN·mm");
        before = after;
        farthest = farthest.max((flat(&state.position_mm) - flat(mesh.vertices_mm())).amax());
    }
    println!("energy {start} -> {before} mN·mm, farthest {farthest} mm");
    assert!(farthest > 1.5 && before < 0.05 * start, "farthest {farthest} mm, {before} of {start} mN·mm left");
}

/// Elastica: a cantilever under a tip load P with P L²/EI = 2 sinks by 0.4935 L and comes in by 0.1606 L \[Mattiasson1981\].
/// Linear tetrahedra are too stiff in bending: two meshes are extrapolated at second order.
#[test]
fn a_cantilever_bends_as_the_elastica() {
    let (length_mm, depth_mm, stiffness_kpa) = (100.0, 10.0, 100.0);
    let inertia_mm4 = f64::powi(depth_mm, 4) / 12.0;
    let load_mn = 2.0 * stiffness_kpa * inertia_mm4 / (length_mm * length_mm);
    let tip = |refinement: usize| {
        let cells = [16 * refinement, 2 * refinement, 2 * refinement];
        let (mesh, surface) = meshes::block(Vector3::new(length_mm, depth_mm, depth_mm), cells);
        let properties = PassiveProperties {
            fibre_stiffness_kpa: stiffness_kpa,
            transverse_stiffness_kpa: stiffness_kpa,
            poisson_ratio: 0.0,
            base_stiffness_isotropic_kpa_per_mm: 1e4,
            ..BARE
        };
        let axes = vec![Matrix3::identity(); mesh.tetrahedron_count()];
        let tissue = Arc::new(Myocardium::new(&mesh, &surface, &axes, &properties).unwrap());
        let operator = operator(&tissue, 10.0, TimeScheme::BackwardEuler);
        let end: Vec<usize> = (0..mesh.vertex_count()).filter(|&v| mesh.vertices_mm()[v].x == length_mm).collect();
        let mut state = MotionState::at_rest(mesh.vertices_mm().to_vec());
        for fraction in [0.25, 0.5, 0.75, 1.0] {
            let mut force = vec![Vector3::zeros(); mesh.vertex_count()];
            end.iter().for_each(|&v| force[v].z = fraction * load_mn / end.len() as f64);
            let (position, moves) = newton(&operator, &state, &mut loaded(&operator, &state, 0.0, &force));
            println!("load {fraction}: {} rounds", moves.len());
            state = MotionState::at_rest(position);
        }
        let mean =
            |axis: usize| end.iter().map(|&v| state.position_mm[v][axis] - mesh.vertices_mm()[v][axis]).sum::<f64>() / end.len() as f64;
        Vector3::new(-mean(0), 0.0, mean(2)) / length_mm
    };
    let (coarse, fine) = (tip(2), tip(4));
    let extrapolated = (fine * 4.0 - coarse) / 3.0;
    println!("coarse {coarse:?}, fine {fine:?}, extrapolated {extrapolated:?}");
    assert!((extrapolated.z - 0.4935).abs() < 0.01, "sinks {} L", extrapolated.z);
    assert!((extrapolated.x - 0.1606).abs() < 0.01, "comes in {} L", extrapolated.x);
}

#[test]
fn one_thread_and_two_find_the_same_bits() {
    let (mesh, tissue) = held_block(&PassiveProperties { base_stiffness_isotropic_kpa_per_mm: 10.0, damping_stiffness_s: 0.01, ..BARE });
    let state = MotionState::at_rest(mesh.vertices_mm().to_vec());
    let end = |thread_count: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(thread_count).build().unwrap();
        let operator = operator(&tissue, 0.01, TimeScheme::BackwardEuler);
        pool.install(|| newton(&operator, &state, &mut loaded(&operator, &state, 60.0, &[])))
    };
    assert_eq!(end(1), end(2));
}

#[test]
fn a_system_that_was_not_linearised_is_refused() {
    let (mesh, tissue) = held_block(&BARE);
    let operator = operator(&tissue, 0.01, TimeScheme::BackwardEuler);
    let state = MotionState::at_rest(mesh.vertices_mm().to_vec());
    let mut system = loaded(&operator, &state, 1.0, &[]);
    let mut columns = vec![state.position_mm.clone()];
    let mut solver = StepSolver::default();
    assert_eq!(solver.correct(&operator, &system, &mut columns, 1e-8), Err(MechanicsError::NotLinearised));
    assert_eq!(solver.solve(&operator, &system, &mut columns[0], &mut []), Err(MechanicsError::NotLinearised));
    operator.linearise(&state.position_mm, Linearisation::Exact, &mut system).unwrap();
    solver.correct(&operator, &system, &mut columns, 1e-8).unwrap();
}
