//! `[tracking]` beyond the gains of the parameter table: force scheme, boundary search and the base, [Billet2009] §4–5.

use std::collections::BTreeSet;

use super::words;
use crate::heart::{Parameter, Parameters, Section};
use crate::study::reader::TableReader;

words! {
    /// How image forces enter the time step.
    ForceScheme {
        /// At the step's start, [Billet2009] §4.2.
        Explicit = "explicit",
        /// Implicit with B as printed in [Billet2009] eq. 3.
        Published = "published",
        /// Implicit with the derivative of the construction itself.
        Exact = "exact",
        /// Implicit from an energy: symmetric.
        Variational = "variational",
    }
}

words! {
    /// What holds the base, [Billet2009] §6.2.
    BaseMode {
        /// Nothing.
        Free = "free",
        /// Springs to the place of rest.
        Springs = "springs",
        /// Springs to block-matched positions.
        BlockMatching = "block_matching",
    }
}

words! {
    /// How two blocks of voxels are compared.
    Similarity {
        /// Sum of squared differences.
        Ssd = "ssd",
        /// Normalised cross-correlation.
        Ncc = "ncc",
    }
}

words! {
    /// How the image gains are chosen.
    GainChoice {
        /// As the study file writes them.
        Written = "written",
        /// By the error at boundary points that are held out.
        HeldOut = "held_out",
    }
}

/// How images pull on the heart; the gains themselves are parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackingPlan {
    /// `scheme`.
    pub scheme: ForceScheme,
    /// `gains`.
    pub gains: GainChoice,
    /// `search_range_mm`: how far along the normal a boundary is searched, either way.
    pub search_range_mm: f64,
    /// `search_step_mm`: distance of samples along the normal.
    pub search_step_mm: f64,
    /// `max_angle_deg`: boundaries turned more than this against the surface are dropped.
    pub max_angle_deg: f64,
    /// `held_out_fraction`: part of the boundary points that pulls on nothing and judges instead.
    pub held_out_fraction: f64,
    /// `seed`: of the choice of held-out points.
    pub seed: u64,
    /// `base`.
    pub base: BaseMode,
    /// `similarity`.
    pub similarity: Similarity,
    /// `block_size_mm`: edge of a block.
    pub block_size_mm: f64,
    /// `block_range_mm`: how far around the current position a block is searched.
    pub block_range_mm: f64,
    /// `beats`: beats that are tracked; results are of the last one.
    pub beats: usize,
}

pub(super) fn read(table: TableReader, parameters: &mut Parameters, written: &mut BTreeSet<Parameter>) -> TrackingPlan {
    table.parameters(Section::Tracking, parameters, written);
    let plan = TrackingPlan {
        scheme: table.choice("scheme", ForceScheme::Variational),
        gains: table.choice("gains", GainChoice::Written),
        search_range_mm: table.number("search_range_mm", 1.0..=50.0, 10.0),
        search_step_mm: table.number("search_step_mm", 0.05..=5.0, 0.5),
        max_angle_deg: table.number("max_angle_deg", 5.0..=89.0, 60.0),
        held_out_fraction: table.number("held_out_fraction", 0.0..=0.5, 0.1),
        seed: table.count("seed", 0..=i64::MAX, 1) as u64,
        base: table.choice("base", BaseMode::BlockMatching),
        similarity: table.choice("similarity", Similarity::Ssd),
        block_size_mm: table.number("block_size_mm", 2.0..=60.0, 12.0),
        block_range_mm: table.number("block_range_mm", 1.0..=40.0, 8.0),
        beats: table.count("beats", 1..=20, 1),
    };
    if plan.search_step_mm > plan.search_range_mm {
        table.problem("search_step_mm", "is longer than search_range_mm", format!("choose at most {}", plan.search_range_mm));
    }
    if plan.gains == GainChoice::HeldOut && plan.held_out_fraction == 0.0 {
        table.problem("gains", "needs points that are held out", "choose held_out_fraction above 0, or gains = \"written\"");
    }
    table.close();
    plan
}
