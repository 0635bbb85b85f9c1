//! Files that are either absent or complete: written beside their place under another name, then renamed.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::ReportError;

/// Makes a folder and those above it.
///
/// # Errors
/// [`ReportError::Folder`] with the system's reason.
pub fn create_folder(folder: &Path) -> Result<(), ReportError> {
    fs::create_dir_all(folder).map_err(|source| ReportError::Folder { folder: folder.to_path_buf(), source })
}

/// Writes a file through `write`, so that whoever looks sees the file that stood there before, or the whole new one.
///
/// # Errors
/// [`ReportError::Write`] with the system's reason, or with that of `write`; nothing is left behind then.
pub fn write_atomically(file: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), ReportError> {
    replace(file, write).map_err(|source| ReportError::Write { file: file.to_path_buf(), source })
}

/// Takes a file away, if it is there.
///
/// # Errors
/// [`ReportError::Write`] with the system's reason.
pub fn remove(file: &Path) -> Result<(), ReportError> {
    match fs::remove_file(file) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other.map_err(|source| ReportError::Write { file: file.to_path_buf(), source }),
    }
}

fn replace(file: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".writing-").suffix(".tmp");
    // A temporary file is private by default; results are made as any other file, as the user's umask says.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut temporary = {
        let mut under_way = under_way();
        let temporary = builder.tempfile_in(folder)?;
        under_way.push(temporary.path().to_path_buf());
        temporary
    };
    let path = temporary.path().to_path_buf();
    let mut buffered = BufWriter::new(temporary.as_file_mut());
    let written = write(&mut buffered).and_then(|()| buffered.flush());
    drop(buffered);
    let mut under_way = under_way();
    under_way.retain(|other| *other != path);
    written.and_then(|()| temporary.persist(file).map(drop).map_err(|error| error.error))
}

/// The temporary files of this process. They are a matter of the whole process, and so is their list: only its end asks for it.
static UNDER_WAY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn under_way() -> MutexGuard<'static, Vec<PathBuf>> {
    UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// As long as it lives no file is begun or put in its place.
#[derive(Debug)]
pub struct WritingStopped(#[allow(dead_code, reason = "held, not read")] MutexGuard<'static, Vec<PathBuf>>);

/// Takes away whatever is half-written, and lets nothing more be written: for a program that is about to end at once.
pub fn stop_writing() -> WritingStopped {
    let under_way = under_way();
    for file in under_way.iter() {
        // What cannot be removed cannot be told any more either.
        let _there_or_not = fs::remove_file(file);
    }
    WritingStopped(under_way)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_write_that_fails_halfway_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("curves.csv");
        write_atomically(&file, |out| out.write_all(b"old")).unwrap();
        let error = write_atomically(&file, |out| {
            out.write_all(&[b'x'; 100_000])?;
            Err(io::Error::other("the disk is full"))
        });
        assert!(error.unwrap_err().to_string().contains("curves.csv"));
        assert_eq!(fs::read(&file).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["curves.csv"]);
        write_atomically(&file, |out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let error = create_folder(&file.join("below")).unwrap_err();
        assert!(matches!(&error, ReportError::Folder { folder, .. } if folder.ends_with("file/below")), "{error}");
    }
}
