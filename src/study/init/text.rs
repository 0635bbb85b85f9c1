//! The study file itself: what was found as keys, what may be wanted as comments.

use std::fmt::Write;
use std::path::{Component, Path, PathBuf};

use super::Draft;
use super::files::{CineFinding, DrawnCodes, Findings, FrameFinding, LabelFinding, MeshFinding};
use crate::units::MS_PER_S;

/// Wall that is proposed around a cavity that was drawn without one, mm.
const WALL_MM: f64 = 9.0;

/// A study file in the making.
struct Pen {
    text: String,
    notes: Vec<String>,
    data: PathBuf,
}

/// Writes down what was found.
pub(super) fn draft(findings: &Findings, study_file: &Path) -> Draft {
    let folder = absolute(study_file.parent().unwrap_or(Path::new(".")));
    let data = first_file(findings).and_then(|file| absolute(file).parent().map(Path::to_path_buf)).unwrap_or_else(|| folder.clone());
    let mut pen = Pen { text: String::new(), notes: Vec::new(), data };
    pen.head(findings, &folder);
    pen.anatomy(findings);
    match &findings.cine {
        Some(cine) => {
            pen.images(cine, findings);
            pen.model_of_patient();
            pen.personalisation();
        }
        None => pen.free_heart(),
    }
    pen.line("\n[output]\n# The folder of the results, from the folder of this file; -o DIR replaces it.\ndirectory = \"results\"");
    Draft { text: pen.text, notes: pen.notes }
}

fn first_file(findings: &Findings) -> Option<&Path> {
    let cine = findings.cine.as_ref().map(|cine| cine.path.as_path());
    let labels = findings.labels.first().map(|labels| labels.path.as_path());
    let masks = findings.masks.as_ref().map(|masks| masks.epicardium.as_path());
    cine.or(labels).or(masks).or(findings.mesh.as_ref().map(|mesh| mesh.path.as_path()))
}

impl Pen {
    fn line(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    fn note(&mut self, text: String) {
        self.notes.push(text);
    }

    /// A path as the study file writes it, from its `data`.
    fn path(&self, path: &Path) -> String {
        quoted(relative(&self.data, &absolute(path)))
    }

    fn head(&mut self, findings: &Findings, folder: &Path) {
        let kind = if findings.cine.is_some() { "personalise" } else { "simulate" };
        self.line("# Written by `cardiotwin init`. Every key and its default: docs/study_file.md; parameters of the model: `cardiotwin parameters`.");
        self.line("# `cardiotwin check` says what this file means, `cardiotwin run` does it. World coordinates are RAS in mm, frames count from 0.");
        self.line(match kind {
            "personalise" => {
                "# personalise tracks the images and finds parameters; \"track\" only tracks, \"simulate\" beats without images, \"mesh\" only meshes."
            }
            _ => "# simulate beats the heart without images; \"mesh\" only builds it.",
        });
        let _ = writeln!(self.text, "kind = \"{kind}\"");
        if self.data != *folder {
            let data = quoted(relative(folder, &self.data));
            let _ = writeln!(self.text, "# Where the data paths below start; --data DIR replaces it.\ndata = {data}");
        }
    }

    fn anatomy(&mut self, findings: &Findings) {
        self.line("\n[anatomy]");
        if let Some(mesh) = &findings.mesh {
            return self.mesh(mesh);
        }
        if let Some(masks) = &findings.masks {
            let files = [
                ("mask_epicardium", Some(&masks.epicardium)),
                ("mask_endocardium_lv", Some(&masks.endocardium_lv)),
                ("mask_endocardium_rv", masks.endocardium_rv.as_ref()),
            ];
            for (key, file) in files.into_iter().filter_map(|(key, file)| Some((key, file?))) {
                let path = self.path(file);
                let _ = writeln!(self.text, "{key} = {path}");
            }
            let count = if masks.endocardium_rv.is_some() { "two ventricles" } else { "a left ventricle" };
            self.note(format!("masks     {count} from {}", masks.epicardium.display()));
        } else if let Some(labels) = findings.labels.first() {
            self.labels(labels);
        }
        self.frame(findings);
        self.line("# Edge of a tetrahedron: 5 mm for a first look, 3.5 mm or less for results.\nedge_length_mm = 5.0");
        self.line("# Fibre angles against the short-axis plane; linear kinematics want them less steep than the 80 of the default.");
        self.line("fibre_angle_endocardium_deg = 60.0\nfibre_angle_epicardium_deg = -60.0");
        self.line("# From the long axis of the left ventricle to the septum; AHA segments start from it. Absent: to the patient's right and front.");
        self.line("# septal_direction = [0.8, 0.6, 0.0]");
        match findings.labels.first().and_then(|labels| labels.beat.as_ref()?.slices) {
            Some([first, last]) => {
                let why =
                    "on the others the labelled cavity jumps, or grows while the ventricle contracts, as labels of atrium and aorta do";
                let _ = writeln!(
                    self.text,
                    "# Slices whose labels count, counted from 0: {why}; look whether that is so.\nlabel_slices = [{first}, {last}]"
                );
                self.note(format!("slices    {first} to {last}: {why}"));
            }
            None => self.line("# Slices whose labels count, where the outermost ones should not.\n# label_slices = [0, 9]"),
        }
    }

    fn labels(&mut self, labels: &LabelFinding) {
        let path = self.path(&labels.path);
        let _ = writeln!(self.text, "labels = {path}");
        let name = labels.path.display();
        match labels.codes {
            DrawnCodes::Blood(code) => {
                let _ = writeln!(
                    self.text,
                    "# Blood alone is drawn (code {code}); a wall of this thickness is grown around it: measure yours."
                );
                let _ = writeln!(self.text, "code_cavity_lv = {code}\ncode_wall_lv = {}", if code == 2 { 1 } else { 2 });
                let _ = writeln!(self.text, "wall_thickness_lv_mm = {WALL_MM:.1}");
                self.note(format!("labels    {name}: blood {code} and no wall; one of {WALL_MM} mm will be grown"));
            }
            DrawnCodes::Heart(codes) => {
                self.line("# Told by which code touches which; look whether they are right.");
                let _ = writeln!(self.text, "code_cavity_lv = {}\ncode_wall_lv = {}", codes.cavity_lv, codes.wall_lv);
                let right = codes.cavity_rv.map_or("no right ventricle".to_string(), |code| format!("RV blood {code}"));
                if let Some(code) = codes.cavity_rv {
                    let _ = writeln!(self.text, "# Take this line away for a left ventricle alone.\ncode_cavity_rv = {code}");
                }
                self.note(format!("labels    {name}: LV blood {}, wall {}, {right}", codes.cavity_lv, codes.wall_lv));
            }
        }
    }

    fn frame(&mut self, findings: &Findings) {
        let frame = findings.frame.frame();
        let largest = findings.labels.first().and_then(end_diastole).unwrap_or_default();
        let how = match findings.frame {
            FrameFinding::Unknown if findings.cine.is_none() => return,
            FrameFinding::Unknown => "it could not be found on the images, write it here.",
            FrameFinding::Told(_) => "as it was told.",
            FrameFinding::Fits(_) => "outlines fit it best; frames beside it may fit as well: write the right one here if you know it.",
            FrameFinding::Largest(_) => &largest,
        };
        let _ = writeln!(self.text, "# The frame of the cine that the heart was drawn on: {how}\nframe = {frame}");
        self.note(format!("frame     {frame}: {how}"));
    }

    fn mesh(&mut self, mesh: &MeshFinding) {
        let path = self.path(&mesh.path);
        let _ = writeln!(self.text, "mesh = {path}\nunit = \"{}\"", mesh.unit);
        let fields = mesh.surface_fields.join(", ");
        let _ =
            writeln!(self.text, "# The field of its boundary triangles that tells the surfaces apart (found: {fields}), and its codes.");
        if let ([field], true) = (mesh.surface_fields.as_slice(), !mesh.surface_fields.iter().any(|field| field == "surface_tag")) {
            let _ = writeln!(self.text, "surface_field = {}", quoted(field));
        }
        self.line("code_base = 10\ncode_endocardium_rv = 20\ncode_endocardium_lv = 30\ncode_epicardium = 40");
        match &mesh.fibre_field {
            Some(field) => {
                let _ = writeln!(self.text, "fibre_field = {}", quoted(field));
            }
            None => self.line("# fibre_field = \"fibre\"    # without it, by fibre_angle_endocardium_deg and fibre_angle_epicardium_deg"),
        }
        self.note(format!("mesh      {}: {} tetrahedra in {}", mesh.path.display(), mesh.tetrahedra, mesh.unit));
    }

    fn images(&mut self, cine: &CineFinding, findings: &Findings) {
        let summary = &cine.summary;
        let [ni, nj, nk] = summary.shape;
        let [_, _, thick_mm] = summary.spacing_mm;
        let beat = summary.period_s.map_or("heart period unknown".into(), |s| format!("heart period {:.0} ms", s * MS_PER_S));
        let words = format!("{} frames of {ni} × {nj} × {nk} voxels, slices {thick_mm:.1} mm apart, {beat}", summary.frame_count);
        let path = self.path(&cine.path);
        let _ = writeln!(self.text, "\n[images]\n# {words}; `cardiotwin info` says more.\ncine = {path}");
        self.note(format!("cine      {}: {words}", cine.path.display()));
        match &findings.timing {
            Some(timing) => {
                let timing = self.path(timing);
                let _ = writeln!(self.text, "timing = {timing}");
            }
            None if summary.period_s.is_none() => {
                let needed = "its times make no beat: a JSON file with trigger_time_ms_per_slice and nominal_interval_ms is needed";
                let _ = writeln!(self.text, "# {needed}.\n# timing = \"timing.json\"");
                self.note(format!("warning   {needed}"));
            }
            None => {}
        }
        for warning in &summary.warnings {
            self.note(format!("warning   {warning}"));
        }
        self.volumes(findings);
        self.line("# Move slices of other breath-holds back beside their neighbours; look at `cardiotwin info` first.\ncorrect_slice_shifts = false");
        self.line("# long_axis = \"cine_lax.nii.gz\"    # further views, shown with the contours and not tracked");
        for labels in findings.labels.iter().skip(1).filter(|labels| !labels.is_of_every_frame()) {
            let (path, code) = (self.path(&labels.path), labels.codes.cavity_lv());
            let frame = labels.frame.unwrap_or(0);
            self.line("\n# Labels that judge the result; nothing is fitted to them.\n[[images.validation]]");
            let _ = writeln!(self.text, "labels = {path}\nframe = {frame}\ncode_cavity_lv = {code}");
            self.note(format!("judge     {}: blood {code} on frame {frame}", labels.path.display()));
        }
    }

    /// The volume curve: a table, labels of every frame, or none.
    fn volumes(&mut self, findings: &Findings) {
        let every = findings.labels.iter().find(|labels| labels.is_of_every_frame());
        let Some(file) = findings.volumes.as_deref().or(every.map(|labels| labels.path.as_path())) else {
            return self.line("# volumes = \"volumes.csv\"    # a measured volume curve (time_s, volume_lv_ml), or labels of every frame");
        };
        let path = self.path(file);
        let _ = writeln!(self.text, "# The volume curve that parameters are fitted to.\nvolumes = {path}");
        if let (None, Some(labels)) = (&findings.volumes, every) {
            let _ = writeln!(self.text, "volumes_code_cavity_lv = {}", labels.codes.cavity_lv());
            if let Some([first, last]) = labels.beat.as_ref().and_then(|beat| beat.slices) {
                let _ = writeln!(self.text, "volumes_slices = [{first}, {last}]");
            }
        }
        self.note(format!("volumes   from {}", file.display()));
    }

    fn model_of_patient(&mut self) {
        self.line("\n[mechanics]\n# 0.01 for a first look.\nstep_s = 0.005\n# Peak contraction to start from; it is found below.\ncontraction_peak_lv_kpa = 120.0");
        self.line(
            "# Stiff, as small-strain kinematics need it (\"corotational\" does not, at ten times the cost).\nkinematics = \"linear\"",
        );
        self.line("fibre_stiffness_kpa = 200.0\ntransverse_stiffness_kpa = 200.0\npericardium_stiffness_kpa_per_mm = 0.5");
        self.line("\n[tracking]\n# The base follows blocks of the images; \"springs\" or \"free\" are the alternatives.\nbase = \"block_matching\"\nbase_projection = \"full\"");
        self.line("# If the tracked wall turns about its axis where the images do not: block_shape = \"carried\", wall = \"block_matching\", block_window = 1.5.");
        self.line("# How strongly images pull is chosen by boundary points that are held out; \"written\" takes it as written.\ngains = \"held_out\"");
        self.line("# \"ncc\" (correlation) is blind to brightness that varies across the images, \"ssd\" (differences) is not.\nsimilarity = \"ncc\"");
    }

    fn personalisation(&mut self) {
        self.line("\n[personalisation]\n# How far the data are trusted: volumes, and boundaries on the images.\nsigma_volume_ml = 3.0\nsigma_boundary_mm = 4.0\nmax_iterations = 20");
        self.line("\n# What is found, each within its bounds; a prior keeps it near what is known.");
        let free = [
            ("contraction_peak_lv_kpa", 10.0, 800.0, None),
            ("action_potential_duration_s", 0.1, 0.5, None),
            ("conduction_velocity_mm_per_s", 150.0, 2000.0, Some((600.0, 200.0))),
            ("onset_time_s", -0.1, 0.1, Some((0.0, 0.05))),
            ("relaxation_rate_per_s", 5.0, 60.0, Some((20.0, 10.0))),
        ];
        for (name, lower, upper, prior) in free {
            let _ = writeln!(self.text, "\n[[personalisation.parameter]]\nname = \"{name}\"\nlower = {lower:?}\nupper = {upper:?}");
            if let Some((mean, sd)) = prior {
                let _ = writeln!(self.text, "prior_mean = {mean:?}\nprior_sd = {sd:?}");
            }
        }
    }

    fn free_heart(&mut self) {
        self.line("\n[electrophysiology]\n# \"lbbb\", \"rv_apical_pacing\", \"biventricular_pacing\", \"endocardium\" or \"sites\" in its place.\nonset = \"normal\"");
        self.line("\n[mechanics]\n# 0.01 for a first look.\nstep_s = 0.005\n# contraction_peak_lv_kpa = 120.0\n# kinematics = \"corotational\"    # large rotations, at ten times the cost");
        self.line("\n[simulation]\n# A number of beats, or \"periodic\": until they repeat.\nbeats = 1");
    }
}

/// Why labels of every frame start from end-diastole, in words.
fn end_diastole(labels: &LabelFinding) -> Option<String> {
    let beat = labels.beat.as_ref()?;
    let [most, least] = [beat.end_diastole(), beat.end_systole()];
    let (most_ml, least_ml) = (beat.volumes_ml.get(most)?, beat.volumes_ml.get(least)?);
    Some(format!(
        "end-diastole, where the labelled cavity is the largest ({most_ml:.1} mL; the least is {least_ml:.1} mL on frame {least})."
    ))
}

/// A path or a word in quotes as TOML writes it.
fn quoted(text: impl AsRef<Path>) -> String {
    toml::Value::String(text.as_ref().to_string_lossy().replace('\\', "/")).to_string()
}

/// The path from the root of the file system; as it is where that cannot be told.
fn absolute(path: &Path) -> PathBuf {
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    std::fs::canonicalize(path).or_else(|_| std::path::absolute(path)).unwrap_or_else(|_| path.to_path_buf())
}

/// How one comes from a folder to a path, both absolute; the path itself where they have nothing in common.
fn relative(folder: &Path, path: &Path) -> PathBuf {
    let common = folder.components().zip(path.components()).take_while(|(a, b)| a == b).count();
    let shares_a_folder = path.components().take(common).any(|part| matches!(part, Component::Normal(_)));
    if !shares_a_folder {
        return path.to_path_buf();
    }
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    let way: PathBuf = up.chain(path.components().skip(common)).collect();
    if way.as_os_str().is_empty() { PathBuf::from(".") } else { way }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_go_up_and_down_from_the_study_file() {
        let way = |folder: &str, path: &str| relative(Path::new(folder), Path::new(path)).to_string_lossy().into_owned();
        assert_eq!(way("/home/a/studies", "/home/a/data/cine.nii.gz"), "../data/cine.nii.gz");
        assert_eq!(way("/home/a", "/home/a/cine.nii.gz"), "cine.nii.gz");
        assert_eq!(way("/home/a", "/home/a"), ".");
        assert_eq!(way("/home/a", "/media/disk/cine.nii.gz"), "/media/disk/cine.nii.gz");
    }
}
