//! `[anatomy]`: the heart at rest, from labels or masks of a patient, a mesh made elsewhere or an idealised shape, \[Billet2009\] §3.

use nalgebra::Vector3;

use super::labels::{self, LabelsPlan};
use super::mesh_file::{self, MeshPlan};
use crate::anatomy::IdealisedBiventricle;
use crate::study::reader::TableReader;

/// Before the atrial kick of a beat at rest, s after the trigger: the filling has come to an end, and the heart is nearly still.
pub(super) const DIASTASIS_S: f64 = -0.15;

/// The heart at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct AnatomyPlan {
    /// Where its shape comes from.
    pub source: AnatomySource,
    /// `edge_length_mm`: length of a tetrahedron's edge.
    pub edge_length_mm: f64,
    /// Fibre angles.
    pub fibres: FibrePlan,
    /// Fibre angles of the free wall of the right ventricle: `fibre_angle_rv_endocardium_deg`, `fibre_angle_rv_epicardium_deg`.
    pub fibres_rv: FibrePlan,
    /// `septal_direction`: a vector in world coordinates (RAS) from the long axis to the septum, which AHA angles start from; the
    /// anatomy's own choice where absent.
    pub septal_direction: Option<Vector3<f64>>,
}

/// Where the shape comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum AnatomySource {
    /// Labels or masks drawn on one frame of the cine.
    Labels(LabelsPlan),
    /// A truncated ellipsoid.
    IdealisedLv(IdealisedLv),
    /// Two ventricles between ellipsoids.
    IdealisedBiventricle {
        /// `[anatomy.idealised_biventricle]`.
        shape: IdealisedBiventricle,
        /// `reference_time_s`, as for [`IdealisedLv::reference_time_s`].
        reference_time_s: f64,
    },
    /// A mesh made elsewhere.
    Mesh(MeshPlan),
}

impl AnatomySource {
    /// Whether the shape is made up.
    pub fn is_idealised(&self) -> bool {
        matches!(self, Self::IdealisedLv(_) | Self::IdealisedBiventricle { .. })
    }
}

/// `[anatomy.idealised_lv]`: the wall between two truncated ellipsoids; lengths are semi-axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdealisedLv {
    /// `cavity_radius_mm`: short semi-axis of the cavity.
    pub cavity_radius_mm: f64,
    /// `cavity_length_mm`: long semi-axis of the cavity, from the centre to the apex.
    pub cavity_length_mm: f64,
    /// `wall_thickness_mm`: wall at the equator.
    pub wall_thickness_mm: f64,
    /// `apex_thickness_mm`: wall at the apex.
    pub apex_thickness_mm: f64,
    /// `base_height_mm`: height of the base above the centre.
    pub base_height_mm: f64,
    /// `cross_section_ratio`: long over short axis of the cavity's cross-section.
    pub cross_section_ratio: f64,
    /// `epicardium_offset_mm`: how far the epicardium lies off the cavity's axis.
    pub epicardium_offset_mm: f64,
    /// `reference_time_s`: the time of the beat at which the shape holds, s after the trigger.
    pub reference_time_s: f64,
}

/// Fibre angles against the short-axis plane, linear in depth between the two surfaces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FibrePlan {
    /// `fibre_angle_endocardium_deg`.
    pub endocardium_deg: f64,
    /// `fibre_angle_epicardium_deg`.
    pub epicardium_deg: f64,
}

pub(super) fn read(table: TableReader) -> AnatomyPlan {
    let (lv, biventricle) = (table.table("idealised_lv"), table.table("idealised_biventricle"));
    let written = [
        ("labels", table.has("labels")),
        ("mask_epicardium", table.has("mask_epicardium")),
        ("mesh", table.has("mesh")),
        ("mesh_tables", table.has("mesh_tables")),
        ("idealised_lv", lv.is_written()),
        ("idealised_biventricle", biventricle.is_written()),
    ];
    let mut sources = written.iter().filter(|(_, is_written)| *is_written).map(|(key, _)| *key);
    let first = sources.next();
    match (first, sources.next()) {
        (None, _) => table.missing(
            "labels",
            "labels = \"…\" (a label map), mask_epicardium = \"…\" and mask_endocardium_lv = \"…\", mesh = \"…\", [anatomy.mesh_tables], [anatomy.idealised_lv] or [anatomy.idealised_biventricle]",
        ),
        (Some(one), Some(other)) => {
            table.problem(one, format!("stands beside {other}"), "the heart has one shape: take one of the two away")
        }
        _ => {}
    }
    let (lv, (shape, reference_time_s), mesh) = (read_idealised(lv), read_biventricle(biventricle), mesh_file::read(&table));
    let drawn = labels::read(&table);
    let source = match (first, mesh) {
        (Some("idealised_lv"), _) => AnatomySource::IdealisedLv(lv),
        (Some("idealised_biventricle"), _) => AnatomySource::IdealisedBiventricle { shape, reference_time_s },
        (Some("mesh" | "mesh_tables"), Some(mesh)) => AnatomySource::Mesh(mesh),
        _ => AnatomySource::Labels(drawn),
    };
    if !matches!(source, AnatomySource::Labels(_)) {
        for key in labels::LABEL_KEYS.into_iter().filter(|key| table.has(key)) {
            table.problem(key, "is of no use without labels", "write labels = \"…\", or take it away");
        }
    }
    if matches!(source, AnatomySource::Mesh(_)) && table.has("edge_length_mm") {
        table.problem("edge_length_mm", "is of no use with a mesh", "take it away: the mesh has its edges");
    }
    let angle = |key, default| table.number(key, -90.0..=90.0, default);
    let fibres = FibrePlan {
        endocardium_deg: angle("fibre_angle_endocardium_deg", 80.0),
        epicardium_deg: angle("fibre_angle_epicardium_deg", -80.0),
    };
    let fibres_rv = FibrePlan {
        endocardium_deg: angle("fibre_angle_rv_endocardium_deg", fibres.endocardium_deg),
        epicardium_deg: angle("fibre_angle_rv_epicardium_deg", fibres.epicardium_deg),
    };
    let plan = AnatomyPlan {
        source,
        edge_length_mm: table.number("edge_length_mm", 0.5..=20.0, 5.0),
        fibres,
        fibres_rv,
        septal_direction: table.vector("septal_direction").filter(|direction| {
            let is_direction = direction.norm() > 0.0;
            if !is_direction {
                table.problem("septal_direction", "has no direction", "write a vector that is not zero");
            }
            is_direction
        }),
    };
    table.close();
    plan
}

fn read_idealised(table: TableReader) -> IdealisedLv {
    let plan = IdealisedLv {
        cavity_radius_mm: table.number("cavity_radius_mm", 2.0..=100.0, 24.0),
        cavity_length_mm: table.number("cavity_length_mm", 2.0..=200.0, 60.0),
        wall_thickness_mm: table.number("wall_thickness_mm", 1.0..=50.0, 10.0),
        apex_thickness_mm: table.number("apex_thickness_mm", 1.0..=50.0, 8.0),
        base_height_mm: table.number("base_height_mm", 0.0..=150.0, 20.0),
        cross_section_ratio: table.number("cross_section_ratio", 0.5..=2.0, 1.0),
        epicardium_offset_mm: table.number("epicardium_offset_mm", -40.0..=40.0, 0.0),
        reference_time_s: table.number("reference_time_s", -2.5..=2.5, -0.02),
    };
    if plan.base_height_mm >= plan.cavity_length_mm {
        table.problem("base_height_mm", "lies beyond the cavity", format!("choose less than cavity_length_mm, {}", plan.cavity_length_mm));
    }
    let thinnest_mm = 0.8 * plan.wall_thickness_mm;
    if plan.epicardium_offset_mm.abs() > thinnest_mm {
        table.problem("epicardium_offset_mm", "leaves no wall on one side", format!("choose at most {thinnest_mm} either way"));
    }
    table.close();
    plan
}

fn read_biventricle(table: TableReader) -> (IdealisedBiventricle, f64) {
    let default = IdealisedBiventricle::default();
    let length = |key, default| table.number(key, 0.5..=200.0, default);
    let shape = IdealisedBiventricle {
        lv_radius_mm: length("lv_radius_mm", default.lv_radius_mm),
        lv_length_mm: length("lv_length_mm", default.lv_length_mm),
        lv_wall_mm: length("lv_wall_mm", default.lv_wall_mm),
        rv_width_mm: length("rv_width_mm", default.rv_width_mm),
        rv_depth_mm: length("rv_depth_mm", default.rv_depth_mm),
        rv_length_mm: length("rv_length_mm", default.rv_length_mm),
        rv_offset_mm: length("rv_offset_mm", default.rv_offset_mm),
        rv_wall_mm: length("rv_wall_mm", default.rv_wall_mm),
        rounding_mm: length("rounding_mm", default.rounding_mm),
        base_height_mm: table.number("base_height_mm", 0.0..=150.0, default.base_height_mm),
        ..default
    };
    let reference_time_s = table.number("reference_time_s", -2.5..=2.5, DIASTASIS_S);
    table.close();
    (shape, reference_time_s)
}
