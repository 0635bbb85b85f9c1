//! What images cost: resampling, rasterising, sampling along normals, and a mesh from a label map.
//!
//! With `CARDIOTWIN_PEER` set it obeys a peer instead: it reads `image FILE` (voxels as 32-bit floats, i fastest, and in
//! FILE.points the points to be sampled, in voxels), `resample`, `sample` and `leave FILE` (what both found) from its standard input and answers
//! `done` to each, so that the peer can time both sides in turn and compare their answers (`benches/peers/resample.py`).
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "criterion's macros, and a bench that fails loudly"
)]

use std::hint::black_box;
use std::io::{BufRead, Write};

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{Anatomy, AnatomySettings, build_from_fields};
use cardiotwin::image::{FieldOptions, Grid, HeartCodes, Volume, heart_fields, resampled_isotropic};
use cardiotwin::phantom::{IdealisedLv, LABEL_CAVITY_LV, LABEL_WALL, ShortAxisStack, VoxelSampling, rasterise};
use criterion::{BenchmarkId, Criterion, Throughput};
use nalgebra::Vector3;

mod hearts;

const SHAPE: [usize; 3] = [192, 192, 12];
const SPACING_MM: [f64; 3] = [1.5, 1.5, 8.0];

/// Vertices of a surface, and places along the normal of each.
const NORMALS: usize = 4000;
const PLACES: usize = 33;

/// An image without symmetry.
fn image() -> Volume {
    let grid = Grid::axis_aligned(SHAPE, Vector3::zeros(), Vector3::from(SPACING_MM)).unwrap();
    let value = |flat: usize| {
        let [i, j, k] = grid.voxel_of(flat).map(|n| n as f64);
        (100.0 + 60.0 * (0.21 * i + 0.3 * k).sin() * (0.17 * j - 0.2 * k).cos() + 0.1 * (i * j + k)) as f32
    };
    Volume::new(grid.clone(), (0..grid.voxel_count()).map(value).collect()).unwrap()
}

/// Points along the normals of an ellipsoid in the middle of the image, mm.
fn points() -> Vec<Vector3<f64>> {
    let centre = Vector3::from_fn(|axis, _| 0.5 * (SHAPE[axis] - 1) as f64 * SPACING_MM[axis]);
    let direction = |n: usize| {
        let (height, turn) = (1.0 - 2.0 * (n as f64 + 0.5) / NORMALS as f64, 2.399_963 * n as f64);
        let radius = (1.0 - height * height).sqrt();
        Vector3::new(radius * turn.cos(), radius * turn.sin(), height)
    };
    let along = |n: usize, place: usize| centre + direction(n) * (30.0 + 0.5 * (place as f64 - 16.0));
    (0..NORMALS).flat_map(|n| (0..PLACES).map(move |place| (n, place))).map(|(n, place)| along(n, place)).collect()
}

fn sampled(image: &Volume, points: &[Vector3<f64>]) -> Vec<f64> {
    points.iter().map(|point| image.sample(point).unwrap_or(f64::NAN)).collect()
}

fn ventricle() -> Anatomy {
    IdealisedLv::default().build(&MesherSettings::with_edge_length_mm(4.0), &AnatomySettings::default()).unwrap()
}

fn resampling_and_sampling(criterion: &mut Criterion<hearts::ProcessorTime>) {
    let (image, points) = (image(), points());
    let mut group = criterion.benchmark_group("image");
    let voxels = resampled_isotropic(&image, None).unwrap().grid().voxel_count();
    group.throughput(Throughput::Elements(voxels as u64));
    group.bench_function(BenchmarkId::new("resample", voxels), |bencher| {
        bencher.iter(|| black_box(resampled_isotropic(&image, None).unwrap()))
    });
    group.throughput(Throughput::Elements(points.len() as u64));
    group.bench_function(BenchmarkId::new("sample", points.len()), |bencher| bencher.iter(|| black_box(sampled(&image, &points))));
    group.bench_function(BenchmarkId::new("sample_with_gradient", points.len()), |bencher| {
        bencher.iter(|| {
            points.iter().filter_map(|point| image.sample_with_gradient(point)).map(|(value, gradient)| value + gradient.x).sum::<f64>()
        });
    });
    group.finish();
}

fn rasterising_and_meshing(criterion: &mut Criterion<hearts::ProcessorTime>) {
    let anatomy = ventricle();
    let mut group = criterion.benchmark_group("heart");
    group.sample_size(10);
    for slice_distance_mm in [1.5, 8.0] {
        let grid = ShortAxisStack { slice_distance_mm, ..ShortAxisStack::default() }.grid(&anatomy).unwrap();
        group.throughput(Throughput::Elements(grid.voxel_count() as u64));
        group.bench_function(BenchmarkId::new("rasterise", slice_distance_mm), |bencher| {
            bencher.iter(|| black_box(rasterise(&anatomy, anatomy.mesh.vertices_mm(), &grid, &VoxelSampling::default()).unwrap()));
        });
    }
    let grid = ShortAxisStack::default().grid(&anatomy).unwrap();
    let labels = rasterise(&anatomy, anatomy.mesh.vertices_mm(), &grid, &VoxelSampling::CENTRES).unwrap().to_label_map().unwrap();
    let mesh = || {
        let fields = heart_fields(&labels, &HeartCodes::left(LABEL_CAVITY_LV, LABEL_WALL), &FieldOptions::default()).unwrap();
        build_from_fields(&fields, &MesherSettings::with_edge_length_mm(3.0), &AnatomySettings::default()).unwrap()
    };
    let tetrahedra = mesh().mesh.tetrahedron_count();
    group.throughput(Throughput::Elements(tetrahedra as u64));
    group.bench_function(BenchmarkId::new("mesh_of_labels", tetrahedra), |bencher| bencher.iter(|| black_box(mesh())));
    group.finish();
}

/// Does what a peer writes, line by line.
fn serve() {
    let (image, points) = (image(), points());
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let (mut resampled, mut values) = (None, Vec::new());
    for line in std::io::stdin().lock().lines() {
        let line = line.unwrap();
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["image", file] => {
                std::fs::write(file, floats(image.values())).unwrap();
                let voxels = points.iter().flat_map(|point| image.grid().to_voxel(point).data.0[0]);
                std::fs::write(format!("{file}.points"), voxels.flat_map(f64::to_le_bytes).collect::<Vec<u8>>()).unwrap();
            }
            ["resample"] => resampled = Some(black_box(resampled_isotropic(&image, None).unwrap())),
            ["sample"] => values = black_box(sampled(&image, &points)),
            ["leave", file] => {
                let volume = resampled.as_ref().unwrap();
                std::fs::write(file, floats(volume.values())).unwrap();
                std::fs::write(format!("{file}.values"), values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
            }
            other => panic!("unknown: {other:?}"),
        }
        println!("done");
        std::io::stdout().flush().unwrap();
    }
}

fn main() {
    if std::env::var_os("CARDIOTWIN_PEER").is_some() {
        return serve();
    }
    let mut criterion = hearts::criterion();
    resampling_and_sampling(&mut criterion);
    rasterising_and_meshing(&mut criterion);
    criterion.final_summary();
}
