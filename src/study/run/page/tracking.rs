//! What the images had to add to the model: distances from the boundary by surface and segment, and the work of the image forces.

use crate::anatomy::Anatomy;
use crate::mesh::SurfaceTag;
use crate::numerics::root_mean_square;
use crate::report::figures::{Bar, Curve, Look};
use crate::report::html::{Bars, Block, BullsEye, Plot, Scale, Section, Table};
use crate::study::run::clock::Clock;
use crate::study::run::discrepancy::{region_work_mj, segment_work_mj};
use crate::study::run::personal_summary::{TrackingSummary, ValidationSummary};
use crate::study::run::track::Tracked;
use crate::tracking::TrackedMotion;

use super::wall::by_segment;

const SURFACES: [(SurfaceTag, &str, Look); 3] = [
    (SurfaceTag::EndocardiumLv, "LV endocardium", Look::Simulated),
    (SurfaceTag::EndocardiumRv, "RV endocardium", Look::Other),
    (SurfaceTag::Epicardium, "epicardium", Look::Tracked),
];

/// How the tracked heart follows the images, and what that took.
pub(in crate::study::run) fn tracking_section(
    anatomy: &Anatomy,
    clock: &Clock,
    tracked: &Tracked,
    summary: &TrackingSummary,
    validation: &[ValidationSummary],
) -> Section {
    let motion = &tracked.motion;
    let about = "The tracked heart is the model pulled along by the images. Its distance from their boundaries says how well it follows; the work of \
                 the image forces says how much the model alone could not explain, and where. Segments in grey have no boundary points.";
    let eyes = vec![
        distance_eye(anatomy, motion, SurfaceTag::EndocardiumLv, "Distance of the endocardium"),
        distance_eye(anatomy, motion, SurfaceTag::Epicardium, "Distance of the epicardium"),
        BullsEye {
            title: "Work of the image forces".into(),
            unit: "mJ".into(),
            values: by_segment(segment_work_mj(anatomy, motion).into_iter()),
            scale: Scale::Sequential,
        },
    ];
    let eyes: Vec<BullsEye> = eyes.into_iter().filter(|eye| eye.values.iter().any(Option::is_some)).collect();
    let mut plots = vec![Block::Plot(residual_plot(clock, motion)), Block::Bars(work_bars(anatomy, motion))];
    plots.extend((validation.len() > 3).then(|| Block::Plot(agreement_plot(clock, validation))));
    let mut blocks = vec![Block::Text(about.into()), Block::Beside(plots), Block::BullsEyes(eyes)];
    if !validation.is_empty() {
        let table = Block::Table(Table::of_rows("Against labels that nothing was fitted to", validation));
        blocks.push(if validation.len() > 3 { Block::Folded("Every labelled frame".into(), vec![table]) } else { table });
    }
    blocks.push(Block::Folded("Gains and distances in figures".into(), vec![Block::Table(Table::of_record("tracking", summary))]));
    Section { title: "Tracking and discrepancy".into(), blocks }
}

fn residual_plot(clock: &Clock, motion: &TrackedMotion) -> Plot {
    let curve = |&(tag, name, look): &(SurfaceTag, &str, Look)| {
        let rms = |frame: &crate::tracking::TrackedFrame| frame.residuals.iter().find(|r| r.tag == tag && r.found > 0).map(|r| r.rms_mm);
        let points = motion.frames.iter().filter_map(|frame| Some((frame.time_s - clock.last_trigger_s(), rms(frame)?)));
        Curve { name: name.into(), look, points: points.collect() }
    };
    let curves: Vec<Curve> = SURFACES.iter().map(curve).filter(|curve| !curve.points.is_empty()).collect();
    Plot::over_time("Distance of the tracked surfaces from the boundaries", "RMS distance (mm)", &curves)
}

/// How the tracked cavity agrees with labels that nothing was fitted to.
fn agreement_plot(clock: &Clock, validation: &[ValidationSummary]) -> Plot {
    let curve = |name: &str, look, value: fn(&ValidationSummary) -> f64| {
        let at = |one: &ValidationSummary| Some((clock.times_s[clock.position_of(one.frame)?] - clock.last_trigger_s(), value(one)));
        let mut points: Vec<(f64, f64)> = validation.iter().filter_map(at).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Curve { name: name.into(), look, points }
    };
    let curves = [curve("tracked", Look::Tracked, |one| one.dice_tracked), curve("mesh at rest", Look::Initial, |one| one.dice_no_motion)];
    Plot::over_time("The LV cavity against labels that nothing was fitted to", "Dice coefficient", &curves)
}

fn work_bars(anatomy: &Anatomy, motion: &TrackedMotion) -> Bars {
    let bar = |(name, value): (String, f64)| Bar {
        name: name.replace('_', " ").replace("lv", "LV").replace("rv", "RV"),
        value,
        ..Bar::default()
    };
    Bars {
        title: "Work of the image forces by region".into(),
        quantity: "magnitude over the beat (mJ)".into(),
        beside: None,
        bars: region_work_mj(anatomy, motion).into_iter().map(bar).collect(),
    }
}

/// Root mean square distance of a surface's boundary points over the beat, by segment.
fn distance_eye(anatomy: &Anatomy, motion: &TrackedMotion, tag: SurfaceTag, title: &str) -> BullsEye {
    let segment_of = vertex_segments(anatomy);
    let mut distances: Vec<Vec<f64>> = vec![Vec::new(); 18];
    let targets = motion.frames.iter().flat_map(|frame| &frame.targets).filter(|targets| targets.tag == tag);
    for target in targets.flat_map(|targets| &targets.targets) {
        distances[usize::from(segment_of[target.vertex])].push(target.signed_distance_mm);
    }
    let of_segment = (1u8..).zip(&distances[1..]).filter(|(_, found)| !found.is_empty());
    let values = by_segment(of_segment.map(|(segment, found)| (segment, root_mean_square(found))));
    BullsEye { title: title.into(), unit: "mm RMS".into(), values, scale: Scale::Sequential }
}

/// The segment that every vertex belongs to: that of the last of its tetrahedra that has one, 0 where none.
fn vertex_segments(anatomy: &Anatomy) -> Vec<u8> {
    let mut segments = vec![0; anatomy.mesh.vertex_count()];
    for (&segment, corners) in anatomy.aha_segments.iter().zip(anatomy.mesh.tetrahedra()) {
        if (1..=17).contains(&segment) {
            corners.iter().for_each(|&vertex| segments[vertex] = segment);
        }
    }
    segments
}
