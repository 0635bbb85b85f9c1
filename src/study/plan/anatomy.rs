//! `[anatomy]`: the heart at rest, from a label map of a patient or from an idealised shape, \[Billet2009\] §3.

use std::path::PathBuf;

use nalgebra::Vector3;

use crate::study::reader::TableReader;

/// The heart at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct AnatomyPlan {
    /// Where its shape comes from.
    pub source: AnatomySource,
    /// `edge_length_mm`: length of a tetrahedron's edge.
    pub edge_length_mm: f64,
    /// Fibre angles.
    pub fibres: FibrePlan,
    /// `septal_direction`: a vector in world coordinates (RAS) from the long axis to the septum, which AHA angles start from; the
    /// anatomy's own choice where absent.
    pub septal_direction: Option<Vector3<f64>>,
}

/// Where the shape comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum AnatomySource {
    /// A label map drawn on one frame of the cine.
    Labels {
        /// `labels`: the label map, NIfTI.
        path: PathBuf,
        /// Its codes.
        codes: LabelCodes,
        /// `frame`: the frame of the cine that it was drawn on, from 0; simulations start at that frame's time.
        frame: usize,
    },
    /// A truncated ellipsoid.
    IdealisedLv(IdealisedLv),
}

/// What the numbers of a label map mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LabelCodes {
    /// `code_cavity_lv`: blood of the left ventricle.
    pub cavity_lv: u16,
    /// `code_wall_lv`: wall of the left ventricle.
    pub wall_lv: u16,
}

/// `[anatomy.idealised_lv]`: the wall between two truncated ellipsoids of revolution with one centre; lengths are semi-axes.
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
    let ideal = table.table("idealised_lv");
    let is_ideal = ideal.is_written();
    match (is_ideal, table.has("labels")) {
        (true, true) => table.problem("labels", "stands beside [anatomy.idealised_lv]", "take one of the two away"),
        (false, false) => table.missing("labels", "labels = \"…\" (a label map), or [anatomy.idealised_lv]"),
        _ => {}
    }
    let idealised = read_idealised(ideal);
    let source = if is_ideal { AnatomySource::IdealisedLv(idealised) } else { read_labels(&table) };
    let plan = AnatomyPlan {
        source,
        edge_length_mm: table.number("edge_length_mm", 0.5..=20.0, 5.0),
        fibres: FibrePlan {
            endocardium_deg: table.number("fibre_angle_endocardium_deg", -90.0..=90.0, 80.0),
            epicardium_deg: table.number("fibre_angle_epicardium_deg", -90.0..=90.0, -80.0),
        },
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

fn read_labels(table: &TableReader) -> AnatomySource {
    let code = |key, default| u16::try_from(table.count(key, 1..=i64::from(u8::MAX), default)).unwrap_or(u16::MAX);
    let codes = LabelCodes { cavity_lv: code("code_cavity_lv", 1), wall_lv: code("code_wall_lv", 2) };
    if codes.cavity_lv == codes.wall_lv {
        table.problem("code_wall_lv", "equals code_cavity_lv", "give the wall and the cavity their own codes");
    }
    AnatomySource::Labels { path: table.data_file("labels").unwrap_or_default(), codes, frame: table.count("frame", 0..=100_000, 0) }
}

fn read_idealised(table: TableReader) -> IdealisedLv {
    let plan = IdealisedLv {
        cavity_radius_mm: table.number("cavity_radius_mm", 2.0..=100.0, 24.0),
        cavity_length_mm: table.number("cavity_length_mm", 2.0..=200.0, 60.0),
        wall_thickness_mm: table.number("wall_thickness_mm", 1.0..=50.0, 10.0),
        apex_thickness_mm: table.number("apex_thickness_mm", 1.0..=50.0, 8.0),
        base_height_mm: table.number("base_height_mm", 0.0..=150.0, 20.0),
        reference_time_s: table.number("reference_time_s", -2.5..=2.5, -0.02),
    };
    if plan.base_height_mm >= plan.cavity_length_mm {
        table.problem("base_height_mm", "lies beyond the cavity", format!("choose less than cavity_length_mm, {}", plan.cavity_length_mm));
    }
    table.close();
    plan
}
