//! The coupled heart: parameters, model, step, beat and observables, [Billet2009] §2.

mod parameters;

pub use parameters::{OutOfRange, Parameter, ParameterSpec, Parameters, Section};
