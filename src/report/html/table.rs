//! Tables of the page, from the same rows that are written as CSV.

use std::fmt::Write;

use serde::Serialize;

use super::escape::escaped;
use super::heading::heading;
use super::number::readable;

/// A table.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// What it shows.
    pub caption: String,
    /// Headings.
    pub columns: Vec<String>,
    /// Cells by row; numbers are set to the right.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// The rows under the names of their fields in words, numbers readable; columns that are empty in every row are left out.
    pub fn of_rows<R: Serialize>(caption: impl Into<String>, rows: &[R]) -> Self {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let is_written = rows.iter().all(|row| writer.serialize(row).is_ok());
        let bytes = if is_written { writer.into_inner().unwrap_or_default() } else { Vec::new() };
        let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(bytes.as_slice());
        let mut records = reader.records().filter_map(Result::ok);
        let columns: Vec<String> = records.next().iter().flatten().map(heading).collect();
        let rows = records.map(|record| record.iter().map(cell).collect()).collect();
        Self { caption: caption.into(), columns, rows }.without_empty_columns()
    }

    /// The values of a record by name, those of inner records as `outer.inner`; what is empty is left out.
    pub fn of_record<R: Serialize>(caption: impl Into<String>, record: &R) -> Self {
        let mut rows = Vec::new();
        if let Ok(value) = serde_json::to_value(record) {
            flatten(String::new(), &value, &mut rows);
        }
        Self { caption: caption.into(), columns: ["name", "value"].map(str::to_owned).to_vec(), rows }
    }

    fn without_empty_columns(self) -> Self {
        let kept: Vec<usize> =
            (0..self.columns.len()).filter(|&n| self.rows.iter().any(|row| row.get(n).is_some_and(|cell| !cell.is_empty()))).collect();
        let pick = |cells: &Vec<String>| kept.iter().filter_map(|&n| cells.get(n).cloned()).collect();
        Self { caption: self.caption, columns: pick(&self.columns), rows: self.rows.iter().map(pick).collect() }
    }

    /// Writes the table as HTML.
    pub(super) fn html(&self) -> String {
        let mut html = format!(
            "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{0}\"><table><caption>{0}</caption><thead><tr>",
            escaped(&self.caption)
        );
        for column in &self.columns {
            let _ = write!(html, "<th scope=\"col\">{}</th>", escaped(&breakable(column)));
        }
        html.push_str("</tr></thead><tbody>");
        for row in &self.rows {
            html.push_str("<tr>");
            for cell in row {
                let class = if is_number(cell) { " class=\"number\"" } else { "" };
                let _ = write!(html, "<td{class}>{}</td>", escaped(&breakable(cell)));
            }
            html.push_str("</tr>");
        }
        html.push_str("</tbody></table></div>");
        html
    }
}

/// Adds the rows of a value under its name.
fn flatten(name: String, value: &serde_json::Value, rows: &mut Vec<Vec<String>>) {
    use serde_json::Value;
    let below = |key: &str| if name.is_empty() { key.to_owned() } else { format!("{name}.{key}") };
    match value {
        Value::Null => {}
        Value::Object(inner) => inner.iter().for_each(|(key, value)| flatten(below(key), value, rows)),
        Value::Array(inner) => (1..).zip(inner).for_each(|(n, value)| flatten(below(&n.to_string()), value, rows)),
        Value::String(text) => rows.push(vec![name, text.clone()]),
        Value::Number(number) => rows.push(vec![name, cell(&number.to_string())]),
        Value::Bool(flag) => rows.push(vec![name, flag.to_string()]),
    }
}

/// Numbers readable, all else as it is.
fn cell(field: &str) -> String {
    match field.parse::<f64>() {
        Ok(value) if field.contains(['.', 'e', 'E']) => readable(value),
        _ => field.to_owned(),
    }
}

fn is_number(cell: &str) -> bool {
    cell.starts_with(|c: char| c.is_ascii_digit() || c == '−' || c == '-' || c == '–') && !cell.contains(|c: char| c.is_alphabetic())
}

/// Names of many words may break behind their underscores.
fn breakable(text: &str) -> String {
    text.replace('_', "_\u{200b}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Row {
        name: &'static str,
        value: f64,
        empty: Option<f64>,
    }

    #[test]
    fn rows_become_cells_and_empty_columns_go() {
        let rows = [Row { name: "a<b", value: 0.123_456, empty: None }, Row { name: "c", value: 2.0, empty: None }];
        let table = Table::of_rows("two rows", &rows);
        assert_eq!(table.columns, ["Name", "Value"]);
        assert_eq!(table.rows, [["a<b", "0.1235"], ["c", "2"]]);
        let record = Table::of_record("one", &rows[0]);
        assert_eq!(record.rows, [["name", "a<b"], ["value", "0.1235"]]);
        let html = table.html();
        assert!(html.contains("<td>a&lt;b</td><td class=\"number\">0.1235</td>") && html.contains("<caption>two rows</caption>"));
    }
}
