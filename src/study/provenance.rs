//! What a result came from: program, study file and the changes of the command line; no path of the machine that ran it.

use serde::Serialize;

use super::Config;
use crate::report::fingerprint;

/// What a result came from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Provenance {
    /// Name of the program.
    pub program: &'static str,
    /// Its version.
    pub version: &'static str,
    /// Its revision, where the build was told it (`CARDIOTWIN_REVISION`).
    pub revision: Option<&'static str>,
    /// File name of the study.
    pub study_file: String,
    /// FNV-1a hash of the study file's text, hexadecimal.
    pub study_hash: String,
    /// Settings of the command line, in order.
    pub settings: Vec<String>,
}

impl Provenance {
    pub(super) fn new(config: &Config) -> Self {
        let folder = config.file.canonicalize().ok().and_then(|file| file.parent().and_then(|f| f.file_name().map(ToOwned::to_owned)));
        let name = config.file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        Self {
            program: env!("CARGO_PKG_NAME"),
            version: env!("CARGO_PKG_VERSION"),
            revision: option_env!("CARDIOTWIN_REVISION"),
            study_file: folder.map_or_else(|| name.clone(), |folder| format!("{}/{name}", folder.to_string_lossy())),
            study_hash: format!("{:016x}", fingerprint(config.text.as_bytes())),
            settings: config.overrides.settings.clone(),
        }
    }
}
