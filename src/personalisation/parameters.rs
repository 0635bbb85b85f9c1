//! The parameters that a study sets free, and the coordinates in which they are sought.
//!
//! A coordinate is θ = ln p where p is positive (steps are then relative and p stays positive) or θ = p.

use nalgebra::DVector;
use serde::Serialize;

use super::{PersonalisationError, Tie};
use crate::heart::{Parameter, Parameters, Part, RegionalParameter};

/// How a physical value becomes a coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Transform {
    /// θ = p.
    Identity,
    /// θ = ln p, p > 0.
    Log,
}

impl Transform {
    /// The coordinate of a physical value.
    pub fn to_coordinate(self, value: f64) -> f64 {
        match self {
            Self::Identity => value,
            Self::Log => value.ln(),
        }
    }

    /// The physical value of a coordinate.
    pub fn to_value(self, coordinate: f64) -> f64 {
        match self {
            Self::Identity => coordinate,
            Self::Log => coordinate.exp(),
        }
    }

    /// dp/dθ at a physical value.
    pub fn slope(self, value: f64) -> f64 {
        match self {
            Self::Identity => 1.0,
            Self::Log => value,
        }
    }
}

/// One parameter of a study: where it starts, how far it may go, and what is known before the data.
#[derive(Debug, Clone, PartialEq)]
pub struct FreeParameter {
    /// Which parameter of the model, and where.
    pub parameter: RegionalParameter,
    /// The part of the heart it speaks of, for people (`global`, `lv`, `rv`, `scar`, `segment_7`, …).
    pub region: String,
    /// Coordinate.
    pub transform: Transform,
    /// Start value, physical.
    pub initial: f64,
    /// Smallest value allowed, physical.
    pub lower: f64,
    /// Largest value allowed, physical.
    pub upper: f64,
    /// Prior mean, physical.
    pub prior_mean: f64,
    /// Prior standard deviation of the coordinate (relative for [`Transform::Log`]); infinite means no prior.
    pub prior_sd: f64,
    /// Keep at `initial`; it is reported but not sought.
    pub fixed: bool,
}

impl FreeParameter {
    /// A parameter at its default, within its physical range, with a wide prior: a factor of two (log) or a quarter of the range.
    /// Positive parameters are sought in their logarithm.
    pub fn new(parameter: impl Into<RegionalParameter>) -> Self {
        let parameter: RegionalParameter = parameter.into();
        let spec = parameter.parameter().spec();
        let transform = if spec.lower > 0.0 { Transform::Log } else { Transform::Identity };
        let prior_sd = match transform {
            Transform::Log => std::f64::consts::LN_2,
            Transform::Identity => (spec.upper - spec.lower) / 4.0,
        };
        Self {
            parameter,
            region: region(parameter).to_owned(),
            transform,
            initial: spec.default,
            lower: spec.lower,
            upper: spec.upper,
            prior_mean: spec.default,
            prior_sd,
            fixed: false,
        }
    }

    /// Between two physical values; the start and the prior mean are moved inside, and a positive lower bound means a log coordinate with
    /// a quarter of the range (in the coordinate) as the prior's standard deviation.
    #[must_use]
    pub fn between(mut self, lower: f64, upper: f64) -> Self {
        self.transform = if lower > 0.0 { Transform::Log } else { Transform::Identity };
        self.prior_sd = (self.transform.to_coordinate(upper) - self.transform.to_coordinate(lower)) / 4.0;
        (self.lower, self.upper) = (lower, upper);
        self.initial = self.initial.max(lower).min(upper);
        self.prior_mean = self.prior_mean.max(lower).min(upper);
        self
    }

    /// Starts from `value`.
    #[must_use]
    pub fn starting_at(mut self, value: f64) -> Self {
        self.initial = value;
        self
    }

    /// Prior `mean` (physical) with standard deviation `sd` of the coordinate.
    #[must_use]
    pub fn with_prior(mut self, mean: f64, sd: f64) -> Self {
        (self.prior_mean, self.prior_sd) = (mean, sd);
        self
    }

    fn check(&self) -> Result<(), PersonalisationError> {
        let spec = self.parameter.parameter().spec();
        let refuse = |reason: String| Err(PersonalisationError::FreeParameter { name: spec.name, region: self.region.clone(), reason });
        if !(self.lower < self.upper && self.lower >= spec.lower && self.upper <= spec.upper) {
            let (lower, upper, unit) = (self.lower, self.upper, spec.unit);
            return refuse(format!(
                "bounds {lower} to {upper} {unit} must be ascending and within the physical range {} to {}",
                spec.lower, spec.upper
            ));
        }
        if self.transform == Transform::Log && self.lower <= 0.0 {
            return refuse(format!("a logarithmic coordinate needs a positive lower bound, not {}", self.lower));
        }
        for (what, value) in [("start value", self.initial), ("prior mean", self.prior_mean)] {
            if !(self.lower..=self.upper).contains(&value) {
                return refuse(format!("{what} {value} is outside its bounds {} to {} {}", self.lower, self.upper, spec.unit));
            }
        }
        if self.prior_sd.is_nan() || self.prior_sd <= 0.0 {
            return refuse(format!("prior standard deviation {} must be positive (infinite for none)", self.prior_sd));
        }
        Ok(())
    }
}

/// The part of the heart, which may be told by a parameter's own name.
fn region(parameter: RegionalParameter) -> &'static str {
    if parameter.part() != Part::Whole {
        return parameter.part().name();
    }
    let name = parameter.parameter().spec().name;
    ["lv", "rv", "scar"].into_iter().find(|region| name.contains(&format!("_{region}_"))).unwrap_or("global")
}

/// The map between coordinates θ (free, not fixed, in the order given) and the model's parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterSpace {
    base: Parameters,
    all: Vec<FreeParameter>,
    free: Vec<usize>,
    ties: Vec<Tie>,
}

impl ParameterSpace {
    /// A space around `base`, which holds whatever is not listed.
    ///
    /// # Errors
    /// [`PersonalisationError::FreeParameter`] for inconsistent bounds, start or prior, for a parameter listed twice, or if none is free.
    pub fn new(base: Parameters, parameters: Vec<FreeParameter>) -> Result<Self, PersonalisationError> {
        let mut base = base;
        for (index, entry) in parameters.iter().enumerate() {
            entry.check()?;
            if parameters[..index].iter().any(|earlier| earlier.parameter == entry.parameter) {
                let (name, region) = (entry.parameter.parameter().spec().name, entry.region.clone());
                return Err(PersonalisationError::FreeParameter { name, region, reason: "listed twice".to_owned() });
            }
            base.set(entry.parameter, entry.initial)?;
        }
        let free: Vec<usize> = (0..parameters.len()).filter(|&index| !parameters[index].fixed).collect();
        if free.is_empty() {
            return Err(PersonalisationError::Shape { what: "free parameters", found: 0, expected: 1 });
        }
        Ok(Self { base, all: parameters, free, ties: Vec::new() })
    }

    /// The same space, where a parameter differs little between neighbouring AHA segments: by a standard deviation `sd` of the coordinate
    /// (relative in a logarithm). Segments that are not free are left alone.
    #[must_use]
    pub fn with_alike_segments(mut self, parameter: Parameter, sd: f64) -> Self {
        let segments = self.free().enumerate().filter_map(|(index, entry)| match entry.parameter.part() {
            Part::Segment(segment) if entry.parameter.parameter() == parameter => Some((index, segment)),
            _ => None,
        });
        let segments: Vec<_> = segments.collect();
        for (place, &(second, segment)) in segments.iter().enumerate() {
            let neighbours = segments[..place].iter().filter(|(_, other)| segment.is_neighbour_of(*other));
            self.ties.extend(neighbours.map(|&(first, _)| Tie { first, second, sd }));
        }
        self
    }

    /// The same space with other strengths of what is known before the data: factors on the standard deviations of the parameters' own
    /// priors and of the ties.
    #[must_use]
    pub fn with_prior_scaled(&self, own: f64, ties: f64) -> Self {
        let mut scaled = self.clone();
        scaled.all.iter_mut().for_each(|entry| entry.prior_sd *= own);
        scaled.ties.iter_mut().for_each(|tie| tie.sd *= ties);
        scaled
    }

    /// The coordinates that are expected to be alike.
    pub fn ties(&self) -> &[Tie] {
        &self.ties
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.free.len()
    }

    /// The free parameters, one a coordinate.
    pub fn free(&self) -> impl ExactSizeIterator<Item = &FreeParameter> + '_ {
        self.free.iter().map(|&index| &self.all[index])
    }

    /// All listed parameters, fixed ones too.
    pub fn all(&self) -> &[FreeParameter] {
        &self.all
    }

    /// The coordinate of a parameter, if it is free.
    pub fn coordinate_index(&self, parameter: impl Into<RegionalParameter>) -> Option<usize> {
        let parameter = parameter.into();
        self.free().position(|entry| entry.parameter == parameter)
    }

    /// Short name of every coordinate, for messages.
    pub fn names(&self) -> Vec<String> {
        self.free().map(|entry| entry.parameter.name()).collect()
    }

    /// The model's parameters at `coordinates`.
    ///
    /// # Errors
    /// [`PersonalisationError::Shape`], or [`PersonalisationError::OutOfRange`] outside the physical range.
    pub fn to_parameters(&self, coordinates: &DVector<f64>) -> Result<Parameters, PersonalisationError> {
        if coordinates.len() != self.dimension() {
            return Err(PersonalisationError::Shape { what: "coordinates", found: coordinates.len(), expected: self.dimension() });
        }
        let mut parameters = self.base.clone();
        for (entry, &coordinate) in self.free().zip(coordinates) {
            let value = entry.transform.to_value(coordinate);
            // exp(ln p) misses a bound by rounding: a coordinate on its bound means the bound.
            let bound = [entry.lower, entry.upper].into_iter().find(|bound| (bound - value).abs() <= 1e-12 * value.abs());
            parameters.set(entry.parameter, bound.unwrap_or(value))?;
        }
        Ok(parameters)
    }

    /// The coordinates of `parameters`.
    pub fn to_coordinates(&self, parameters: &Parameters) -> DVector<f64> {
        self.map(|entry| entry.transform.to_coordinate(parameters[entry.parameter]))
    }

    /// Physical values of `coordinates`.
    pub fn to_values(&self, coordinates: &DVector<f64>) -> Vec<f64> {
        self.free().zip(coordinates).map(|(entry, &coordinate)| entry.transform.to_value(coordinate)).collect()
    }

    /// Start.
    pub fn initial(&self) -> DVector<f64> {
        self.map(|entry| entry.transform.to_coordinate(entry.initial))
    }

    /// Lower bounds.
    pub fn lower(&self) -> DVector<f64> {
        self.map(|entry| entry.transform.to_coordinate(entry.lower))
    }

    /// Upper bounds.
    pub fn upper(&self) -> DVector<f64> {
        self.map(|entry| entry.transform.to_coordinate(entry.upper))
    }

    /// Prior means.
    pub fn prior_mean(&self) -> DVector<f64> {
        self.map(|entry| entry.transform.to_coordinate(entry.prior_mean))
    }

    /// Prior standard deviations; infinite where there is none.
    pub fn prior_sd(&self) -> DVector<f64> {
        self.map(|entry| entry.prior_sd)
    }

    fn map(&self, value: impl Fn(&FreeParameter) -> f64) -> DVector<f64> {
        DVector::from_iterator(self.dimension(), self.free().map(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space() -> ParameterSpace {
        let peak = FreeParameter::new(Parameter::ContractionPeakLv).between(40.0, 250.0);
        let onset = FreeParameter::new(Parameter::OnsetTime).between(-0.1, 0.2);
        let rate = FreeParameter { fixed: true, ..FreeParameter::new(Parameter::ContractionRate).starting_at(12.0) };
        ParameterSpace::new(Parameters::default(), vec![peak, rate, onset]).unwrap()
    }

    #[test]
    fn coordinates_and_parameters_are_inverse_maps() {
        let space = space();
        assert_eq!(space.dimension(), 2);
        let coordinates = DVector::from_vec(vec![120.0_f64.ln(), 0.05]);
        let parameters = space.to_parameters(&coordinates).unwrap();
        assert!((parameters[Parameter::ContractionPeakLv] - 120.0).abs() < 1e-12);
        assert_eq!(parameters[Parameter::OnsetTime], 0.05);
        assert_eq!(parameters[Parameter::ContractionRate], 12.0, "a fixed parameter keeps its start value");
        assert!((space.to_coordinates(&parameters) - coordinates).amax() < 1e-15);
        assert_eq!(space.coordinate_index(Parameter::OnsetTime), Some(1));
        assert_eq!(space.coordinate_index(Parameter::ContractionRate), None);
    }

    #[test]
    fn neighbouring_free_segments_are_tied_and_named() {
        let in_segment = |number| {
            let segment = crate::anatomy::AhaSegment::new(number).unwrap();
            let regional = RegionalParameter::new(Parameter::ContractionPeakLv, Part::Segment(segment)).unwrap();
            FreeParameter { fixed: number == 3, ..FreeParameter::new(regional).between(20.0, 300.0) }
        };
        let onset = FreeParameter::new(Parameter::OnsetTime).between(-0.1, 0.2);
        let entries = vec![in_segment(1), onset, in_segment(2), in_segment(3), in_segment(4)];
        let space = ParameterSpace::new(Parameters::default(), entries).unwrap().with_alike_segments(Parameter::ContractionPeakLv, 0.2);
        assert_eq!(space.ties(), [Tie { first: 0, second: 2, sd: 0.2 }], "segments 1 and 2; 3 is fixed, 4 touches neither");
        assert_eq!(space.names()[2], "contraction_peak_lv_kpa.segment_2");
        assert_eq!(space.all()[2].region, "segment_2");
    }

    #[test]
    fn bounds_are_reachable_and_nothing_beyond_the_physical_range_is() {
        let upper = Parameter::RelaxationRate.spec().upper;
        let space = ParameterSpace::new(Parameters::default(), vec![FreeParameter::new(Parameter::RelaxationRate)]).unwrap();
        assert_eq!(space.to_parameters(&space.upper()).unwrap()[Parameter::RelaxationRate], upper);
        assert!(space.to_parameters(&space.upper().add_scalar(1e-6)).is_err());
        assert!(space.to_parameters(&DVector::from_element(1, f64::NAN)).is_err());
    }

    /// dp/dθ against a central difference.
    #[test]
    fn slope_is_the_derivative_of_the_transform() {
        for transform in [Transform::Identity, Transform::Log] {
            let (value, step) = (3.7, 1e-5);
            let coordinate = transform.to_coordinate(value);
            let difference = (transform.to_value(coordinate + step) - transform.to_value(coordinate - step)) / (2.0 * step);
            assert!((difference - transform.slope(value)).abs() < 1e-8);
        }
    }

    #[test]
    fn regions_are_read_from_names() {
        assert_eq!(FreeParameter::new(Parameter::ContractionPeakRv).region, "rv");
        assert_eq!(FreeParameter::new(Parameter::ContractionPeakScar).region, "scar");
        assert_eq!(FreeParameter::new(Parameter::ActionPotentialDuration).region, "global");
    }

    #[test]
    fn inconsistent_parameters_are_refused_with_their_numbers() {
        let refused = |entry: FreeParameter| ParameterSpace::new(Parameters::default(), vec![entry]).unwrap_err().to_string();
        let peak = || FreeParameter::new(Parameter::ContractionPeakLv);
        assert!(refused(peak().between(40.0, 20.0)).contains("bounds 40 to 20 kPa"));
        assert!(refused(peak().between(40.0, 200.0).starting_at(300.0)).contains("start value 300"));
        assert!(refused(peak().between(40.0, 200.0).with_prior(90.0, 0.0)).contains("standard deviation 0"));
        assert!(refused(FreeParameter { transform: Transform::Log, ..peak() }).contains("positive lower bound"));
        assert!(refused(peak().between(40.0, 1e9)).contains("physical range"));
        let twice = ParameterSpace::new(Parameters::default(), vec![peak().between(1.0, 9.0), peak().between(1.0, 9.0)]);
        assert!(twice.unwrap_err().to_string().contains("twice"));
        assert!(ParameterSpace::new(Parameters::default(), vec![FreeParameter { fixed: true, ..peak() }]).is_err());
    }
}
