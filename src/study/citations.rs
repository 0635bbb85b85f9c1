//! What a study's results rest on: the references of the methods that its options use, as BibTeX out of `docs/references.bib`.

use std::collections::BTreeSet;

use super::plan::{
    AnatomySource, BaseMode, GainChoice, ImageSource, Intervals, KinematicsPlan, OnsetSite, SensitivityMethod, VolumeData, VolumeSource,
};
use super::{Kind, Plan};
use crate::heart::Parameter;
use crate::mechanics::TimeScheme;
use crate::personalisation::SearchMethod;

const REFERENCES: &str = include_str!("../../docs/references.bib");

/// The program itself.
const SOFTWARE: &str = concat!(
    "@software{cardiotwin,\n  title   = {cardiotwin: personalised electromechanical heart models from cine {MRI}},\n  version = {",
    env!("CARGO_PKG_VERSION"),
    "}\n}\n"
);

/// The program and the references of what a study uses, in BibTeX, in the order of their keys.
pub fn bibliography(plan: &Plan) -> String {
    let entries = cited_keys(plan).into_iter().filter_map(entry);
    std::iter::once(SOFTWARE).chain(entries).collect::<Vec<_>>().join("\n")
}

/// The entry of a key, with its last line's end.
fn entry(key: &str) -> Option<&'static str> {
    let start = REFERENCES.find(&format!("{{{key},")).and_then(|at| REFERENCES[..at].rfind('@'))?;
    let rest = &REFERENCES[start..];
    rest.find("\n}\n").map(|end| &rest[..end + "\n}\n".len()])
}

/// Keys of `docs/references.bib` for what a study uses.
pub fn cited_keys(plan: &Plan) -> BTreeSet<&'static str> {
    let mut keys = BTreeSet::from(["Billet2009", "Cerqueira2002"]);
    if !matches!(plan.anatomy.source, AnatomySource::Mesh(_)) {
        keys.extend(["Labelle2007", "Dey1999"]);
    }
    if let Some(ImageSource::Phantom(_)) = plan.images {
        keys.insert("Gudbjartsson1995");
    }
    if plan.kind == Kind::Mesh {
        return keys;
    }
    keys.extend(["Konukoglu2007", "Westerhof2009", "Lekhnitskii1963"]);
    keys.extend(of_parameters(plan));
    keys.extend(of_model(plan));
    if plan.images.is_some() && plan.kind != Kind::Phantom {
        keys.extend(of_tracking(plan));
    }
    keys.extend(of_search(plan));
    keys.extend(of_sensitivity(plan));
    keys
}

/// Where defaults that the study keeps come from, and whose idea a term is that it turns on.
fn of_parameters(plan: &Plan) -> Vec<&'static str> {
    let value = |parameter| plan.parameters[parameter];
    let kept = |parameter: &&Parameter| value(**parameter) == parameter.spec().default;
    let mut keys: Vec<&str> = Parameter::ALL.iter().filter(kept).filter_map(|parameter| leading_key(parameter.spec().source)).collect();
    if value(Parameter::PericardiumStiffness) > 0.0 {
        keys.push("Hirschvogel2017");
    }
    if value(Parameter::PericardiumBaseShare) < 1.0 {
        keys.push("Strocchi2020");
    }
    if value(Parameter::VolumeStiffness) > 0.0 {
        keys.push("Land2015");
    }
    keys
}

/// The key that the source of a default opens with, if it does.
fn leading_key(source: &'static str) -> Option<&'static str> {
    source.strip_prefix('[').and_then(|rest| rest.split_once(']')).map(|(key, _)| key)
}

fn of_model(plan: &Plan) -> Vec<&'static str> {
    let mut keys = Vec::new();
    if plan.model.onset.place == OnsetSite::Normal {
        keys.push("Durrer1970");
    }
    if !plan.model.onset.sites.is_empty() {
        keys.push("Moe1964");
    }
    if plan.model.kinematics == KinematicsPlan::Corotational {
        keys.extend(["Teran2005", "Higham1986"]);
    }
    if matches!(plan.model.time_scheme, TimeScheme::GeneralisedAlpha { .. }) {
        keys.extend(["ChungHulbert1993", "ArnoldBruels2007"]);
    }
    keys
}

fn of_tracking(plan: &Plan) -> Vec<&'static str> {
    let mut keys = vec!["Saad2003"];
    if plan.tracking.base == BaseMode::BlockMatching || plan.kind == Kind::CompareBases {
        keys.push("Ourselin2000");
    }
    if plan.tracking.gains == GainChoice::Discrepancy {
        keys.push("Morozov1966");
    }
    keys
}

fn of_search(plan: &Plan) -> Vec<&'static str> {
    let Some(wanted) = &plan.personalisation else { return Vec::new() };
    let solvers = if plan.kind == Kind::CompareSolvers { wanted.solvers.as_slice() } else { &[wanted.solver] };
    let of_solver = |solver: &SearchMethod| match solver {
        SearchMethod::GaussNewton => &["Nocedal2006", "Goulart2024"][..],
        SearchMethod::Lbfgs => &["Nocedal2006"],
        SearchMethod::NelderMead => &["Nelder1965"],
        SearchMethod::CmaEs => &["Hansen2016"],
        SearchMethod::ParticleSwarm => &[],
    };
    let mut keys: Vec<&str> = std::iter::once("Huber1964").chain(solvers.iter().flat_map(of_solver).copied()).collect();
    let is_followed = matches!(&plan.images, Some(ImageSource::Cine(images)) if matches!(images.volumes, VolumeSource::Images));
    if wanted.data.volumes == Some(VolumeData::Measured) && is_followed {
        keys.push("Amini1990");
    }
    if wanted.bias_rounds > 0 {
        keys.push("Gourieroux1993");
    }
    if wanted.intervals == Intervals::Clusters {
        keys.push("Cameron2011");
    }
    keys
}

fn of_sensitivity(plan: &Plan) -> Vec<&'static str> {
    match plan.sensitivity.as_ref().map(|sensitivity| sensitivity.method) {
        Some(SensitivityMethod::Morris) => vec!["Morris1991", "Campolongo2007"],
        Some(SensitivityMethod::Sobol) => vec!["Sobol2001", "Saltelli2010", "Jansen1999", "Efron1993"],
        Some(SensitivityMethod::Local) | None => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::study::{Config, Overrides};

    fn plan(text: &str) -> Plan {
        Plan::new(&Config::from_text(Path::new("study.toml"), text.into(), Overrides::default()).unwrap()).unwrap()
    }

    #[test]
    fn what_is_turned_on_is_cited_and_what_is_not_is_not() {
        const HEART: &str = "kind = \"simulate\"\n[anatomy.idealised_lv]\n";
        let free = cited_keys(&plan(HEART));
        assert!(["Billet2009", "Konukoglu2007", "Hirschvogel2017"].iter().all(|key| free.contains(key)), "{free:?}");
        assert!(["Teran2005", "Ourselin2000", "Sobol2001", "Strocchi2020"].iter().all(|key| !free.contains(key)), "{free:?}");
        let turned = cited_keys(&plan(&format!("{HEART}[mechanics]\nkinematics = \"corotational\"\npericardium_base_share = 0.3\n")));
        let added: Vec<_> = turned.difference(&free).copied().collect();
        assert_eq!(added, ["Higham1986", "Strocchi2020", "Teran2005"]);
        let swept = "kind = \"sensitivity\"\n[anatomy.idealised_lv]\n[sensitivity]\nmethod = \"sobol\"\noutputs = [\"ejection_fraction_lv\"]\n\
                     [[sensitivity.input]]\nname = \"contraction_peak_lv_kpa\"\nlower = 50.0\nupper = 150.0\n";
        assert!(cited_keys(&plan(swept)).contains("Jansen1999"));
    }

    #[test]
    fn every_key_that_can_be_cited_has_its_entry() {
        let source = include_str!("citations.rs").split("#[cfg(test)]").next().unwrap();
        let is_key = |word: &&str| word.len() > 8 && word.chars().rev().take(4).all(|c| c.is_ascii_digit());
        let written = source.split('"').filter(is_key);
        let defaults = Parameter::ALL.iter().filter_map(|parameter| leading_key(parameter.spec().source));
        let keys: BTreeSet<&str> = written.chain(defaults).collect();
        assert!(keys.len() > 25, "{keys:?}");
        for key in keys {
            let entry = entry(key).unwrap_or_else(|| panic!("{key} has no entry"));
            assert!(entry.starts_with('@') && entry.contains(&format!("{{{key},")) && entry.ends_with("}\n}\n"), "{entry}");
            assert_eq!(entry.matches("\n@").count(), 0, "{key}: two entries");
        }
    }
}
