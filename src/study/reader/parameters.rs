//! The parameters of the model in a study file: under their own names, and in parts of the heart.

use std::collections::BTreeSet;

use toml::Value;

use super::TableReader;
use crate::heart::{Parameter, Parameters, Part, RegionalParameter, Section};

impl TableReader<'_> {
    /// The parameters of one section of the model's table, each within its physical range.
    pub(in crate::study) fn parameters(&self, section: Section, parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) {
        let of_section: Vec<_> = Parameter::ALL.iter().copied().filter(|parameter| parameter.spec().section == section).collect();
        for &parameter in &of_section {
            self.parameter(parameter, parameters, written);
        }
        if of_section.iter().any(|&parameter| !RegionalParameter::parts_of(parameter).is_empty()) {
            self.regions(&of_section, parameters, written);
        }
    }

    /// One parameter under its own name, if it is written.
    pub(in crate::study) fn parameter(&self, parameter: Parameter, parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) {
        self.regional_parameter(parameter.into(), parameters, written);
    }

    fn regional_parameter(&self, regional: RegionalParameter, parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) {
        let spec = regional.parameter().spec();
        if let Some(value) = self.optional_number(spec.name, spec.lower..=spec.upper) {
            match parameters.set(regional, value) {
                Ok(()) if written.insert(regional) => {}
                Ok(()) => self.problem(spec.name, format!("stands twice for {}", regional.part().name()), "keep one of them"),
                Err(error) => self.problem(spec.name, "is out of range", error.to_string()),
            }
        }
    }

    /// `[[region]]`: values that hold in the `parts` named and nowhere else.
    pub(in crate::study) fn regions(&self, of: &[Parameter], parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) {
        for table in self.tables("region") {
            let parts = table.parts("parts");
            for &parameter in of.iter().filter(|&&parameter| !RegionalParameter::parts_of(parameter).is_empty()) {
                let is_written = table.has(parameter.spec().name);
                for &part in &parts {
                    match RegionalParameter::new(parameter, part) {
                        Some(regional) => table.regional_parameter(regional, parameters, written),
                        None if is_written => {
                            let remedy = format!("it has values of its own in {}", words_of(&RegionalParameter::parts_of(parameter)));
                            table.problem(parameter.spec().name, format!("has no value of {}", part.name()), remedy);
                        }
                        None => {}
                    }
                }
            }
            table.close();
        }
    }

    /// Names of parts of the heart, at least one.
    fn parts(&self, key: &'static str) -> Vec<Part> {
        let list = self.value(key).and_then(Value::as_array);
        let parts = list.and_then(|list| list.iter().map(|word| Part::from_name(word.as_str()?)).collect::<Option<Vec<_>>>());
        match parts.filter(|parts| !parts.is_empty() && !parts.contains(&Part::Whole)) {
            Some(parts) => parts,
            None => {
                self.problem(
                    key,
                    "is no list of parts of the heart",
                    "write some of lv, rv, scar, segment_1 to segment_17, as in [\"segment_7\"]",
                );
                Vec::new()
            }
        }
    }
}

/// The parts of a list as people would say them.
fn words_of(parts: &[Part]) -> &'static str {
    if parts.contains(&Part::Scar) { "lv, rv, scar and the segments" } else { "the segments" }
}
