//! Reads Gmsh meshes (.msh), versions 2.2 and 4.1, text and binary; physical groups become the cell field `physical`, node and element data
//! fields.

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector3;

use super::gmsh_numbers::{Encoding, Numbers, text_of};
use super::mesh_file::{CellSorter, FieldArray, MeshFile};

/// The content of a .msh file.
pub(super) fn read_gmsh(bytes: &[u8]) -> Result<MeshFile, String> {
    let (version, encoding) = read_format(bytes)?;
    let mut content = Content::default();
    let mut rest = bytes;
    while let Some(start) = find(rest, b"$") {
        let after = &rest[start + 1..];
        let line_end = find(after, b"\n").ok_or("it ends within a section's name")?;
        let (name, after) = (String::from_utf8_lossy(&after[..line_end]).trim().to_string(), &after[line_end + 1..]);
        let end_mark = format!("$End{name}");
        let end = find(after, end_mark.as_bytes()).ok_or_else(|| format!("section ${name} does not end; is it truncated?"))?;
        let section = &after[..end];
        let numbers = || Numbers::new(section, encoding, &name);
        match (name.as_str(), version) {
            ("Nodes", Version::Four) => content.read_nodes_4(&mut numbers()?)?,
            ("Nodes", Version::Two) => content.read_nodes_2(&mut numbers()?)?,
            ("Elements", Version::Four) => content.read_elements_4(&mut numbers()?)?,
            ("Elements", Version::Two) => content.read_elements_2(&mut numbers()?)?,
            ("Entities", Version::Four) => content.read_entities(&mut numbers()?)?,
            ("NodeData", _) => content.node_data.push(read_data(section, encoding, &name)?),
            ("ElementData", _) => content.element_data.push(read_data(section, encoding, &name)?),
            _ => {}
        }
        rest = &after[end + end_mark.len()..];
    }
    content.finish()
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Version {
    Two,
    Four,
}

/// The first section: version, 0 for text or 1 for binary, and the bytes of a `size_t`; in binary files then the number one.
fn read_format(bytes: &[u8]) -> Result<(Version, Encoding), String> {
    let mut lines = bytes.splitn(3, |&byte| byte == b'\n');
    if lines.next().map(<[u8]>::trim_ascii) != Some(b"$MeshFormat") {
        return Err("it does not begin with $MeshFormat".into());
    }
    let words: Vec<&str> = text_of(lines.next().unwrap_or_default(), "MeshFormat")?.split_ascii_whitespace().collect();
    let version = match words.first() {
        Some(&("2.2" | "2.1" | "2" | "2.0")) => Version::Two,
        Some(&"4.1") => Version::Four,
        other => return Err(format!("its version {} is not supported; save it as version 4.1 or 2.2", other.unwrap_or(&"is missing:"))),
    };
    let encoding = match (words.get(1), words.get(2), lines.next().unwrap_or_default()) {
        (Some(&"0"), _, _) => Encoding::Text,
        (Some(&"1"), Some(&"8"), [1, 0, 0, 0, ..]) => Encoding::Binary { is_big_endian: false },
        (Some(&"1"), Some(&"8"), [0, 0, 0, 1, ..]) => Encoding::Binary { is_big_endian: true },
        _ => return Err("it is a binary .msh of a kind that is not supported; save it as text (ASCII) or as VTU".into()),
    };
    Ok((version, encoding))
}

fn find(bytes: &[u8], mark: &[u8]) -> Option<usize> {
    bytes.windows(mark.len()).position(|window| window == mark)
}

#[derive(Default)]
struct Content {
    points: Vec<Vector3<f64>>,
    point_of_node: HashMap<u64, usize>,
    /// First physical group of each entity, by dimension and number.
    group_of_entity: HashMap<(u64, i64), i64>,
    elements: Vec<Element>,
    node_data: Vec<Data>,
    element_data: Vec<Data>,
}

struct Element {
    number: u64,
    kind: u64,
    group: i64,
    nodes: Vec<u64>,
}

/// A field: values of nodes or elements by their numbers.
struct Data {
    name: String,
    components: usize,
    rows: Vec<(u64, Vec<f64>)>,
}

impl Data {
    /// One entry for each of `count` things, zero where the file has none.
    fn field(&self, count: usize, place_of: &HashMap<u64, usize>) -> FieldArray {
        let mut values = vec![0.0; count * self.components];
        for (number, row) in &self.rows {
            if let Some(place) = place_of.get(number) {
                values[place * self.components..][..self.components].copy_from_slice(row);
            }
        }
        FieldArray { components: self.components, values }
    }
}

/// A section of node or element data: its words (the first is the name), real numbers (times), integers (step, components, rows), each on
/// a line of text, then the rows.
fn read_data(section: &[u8], encoding: Encoding, name: &str) -> Result<Data, String> {
    let mut rest = section.trim_ascii_start();
    let mut line = || -> Result<String, String> {
        let end = find(rest, b"\n").ok_or_else(|| format!("section ${name} ends too early"))?;
        let line = String::from_utf8_lossy(&rest[..end]).trim().trim_matches('"').to_string();
        rest = &rest[end + 1..];
        Ok(line)
    };
    let mut lines_counted = |what: &str| -> Result<Vec<String>, String> {
        let count: usize = line()?.parse().map_err(|_| format!("section ${name} does not say how many {what} it has"))?;
        (0..count).map(|_| line()).collect()
    };
    let (names, _, integers) = (lines_counted("names")?, lines_counted("times")?, lines_counted("integers")?);
    let [field_name] = names.as_slice() else { return Err(format!("section ${name} does not have one name")) };
    let integer = |place: usize| integers.get(place).and_then(|word| word.parse::<usize>().ok());
    let (Some(components), Some(row_count)) = (integer(1), integer(2)) else {
        return Err(format!("section ${name} does not say how many components and rows it has"));
    };
    if !(1..=9).contains(&components) {
        return Err(format!("section ${name} has {components} components"));
    }
    let mut numbers = Numbers::new(rest, encoding, name)?;
    let mut rows = vec![];
    for _ in 0..row_count {
        let number = numbers.count()?;
        let mut row = vec![];
        for _ in 0..components {
            row.push(numbers.real()?);
        }
        rows.push((number, row));
    }
    Ok(Data { name: field_name.clone(), components, rows })
}

/// Nodes of Gmsh's element types that may occur, and their VTK type.
fn element_kind(kind: u64) -> Result<(usize, i64), String> {
    match kind {
        1 => Ok((2, 3)),
        2 => Ok((3, 5)),
        4 => Ok((4, 10)),
        15 => Ok((1, 1)),
        _ => Err(format!("elements of Gmsh type {kind} are not supported; linear tetrahedra are needed")),
    }
}

/// Reads `count` numbers over.
fn repeat<T>(count: u64, mut next: impl FnMut() -> Result<T, String>) -> Result<(), String> {
    (0..count).try_for_each(|_| next().map(|_| ()))
}

impl Content {
    fn add_node(&mut self, node: u64, numbers: &mut Numbers) -> Result<(), String> {
        let position = Vector3::new(numbers.real()?, numbers.real()?, numbers.real()?);
        self.point_of_node.insert(node, self.points.len());
        self.points.push(position);
        Ok(())
    }

    fn read_nodes_2(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        for _ in 0..numbers.line()? {
            let node = numbers.count()?;
            self.add_node(node, numbers)?;
        }
        Ok(())
    }

    fn read_nodes_4(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        let block_count = numbers.size()?;
        repeat(3, || numbers.size())?;
        for _ in 0..block_count {
            let (dimension, _, is_parametric) = (numbers.count()?, numbers.integer()?, numbers.integer()?);
            let node_count = numbers.size()?;
            let mut nodes = vec![];
            for _ in 0..node_count {
                nodes.push(numbers.size()?);
            }
            for node in nodes {
                self.add_node(node, numbers)?;
                repeat(if is_parametric == 1 { dimension } else { 0 }, || numbers.real())?;
            }
        }
        Ok(())
    }

    /// In text every element stands with its kind and its tags; in binary, runs of elements of a kind share them.
    fn read_elements_2(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        let element_count = numbers.line()?;
        let mut read_count = 0;
        while read_count < element_count {
            let mut number = if numbers.is_binary() { 0 } else { numbers.count()? };
            let kind = numbers.count()?;
            let run_length = if numbers.is_binary() { numbers.count()? } else { 1 };
            let tag_count = numbers.count()?;
            for _ in 0..run_length {
                if numbers.is_binary() {
                    number = numbers.count()?;
                }
                let group = if tag_count > 0 { numbers.integer()? } else { 0 };
                repeat(tag_count.saturating_sub(1), || numbers.integer())?;
                self.add_element(number, kind, group, || numbers.count())?;
            }
            read_count += run_length;
        }
        Ok(())
    }

    fn read_elements_4(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        let block_count = numbers.size()?;
        repeat(3, || numbers.size())?;
        for _ in 0..block_count {
            let (dimension, entity, kind) = (numbers.count()?, numbers.integer()?, numbers.count()?);
            let element_count = numbers.size()?;
            let group = self.group_of_entity.get(&(dimension, entity)).copied().unwrap_or(0);
            for _ in 0..element_count {
                let number = numbers.size()?;
                self.add_element(number, kind, group, || numbers.size())?;
            }
        }
        Ok(())
    }

    fn add_element(&mut self, number: u64, kind: u64, group: i64, node: impl FnMut() -> Result<u64, String>) -> Result<(), String> {
        let nodes = std::iter::repeat_with(node).take(element_kind(kind)?.0).collect::<Result<Vec<u64>, String>>()?;
        self.elements.push(Element { number, kind, group, nodes });
        Ok(())
    }

    fn read_entities(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        let counts = [numbers.size()?, numbers.size()?, numbers.size()?, numbers.size()?];
        for (dimension, count) in (0..).zip(counts) {
            for _ in 0..count {
                let entity = numbers.integer()?;
                repeat(if dimension == 0 { 3 } else { 6 }, || numbers.real())?;
                for number in 0..numbers.size()? {
                    let group = numbers.integer()?;
                    if number == 0 {
                        self.group_of_entity.insert((dimension, entity), group);
                    }
                }
                if dimension > 0 {
                    let boundary_count = numbers.size()?;
                    repeat(boundary_count, || numbers.integer())?;
                }
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<MeshFile, String> {
        let mut sorter = CellSorter::default();
        let mut groups = vec![];
        for Element { kind, group, nodes, .. } in &self.elements {
            let point =
                |node: &u64| self.point_of_node.get(node).copied().ok_or_else(|| format!("an element names node {node}, which is missing"));
            let corners = nodes.iter().map(point).collect::<Result<Vec<usize>, String>>()?;
            sorter.add(element_kind(*kind)?.1, &corners)?;
            groups.push(*group as f64);
        }
        let place_of_element = self.elements.iter().enumerate().map(|(place, element)| (element.number, place)).collect();
        let field = |data: &Data| (data.name.clone(), data.field(self.elements.len(), &place_of_element));
        let mut cell_fields: BTreeMap<String, FieldArray> = self.element_data.iter().map(field).collect();
        cell_fields.insert("physical".into(), FieldArray { components: 1, values: groups });
        let at_points = |data: &Data| (data.name.clone(), data.field(self.points.len(), &self.point_of_node));
        let point_fields = self.node_data.iter().map(at_points).collect();
        Ok(sorter.finish(self.points, point_fields, &cell_fields))
    }
}
