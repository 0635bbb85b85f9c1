//! Writes legacy VTK files (.vtk, version 4.2, binary) of tetrahedra and tagged triangles, readable by VTK from 4 to 9 and meshio.

use nalgebra::Vector3;

use super::{FieldValues, NamedField};

/// What stands for a blank in the name of an array.
pub(super) const BLANK: &str = "%20";

/// The whole file; `cells` with their VTK types, `cell_fields` one entry a cell.
pub(super) fn legacy_vtk_document(
    position_mm: &[Vector3<f64>],
    cells: &[(u8, &[usize])],
    point_fields: &[NamedField],
    cell_fields: &[NamedField],
) -> Vec<u8> {
    let mut file = b"# vtk DataFile Version 4.2\ncardiotwin, lengths in mm\nBINARY\nDATASET UNSTRUCTURED_GRID\n".to_vec();
    line(&mut file, format!("POINTS {} double", position_mm.len()));
    file.extend(position_mm.iter().flatten().flat_map(|x| x.to_be_bytes()));
    let size: usize = cells.iter().map(|(_, corners)| corners.len() + 1).sum();
    line(&mut file, format!("\nCELLS {} {size}", cells.len()));
    let int = |number: usize| (number as i32).to_be_bytes();
    for (_, corners) in cells {
        file.extend(int(corners.len()));
        file.extend(corners.iter().flat_map(|&vertex| int(vertex)));
    }
    line(&mut file, format!("\nCELL_TYPES {}", cells.len()));
    file.extend(cells.iter().flat_map(|&(kind, _)| int(kind.into())));
    for (section, count, fields) in [("POINT_DATA", position_mm.len(), point_fields), ("CELL_DATA", cells.len(), cell_fields)] {
        if !fields.is_empty() {
            line(&mut file, format!("\n{section} {count}\nFIELD FieldData {}", fields.len()));
            fields.iter().for_each(|&(name, values)| push_field(&mut file, name, values));
        }
    }
    file
}

fn push_field(file: &mut Vec<u8>, name: &str, values: FieldValues) {
    let (components, kind) = match values {
        FieldValues::Scalars(_) => (1, "double"),
        FieldValues::Vectors(_) => (3, "double"),
        FieldValues::Labels(_) => (1, "int"),
    };
    let name: String = name.split_whitespace().collect::<Vec<_>>().join(BLANK);
    line(file, format!("{name} {components} {} {kind}", values.len()));
    match values {
        FieldValues::Scalars(v) => file.extend(v.iter().flat_map(|x| x.to_be_bytes())),
        FieldValues::Vectors(v) => file.extend(v.iter().flatten().flat_map(|x| x.to_be_bytes())),
        FieldValues::Labels(v) => file.extend(v.iter().flat_map(|x| x.to_be_bytes())),
    }
    file.push(b'\n');
}

fn line(file: &mut Vec<u8>, text: String) {
    file.extend(text.into_bytes());
    file.push(b'\n');
}
