//! What a cohort file may say, and what becomes of patients that cannot be run.

use super::*;
use crate::study::Silent;

const BASE: &str = "kind = \"mesh\"\n[anatomy]\nedge_length_mm = 15\n[anatomy.idealised_lv]\n[output]\nfigures = false\nmeshes = false\n";

fn cohort(folder: &Path, text: &str) -> Result<Cohort, StudyError> {
    std::fs::write(folder.join("base.toml"), BASE).unwrap();
    Cohort::new(&Config::from_text(&folder.join("cohort.toml"), text.into(), Overrides::default())?)
}

#[test]
fn settings_of_a_patient_stand_behind_those_of_the_cohort() {
    let folder = tempfile::tempdir().unwrap();
    let text = "base = \"base.toml\"\n[set]\n\"anatomy.edge_length_mm\" = 9\n[[patient]]\nname = \"A\"\ndata = \"a\"\n\
                [patient.set.anatomy]\nedge_length_mm = 12\n[[patient]]\nname = \"B\"\n";
    let cohort = cohort(folder.path(), text).unwrap();
    assert_eq!(cohort.patients[0].settings, ["anatomy.edge_length_mm=9", "anatomy.edge_length_mm=12"]);
    assert_eq!(cohort.patients[0].data, Some(folder.path().join("a")));
    assert_eq!(cohort.patients[1].settings, ["anatomy.edge_length_mm=9"]);
    assert_eq!(Plan::new(&cohort.config(&cohort.patients[1]).unwrap()).unwrap().anatomy.edge_length_mm, 9.0);
}

#[test]
fn everything_wrong_with_a_cohort_file_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let text =
        "base = \"none.toml\"\n[[patient]]\nname = \"../A\"\n[[patient]]\nname = \"B\"\nset = 3\n[[patient]]\nname = \"B\"\nfoot = 1\n";
    let error = cohort(folder.path(), text).unwrap_err().to_string();
    for words in ["names no file", "is no name of a folder", "stands twice", "foot = 1 is not known", "set = 3 is not a table"] {
        assert!(error.contains(words), "`{words}` is missing in:\n{error}");
    }
    assert!(cohort(folder.path(), "base = \"base.toml\"\n").unwrap_err().to_string().contains("patient is missing"));
}

/// One patient's image is missing, another's study is wrong, a third one's folder is a file: the fourth is run, each failure is a row that
/// says why, and what went well is not run again.
#[test]
fn a_patient_that_fails_is_a_row_and_the_others_are_run() {
    let folder = tempfile::tempdir().unwrap();
    let text = "base = \"base.toml\"\n[[patient]]\nname = \"image\"\nset = { \"anatomy.labels\" = \"none.nii\" }\n\
                [[patient]]\nname = \"edge\"\nset = { \"anatomy.edge_length_mm\" = -1 }\n[[patient]]\nname = \"file\"\n[[patient]]\nname = \"good\"\n";
    let cohort = cohort(folder.path(), text).unwrap();
    std::fs::create_dir_all(cohort.directory.join("file").join("summary.json")).unwrap();
    let stop = std::sync::atomic::AtomicBool::new(false);
    let context = RunContext::new(&Silent, &stop);
    let outcome = cohort.run(None, &context).unwrap();
    assert_eq!(outcome.status, Status::Failed, "{:?}", outcome.headlines);
    let said = |name: &str| outcome.headlines.iter().find(|line| line.starts_with(name)).unwrap().clone();
    assert!(said("image: failed").contains("none.nii"), "{}", said("image"));
    assert!(said("edge: failed").contains("anatomy.edge_length_mm = -1 is out of range"), "{}", said("edge"));
    assert!(said("file: failed").contains("cannot write"), "{}", said("file"));
    assert_eq!(said("good"), "good: converged");
    let table = std::fs::read(cohort.directory.join("patients.csv")).unwrap();
    assert!(std::fs::read_to_string(cohort.directory.join("cohort.md")).unwrap().contains("4 patients: 3 failed, 0 not run."));

    // What was wrong with one of them is put right; the others' rows stay what they were.
    std::fs::remove_dir_all(cohort.directory.join("file")).unwrap();
    let summary = cohort.directory.join("good").join("summary.json");
    let before = std::fs::metadata(&summary).unwrap().modified().unwrap();
    let again = cohort.run(None, &context).unwrap();
    assert!(again.headlines.contains(&"file: converged".to_string()), "{:?}", again.headlines);
    assert_eq!(std::fs::metadata(&summary).unwrap().modified().unwrap(), before, "a patient that was done was run again");
    let merged = cohort.merge().unwrap();
    assert_eq!((merged.headlines, merged.status), (again.headlines, Status::Failed));
    assert_ne!(std::fs::read(cohort.directory.join("patients.csv")).unwrap(), table);
}

#[test]
fn shards_of_a_cohort_make_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let names: String = (0..3).map(|n| format!("[[patient]]\nname = \"p{n}\"\n")).collect();
    let mut whole = cohort(folder.path(), &format!("base = \"base.toml\"\n{names}")).unwrap();
    let stop = std::sync::atomic::AtomicBool::new(false);
    let context = RunContext::new(&Silent, &stop);
    whole.run(None, &context).unwrap();
    let expected = std::fs::read(whole.directory.join("patients.csv")).unwrap();
    whole.directory = folder.path().join("parts");
    whole.run("2/2".parse().ok(), &context).unwrap();
    let merged = whole.merge().unwrap();
    assert_eq!(merged.status, Status::Failed);
    assert!(merged.headlines.contains(&"p0: not run".to_string()), "{:?}", merged.headlines);
    whole.run("1/2".parse().ok(), &context).unwrap();
    for _ in 0..2 {
        assert_eq!(whole.merge().unwrap().status, Status::Converged);
        assert_eq!(std::fs::read(whole.directory.join("patients.csv")).unwrap(), expected);
    }
}
