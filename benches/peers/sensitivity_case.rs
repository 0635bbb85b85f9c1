//! Ishigami's and Sobol's g-function at our designs, and the indices that we read off: what `sensitivity.py` gives to SALib.
//!
//! One line a point, `design x… y`; one an index, `measure input partner value`; a line `=` between them, and an empty one behind.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a peer reads what is printed")]

use std::f64::consts::PI;

use cardiotwin::sensitivity::{Design, MorrisDesign, SobolDesign};

fn ishigami(x: &[f64]) -> f64 {
    let angle = |place: f64| PI * (2.0 * place - 1.0);
    let (x1, x2, x3) = (angle(x[0]), angle(x[1]), angle(x[2]));
    x1.sin() + 7.0 * x2.sin().powi(2) + 0.1 * x3.powi(4) * x1.sin()
}

fn sobol_g(x: &[f64]) -> f64 {
    let coefficients = [0.0, 0.5, 3.0, 9.0, 99.0, 99.0];
    x.iter().zip(coefficients).map(|(x, a)| ((4.0 * x - 2.0).abs() + a) / (1.0 + a)).product()
}

fn print(name: &str, design: &Design, model: fn(&[f64]) -> f64) {
    let values: Vec<f64> = design.points().iter().map(|point| model(point)).collect();
    for (point, value) in design.points().iter().zip(&values) {
        let places: Vec<String> = point.iter().map(f64::to_string).collect();
        println!("{name} {} {value}", places.join(" "));
    }
    println!("=");
    let response: Vec<Option<f64>> = values.into_iter().map(Some).collect();
    for index in design.indices(&response).unwrap() {
        let partner = index.partner.map_or("-".into(), |partner| partner.to_string());
        println!("{:?} {} {partner} {}", index.measure, index.input, index.value);
    }
    println!();
}

fn main() {
    print("sobol", &Design::Sobol(SobolDesign::new(3, 512, true, 1).unwrap()), ishigami);
    print("sobol", &Design::Sobol(SobolDesign::new(6, 512, true, 2).unwrap()), sobol_g);
    print("morris", &Design::Morris(MorrisDesign::new(3, 40, 4, 1).unwrap()), ishigami);
    print("morris", &Design::Morris(MorrisDesign::new(6, 40, 8, 2).unwrap()), sobol_g);
}
