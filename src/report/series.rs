//! A series of mesh files in time, as ParaView's collection file.

use std::path::Path;

use super::{ReportError, write_atomically};

/// Writes a `.pvd` that lists mesh files with their times; the names are relative to the folder of the `.pvd`.
///
/// # Errors
/// [`ReportError::Write`].
pub fn write_pvd(file: &Path, frames: &[(f64, String)]) -> Result<(), ReportError> {
    write_atomically(file, |out| {
        writeln!(out, "<?xml version=\"1.0\"?>")?;
        writeln!(out, "<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n  <Collection>")?;
        for (time_s, name) in frames {
            let name = name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
            writeln!(out, "    <DataSet timestep=\"{time_s}\" part=\"0\" file=\"{name}\"/>")?;
        }
        writeln!(out, "  </Collection>\n</VTKFile>")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_frame_is_listed_with_its_time() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("heart.pvd");
        write_pvd(&file, &[(0.0, "heart/000.vtu".into()), (0.035, "a&b.vtu".into())]).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.contains("timestep=\"0\" part=\"0\" file=\"heart/000.vtu\"/>"));
        assert!(text.contains("timestep=\"0.035\" part=\"0\" file=\"a&amp;b.vtu\"/>"));
    }
}
