//! `report.html` from outside: every kind of run leaves one, it is one file that asks for no other, small, and whole without its script.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

mod common;

use std::path::{Path, PathBuf};

/// A beat of a coarse left ventricle.
const BEAT: &str = r#"
kind = "simulate"
[anatomy]
edge_length_mm = 12.0
[anatomy.idealised_lv]
[mechanics]
step_s = 0.02
[simulation]
frames = 5
[output]
figures = false
"#;

/// The first study, coarse and short.
const COARSE: [&str; 5] =
    ["anatomy.edge_length_mm=12", "phantom.frames=6", "personalisation.max_iterations=1", "mechanics.step_s=0.02", "output.figures=false"];

fn fresh_folder(name: &str) -> PathBuf {
    common::fresh_folder("report_page", name)
}

/// Runs a study file and reads the report of its folder.
fn report_of(command: &str, file: &Path, folder: &Path, settings: &[&str]) -> String {
    let settings = settings.iter().flat_map(|setting| ["--set", setting]);
    let mut run = assert_cmd::Command::new(assert_cmd::cargo::cargo_bin("cardiotwin"));
    let answer = run.arg(command).arg(file).arg("-o").arg(folder).args(settings).output().unwrap();
    assert!(answer.status.success(), "{}", String::from_utf8_lossy(&answer.stderr));
    let html = std::fs::read_to_string(folder.join("report.html")).unwrap();
    is_a_whole_page(&html);
    html
}

fn written(name: &str, text: &str) -> (PathBuf, PathBuf) {
    common::fresh_study("report_page", name, text)
}

/// What holds of every report, whatever it shows.
fn is_a_whole_page(html: &str) {
    assert!(html.starts_with("<!DOCTYPE html>") && html.trim_end().ends_with("</html>"));
    assert!(html.len() < 4_000_000, "{} bytes", html.len());
    assert!(!html.contains("{{"), "a name of the template is left");
    for word in [" src=\"http", " href=\"http", "@import", "<link", "<iframe"] {
        assert!(!html.contains(word), "{word}");
    }
    assert!(html.contains("default-src 'none'"), "nothing from outside may be loaded");
    let shown = html.split("<script type=\"application/json\"").next().unwrap();
    for word in ["NaN", "undefined", "Some(", "inf<"] {
        assert!(!shown.contains(word), "{word} is shown");
    }
    for name in ["section", "figure", "svg", "table", "ul", "details"] {
        assert_eq!(shown.matches(&format!("<{name}")).count(), shown.matches(&format!("</{name}>")).count(), "{name}");
    }
    let drawings = shown.matches("<svg ").count();
    assert_eq!(drawings, shown.matches("role=\"img\" aria-label=\"").count() - shown.matches("<canvas").count(), "a drawing has no name");
    assert!(html.contains("In short") || html.contains("Patients"));
    data_of(html);
}

/// What the script of a report reads.
fn data_of(html: &str) -> serde_json::Value {
    let data = html.split("id=\"report-data\">").nth(1).unwrap().split("</script>").next().unwrap();
    serde_json::from_str(data).unwrap()
}

#[test]
fn a_free_beat_has_its_mesh_and_no_images() {
    let (file, folder) = written("beat", BEAT);
    let html = report_of("run", &file, &folder, &[]);
    for words in ["Pressure–volume loop, LV", "The wall by segment", "Ejection fraction, LV", "id=\"heart\"", "id=\"controls\""] {
        assert!(html.contains(words), "{words}");
    }
    for words in ["id=\"slices\"", "RV volume", "What the data tell", "Tracking and discrepancy"] {
        assert!(!html.contains(words), "{words} has no place here");
    }
    let data = data_of(&html);
    assert!(data["slices"].is_null());
    let (frames, fields) = (data["heart"]["positions"].as_array().unwrap(), data["heart"]["fields"].as_array().unwrap());
    assert_eq!((frames.len(), data["times_ms"].as_array().unwrap().len()), (6, 6), "five frames, and the first again");
    let names: Vec<&str> = fields.iter().map(|field| field["name"].as_str().unwrap()).collect();
    assert!(names.iter().any(|name| name.contains("stress")) && names.iter().any(|name| name.contains("Displacement")), "{names:?}");
}

#[test]
fn a_personalised_phantom_has_all_its_parts() {
    let study = Path::new(env!("CARGO_MANIFEST_DIR")).join("studies/01_phantom_recovery/study.toml");
    let html = report_of("run", &study, &fresh_folder("phantom"), &COARSE);
    let parts = ["In short", "Parameters", "The beat", "Through the beat", "The wall by segment", "Tracking and discrepancy"];
    for words in parts.iter().chain(&["What the data tell", "Convergence", "All figures"]) {
        assert!(html.contains(&format!(">{words}</h2>")), "{words}");
    }
    let data = data_of(&html);
    let views = data["slices"]["views"].as_array().unwrap();
    assert_eq!(views.len(), 5, "three short-axis slices and two long-axis planes");
    for view in views {
        let (images, paths) = (view["images"].as_array().unwrap(), view["paths"].as_array().unwrap());
        assert_eq!((images.len(), paths.len()), (7, 7));
        assert!(paths.iter().all(|surfaces| surfaces[0].as_str().unwrap().starts_with('M')), "a frame has no contour");
        assert_ne!(paths[0], paths[3], "the contours do not move");
    }
}

/// What pacing would do to the heart that was found, beside what it does to the true one; and no report where none is wanted.
#[test]
fn predictions_stand_beside_their_own_onset_and_the_truth() {
    let study = Path::new(env!("CARGO_MANIFEST_DIR")).join("studies/20_pacing_prediction/study.toml");
    let folder = fresh_folder("prediction");
    let html = report_of("run", &study, &folder, &COARSE);
    let part = html.split(">Predictions</h2>").nth(1).unwrap().split("</section>").next().unwrap();
    for words in ["own onset", "biventricular pacing", "(true\u{a0}", "LV pressure under each onset", "Activation, normal"] {
        assert!(part.contains(words), "{words}");
    }
    let file = folder.join("predictions.csv");
    let mut table = csv::Reader::from_path(&file).unwrap();
    let place = table.headers().unwrap().iter().position(|name| name == "total_activation_time_ms").unwrap();
    for row in table.records().map(Result::unwrap) {
        let shown = format!("{:.0}", row[place].parse::<f64>().unwrap());
        assert!(part.contains(&shown), "{row:?} is not shown");
    }
    let beat = "kind = \"simulate\"\n[anatomy]\nedge_length_mm = 12.0\n[anatomy.idealised_lv]\n[mechanics]\nstep_s = 0.02\n";
    let file = folder.join("beat.toml");
    std::fs::write(&file, format!("{beat}[output]\nfigures = false\nreport = false\n")).unwrap();
    let mut run = assert_cmd::Command::new(assert_cmd::cargo::cargo_bin("cardiotwin"));
    run.arg("run").arg(&file).arg("-o").arg(&folder).assert().success();
    assert!(folder.join("summary.json").is_file() && !folder.join("report.html").exists(), "an earlier one would pass for this run's");
}

#[test]
fn a_mesh_a_sensitivity_and_a_cohort_have_theirs() {
    let (file, folder) = written("mesh", &BEAT.replace("simulate", "mesh"));
    let mesh = report_of("run", &file, &folder, &[]);
    assert!(mesh.contains("Tetrahedra") && mesh.contains("id=\"heart\"") && !mesh.contains("id=\"controls\""));
    let screening = "[sensitivity]\nmethod = \"morris\"\npaths = 2\noutputs = [\"ejection_fraction_lv\"]\n\
                     [[sensitivity.input]]\nname = \"contraction_peak_lv_kpa\"\nlower = 60\nupper = 200\n\
                     [[sensitivity.input]]\nname = \"heart_period_s\"\nlower = 0.7\nupper = 0.9\n";
    let (file, folder) = written("screening", &(BEAT.replace("simulate", "sensitivity") + screening));
    let html = report_of("run", &file, &folder, &[]);
    assert!(html.contains("What moves ejection_fraction_lv") && html.contains("class=\"sample\""));
    let (base, folder) = written("cohort", BEAT);
    let cohort = base.with_file_name("cohort.toml");
    std::fs::write(&cohort, "base = \"study.toml\"\n[[patient]]\nname = \"one\"\n[[patient]]\nname = \"two\"\n").unwrap();
    let html = report_of("cohort", &cohort, &folder, &[]);
    assert!(html.contains("<a href=\"one/report.html\">one</a>") && folder.join("two/report.html").is_file());
}
