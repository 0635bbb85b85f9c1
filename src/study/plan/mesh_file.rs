//! `[anatomy.mesh]`: a mesh made elsewhere, with its tagged surface and, where it has them, fibres.

use std::path::PathBuf;

use super::anatomy::DIASTASIS_S;
use super::words;
use crate::mesh::SurfaceTag;
use crate::study::reader::TableReader;

words! {
    /// Where a file has its fibres.
    FibreSource {
        /// They follow the rule of the fibre angles.
        Rule = "rule",
        /// A direction a vertex.
        Vertices = "vertices",
        /// A direction a tetrahedron.
        Tetrahedra = "tetrahedra",
    }
}

/// A mesh made elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshPlan {
    /// `file`: `.vtu`, `.vtk` or `.msh`.
    pub path: PathBuf,
    /// `mm_per_unit`: length of the file's unit; 1000 for metres.
    pub mm_per_unit: f64,
    /// `surface_field`: field of the triangles that tells the surfaces apart.
    pub surface_field: String,
    /// `code_base`, `code_endocardium_lv`, …: what stands for each surface there.
    pub codes: Vec<(i64, SurfaceTag)>,
    /// `fibres`.
    pub fibres: FibreSource,
    /// `fibre_field`: field of the fibre directions.
    pub fibre_field: String,
    /// `sheet_field`: field of the sheet directions, across the fibre; the wall's normal where it is not written.
    pub sheet_field: Option<String>,
    /// `reference_time_s`: the time of the beat at which the shape holds, s after the trigger.
    pub reference_time_s: f64,
}

pub(super) fn read(table: TableReader) -> MeshPlan {
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
    let plan = MeshPlan {
        path: if table.is_written() { table.required_data_file("file") } else { table.data_file("file").unwrap_or_default() },
        mm_per_unit: table.number("mm_per_unit", 1e-6..=1e6, 1.0),
        surface_field: table.text("surface_field").unwrap_or("surface_tag").into(),
        codes,
        fibres: table.choice("fibres", FibreSource::Rule),
        fibre_field: table.text("fibre_field").unwrap_or("fibre").into(),
        sheet_field: table.text("sheet_field").map(Into::into),
        reference_time_s: table.number("reference_time_s", -2.5..=2.5, DIASTASIS_S),
    };
    table.close();
    plan
}
