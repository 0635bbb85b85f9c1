//! What tests share: folders of their own, and real data where they are at hand.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "each test uses its part, may stop at the first surprise, and says what it could not look at"
)]

use std::path::{Path, PathBuf};

/// An empty folder for a part of a test.
pub fn fresh_folder(test: &str, part: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test).join(part);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// A study file in an empty folder of its own, and the folder of its results, which is not there yet.
pub fn fresh_study(test: &str, part: &str, text: &str) -> (PathBuf, PathBuf) {
    let folder = fresh_folder(test, part);
    let file = folder.join("study.toml");
    std::fs::write(&file, text).unwrap();
    (file, folder.join("results"))
}

/// A folder of `../shared/data`, or none, which is said, where this machine has no copy of it.
pub fn real_data(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !folder.is_dir() {
        eprintln!("SKIPPED: {} is not at hand", folder.display());
        return None;
    }
    Some(folder)
}
