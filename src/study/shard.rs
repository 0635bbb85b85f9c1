//! A part of a study's runs, so that several machines share them: the i-th of n takes every n-th run.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// The `number`-th (from 1) of `count` parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    number: usize,
    count: usize,
}

impl Shard {
    /// Whether a run (from 0) is of this part.
    pub fn holds(self, run: usize) -> bool {
        run % self.count == self.number - 1
    }

    /// The name of a table of this part: `runs.csv` becomes `runs_2_of_8.csv`.
    pub(super) fn file_name(shard: Option<Self>, table: &str) -> String {
        shard.map_or_else(|| format!("{table}.csv"), |Self { number, count }| format!("{table}_{number}_of_{count}.csv"))
    }

    /// The names of all parts' tables in a folder.
    pub(super) fn files(folder: &Path, table: &str) -> Vec<String> {
        let names = std::fs::read_dir(folder).into_iter().flatten().flatten().filter_map(|entry| entry.file_name().into_string().ok());
        let is_part = |name: &String| {
            let part = name.strip_prefix(table).and_then(|rest| rest.strip_prefix('_')?.strip_suffix(".csv"));
            part.is_some_and(|part| part.replacen("_of_", "/", 1).parse::<Self>().is_ok())
        };
        let mut names: Vec<String> = names.filter(is_part).collect();
        names.sort();
        names
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(number, count)| Some((number.parse().ok()?, count.parse().ok()?)));
        match parts {
            Some((number, count)) if (1..=count).contains(&number) => Ok(Self { number, count }),
            _ => Err("write the number of the part and how many there are, such as 2/8".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_are_disjoint_and_make_the_whole() {
        let shards: Vec<Shard> = ["1/3", "2/3", "3/3"].iter().map(|text| text.parse().unwrap()).collect();
        for run in 0..20 {
            assert_eq!(shards.iter().filter(|shard| shard.holds(run)).count(), 1);
        }
        assert_eq!(Shard::file_name(Some(shards[1]), "runs"), "runs_2_of_3.csv");
        assert_eq!(Shard::file_name(None, "runs"), "runs.csv");
        for wrong in ["0/3", "4/3", "1", "1/0", "a/b", ""] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }
}
