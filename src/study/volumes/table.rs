//! Volume curves from a CSV file with the columns `time_s` and `volume_lv_ml`, and where known `volume_rv_ml`, as results have them; other columns are
//! left out.

use std::path::Path;

use crate::image::ImageError;

/// What a table holds.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    /// Times, s.
    pub(super) times_s: Vec<f64>,
    /// Volumes of the left ventricle, mL.
    pub(super) left_ml: Vec<f64>,
    /// Volumes of the right ventricle, mL; none without that column, or where all its cells are empty.
    pub(super) right_ml: Option<Vec<f64>>,
}

pub(super) fn read(path: &Path) -> Result<Columns, ImageError> {
    let text = std::fs::read_to_string(path).map_err(|error| ImageError::Unreadable { path: path.into(), reason: error.to_string() })?;
    parse(&text).map_err(|reason| ImageError::Unusable { path: path.into(), reason })
}

fn parse(text: &str) -> Result<Columns, String> {
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (_, head) = lines.next().ok_or("it is empty")?;
    let names: Vec<&str> = head.split(',').map(str::trim).collect();
    let place = |name: &str| names.iter().position(|found| *found == name);
    let needed = |name: &str| place(name).ok_or_else(|| format!("it has no column `{name}` among {names:?}"));
    let rows: Vec<(usize, Vec<&str>)> = lines.map(|(number, line)| (number + 1, line.split(',').map(str::trim).collect())).collect();
    let cell = |row: &[&str], column: usize| row.get(column).map_or(String::new(), ToString::to_string);
    let numbers = |column: usize| {
        let value = |(number, row): &(usize, Vec<&str>)| {
            let cell = cell(row, column);
            cell.parse::<f64>().map_err(|_| format!("line {number}: `{cell}` in column `{}` is no number", names[column]))
        };
        rows.iter().map(value).collect::<Result<Vec<f64>, String>>()
    };
    let right = place("volume_rv_ml").filter(|&column| rows.iter().any(|(_, row)| !cell(row, column).is_empty()));
    Ok(Columns {
        times_s: numbers(needed("time_s")?)?,
        left_ml: numbers(needed("volume_lv_ml")?)?,
        right_ml: right.map(numbers).transpose()?,
    })
}

#[cfg(test)]
mod tests {
    use super::{Columns, parse};

    #[test]
    fn columns_are_found_by_name_and_bad_cells_by_line() {
        let found = parse("frame, time_s,volume_lv_ml\n0,0.1, 80\n\n1,0.2,70.5\n").unwrap();
        assert_eq!(found, Columns { times_s: vec![0.1, 0.2], left_ml: vec![80.0, 70.5], right_ml: None });
        assert_eq!(parse("time_s,volume_rv_ml,volume_lv_ml\n0.1,9,8\n").unwrap().right_ml, Some(vec![9.0]));
        assert_eq!(parse("time_s,volume_lv_ml,volume_rv_ml\n0.1,9,\n").unwrap().right_ml, None);
        assert!(parse("").unwrap_err().contains("empty"));
        assert!(parse("time_s,volume\n").unwrap_err().contains("volume_lv_ml"));
        assert!(parse("time_s,volume_lv_ml\n0.1\n").unwrap_err().contains("line 2"));
        assert!(parse("time_s,volume_lv_ml\n0.1,1\n0.2,many\n").unwrap_err().contains("line 3: `many`"));
    }
}
