//! What the documents name exists: files and tests of `docs/equations.md`, references, study files of the README.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may stop at the first surprise")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn read(path: impl AsRef<Path>) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn files_below(folder: &str, extension: &str) -> Vec<PathBuf> {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|found| found == extension) {
                files.push(path);
            }
        }
    }
    files
}

/// What stands between backticks.
fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

#[test]
fn every_equation_has_its_file_and_its_test() {
    let equations = read("docs/equations.md");
    let rows: Vec<&str> = equations.lines().filter(|line| line.starts_with("| ") && line.contains("`src/")).collect();
    assert!(rows.len() >= 10, "{} rows", rows.len());
    for row in rows {
        let cells: Vec<&str> = row.split(" | ").collect();
        for file in quoted(cells[2]) {
            assert!(!read(file).is_empty());
        }
        let mut source = String::new();
        let mut tests = 0;
        for word in quoted(cells[3]) {
            if word.ends_with(".rs") {
                source = read(word);
            } else {
                assert!(source.contains(&format!("fn {word}(")), "the test {word} is not where docs/equations.md has it");
                tests += 1;
            }
        }
        assert!(tests > 0, "no test in: {row}");
    }
}

/// `[Name1234]` in a text; documentation comments write `\[Name1234\]`, which is no link.
fn citations(text: &str) -> BTreeSet<String> {
    let is_key = |key: &str| {
        let (name, year) = key.split_at(key.len().saturating_sub(4));
        name.chars().next().is_some_and(char::is_uppercase)
            && name.chars().all(char::is_alphabetic)
            && year.chars().all(|c| c.is_ascii_digit())
    };
    // In documentation comments the brackets are escaped, so that they are no links.
    let keys = text.split('[').skip(1).filter_map(|rest| rest.split_once(']')).map(|(key, _)| key.trim_end_matches('\\'));
    keys.filter(|key| key.is_ascii() && key.len() > 5 && is_key(key)).map(str::to_string).collect()
}

#[test]
fn every_citation_has_its_reference() {
    let references = read("docs/references.bib");
    let texts = files_below("src", "rs").into_iter().chain(files_below("tests", "rs")).chain(files_below("docs", "md"));
    let mut cited = 0;
    for file in texts.chain([PathBuf::from("README.md")]) {
        for key in citations(&read(&file)).iter().filter(|key| *key != "Name1234") {
            assert!(references.contains(&format!("{{{key},")), "[{key}], cited in {}, is not in docs/references.bib", file.display());
            cited += 1;
        }
    }
    assert!(cited > 30, "only {cited} citations found: has their spelling changed?");
}

#[test]
fn files_that_the_readme_names_exist() {
    let readme = read("README.md");
    let named = readme.split(|c: char| c.is_whitespace() || "()`,;".contains(c));
    let files: BTreeSet<&str> =
        named.filter(|word| ["studies/", "docs/", "src/", "results/"].iter().any(|root| word.starts_with(root))).collect();
    assert!(files.len() > 3, "{files:?}");
    for file in files {
        assert!(
            Path::new(env!("CARGO_MANIFEST_DIR")).join(file.trim_end_matches(['.', ':'])).exists(),
            "{file}, named in README.md, does not exist"
        );
    }
}

/// README.md, the documents and those of the studies and of the Python door.
fn documents() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let all = files_below("docs", "md").into_iter().chain(files_below("studies", "md"));
    all.chain([root.join("README.md"), root.join("python/README.md"), root.join("CHANGELOG.md")]).collect()
}

#[test]
fn links_lead_to_files() {
    let mut count = 0;
    for document in documents() {
        let text = read(&document);
        for target in text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target) {
            let file = target.split('#').next().unwrap_or("");
            if !target.contains("://") && !file.is_empty() {
                let path = document.with_file_name(file);
                assert!(path.exists(), "{target}, linked in {}, does not exist", document.display());
                count += 1;
            }
        }
    }
    assert!(count > 20, "{count}");
}

#[test]
fn files_that_a_run_is_said_to_leave_are_written_somewhere() {
    let source: String = files_below("src", "rs").iter().map(read).collect();
    let results = read("docs/results.md");
    let names: BTreeSet<&str> =
        quoted(&results).into_iter().filter(|word| word.ends_with(".csv") || word.ends_with(".json") || word.ends_with(".pvd")).collect();
    assert!(names.len() > 12, "{names:?}");
    for name in names {
        // Series of meshes are named without their endings.
        let written = name.strip_suffix(".pvd").unwrap_or(name);
        assert!(source.contains(&format!("\"{written}")), "{name} of docs/results.md is written nowhere");
    }
}

#[test]
fn commands_in_running_text_exist() {
    let arguments = read("src/cli/arguments.rs");
    let commands = arguments.split("enum Command {").nth(1).and_then(|rest| rest.split("\nimpl Command").next()).unwrap_or_default();
    let known: BTreeSet<String> = commands
        .lines()
        .filter_map(|line| line.trim().split(['(', ' ', ',']).next())
        .filter(|word| word.chars().next().is_some_and(char::is_uppercase))
        .map(str::to_lowercase)
        .collect();
    assert!(known.contains("run") && known.contains("completions") && known.len() > 10, "{known:?}");
    let mut count = 0;
    for document in documents() {
        for code in quoted(&read(&document)) {
            let Some(command) = code.strip_prefix("cardiotwin ").and_then(|rest| rest.split_whitespace().next()) else { continue };
            let is_command = command.chars().all(|c| c.is_ascii_lowercase());
            assert!(!is_command || known.contains(command), "`{code}` in {}: there is no command {command}", document.display());
            count += usize::from(is_command);
        }
    }
    assert!(count > 20, "{count}");
}
