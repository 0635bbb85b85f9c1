//! Reads VTU files: unstructured grids in VTK's XML, in text, base64 or raw, compressed by zlib or not.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::encoding::Encoding;
use super::mesh_file::{CellSorter, FieldArray, MeshFile};
use super::xml::{Element, parse};

/// The content of a VTU file; several pieces are put together.
pub(super) fn read_vtu(bytes: &[u8]) -> Result<MeshFile, String> {
    let file = parse(bytes)?;
    if file.name != "VTKFile" || file.attribute("type") != Some("UnstructuredGrid") {
        return Err("it is not a VTK XML file of an unstructured grid".into());
    }
    let encoding = Encoding::of(&file)?;
    let grid = file.child("UnstructuredGrid").ok_or("it has no UnstructuredGrid")?;
    let mut all = Pieces::default();
    for piece in grid.children_named("Piece") {
        all.add(piece, &encoding)?;
    }
    let Pieces { points, cells, point_fields, cell_fields } = all;
    Ok(cells.finish(points, point_fields, &cell_fields))
}

#[derive(Default)]
struct Pieces {
    points: Vec<Vector3<f64>>,
    cells: CellSorter,
    point_fields: BTreeMap<String, FieldArray>,
    cell_fields: BTreeMap<String, FieldArray>,
}

impl Pieces {
    fn add(&mut self, piece: &Element, encoding: &Encoding) -> Result<(), String> {
        let (first_point, first_cell) = (self.points.len(), self.cells.cell_count());
        let point_count = count(piece, "NumberOfPoints")?;
        let cell_count = count(piece, "NumberOfCells")?;
        let points = piece.child("Points").and_then(|p| p.child("DataArray")).ok_or("a piece has no points")?;
        let numbers = encoding.numbers(points, point_count.saturating_mul(3))?;
        self.points.extend(numbers.chunks_exact(3).map(|p| Vector3::new(p[0], p[1], p[2])));
        self.add_cells(piece.child("Cells").ok_or("a piece has no cells")?, encoding, cell_count, first_point)?;
        for (section, entries, before, fields) in
            [("PointData", point_count, first_point, &mut self.point_fields), ("CellData", cell_count, first_cell, &mut self.cell_fields)]
        {
            let arrays = piece.child(section).into_iter().flat_map(|section| section.children_named("DataArray"));
            // Words cannot be fields here.
            for array in arrays.filter(|array| array.attribute("type") != Some("String")) {
                let components = array.attribute("NumberOfComponents").map_or(Ok(1), |n| n.trim().parse::<usize>());
                let components = components.map_err(|_| "a number of components is senseless".to_string())?;
                let values = encoding.numbers(array, entries.saturating_mul(components))?;
                let name = array.attribute("Name").unwrap_or("").to_string();
                let field = fields.entry(name.clone()).or_insert_with(|| FieldArray { components, values: vec![] });
                if field.components != components || field.values.len() != before * components {
                    return Err(format!("array {name} is not alike in all pieces"));
                }
                field.values.extend(values);
            }
        }
        Ok(())
    }

    fn add_cells(&mut self, cells: &Element, encoding: &Encoding, cell_count: usize, first_point: usize) -> Result<(), String> {
        let array = |name: &'static str| {
            let found = cells.children_named("DataArray").find(|array| array.attribute("Name") == Some(name));
            found.ok_or_else(|| format!("the cells have no array {name}"))
        };
        let offsets = encoding.numbers(array("offsets")?, cell_count)?;
        let types = encoding.numbers(array("types")?, cell_count)?;
        let corner_count = offsets.last().map_or(0, |&end| end as usize);
        let connectivity = encoding.numbers(array("connectivity")?, corner_count)?;
        let mut start = 0;
        for (&end, &kind) in offsets.iter().zip(&types) {
            let corners = connectivity.get(start..end as usize).ok_or("the offsets of the cells do not ascend")?;
            start = end as usize;
            if corners.iter().any(|&corner| corner < 0.0) {
                return Err("a cell names a point by a negative number".into());
            }
            let corners: Vec<usize> = corners.iter().map(|&corner| first_point + corner as usize).collect();
            self.cells.add(kind as i64, &corners)?;
        }
        Ok(())
    }
}

fn count(piece: &Element, name: &str) -> Result<usize, String> {
    piece.attribute(name).and_then(|n| n.trim().parse().ok()).ok_or_else(|| format!("a piece does not say its {name}"))
}
