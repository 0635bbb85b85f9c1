//! What a cine shows: `cargo run --release --example read_cine -- cine.nii.gz` (or a folder of DICOM files); without an argument one is made up.

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use std::error::Error;
use std::fs::File;
use std::path::PathBuf;

use cardiotwin::image::{CineSequence, CineTiming, Grid, Volume, read_cine_source, write_cine};
use nalgebra::Vector3;

pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let given = std::env::args().nth(1).map(PathBuf::from).filter(|path| path.exists());
    let path = given.map_or_else(written, Ok)?;

    // Times come from the header; a CineTiming says what is known better. Warnings say what is odd.
    let reading = read_cine_source(&path, &CineTiming::default())?;
    let cine = &reading.cine;
    println!("{}: {} frames, heart period {:.0} ms; {:?}", path.display(), cine.frames().len(), 1000.0 * cine.period_s(), reading.warnings);

    // An instant between two frames, at a place in the world (mm, RAS), with its gradient.
    let [ni, nj, nk] = cine.grid().shape();
    let centre_mm = cine.grid().to_world_mm(&Vector3::new(ni as f64 / 2.0, nj as f64 / 2.0, nk as f64 / 2.0));
    let instant = cine.at_time(0.4 * cine.period_s());
    let (value, gradient) = instant.sample_with_gradient(&centre_mm).ok_or("the centre lies outside of the image")?;
    println!("at {centre_mm:?} mm: {value:.1}, gradient {gradient:?} a mm");
    Ok(())
}

/// Ten frames of a bright ball that shrinks and grows.
fn written() -> Result<PathBuf, Box<dyn Error>> {
    let grid = Grid::axis_aligned([24, 24, 8], Vector3::new(-24.0, -24.0, 0.0), Vector3::new(2.0, 2.0, 8.0))?;
    let frame = |n: u32| {
        let radius_mm = 18.0 + 4.0 * (std::f64::consts::TAU * f64::from(n) / 10.0).cos();
        let value = |flat: usize| {
            let [i, j, k] = grid.voxel_of(flat).map(|index| index as f64);
            let distance_mm = (2.0 * i - 24.0).hypot(2.0 * j - 24.0).hypot(8.0 * k - 28.0);
            (100.0 - 10.0 * (distance_mm - radius_mm)).clamp(20.0, 200.0) as f32
        };
        Volume::new(grid.clone(), (0..grid.voxel_count()).map(value).collect())
    };
    let frames = (0..10).map(frame).collect::<Result<Vec<_>, _>>()?;
    let cine = CineSequence::new(frames, (0..10).map(|n| 0.08 * f64::from(n)).collect(), 0.8)?;
    let path = std::env::temp_dir().join("cardiotwin_example_cine.nii.gz");
    write_cine(&mut File::create(&path)?, &cine)?;
    Ok(path)
}
