//! A volume curve from a CSV file with the columns `time_s` and `volume_lv_ml`, as results have them; other columns are left out.

use std::path::Path;

use crate::image::ImageError;

/// Times (s) and volumes (mL).
pub(super) fn read(path: &Path) -> Result<(Vec<f64>, Vec<f64>), ImageError> {
    let text = std::fs::read_to_string(path).map_err(|error| ImageError::Unreadable { path: path.into(), reason: error.to_string() })?;
    parse(&text).map_err(|reason| ImageError::Unusable { path: path.into(), reason })
}

fn parse(text: &str) -> Result<(Vec<f64>, Vec<f64>), String> {
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (_, head) = lines.next().ok_or("it is empty")?;
    let names: Vec<&str> = head.split(',').map(str::trim).collect();
    let column =
        |name: &str| names.iter().position(|found| *found == name).ok_or_else(|| format!("it has no column `{name}` among {names:?}"));
    let (time, volume) = (column("time_s")?, column("volume_lv_ml")?);
    let mut found = (Vec::new(), Vec::new());
    for (number, line) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let value = |column: usize| {
            let cell = cells.get(column).copied().unwrap_or_default();
            cell.parse::<f64>().map_err(|_| format!("line {}: `{cell}` in column `{}` is no number", number + 1, names[column]))
        };
        found.0.push(value(time)?);
        found.1.push(value(volume)?);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::parse;

    #[test]
    fn columns_are_found_by_name_and_bad_cells_by_line() {
        assert_eq!(parse("frame, time_s,volume_lv_ml\n0,0.1, 80\n\n1,0.2,70.5\n"), Ok((vec![0.1, 0.2], vec![80.0, 70.5])));
        assert!(parse("").unwrap_err().contains("empty"));
        assert!(parse("time_s,volume\n").unwrap_err().contains("volume_lv_ml"));
        assert!(parse("time_s,volume_lv_ml\n0.1\n").unwrap_err().contains("line 2"));
        assert!(parse("time_s,volume_lv_ml\n0.1,1\n0.2,many\n").unwrap_err().contains("line 3: `many`"));
    }
}
