//! The range over which a parameter of the heart is screened, as a map from the unit interval.

use super::SensitivityError;
use crate::heart::{OutOfRange, Parameters, RegionalParameter};

/// How a range is walked through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spacing {
    /// Equal differences.
    Linear,
    /// Equal ratios; for positive ranges.
    Logarithmic,
}

/// One parameter, of the whole heart or a part of it, and its range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScreeningInput {
    parameter: RegionalParameter,
    lower: f64,
    upper: f64,
    spacing: Spacing,
}

impl ScreeningInput {
    /// `parameter` from `lower` to `upper`, in its own unit.
    ///
    /// # Errors
    /// [`SensitivityError::Setting`] if the range does not ascend, leaves the physical range, or is not positive where it is walked in ratios.
    pub fn new(parameter: impl Into<RegionalParameter>, lower: f64, upper: f64, spacing: Spacing) -> Result<Self, SensitivityError> {
        let parameter = parameter.into();
        let spec = parameter.parameter().spec();
        let refuse = |value, remedy| Err(SensitivityError::Setting { what: spec.name, value, remedy });
        if !(lower < upper && lower >= spec.lower && upper <= spec.upper) {
            return refuse(lower, "the range must ascend and stay within the physical range");
        }
        if spacing == Spacing::Logarithmic && lower <= 0.0 {
            return refuse(lower, "a range walked in ratios must be positive");
        }
        Ok(Self { parameter, lower, upper, spacing })
    }

    /// Which parameter, and where.
    pub fn parameter(&self) -> RegionalParameter {
        self.parameter
    }

    /// The value at a place of the unit interval.
    pub fn value(&self, place: f64) -> f64 {
        let value = match self.spacing {
            Spacing::Linear => self.lower + place * (self.upper - self.lower),
            Spacing::Logarithmic => self.lower * (self.upper / self.lower).powf(place),
        };
        value.clamp(self.lower, self.upper)
    }

    /// The place of a value in the unit interval; none outside of the range.
    pub fn place(&self, value: f64) -> Option<f64> {
        let place = match self.spacing {
            Spacing::Linear => (value - self.lower) / (self.upper - self.lower),
            Spacing::Logarithmic => (value / self.lower).ln() / (self.upper / self.lower).ln(),
        };
        (self.lower..=self.upper).contains(&value).then(|| place.clamp(0.0, 1.0))
    }
}

/// `base` with every input at its place of the unit cube.
///
/// # Errors
/// [`OutOfRange`] for a place that is not a number.
pub fn to_parameters(base: &Parameters, inputs: &[ScreeningInput], places: &[f64]) -> Result<Parameters, OutOfRange> {
    inputs.iter().zip(places).try_fold(base.clone(), |parameters, (input, &place)| parameters.with(input.parameter, input.value(place)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heart::{Parameter, Part};

    #[test]
    fn ends_and_middle_of_a_range() {
        let peak = ScreeningInput::new(Parameter::ContractionPeakLv, 50.0, 200.0, Spacing::Logarithmic).unwrap();
        let onset = ScreeningInput::new(Parameter::OnsetTime, -0.1, 0.3, Spacing::Linear).unwrap();
        let parameters = to_parameters(&Parameters::default(), &[peak, onset], &[0.5, 0.5]).unwrap();
        assert!((parameters[Parameter::ContractionPeakLv] - 100.0).abs() < 1e-12);
        assert!((parameters[Parameter::OnsetTime] - 0.1).abs() < 1e-12);
        assert_eq!((peak.value(0.0), peak.value(1.0)), (50.0, 200.0));
        assert!((peak.place(100.0).unwrap() - 0.5).abs() < 1e-12 && (onset.place(0.0).unwrap() - 0.25).abs() < 1e-12);
        assert_eq!((peak.place(49.0), onset.place(f64::NAN)), (None, None));
    }

    #[test]
    fn an_input_of_a_part_moves_that_part_alone() {
        let [moved, other] = ["segment_7", "segment_8"]
            .map(|name| RegionalParameter::new(Parameter::ContractionPeakLv, Part::from_name(name).unwrap()).unwrap());
        let input = ScreeningInput::new(moved, 20.0, 60.0, Spacing::Linear).unwrap();
        let parameters = to_parameters(&Parameters::default(), &[input], &[0.25]).unwrap();
        let default = Parameters::default()[Parameter::ContractionPeakLv];
        assert_eq!((parameters[moved], parameters[other], parameters[Parameter::ContractionPeakLv]), (30.0, default, default));
    }

    #[test]
    fn ranges_without_sense_are_refused() {
        let refused = |lower, upper, spacing| ScreeningInput::new(Parameter::OnsetTime, lower, upper, spacing).is_err();
        assert!(refused(0.2, 0.1, Spacing::Linear));
        assert!(refused(-0.1, 0.1, Spacing::Logarithmic));
        assert!(refused(-5.0, 0.1, Spacing::Linear));
        assert!(refused(f64::NAN, 0.1, Spacing::Linear));
    }
}
