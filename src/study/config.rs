//! A study file as written: its TOML, the folder it stands in, and what the command line changes in it.

use std::path::{Path, PathBuf};

use toml::de::DeTable;
use toml::{Table, Value};

use super::StudyError;

/// What the command line changes in a study file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overrides {
    /// Replaces the key `data`, the folder that the data paths start from; relative to the working directory.
    pub data: Option<PathBuf>,
    /// Replaces `output.directory`; relative to the working directory.
    pub output: Option<PathBuf>,
    /// Settings `table.key=value`, in order; the value is TOML, or text where it is not.
    pub settings: Vec<String>,
}

/// A study file as written.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    pub(super) file: PathBuf,
    pub(super) text: String,
    pub(super) document: Table,
    pub(super) overrides: Overrides,
}

impl Config {
    /// Reads a study file and applies the command line to it.
    ///
    /// # Errors
    /// [`StudyError`] if the file cannot be read, is not TOML, or an override cannot be understood.
    pub fn read(file: &Path, overrides: Overrides) -> Result<Self, StudyError> {
        let text = std::fs::read_to_string(file).map_err(|source| StudyError::Unreadable { file: file.to_path_buf(), source })?;
        Self::from_text(file, text, overrides)
    }

    /// The study that `text` writes, as if it stood in `file`.
    ///
    /// # Errors
    /// [`StudyError`] if the text is not TOML, or an override cannot be understood.
    pub fn from_text(file: &Path, text: String, overrides: Overrides) -> Result<Self, StudyError> {
        let mut document: Table =
            text.parse().map_err(|error: toml::de::Error| StudyError::NotToml { file: file.to_path_buf(), message: error.to_string() })?;
        for setting in &overrides.settings {
            apply(&mut document, setting)?;
        }
        Ok(Self { file: file.to_path_buf(), text, document, overrides })
    }

    /// The study that meshes a heart from a label map, or from the masks of epicardium, left and (if there is one) right endocardium; their
    /// paths start from the working directory.
    ///
    /// # Errors
    /// [`StudyError`] if an override cannot be understood.
    pub fn of_drawing(paths: &[PathBuf], overrides: Overrides) -> Result<Self, StudyError> {
        const MASKS: [&str; 3] = ["mask_epicardium", "mask_endocardium_lv", "mask_endocardium_rv"];
        let keys = if paths.len() == 1 { &["labels"][..] } else { &MASKS };
        let files = keys.iter().zip(paths).map(|(key, path)| (key.to_string(), Value::String(path.to_string_lossy().into_owned())));
        let anatomy = Value::Table(files.collect());
        let document: Table = [("kind".to_string(), Value::String("mesh".into())), ("anatomy".to_string(), anatomy)].into_iter().collect();
        let overrides = Overrides { data: overrides.data.or_else(|| Some(".".into())), ..overrides };
        Self::from_text(Path::new("command line"), document.to_string(), overrides)
    }

    /// The study file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The folder of the study file, which its relative paths start from.
    pub fn folder(&self) -> &Path {
        self.file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
    }

    /// The folder of the data: `--data`, or the key `data`, or the folder of the study file.
    pub fn data_folder(&self) -> PathBuf {
        match (&self.overrides.data, self.document.get("data").and_then(Value::as_str)) {
            (Some(data), _) => data.clone(),
            (None, Some(data)) => self.folder().join(data),
            (None, None) => self.folder().to_path_buf(),
        }
    }

    /// Line of a key in the file, counted from one; none if it is not written there or was set on the command line.
    pub(super) fn line_of(&self, key: &str) -> Option<usize> {
        let is_overridden = |setting: &String| setting.split_once('=').is_some_and(|(name, _)| name.trim() == key);
        if self.overrides.settings.iter().any(is_overridden) {
            return None;
        }
        let document = DeTable::parse(&self.text).ok()?;
        let mut table = document.get_ref();
        let mut offset = None;
        let names: Vec<&str> = key.split('.').collect();
        for (depth, name) in names.iter().enumerate() {
            // An array's element is written `name[number]`; the whole array's place serves.
            let (name, is_element) = name.split_once('[').map_or((*name, false), |(name, _)| (name, true));
            let Some((found, value)) = table.iter().find(|(found, _)| found.get_ref().as_ref() == name) else { break };
            offset = Some(found.span().start);
            if is_element || depth + 1 == names.len() {
                break;
            }
            match value.get_ref().as_table() {
                Some(inner) => table = inner,
                None => break,
            }
        }
        offset.map(|offset| self.text[..offset].matches('\n').count() + 1)
    }
}

/// Writes `table.key=value` into the document, making tables where they are missing.
fn apply(document: &mut Table, setting: &str) -> Result<(), StudyError> {
    let bad = |reason: &str| StudyError::BadOverride { text: setting.to_string(), reason: reason.to_string() };
    let (key, value) = setting.split_once('=').ok_or_else(|| bad("it has no `=`"))?;
    let value = value.trim();
    let parsed = format!("value = {value}").parse::<Table>().ok().and_then(|mut table| table.remove("value"));
    let value = parsed.unwrap_or_else(|| Value::String(value.to_string()));
    let mut names: Vec<&str> = key.split('.').map(str::trim).collect();
    let last = names.pop().filter(|name| !name.is_empty()).ok_or_else(|| bad("its key is empty"))?;
    let mut table = document;
    for name in names {
        let inner = table.entry(name).or_insert_with(|| Value::Table(Table::new()));
        table = inner.as_table_mut().ok_or_else(|| bad(&format!("`{name}` is a value, not a table")))?;
    }
    table.insert(last.to_string(), value);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(text: &str, settings: &[&str]) -> Result<Config, StudyError> {
        let overrides = Overrides { settings: settings.iter().map(|s| s.to_string()).collect(), ..Overrides::default() };
        Config::from_text(Path::new("a/study.toml"), text.into(), overrides)
    }

    #[test]
    fn a_setting_replaces_or_adds_a_key_with_its_own_type() {
        let config =
            config("[mechanics]\nstep_s = 0.01\n", &["mechanics.step_s=0.002", "tracking.scheme=exact", "kind=\"track\""]).unwrap();
        assert_eq!(config.document["mechanics"]["step_s"].as_float(), Some(0.002));
        assert_eq!(config.document["tracking"]["scheme"].as_str(), Some("exact"));
        assert_eq!(config.document["kind"].as_str(), Some("track"));
    }

    #[test]
    fn a_setting_without_a_key_or_through_a_value_is_refused() {
        for bad in ["mechanics.step_s", "=3", "kind.deeper=3"] {
            assert!(matches!(config("kind = \"track\"", &[bad]), Err(StudyError::BadOverride { .. })), "{bad}");
        }
    }

    #[test]
    fn lines_are_those_of_the_file_and_overridden_keys_have_none() {
        let text = "kind = \"track\"\n\n[mechanics]\nstep_s = 0.01\n# a remark\npoisson_ratio = 0.4\n";
        let config = config(text, &["mechanics.step_s=0.1"]).unwrap();
        assert_eq!(config.line_of("mechanics.poisson_ratio"), Some(6));
        assert_eq!(config.line_of("mechanics"), Some(3));
        assert_eq!(config.line_of("mechanics.step_s"), None);
    }

    #[test]
    fn paths_start_from_the_study_file_and_the_command_line_from_where_one_stands() {
        let mut config = config("data = \"../hearts\"", &[]).unwrap();
        assert_eq!(config.data_folder(), Path::new("a/../hearts"));
        config.overrides.data = Some("elsewhere".into());
        assert_eq!(config.data_folder(), Path::new("elsewhere"));
    }
}
