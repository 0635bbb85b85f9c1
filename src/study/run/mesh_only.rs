//! `kind = "mesh"` and `cardiotwin mesh`: the heart at rest as a file, with what it is worth: quality, and sizes beside those of the masks.

use std::path::Path;
use std::time::Instant;

use nalgebra::Vector3;
use serde::Serialize;

use super::error::RunError;
use super::mesh_file::anatomy_of_file;
use super::mesh_overlays::{Overlays, draw_overlays};
use super::page::{Account, leave_page, resting_heart, table_section};
use super::patient::{anatomy_settings, biventricular_anatomy, idealised_anatomy};
use crate::anatomy::mesher::MesherSettings;
use crate::anatomy::{Anatomy, Region, Ventricle, build_from_fields};
use crate::heart::Parameter;
use crate::image::{HeartFields, Volume, heart_fields};
use crate::mesh::io::{FieldValues, write_mesh_file};
use crate::mesh::{MeshQuality, SurfaceTag};
use crate::numerics::quantile;
use crate::report::html::{Block, KeyFigure, Section, Slices, readable};
use crate::report::{create_folder, write_json};
use crate::study::cine::StudyCine;
use crate::study::drawn_heart::DrawnHeart;
use crate::study::plan::{AnatomySource, ImageSource, LabelsPlan, Plan};
use crate::study::{Kind, Outcome, Provenance, RunContext, Status};
use crate::tracking::CavityAgreement;
use crate::units::ml_from_mm3;

/// What a mesh is worth.
#[derive(Debug, Clone, Serialize)]
pub struct MeshReport {
    /// Shape of the tetrahedra.
    pub quality: MeshQuality,
    /// Cavities and wall.
    pub volumes: Vec<PartVolume>,
    /// The part of the wall that was grown around cavities without one, mL.
    pub grown_wall_ml: f64,
    /// How well the surfaces follow what was drawn; nothing for a heart that was not.
    pub surfaces: Vec<SurfaceAgreement>,
    /// First and last slice used, apex first.
    pub slices: Option<[usize; 2]>,
    /// What was assumed or left out, in words.
    pub warnings: Vec<String>,
    /// Time from labels in memory to the mesh with its fibres, s.
    pub meshing_s: f64,
}

/// A volume of the mesh and of the masks.
#[derive(Debug, Clone, Serialize)]
pub struct PartVolume {
    /// `cavity_lv`, `cavity_rv` or `wall`.
    pub part: &'static str,
    /// Volume of the mesh, mL.
    pub mesh_ml: f64,
    /// Volume by counting voxels (of a wall, with what was grown), mL; none for a heart that was not drawn.
    pub masks_ml: Option<f64>,
}

impl PartVolume {
    /// How much larger the mesh is, %.
    pub fn difference_percent(&self) -> Option<f64> {
        self.masks_ml.map(|masks_ml| 100.0 * (self.mesh_ml / masks_ml - 1.0))
    }
}

/// How well a surface of the mesh follows what was drawn.
#[derive(Debug, Clone, Serialize)]
pub struct SurfaceAgreement {
    /// The surface.
    pub surface: &'static str,
    /// Mean distance of its points from the smooth surface through the slices, mm.
    pub distance_mean_mm: f64,
    /// The distance that one point in twenty exceeds, mm.
    pub distance_percentile_95_mm: f64,
    /// Of an endocardium: Dice coefficient of its blood with the labels, voxel by voxel.
    pub dice: Option<f64>,
    /// Of an endocardium: mean distance of its contours from those of the labels in the slices, mm.
    pub contour_distance_mm: Option<f64>,
}

/// `summary.json`.
#[derive(Serialize)]
struct Summary<'a> {
    kind: Kind,
    status: Status,
    #[serde(flatten)]
    report: &'a MeshReport,
    wall_time_s: f64,
    provenance: &'a Provenance,
}

/// The heart of a plan before it beats, and where it comes from.
pub(super) struct RestingHeart {
    pub(super) anatomy: Anatomy,
    /// Of a heart that was drawn, what was drawn and the fields through it.
    pub(super) drawn: Option<(DrawnHeart, HeartFields)>,
    /// The images it was drawn on, and the frame.
    pub(super) study: Option<(StudyCine, usize)>,
    meshing_s: f64,
}

impl RestingHeart {
    fn new(plan: &Plan, context: &RunContext) -> Result<Self, RunError> {
        let settings = anatomy_settings(&plan.anatomy);
        match &plan.anatomy.source {
            AnatomySource::Labels(wanted) => Self::of_drawing(plan, wanted, context),
            AnatomySource::IdealisedLv(shape) => Self::of_shape(context, || idealised_anatomy(&plan.anatomy, shape)),
            AnatomySource::IdealisedBiventricle { shape, .. } => Self::of_shape(context, || biventricular_anatomy(&plan.anatomy, shape)),
            AnatomySource::Mesh(mesh) => Self::of_shape(context, || anatomy_of_file(mesh, &settings)),
        }
    }

    fn of_drawing(plan: &Plan, wanted: &LabelsPlan, context: &RunContext) -> Result<Self, RunError> {
        context.progress().stage("reading images and labels", None);
        let (heart, study) = read_drawn(plan, wanted)?;
        context.progress().stage("building the anatomy", None);
        let started = Instant::now();
        let fields = heart_fields(&heart.labels, &heart.codes, &wanted.field_options())?;
        let mesher = MesherSettings::with_edge_length_mm(plan.anatomy.edge_length_mm);
        let anatomy = build_from_fields(&fields, &mesher, &anatomy_settings(&plan.anatomy))?;
        let study = study.map(|study| (study, wanted.frame));
        Ok(Self { anatomy, drawn: Some((heart, fields)), study, meshing_s: started.elapsed().as_secs_f64() })
    }

    fn of_shape(context: &RunContext, build: impl FnOnce() -> Result<Anatomy, RunError>) -> Result<Self, RunError> {
        context.progress().stage("building the anatomy", None);
        let started = Instant::now();
        Ok(Self { anatomy: build()?, drawn: None, study: None, meshing_s: started.elapsed().as_secs_f64() })
    }
}

fn read_drawn(plan: &Plan, drawn: &LabelsPlan) -> Result<(DrawnHeart, Option<StudyCine>), RunError> {
    let Some(ImageSource::Cine(images)) = &plan.images else { return Ok((DrawnHeart::read(drawn)?, None)) };
    let period_s = plan.written.contains(&Parameter::HeartPeriod.into()).then_some(plan.parameters[Parameter::HeartPeriod]);
    let study = StudyCine::read(images, period_s, Some(drawn))?;
    let (frame, frame_count) = (drawn.frame, study.cine.frames().len());
    if frame >= frame_count {
        return Err(RunError::FrameOutOfRange { key: "anatomy.frame", frame, frame_count });
    }
    Ok((study.read_heart(drawn)?, Some(study)))
}

/// Builds the heart of a plan and writes it to `file` (`.vtu`, `.vtk` or `.msh`); with a folder for figures, its contours on the images.
///
/// # Errors
/// [`RunError`] names the room that failed, with its reason and remedy.
pub fn mesh_heart(plan: &Plan, file: &Path, figures: Option<&Path>, context: &RunContext) -> Result<MeshReport, RunError> {
    let (_, report, overlays) = meshed(plan, file, context)?;
    if let Some(folder) = figures {
        create_folder(folder)?;
        draw_overlays(folder, &overlays)?;
    }
    context.progress().finish();
    Ok(report)
}

/// The heart of a plan, written to `file`, with what it is worth and its contours on the images.
fn meshed(plan: &Plan, file: &Path, context: &RunContext) -> Result<(RestingHeart, MeshReport, Overlays), RunError> {
    let heart = RestingHeart::new(plan, context)?;
    context.progress().stage("writing results", None);
    if let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        create_folder(folder)?;
    }
    write_heart(file, &heart.anatomy)?;
    let mut report = report_of(&heart);
    let mut overlays = Overlays::default();
    if let Some(ImageSource::Cine(images)) = &plan.images {
        overlays = Overlays::new(images, &heart)?;
        report.warnings.extend(overlays.warnings.iter().cloned());
    }
    Ok((heart, report, overlays))
}

/// Meshes the plan's heart into its folder.
pub(super) fn run(plan: &Plan, context: &RunContext) -> Result<Outcome, RunError> {
    let started = Instant::now();
    let folder = &plan.output.directory;
    let (heart, report, overlays) = meshed(plan, &folder.join("heart.vtu"), context)?;
    if plan.output.figures {
        draw_overlays(folder, &overlays)?;
    }
    let status = Status::Converged;
    let wall_time_s = started.elapsed().as_secs_f64();
    let summary = Summary { kind: plan.kind, status, report: &report, wall_time_s, provenance: &plan.provenance };
    write_json(&folder.join("summary.json"), &summary)?;
    let headlines = report.lines();
    let account = Account { status, headlines: &[], warnings: &report.warnings, key_figures: report.key_figures(), record: &summary };
    leave_report(plan, &heart.anatomy, &report, overlays, account)?;
    context.progress().finish();
    Ok(Outcome { status, directory: folder.clone(), headlines })
}

fn leave_report(
    plan: &Plan,
    anatomy: &Anatomy,
    report: &MeshReport,
    overlays: Overlays,
    account: Account<Summary>,
) -> Result<(), RunError> {
    let slices = overlays.for_page().map(|montage| vec![Block::Slices(Slices(montage))]).unwrap_or_default();
    let sections = vec![
        Section { title: "On the images".into(), blocks: slices },
        Section { title: "The mesh".into(), blocks: vec![Block::Heart(resting_heart(anatomy))] },
        table_section("Volumes", "The mesh and the masks", &report.volumes),
        table_section("Surfaces", "Distances from what was drawn", &report.surfaces),
    ];
    leave_page(plan, account, sections, Vec::new())
}

/// Writes the mesh with its tags, depth, fibres, sheets, regions and segments; lengths are mm.
fn write_heart(file: &Path, anatomy: &Anatomy) -> Result<(), RunError> {
    let column = |n: usize| anatomy.fibre_axes.iter().map(|axes| axes.column(n).into_owned()).collect::<Vec<Vector3<f64>>>();
    let (fibres, sheets) = (column(0), column(1));
    let regions: Vec<i32> = anatomy.regions.iter().map(|&region| code_of(region)).collect();
    let segments: Vec<i32> = anatomy.aha_segments.iter().map(|&segment| i32::from(segment)).collect();
    let points = [("transmural_depth", FieldValues::Scalars(&anatomy.transmural_depth))];
    let cells = [
        ("fibre", FieldValues::Vectors(&fibres)),
        ("sheet", FieldValues::Vectors(&sheets)),
        ("region", FieldValues::Labels(&regions)),
        ("aha_segment", FieldValues::Labels(&segments)),
    ];
    Ok(write_mesh_file(file, &anatomy.mesh, &anatomy.surface, &points, &cells)?)
}

/// The field `region` of the file.
fn code_of(region: Region) -> i32 {
    match region {
        Region::FreeWallLv => 1,
        Region::Septum => 2,
        Region::FreeWallRv => 3,
        Region::Scar => 4,
    }
}

fn report_of(heart: &RestingHeart) -> MeshReport {
    let anatomy = &heart.anatomy;
    let position_mm = anatomy.mesh.vertices_mm();
    let sizes = heart.drawn.as_ref().map(|(_, fields)| &fields.report);
    let cavity = |(ventricle, cavity): &(Ventricle, crate::mesh::Cavity)| {
        let (part, masks_ml) = match ventricle {
            Ventricle::Left => ("cavity_lv", sizes.map(|sizes| sizes.labelled_cavity_lv_ml)),
            Ventricle::Right => ("cavity_rv", sizes.and_then(|sizes| sizes.labelled_cavity_rv_ml)),
        };
        PartVolume { part, mesh_ml: ml_from_mm3(cavity.volume_mm3(position_mm)), masks_ml }
    };
    let wall = PartVolume {
        part: "wall",
        mesh_ml: ml_from_mm3(anatomy.mesh.total_volume_mm3()),
        masks_ml: sizes.map(|sizes| sizes.labelled_wall_ml + sizes.grown_wall_ml),
    };
    let warnings = heart.drawn.iter().flat_map(|(drawn, fields)| drawn.warnings.iter().chain(&fields.warnings).cloned());
    let of_images = heart.study.iter().flat_map(|(study, _)| study.warnings.iter().cloned());
    MeshReport {
        quality: MeshQuality::of(&anatomy.mesh),
        volumes: anatomy.cavities.iter().map(cavity).chain([wall]).collect(),
        grown_wall_ml: sizes.map_or(0.0, |sizes| sizes.grown_wall_ml),
        surfaces: heart.drawn.iter().flat_map(|(drawn, fields)| surfaces(anatomy, drawn, fields)).collect(),
        slices: sizes.map(|sizes| [sizes.apical_slice, sizes.basal_slice]),
        warnings: of_images.chain(warnings).collect(),
        meshing_s: heart.meshing_s,
    }
}

fn surfaces(anatomy: &Anatomy, drawn: &DrawnHeart, fields: &HeartFields) -> Vec<SurfaceAgreement> {
    let endocardium = |(ventricle, cavity): &(Ventricle, crate::mesh::Cavity)| {
        let (surface, field, code) = match ventricle {
            Ventricle::Left => ("endocardium_lv", Some(&fields.cavity_lv), Some(drawn.codes.cavity_lv)),
            Ventricle::Right => ("endocardium_rv", fields.cavity_rv.as_ref(), drawn.codes.cavity_rv),
        };
        let agreement = CavityAgreement::new(cavity, anatomy.mesh.vertices_mm(), &drawn.labels, code?);
        let agrees = SurfaceAgreement {
            dice: Some(agreement.dice),
            contour_distance_mm: agreement.mean_distance_mm,
            ..distance(anatomy, surface, cavity.tag(), field?)
        };
        Some(agrees)
    };
    let epicardium = distance(anatomy, "epicardium", SurfaceTag::Epicardium, &fields.epicardium);
    anatomy.cavities.iter().filter_map(endocardium).chain([epicardium]).collect()
}

/// Distances of the corners and centres of a surface's triangles from the zero level of a field.
fn distance(anatomy: &Anatomy, surface: &'static str, tag: SurfaceTag, field: &Volume) -> SurfaceAgreement {
    let position_mm = anatomy.mesh.vertices_mm();
    let points = anatomy.surface.triangles_with(tag).flat_map(|triangle| {
        let [a, b, c] = triangle.map(|vertex| position_mm[vertex]);
        [a, (a + b + c) / 3.0]
    });
    let distances_mm: Vec<f64> = points.filter_map(|point| field.sample(&point)).map(f64::abs).collect();
    let count = distances_mm.len().max(1) as f64;
    SurfaceAgreement {
        surface,
        distance_mean_mm: distances_mm.iter().sum::<f64>() / count,
        distance_percentile_95_mm: quantile(&distances_mm, 0.95).unwrap_or(0.0),
        dice: None,
        contour_distance_mm: None,
    }
}

impl MeshReport {
    fn key_figures(&self) -> Vec<KeyFigure> {
        let figure = |name: String, value: f64, unit: &str, beside| KeyFigure { name, value: readable(value), unit: unit.into(), beside };
        let volume = |volume: &PartVolume| {
            let masks = volume.masks_ml.map(|masks_ml| format!("masks: {} mL", readable(masks_ml)));
            figure(volume.part.replace('_', " "), volume.mesh_ml, "mL", masks)
        };
        let quality = &self.quality;
        let own = [
            figure("Vertices".into(), quality.vertex_count as f64, "", None),
            figure("Tetrahedra".into(), quality.tetrahedron_count as f64, "", None),
            figure("Mean edge".into(), quality.edge_mean_mm, "mm", None),
            figure("Least dihedral angle".into(), quality.dihedral_least_deg, "°", None),
        ];
        own.into_iter().chain(self.volumes.iter().map(volume)).collect()
    }

    /// What people want to know of it, a topic a line.
    pub fn lines(&self) -> Vec<String> {
        let quality = &self.quality;
        let mut lines = vec![
            format!("{:<28}{}", "vertices", quality.vertex_count),
            format!("{:<28}{}", "tetrahedra", quality.tetrahedron_count),
            format!(
                "{:<28}{:.2} (mean), {:.2} to {:.2}",
                "edge (mm)", quality.edge_mean_mm, quality.edge_least_mm, quality.edge_greatest_mm
            ),
            format!(
                "{:<28}{:.1} (least), {:.1} (1st percentile)",
                "dihedral angle (°)", quality.dihedral_least_deg, quality.dihedral_percentile_1_deg
            ),
            format!("{:<28}{:.2} (least), {:.2} (mean)", "radius ratio", quality.radius_ratio_least, quality.radius_ratio_mean),
        ];
        for volume in &self.volumes {
            let beside = match (volume.masks_ml, volume.difference_percent()) {
                (Some(masks_ml), Some(percent)) => format!(" (masks {masks_ml:.1}, {percent:+.1} %)"),
                _ => String::new(),
            };
            lines.push(format!("{:<28}{:.1}{beside}", format!("{} (mL)", volume.part), volume.mesh_ml));
        }
        if self.grown_wall_ml > 0.0 {
            lines.push(format!("{:<28}{:.1}", "  of it grown (mL)", self.grown_wall_ml));
        }
        for surface in &self.surfaces {
            let dice = match (surface.dice, surface.contour_distance_mm) {
                (Some(dice), Some(contours_mm)) => format!("; on the labels: Dice {dice:.3}, contours {contours_mm:.2} mm"),
                _ => String::new(),
            };
            let (mean, most) = (surface.distance_mean_mm, surface.distance_percentile_95_mm);
            lines.push(format!("{:<28}{mean:.2} (mean), {most:.2} (95th percentile){dice}", format!("{} off by (mm)", surface.surface)));
        }
        lines.push(format!("{:<28}{:.2}", "meshing (s)", self.meshing_s));
        lines
    }
}
