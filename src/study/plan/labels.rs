//! `anatomy.labels` or `anatomy.mask_…`: the patient's heart as somebody drew it on one frame, \[Billet2009\] §3.

use std::ops::Range;
use std::path::{Path, PathBuf};

use super::images::slice_range;
use crate::image::{BaseCut, FieldOptions, HeartCodes, MASK_CODES, Plane};
use crate::study::reader::{Choice, TableReader};

/// A heart drawn on one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelsPlan {
    /// The file or files.
    pub source: LabelSource,
    /// `frame`: the frame of the cine that it was drawn on, from 0; simulations start at that frame's time. Of a file with labels of
    /// every frame, this one is taken.
    pub frame: usize,
    /// `label_slices`: the slices whose labels count, all where absent.
    pub slices: Option<Range<usize>>,
    /// `base`, or `base_points_mm`, or `base_point_mm` and `base_normal`: where the heart is cut at the base.
    pub base: BaseCut,
    /// `wall_thickness_lv_mm`: thickness of the wall that is grown around a left cavity without one; without it such slices do not count.
    pub wall_thickness_lv_mm: Option<f64>,
    /// `wall_thickness_rv_mm`: thickness of the wall that is grown around a right cavity without one.
    pub wall_thickness_rv_mm: f64,
}

/// Where a heart is drawn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LabelSource {
    /// One label map.
    Map {
        /// `labels`: NIfTI.
        path: PathBuf,
        /// `code_cavity_lv`, `code_wall_lv`, `code_cavity_rv`, `code_wall_rv`.
        codes: HeartCodes,
    },
    /// Binary masks, NIfTI.
    Masks {
        /// `mask_epicardium`: what the epicardium encloses.
        epicardium: PathBuf,
        /// `mask_endocardium_lv`: left blood.
        endocardium_lv: PathBuf,
        /// `mask_endocardium_rv`: right blood.
        endocardium_rv: Option<PathBuf>,
    },
}

impl LabelSource {
    /// All files.
    pub fn files(&self) -> Vec<&Path> {
        match self {
            Self::Map { path, .. } => vec![path],
            Self::Masks { epicardium, endocardium_lv, endocardium_rv } => {
                [Some(epicardium), Some(endocardium_lv), endocardium_rv.as_ref()].into_iter().flatten().map(PathBuf::as_path).collect()
            }
        }
    }

    /// What the numbers of the label map mean; of that which masks are joined to.
    pub fn codes(&self) -> HeartCodes {
        match self {
            Self::Map { codes, .. } => *codes,
            Self::Masks { endocardium_rv: Some(_), .. } => MASK_CODES,
            Self::Masks { .. } => HeartCodes { cavity_rv: None, ..MASK_CODES },
        }
    }
}

impl LabelsPlan {
    /// How fields are made from these labels.
    pub fn field_options(&self) -> FieldOptions {
        let Self { base, wall_thickness_lv_mm, wall_thickness_rv_mm, .. } = *self;
        FieldOptions { base, wall_thickness_lv_mm, wall_thickness_rv_mm, ..FieldOptions::default() }
    }
}

impl Choice for BaseCut {
    const WORDS: &'static [(&'static str, Self)] = &[("outer_face", Self::OuterFace), ("mid_slice", Self::MidSlice)];
}

/// The keys that are of no use without labels or masks.
pub(super) const LABEL_KEYS: [&str; 11] = [
    "code_cavity_lv",
    "code_wall_lv",
    "code_cavity_rv",
    "code_wall_rv",
    "label_slices",
    "base",
    "base_point_mm",
    "base_normal",
    "base_points_mm",
    "wall_thickness_lv_mm",
    "wall_thickness_rv_mm",
];

/// Reads what was drawn.
pub(super) fn read(table: &TableReader) -> LabelsPlan {
    let codes = read_codes(table);
    let masks = ["mask_epicardium", "mask_endocardium_lv", "mask_endocardium_rv"].map(|key| table.data_file(key));
    let has_masks = masks.iter().any(Option::is_some);
    let path = table.data_file("labels").unwrap_or_default();
    let source = match masks {
        [Some(epicardium), Some(endocardium_lv), endocardium_rv] => LabelSource::Masks { epicardium, endocardium_lv, endocardium_rv },
        [epicardium, _, _] if has_masks => {
            let missing = if epicardium.is_none() { "mask_epicardium" } else { "mask_endocardium_lv" };
            if !table.has(missing) {
                table.missing(missing, "the path of a file: the epicardium and the left endocardium are needed, the right one is not");
            }
            LabelSource::Map { path, codes }
        }
        _ => LabelSource::Map { path, codes },
    };
    if has_masks {
        for key in LABEL_KEYS.into_iter().take(4).filter(|key| table.has(key)) {
            table.problem(key, "is of no use with masks", "take it away: whatever is not 0 is inside a mask");
        }
    }
    LabelsPlan {
        source,
        frame: table.count("frame", 0..=100_000, 0),
        slices: slice_range(table, "label_slices"),
        base: read_base(table),
        wall_thickness_lv_mm: table.optional_number("wall_thickness_lv_mm", 1.0..=30.0),
        wall_thickness_rv_mm: table.number("wall_thickness_rv_mm", 1.0..=20.0, FieldOptions::default().wall_thickness_rv_mm),
    }
}

fn read_codes(table: &TableReader) -> HeartCodes {
    let optional = |key| table.optional_count(key, 1..=i64::from(u8::MAX)).and_then(|code| u8::try_from(code).ok());
    let codes = HeartCodes {
        cavity_lv: optional("code_cavity_lv").unwrap_or(1),
        wall_lv: optional("code_wall_lv").unwrap_or(2),
        cavity_rv: optional("code_cavity_rv"),
        wall_rv: optional("code_wall_rv"),
    };
    if codes.cavity_lv == codes.wall_lv {
        table.problem("code_wall_lv", "equals code_cavity_lv", "give the wall and the cavity their own codes");
    }
    if codes.cavity_rv.is_some_and(|code| code == codes.cavity_lv || code == codes.wall_lv) {
        table.problem("code_cavity_rv", "stands for the left ventricle", "give the right cavity its own code");
    }
    if codes.wall_rv.is_some_and(|code| code == codes.cavity_lv || code == codes.wall_lv || Some(code) == codes.cavity_rv) {
        table.problem("code_wall_rv", "stands for something else", "take it away if both walls share code_wall_lv");
    }
    if codes.wall_rv.is_some() && codes.cavity_rv.is_none() {
        table.problem("code_wall_rv", "stands without code_cavity_rv", "write the code of the right cavity too");
    }
    codes
}

fn read_base(table: &TableReader) -> BaseCut {
    if let Some(points_mm) = table.vectors("base_points_mm") {
        for key in ["base", "base_point_mm", "base_normal"].into_iter().filter(|key| table.has(key)) {
            table.problem(key, "stands beside base_points_mm", "take one of the two away");
        }
        let plane = Plane::through(&points_mm);
        if plane.is_none() {
            table.problem("base_points_mm", "spans no plane", "write at least three points that do not lie on a line");
        }
        return plane.map_or(BaseCut::OuterFace, BaseCut::Plane);
    }
    let flat = table.choice("base", BaseCut::OuterFace);
    let (point_mm, normal) = (table.vector("base_point_mm"), table.vector("base_normal"));
    let direction = normal.and_then(|normal| normal.try_normalize(1e-9));
    if normal.is_some() && direction.is_none() {
        table.problem("base_normal", "has no direction", "write a vector that is not zero");
    }
    match (point_mm, direction) {
        (Some(point_mm), Some(normal)) => {
            if table.has("base") {
                table.problem("base", "stands beside base_point_mm and base_normal", "take one of the two away");
            }
            BaseCut::Plane(Plane { point_mm, normal })
        }
        (point_mm, _) => {
            if table.has("base_point_mm") != table.has("base_normal") {
                let missing = if point_mm.is_some() { "base_normal" } else { "base_point_mm" };
                table.missing(missing, "three numbers: a plane needs its point and its normal");
            }
            flat
        }
    }
}
