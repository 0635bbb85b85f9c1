//! A personalisation as the program does it, from Rust: a study in text, a listener, what it left. `cargo run --release --example personalise`

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use std::error::Error;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use cardiotwin::report::read_parameters;
use cardiotwin::study::{Config, Overrides, Plan, Progress, RunContext, run};

/// A synthetic patient with σ0 = 150 kPa, coarse, and one parameter to be found.
const STUDY: &str = r#"
kind = "personalise"
[anatomy]
edge_length_mm = 10.0
[anatomy.idealised_lv]
[mechanics]
step_s = 0.02
[phantom]
frames = 8
voxel_size_mm = 2.5
truth = { contraction_peak_lv_kpa = 150.0 }
[personalisation]
volumes = "truth"
boundary = "none"
max_iterations = 6
retrack = false
[[personalisation.parameter]]
name = "contraction_peak_lv_kpa"
lower = 20.0
upper = 400.0
[output]
meshes = false
figures = false
"#;

/// Prints the stages.
struct Stages;

impl Progress for Stages {
    fn stage(&self, name: &str, _: Option<u64>) {
        println!("{name} …");
    }
    fn step(&self, _: u64) {}
    fn finish(&self) {}
    fn warning(&self, text: &str) {
        println!("warning: {text}");
    }
}

pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::temp_dir().join("cardiotwin_example_personalise");
    let overrides = Overrides { output: Some(folder.clone()), ..Overrides::default() };
    let plan = Plan::new(&Config::from_text(Path::new("study.toml"), STUDY.into(), overrides)?)?;
    // Whoever sets this flag ends the run at its next step.
    let stop = AtomicBool::new(false);
    let outcome = run(&plan, &RunContext::new(&Stages, &stop))?;
    println!("{:?}: {}", outcome.status, outcome.headlines.join("; "));
    let found = read_parameters(&folder.join("parameters.csv"))?;
    let sigma = found.iter().find(|row| row.parameter == "contraction_peak_lv_kpa").ok_or("σ0 is not listed")?;
    println!("σ0 = {:.1} kPa [{:?}, {:?}], of 150", sigma.value, sigma.interval_low, sigma.interval_high);
    // The data are the true heart's own volumes: nothing but the search stands between.
    if (sigma.value - 150.0).abs() > 1.0 {
        return Err(format!("σ0 = {} kPa is not the truth", sigma.value).into());
    }
    Ok(())
}
