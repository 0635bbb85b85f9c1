//! Writes Gmsh meshes (.msh), version 2.2 in text: surfaces as physical groups, fields as node and element data.

use std::fmt::Write as _;

use super::{FieldValues, NamedField};
use crate::mesh::{SurfaceTag, TaggedSurface, TetMesh};

/// The physical group of the tetrahedra; those of the triangles are [`SurfaceTag::code`].
const MYOCARDIUM: i32 = 1;

/// The whole file. Triangles come after the tetrahedra; cell fields have one entry a tetrahedron.
pub(super) fn gmsh_document(
    mesh: &TetMesh,
    surface: &TaggedSurface,
    point_fields: &[NamedField],
    cell_fields: &[NamedField],
) -> Result<String, std::fmt::Error> {
    let mut text = String::from("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n");
    writeln!(text, "$PhysicalNames\n{}\n3 {MYOCARDIUM} \"myocardium\"", SurfaceTag::ALL.len() + 1)?;
    for tag in SurfaceTag::ALL {
        writeln!(text, "2 {} \"{tag:?}\"", tag.code())?;
    }
    writeln!(text, "$EndPhysicalNames\n$Nodes\n{}", mesh.vertex_count())?;
    for (vertex, p) in mesh.vertices_mm().iter().enumerate() {
        writeln!(text, "{} {:e} {:e} {:e}", vertex + 1, p.x, p.y, p.z)?;
    }
    let tetrahedron_count = mesh.tetrahedron_count();
    writeln!(text, "$EndNodes\n$Elements\n{}", tetrahedron_count + surface.triangles().len())?;
    for (number, corners) in mesh.tetrahedra().iter().enumerate() {
        let [a, b, c, d] = corners.map(|vertex| vertex + 1);
        writeln!(text, "{} 4 2 {MYOCARDIUM} {MYOCARDIUM} {a} {b} {c} {d}", number + 1)?;
    }
    for (number, (triangle, tag)) in surface.triangles().iter().zip(surface.tags()).enumerate() {
        let ([a, b, c], code) = (triangle.map(|vertex| vertex + 1), tag.code());
        writeln!(text, "{} 2 2 {code} {code} {a} {b} {c}", tetrahedron_count + number + 1)?;
    }
    text.push_str("$EndElements\n");
    for (section, fields) in [("NodeData", point_fields), ("ElementData", cell_fields)] {
        for &(name, values) in fields {
            push_field(&mut text, section, name, values)?;
        }
    }
    Ok(text)
}

fn push_field(text: &mut String, section: &str, name: &str, values: FieldValues) -> std::fmt::Result {
    let components = if matches!(values, FieldValues::Vectors(_)) { 3 } else { 1 };
    writeln!(text, "${section}\n1\n\"{}\"\n1\n0\n3\n0\n{components}\n{}", name.replace(['"', '\n'], "'"), values.len())?;
    match values {
        FieldValues::Scalars(v) => v.iter().zip(1..).try_for_each(|(x, n)| writeln!(text, "{n} {x:e}")),
        FieldValues::Vectors(v) => v.iter().zip(1..).try_for_each(|(x, n)| writeln!(text, "{n} {:e} {:e} {:e}", x.x, x.y, x.z)),
        FieldValues::Labels(v) => v.iter().zip(1..).try_for_each(|(x, n)| writeln!(text, "{n} {x}")),
    }?;
    writeln!(text, "$End{section}")
}
