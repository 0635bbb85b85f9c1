//! `[phantom]`: images made of a heart whose truth is known, so that what is found can be judged.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::words;
use crate::heart::{Parameter, Parameters, RegionalParameter};
use crate::phantom::SyntheticCineSettings;
use crate::study::reader::TableReader;

words! {
    /// The anatomy that the truth is searched with.
    ModelAnatomy {
        /// The true mesh.
        Truth = "truth",
        /// A mesh from the rasterised labels of the first image, as a patient's would be.
        Labels = "labels",
    }
}

/// `[phantom.contraction]`: the wall moves by a law in closed form and not by the model; for the idealised left ventricle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContractionPlan {
    /// `ejection_fraction`: share of its volume that the cavity ejects, exactly.
    pub ejection_fraction: f64,
    /// `shortening`: relative, of the long axis.
    pub shortening: f64,
    /// `twist_deg`: turn of the base against the apex.
    pub twist_deg: f64,
    /// `systole_s`: time from the trigger to the peak of the contraction, and back again.
    pub systole_s: f64,
}

/// A synthetic patient.
#[derive(Debug, Clone, PartialEq)]
pub struct PhantomPlan {
    /// `[phantom.contraction]`; the model beats where absent.
    pub contraction: Option<ContractionPlan>,
    /// `[phantom.truth]`: true values of parameters; the others are the model's.
    pub truth: BTreeMap<RegionalParameter, f64>,
    /// `[phantom.tolerance]`: how far the value found may lie from the true one, in the parameter's unit.
    pub tolerances: BTreeMap<Parameter, f64>,
    /// `anatomy`.
    pub anatomy: ModelAnatomy,
    /// `frames`: images of the beat.
    pub frames: usize,
    /// `reference_frame`: the image whose shape the model takes for its own at rest, and starts from.
    pub reference_frame: usize,
    /// `reference_scale`: factor on that shape about its centre; other than 1 for a mesh that was drawn wrongly.
    pub reference_scale: f64,
    /// `reference_shift_mm`: shift of that shape.
    pub reference_shift_mm: Vector3<f64>,
    /// `valve_mark_sd_mm`: the standard deviation with which the valve ring is marked on long-axis views; it is not where absent.
    pub valve_mark_sd_mm: Option<f64>,
    /// `voxel_size_mm`: voxel edge within a slice.
    pub voxel_size_mm: f64,
    /// `slice_thickness_mm`: slices average over it.
    pub slice_thickness_mm: f64,
    /// `slice_distance_mm`: between the centres of slices, which touch each other where it is absent.
    pub slice_distance_mm: f64,
    /// `slice_shift_sd_mm`: standard deviation of every slice's displacement along either axis of the slice: breath-holds that differ.
    pub slice_shift_sd_mm: f64,
    /// `blood`: its intensity.
    pub blood: f64,
    /// `wall`: mean intensity of the wall.
    pub wall: f64,
    /// `background`: mean intensity of the surroundings.
    pub background: f64,
    /// `noise`: standard deviation of the Rician noise over the intensity of blood.
    pub noise: f64,
    /// `texture`: standard deviation of the texture that moves with the tissue over the intensity of muscle.
    pub texture: f64,
    /// `texture_length_mm`: its correlation length.
    pub texture_length_mm: f64,
    /// `bias`: amplitude of the smooth bias field, relative.
    pub bias: f64,
    /// `seed`: of texture, noise and slice shifts.
    pub seed: u64,
}

pub(super) fn read(table: TableReader) -> Option<PhantomPlan> {
    let truth_table = table.table("truth");
    let mut truth = Parameters::default();
    let mut written = BTreeSet::new();
    for &parameter in Parameter::ALL {
        truth_table.parameter(parameter, &mut truth, &mut written);
    }
    truth_table.regions(Parameter::ALL, &mut truth, &mut written);
    truth_table.close();
    let tolerance_table = table.table("tolerance");
    let tolerance = |&parameter: &Parameter| Some((parameter, tolerance_table.optional_number(parameter.spec().name, 0.0..=1e12)?));
    let tolerances = Parameter::ALL.iter().filter_map(tolerance).collect();
    tolerance_table.close();
    let contraction = read_contraction(table.table("contraction"));
    let slice_thickness_mm = table.number("slice_thickness_mm", 0.5..=20.0, 8.0);
    let looks = SyntheticCineSettings::default();
    let plan = table.is_written().then(|| PhantomPlan {
        contraction,
        truth: written.into_iter().map(|parameter| (parameter, truth[parameter])).collect(),
        tolerances,
        anatomy: table.choice("anatomy", ModelAnatomy::Truth),
        frames: table.count("frames", 4..=200, 30),
        reference_frame: table.count("reference_frame", 0..=199, 0),
        reference_scale: table.number("reference_scale", 0.5..=2.0, 1.0),
        reference_shift_mm: table.vector("reference_shift_mm").unwrap_or_default(),
        valve_mark_sd_mm: table.optional_number("valve_mark_sd_mm", 0.0..=20.0),
        voxel_size_mm: table.number("voxel_size_mm", 0.5..=10.0, 1.5),
        slice_thickness_mm,
        slice_distance_mm: table.number("slice_distance_mm", 0.5..=40.0, slice_thickness_mm),
        slice_shift_sd_mm: table.number("slice_shift_sd_mm", 0.0..=20.0, 0.0),
        blood: table.number("blood", 1.0..=1e5, looks.blood),
        wall: table.number("wall", 0.0..=1e5, looks.wall),
        background: table.number("background", 0.0..=1e5, looks.background),
        noise: table.number("noise", 0.0..=1.0, 0.03),
        texture: table.number("texture", 0.0..=1.0, 0.15),
        texture_length_mm: table.number("texture_length_mm", 0.5..=50.0, 4.0),
        bias: table.number("bias", 0.0..=0.9, 0.1),
        seed: table.count("seed", 0..=i64::MAX, 1) as u64,
    });
    if let Some(plan) = plan.as_ref().filter(|plan| plan.reference_frame >= plan.frames) {
        table.problem("reference_frame", "is no image of the beat", format!("choose at most {}", plan.frames - 1));
    }
    if plan.as_ref().is_some_and(|plan| plan.valve_mark_sd_mm.is_some() && plan.anatomy == ModelAnatomy::Truth) {
        table.problem("valve_mark_sd_mm", "is of no use with the true mesh", "write anatomy = \"labels\", or take it away");
    }
    table.close();
    plan
}

fn read_contraction(table: TableReader) -> Option<ContractionPlan> {
    let plan = table.is_written().then(|| ContractionPlan {
        ejection_fraction: table.number("ejection_fraction", 0.0..=0.9, 0.6),
        shortening: table.number("shortening", 0.0..=0.5, 0.15),
        twist_deg: table.number("twist_deg", -60.0..=60.0, 12.0),
        systole_s: table.number("systole_s", 0.02..=1.0, 0.3),
    });
    table.close();
    plan
}
