//! Measurements from CSV files: cavity pressures over time, and depolarisation times at points.

use std::path::Path;

use nalgebra::Vector3;

use super::clock::Clock;
use super::error::RunError;
use crate::anatomy::{Anatomy, Ventricle};

/// Columns of numbers by name.
struct Columns<'p> {
    path: &'p Path,
    names: Vec<String>,
    rows: Vec<Vec<f64>>,
}

impl<'p> Columns<'p> {
    fn read(path: &'p Path) -> Result<Self, RunError> {
        let refuse = |reason: String| RunError::DataTable { path: path.into(), reason };
        let text = std::fs::read_to_string(path).map_err(|error| refuse(error.to_string()))?;
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let (_, head) = lines.next().ok_or_else(|| refuse("it is empty".into()))?;
        let names: Vec<String> = head.split(',').map(|name| name.trim().to_owned()).collect();
        // An empty or wordy cell is no number; only columns that are asked for must have one.
        let row = |(_, line): (usize, &str)| line.split(',').map(|cell| cell.trim().parse().unwrap_or(f64::NAN)).collect();
        Ok(Self { path, names, rows: lines.map(row).collect() })
    }

    /// A column; none if the table has no such one.
    fn find(&self, name: &str) -> Option<Vec<f64>> {
        let place = self.names.iter().position(|found| found == name)?;
        Some(self.rows.iter().map(|row| row.get(place).copied().unwrap_or(f64::NAN)).collect())
    }

    /// A column that must be there, with a number in every row.
    fn needed(&self, name: &str) -> Result<Vec<f64>, RunError> {
        let refuse = |reason: String| RunError::DataTable { path: self.path.into(), reason };
        let column = self.find(name).ok_or_else(|| refuse(format!("it has no column `{name}` among {:?}", self.names)))?;
        match column.iter().position(|value| !value.is_finite()) {
            Some(row) => Err(refuse(format!("row {} of column `{name}` is no number", row + 1))),
            None if column.is_empty() => Err(refuse("it has no rows".into())),
            None => Ok(column),
        }
    }
}

/// A ventricle with its pressures: frame, kPa.
type VentriclePressures = (Ventricle, Vec<(usize, f64)>);

/// Pressures of a ventricle (kPa) at the frames of a clock, linear between the times of the table; frames outside of them have none.
pub(super) fn pressures(path: &Path, clock: &Clock) -> Result<Vec<VentriclePressures>, RunError> {
    let table = Columns::read(path)?;
    let times_s = table.needed("time_s")?;
    if times_s.windows(2).any(|pair| pair[1] <= pair[0]) {
        return Err(RunError::DataTable { path: path.into(), reason: "its times do not ascend".into() });
    }
    let columns = [(Ventricle::Left, "pressure_lv_kpa"), (Ventricle::Right, "pressure_rv_kpa")];
    if columns.iter().all(|(_, name)| table.find(name).is_none()) {
        table.needed("pressure_lv_kpa")?;
    }
    let at_frames = |column: &[f64]| -> Vec<(usize, f64)> {
        let value = |frame_s: f64| {
            let after = times_s.partition_point(|&time_s| time_s < frame_s);
            let (before, after) = (after.checked_sub(1).unwrap_or(after), after.min(times_s.len() - 1));
            if frame_s < times_s[0] || frame_s > times_s[times_s.len() - 1] {
                return f64::NAN;
            }
            let width_s = times_s[after] - times_s[before];
            let share = if width_s > 0.0 { (frame_s - times_s[before]) / width_s } else { 0.0 };
            column[before] + share * (column[after] - column[before])
        };
        let at = clock.times_s.iter().enumerate().map(|(frame, &frame_s)| (frame, value(frame_s)));
        at.filter(|(_, pressure_kpa)| pressure_kpa.is_finite()).collect()
    };
    Ok(columns.into_iter().filter_map(|(ventricle, name)| Some((ventricle, at_frames(&table.find(name)?)))).collect())
}

/// Depolarisation times (s) at the vertices nearest to the points of the table.
pub(super) fn activation_times(path: &Path, anatomy: &Anatomy) -> Result<Vec<(usize, f64)>, RunError> {
    let table = Columns::read(path)?;
    let [x, y, z, times_s] = ["x_mm", "y_mm", "z_mm", "time_s"].map(|name| table.needed(name));
    let (x, y, z, times_s) = (x?, y?, z?, times_s?);
    let nearest = |point_mm: Vector3<f64>| {
        let distance = |vertex: &Vector3<f64>| (vertex - point_mm).norm_squared();
        let vertices = anatomy.mesh.vertices_mm().iter().enumerate();
        vertices.min_by(|a, b| distance(a.1).total_cmp(&distance(b.1))).map_or(0, |(vertex, _)| vertex)
    };
    Ok((0..times_s.len()).map(|row| (nearest(Vector3::new(x[row], y[row], z[row])), times_s[row])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pressures_are_read_at_the_frames_and_bad_tables_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pressures.csv");
        let clock = Clock::new(0, &[0.0, 0.2, 0.4, 0.6], 0.8, 1);
        std::fs::write(&file, "time_s,pressure_lv_kpa\n0.1,2\n0.3,12\n0.5,4\n").unwrap();
        let found = pressures(&file, &clock).unwrap();
        assert_eq!(found.len(), 1);
        let expected = [(1, 7.0), (2, 8.0)];
        assert!(found[0].1.iter().zip(expected).all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < 1e-12) && found[0].1.len() == 2);
        for (text, part) in [("time_s\n0.1\n", "no column `pressure_lv_kpa`"), ("", "empty"), ("time_s,pressure_lv_kpa\nx,2\n", "row 1")] {
            std::fs::write(&file, text).unwrap();
            let words = pressures(&file, &clock).unwrap_err().to_string();
            assert!(words.contains(part), "{words}");
        }
    }
}
