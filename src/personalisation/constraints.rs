//! Inequalities between parameters: c(θ) ≤ 0, linearised in every step.

use nalgebra::DVector;

use super::{ParameterSpace, PersonalisationError};
use crate::heart::{Parameter, Parameters, Part};

/// A smooth inequality c(θ) ≤ 0 in coordinates.
pub trait InequalityConstraint: Send + Sync {
    /// What it says, for reports.
    fn label(&self) -> &str;
    /// c(θ), of the order of one.
    fn value(&self, coordinates: &DVector<f64>) -> f64;
    /// ∇c(θ).
    fn gradient(&self, coordinates: &DVector<f64>) -> DVector<f64>;
}

/// aᵀθ − b ≤ 0.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearConstraint {
    label: String,
    coefficients: DVector<f64>,
    bound: f64,
}

impl LinearConstraint {
    /// `coefficients` · θ ≤ `bound`.
    ///
    /// # Errors
    /// [`PersonalisationError::Setting`] if a number is not finite or all coefficients are zero.
    pub fn new(label: impl Into<String>, coefficients: DVector<f64>, bound: f64) -> Result<Self, PersonalisationError> {
        let size = coefficients.amax();
        if !(size > 0.0 && size.is_finite() && bound.is_finite() && coefficients.iter().all(|entry| entry.is_finite())) {
            let remedy = "a linear constraint needs finite coefficients, not all zero";
            return Err(PersonalisationError::Setting { what: "linear constraint", value: size, remedy });
        }
        Ok(Self { label: label.into(), coefficients, bound })
    }

    /// `smaller` ≤ `larger`, for example σ0,RV ≤ σ0,LV; at least one of the two must be free, with one transform for both.
    ///
    /// # Errors
    /// [`PersonalisationError::FreeParameter`] if neither is free or their transforms differ.
    pub fn ordered(space: &ParameterSpace, smaller: Parameter, larger: Parameter) -> Result<Self, PersonalisationError> {
        let label = format!("{} <= {}", smaller.spec().name, larger.spec().name);
        let (below, above) = (space.coordinate_index(smaller), space.coordinate_index(larger));
        let transforms: Vec<_> =
            [below, above].iter().flatten().filter_map(|&index| space.free().nth(index)).map(|p| p.transform).collect();
        let refuse = |reason: &str| {
            let (name, region) = (smaller.spec().name, "constraint".to_owned());
            Err(PersonalisationError::FreeParameter { name, region, reason: format!("{label}: {reason}") })
        };
        let Some(&transform) = transforms.first() else { return refuse("neither parameter is free") };
        if transforms.iter().any(|&other| other != transform) {
            return refuse("the two parameters have different transforms");
        }
        let mut coefficients = DVector::zeros(space.dimension());
        let start = space.to_parameters(&space.initial())?;
        let mut bound = 0.0;
        for (index, parameter, sign) in [(below, smaller, 1.0), (above, larger, -1.0)] {
            match index {
                Some(index) => coefficients[index] = sign,
                None => bound -= sign * transform.to_coordinate(start[parameter]),
            }
        }
        Self::new(label, coefficients, bound)
    }
}

impl InequalityConstraint for LinearConstraint {
    fn label(&self) -> &str {
        &self.label
    }

    fn value(&self, coordinates: &DVector<f64>) -> f64 {
        self.coefficients.dot(coordinates) - self.bound
    }

    fn gradient(&self, _: &DVector<f64>) -> DVector<f64> {
        self.coefficients.clone()
    }
}

/// The last muscle to depolarise has repolarised before the next beat: t₀ + T_ref v_ref/v + APD ≤ HP − margin, over HP.
#[derive(Debug, Clone, PartialEq)]
pub struct RepolarisedBeforeNextBeat {
    space: ParameterSpace,
    /// T_ref v_ref, mm: the longest way of the activation.
    longest_way_mm: f64,
    margin_s: f64,
}

impl RepolarisedBeforeNextBeat {
    /// `activation_span_s` is the time from the first to the last depolarisation at `reference` parameters; it scales with 1/v.
    pub fn new(space: ParameterSpace, reference: &Parameters, activation_span_s: f64, margin_s: f64) -> Self {
        Self { space, longest_way_mm: activation_span_s * reference[Parameter::ConductionVelocity], margin_s }
    }

    fn at(&self, parameters: &Parameters) -> f64 {
        let last_s = parameters[Parameter::OnsetTime] + self.longest_way_mm / parameters[Parameter::ConductionVelocity];
        let period_s = parameters[Parameter::HeartPeriod];
        (last_s + parameters[Parameter::ActionPotentialDuration] + self.margin_s) / period_s - 1.0
    }
}

impl InequalityConstraint for RepolarisedBeforeNextBeat {
    fn label(&self) -> &str {
        "last depolarisation + APD before the next beat"
    }

    /// NaN where the coordinates leave the physical range.
    fn value(&self, coordinates: &DVector<f64>) -> f64 {
        self.space.to_parameters(coordinates).map_or(f64::NAN, |parameters| self.at(&parameters))
    }

    fn gradient(&self, coordinates: &DVector<f64>) -> DVector<f64> {
        let mut gradient = DVector::zeros(coordinates.len());
        let Ok(parameters) = self.space.to_parameters(coordinates) else { return gradient };
        let period_s = parameters[Parameter::HeartPeriod];
        for (slope, entry) in gradient.iter_mut().zip(self.space.free()) {
            let value = parameters[entry.parameter];
            let physical = match entry.parameter.parameter() {
                _ if entry.parameter.part() != Part::Whole => 0.0,
                Parameter::OnsetTime | Parameter::ActionPotentialDuration => 1.0 / period_s,
                Parameter::ConductionVelocity => -self.longest_way_mm / (value * value * period_s),
                Parameter::HeartPeriod => -(self.at(&parameters) + 1.0) / period_s,
                _ => 0.0,
            };
            *slope = physical * entry.transform.slope(value);
        }
        gradient
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::personalisation::FreeParameter;

    fn space() -> ParameterSpace {
        let free = [
            (Parameter::ConductionVelocity, 200.0, 2000.0),
            (Parameter::ActionPotentialDuration, 0.1, 0.5),
            (Parameter::OnsetTime, -0.1, 0.3),
            (Parameter::HeartPeriod, 0.4, 2.0),
            (Parameter::ContractionPeakRv, 20.0, 300.0),
            (Parameter::ContractionPeakLv, 20.0, 300.0),
        ];
        let free = free.into_iter().map(|(parameter, lower, upper)| FreeParameter::new(parameter).between(lower, upper));
        ParameterSpace::new(Parameters::default(), free.collect()).unwrap()
    }

    #[test]
    fn ordering_is_met_exactly_where_the_values_are_ordered() {
        let space = space();
        let ordered = LinearConstraint::ordered(&space, Parameter::ContractionPeakRv, Parameter::ContractionPeakLv).unwrap();
        let at = |rv: f64, lv: f64| {
            let base = Parameters::default().with(Parameter::ContractionPeakRv, rv).unwrap();
            ordered.value(&space.to_coordinates(&base.with(Parameter::ContractionPeakLv, lv).unwrap()))
        };
        assert!(at(80.0, 90.0) < 0.0 && at(90.0, 80.0) > 0.0 && at(90.0, 90.0).abs() < 1e-14);
    }

    #[test]
    fn ordering_holds_against_a_parameter_that_is_not_free() {
        let free = vec![FreeParameter::new(Parameter::ContractionPeakRv).between(20.0, 300.0)];
        let space = ParameterSpace::new(Parameters::default(), free).unwrap();
        let ordered = LinearConstraint::ordered(&space, Parameter::ContractionPeakRv, Parameter::ContractionPeakLv).unwrap();
        let default_lv = Parameter::ContractionPeakLv.spec().default;
        assert!(ordered.value(&DVector::from_element(1, default_lv.ln())).abs() < 1e-12);
        assert!(LinearConstraint::ordered(&space, Parameter::OnsetTime, Parameter::HeartPeriod).is_err());
    }

    /// The gradient against central differences, in coordinates.
    #[test]
    fn gradient_of_the_beat_constraint_is_its_derivative() {
        let space = space();
        let constraint = RepolarisedBeforeNextBeat::new(space.clone(), &Parameters::default(), 0.12, 0.02);
        let at = space.initial();
        let gradient = constraint.gradient(&at);
        for index in 0..space.dimension() {
            let mut shift = DVector::zeros(space.dimension());
            shift[index] = 1e-6;
            let difference = (constraint.value(&(&at + &shift)) - constraint.value(&(&at - &shift))) / 2e-6;
            assert!((difference - gradient[index]).abs() < 1e-8, "{index}: {difference} {}", gradient[index]);
        }
        let period = Parameters::default()[Parameter::HeartPeriod];
        let expected = (0.02 + 0.12 + 0.3 + 0.02) / period - 1.0;
        assert!((constraint.value(&at) - expected).abs() < 1e-12);
    }
}
