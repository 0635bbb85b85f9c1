//! What the benches share: idealised left ventricles by size, and medians of things timed in turn.
#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "every bench takes what it needs, and fails loudly"
)]

use std::sync::Arc;
use std::time::Duration;

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings};
use cardiotwin::heart::{HeartModel, ModelSettings, Parameter, Parameters};
use cardiotwin::mechanics::{Kinematics, Myocardium, PassiveProperties, StepOperator};
use cardiotwin::numerics::median;
use cardiotwin::phantom::IdealisedLv;
use criterion::Criterion;
use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use rustix::time::{ClockId, clock_gettime};

/// Number of vertices and the edge length that gives about so many.
pub const SIZES: [(&str, f64); 3] = [("5k", 4.05), ("15k", 2.66), ("40k", 1.85)];

/// An idealised left ventricle.
pub fn left_ventricle(edge_length_mm: f64) -> Arc<Anatomy> {
    Arc::new(IdealisedLv::default().build(&MesherSettings::with_edge_length_mm(edge_length_mm), &AnatomySettings::default()).unwrap())
}

/// The tissue of the benches.
pub const PROPERTIES: PassiveProperties = PassiveProperties {
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
    volume_stiffness_kpa: 0.0,
    pericardium_base_share: 1.0,
    valve_ring_height_mm: 0.0,
    valve_ring_stiffness_kpa: 0.0,
};

/// Its step of 5 ms.
pub fn step_operator(anatomy: &Anatomy) -> StepOperator {
    let tissue = Myocardium::new(&anatomy.mesh, &anatomy.surface, &anatomy.fibre_axes, &PROPERTIES).unwrap();
    StepOperator::new(Arc::new(tissue), 0.005).unwrap()
}

/// It ready to beat in steps of 5 ms with the default parameters.
pub fn heart(edge_length_mm: f64) -> HeartModel {
    HeartModel::new(left_ventricle(edge_length_mm), Parameters::default(), ModelSettings::default()).unwrap()
}

/// The same of soft tissue under large rotations.
pub fn soft_heart(edge_length_mm: f64) -> HeartModel {
    let values = [
        (Parameter::FibreStiffness, 30.0),
        (Parameter::TransverseStiffness, 20.0),
        (Parameter::ContractionPeakLv, 80.0),
        (Parameter::ContractionRate, 15.0),
        (Parameter::RelaxationRate, 25.0),
    ];
    let parameters = values.iter().fold(Parameters::default(), |all, &(parameter, value)| all.with(parameter, value).unwrap());
    let settings = ModelSettings { kinematics: Kinematics::Corotational, ..ModelSettings::default() };
    HeartModel::new(left_ventricle(edge_length_mm), parameters, settings).unwrap()
}

/// Seconds that this process has computed, on all its threads: others' use of the machine does not count.
pub fn processor_s() -> f64 {
    let used = clock_gettime(ClockId::ProcessCPUTime);
    used.tv_sec as f64 + used.tv_nsec as f64 * 1e-9
}

/// Criterion's measurement by [`processor_s`].
pub struct ProcessorTime;

impl Measurement for ProcessorTime {
    type Intermediate = f64;
    type Value = Duration;

    fn start(&self) -> f64 {
        processor_s()
    }

    fn end(&self, start: f64) -> Duration {
        Duration::from_secs_f64((processor_s() - start).max(0.0))
    }

    fn add(&self, first: &Duration, second: &Duration) -> Duration {
        *first + *second
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        WallTime.to_f64(value)
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        static CLOCK: WallTime = WallTime;
        CLOCK.formatter()
    }
}

/// Ten samples of processor time.
pub fn criterion() -> Criterion<ProcessorTime> {
    Criterion::default().with_measurement(ProcessorTime).sample_size(10).configure_from_args()
}

/// Something to time, by name.
pub type Timed<'a> = (&'a str, Box<dyn FnMut() + 'a>);

/// Times things in turn, A B C A B C …, by the processor, and prints the median of each and of its rounds' ratios to the first.
pub fn print_in_turn(title: &str, round_count: usize, things: Vec<Timed<'_>>) {
    print_in_turn_by(processor_s, title, round_count, things);
}

/// [`print_in_turn`] by another clock, in seconds.
pub fn print_in_turn_by(clock_s: impl Fn() -> f64, title: &str, round_count: usize, mut things: Vec<Timed<'_>>) {
    things.iter_mut().for_each(|(_, thing)| thing());
    let mut rounds: Vec<Vec<f64>> = Vec::new();
    for _ in 0..round_count {
        let timed = things.iter_mut().map(|(_, thing)| {
            let start_s = clock_s();
            thing();
            clock_s() - start_s
        });
        rounds.push(timed.collect());
    }
    println!("{title}, medians in turn, and ratios to the first:");
    for (index, (name, _)) in things.iter().enumerate() {
        let seconds: Vec<f64> = rounds.iter().map(|round| round[index]).collect();
        let ratios: Vec<f64> = rounds.iter().map(|round| round[index] / round[0]).collect();
        println!("    {name:32} {:9.2} ms {:7.2}", median(&seconds).unwrap() * 1e3, median(&ratios).unwrap());
    }
}
