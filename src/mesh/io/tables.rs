//! Reads meshes from plain-text tables: a file of vertices, one of tetrahedra, one of tagged triangles, one of fibres.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::mesh_file::{FieldArray, MeshFile};
use crate::mesh::MeshError;

/// The files of a mesh. A row a line, numbers separated by blanks or commas; vertices are counted from 0, and `#` begins a remark.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TableFiles {
    /// x y z.
    pub vertices: PathBuf,
    /// Four vertices.
    pub tetrahedra: PathBuf,
    /// Three vertices and the code of the surface.
    pub surface: PathBuf,
    /// A row a vertex or a tetrahedron: the fibre's x y z, then, if there are more, those of the sheet; the rest is left out.
    pub fibres: Option<PathBuf>,
}

/// Reads the tables; the surface's codes become the triangles' field `surface_tag`, fibres and sheets the fields `fibre` and `sheet`.
///
/// # Errors
/// [`MeshError::Unreadable`] if a file cannot be opened, [`MeshError::Unusable`] names the file and the line that does not fit.
pub fn read_mesh_tables(files: &TableFiles) -> Result<MeshFile, MeshError> {
    let mut mesh = MeshFile {
        points: rows::<f64, 3>(&files.vertices)?.into_iter().map(Vector3::from).collect(),
        tetrahedra: rows::<usize, 4>(&files.tetrahedra)?,
        ..MeshFile::default()
    };
    let mut codes = vec![];
    for [a, b, c, code] in rows::<usize, 4>(&files.surface)? {
        mesh.triangles.push([a, b, c]);
        codes.push(code as f64);
    }
    mesh.triangle_fields.insert("surface_tag".into(), FieldArray { components: 1, values: codes });
    if let Some(path) = &files.fibres {
        let table = table::<f64>(path)?;
        let width = table.first().map_or(0, Vec::len);
        let fields = match table.len() {
            n if n == mesh.points.len() => &mut mesh.point_fields,
            n if n == mesh.tetrahedra.len() => &mut mesh.tetrahedron_fields,
            n => return Err(unusable(path, format!("it has {n} rows, neither one a vertex nor one a tetrahedron"))),
        };
        if width < 3 {
            return Err(unusable(path, format!("its rows have {width} numbers; a direction has three")));
        }
        for (name, from) in [("fibre", 0), ("sheet", 3)].into_iter().filter(|(_, from)| from + 3 <= width) {
            let values = table.iter().flat_map(|row| row[from..from + 3].iter().copied()).collect();
            fields.insert(name.into(), FieldArray { components: 3, values });
        }
    }
    Ok(mesh)
}

fn unusable(path: &Path, reason: String) -> MeshError {
    MeshError::Unusable { path: path.into(), reason }
}

/// Rows of `N` numbers.
fn rows<T: std::str::FromStr, const N: usize>(path: &Path) -> Result<Vec<[T; N]>, MeshError> {
    let wrong = |count: usize| unusable(path, format!("its rows have {count} numbers where {N} are needed"));
    table(path)?.into_iter().map(|row| <[T; N]>::try_from(row).map_err(|row: Vec<T>| wrong(row.len()))).collect()
}

/// Rows of numbers, all of one length.
fn table<T: std::str::FromStr>(path: &Path) -> Result<Vec<Vec<T>>, MeshError> {
    let text = std::fs::read_to_string(path).map_err(|error| MeshError::Unreadable { path: path.into(), reason: error.to_string() })?;
    let mut table: Vec<Vec<T>> = vec![];
    for (number, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or("");
        let words = content.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
        let not_a_number = |word: &str| unusable(path, format!("line {}: {word:?} is not a number of the kind needed here", number + 1));
        let row = words.map(|word| word.parse().map_err(|_| not_a_number(word))).collect::<Result<Vec<T>, _>>()?;
        let width = table.first().map_or(row.len(), Vec::len);
        if !row.is_empty() && row.len() != width {
            let reason = format!("line {} has {} numbers where those before have {width}; is the file truncated?", number + 1, row.len());
            return Err(unusable(path, reason));
        }
        if !row.is_empty() {
            table.push(row);
        }
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(folder: &Path, contents: [&str; 4]) -> TableFiles {
        let [vertices, tetrahedra, surface, fibres] = ["v.txt", "t.txt", "s.txt", "f.txt"].map(|name| folder.join(name));
        for (path, content) in [&vertices, &tetrahedra, &surface, &fibres].into_iter().zip(contents) {
            std::fs::write(path, content).unwrap();
        }
        TableFiles { vertices, tetrahedra, surface, fibres: Some(fibres) }
    }

    #[test]
    fn tables_are_read_and_what_does_not_fit_is_named_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let vertices = "# metres\n0 0 0\n1,0,0\n\n0 1 0\n0 0 1\n";
        let good = [vertices, "0 1 2 3\n", "0 1 2 30\n", "1 0 0 0 1 0 0 0 1\n"];
        let mesh = read_mesh_tables(&files(folder.path(), good)).unwrap();
        assert_eq!((mesh.points[1], mesh.tetrahedra[0], mesh.triangles[0]), (Vector3::x(), [0, 1, 2, 3], [0, 1, 2]));
        assert_eq!(mesh.triangle_fields["surface_tag"].values, [30.0]);
        assert_eq!((mesh.directions("fibre").unwrap()[0], mesh.directions("sheet").unwrap()[0]), (Vector3::x(), Vector3::y()));
        let cases = [
            (["0 0 0\n1 0\n", good[1], good[2], good[3]], "v.txt cannot be used: line 2 has 2 numbers where those before have 3"),
            ([vertices, "0 1 2 -3\n", good[2], good[3]], "t.txt cannot be used: line 1: \"-3\" is not a number of the kind"),
            ([vertices, "0 1 2\n", good[2], good[3]], "t.txt cannot be used: its rows have 3 numbers where 4 are needed"),
            ([vertices, good[1], good[2], "1 0 0\n1 0 0\n"], "f.txt cannot be used: it has 2 rows, neither one a vertex nor one a tetra"),
            ([vertices, good[1], good[2], "1 0\n"], "f.txt cannot be used: its rows have 2 numbers; a direction has three"),
        ];
        for (contents, words) in cases {
            let error = read_mesh_tables(&files(folder.path(), contents)).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
