//! The wall of the left ventricle: strain curves, and bull's-eyes of activation, strain and thickening by AHA segment.

use crate::heart::{BeatDeformation, HeartModel, Trajectory};
use crate::report::html::{Block, BullsEye, Plot, Scale, Section};
use crate::study::run::clock::Clock;
use crate::study::run::forward::deformation;
use crate::study::run::pictures::strains;
use crate::study::run::wall::{SegmentRow, segment_rows};
use crate::units::MS_PER_S;

/// Strains over the beat and by segment; empty where the beat has no frames.
pub(in crate::study::run) fn wall_section(model: &HeartModel, clock: &Clock, trajectory: &Trajectory) -> Section {
    let found = deformation(model, trajectory, clock);
    let blocks = found.map(|beat| blocks(model, clock, &beat)).unwrap_or_default();
    Section { title: "The wall by segment".into(), blocks }
}

fn blocks(model: &HeartModel, clock: &Clock, beat: &BeatDeformation) -> Vec<Block> {
    let rows = segment_rows(model, beat);
    let eye = |title: &str, unit: &str, scale: Scale, value: fn(&SegmentRow) -> f64| BullsEye {
        title: title.into(),
        unit: unit.into(),
        values: by_segment(rows.iter().map(|row| (row.segment, value(row)))),
        scale,
    };
    let eyes = vec![
        eye("Activation", "ms", Scale::Sequential, |row| MS_PER_S * row.activation_time_s),
        eye("Circumferential strain at end-systole", "%", Scale::Diverging, |row| 100.0 * row.strain_circumferential_end_systole),
        eye("Longitudinal strain at end-systole", "%", Scale::Diverging, |row| 100.0 * row.strain_longitudinal_end_systole),
        eye("Radial strain at end-systole", "%", Scale::Diverging, |row| 100.0 * row.strain_radial_end_systole),
        eye("Thickening at end-systole", "%", Scale::Diverging, |row| 100.0 * row.thickening),
        eye("Thickness at end-diastole", "mm", Scale::Sequential, |row| row.thickness_end_diastole_mm),
    ];
    let about = "Strains are relative changes of length against end-diastole, around, along and across the wall: shortening is negative. \
                 The base lies outside, the apex in the middle, the septum on the left; the apical cap may lie beyond the colours.";
    let curves = strains(beat, clock.last_trigger_s()).panels;
    let plots = curves.iter().map(|panel| Block::Plot(Plot::from(panel))).collect();
    let mut blocks = vec![Block::Text(about.into())];
    let along = 100.0 * beat.end_systole.strain.longitudinal;
    if along > 0.0 {
        blocks.push(Block::Warnings(vec![format!(
            "The wall of this model lengthens along the ventricle in systole, by {along:.1} % on average, where every heart shortens: its \
             longitudinal strains are the model's, and say nothing of the patient."
        )]));
    }
    blocks.extend([Block::BullsEyes(eyes), Block::Beside(plots)]);
    blocks
}

/// Values of the segments 1 to 17 in their places.
pub(super) fn by_segment(values: impl Iterator<Item = (u8, f64)>) -> [Option<f64>; 17] {
    let mut placed = [None; 17];
    for (segment, value) in values.filter(|(segment, value)| (1..=17).contains(segment) && value.is_finite()) {
        placed[usize::from(segment) - 1] = Some(value);
    }
    placed
}
