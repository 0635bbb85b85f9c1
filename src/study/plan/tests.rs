//! What a study file may say, and what it is told when it says something else.

use std::path::Path;

use super::*;
use crate::heart::Parameter;
use crate::study::Overrides;

const SIMULATE: &str = "kind = \"simulate\"\n[anatomy.idealised_lv]\n";
const PHANTOM: &str = "kind = \"personalise\"\n[anatomy.idealised_lv]\n[phantom.truth]\ncontraction_peak_lv_kpa = 95\n[phantom.tolerance]\n\
    contraction_peak_lv_kpa = 5\n[personalisation]\n[[personalisation.parameter]]\nname = \"contraction_peak_lv_kpa\"\nlower = 30\nupper = 200\n";

fn plan(text: &str, settings: &[&str]) -> Result<Plan, StudyError> {
    let overrides = Overrides { settings: settings.iter().map(|s| s.to_string()).collect(), ..Overrides::default() };
    Plan::new(&Config::from_text(Path::new("some/study.toml"), text.into(), overrides)?)
}

/// The only problem of a study.
fn problem(text: &str, settings: &[&str]) -> String {
    match plan(text, settings).unwrap_err() {
        StudyError::Invalid { problems, .. } => {
            assert_eq!(problems.len(), 1, "{problems:?}");
            problems[0].to_string()
        }
        other => panic!("{other}"),
    }
}

#[test]
fn what_is_not_written_has_its_default() {
    let plan = plan(SIMULATE, &[]).unwrap();
    assert_eq!(plan.kind, Kind::Simulate);
    assert_eq!(plan.parameters, Parameters::default());
    assert!(plan.written.is_empty() && plan.images.is_none() && plan.personalisation.is_none());
    assert_eq!(plan.output.directory, Path::new("some/results"));
}

#[test]
fn a_parameter_is_written_in_its_section_by_its_name() {
    let plan = plan(SIMULATE, &["mechanics.contraction_peak_lv_kpa=120", "tracking.image_gain_base_kpa_per_mm = 2.5"]).unwrap();
    assert_eq!(plan.parameters[Parameter::ContractionPeakLv], 120.0);
    assert_eq!(plan.parameters[Parameter::ImageGainBase], 2.5);
    assert_eq!(plan.written.len(), 2);
}

#[test]
fn every_parameter_of_the_table_can_be_written() {
    for parameter in Parameter::ALL {
        let spec = parameter.spec();
        let setting = format!("{}.{}={}", spec.section.key(), spec.name, spec.upper);
        assert_eq!(plan(SIMULATE, &[&setting]).unwrap().parameters[*parameter], spec.upper, "{setting}");
    }
}

#[test]
fn a_misspelt_key_is_told_the_nearest_one() {
    assert_eq!(
        problem(&format!("{SIMULATE}[mechanics]\npoison_ratio = 0.4\n"), &[]),
        "line 4: mechanics.poison_ratio = 0.4 is not known in [mechanics]; did you mean `poisson_ratio`?"
    );
    assert_eq!(
        problem("kind = \"simulate\"\n[anatomy.idealised_lv]\n[mechanic]\n", &[]),
        "line 3: mechanic is not known; did you mean `mechanics`?"
    );
}

#[test]
fn a_parameter_in_the_wrong_table_is_told_its_own() {
    let words = problem(&format!("{SIMULATE}[circulation]\ncontraction_peak_lv_kpa = 90\n"), &[]);
    assert!(words.ends_with("is not known in [circulation]; it belongs into [mechanics]"), "{words}");
}

#[test]
fn a_value_out_of_range_is_told_the_range() {
    assert_eq!(
        problem(&format!("{SIMULATE}[mechanics]\npoisson_ratio = 0.6\n"), &[]),
        "line 4: mechanics.poisson_ratio = 0.6 is out of range; choose a value from 0 to 0.49"
    );
    assert!(problem(SIMULATE, &["mechanics.step_s=nan"]).contains("out of range"));
}

#[test]
fn a_wrong_type_is_told_the_right_one() {
    assert!(problem(SIMULATE, &["simulation.beats=1.5"]).contains("is not a whole number; write a whole number from 1 to 1000"));
    assert!(problem(SIMULATE, &["mechanics.poisson_ratio=soft"]).contains("is not a number"));
    assert!(problem(SIMULATE, &["mechanics=3"]).contains("is not a table"));
    assert!(problem(SIMULATE, &["tracking.scheme=fast"]).contains("choose one of \"explicit\", \"published\", \"exact\", \"variational\""));
    assert!(problem(SIMULATE, &["anatomy.septal_direction=[1,2]"]).contains("is not a vector"));
    assert!(problem(SIMULATE, &["output.meshes=1"]).contains("neither true nor false"));
}

#[test]
fn a_time_scheme_is_chosen_with_its_spectral_radius() {
    use crate::mechanics::TimeScheme;
    let scheme = |settings: &[&str]| plan(SIMULATE, settings).unwrap().model.time_scheme;
    let alpha = "mechanics.time_scheme=generalised_alpha";
    assert_eq!(scheme(&[]), TimeScheme::BackwardEuler);
    assert_eq!(scheme(&[alpha]), TimeScheme::GeneralisedAlpha { spectral_radius: 0.5 });
    assert_eq!(scheme(&[alpha, "mechanics.spectral_radius=0.8"]), TimeScheme::GeneralisedAlpha { spectral_radius: 0.8 });
    assert!(problem(SIMULATE, &[alpha, "mechanics.spectral_radius=1.5"]).contains("choose a value from 0 to 1"));
    let alone = problem(SIMULATE, &["mechanics.spectral_radius=0.8"]);
    assert!(alone.ends_with("is of generalised_alpha alone; write time_scheme = \"generalised_alpha\", or leave it out"), "{alone}");
}

#[test]
fn the_heart_has_one_shape() {
    let biventricle = plan("kind = \"simulate\"\n[anatomy.idealised_biventricle]\nrv_wall_mm = 3.5\n", &[]).unwrap();
    let AnatomySource::IdealisedBiventricle { shape, .. } = biventricle.anatomy.source else { panic!("{:?}", biventricle.anatomy.source) };
    assert_eq!(shape.rv_wall_mm, 3.5);
    let two = problem(&format!("{SIMULATE}[anatomy.idealised_biventricle]\n"), &[]);
    assert!(two.contains("anatomy.idealised_lv stands beside idealised_biventricle"), "{two}");
    let images = "kind = \"track\"\n[anatomy.idealised_biventricle]\n[phantom]\n";
    assert!(plan(images, &[]).is_ok());
    assert!(problem(&format!("{images}[phantom.contraction]\n"), &[]).contains("moves the idealised left ventricle"));
}

#[test]
fn beats_are_counted_or_go_on_until_they_repeat() {
    assert_eq!(plan(SIMULATE, &[]).unwrap().simulation.beats, Beats::Count(1));
    assert_eq!(plan(SIMULATE, &["simulation.beats=3"]).unwrap().simulation.beats, Beats::Count(3));
    let settings = ["simulation.beats=periodic", "simulation.tolerance_ml=0.1", "simulation.beat_limit=40"];
    let expected = crate::heart::Periodicity { tolerance_ml: 0.1, beat_limit: 40 };
    assert_eq!(plan(SIMULATE, &settings).unwrap().simulation.beats, Beats::Periodic(expected));
    assert!(problem(SIMULATE, &["simulation.beats=forever"]).contains("neither a number nor \"periodic\""));
    assert!(problem(SIMULATE, &["simulation.tolerance_ml=0.1"]).contains("of no use with a number of beats"));
    assert!(problem(PHANTOM, &["simulation.beats=periodic"]).contains("needs a heart without images"));
}

#[test]
fn all_errors_are_named_at_once() {
    let error = plan("kind = \"fly\"\n[simulation]\nbeats = 0\n[mechanics]\nstep = 1\n", &[]).unwrap_err().to_string();
    for part in ["has 4 errors", "kind = \"fly\"", "anatomy.labels is missing", "beats = 0", "mechanics.step = 1"] {
        assert!(error.contains(part), "{part} is missing in:\n{error}");
    }
}

#[test]
fn a_missing_file_is_named_with_the_way_to_find_it() {
    let words = problem("kind = \"simulate\"\n[anatomy]\nlabels = \"no_such_labels.nii.gz\"\n", &[]);
    assert!(words.contains("some/no_such_labels.nii.gz does not exist") && words.contains("--data DIR"), "{words}");
}

#[test]
fn a_recorded_base_is_looked_for_from_the_folder_of_the_study() {
    let text = format!("{SIMULATE}[tracking]\nbase = \"recorded\"\nbase_motion = \"../run/base_motion.csv\"\n");
    let problem = problem(&text, &[]);
    assert!(problem.contains("some/../run/base_motion.csv does not exist"), "{problem}");
    assert!(problem.contains("the folder of the study file"), "{problem}");
}

#[test]
fn a_missing_data_folder_is_named() {
    let words = problem(&format!("data = \"nowhere\"\n{SIMULATE}"), &[]);
    assert!(words.starts_with("line 1: data = \"nowhere\" names no folder: some/nowhere does not exist"), "{words}");
}

#[test]
fn a_phantom_states_its_truth_and_what_is_found() {
    let plan = plan(PHANTOM, &[]).unwrap();
    let Some(ImageSource::Phantom(phantom)) = &plan.images else { panic!("no phantom") };
    assert_eq!(phantom.truth.get(&Parameter::ContractionPeakLv.into()), Some(&95.0));
    let free = &plan.personalisation.as_ref().unwrap().parameters[0];
    assert_eq!((free.lower, free.upper, free.start, free.prior_sd), (30.0, 200.0, None, None));
    assert_eq!(free.prior_mean, Parameter::ContractionPeakLv.spec().default);
}

#[test]
fn contradictions_are_refused() {
    let cases = [
        (PHANTOM.replace("contraction_peak_lv_kpa = 5", "contraction_rate_per_s = 5"), "not free"),
        (PHANTOM.replace("lower = 30", "lower = 300"), "is not below upper"),
        (PHANTOM.replace("lower = 30", "lower = 30\nstart = 20"), "choose a value from 30 to 200"),
        (
            PHANTOM.replace("name = \"contraction_peak_lv_kpa\"", "name = \"contraction_peak_kpa\""),
            "did you mean \"contraction_peak_lv_kpa\"",
        ),
        (PHANTOM.replace("kind = \"personalise\"", "kind = \"track\""), "is of no use here"),
        (SIMULATE.replace("simulate", "track"), "images is missing"),
        (format!("{SIMULATE}cavity_length_mm = 30\nbase_height_mm = 40\n"), "lies beyond the cavity"),
    ];
    for (text, part) in cases {
        let error = plan(&text, &[]).unwrap_err().to_string();
        assert!(error.contains(part), "`{part}` is missing in:\n{error}");
    }
}

#[test]
fn a_mesh_has_its_own_keys() {
    assert!(problem(SIMULATE, &["anatomy.unit=m"]).contains("anatomy.unit = \"m\" is of no use without a mesh"));
    let text = "kind = \"simulate\"\n[anatomy]\nmesh = \"study/plan/tests.rs\"\n";
    let mesh = |settings: &[&str]| plan(&format!("data = \"{}/src\"\n{text}", env!("CARGO_MANIFEST_DIR")), settings);
    let AnatomySource::Mesh(read) = mesh(&["anatomy.unit=cm", "anatomy.code_base=7"]).unwrap().anatomy.source else { panic!("no mesh") };
    assert_eq!((read.unit.mm(), read.codes[0].0, read.fibre_field), (10.0, 7, None));
    for (setting, part) in [
        ("anatomy.unit=inch", "choose one of \"mm\", \"cm\", \"m\""),
        ("anatomy.code_base=40", "gives two surfaces the code 40"),
        ("anatomy.sheet_field=sheet", "stands without fibre_field"),
        ("anatomy.edge_length_mm=3", "is of no use with a mesh"),
    ] {
        let error = mesh(&[setting]).unwrap_err().to_string();
        assert!(error.contains(part), "`{part}` is missing in:\n{error}");
    }
}

#[test]
fn a_scar_is_written_by_segment_and_parts_are_checked() {
    let scar = |more: &str| format!("{SIMULATE}[[mechanics.region]]\nparts = [\"segment_4\", \"segment_10\"]\n{more}");
    let written = plan(&scar("contraction_peak_lv_kpa = 30\n"), &[]).unwrap();
    let in_segment = |number| {
        let segment = crate::anatomy::AhaSegment::new(number).unwrap();
        written.parameters[RegionalParameter::new(Parameter::ContractionPeakLv, crate::heart::Part::Segment(segment)).unwrap()]
    };
    assert_eq!([4, 10, 11].map(in_segment), [30.0, 30.0, Parameter::ContractionPeakLv.spec().default]);
    assert_eq!(written.written.len(), 2);
    assert!(problem(&scar("contraction_peak_rv_kpa = 30\n"), &[]).contains("is not known in [mechanics.region[0]]"));
    assert!(problem(&scar("contraction_peak_lv_kpa = -30\n").replace(", \"segment_10\"", ""), &[]).contains("is out of range"));
    let elsewhere = scar("contraction_peak_lv_kpa = 30\n").replace("\"segment_4\", \"segment_10\"", "\"rv\"");
    assert!(problem(&elsewhere, &[]).contains("has no value of rv; it has values of its own in the segments"));
    assert!(problem(&elsewhere.replace("\"rv\"", "\"segment_18\""), &[]).contains("segment_1 to segment_17"));
    let twice = scar("contraction_peak_lv_kpa = 30\n").replace("segment_10", "segment_4");
    assert!(problem(&twice, &[]).contains("stands twice for segment_4"));
}

#[test]
fn a_parameter_is_freed_by_segment_or_fixed() {
    let by_segment = PHANTOM.replace("lower = 30", "regions = \"aha_segments\"\nneighbour_sd = 0.2\nlower = 30");
    let free = plan(&by_segment, &[]).unwrap().personalisation.unwrap().parameters[0];
    assert_eq!((free.regions, free.neighbour_sd, free.fixed), (Regions::AhaSegments, 0.2, false));
    assert!(problem(&by_segment.replace("aha_segments", "whole"), &[]).contains("is of segments alone"));
    assert!(problem(&PHANTOM.replace("lower = 30", "regions = \"ventricles\"\nlower = 30"), &[]).contains("is not for this parameter"));
    assert!(problem(&PHANTOM.replace("lower = 30", "fixed = true\nlower = 30"), &[]).contains("leaves nothing to be found"));
}

#[test]
fn the_same_parameter_is_not_freed_twice() {
    let twice = format!("{PHANTOM}[[personalisation.parameter]]\nname = \"contraction_peak_lv_kpa\"\n");
    assert!(plan(&twice, &[]).unwrap_err().to_string().contains("stands twice"));
}

/// A study with every table that is optional as a whole, so that their keys are asked for.
const LISTS: &str = "[[electrophysiology.site]]\n[[electrophysiology.region]]\n[[mechanics.region]]\n[[phantom.truth.region]]\n[[images.validation]]\n[[personalisation.parameter]]\n[[personalisation.order]]\n[phantom.contraction]\n[comparison]\n[[sensitivity.input]]\n[[prediction]]\n[[prediction.site]]\n";

#[test]
fn every_key_is_documented_and_every_documented_key_exists() {
    let config = Config::from_text(Path::new("study.toml"), LISTS.into(), Overrides::default()).unwrap();
    let reader = Reader::new(&config);
    let _ = read(&config, &reader);
    let is_parameter = |key: &String| key.rsplit('.').next().and_then(Parameter::from_name).is_some();
    let known: BTreeSet<String> = reader.known_keys().into_iter().filter(|key| !is_parameter(key)).collect();
    let document = include_str!("../../../docs/study_file.md");
    let rows = document.lines().filter_map(|line| line.strip_prefix("| `")?.split_once('`'));
    let documented: BTreeSet<String> = rows.map(|(key, _)| key.to_string()).collect();
    let above: BTreeSet<String> = documented.iter().flat_map(|key| key.match_indices('.').map(|(at, _)| key[..at].to_string())).collect();
    let missing: Vec<_> = known.iter().filter(|key| !documented.contains(*key) && !above.contains(*key) && *key != "circulation").collect();
    assert!(missing.is_empty(), "docs/study_file.md lacks {missing:?}");
    let stale: Vec<_> = documented.difference(&known).collect();
    assert!(stale.is_empty(), "docs/study_file.md has keys that are not there: {stale:?}");
}

proptest::proptest! {
    #[test]
    fn no_text_makes_it_panic(text in "(\\[{0,2}(anatomy|phantom|mechanics|personalisation.parameter|images)?\\]{0,2}\n?|kind|data|[a-z_.]{0,12} ?= ?[-0-9a-z\"\\[\\]{},.]{0,9}\n){0,12}") {
        let _ = plan(&text, &[]);
        let _ = plan(SIMULATE, &[&text]);
    }
}

/// Files that exist stand for images here: a plan does not read them.
fn drawn(kind: &str, anatomy: &str) -> String {
    let (data, cine) = (env!("CARGO_MANIFEST_DIR"), "[images]\ncine = \"Cargo.toml\"\n");
    let search = "[personalisation]\n[[personalisation.parameter]]\nname = \"contraction_peak_rv_kpa\"\nlower = 10\nupper = 200\n";
    let search = if kind == "personalise" { search } else { "" };
    format!("kind = \"{kind}\"\ndata = \"{data}\"\n[anatomy]\n{anatomy}{cine}{search}")
}

#[test]
fn every_kind_with_images_takes_one_ventricle_or_two_from_labels_or_masks() {
    let labels = "labels = \"Cargo.toml\"\ncode_cavity_rv = 3\nwall_thickness_lv_mm = 9\nwall_thickness_rv_mm = 4\nlabel_slices = [2, 5]\n";
    let masks = "mask_epicardium = \"Cargo.toml\"\nmask_endocardium_lv = \"Cargo.toml\"\nmask_endocardium_rv = \"Cargo.toml\"\nframe = 2\n";
    for kind in ["mesh", "track", "personalise"] {
        let [one, other] = [labels, masks].map(|anatomy| plan(&drawn(kind, anatomy), &[]).unwrap());
        let AnatomySource::Labels(from_labels) = one.anatomy.source else { panic!("{:?}", one.anatomy) };
        let options = from_labels.field_options();
        assert_eq!((from_labels.source.codes().cavity_rv, from_labels.slices), (Some(3), Some(2..6)));
        assert_eq!((options.wall_thickness_lv_mm, options.wall_thickness_rv_mm), (Some(9.0), 4.0));
        assert_eq!(other.input_files().len(), 4);
        let AnatomySource::Labels(from_masks) = other.anatomy.source else { panic!("{:?}", other.anatomy) };
        assert_eq!((from_masks.source.codes(), from_masks.frame), (crate::image::MASK_CODES, 2));
    }
}

#[test]
fn keys_of_labels_and_masks_that_contradict_each_other_are_named() {
    let told = |anatomy: &str| problem(&drawn("mesh", anatomy), &[]);
    let labels = |more: &str| told(&format!("labels = \"Cargo.toml\"\n{more}"));
    assert!(labels("code_cavity_rv = 1\n").contains("stands for the left ventricle"));
    assert!(labels("code_wall_rv = 4\n").contains("stands without code_cavity_rv"));
    assert!(labels("base_normal = [0, 0, 1]\n").contains("anatomy.base_point_mm is missing"));
    assert!(labels("base_point_mm = [0, 0, 1]\nbase_normal = [0, 0, 0]\n").contains("base_normal = [0, 0, 0] has no direction"));
    assert!(labels("base = \"mid_slice\"\nbase_point_mm = [0, 0, 1]\nbase_normal = [0, 0, 1]\n").contains("take one of the two away"));
    assert!(labels("base_points_mm = [[0, 0, 1], [1, 0, 1], [2, 0, 1]]\n").contains("spans no plane"));
    assert!(labels("base_points_mm = [[0, 0, 1], [1, 0], [2, 0, 1]]\n").contains("is not a list of points"));
    assert!(labels("base = \"mid_slice\"\nbase_points_mm = [[0, 0, 1], [1, 0, 1], [0, 1, 1]]\n").contains("stands beside base_points_mm"));
    assert!(labels("label_slices = [5, 2]\n").contains("is no range of slices"));
    assert!(labels("mask_epicardium = \"Cargo.toml\"\nmask_endocardium_lv = \"Cargo.toml\"\n").contains("stands beside mask_epicardium"));
    assert!(told("mask_epicardium = \"Cargo.toml\"\n").contains("anatomy.mask_endocardium_lv is missing"));
    let coded = "mask_epicardium = \"Cargo.toml\"\nmask_endocardium_lv = \"Cargo.toml\"\ncode_wall_lv = 5\n";
    assert!(told(coded).contains("code_wall_lv = 5 is of no use with masks"));
    assert!(
        problem(&format!("{SIMULATE}[anatomy]\n").replace("[anatomy]\n", ""), &["anatomy.code_cavity_rv=3"]).contains("without labels")
    );
}

/// What was found goes before what the study writes, and what was held does not.
#[test]
fn parameters_of_an_earlier_run_replace_those_of_the_study() {
    let folder = tempfile::tempdir().unwrap();
    let table = "parameter,symbol,unit,region,initial,value,lower,upper,sd,interval_low,interval_high,at_bound,state\n\
        contraction_peak_lv_kpa,σ0_LV,kPa,lv,90,101.5,30,200,,,,false,free\n\
        relaxation_rate_per_s,kRS,1/s,segment_7,15,21,5,60,,,,true,upper\n\
        fibre_stiffness_kpa,E_f,kPa,global,200,200,1,300,,,,false,fixed\n";
    std::fs::write(folder.path().join("parameters.csv"), table).unwrap();
    let read = |text: &str| Plan::new(&Config::from_text(&folder.path().join("study.toml"), text.into(), Overrides::default()).unwrap());
    let study =
        "kind = \"simulate\"\nparameters_from = \"parameters.csv\"\n[anatomy.idealised_lv]\n[mechanics]\ncontraction_peak_lv_kpa = 70\n";
    let plan =
        read(&format!("{study}[[prediction]]\nonset = \"lbbb\"\n[[prediction]]\nname = \"two\"\nonset = \"biventricular_pacing\"\n"))
            .unwrap();
    assert_eq!(plan.parameters[Parameter::ContractionPeakLv], 101.5);
    assert_eq!(plan.parameters[Parameter::FibreStiffness], Parameters::default()[Parameter::FibreStiffness]);
    let part = crate::heart::Part::from_name("segment_7").unwrap();
    assert_eq!(plan.parameters[RegionalParameter::new(Parameter::RelaxationRate, part).unwrap()], 21.0);
    assert_eq!(plan.predictions.iter().map(|one| one.name.as_str()).collect::<Vec<_>>(), ["lbbb", "two"]);
    let told = |text: &str| format!("{:?}", read(text).unwrap_err());
    assert!(told(&study.replace("\"parameters.csv\"", "\"none.csv\"")).contains("names no file"));
    assert!(told(&format!("{study}[[prediction]]\n[[prediction]]\n")).contains("has \\\"normal\\\" twice"));
    assert!(told(&format!("{study}[[prediction]]\nname = \"a/b\"\n")).contains("is no name of a file"));
    assert!(told(&format!("{study}[[prediction]]\nname = \"own\"\n")).contains("the heart's own onset"));
}
