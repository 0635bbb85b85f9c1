//! `[tracking]` beyond the gains of the parameter table: force scheme, boundary search and the base, \[Billet2009\] §4–5.

use std::collections::BTreeSet;
use std::path::PathBuf;

use super::words;
use crate::heart::{Parameters, RegionalParameter, Section};
use crate::study::reader::{Choice, TableReader};
use crate::tracking::{BaseProjection, BlockMatchingSettings, BlockShape, BoundarySettings, ForceScheme, Similarity};

impl Choice for ForceScheme {
    const WORDS: &'static [(&'static str, Self)] =
        &[("explicit", Self::Explicit), ("published", Self::Published), ("exact", Self::Exact), ("variational", Self::Variational)];
}

impl Choice for Similarity {
    const WORDS: &'static [(&'static str, Self)] = &[("ssd", Self::Ssd), ("ncc", Self::Ncc)];
}

impl Choice for BlockShape {
    const WORDS: &'static [(&'static str, Self)] = &[("still", Self::Still), ("carried", Self::Carried)];
}

impl Choice for BaseProjection {
    const WORDS: &'static [(&'static str, Self)] = &[("normal", Self::Normal), ("full", Self::Full)];
}

words! {
    /// What holds the base, \[Billet2009\] §6.2.
    BaseMode {
        /// Nothing.
        Free = "free",
        /// Springs to the place of rest.
        Springs = "springs",
        /// Springs to block-matched positions.
        BlockMatching = "block_matching",
        /// Springs to the motion that an earlier run left.
        Recorded = "recorded",
    }
}

words! {
    /// What draws the inside of the wall, beyond its surfaces.
    WallMode {
        /// The model alone.
        Model = "model",
        /// Blocks matched around every vertex.
        BlockMatching = "block_matching",
    }
}

words! {
    /// How the image gains are chosen.
    GainChoice {
        /// As the study file writes them.
        Written = "written",
        /// By the error at boundary points that are held out, all surfaces alike.
        HeldOut = "held_out",
        /// The same, one surface after the other.
        HeldOutBySurface = "held_out_by_surface",
        /// So that the boundary points stay as far away as their noise, `noise_mm`.
        Discrepancy = "discrepancy",
    }
}

/// How images pull on the heart; the gains themselves are parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackingPlan {
    /// `scheme`.
    pub scheme: ForceScheme,
    /// `gains`.
    pub gains: GainChoice,
    /// `noise_mm`: of boundary points, for the discrepancy principle.
    pub noise_mm: f64,
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
    /// `base_motion`: the `base_motion.csv` of an earlier run on the same mesh, for `base = "recorded"`.
    pub base_motion: Option<PathBuf>,
    /// `base_projection`: which part of the way to a matched block is pulled.
    pub base_projection: BaseProjection,
    /// `similarity`.
    pub similarity: Similarity,
    /// `block_size_mm`: edge of a block.
    pub block_size_mm: f64,
    /// `block_range_mm`: how far around the current position a block is searched.
    pub block_range_mm: f64,
    /// `block_shape`.
    pub block_shape: BlockShape,
    /// `block_window`: the intensities that carried blocks see, in standard deviations of the wall's own; all if nothing is written.
    pub block_window: Option<f64>,
    /// `wall`.
    pub wall: WallMode,
    /// `wall_gain_kpa_per_mm2`: per volume, for `wall = "block_matching"`.
    pub wall_gain_kpa_per_mm2: f64,
}

pub(super) fn read(table: TableReader, parameters: &mut Parameters, written: &mut BTreeSet<RegionalParameter>) -> TrackingPlan {
    table.parameters(Section::Tracking, parameters, written);
    let (boundary, blocks) = (BoundarySettings::default(), BlockMatchingSettings::default());
    let block_size_mm = blocks.voxel_mm * (2 * blocks.block_radius_voxels + 1) as f64;
    let plan = TrackingPlan {
        scheme: table.choice("scheme", ForceScheme::default()),
        gains: table.choice("gains", GainChoice::Written),
        noise_mm: table.number("noise_mm", 0.01..=10.0, 0.5),
        search_range_mm: table.number("search_range_mm", 1.0..=50.0, boundary.range_mm),
        search_step_mm: table.number("search_step_mm", 0.05..=5.0, boundary.sample_mm),
        max_angle_deg: table.number("max_angle_deg", 5.0..=89.0, boundary.angle_none_deg),
        held_out_fraction: table.number("held_out_fraction", 0.0..=0.5, 0.1),
        seed: table.count("seed", 0..=i64::MAX, 1) as u64,
        base: table.choice("base", BaseMode::BlockMatching),
        base_motion: table.result_file("base_motion"),
        base_projection: table.choice("base_projection", BaseProjection::default()),
        similarity: table.choice("similarity", Similarity::default()),
        block_size_mm: table.number("block_size_mm", 2.0..=60.0, block_size_mm),
        block_range_mm: table.number("block_range_mm", 1.0..=40.0, blocks.range_mm),
        block_shape: table.choice("block_shape", blocks.shape),
        block_window: table.optional_number("block_window", 0.5..=100.0),
        wall: table.choice("wall", WallMode::Model),
        wall_gain_kpa_per_mm2: table.number("wall_gain_kpa_per_mm2", 0.0..=1e4, 1.0),
    };
    if plan.search_step_mm > plan.search_range_mm {
        table.problem("search_step_mm", "is longer than search_range_mm", format!("choose at most {}", plan.search_range_mm));
    }
    if plan.block_window.is_some() && (plan.block_shape, plan.wall) == (BlockShape::Still, WallMode::Model) {
        table.problem("block_window", "is of no use to still blocks", "write block_shape = \"carried\", or take it away");
    }
    match (plan.base, &plan.base_motion) {
        (BaseMode::Recorded, None) if !table.has("base_motion") => table.missing("base_motion", "the base_motion.csv of an earlier run"),
        (BaseMode::Recorded, _) | (_, None) => {}
        (_, Some(_)) => table.problem("base_motion", "is of no use here", "write base = \"recorded\", or take it away"),
    }
    if matches!(plan.gains, GainChoice::HeldOut | GainChoice::HeldOutBySurface) && plan.held_out_fraction == 0.0 {
        table.problem("gains", "needs points that are held out", "choose held_out_fraction above 0, or gains = \"written\"");
    }
    table.close();
    plan
}
