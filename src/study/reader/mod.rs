//! Reads typed values out of a study file and collects everything that is wrong with it, so that one run names all errors.

mod parameters;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use toml::Value;

use super::{Config, Problem};
use crate::heart::Parameter;

/// A closed set of words of the study file.
pub trait Choice: Copy + PartialEq + 'static {
    /// Each value with its word.
    const WORDS: &'static [(&'static str, Self)];

    /// The word of the study file.
    fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(_, value)| *value == self).map_or("", |(word, _)| word)
    }
}

/// Collects the problems of one study file.
pub(super) struct Reader<'a> {
    config: &'a Config,
    problems: RefCell<Vec<Problem>>,
    known: RefCell<BTreeSet<String>>,
}

/// One table of a study file; every key that is asked for is a key that may be written.
pub(super) struct TableReader<'a> {
    reader: &'a Reader<'a>,
    path: String,
    table: Option<&'a toml::Table>,
    asked: RefCell<BTreeSet<&'static str>>,
}

impl<'a> Reader<'a> {
    pub(super) fn new(config: &'a Config) -> Self {
        Self { config, problems: RefCell::default(), known: RefCell::default() }
    }

    /// The top of the file.
    pub(super) fn root(&'a self) -> TableReader<'a> {
        self.table(String::new(), Some(&self.config.document))
    }

    /// All problems found so far.
    pub(super) fn into_problems(self) -> Vec<Problem> {
        self.problems.into_inner()
    }

    /// Full names of all keys that may be written, elements of lists without their numbers.
    #[cfg(test)]
    pub(super) fn known_keys(&self) -> BTreeSet<String> {
        self.known.borrow().clone()
    }

    fn table(&'a self, path: String, table: Option<&'a toml::Table>) -> TableReader<'a> {
        TableReader { reader: self, path, table, asked: RefCell::default() }
    }
}

impl<'a> TableReader<'a> {
    /// Whether the table is written in the file.
    pub(super) fn is_written(&self) -> bool {
        self.table.is_some()
    }

    /// Whether a key is written.
    pub(super) fn has(&self, key: &'static str) -> bool {
        self.value(key).is_some()
    }

    /// Full name of a key.
    pub(super) fn name_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_string() } else { format!("{}.{key}", self.path) }
    }

    /// Records that something is wrong with a key.
    pub(super) fn problem(&self, key: &str, what: impl Into<String>, remedy: impl Into<String>) {
        let name = if key.is_empty() { self.path.clone() } else { self.name_of(key) };
        let written = self.table.and_then(|table| table.get(key));
        let value = written.filter(|value| !value.is_table()).map(|value| shortened(&value.to_string()));
        self.reader.problems.borrow_mut().push(Problem {
            line: written.and(self.reader.config.line_of(&name)),
            value,
            key: name,
            what: what.into(),
            remedy: remedy.into(),
        });
    }

    /// A number within a range, or its default where the key is absent.
    pub(super) fn number(&self, key: &'static str, range: RangeInclusive<f64>, default: f64) -> f64 {
        self.optional_number(key, range).unwrap_or(default)
    }

    /// A number within a range, if it is written.
    pub(super) fn optional_number(&self, key: &'static str, range: RangeInclusive<f64>) -> Option<f64> {
        let number = match self.value(key)? {
            Value::Float(number) => *number,
            Value::Integer(number) => *number as f64,
            _ => {
                self.problem(key, "is not a number", format!("write a number from {} to {}", range.start(), range.end()));
                return None;
            }
        };
        if !range.contains(&number) {
            self.problem(key, "is out of range", format!("choose a value from {} to {}", range.start(), range.end()));
            return None;
        }
        Some(number)
    }

    /// A whole number within a range, or its default.
    pub(super) fn count(&self, key: &'static str, range: RangeInclusive<i64>, default: i64) -> usize {
        self.optional_count(key, range).unwrap_or(usize::try_from(default).unwrap_or(0))
    }

    /// A whole number within a range, if it is written.
    pub(super) fn optional_count(&self, key: &'static str, range: RangeInclusive<i64>) -> Option<usize> {
        let allowed = format!("a whole number from {} to {}", range.start(), range.end());
        match self.value(key)? {
            Value::Integer(number) if range.contains(number) => usize::try_from(*number).ok(),
            Value::Integer(_) => {
                self.problem(key, "is out of range", format!("choose {allowed}"));
                None
            }
            _ => {
                self.problem(key, "is not a whole number", format!("write {allowed}"));
                None
            }
        }
    }

    /// One of a closed set of words, or its default.
    pub(super) fn choice<T: Choice>(&self, key: &'static str, default: T) -> T {
        self.optional_choice(key).unwrap_or(default)
    }

    /// One of a closed set of words, if it is written.
    pub(super) fn optional_choice<T: Choice>(&self, key: &'static str) -> Option<T> {
        let words = || T::WORDS.iter().map(|(word, _)| format!("\"{word}\"")).collect::<Vec<_>>().join(", ");
        let found = self.value(key)?.as_str().and_then(|text| T::WORDS.iter().find(|(word, _)| *word == text));
        if found.is_none() {
            self.problem(key, "is not one of its words", format!("choose one of {}", words()));
        }
        found.map(|&(_, value)| value)
    }

    /// A list of such words, if it is written.
    pub(super) fn words<T: Choice>(&self, key: &'static str) -> Option<Vec<T>> {
        let find = |text: &String| T::WORDS.iter().find(|(word, _)| word == text).map(|&(_, value)| value);
        let found = self.texts(key)?.iter().map(find).collect::<Option<Vec<T>>>().filter(|list| !list.is_empty());
        if found.is_none() {
            let words = T::WORDS.iter().map(|(word, _)| format!("\"{word}\"")).collect::<Vec<_>>().join(", ");
            self.problem(key, "is not a list of its words", format!("write some of {words} in brackets"));
        }
        found
    }

    /// Text, if it is written.
    pub(super) fn text(&self, key: &'static str) -> Option<&'a str> {
        let text = self.value(key)?.as_str();
        if text.is_none() {
            self.problem(key, "is not text", "write it in quotes");
        }
        text
    }

    /// Whether text is written.
    pub(super) fn is_text(&self, key: &'static str) -> bool {
        self.value(key).is_some_and(Value::is_str)
    }

    /// Yes or no, or its default.
    pub(super) fn flag(&self, key: &'static str, default: bool) -> bool {
        let Some(value) = self.value(key) else { return default };
        value.as_bool().unwrap_or_else(|| {
            self.problem(key, "is neither true nor false", "write true or false");
            default
        })
    }

    /// Three numbers, if they are written.
    pub(super) fn vector(&self, key: &'static str) -> Option<Vector3<f64>> {
        let numbers = self.numbers(key)?;
        if numbers.len() != 3 {
            self.problem(key, "is not a vector", "write three numbers, [x, y, z], in world coordinates (RAS)");
            return None;
        }
        Some(Vector3::new(numbers[0], numbers[1], numbers[2]))
    }

    /// A list of vectors, if it is written.
    pub(super) fn vectors(&self, key: &'static str) -> Option<Vec<Vector3<f64>>> {
        let number = |value: &Value| value.as_float().or_else(|| value.as_integer().map(|n| n as f64)).filter(|n| n.is_finite());
        let vector = |value: &Value| match value.as_array()?.iter().map(number).collect::<Option<Vec<f64>>>()?[..] {
            [x, y, z] => Some(Vector3::new(x, y, z)),
            _ => None,
        };
        let vectors = self.value(key)?.as_array().and_then(|list| list.iter().map(vector).collect());
        if vectors.is_none() {
            self.problem(key, "is not a list of points", "write points in brackets, [[x, y, z], …], in world coordinates (RAS)");
        }
        vectors
    }

    /// A list of finite numbers, if it is written.
    pub(super) fn numbers(&self, key: &'static str) -> Option<Vec<f64>> {
        let number = |value: &Value| value.as_float().or_else(|| value.as_integer().map(|n| n as f64)).filter(|n| n.is_finite());
        let numbers = self.value(key)?.as_array().and_then(|list| list.iter().map(number).collect());
        if numbers.is_none() {
            self.problem(key, "is not a list of numbers", "write numbers in brackets, separated by commas");
        }
        numbers
    }

    /// A list of texts, if it is written.
    pub(super) fn texts(&self, key: &'static str) -> Option<Vec<String>> {
        let text = |value: &Value| value.as_str().map(str::to_string);
        let texts = self.value(key)?.as_array().and_then(|list| list.iter().map(text).collect());
        if texts.is_none() {
            self.problem(key, "is not a list of names", "write names in quotes and brackets, separated by commas");
        }
        texts
    }

    /// The keys and values of the table under a key, whatever they are, as `table.key=value`.
    pub(super) fn settings(&self, key: &'static str) -> Vec<String> {
        let Some(value) = self.value(key) else { return Vec::new() };
        if !value.is_table() {
            self.problem(key, "is not a table", "write keys of the study and their values, { \"table.key\" = value }");
        }
        let mut settings = Vec::new();
        flatten(None, value, &mut settings);
        settings
    }

    /// An existing file of the data folder, if it is written.
    pub(super) fn data_file(&self, key: &'static str) -> Option<PathBuf> {
        let remedy = "mend the path, which starts from `data`, or give the folder of the data with --data DIR";
        self.file_in(&self.reader.config.data_folder(), key, remedy)
    }

    /// An existing file that an earlier run left, if it is written: from the folder of the study file, as `output.directory`.
    pub(super) fn result_file(&self, key: &'static str) -> Option<PathBuf> {
        let remedy = "mend the path, which starts from the folder of the study file, or run first the study that leaves it";
        self.file_in(self.reader.config.folder(), key, remedy)
    }

    fn file_in(&self, folder: &Path, key: &'static str, remedy: &str) -> Option<PathBuf> {
        let path = folder.join(self.text(key)?);
        if !path.is_file() {
            self.problem(key, format!("names no file: {} does not exist", path.display()), remedy);
        }
        Some(path)
    }

    /// An existing file or folder of the data folder, if it is written.
    pub(super) fn data_path(&self, key: &'static str) -> Option<PathBuf> {
        let path = self.reader.config.data_folder().join(self.text(key)?);
        if path.is_dir() { Some(path) } else { self.data_file(key) }
    }

    /// An existing file or folder of the data folder that must be written.
    pub(super) fn required_data_path(&self, key: &'static str) -> PathBuf {
        if !self.has(key) {
            self.missing(key, "the path of a file or a folder");
        }
        self.data_path(key).unwrap_or_default()
    }

    /// An existing file of the data folder that must be written.
    pub(super) fn required_data_file(&self, key: &'static str) -> PathBuf {
        if !self.has(key) {
            self.missing(key, "the path of a file");
        }
        self.data_file(key).unwrap_or_default()
    }

    /// The table under a key.
    pub(super) fn table(&self, key: &'static str) -> TableReader<'a> {
        let value = self.value(key);
        let table = value.and_then(Value::as_table);
        if value.is_some() && table.is_none() {
            self.problem(key, "is not a table", format!("write [{}] and its keys below", self.name_of(key)));
        }
        self.reader.table(self.name_of(key), table)
    }

    /// The tables of an array of tables, `[[key]]`.
    pub(super) fn tables(&self, key: &'static str) -> Vec<TableReader<'a>> {
        let Some(value) = self.value(key) else { return Vec::new() };
        let tables: Option<Vec<_>> = value.as_array().and_then(|list| list.iter().map(Value::as_table).collect());
        if tables.is_none() {
            self.problem(key, "is not a list of tables", format!("write [[{}]] once for each", self.name_of(key)));
        }
        let named = |(number, table)| self.reader.table(format!("{}[{number}]", self.name_of(key)), Some(table));
        tables.unwrap_or_default().into_iter().enumerate().map(named).collect()
    }

    /// Ends the table: whatever is written and was not asked for is an error.
    pub(super) fn close(self) {
        let asked = self.asked.borrow();
        let path = without_numbers(&self.path);
        let full = |key: &&str| if path.is_empty() { key.to_string() } else { format!("{path}.{key}") };
        self.reader.known.borrow_mut().extend(asked.iter().map(full));
        let Some(table) = self.table else { return };
        for key in table.keys().filter(|key| !asked.contains(key.as_str())) {
            let remedy = match nearest(key, &asked) {
                Some(near) => format!("did you mean `{near}`?"),
                None => {
                    elsewhere(key).unwrap_or_else(|| format!("the keys here are {}", asked.iter().copied().collect::<Vec<_>>().join(", ")))
                }
            };
            let known = if self.path.is_empty() { "is not known".to_string() } else { format!("is not known in [{}]", self.path) };
            self.problem(key, known, remedy);
        }
    }

    fn value(&self, key: &'static str) -> Option<&'a Value> {
        self.asked.borrow_mut().insert(key);
        self.table?.get(key)
    }

    /// Records that a key must be written and is not.
    pub(super) fn missing(&self, key: &str, expected: &str) {
        self.problem(key, "is missing", format!("write {expected}"));
    }
}

/// The name of a table without its numbers in lists.
fn without_numbers(path: &str) -> String {
    path.split('[')
        .enumerate()
        .map(|(place, part)| if place == 0 { part } else { part.split_once(']').map_or("", |(_, rest)| rest) })
        .collect()
}

/// `table.key=value` for every value of nested tables.
fn flatten(name: Option<&str>, value: &Value, settings: &mut Vec<String>) {
    match (name, value.as_table()) {
        (_, Some(table)) => {
            for (key, inner) in table {
                let full = name.map_or_else(|| key.clone(), |name| format!("{name}.{key}"));
                flatten(Some(&full), inner, settings);
            }
        }
        (Some(name), None) => settings.push(format!("{name}={value}")),
        (None, None) => {}
    }
}

/// The known key that differs by few letters.
fn nearest<'k>(key: &str, known: &BTreeSet<&'k str>) -> Option<&'k str> {
    let near = known.iter().map(|&candidate| (strsim::damerau_levenshtein(key, candidate), candidate)).min()?;
    (near.0 <= 2.max(key.len() / 4)).then_some(near.1)
}

/// Where a parameter belongs that was written in a wrong table.
fn elsewhere(key: &str) -> Option<String> {
    Parameter::from_name(key).map(|parameter| format!("it belongs into [{}]", parameter.spec().section.key()))
}

fn shortened(text: &str) -> String {
    let mut short: String = text.chars().take(80).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}
