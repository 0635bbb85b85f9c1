//! What it costs to make a mesh of masks: fields through thick slices, and tetrahedra a second, for one ventricle and two.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "criterion's macros, and a bench that fails loudly")]

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings, IdealisedBiventricle, build_from_fields};
use cardiotwin::image::{FieldOptions, HeartCodes, HeartFields, LabelMap, heart_fields};
use cardiotwin::mesh::MeshQuality;
use cardiotwin::phantom::{LABEL_CAVITY_LV, LABEL_CAVITY_RV, LABEL_WALL, ShortAxisStack, VoxelSampling, rasterise};
use criterion::{BenchmarkId, Criterion, Throughput};

mod hearts;

/// The hearts that are drawn, at 1.5 × 1.5 × 8 mm, with what their labels mean.
fn drawn() -> [(&'static str, LabelMap, HeartCodes); 2] {
    let mesher = MesherSettings::with_edge_length_mm(4.0);
    let two = IdealisedBiventricle::default().build(&mesher, &AnatomySettings::default()).unwrap();
    let one = hearts::left_ventricle(4.0);
    let labels = |anatomy: &Anatomy| {
        let grid = ShortAxisStack::default().grid(anatomy).unwrap();
        rasterise(anatomy, anatomy.mesh.vertices_mm(), &grid, &VoxelSampling::CENTRES).unwrap().to_label_map().unwrap()
    };
    let left = HeartCodes::left(LABEL_CAVITY_LV, LABEL_WALL);
    [("one ventricle", labels(&one), left), ("two ventricles", labels(&two), HeartCodes { cavity_rv: Some(LABEL_CAVITY_RV), ..left })]
}

fn meshed(fields: &HeartFields, edge_length_mm: f64) -> Anatomy {
    build_from_fields(fields, &MesherSettings::with_edge_length_mm(edge_length_mm), &AnatomySettings::default()).unwrap()
}

fn masks_to_mesh(criterion: &mut Criterion<hearts::ProcessorTime>) {
    let hearts = drawn();
    let fields_of = |labels, codes| heart_fields(labels, codes, &FieldOptions::default()).unwrap();
    let mut group = criterion.benchmark_group("masks to fields");
    for (name, labels, codes) in &hearts {
        group.bench_function(*name, |bencher| bencher.iter(|| fields_of(labels, codes)));
    }
    group.finish();
    let mut group = criterion.benchmark_group("fields to mesh with fibres");
    for (name, labels, codes) in &hearts {
        let fields = fields_of(labels, codes);
        for edge_length_mm in [5.0, 3.0] {
            let quality = MeshQuality::of(&meshed(&fields, edge_length_mm).mesh);
            println!(
                "{name}, edge {edge_length_mm} mm: {} tetrahedra, dihedral angle {:.1}° (least), {:.1}° (1st percentile), radius ratio {:.2}",
                quality.tetrahedron_count, quality.dihedral_least_deg, quality.dihedral_percentile_1_deg, quality.radius_ratio_least
            );
            group.throughput(Throughput::Elements(quality.tetrahedron_count as u64));
            group.bench_function(BenchmarkId::new(*name, edge_length_mm), |bencher| bencher.iter(|| meshed(&fields, edge_length_mm)));
        }
    }
    group.finish();
}

fn main() {
    let mut criterion = hearts::criterion();
    masks_to_mesh(&mut criterion);
    criterion.final_summary();
}
