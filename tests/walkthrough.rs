//! Every command that README.md and the documents show is run as it is shown, in a folder with files of the names they use: on coarse meshes, with
//! long steps, and for studies of real data as `check`, or as a refusal that says what is missing where the data are not at hand.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test may stop at the first surprise, and says what it could not look at"
)]

mod dicom_slices;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Commands of other programs, by their first words: what installs, builds or asks another machine.
const OTHERS: [&str; 12] = [
    "cargo install --locked --path .",
    "cargo test --release",
    "cargo doc --open",
    "CARDIOTWIN_GARBLED_FILES=",
    "python3 -m venv",
    "pip install",
    "snakemake ",
    "podman ",
    "apptainer ",
    "cardiotwin completions bash >",
    "cardiotwin completions fish >",
    "cardiotwin completions zsh >",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The lines of all blocks of commands in a document, without their remarks; what goes on behind a backslash is one line.
fn commands(document: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(document).unwrap().replace("\\\n", " ");
    let mut commands = Vec::new();
    let mut is_command = false;
    for line in text.lines() {
        match line.trim() {
            "```sh" => is_command = true,
            fence if fence.starts_with("```") => is_command = false,
            line if is_command && !line.is_empty() => commands.push(line.split(" #").next().unwrap_or(line).trim().to_string()),
            _ => {}
        }
    }
    commands
}

fn run(folder: &Path, arguments: &[String]) -> (i32, String) {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("cardiotwin"));
    let output = command.current_dir(folder).args(arguments).stdout(Stdio::piped()).output().unwrap();
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// A folder like that of a reader: the studies beside files of the names that the documents use.
fn desk() -> &'static Path {
    static DESK: OnceLock<PathBuf> = OnceLock::new();
    DESK.get_or_init(|| {
        let desk = Path::new(env!("CARGO_TARGET_TMPDIR")).join("walkthrough");
        let _ = std::fs::remove_dir_all(&desk);
        std::fs::create_dir_all(desk.join("studies")).unwrap();
        let phantom = "kind = \"phantom\"\n[anatomy]\nedge_length_mm = 9.0\n[anatomy.idealised_lv]\n[mechanics]\nstep_s = 0.02\n\
                       [phantom]\nframes = 10\nvoxel_size_mm = 2.5\n[output]\nfigures = false\ndirectory = \".\"\n";
        std::fs::write(desk.join("phantom.toml"), phantom).unwrap();
        let (code, err) = run(&desk, &["run".into(), "phantom.toml".into(), "-q".into()]);
        assert_eq!(code, 0, "{err}");
        write_masks(&desk);
        std::fs::write(desk.join("points.csv"), "point,x_mm,y_mm,z_mm\na,31.0,0.0,0.0\n").unwrap();
        let times: Vec<String> = (0..10).map(|n| (80 * n).to_string()).collect();
        let timing = format!("{{\"trigger_time_ms_per_slice\": [[{}]], \"nominal_interval_ms\": [800]}}", times.join(", "));
        std::fs::write(desk.join("meta.json"), timing).unwrap();
        copy_studies(&root().join("studies"), &desk.join("studies"));
        desk
    })
}

/// The phantom's labels as masks.
fn write_masks(desk: &Path) {
    use cardiotwin::image::{LabelMap, read_label_map, write_label_map};
    let labels = read_label_map(&desk.join("labels_reference.nii.gz")).unwrap();
    for (name, inside) in [("epicardium.nii.gz", &[1_u8, 2][..]), ("lv.nii.gz", &[1])] {
        let mask = labels.labels().iter().map(|code| u8::from(inside.contains(code))).collect();
        let mask = LabelMap::new(labels.grid().clone(), mask).unwrap();
        write_label_map(&mut std::fs::File::create(desk.join(name)).unwrap(), &mask).unwrap();
    }
}

fn copy_studies(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for path in std::fs::read_dir(from).unwrap().map(|entry| entry.unwrap().path()) {
        let copy = to.join(path.file_name().unwrap());
        if path.is_dir() { copy_studies(&path, &copy) } else { assert!(std::fs::copy(path, copy).is_ok()) }
    }
}

/// Settings that make a study short, of the tables that it has.
fn short(study: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(study).unwrap_or_default();
    let mut settings = vec!["mechanics.step_s=0.02", "output.meshes=true", "output.figures=false"];
    if !text.contains("\nmesh = ") && !text.contains("mesh_tables") {
        settings.push("anatomy.edge_length_mm=9.0");
    }
    if text.contains("[personalisation]") {
        settings.extend(["personalisation.max_iterations=1", "personalisation.retrack=false", "tracking.gains=written"]);
    }
    if text.contains("[phantom]") {
        settings.push("phantom.frames=8");
    }
    settings.into_iter().flat_map(|setting| ["--set".to_string(), setting.to_string()]).collect()
}

/// Runs one line of a document; says what was not looked at.
fn follow(document: &str, line: &str) {
    let words = line.trim_start_matches("cargo run --release --").trim_start_matches("cardiotwin");
    let mut arguments: Vec<String> = words.split_whitespace().take_while(|word| *word != "2>").map(str::to_string).collect();
    let desk = desk();
    let data = arguments.iter().position(|word| word.starts_with("path/to/"));
    if let Some(at) = data {
        let folder = root().join("../shared/data").join(arguments[at].trim_start_matches("path/to/"));
        arguments[0] = if arguments[0] == "run" { "check".into() } else { arguments[0].clone() };
        arguments[at] = folder.to_string_lossy().into_owned();
        let (code, err) = run(desk, &arguments);
        if folder.is_dir() {
            assert_eq!(code, 0, "{document}: {line}\n{err}");
        } else {
            eprintln!("SKIPPED: {} is not at hand for: {line}", folder.display());
            assert!(code == 2 && err.contains("give the folder of the data with --data DIR"), "{document}: {line}\n{err}");
        }
        return;
    }
    match arguments.first().map(String::as_str) {
        Some("run") => {
            let study = desk.join(&arguments[1]);
            arguments.extend(short(&study));
        }
        Some("init") => arguments.push("--force".into()),
        Some("mesh") => {
            arguments.extend(["--edge-length-mm".into(), "8".into()].into_iter().filter(|_| !line.contains("--edge-length-mm")))
        }
        _ => {}
    }
    let (code, err) = run(desk, &arguments);
    assert_eq!(code, 0, "{document}: {line}\n{err}");
}

/// Follows a document from top to bottom.
fn follow_all(document: &str) -> usize {
    let commands = commands(&root().join(document));
    for line in &commands {
        if !OTHERS.iter().any(|other| line.starts_with(other)) {
            let is_ours = line.starts_with("cardiotwin ") || line.starts_with("cargo run --release -- ");
            assert!(is_ours, "{document}: `{line}` is a command that this test does not know");
            follow(document, line);
        }
    }
    commands.len()
}

#[test]
fn every_command_of_the_readme_and_the_documents_works() {
    std::fs::create_dir_all(desk().join("dicom")).unwrap();
    for (slice, phase) in (0..2).flat_map(|slice| (0..4).map(move |phase| (slice, phase))) {
        std::fs::write(desk().join(format!("dicom/{slice}_{phase}.dcm")), dicom_slices::dicom_slice(slice, phase)).unwrap();
    }
    let documents = ["README.md", "docs/images.md", "docs/command_line.md", "docs/many_runs.md", "docs/results.md", "docs/install.md"];
    let count: usize = documents.into_iter().map(follow_all).sum();
    assert!(count > 25, "only {count} commands found: has the fence of code blocks changed?");
}

/// Study files that the folders of studies name are checked as they are named; the runs are theirs to keep.
#[test]
fn every_command_of_the_studies_names_a_study_that_holds() {
    let mut count = 0;
    for folder in std::fs::read_dir(root().join("studies")).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_dir()) {
        for line in commands(&folder.join("README.md")) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let Some(study) = words.iter().find(|word| word.starts_with("studies/")).filter(|word| word.ends_with(".toml")) else {
                continue;
            };
            count += 1;
            assert!(root().join(study).is_file(), "{line}");
            let checked = if words.contains(&"cohort") { "../05_patient_SCD0000201/study.toml" } else { study };
            let checked = if words.contains(&"cohort") { folder.join(checked) } else { root().join(checked) };
            let mut arguments = vec!["check".to_string(), checked.to_string_lossy().into_owned()];
            if let Some(data) = words.iter().find_map(|word| word.strip_prefix("path/to/")) {
                arguments.extend(["--data".into(), root().join("../shared/data").join(data).to_string_lossy().into_owned()]);
            }
            let (code, err) = run(root(), &arguments);
            assert!(code == 0 || (code == 2 && err.contains("--data DIR")), "{line}\n{err}");
        }
    }
    assert!(count >= 15, "{count}");
}
