//! Whether two runs are of the same study: the hash of what a study file means, what its files hold, and the program.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::{Config, Plan, RunError};
use crate::report::{FINGERPRINT_START, fingerprint, fingerprint_on};

/// The hash of a study file with the changes of the command line. Comments, order of keys, output and the folder of the data make no difference.
pub(super) fn document_hash(config: &Config) -> u64 {
    let mut meaning = config.document.clone();
    meaning.remove("output");
    meaning.remove("data");
    fingerprint(meaning.to_string().as_bytes())
}

/// The hash of program, study file and the contents of the files that it reads.
///
/// # Errors
/// [`RunError::Input`] if one of these cannot be read.
pub(super) fn identity(plan: &Plan, document_hash: u64) -> Result<u64, RunError> {
    let program = fingerprint_on(FINGERPRINT_START, plan.provenance.version.as_bytes());
    let study = fingerprint_on(program, &document_hash.to_le_bytes());
    plan.input_files().iter().try_fold(study, |hash, path| content_hash(hash, path))
}

/// The hash of a file's contents, or of all files of a folder, in the order of their names.
fn content_hash(so_far: u64, path: &Path) -> Result<u64, RunError> {
    let failed = |source| RunError::Input { file: path.to_path_buf(), source };
    if path.is_dir() {
        let entries = std::fs::read_dir(path).map_err(failed)?;
        let mut inside: Vec<PathBuf> = entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>().map_err(failed)?;
        inside.sort();
        return inside.iter().try_fold(so_far, |hash, path| content_hash(hash, path));
    }
    let (mut file, mut hash) = (std::fs::File::open(path).map_err(failed)?, so_far);
    let mut block = vec![0; 1 << 16];
    loop {
        match file.read(&mut block).map_err(failed)? {
            0 => return Ok(hash),
            count => hash = fingerprint_on(hash, &block[..count]),
        }
    }
}
