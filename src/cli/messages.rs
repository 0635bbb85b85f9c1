//! What people read: errors with their causes, a plan in a few lines, the table of parameters.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;

use crate::heart::{Parameter, ParameterSpec, Section};
use crate::study::plan::{AnatomySource, Beats, FreeParameter, ImageSource, LabelSource, ModelAnatomy, OnsetSite, Regions};
use crate::study::{Choice, Plan};

/// An error and what caused it, one cause a line.
pub(super) fn error_chain(error: &dyn Error) -> String {
    let mut text = format!("error: {error}");
    let mut cause = error.source();
    while let Some(inner) = cause {
        let words = inner.to_string();
        // Errors that pass another on unchanged would be said twice.
        if !text.ends_with(&words) {
            let _ = write!(text, "\n  because: {words}");
        }
        cause = inner.source();
    }
    text
}

/// What a study would do, one topic a line.
pub(super) fn plan_lines(plan: &Plan) -> String {
    let mut text = String::new();
    let mut line = |topic: &str, words: String| {
        let _ = writeln!(text, "{topic:<11} {words}");
    };
    line("study", format!("{} ({})", plan.provenance.study_file, plan.kind.word()));
    line("anatomy", anatomy(plan));
    if let Some(images) = &plan.images {
        line("images", image_source(images));
    }
    line("model", model(plan));
    if plan.images.is_some() {
        let tracking = &plan.tracking;
        line("tracking", format!("{} image forces, base by {}", tracking.scheme.word(), tracking.base.word()));
    }
    for free in plan.personalisation.iter().flat_map(|personalisation| &personalisation.parameters) {
        line(if free.fixed { "fixed" } else { "free" }, free_parameter(free));
    }
    if let Some(sensitivity) = &plan.sensitivity {
        let (runs, inputs) = (sensitivity.design.points().len(), sensitivity.inputs.len());
        line("sensitivity", format!("{}, {runs} runs in {inputs} inputs: {}", sensitivity.method.word(), sensitivity.outputs.join(", ")));
    }
    for parameter in &plan.written {
        line("set", format!("{} = {}", parameter.name(), plan.parameters[*parameter]));
    }
    line("output", plan.output.directory.display().to_string());
    text
}

fn anatomy(plan: &Plan) -> String {
    let shape = match &plan.anatomy.source {
        AnatomySource::Labels(drawn) => match &drawn.source {
            LabelSource::Map { path, codes } => {
                let right = codes.cavity_rv.map_or(String::new(), |code| format!(", RV cavity {code}"));
                format!("{} (cavity {}, wall {}{right}) on frame {}", name(path), codes.cavity_lv, codes.wall_lv, drawn.frame)
            }
            masks => {
                let names: Vec<String> = masks.files().into_iter().map(name).collect();
                format!("masks {} on frame {}", names.join(", "), drawn.frame)
            }
        },
        AnatomySource::Mesh(mesh) => {
            let fibres = match &mesh.fibre_field {
                Some(field) => format!("its own (`{field}`)"),
                None => format!("{}° to {}°", plan.anatomy.fibres.endocardium_deg, plan.anatomy.fibres.epicardium_deg),
            };
            return format!("mesh {} in {}; fibres {fibres}", name(mesh.source.path()), mesh.unit.word());
        }
        AnatomySource::IdealisedBiventricle { shape, .. } => format!(
            "idealised ventricles, LV cavity {} × {} mm, walls {} and {} mm",
            shape.lv_radius_mm, shape.lv_length_mm, shape.lv_wall_mm, shape.rv_wall_mm
        ),
        AnatomySource::IdealisedLv(lv) => {
            format!(
                "idealised left ventricle, cavity {} × {} mm, wall {} mm",
                lv.cavity_radius_mm, lv.cavity_length_mm, lv.wall_thickness_mm
            )
        }
    };
    let fibres = plan.anatomy.fibres;
    format!("{shape}; edges {} mm; fibres {}° to {}°", plan.anatomy.edge_length_mm, fibres.endocardium_deg, fibres.epicardium_deg)
}

fn image_source(images: &ImageSource) -> String {
    match images {
        ImageSource::Cine(cine) => {
            let judges = cine.validation.len();
            let judged = if judges == 0 { String::new() } else { format!("; judged by {judges} label map(s)") };
            format!("{}{judged}", name(&cine.cine))
        }
        ImageSource::Phantom(phantom) => format!(
            "made: {} frames of {} × {} × {} mm, noise {} %, seed {}; model on {}",
            phantom.frames,
            phantom.voxel_size_mm,
            phantom.voxel_size_mm,
            phantom.slice_thickness_mm,
            100.0 * phantom.noise,
            phantom.seed,
            match phantom.anatomy {
                ModelAnatomy::Truth => "the true mesh",
                ModelAnatomy::Labels => "a mesh from the images' labels",
            }
        ),
    }
}

fn model(plan: &Plan) -> String {
    let onset = match plan.model.onset.place {
        OnsetSite::Sites => format!("{} site(s)", plan.model.onset.sites.len()),
        place if plan.model.onset.sites.is_empty() => place.word().to_string(),
        place => format!("{} and {} site(s)", place.word(), plan.model.onset.sites.len()),
    };
    let beats = match plan.simulation.beats {
        Beats::Count(count) => format!("{count} beat(s)"),
        Beats::Periodic(periodicity) => format!("beats until they repeat within {} mL", periodicity.tolerance_ml),
    };
    format!("step {} s, {beats}, onset {onset}", plan.model.step_s)
}

fn free_parameter(free: &FreeParameter) -> String {
    let spec = free.parameter.spec();
    let start = free.start.map_or(String::new(), |start| format!(", start {start}"));
    let prior = free.prior_sd.map_or(String::new(), |sd| format!(", prior {} ± {sd}", free.prior_mean));
    let regions = if free.regions == Regions::Whole { String::new() } else { format!(" by {}", free.regions.word()) };
    format!("{}{regions} in {} to {} {}{start}{prior}", spec.name, free.lower, free.upper, spec.unit)
}

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The table of parameters in Markdown, a part for each table of the study file.
pub(super) fn parameter_table() -> String {
    let mut text =
        String::from("# Parameters\n\nEach is a key of its table in a study file, and has this name in results and on the command line.\n");
    for section in [Section::Electrophysiology, Section::Mechanics, Section::Circulation, Section::Tracking] {
        let _ = writeln!(text, "\n## [{}]\n", section.key());
        let head = ["name", "symbol", "unit", "default", "range", "meaning", "source"].map(str::to_string);
        let specs = Parameter::ALL.iter().map(|parameter| parameter.spec()).filter(|spec| spec.section == section);
        let rows: Vec<_> = std::iter::once(head).chain(specs.map(cells)).collect();
        let widths: [usize; 7] = std::array::from_fn(|column| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0));
        for (number, row) in rows.iter().enumerate() {
            let padded = row.iter().zip(widths).map(|(cell, width)| format!(" {cell:<width$} |")).collect::<String>();
            let _ = writeln!(text, "|{padded}");
            if number == 0 {
                let _ = writeln!(text, "|{}", widths.map(|width| format!("{}|", "-".repeat(width + 2))).concat());
            }
        }
    }
    text
}

fn cells(spec: &ParameterSpec) -> [String; 7] {
    let range = format!("{} to {}", number(spec.lower), number(spec.upper));
    [format!("`{}`", spec.name), spec.symbol.into(), spec.unit.into(), number(spec.default), range, spec.meaning.into(), spec.source.into()]
}

/// Small and large numbers with an exponent.
fn number(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) { format!("{value:e}") } else { format!("{value}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_follow_an_error_and_none_is_said_twice() {
        #[derive(Debug, thiserror::Error)]
        enum Layers {
            #[error("cannot write a.csv")]
            Outer { source: std::io::Error },
            #[error(transparent)]
            Same(std::io::Error),
        }
        let full = || std::io::Error::other("the disk is full");
        assert_eq!(error_chain(&Layers::Outer { source: full() }), "error: cannot write a.csv\n  because: the disk is full");
        assert_eq!(error_chain(&Layers::Same(full())), "error: the disk is full");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.0, 1.06e-6, 0.16, 1e4, 1e5, -0.5].map(number), ["0", "1.06e-6", "0.16", "10000", "1e5", "-0.5"]);
    }
}
