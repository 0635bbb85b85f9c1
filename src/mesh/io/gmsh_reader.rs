//! Reads Gmsh meshes (.msh), versions 2.2 and 4.1 in text; physical groups become the cell field `physical`, node and element data fields.

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector3;

use super::mesh_file::{CellSorter, FieldArray, MeshFile};

/// The content of a .msh file.
pub(super) fn read_gmsh(bytes: &[u8]) -> Result<MeshFile, String> {
    let header = String::from_utf8_lossy(&bytes[..bytes.len().min(200)]).into_owned();
    let mut words = header.split_ascii_whitespace();
    if words.next() != Some("$MeshFormat") {
        return Err("it does not begin with $MeshFormat".into());
    }
    let (version, is_binary) = (words.next().unwrap_or(""), words.next() != Some("0"));
    if is_binary {
        return Err("it is a binary .msh; save it as text (ASCII) or as VTU".into());
    }
    let text = std::str::from_utf8(bytes).map_err(|_| "it holds bytes that are no text".to_string())?;
    let mut content = Content::default();
    let mut rest = text;
    while let Some(start) = rest.find('$') {
        let (name, after) = rest[start + 1..].split_once('\n').ok_or("it ends within a section's name")?;
        let name = name.trim();
        let end_mark = format!("$End{name}");
        let end = after.find(&end_mark).ok_or_else(|| format!("section ${name} does not end; is it truncated?"))?;
        let mut numbers = Numbers { words: after[..end].split_ascii_whitespace(), section: name };
        match (name, version.starts_with('4')) {
            ("Nodes", true) => content.read_nodes_4(&mut numbers)?,
            ("Nodes", false) => content.read_nodes_2(&mut numbers)?,
            ("Elements", true) => content.read_elements_4(&mut numbers)?,
            ("Elements", false) => content.read_elements_2(&mut numbers)?,
            ("Entities", true) => content.read_entities(&mut numbers)?,
            ("NodeData", _) => content.node_data.push(read_data(&after[..end], name)?),
            ("ElementData", _) => content.element_data.push(read_data(&after[..end], name)?),
            _ => {}
        }
        rest = &after[end + end_mark.len()..];
    }
    content.finish()
}

/// The words of a section as numbers.
struct Numbers<'a> {
    words: std::str::SplitAsciiWhitespace<'a>,
    section: &'a str,
}

impl Numbers<'_> {
    fn next<T: std::str::FromStr>(&mut self) -> Result<T, String> {
        let word = self.words.next().ok_or_else(|| format!("section ${} ends too early", self.section))?;
        word.parse().map_err(|_| format!("section ${}: {word:?} is not a number of the kind needed", self.section))
    }

    fn skip(&mut self, count: usize) -> Result<(), String> {
        (0..count).try_for_each(|_| self.next::<f64>().map(|_| ()))
    }
}

#[derive(Default)]
struct Content {
    points: Vec<Vector3<f64>>,
    point_of_node: HashMap<u64, usize>,
    /// First physical group of each entity, by dimension and number.
    group_of_entity: HashMap<(usize, i64), i64>,
    elements: Vec<Element>,
    node_data: Vec<Data>,
    element_data: Vec<Data>,
}

struct Element {
    number: u64,
    kind: u32,
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

/// A section of node or element data: its words (the first is the name), real numbers (times), integers (step, components, rows), rows.
fn read_data(section: &str, name: &str) -> Result<Data, String> {
    let mut lines = section.trim_start().splitn(3, '\n');
    if lines.next().map(str::trim) != Some("1") {
        return Err(format!("section ${name} does not have one name"));
    }
    let field_name = lines.next().unwrap_or("").trim().trim_matches('"').to_string();
    let mut numbers = Numbers { words: lines.next().unwrap_or("").split_ascii_whitespace(), section: name };
    let real_count = numbers.next()?;
    numbers.skip(real_count)?;
    let integer_count: usize = numbers.next()?;
    if integer_count < 3 {
        return Err(format!("section ${name} does not say how many components and rows it has"));
    }
    numbers.skip(1)?;
    let (components, row_count): (usize, u64) = (numbers.next()?, numbers.next()?);
    numbers.skip(integer_count - 3)?;
    if !(1..=9).contains(&components) {
        return Err(format!("section ${name} has {components} components"));
    }
    let mut rows = vec![];
    for _ in 0..row_count {
        let number = numbers.next()?;
        let mut row = vec![];
        for _ in 0..components {
            row.push(numbers.next()?);
        }
        rows.push((number, row));
    }
    Ok(Data { name: field_name, components, rows })
}

/// Nodes of Gmsh's element types that may occur, and their VTK type.
fn element_kind(kind: u32) -> Result<(usize, i64), String> {
    match kind {
        1 => Ok((2, 3)),
        2 => Ok((3, 5)),
        4 => Ok((4, 10)),
        15 => Ok((1, 1)),
        _ => Err(format!("elements of Gmsh type {kind} are not supported; linear tetrahedra are needed")),
    }
}

impl Content {
    fn add_node(&mut self, node: u64, numbers: &mut Numbers) -> Result<(), String> {
        let position = Vector3::new(numbers.next()?, numbers.next()?, numbers.next()?);
        self.point_of_node.insert(node, self.points.len());
        self.points.push(position);
        Ok(())
    }

    fn read_nodes_2(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        for _ in 0..numbers.next::<u64>()? {
            let node = numbers.next()?;
            self.add_node(node, numbers)?;
        }
        Ok(())
    }

    fn read_nodes_4(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        let block_count: u64 = numbers.next()?;
        numbers.skip(3)?;
        for _ in 0..block_count {
            let dimension: usize = numbers.next()?;
            numbers.skip(1)?;
            let is_parametric: u32 = numbers.next()?;
            let node_count: u64 = numbers.next()?;
            let mut nodes = vec![];
            for _ in 0..node_count {
                nodes.push(numbers.next::<u64>()?);
            }
            for node in nodes {
                self.add_node(node, numbers)?;
                numbers.skip(if is_parametric == 1 { dimension } else { 0 })?;
            }
        }
        Ok(())
    }

    fn read_elements_2(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        for _ in 0..numbers.next::<u64>()? {
            let number = numbers.next()?;
            let kind: u32 = numbers.next()?;
            let tag_count: usize = numbers.next()?;
            let group = if tag_count > 0 { numbers.next()? } else { 0 };
            numbers.skip(tag_count.saturating_sub(1))?;
            self.add_element(number, kind, group, numbers)?;
        }
        Ok(())
    }

    fn read_elements_4(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        let block_count: u64 = numbers.next()?;
        numbers.skip(3)?;
        for _ in 0..block_count {
            let dimension: usize = numbers.next()?;
            let entity: i64 = numbers.next()?;
            let kind: u32 = numbers.next()?;
            let element_count: u64 = numbers.next()?;
            let group = self.group_of_entity.get(&(dimension, entity)).copied().unwrap_or(0);
            for _ in 0..element_count {
                let number = numbers.next()?;
                self.add_element(number, kind, group, numbers)?;
            }
        }
        Ok(())
    }

    fn add_element(&mut self, number: u64, kind: u32, group: i64, numbers: &mut Numbers) -> Result<(), String> {
        let mut nodes = vec![];
        for _ in 0..element_kind(kind)?.0 {
            nodes.push(numbers.next()?);
        }
        self.elements.push(Element { number, kind, group, nodes });
        Ok(())
    }

    fn read_entities(&mut self, numbers: &mut Numbers) -> Result<(), String> {
        let mut counts = [0_u64; 4];
        for count in &mut counts {
            *count = numbers.next()?;
        }
        for (dimension, count) in counts.into_iter().enumerate() {
            for _ in 0..count {
                let entity: i64 = numbers.next()?;
                numbers.skip(if dimension == 0 { 3 } else { 6 })?;
                let group_count: usize = numbers.next()?;
                for number in 0..group_count {
                    let group: i64 = numbers.next()?;
                    if number == 0 {
                        self.group_of_entity.insert((dimension, entity), group);
                    }
                }
                if dimension > 0 {
                    let boundary_count: usize = numbers.next()?;
                    numbers.skip(boundary_count)?;
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
