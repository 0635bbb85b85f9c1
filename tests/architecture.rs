//! The house keeps its plan: layers, one room for each third-party crate and each side effect, files that open with a sentence.
//!
//! A failure names the file and the line; the remedy is to move the code, not to widen the tables below.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::fs;
use std::path::{Path, PathBuf};

/// Rooms by layer; a room uses strictly lower layers only, so rooms of one layer are strangers.
const LAYERS: &[(&str, u32)] = &[
    ("units", 0),
    ("numerics", 1),
    ("image", 2),
    ("mesh", 2),
    ("anatomy", 3),
    ("electrophysiology", 4),
    ("mechanics", 4),
    ("circulation", 4),
    ("heart", 5),
    ("tracking", 6),
    ("phantom", 6),
    ("sensitivity", 7),
    ("personalisation", 8),
    ("report", 9),
    ("study", 10),
    ("cli", 11),
];

/// Third-party crates that have rooms of their own. Crates that are vocabulary (nalgebra, serde, thiserror, rayon, rand) are free.
const CRATES: &[(&str, &[&str])] = &[
    ("faer", &["numerics"]),
    ("feral_metis", &["numerics"]),
    ("clarabel", &["numerics"]),
    ("nifti", &["image"]),
    ("ndarray", &["image"]),
    ("flate2", &["image", "mesh"]),
    ("dicom_core", &["image"]),
    ("dicom_encoding", &["image"]),
    ("dicom_object", &["image"]),
    ("dicom_transfer_syntax_registry", &["image"]),
    ("vtkio", &["mesh", "report"]),
    ("argmin", &["personalisation"]),
    ("plotters", &["report"]),
    ("dejavu", &["report"]),
    ("csv", &["report"]),
    ("tempfile", &["report"]),
    ("serde_json", &["report", "image", "cli"]),
    ("::image", &["report"]),
    ("toml", &["study"]),
    ("strsim", &["study"]),
    ("clap", &["cli"]),
    ("clap_complete", &["cli"]),
    ("indicatif", &["cli"]),
    ("ctrlc", &["cli"]),
    ("anyhow", &["cli"]),
];

/// Side effects by their words, and where they may happen: rooms, or files of a room.
const EFFECTS: &[(&str, &[&str])] = &[
    ("std::fs", &["image/nifti", "image/dicom", "image/timing", "mesh/io", "report", "study", "cli"]),
    ("File::", &["image/nifti", "image/dicom", "image/timing", "mesh/io", "report", "study", "cli"]),
    ("std::io", &["image/nifti", "image/dicom", "image/timing", "image/error", "mesh/io", "mesh/error", "report", "study", "cli"]),
    ("println!", &["cli"]),
    ("print!", &["cli"]),
    ("std::env", &["cli"]),
    ("std::process", &["cli", "main"]),
    ("std::time", &["study", "cli"]),
    ("Instant::now", &["study", "cli"]),
    ("SystemTime", &[]),
    ("from_os_rng", &[]),
    ("from_entropy", &[]),
    ("thread_rng", &[]),
    ("rand::rng()", &[]),
    ("std::thread", &["study", "cli"]),
    ("static mut", &[]),
];

/// A source file: its path below `src`, and the lines of its code without tests, comments and texts of errors.
struct Source {
    name: String,
    text: String,
    code: Vec<String>,
}

impl Source {
    fn room(&self) -> &str {
        self.name.split(['/', '.']).next().unwrap_or_default()
    }

    fn stands_in(&self, places: &[&str]) -> bool {
        let path = self.name.trim_end_matches(".rs");
        places.iter().any(|place| path == *place || path.starts_with(&format!("{place}/")))
    }
}

fn rust_files(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.extension() {
            _ if path.is_dir() => rust_files(&path, files),
            Some(extension) if extension == "rs" => files.push(path),
            _ => {}
        }
    }
}

fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&root, &mut files);
    files.sort();
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).unwrap();
        let name = path.strip_prefix(&root).unwrap().to_str().unwrap().replace('\\', "/");
        let is_test = name.ends_with("/tests.rs") || name.contains("/tests/");
        let production = if is_test { "" } else { text.split("#[cfg(test)]\nmod tests").next().unwrap_or("") };
        let code = production.lines().map(|line| line.split("//").next().unwrap_or("").to_string()).collect();
        Source { name, text, code }
    };
    files.into_iter().map(read).collect()
}

fn layer(room: &str) -> Option<u32> {
    LAYERS.iter().find(|(name, _)| *name == room).map(|&(_, layer)| layer)
}

/// Whether `word` stands in `line` with no letter, digit or underscore before it.
fn stands_alone(line: &str, word: &str) -> bool {
    line.match_indices(word).any(|(at, _)| !line[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_'))
}

/// Rooms that a line names by `crate::room`, or by `crate::{room, …}`.
fn rooms_named(line: &str) -> Vec<String> {
    let mut rooms = Vec::new();
    for (at, _) in line.match_indices("crate::").filter(|&(at, _)| !line[..at].ends_with('$')) {
        let rest = &line[at + "crate::".len()..];
        match rest.strip_prefix('{') {
            Some(list) => rooms.extend(list.split([',', '}']).map(|part| part.trim().split("::").next().unwrap_or("").to_string())),
            None => rooms.push(rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()),
        }
    }
    rooms.retain(|room| layer(room).is_some());
    rooms
}

fn assert_none(complaints: Vec<String>) {
    assert!(complaints.is_empty(), "\n{}", complaints.join("\n"));
}

/// Every line of every file for which `complaint` has something to say.
fn complaints(sources: &[Source], complaint: impl Fn(&Source, &str) -> Option<String>) -> Vec<String> {
    let mut found = Vec::new();
    for source in sources {
        for (number, line) in source.code.iter().enumerate() {
            found.extend(complaint(source, line).map(|words| format!("src/{}:{}: {words}", source.name, number + 1)));
        }
    }
    found
}

#[test]
fn a_room_uses_strictly_lower_layers_only() {
    assert_none(complaints(&sources(), |source, line| {
        let own = layer(source.room())?;
        let higher = |room: &String| room != source.room() && layer(room).is_some_and(|layer| layer >= own);
        let room = rooms_named(line).into_iter().find(higher)?;
        Some(format!("{} (layer {own}) may not use {room} (layer {})", source.room(), layer(&room)?))
    }));
}

#[test]
fn every_room_has_its_layer() {
    let outside = ["lib", "main"];
    let homeless = |source: &&Source| layer(source.room()).is_none() && !outside.contains(&source.room());
    assert_none(sources().iter().filter(homeless).map(|source| format!("src/{}: its room has no layer", source.name)).collect());
}

#[test]
fn a_third_party_crate_has_its_one_room() {
    assert_none(complaints(&sources(), |source, line| {
        let name = |&&(name, rooms): &&(&str, &[&str])| stands_alone(line, &format!("{name}::")) && !rooms.contains(&source.room());
        CRATES.iter().find(name).map(|(name, rooms)| format!("{name} belongs into {}", rooms.join(" or ")))
    }));
}

#[test]
fn a_side_effect_has_its_place() {
    assert_none(complaints(&sources(), |source, line| {
        let misplaced = |&&(word, places): &&(&str, &[&str])| stands_alone(line, word) && !source.stands_in(places);
        let (word, places) = EFFECTS.iter().find(misplaced)?;
        Some(if places.is_empty() { format!("`{word}` has no place") } else { format!("`{word}` belongs into {}", places.join(", ")) })
    }));
}

#[test]
fn a_file_opens_with_a_sentence_and_stays_one_room() {
    let complaint = |source: &Source| {
        let lines = source.code.len();
        if !source.text.starts_with("//! ") {
            Some(format!("src/{}: opens with no sentence (`//! …`)", source.name))
        } else if lines > 500 {
            Some(format!("src/{}: {lines} lines before its tests; split it where the parts have names", source.name))
        } else {
            None
        }
    };
    assert_none(sources().iter().filter_map(complaint).collect());
}

#[test]
fn nothing_unfinished_is_left() {
    let words = ["TODO", "FIXME", "XXX", "todo!(", "unimplemented!(", "#[ignore"];
    let complaint = |source: &Source| {
        let word = words.iter().find(|word| source.text.contains(**word))?;
        Some(format!("src/{}: `{word}`", source.name))
    };
    assert_none(sources().iter().filter_map(complaint).collect());
}

/// The checks themselves: what they must see, and what they must not.
#[test]
fn the_checks_see_what_they_should() {
    assert_eq!(rooms_named("use crate::{mesh::TetMesh, units, image::{Volume}};"), ["mesh", "units", "image"]);
    assert_eq!(rooms_named("let x = crate::heart::Parameter::ALL;"), ["heart"]);
    assert!(rooms_named("$crate::study::reader").is_empty());
    assert!(stands_alone("use std::fs;", "std::fs"));
    assert!(!stands_alone("eprintln!(1)", "println!") && !stands_alone("use ndarray_stats::x", "array_stats::"));
}
