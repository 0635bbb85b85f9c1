//! Slices of the images through the beat with the model's contours on them, \[Billet2009\] fig. 3: one picture and one set of lines a frame.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::io;

use serde::Serialize;

use super::pack::base64;
use crate::report::figures::{Contour, Montage, MontagePanel};

/// Slices by row, frames by column, as in a printed montage but of every frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Slices(pub Montage);

/// What the script shows.
#[derive(Debug, Serialize)]
pub(super) struct SliceRecord {
    /// Names of the surfaces.
    surfaces: Vec<String>,
    views: Vec<ViewRecord>,
}

#[derive(Debug, Serialize)]
struct ViewRecord {
    title: String,
    /// Pixels in a row and rows.
    pixels: [usize; 2],
    /// Left, top, width and height in tenths of a millimetre.
    view_box: [i64; 4],
    /// JPEG in base64.
    images: Vec<String>,
    /// Paths in tenths of a millimetre, by frame and surface.
    paths: Vec<Vec<String>>,
}

/// Tenths of a millimetre.
const PER_MM: f64 = 10.0;
const QUALITY: u8 = 82;

impl Slices {
    /// The slices as the script takes them.
    pub(super) fn record(&self) -> io::Result<SliceRecord> {
        let montage = &self.0;
        let count = montage.column_titles.len().max(1);
        let views = montage.row_titles.iter().zip(montage.panels.chunks(count));
        let views = views.map(|(title, panels)| view(title, panels, montage)).collect::<io::Result<_>>()?;
        Ok(SliceRecord { surfaces: montage.surfaces.clone(), views })
    }
}

fn view(title: &str, panels: &[MontagePanel], montage: &Montage) -> io::Result<ViewRecord> {
    let (pixels, view_box) = panels.first().map_or(([0; 2], [0; 4]), |panel| {
        let corner = |axis: usize| panel.origin_mm[axis] - 0.5 * panel.spacing_mm[axis];
        let size = [panel.columns as f64 * panel.spacing_mm[0], panel.rows as f64 * panel.spacing_mm[1]];
        ([panel.columns, panel.rows], [corner(0), corner(1), size[0], size[1]].map(tenths))
    });
    let images = panels.iter().map(|panel| Ok(base64(&jpeg(panel, montage.window)?))).collect::<io::Result<_>>()?;
    let paths_of = |panel: &MontagePanel| (0..montage.surfaces.len()).map(|surface| path(&panel.contours, surface)).collect();
    Ok(ViewRecord { title: title.to_owned(), pixels, view_box, images, paths: panels.iter().map(paths_of).collect() })
}

fn tenths(length_mm: f64) -> i64 {
    (length_mm * PER_MM).round() as i64
}

fn jpeg(panel: &MontagePanel, (black, white): (f64, f64)) -> io::Result<Vec<u8>> {
    let grey = |value: &f64| ((value - black) / (white - black) * 255.0).round().clamp(0.0, 255.0) as u8;
    let pixels: Vec<u8> = panel.intensity.iter().map(grey).collect();
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, QUALITY);
    encoder.encode(&pixels, panel.columns as u32, panel.rows as u32, image::ColorType::L8).map_err(io::Error::other)?;
    Ok(bytes)
}

/// The contours of a surface as the path of a drawing.
fn path(contours: &[Contour], surface: usize) -> String {
    let of_surface = contours.iter().filter(|contour| contour.surface == surface);
    let lines: Vec<Vec<[i64; 2]>> = of_surface.map(|contour| contour.points_mm.iter().map(|point| point.map(tenths)).collect()).collect();
    let mut path = String::new();
    for line in joined(&lines) {
        let mut before = line[0];
        let _ = write!(path, "M{} {}", before[0], before[1]);
        for point in &line[1..] {
            let _ = write!(path, "l{} {}", point[0] - before[0], point[1] - before[1]);
            before = *point;
        }
    }
    path
}

/// Lines joined where their ends meet, so that a contour is one line.
fn joined(lines: &[Vec<[i64; 2]>]) -> Vec<Vec<[i64; 2]>> {
    let mut at_end: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    let ends = |line: &Vec<[i64; 2]>| line.first().copied().zip(line.last().copied());
    let mut is_left: Vec<bool> = lines.iter().map(|line| ends(line).is_some_and(|(first, last)| line.len() > 2 || first != last)).collect();
    for (number, line) in lines.iter().enumerate().filter(|&(number, _)| is_left[number]) {
        if let Some((first, last)) = ends(line) {
            at_end.entry(first).or_default().push(number);
            at_end.entry(last).or_default().push(number);
        }
    }
    let mut found = Vec::new();
    for start in 0..lines.len() {
        if !is_left[start] {
            continue;
        }
        is_left[start] = false;
        let mut line = lines[start].clone();
        // Forward from its end, then, turned round, from its start.
        for _ in 0..2 {
            while let Some(next) = line.last().and_then(|end| at_end.get(end)?.iter().copied().find(|&number| is_left[number])) {
                is_left[next] = false;
                let piece = &lines[next];
                let from_first = piece.first() == line.last();
                if from_first { line.extend(&piece[1..]) } else { line.extend(piece.iter().rev().skip(1)) }
            }
            line.reverse();
        }
        found.push(line);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_a_contour_become_one_closed_line() {
        let lines = [[[0, 0], [1, 0]], [[1, 1], [1, 0]], [[0, 1], [0, 0]], [[0, 1], [1, 1]], [[5, 5], [5, 5]]].map(|ends| ends.to_vec());
        let found = joined(&lines);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].len(), found[0].first()), (5, found[0].last()));
    }

    #[test]
    fn a_path_is_relative_and_of_its_surface_only() {
        let contour = |surface, points: &[[f64; 2]]| Contour { surface, points_mm: points.to_vec() };
        let contours =
            [contour(0, &[[1.0, 2.0], [1.5, 2.0]]), contour(1, &[[9.0, 9.0], [8.0, 9.0]]), contour(0, &[[1.5, 2.0], [1.5, 3.04]])];
        assert!(["M10 20l5 0l0 10", "M15 30l0 -10l-5 0"].contains(&path(&contours, 0).as_str()), "{}", path(&contours, 0));
    }

    #[test]
    fn a_frame_is_a_picture_that_any_reader_opens() {
        let panel = MontagePanel {
            columns: 16,
            rows: 8,
            intensity: (0..128).map(|n| f64::from(n) * 2.0).collect(),
            origin_mm: [10.0, 20.0],
            spacing_mm: [1.5, 1.5],
            contours: Vec::new(),
        };
        let bytes = jpeg(&panel, (0.0, 255.0)).unwrap();
        let read = image::load_from_memory_with_format(&bytes, image::ImageFormat::Jpeg).unwrap().to_luma8();
        assert_eq!(read.dimensions(), (16, 8));
        assert!((f64::from(read.get_pixel(15, 7).0[0]) - 254.0).abs() < 12.0);
        let record = view("a", &[panel], &Montage { surfaces: vec![], ..empty() }).unwrap();
        assert_eq!((record.view_box, record.pixels), ([93, 193, 240, 120], [16, 8]));
    }

    fn empty() -> Montage {
        Montage { title: String::new(), surfaces: vec![], column_titles: vec![], row_titles: vec![], panels: vec![], window: (0.0, 255.0) }
    }
}
