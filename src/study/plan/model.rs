//! `[electrophysiology]` and `[mechanics]` beyond the parameters: onset and time step.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::words;
use crate::heart::{Parameters, RegionalParameter, Section};
use crate::mechanics::TimeScheme;
use crate::study::reader::TableReader;

words! {
    /// Where the first depolarisation takes place, at `onset_time_s`.
    OnsetSite {
        /// Where the Purkinje network of a normal heart ends.
        Normal = "normal",
        /// Left bundle branch block: the right ventricle alone.
        LeftBundleBranchBlock = "lbbb",
        /// A pacing lead in the apex of the right ventricle alone.
        RightApicalPacing = "rv_apical_pacing",
        /// Leads in the apex of the right ventricle and on the lateral wall of the left.
        BiventricularPacing = "biventricular_pacing",
        /// The whole LV endocardium.
        Endocardium = "endocardium",
        /// The vertices nearest to `[[electrophysiology.site]]`, and nothing else.
        Sites = "sites",
    }
}

words! {
    /// How strain is measured.
    KinematicsPlan {
        /// Small strain, the paper's.
        Linear = "linear",
        /// Large rotations.
        Corotational = "corotational",
    }
}

words! {
    /// How time is discretised.
    TimeSchemePlan {
        /// First order, damps fast modes; the paper's.
        BackwardEuler = "backward_euler",
        /// Second order, damps fast modes by `mechanics.spectral_radius`.
        GeneralisedAlpha = "generalised_alpha",
    }
}

/// Where and when depolarisation starts.
#[derive(Debug, Clone, PartialEq)]
pub struct OnsetPlan {
    /// `onset`.
    pub place: OnsetSite,
    /// `[[electrophysiology.site]]`: sites beside any other onset.
    pub sites: Vec<SitePlan>,
}

/// `[[electrophysiology.site]]`: a pacing lead, or where an extrasystole comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SitePlan {
    /// `position_mm`: world, RAS.
    pub position_mm: Vector3<f64>,
    /// `delay_s` after the onset of a beat.
    pub delay_s: f64,
    /// `beat`: the beat, from 1, in which alone it stimulates; in every one where absent.
    pub beat: Option<usize>,
}

/// How the model is run.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelPlan {
    /// Onset of depolarisation.
    pub onset: OnsetPlan,
    /// `mechanics.step_s`: time step.
    pub step_s: f64,
    /// `mechanics.kinematics`: how strain is measured.
    pub kinematics: KinematicsPlan,
    /// `mechanics.time_scheme` with `mechanics.spectral_radius`: how time is discretised.
    pub time_scheme: TimeScheme,
}

pub(super) fn read(root: &TableReader, parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) -> ModelPlan {
    let onset = read_onset(root.table(Section::Electrophysiology.key()), parameters, written);
    let mechanics = root.table(Section::Mechanics.key());
    mechanics.parameters(Section::Mechanics, parameters, written);
    let kinematics = mechanics.choice("kinematics", KinematicsPlan::Linear);
    let time_scheme = read_time_scheme(&mechanics);
    let plan = ModelPlan { onset, step_s: mechanics.number("step_s", 1e-5..=0.05, 0.005), kinematics, time_scheme };
    mechanics.close();
    plan
}

fn read_time_scheme(mechanics: &TableReader) -> TimeScheme {
    let scheme = mechanics.choice("time_scheme", TimeSchemePlan::BackwardEuler);
    let spectral_radius = mechanics.number("spectral_radius", 0.0..=1.0, 0.5);
    match scheme {
        TimeSchemePlan::GeneralisedAlpha => TimeScheme::GeneralisedAlpha { spectral_radius },
        TimeSchemePlan::BackwardEuler => {
            if mechanics.has("spectral_radius") {
                mechanics.problem(
                    "spectral_radius",
                    "is of generalised_alpha alone",
                    "write time_scheme = \"generalised_alpha\", or leave it out",
                );
            }
            TimeScheme::BackwardEuler
        }
    }
}

fn read_onset(table: TableReader, parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) -> OnsetPlan {
    table.parameters(Section::Electrophysiology, parameters, written);
    let onset = read_onset_sites(&table);
    table.close();
    onset
}

/// `onset` and `[[site]]` of a table.
pub(super) fn read_onset_sites(table: &TableReader) -> OnsetPlan {
    let place = table.choice("onset", OnsetSite::Normal);
    let sites: Vec<_> = table.tables("site").into_iter().map(read_site).collect();
    if place == OnsetSite::Sites && sites.iter().all(|site| site.beat.is_some()) {
        table.missing("site", "a site with its position_mm, and without `beat`: it starts every beat");
    }
    OnsetPlan { place, sites }
}

fn read_site(table: TableReader) -> SitePlan {
    let position_mm = table.vector("position_mm");
    if !table.has("position_mm") {
        table.missing("position_mm", "three numbers, [x, y, z], in world coordinates (RAS)");
    }
    let (delay_s, beat) = (table.number("delay_s", 0.0..=2.5, 0.0), table.optional_count("beat", 1..=100));
    table.close();
    SitePlan { position_mm: position_mm.unwrap_or_default(), delay_s, beat }
}
