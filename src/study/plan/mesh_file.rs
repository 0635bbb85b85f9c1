//! `anatomy.mesh` and `[anatomy.mesh_tables]`: a mesh made elsewhere, with its tagged surface and, where it has them, fibres.

use std::path::{Path, PathBuf};

use super::anatomy::DIASTASIS_S;
use super::words;
use crate::mesh::SurfaceTag;
use crate::mesh::io::{Numbering, TableFiles};
use crate::study::reader::{Choice, TableReader};

words! {
    /// The unit of length of a file.
    LengthUnit {
        /// Millimetres.
        Millimetre = "mm",
        /// Centimetres.
        Centimetre = "cm",
        /// Metres.
        Metre = "m",
    }
}

impl LengthUnit {
    /// Its length in mm.
    pub fn mm(self) -> f64 {
        match self {
            Self::Millimetre => 1.0,
            Self::Centimetre => 10.0,
            Self::Metre => 1000.0,
        }
    }
}

impl Choice for Numbering {
    const WORDS: &'static [(&'static str, Self)] = &[("oriented", Self::Oriented), ("free", Self::Free)];
}

/// A mesh made elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshPlan {
    /// The file or files.
    pub source: MeshSource,
    /// `unit`: the file's unit of length.
    pub unit: LengthUnit,
    /// `numbering`: whether the order of a tetrahedron's corners means anything.
    pub numbering: Numbering,
    /// `surface_field`: field of the triangles that tells the surfaces apart; the usual one where it is not written.
    pub surface_field: Option<String>,
    /// `code_base`, `code_endocardium_lv`, …: what stands for each surface there.
    pub codes: Vec<(i64, SurfaceTag)>,
    /// `fibre_field`: field of the fibre directions, of tetrahedra or points; the rule of the fibre angles where it is not written.
    pub fibre_field: Option<String>,
    /// `sheet_field`: field of the sheet directions, across the fibre; the wall's normal where it is not written.
    pub sheet_field: Option<String>,
    /// `reference_time_s`: the time of the beat at which the shape holds, s after the trigger.
    pub reference_time_s: f64,
}

/// Where a mesh is written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MeshSource {
    /// `mesh`: a `.vtu`, `.vtk` or `.msh` file.
    File(PathBuf),
    /// `[anatomy.mesh_tables]`: plain text.
    Tables(TableFiles),
}

impl MeshSource {
    /// The file that stands for all in messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Tables(files) => &files.vertices,
        }
    }

    /// All files.
    pub fn files(&self) -> Vec<PathBuf> {
        match self {
            Self::File(path) => vec![path.clone()],
            Self::Tables(files) => [&files.vertices, &files.tetrahedra, &files.surface].into_iter().chain(&files.fibres).cloned().collect(),
        }
    }
}

/// Reads `mesh` or `[anatomy.mesh_tables]` and the keys that say how to understand it, which without a mesh are of no use.
pub(super) fn read(table: &TableReader) -> Option<MeshPlan> {
    let tables = read_tables(table.table("mesh_tables"));
    let source = table.data_file("mesh").map(MeshSource::File).or(tables);
    let code = |tag: SurfaceTag, key| (table.count(key, 0..=1_000_000, i64::from(tag.code())) as i64, tag);
    let codes = vec![
        code(SurfaceTag::Base, "code_base"),
        code(SurfaceTag::EndocardiumRv, "code_endocardium_rv"),
        code(SurfaceTag::EndocardiumLv, "code_endocardium_lv"),
        code(SurfaceTag::Epicardium, "code_epicardium"),
    ];
    let is_twice = |code: i64| codes.iter().filter(|(other, _)| *other == code).count() > 1;
    if let Some((code, _)) = codes.iter().find(|(code, _)| is_twice(*code)) {
        table.problem("", format!("gives two surfaces the code {code}"), "give each surface its own code");
    }
    let has_table_fibres = matches!(&source, Some(MeshSource::Tables(TableFiles { fibres: Some(_), .. })));
    let field = |key| table.text(key).map(str::to_string);
    let usual = |name: &str| has_table_fibres.then(|| name.to_string());
    let (unit, numbering) = (table.choice("unit", LengthUnit::Millimetre), table.choice("numbering", Numbering::Oriented));
    let surface_field = field("surface_field");
    let (fibre_field, sheet_field) = (field("fibre_field").or(usual("fibre")), field("sheet_field"));
    let reference_time_s = table.number("reference_time_s", -2.5..=2.5, DIASTASIS_S);
    let Some(source) = source else {
        for key in MESH_KEYS.into_iter().filter(|key| table.has(key)) {
            table.problem(key, "is of no use without a mesh", "write mesh = \"…\", or take it away");
        }
        return None;
    };
    if sheet_field.is_some() && fibre_field.is_none() {
        table.problem("sheet_field", "stands without fibre_field", "name the field of the fibres too");
    }
    Some(MeshPlan { source, unit, numbering, surface_field, codes, fibre_field, sheet_field, reference_time_s })
}

/// The keys that say how to understand a mesh.
const MESH_KEYS: [&str; 10] = [
    "unit",
    "numbering",
    "surface_field",
    "code_base",
    "code_endocardium_rv",
    "code_endocardium_lv",
    "code_epicardium",
    "fibre_field",
    "sheet_field",
    "reference_time_s",
];

fn read_tables(table: TableReader) -> Option<MeshSource> {
    let required = |key| if table.is_written() { table.required_data_file(key) } else { table.data_file(key).unwrap_or_default() };
    let files = TableFiles {
        vertices: required("vertices"),
        tetrahedra: required("tetrahedra"),
        surface: required("surface"),
        fibres: table.data_file("fibres"),
    };
    let is_written = table.is_written();
    table.close();
    is_written.then_some(MeshSource::Tables(files))
}
