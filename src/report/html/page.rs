//! The page: sections of blocks, put into the template with its style, its script and, where a mesh is shown, the library for it.

use std::fmt::Write;
use std::io;
use std::path::Path;

use serde::Serialize;

use super::bars::Bars;
use super::bulls_eye::BullsEye;
use super::colour::{Scale, hex};
use super::escape::{escaped, script_json};
use super::heart::{BeatingHeart, HeartRecord};
use super::intervals::Intervals;
use super::matrix::CorrelationMatrix;
use super::plot::{Plot, Scatter};
use super::slices::{SliceRecord, Slices};
use super::table::Table;
use crate::report::{ReportError, write_atomically};
use crate::units::MS_PER_S;

const TEMPLATE: &str = include_str!("template.html");
const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("report.js");
const LIBRARY: &str = include_str!("vendor/three.min.js");

/// What a report shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
    /// Name of the study.
    pub title: String,
    /// What was asked, in a sentence.
    pub question: String,
    /// How it ended, in words, and whether that is good.
    pub status: (String, bool),
    /// Sections from top to bottom.
    pub sections: Vec<Section>,
    /// Times of the frames that slices and mesh are shown at, s after the trigger.
    pub frame_times_s: Vec<f64>,
    /// What the result came from: names and values.
    pub provenance: Vec<(String, String)>,
}

/// A part of the page with a heading; one without blocks is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// What it shows.
    pub blocks: Vec<Block>,
}

/// A piece of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A paragraph.
    Text(String),
    /// A list of sentences.
    List(Vec<String>),
    /// Sentences that the reader should not miss.
    Warnings(Vec<String>),
    /// Other files of the results: names and places relative to the page.
    Links(Vec<(String, String)>),
    /// Numbers in large type.
    KeyFigures(Vec<KeyFigure>),
    /// A table.
    Table(Table),
    /// Curves.
    Plot(Plot),
    /// Points.
    Scatter(Scatter),
    /// Bars.
    Bars(Bars),
    /// Parameters on their bounds.
    Intervals(Intervals),
    /// Correlations.
    Correlations(CorrelationMatrix),
    /// Bull's-eye plots, side by side.
    BullsEyes(Vec<BullsEye>),
    /// Slices through the beat; the page's frames are its columns.
    Slices(Slices),
    /// The beating mesh at the page's frames.
    Heart(BeatingHeart),
    /// Blocks side by side, where there is room.
    Beside(Vec<Block>),
    /// Blocks that are shown on demand, under a name.
    Folded(String, Vec<Block>),
}

/// A number in large type.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct KeyFigure {
    /// What it is.
    pub name: String,
    /// Its value.
    pub value: String,
    /// Its unit.
    pub unit: String,
    /// What it compares with.
    pub beside: Option<String>,
}

/// What the script reads.
#[derive(Serialize)]
struct ScriptRecord {
    times_ms: Vec<f64>,
    slices: Option<SliceRecord>,
    heart: Option<HeartRecord>,
    colours: Vec<(Scale, Vec<String>)>,
}

/// Writes the page as one file that needs no other.
///
/// # Errors
/// [`ReportError::Write`].
pub fn write_page(file: &Path, page: &Page) -> Result<(), ReportError> {
    write_atomically(file, |out| out.write_all(html(page)?.as_bytes()))
}

/// The page as HTML.
pub(super) fn html(page: &Page) -> io::Result<String> {
    let shown: Vec<&Section> = page.sections.iter().filter(|section| !section.blocks.is_empty()).collect();
    let blocks = || shown.iter().flat_map(|section| &section.blocks).flat_map(Block::leaves);
    let slices = blocks().find_map(|block| if let Block::Slices(slices) = block { Some(slices) } else { None });
    let heart = blocks().find_map(|block| if let Block::Heart(heart) = block { Some(heart) } else { None });
    let colours = [Scale::Sequential, Scale::Diverging].map(|scale| (scale, scale.colours().iter().copied().map(hex).collect()));
    let record = ScriptRecord {
        times_ms: page.frame_times_s.iter().map(|time_s| time_s * MS_PER_S).collect(),
        slices: slices.map(Slices::record).transpose()?,
        heart: heart.map(BeatingHeart::record),
        colours: colours.into(),
    };
    let contents: String =
        shown.iter().enumerate().map(|(n, section)| format!("<li><a href=\"#s{n}\">{}</a></li>", escaped(&section.title))).collect();
    let library = if heart.is_some() { format!("<script>{LIBRARY}</script>") } else { String::new() };
    let is_moving = (slices.is_some() || heart.is_some()) && page.frame_times_s.len() > 1;
    let parts = [
        ("title", escaped(&page.title)),
        ("question", escaped(&page.question)),
        ("status", escaped(&page.status.0)),
        ("status_class", if page.status.1 { "good" } else { "bad" }.to_owned()),
        ("style", STYLE.to_owned()),
        ("contents", contents),
        ("sections", shown.iter().enumerate().map(|(n, section)| section_html(n, section)).collect()),
        ("controls", if is_moving { controls(page.frame_times_s.len()) } else { String::new() }),
        ("provenance", provenance(&page.provenance)),
        ("data", script_json(&record)?),
        ("library", library),
        ("script", SCRIPT.to_owned()),
    ];
    Ok(filled(TEMPLATE, &parts))
}

/// The template with its `{{names}}` replaced in one pass, so that nothing within a part is taken for a name.
fn filled(template: &str, parts: &[(&str, String)]) -> String {
    let mut pieces = template.split("{{");
    let mut text = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (name, rest) = piece.split_once("}}").unwrap_or(("", piece));
        text.extend(parts.iter().filter(|(own, _)| *own == name).map(|(_, part)| part.as_str()));
        text.push_str(rest);
    }
    text
}

fn section_html(number: usize, section: &Section) -> String {
    let blocks: String = section.blocks.iter().map(Block::html).collect();
    format!(
        "<section id=\"s{number}\" aria-labelledby=\"h{number}\"><h2 id=\"h{number}\">{}</h2>{blocks}</section>",
        escaped(&section.title)
    )
}

fn controls(frame_count: usize) -> String {
    let last = frame_count - 1;
    format!(
        "<div id=\"controls\" role=\"group\" aria-label=\"The instant of the beat that slices and mesh show\">\
         <button type=\"button\" id=\"play\" aria-pressed=\"false\">Play</button>\
         <input type=\"range\" id=\"frame\" min=\"0\" max=\"{last}\" step=\"1\" value=\"0\" aria-label=\"Frame\">\
         <output id=\"instant\" for=\"frame\"></output>\
         <label>Speed <select id=\"speed\"><option value=\"1\">as in life</option><option value=\"0.5\" selected>half</option>\
         <option value=\"0.2\">a fifth</option></select></label></div>"
    )
}

fn provenance(entries: &[(String, String)]) -> String {
    let entry = |(name, value): &(String, String)| format!("<dt>{}</dt><dd>{}</dd>", escaped(name), escaped(value));
    entries.iter().map(entry).collect()
}

fn list(class: &str, lines: &[String]) -> String {
    let items: String = lines.iter().map(|line| format!("<li>{}</li>", escaped(line))).collect();
    format!("<ul class=\"{class}\">{items}</ul>")
}

impl KeyFigure {
    fn html(&self) -> String {
        let beside = self.beside.as_ref().map(|text| format!("<span class=\"beside\">{}</span>", escaped(text))).unwrap_or_default();
        let [name, value, unit] = [&self.name, &self.value, &self.unit].map(|text| escaped(text));
        format!("<div><dt>{name}</dt><dd>{value}<span class=\"unit\"> {unit}</span>{beside}</dd></div>")
    }
}

impl Block {
    /// Itself, or the blocks within.
    fn leaves(&self) -> Vec<&Self> {
        match self {
            Self::Beside(inner) | Self::Folded(_, inner) => inner.iter().flat_map(Self::leaves).collect(),
            leaf => vec![leaf],
        }
    }

    fn html(&self) -> String {
        let all = |blocks: &[Self]| blocks.iter().map(Self::html).collect::<String>();
        match self {
            Self::Text(text) => format!("<p>{}</p>", escaped(text)),
            Self::List(lines) => list("", lines),
            Self::Warnings(lines) => list("warnings", lines),
            Self::Links(links) => {
                let item = |(name, place): &(String, String)| format!("<li><a href=\"{}\">{}</a></li>", escaped(place), escaped(name));
                format!("<ul>{}</ul>", links.iter().map(item).collect::<String>())
            }
            Self::KeyFigures(figures) => format!("<dl class=\"key\">{}</dl>", figures.iter().map(KeyFigure::html).collect::<String>()),
            Self::Table(table) => table.html(),
            Self::Plot(plot) => plot.html(),
            Self::Scatter(scatter) => scatter.html(),
            Self::Bars(bars) => bars.html(),
            Self::Intervals(intervals) => intervals.html(),
            Self::Correlations(matrix) => matrix.html(),
            Self::BullsEyes(plots) => format!("<div class=\"eyes\">{}</div>", plots.iter().map(BullsEye::html).collect::<String>()),
            Self::Slices(_) => include_str!("slices.html").to_owned(),
            Self::Heart(_) => include_str!("heart.html").to_owned(),
            Self::Beside(blocks) => {
                let are_small = blocks.iter().all(|block| matches!(block, Self::Scatter(_)));
                format!("<div class=\"columns{}\">{}</div>", if are_small { " thirds" } else { "" }, all(blocks))
            }
            Self::Folded(name, blocks) => {
                let mut html = String::new();
                let _ = write!(html, "<details><summary>{}</summary>{}</details>", escaped(name), all(blocks));
                html
            }
        }
    }
}

#[cfg(test)]
mod tests;
