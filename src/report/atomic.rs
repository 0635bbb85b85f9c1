//! Files that are either absent or complete: written beside their place under another name, then renamed.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::Path;

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

fn replace(file: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".writing-").suffix(".tmp");
    // A temporary file is private by default; results are made as any other file, as the user's umask says.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut temporary = builder.tempfile_in(folder)?;
    let mut buffered = BufWriter::new(temporary.as_file_mut());
    write(&mut buffered)?;
    buffered.flush()?;
    drop(buffered);
    temporary.persist(file).map(drop).map_err(|error| error.error)
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
