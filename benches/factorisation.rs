//! What it costs to factorise the step matrix of a left ventricle of 5, 15 and 40 thousand vertices, and to solve with the factor.
//!
//! With `CARDIOTWIN_PEER` set it obeys a peer instead: it reads `matrix EDGE FILE`, `factorise` or `solve COUNT` from its standard input and
//! answers `done` to each, so that the peer can time both sides in turn (`benches/peers/cholmod.py`).
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "criterion's macros, and a bench that fails loudly"
)]

use std::hint::black_box;
use std::io::{BufRead, Write};
use std::sync::Arc;

use cardiotwin::numerics::{BlockMatrix, CholeskyFactor, CholeskyWorkspace};
use criterion::{BenchmarkId, Criterion};

mod hearts;

fn factorisation(criterion: &mut Criterion<hearts::ProcessorTime>) {
    let mut group = criterion.benchmark_group("factorisation");
    for (_, edge_length_mm) in hearts::SIZES {
        let operator = hearts::step_operator(&hearts::left_ventricle(edge_length_mm));
        let structure = operator.myocardium().structure();
        let vertices = operator.myocardium().vertex_count();
        println!("{vertices} vertices, {} entries of the factor", structure.stored_count());
        let mut workspace = CholeskyWorkspace::<f64>::default();
        let mut factor = CholeskyFactor::new(Arc::clone(structure), operator.matrix(), &mut workspace).unwrap();
        group.bench_function(BenchmarkId::new("double", vertices), |bencher| {
            bencher.iter(|| factor.refactorise(operator.matrix(), &mut workspace).unwrap());
        });
        let mut single_workspace = CholeskyWorkspace::<f32>::default();
        let mut single = CholeskyFactor::new(Arc::clone(structure), operator.matrix(), &mut single_workspace).unwrap();
        group.bench_function(BenchmarkId::new("single", vertices), |bencher| {
            bencher.iter(|| single.refactorise(operator.matrix(), &mut single_workspace).unwrap());
        });
        for count in [1, 3, 32] {
            let columns = vec![operator.myocardium().rest_mm().to_vec(); count];
            let mut solved = columns.clone();
            group.bench_function(BenchmarkId::new(format!("solve_{count}"), vertices), |bencher| {
                bencher.iter(|| {
                    solved.clone_from(&columns);
                    factor.solve_in_place(black_box(&mut solved), &mut workspace).unwrap();
                });
            });
        }
    }
    group.finish();
}

/// Number of unknowns and of entries, then row numbers, column numbers (32 bits) and values (64 bits), little-endian.
fn write_entries(matrix: &BlockMatrix, path: &str) {
    let pattern = matrix.pattern();
    let (mut rows, mut columns, mut values) = (Vec::new(), Vec::new(), Vec::new());
    let mut blocks = matrix.blocks().iter();
    for row in 0..pattern.vertex_count() {
        for (&column, block) in pattern.columns_of(row).iter().zip(&mut blocks) {
            for (a, b) in (0..9).map(|entry| (entry / 3, entry % 3)) {
                rows.extend(((3 * row + a) as u32).to_le_bytes());
                columns.extend(((3 * column + b) as u32).to_le_bytes());
                values.extend(block[(a, b)].to_le_bytes());
            }
        }
    }
    let head = [3 * pattern.vertex_count() as u64, 9 * pattern.block_count() as u64].map(u64::to_le_bytes).concat();
    std::fs::write(path, [head, rows, columns, values].concat()).unwrap();
}

fn obey_peer() {
    let mut workspace = CholeskyWorkspace::default();
    let mut subject: Option<(BlockMatrix, CholeskyFactor)> = None;
    for line in std::io::stdin().lock().lines() {
        let line = line.unwrap();
        let words: Vec<&str> = line.split(' ').collect();
        match (words.as_slice(), &mut subject) {
            (["matrix", edge_length_mm, path], subject) => {
                let operator = hearts::step_operator(&hearts::left_ventricle(edge_length_mm.parse().unwrap()));
                write_entries(operator.matrix(), path);
                let structure = Arc::clone(operator.myocardium().structure());
                let factor = CholeskyFactor::new(structure, operator.matrix(), &mut workspace).unwrap();
                *subject = Some((operator.matrix().clone(), factor));
            }
            (["factorise"], Some((matrix, factor))) => factor.refactorise(matrix, &mut workspace).unwrap(),
            (["solve", count], Some((matrix, factor))) => {
                let ones = vec![nalgebra::Vector3::repeat(1.0); matrix.pattern().vertex_count()];
                let mut columns = vec![ones; count.parse().unwrap()];
                factor.solve_in_place(black_box(&mut columns), &mut workspace).unwrap();
            }
            _ => panic!("a peer may not say: {line}"),
        }
        println!("done");
        std::io::stdout().flush().unwrap();
    }
}

fn main() {
    if std::env::var_os("CARDIOTWIN_PEER").is_some() {
        obey_peer();
    } else {
        let mut criterion = hearts::criterion();
        factorisation(&mut criterion);
        criterion.final_summary();
    }
}
