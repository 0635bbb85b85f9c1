//! `cardiotwin info`: what an image shows, as a table or as JSON.

use std::fmt::Write;

use anyhow::Context;

use super::arguments::InfoArguments;
use super::exit::Exit;
use super::print;
use crate::image::{CineTiming, ImageSummary, summarise};
use crate::units::MS_PER_S;

/// Prints a summary of every image at a path.
pub(super) fn show(arguments: &InfoArguments) -> anyhow::Result<Exit> {
    let timing = arguments.timing.as_deref().map(CineTiming::from_sidecar).transpose()?.unwrap_or_default();
    let summaries = summarise(&arguments.path, &timing)?;
    if arguments.json {
        let text = serde_json::to_string_pretty(&summaries).context("cannot write the summary as JSON")?;
        print(&format!("{text}\n"))?;
    } else {
        print(&summaries.iter().map(table).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(Exit::Done)
}

/// One topic a line.
fn table(summary: &ImageSummary) -> String {
    let mut text = String::new();
    let mut line = |topic: &str, words: String| {
        let _ = writeln!(text, "{topic:<13}{words}");
    };
    let [ni, nj, nk] = summary.shape;
    let [si, sj, sk] = summary.spacing_mm;
    let [x, y, z] = summary.centre_mm;
    line("image", summary.name.clone());
    line("grid", format!("{ni} × {nj} × {nk} voxels of {si:.3} × {sj:.3} × {sk:.3} mm"));
    line("orientation", format!("{}, up to {:.1}° oblique", summary.orientation, summary.obliquity_deg));
    line("centre", format!("({x:.1}, {y:.1}, {z:.1}) mm RAS"));
    line("frames", frames(summary));
    line("values", format!("{} to {}", summary.intensity_range[0], summary.intensity_range[1]));
    for label in &summary.labels {
        let (least, most) = label.volumes_ml.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), &ml| (least.min(ml), most.max(ml)));
        let volume = if label.volumes_ml.len() > 1 { format!("{least:.1} to {most:.1} mL") } else { format!("{most:.1} mL") };
        line("label", format!("{}: {volume}", label.code));
    }
    if !summary.slice_shifts_mm.is_empty() {
        let words = |shift: &Option<[f64; 2]>| shift.map_or("?".into(), |[i, j]| format!("{:.1}", i.hypot(j)));
        let shifts: Vec<String> = summary.slice_shifts_mm.iter().map(words).collect();
        line("slice shifts", format!("{} mm (?: not estimable)", shifts.join(" ")));
    }
    for warning in &summary.warnings {
        line("warning", warning.clone());
    }
    text
}

fn frames(summary: &ImageSummary) -> String {
    match (summary.frame_times_s.as_slice(), summary.period_s) {
        ([first_s, .., last_s], Some(period_s)) => format!(
            "{} from {:.1} to {:.1} ms after the trigger, RR {:.1} ms ({:.0} beats/min)",
            summary.frame_count,
            first_s * MS_PER_S,
            last_s * MS_PER_S,
            period_s * MS_PER_S,
            60.0 / period_s
        ),
        _ => summary.frame_count.to_string(),
    }
}
