//! Reads legacy VTK files of unstructured grids, in text or binary.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::encoding::NumberKind;
use super::legacy_vtk_writer::BLANK;
use super::mesh_file::{CellSorter, FieldArray, MeshFile};

/// The content of a legacy VTK file, versions 1 to 5.1.
pub(super) fn read_legacy_vtk(bytes: &[u8]) -> Result<MeshFile, String> {
    let mut text = Scanner { bytes, at: 0, is_binary: false };
    if !text.line()?.starts_with("# vtk DataFile") {
        return Err("it does not begin with '# vtk DataFile'".into());
    }
    text.line()?;
    text.is_binary = match text.line()?.trim() {
        "ASCII" => false,
        "BINARY" => true,
        other => return Err(format!("its third line is {other:?}, not ASCII or BINARY")),
    };
    let mut content = Content::default();
    while let Some(keyword) = text.next_word() {
        content.read_section(keyword, &mut text)?;
    }
    content.finish()
}

/// A place in the file, and how its numbers are written.
struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
    is_binary: bool,
}

impl<'a> Scanner<'a> {
    /// The rest of the line.
    fn line(&mut self) -> Result<&'a str, String> {
        let rest = &self.bytes[self.at..];
        if rest.is_empty() {
            return Err("it ends too early".into());
        }
        let length = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at += (length + 1).min(rest.len());
        std::str::from_utf8(&rest[..length]).map(str::trim_end).map_err(|_| "a line of text holds other bytes".into())
    }

    fn next_word(&mut self) -> Option<&'a str> {
        let rest = &self.bytes[self.at..];
        let start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let length = rest[start..].iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len() - start);
        self.at += start + length;
        std::str::from_utf8(&rest[start..start + length]).ok()
    }

    fn word(&mut self, what: &str) -> Result<&'a str, String> {
        self.next_word().ok_or_else(|| format!("it ends where {what} should be"))
    }

    fn count(&mut self, what: &str) -> Result<usize, String> {
        let word = self.word(what)?;
        word.parse().map_err(|_| format!("{what} is {word:?}, not a number"))
    }

    /// `count` numbers of a type, from the next line on if they are binary.
    fn numbers(&mut self, kind_name: &str, count: usize) -> Result<Vec<f64>, String> {
        let kind = NumberKind::legacy(kind_name).ok_or_else(|| format!("numbers of type {kind_name:?} are not supported"))?;
        if self.is_binary {
            self.line()?;
            let end = count.checked_mul(kind.size()).and_then(|length| length.checked_add(self.at));
            let bytes = end.and_then(|end| self.bytes.get(self.at..end)).ok_or("its binary data end too early; is it truncated?")?;
            self.at += bytes.len();
            return Ok(kind.numbers(bytes, true));
        }
        let mut numbers = vec![];
        for _ in 0..count {
            let word = self.word("a number")?;
            numbers.push(word.parse().map_err(|_| format!("{word:?} is not a number"))?);
        }
        Ok(numbers)
    }
}

#[derive(Default)]
struct Content {
    points: Vec<Vector3<f64>>,
    cells: Vec<Vec<usize>>,
    types: Vec<i64>,
    /// Fields of points, fields of cells.
    fields: [BTreeMap<String, FieldArray>; 2],
    /// What the attributes that follow belong to: 0 points, 1 cells, and how many there are.
    subject: (usize, usize),
}

impl Content {
    fn read_section(&mut self, keyword: &str, text: &mut Scanner) -> Result<(), String> {
        match keyword.to_ascii_uppercase().as_str() {
            "DATASET" => match text.word("the kind of data")? {
                "UNSTRUCTURED_GRID" => {}
                other => return Err(format!("it holds a {other}, not an UNSTRUCTURED_GRID")),
            },
            "POINTS" => {
                let count = text.count("the number of points")?;
                let kind = text.word("the type of the points")?;
                let numbers = text.numbers(kind, count.saturating_mul(3))?;
                self.points = numbers.chunks_exact(3).map(|p| Vector3::new(p[0], p[1], p[2])).collect();
            }
            "CELLS" => self.read_cells(text)?,
            "CELL_TYPES" => {
                let count = text.count("the number of cell types")?;
                self.types = text.numbers("int", count)?.into_iter().map(|kind| kind as i64).collect();
            }
            "POINT_DATA" => self.subject = (0, text.count("the number of points")?),
            "CELL_DATA" => self.subject = (1, text.count("the number of cells")?),
            "SCALARS" => self.read_scalars(text)?,
            "VECTORS" | "NORMALS" => self.read_attribute(text, 3)?,
            "TENSORS" => self.read_attribute(text, 9)?,
            "COLOR_SCALARS" => {
                let name = text.word("a name")?.to_string();
                let components = text.count("a number of components")?;
                let kind = if text.is_binary { "unsigned_char" } else { "float" };
                self.keep(name, components, text, kind)?;
            }
            "TEXTURE_COORDINATES" => {
                let name = text.word("a name")?.to_string();
                let components = text.count("a number of components")?;
                let kind = text.word("a type")?;
                self.keep(name, components, text, kind)?;
            }
            "LOOKUP_TABLE" => {
                text.word("a name")?;
                let size = text.count("the size of a lookup table")?;
                text.numbers(if text.is_binary { "unsigned_char" } else { "float" }, size.saturating_mul(4))?;
            }
            "FIELD" => self.read_field(text)?,
            "METADATA" => {
                text.line()?;
                while text.at < text.bytes.len() && !text.line()?.is_empty() {}
            }
            other => return Err(format!("keyword {other:?} is unknown")),
        }
        Ok(())
    }

    /// The old list (corner count, corners, …) or, since version 5, offsets and connectivity.
    fn read_cells(&mut self, text: &mut Scanner) -> Result<(), String> {
        let count = text.count("the number of cells")?;
        let size = text.count("the size of the cell list")?;
        let as_index = |&number: &f64| if number >= 0.0 { Ok(number as usize) } else { Err("a cell has a negative number".to_string()) };
        let before = text.at;
        if text.next_word() == Some("OFFSETS") {
            let kind = text.word("the type of the offsets")?;
            let offsets = text.numbers(kind, count)?;
            if text.next_word() != Some("CONNECTIVITY") {
                return Err("CONNECTIVITY is missing".into());
            }
            let kind = text.word("the type of the connectivity")?;
            let corners = text.numbers(kind, size)?.iter().map(as_index).collect::<Result<Vec<usize>, String>>()?;
            for ends in offsets.windows(2) {
                let cell = corners.get(ends[0] as usize..ends[1] as usize).ok_or("the offsets of the cells do not ascend")?;
                self.cells.push(cell.to_vec());
            }
            return Ok(());
        }
        text.at = before;
        let list = text.numbers("int", size)?.iter().map(as_index).collect::<Result<Vec<usize>, String>>()?;
        let mut rest = &list[..];
        while let Some((&corner_count, after)) = rest.split_first() {
            let (cell, remaining) = after.split_at_checked(corner_count).ok_or("the list of cells is cut off")?;
            self.cells.push(cell.to_vec());
            rest = remaining;
        }
        if self.cells.len() == count { Ok(()) } else { Err(format!("{} cells are listed where {count} are announced", self.cells.len())) }
    }

    fn read_scalars(&mut self, text: &mut Scanner) -> Result<(), String> {
        let name = text.word("a name")?.to_string();
        let kind = text.word("a type")?;
        let rest_of_line = text.line()?.trim();
        let components =
            if rest_of_line.is_empty() { 1 } else { rest_of_line.parse().map_err(|_| "a number of components is senseless")? };
        if text.next_word() != Some("LOOKUP_TABLE") {
            return Err(format!("scalars {name} have no LOOKUP_TABLE line"));
        }
        text.word("a name")?;
        self.keep(name, components, text, kind)
    }

    fn read_attribute(&mut self, text: &mut Scanner, components: usize) -> Result<(), String> {
        let name = text.word("a name")?.to_string();
        let kind = text.word("a type")?;
        self.keep(name, components, text, kind)
    }

    fn keep(&mut self, name: String, components: usize, text: &mut Scanner, kind: &str) -> Result<(), String> {
        let (subject, entries) = self.subject;
        let values = text.numbers(kind, entries.saturating_mul(components))?;
        self.fields[subject].insert(name.replace(BLANK, " "), FieldArray { components, values });
        Ok(())
    }

    fn read_field(&mut self, text: &mut Scanner) -> Result<(), String> {
        text.word("a name")?;
        let array_count = text.count("the number of arrays")?;
        for _ in 0..array_count {
            let mut name = text.word("the name of an array")?;
            if name == "METADATA" {
                while text.at < text.bytes.len() && !text.line()?.is_empty() {}
                name = text.word("the name of an array")?;
            }
            let components = text.count("a number of components")?;
            let entries = text.count("a number of entries")?;
            let kind = text.word("a type")?;
            if kind == "string" {
                return Err(format!("array {name} holds words; write the mesh without it"));
            }
            let values = text.numbers(kind, entries.saturating_mul(components))?;
            if entries == self.subject.1 {
                self.fields[self.subject.0].insert(name.replace(BLANK, " "), FieldArray { components, values });
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<MeshFile, String> {
        if self.types.len() != self.cells.len() {
            return Err(format!("it has {} cells but {} cell types", self.cells.len(), self.types.len()));
        }
        let mut sorter = CellSorter::default();
        for (cell, &kind) in self.cells.iter().zip(&self.types) {
            sorter.add(kind, cell)?;
        }
        let [point_fields, cell_fields] = self.fields;
        for (fields, entries) in [(&point_fields, self.points.len()), (&cell_fields, self.cells.len())] {
            if let Some((name, field)) = fields.iter().find(|(_, field)| field.values.len() != entries * field.components) {
                return Err(format!("field {name} has {} numbers, not {entries} entries of {}", field.values.len(), field.components));
            }
        }
        Ok(sorter.finish(self.points, point_fields, &cell_fields))
    }
}
