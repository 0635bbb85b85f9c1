//! Material points that move with a tracked heart: from world positions on one frame to their paths over all frames.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use crate::mesh::io::read_mesh_file;
use crate::mesh::{Location, MeshError, TetLocator};
use crate::report::{PathRow, ReportError, write_csv};

/// Points farther than this from the wall are not followed, mm.
const FARTHEST_MM: f64 = 10.0;

/// What was followed.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// One a point and frame, point by point.
    pub paths: Vec<PathRow>,
    /// Points that do not lie in the wall, in words.
    pub warnings: Vec<String>,
}

/// Why points cannot be followed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum FollowError {
    /// The folder has no series of meshes.
    #[error("{} has neither tracked.pvd nor heart.pvd; give the folder of a finished run that wrote its meshes (output.meshes = true)", folder.display())]
    NoSeries { folder: PathBuf },
    /// A file cannot be read.
    #[error("cannot read {}: {reason}", file.display())]
    Unreadable { file: PathBuf, reason: String },
    /// The list of points is not one.
    #[error("{} line {line}: {reason}; the first line is `point,x_mm,y_mm,z_mm`, then one point a line, world coordinates (RAS)", file.display())]
    NotPoints { file: PathBuf, line: usize, reason: String },
    /// The series has no such frame.
    #[error("the run in {} has no frame {frame}; frames.csv lists its frames", folder.display())]
    NoFrame { folder: PathBuf, frame: usize },
    /// A point is nowhere near the wall.
    #[error(
        "the point {point} lies {distance_mm:.1} mm from the wall, more than {FARTHEST_MM} mm; check that it is in world coordinates (RAS, mm) and drawn on frame {frame}"
    )]
    FarAway { point: String, distance_mm: f64, frame: usize },
    /// A mesh file.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Writing.
    #[error(transparent)]
    Report(#[from] ReportError),
}

/// Follows the points of a CSV file (`point,x_mm,y_mm,z_mm`, drawn on the cine's frame `frame`, or on the one that the run starts from)
/// through the meshes that a run left in `folder`, the tracked ones where there are any, and writes `paths.csv` there.
///
/// A point keeps its barycentric weights $w$ in its tetrahedron: $x(t) = \sum_i w_i y_i(t)$. One outside the wall keeps its offset to the
/// nearest place of the wall, and a warning names it.
///
/// # Errors
/// [`FollowError`].
pub fn follow(folder: &Path, points: &Path, frame: Option<usize>) -> Result<Followed, FollowError> {
    let points = read_points(points)?;
    let series = read_series(folder)?;
    let drawn_on = match frame {
        Some(frame) => series.iter().find(|instant| instant.frame == frame),
        None => series.first(),
    };
    let drawn_on = drawn_on.ok_or_else(|| FollowError::NoFrame { folder: folder.into(), frame: frame.unwrap_or(0) })?;
    let (mesh, frame) = (read_mesh_file(&drawn_on.mesh)?, drawn_on.frame);
    let locator = TetLocator::new(&mesh.tetrahedra, &mesh.points);
    let mut warnings = Vec::new();
    let mut places: Vec<(Location, Vector3<f64>)> = Vec::with_capacity(points.len());
    for (point, at_mm) in &points {
        let found = locator.locate(at_mm).filter(|place| place.distance_mm <= FARTHEST_MM);
        let Some(place) = found else {
            let distance_mm = locator.locate(at_mm).map_or(f64::INFINITY, |place| place.distance_mm);
            return Err(FollowError::FarAway { point: point.clone(), distance_mm, frame });
        };
        if place.distance_mm > 0.0 {
            warnings
                .push(format!("{point} lies {:.1} mm outside the wall and keeps its offset to the nearest place of it", place.distance_mm));
        }
        let offset_mm = at_mm - in_tetrahedron(&place, &mesh.tetrahedra, &mesh.points);
        places.push((place, offset_mm));
    }
    let (tetrahedra, vertex_count) = (mesh.tetrahedra, mesh.points.len());
    let mut paths = vec![Vec::with_capacity(series.len()); points.len()];
    for instant in &series {
        let position_mm = read_mesh_file(&instant.mesh)?.points;
        if position_mm.len() != vertex_count {
            let reason = format!("it has {} vertices where the first frame has {vertex_count}", position_mm.len());
            return Err(FollowError::Unreadable { file: instant.mesh.clone(), reason });
        }
        for (((point, _), (place, offset_mm)), path) in points.iter().zip(&places).zip(&mut paths) {
            let [[x_mm, y_mm, z_mm]] = (in_tetrahedron(place, &tetrahedra, &position_mm) + offset_mm).data.0;
            path.push(PathRow { point: point.clone(), frame: instant.frame, time_s: instant.time_s, x_mm, y_mm, z_mm });
        }
    }
    let paths: Vec<PathRow> = paths.into_iter().flatten().collect();
    write_csv(&folder.join("paths.csv"), &paths)?;
    Ok(Followed { paths, warnings })
}

fn in_tetrahedron(place: &Location, tetrahedra: &[[usize; 4]], position_mm: &[Vector3<f64>]) -> Vector3<f64> {
    let corners = tetrahedra[place.tetrahedron];
    corners.iter().zip(place.weights).map(|(&vertex, weight)| position_mm[vertex] * weight).sum()
}

/// Names and positions of a list of points.
fn read_points(file: &Path) -> Result<Vec<(String, Vector3<f64>)>, FollowError> {
    let text = read(file)?;
    let refuse = |line: usize, reason: &str| FollowError::NotPoints { file: file.into(), line: line + 1, reason: reason.into() };
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let header = lines.next().ok_or_else(|| refuse(0, "the file is empty"))?;
    let names: Vec<&str> = header.1.split(',').map(|name| name.trim().trim_matches('"')).collect();
    let column = |name: &str| names.iter().position(|n| *n == name).ok_or_else(|| refuse(header.0, &format!("no column `{name}`")));
    let (point, axes) = (column("point")?, [column("x_mm")?, column("y_mm")?, column("z_mm")?]);
    let read_line = |(number, line): (usize, &str)| {
        let cells: Vec<&str> = line.split(',').map(|cell| cell.trim().trim_matches('"')).collect();
        if cells.len() != names.len() {
            return Err(refuse(number, &format!("{} cells under {} columns", cells.len(), names.len())));
        }
        let number_in = |column: usize| cells[column].parse().ok().filter(|x: &f64| x.is_finite());
        match axes.map(number_in) {
            [Some(x), Some(y), Some(z)] => Ok((cells[point].to_string(), Vector3::new(x, y, z))),
            _ => Err(refuse(number, "a coordinate is no number")),
        }
    };
    let points = lines.map(read_line).collect::<Result<Vec<_>, _>>()?;
    if points.is_empty() { Err(refuse(header.0, "there is no point")) } else { Ok(points) }
}

/// A mesh that a run left.
struct Instant {
    /// Frame of the cine.
    frame: usize,
    time_s: f64,
    mesh: PathBuf,
}

/// The meshes that a run left, as its `.pvd` lists them, with the frames of `frames.csv`.
fn read_series(folder: &Path) -> Result<Vec<Instant>, FollowError> {
    let names = ["tracked.pvd", "heart.pvd"];
    let file = names.iter().map(|name| folder.join(name)).find(|file| file.is_file());
    let file = file.ok_or_else(|| FollowError::NoSeries { folder: folder.into() })?;
    let text = read(&file)?;
    let entry = |line: &str| {
        let attribute = |name: &str| Some(line.split_once(&format!(" {name}=\""))?.1.split_once('"')?.0.to_string());
        let name = attribute("file")?.replace("&lt;", "<").replace("&quot;", "\"").replace("&amp;", "&");
        Some((attribute("timestep")?.parse().ok()?, folder.join(name)))
    };
    let entries: Option<Vec<(f64, PathBuf)>> = text.lines().filter(|line| line.contains("<DataSet ")).map(entry).collect();
    let entries = entries.ok_or_else(|| FollowError::Unreadable { file, reason: "an entry has no time or no file".into() })?;
    let frames = read_frames(&folder.join("frames.csv"), entries.len())?;
    Ok(entries.into_iter().zip(frames).map(|((time_s, mesh), frame)| Instant { frame, time_s, mesh }).collect())
}

/// The first column of `frames.csv`, which a run writes beside its meshes.
fn read_frames(file: &Path, count: usize) -> Result<Vec<usize>, FollowError> {
    let text = read(file)?;
    let frames: Option<Vec<usize>> = text.lines().skip(1).map(|line| line.split(',').next()?.parse().ok()).collect();
    frames.filter(|frames| frames.len() == count).ok_or_else(|| {
        let reason = format!("its first column is not the frames of the {count} meshes");
        FollowError::Unreadable { file: file.into(), reason }
    })
}

fn read(file: &Path) -> Result<String, FollowError> {
    std::fs::read_to_string(file).map_err(|error| FollowError::Unreadable { file: file.into(), reason: error.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::mesh::io::write_vtu;

    /// The motion of frame n: an affine map, which linear tetrahedra follow exactly.
    fn moved(p: &Vector3<f64>, n: usize) -> Vector3<f64> {
        let s = n as f64;
        Vector3::new(p.x * (1.0 + 0.05 * s) + 0.1 * s * p.y + 2.0 * s, p.y * (1.0 - 0.03 * s), p.z - 0.2 * s * p.x + s)
    }

    /// A run of three frames of a tetrahedron with edges of 30 mm, started from frame 4 of the cine.
    fn run() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let corners = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0], [0.0, 0.0, 30.0]].map(Vector3::from).to_vec();
        let mesh = TetMesh::new(corners.clone(), vec![[0, 1, 2, 3]]).unwrap();
        std::fs::create_dir(folder.path().join("heart")).unwrap();
        let mut listed = Vec::new();
        for n in 0..3 {
            let name = format!("heart/{n:03}.vtu");
            let position_mm: Vec<_> = corners.iter().map(|p| moved(p, n)).collect();
            write_vtu(&folder.path().join(&name), &mesh, &position_mm, &[], &[]).unwrap();
            listed.push((0.1 * n as f64, name));
        }
        crate::report::write_pvd(&folder.path().join("heart.pvd"), &listed).unwrap();
        std::fs::write(folder.path().join("frames.csv"), "frame,time_s\n4,0\n5,0.1\n0,0.2\n").unwrap();
        folder
    }

    fn followed(folder: &Path, points: &str, frame: Option<usize>) -> Result<Followed, FollowError> {
        let file = folder.join("points.csv");
        std::fs::write(&file, points).unwrap();
        follow(folder, &file, frame)
    }

    #[test]
    fn points_of_the_wall_move_with_an_affine_motion_exactly() {
        let folder = run();
        let start = Vector3::new(5.0, 7.0, 9.0);
        let later = moved(&start, 1);
        for (frame, at) in [(None, start), (Some(5), later)] {
            let points = format!("point,x_mm,y_mm,z_mm\n\"tag 1\",{},{},{}\n", at.x, at.y, at.z);
            let Followed { paths, warnings } = followed(folder.path(), &points, frame).unwrap();
            assert!(warnings.is_empty(), "{warnings:?}");
            assert_eq!(paths.iter().map(|row| row.frame).collect::<Vec<_>>(), [4, 5, 0]);
            for (n, row) in paths.iter().enumerate() {
                assert_eq!((row.point.as_str(), row.time_s), ("tag 1", 0.1 * n as f64));
                assert!((Vector3::new(row.x_mm, row.y_mm, row.z_mm) - moved(&start, n)).norm() < 1e-9);
            }
            assert!(folder.path().join("paths.csv").is_file());
        }
    }

    #[test]
    fn a_point_outside_keeps_its_offset_and_is_named_and_one_far_away_is_refused() {
        let folder = run();
        let Followed { paths, warnings } = followed(folder.path(), "point,x_mm,y_mm,z_mm\napex,-3,0,0\n", None).unwrap();
        assert!(warnings.len() == 1 && warnings[0].starts_with("apex lies 3.0 mm outside"), "{warnings:?}");
        assert!((paths[2].x_mm - (moved(&Vector3::zeros(), 2).x - 3.0)).abs() < 1e-9);
        let error = followed(folder.path(), "point,x_mm,y_mm,z_mm\nlost,-300,0,0\n", None).unwrap_err();
        assert!(matches!(error, FollowError::FarAway { distance_mm, .. } if (distance_mm - 300.0).abs() < 1e-9), "{error}");
    }

    #[test]
    fn what_is_no_list_of_points_or_no_run_is_refused_with_its_place() {
        let folder = run();
        for (points, line) in
            [("", 1), ("point,x_mm,y_mm\n", 1), ("point,x_mm,y_mm,z_mm\na,1,2\n", 2), ("point,x_mm,y_mm,z_mm\na,1,2,nan\n", 2)]
        {
            let error = followed(folder.path(), points, None).unwrap_err();
            assert!(matches!(error, FollowError::NotPoints { line: found, .. } if found == line), "{error}");
        }
        let points = "point,x_mm,y_mm,z_mm\na,1,2,3\n";
        assert!(matches!(followed(folder.path(), points, Some(9)).unwrap_err(), FollowError::NoFrame { frame: 9, .. }));
        let empty = tempfile::tempdir().unwrap();
        assert!(matches!(followed(empty.path(), points, None).unwrap_err(), FollowError::NoSeries { .. }));
    }
}
