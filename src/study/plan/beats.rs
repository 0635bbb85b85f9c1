//! `[simulation]`: how many beats, and at how many instants of the last one the heart is looked at.

use crate::heart::Periodicity;
use crate::study::reader::TableReader;

/// The beats of a run; results are of the last one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeatsPlan {
    /// `beats`: beats from the time of the anatomy.
    pub beats: Beats,
    /// `frames`: instants of the last beat at which the mesh is written and strains are read, where no images say when.
    pub frames: usize,
}

/// How many beats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beats {
    /// As many as asked.
    Count(usize),
    /// Until two repeat each other.
    Periodic(Periodicity),
}

impl Beats {
    /// The number asked for; one where the beats end when they repeat.
    pub fn count(self) -> usize {
        match self {
            Self::Count(count) => count,
            Self::Periodic(_) => 1,
        }
    }
}

pub(super) fn read(table: TableReader) -> BeatsPlan {
    let default = Periodicity::default();
    let (tolerance_ml, beat_limit) = (table.optional_number("tolerance_ml", 1e-9..=100.0), table.optional_count("beat_limit", 2..=1000));
    let is_word = table.is_text("beats");
    let beats = if is_word {
        if table.text("beats") != Some("periodic") {
            table.problem("beats", "is neither a number nor \"periodic\"", "write a whole number from 1 to 1000, or \"periodic\"");
        }
        Beats::Periodic(Periodicity {
            tolerance_ml: tolerance_ml.unwrap_or(default.tolerance_ml),
            beat_limit: beat_limit.unwrap_or(default.beat_limit),
        })
    } else {
        for key in ["tolerance_ml", "beat_limit"].into_iter().filter(|key| table.has(key)) {
            table.problem(key, "is of no use with a number of beats", "write beats = \"periodic\", or take it away");
        }
        Beats::Count(table.count("beats", 1..=1000, 1))
    };
    let plan = BeatsPlan { beats, frames: table.count("frames", 2..=1000, 30) };
    table.close();
    plan
}
