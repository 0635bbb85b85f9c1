//! Where a parameter holds: in the whole heart, in a ventricle, in scar, or in one AHA segment.
//!
//! The narrowest part that has a value of its own decides: scar before segment before ventricle before the whole heart.

use super::{Parameter, Parameters};
use crate::anatomy::{AhaSegment, Anatomy, Region};

/// A part of the heart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Part {
    /// All of it.
    Whole,
    /// The left ventricle with the septum.
    LeftVentricle,
    /// The free wall of the right ventricle.
    RightVentricle,
    /// One segment of the left ventricle.
    Segment(AhaSegment),
    /// Scar.
    Scar,
}

impl Part {
    /// All parts, from the widest to the narrowest.
    pub fn all() -> impl Iterator<Item = Self> {
        let segments = AhaSegment::all().map(Self::Segment);
        [Self::Whole, Self::LeftVentricle, Self::RightVentricle].into_iter().chain(segments).chain([Self::Scar])
    }

    /// Its name in study files and tables: `whole`, `lv`, `rv`, `scar`, `segment_7`.
    pub fn name(self) -> &'static str {
        #[rustfmt::skip]
        const SEGMENTS: [&str; 17] = [
            "segment_1", "segment_2", "segment_3", "segment_4", "segment_5", "segment_6", "segment_7", "segment_8", "segment_9",
            "segment_10", "segment_11", "segment_12", "segment_13", "segment_14", "segment_15", "segment_16", "segment_17",
        ];
        match self {
            Self::Whole => "whole",
            Self::LeftVentricle => "lv",
            Self::RightVentricle => "rv",
            Self::Scar => "scar",
            Self::Segment(segment) => SEGMENTS[usize::from(segment.number()) - 1],
        }
    }

    /// The part with a name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::all().find(|part| part.name() == name)
    }

    /// Whether it holds tissue of a region and AHA segment (0 outside the left ventricle).
    pub fn contains(self, region: Region, segment: u8) -> bool {
        match self {
            Self::Whole => true,
            Self::LeftVentricle => segment > 0,
            Self::RightVentricle => segment == 0,
            Self::Scar => region == Region::Scar,
            Self::Segment(own) => own.number() == segment,
        }
    }
}

/// A parameter in one part of the heart: what a study may set free.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RegionalParameter {
    parameter: Parameter,
    part: Part,
}

impl RegionalParameter {
    /// A parameter in a part; none where the model has one value for the whole heart.
    pub fn new(parameter: Parameter, part: Part) -> Option<Self> {
        let is_regional = match part {
            Part::Whole => true,
            // The ventricles and scar have peaks of contraction that are parameters of their own.
            Part::Segment(_) => parameter == Parameter::ContractionPeakLv || parameter.is_of_tissue(),
            Part::LeftVentricle | Part::RightVentricle | Part::Scar => parameter.is_of_tissue(),
        };
        is_regional.then_some(Self { parameter, part })
    }

    /// The parts of the heart, narrower than the whole, in which a parameter may have a value of its own.
    pub fn parts_of(parameter: Parameter) -> Vec<Part> {
        Part::all().filter(|&part| part != Part::Whole && Self::new(parameter, part).is_some()).collect()
    }

    /// Which parameter.
    pub fn parameter(self) -> Parameter {
        self.parameter
    }

    /// Where.
    pub fn part(self) -> Part {
        self.part
    }

    /// `contraction_peak_lv_kpa` for the whole heart, `contraction_peak_lv_kpa.segment_7` elsewhere.
    pub fn name(self) -> String {
        match self.part {
            Part::Whole => self.parameter.spec().name.to_owned(),
            part => format!("{}.{}", self.parameter.spec().name, part.name()),
        }
    }
}

impl From<Parameter> for RegionalParameter {
    fn from(parameter: Parameter) -> Self {
        Self { parameter, part: Part::Whole }
    }
}

impl Parameter {
    /// Whether the tissue of every part may have its own value.
    fn is_of_tissue(self) -> bool {
        matches!(self, Self::ConductionVelocity | Self::ActionPotentialDuration | Self::ContractionRate | Self::RelaxationRate)
    }
}

impl Parameters {
    /// The part whose value holds in tissue of a region and AHA segment (0 outside the left ventricle).
    pub fn ruling_part(&self, parameter: Parameter, region: Region, segment: u8) -> Part {
        let own = self.regional_values(parameter).map(|(regional, _)| regional.part());
        own.filter(|part| part.contains(region, segment)).max().unwrap_or(Part::Whole)
    }

    /// The value a tetrahedron.
    pub(super) fn on_tetrahedra(&self, parameter: Parameter, anatomy: &Anatomy) -> Vec<f64> {
        if self.regional_values(parameter).next().is_none() {
            return vec![self[parameter]; anatomy.mesh.tetrahedron_count()];
        }
        let tissue = anatomy.regions.iter().zip(&anatomy.aha_segments);
        let value = |(&region, &segment): (&Region, &u8)| {
            let part = self.ruling_part(parameter, region, segment);
            self[RegionalParameter { parameter, part }]
        };
        tissue.map(value).collect()
    }

    /// The value a vertex: the mean over its tetrahedra by their volumes.
    pub(super) fn on_vertices(&self, parameter: Parameter, anatomy: &Anatomy) -> Vec<f64> {
        if self.regional_values(parameter).next().is_none() {
            return vec![self[parameter]; anatomy.mesh.vertex_count()];
        }
        mean_on_vertices(anatomy, &self.on_tetrahedra(parameter, anatomy))
    }

    /// How much of a tetrahedron's value a regional one is, 1 or 0 a tetrahedron: the derivative of the one in the other.
    pub fn share_on_tetrahedra(&self, regional: RegionalParameter, anatomy: &Anatomy) -> Vec<f64> {
        let rules = |(&region, &segment): (&Region, &u8)| {
            regional.part().contains(region, segment) && self.ruling_part(regional.parameter(), region, segment) <= regional.part()
        };
        anatomy.regions.iter().zip(&anatomy.aha_segments).map(|tissue| f64::from(u8::from(rules(tissue)))).collect()
    }

    /// The same a vertex, for the parameters that the model takes at vertices (APD, kATP, kRS).
    pub fn share_on_vertices(&self, regional: RegionalParameter, anatomy: &Anatomy) -> Vec<f64> {
        mean_on_vertices(anatomy, &self.share_on_tetrahedra(regional, anatomy))
    }
}

fn mean_on_vertices(anatomy: &Anatomy, on_tetrahedra: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); anatomy.mesh.vertex_count()];
    for (tetrahedron, (corners, value)) in anatomy.mesh.tetrahedra().iter().zip(on_tetrahedra).enumerate() {
        let volume_mm3 = anatomy.mesh.volume_mm3(tetrahedron);
        for &vertex in corners {
            sums[vertex].0 += volume_mm3 * value;
            sums[vertex].1 += volume_mm3;
        }
    }
    sums.into_iter().map(|(weighted, volume_mm3)| weighted / volume_mm3).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::heart::idealised_lv::IdealisedLv;
    use crate::heart::{HeartModel, ModelSettings};

    fn in_segment(parameter: Parameter, number: u8) -> RegionalParameter {
        RegionalParameter::new(parameter, Part::Segment(AhaSegment::new(number).unwrap())).unwrap()
    }

    #[test]
    fn names_are_read_back_and_parts_that_a_parameter_does_not_have_are_none() {
        for part in Part::all() {
            assert_eq!(Part::from_name(part.name()), Some(part));
        }
        assert_eq!(in_segment(Parameter::ContractionPeakLv, 7).name(), "contraction_peak_lv_kpa.segment_7");
        assert!(RegionalParameter::new(Parameter::ContractionPeakLv, Part::RightVentricle).is_none());
        assert!(RegionalParameter::new(Parameter::FibreStiffness, Part::Scar).is_none());
    }

    #[test]
    fn the_narrowest_part_with_a_value_of_its_own_decides() {
        let rate = Parameter::ContractionRate;
        let of = |part| RegionalParameter::new(rate, part).unwrap();
        let seven = in_segment(rate, 7);
        let parameters = Parameters::default().with(rate, 10.0).unwrap().with(of(Part::LeftVentricle), 11.0).unwrap();
        let parameters = parameters.with(seven, 12.0).unwrap().with(of(Part::Scar), 13.0).unwrap();
        let value =
            |region, segment| parameters[RegionalParameter { parameter: rate, part: parameters.ruling_part(rate, region, segment) }];
        assert_eq!(value(Region::FreeWallRv, 0), 10.0);
        assert_eq!(value(Region::Septum, 8), 11.0);
        assert_eq!(value(Region::FreeWallLv, 7), 12.0);
        assert_eq!(value(Region::Scar, 7), 13.0);
        assert_eq!(parameters[in_segment(rate, 9)], 11.0, "a segment without a value has that of its ventricle");
    }

    /// Segments that all have the ventricle's value are the ventricle.
    #[test]
    fn one_value_in_all_segments_is_that_value_in_the_whole() {
        let anatomy = Arc::new(IdealisedLv::default().anatomy());
        let stress = |parameters: &Parameters| {
            HeartModel::new(Arc::clone(&anatomy), parameters.clone(), ModelSettings::default()).unwrap().active_stress_kpa(0.2)
        };
        let of_tissue = [Parameter::ConductionVelocity, Parameter::ActionPotentialDuration, Parameter::ContractionRate];
        for (parameter, value) in of_tissue.into_iter().chain([Parameter::ContractionPeakLv]).zip([700.0, 0.25, 12.0, 90.0]) {
            let whole = Parameters::default().with(parameter, value).unwrap();
            let by_segment = AhaSegment::all().fold(Parameters::default(), |parameters, segment| {
                parameters.with(in_segment(parameter, segment.number()), value).unwrap()
            });
            let apart = stress(&whole).iter().zip(&stress(&by_segment)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < 1e-9, "{}: {apart} kPa", parameter.spec().name);
        }
    }

    /// The shares against a difference of the field itself.
    #[test]
    fn shares_are_the_derivative_of_the_values() {
        let anatomy = IdealisedLv::default().anatomy();
        let rate = Parameter::RelaxationRate;
        let seven = in_segment(rate, 7);
        let parameters = Parameters::default().with(in_segment(rate, 8), 20.0).unwrap().with(seven, 15.0).unwrap();
        for regional in [seven, rate.into()] {
            let moved = parameters.clone().with(regional, 16.0).unwrap();
            let difference = |values: fn(&Parameters, Parameter, &Anatomy) -> Vec<f64>| -> Vec<f64> {
                values(&moved, rate, &anatomy).iter().zip(values(&parameters, rate, &anatomy)).map(|(a, b)| a - b).collect()
            };
            assert_eq!(difference(Parameters::on_tetrahedra), parameters.share_on_tetrahedra(regional, &anatomy));
            let shares = parameters.share_on_vertices(regional, &anatomy);
            assert!(difference(Parameters::on_vertices).iter().zip(shares).all(|(a, b)| (a - b).abs() < 1e-12));
        }
    }

    #[test]
    fn a_weak_segment_is_weak_alone() {
        let anatomy = Arc::new(IdealisedLv::default().anatomy());
        let healthy = HeartModel::new(Arc::clone(&anatomy), Parameters::default(), ModelSettings::default()).unwrap();
        let scarred = Parameters::default().with(in_segment(Parameter::ContractionPeakLv, 10), 30.0).unwrap();
        let scarred = healthy.with_parameters(scarred).unwrap();
        let peak = Parameters::default()[Parameter::ContractionPeakLv];
        for ((strong, weak), &segment) in
            healthy.active_stress_kpa(0.2).iter().zip(scarred.active_stress_kpa(0.2)).zip(&anatomy.aha_segments)
        {
            let share = if segment == 10 { 30.0 / peak } else { 1.0 };
            assert!((weak - share * strong).abs() <= 1e-12 * strong, "segment {segment}: {weak} of {strong}");
        }
    }
}
