//! What a calibration has computed, point by point: whoever searches again with it goes the same way without simulating.
//!
//! Every search here is a deterministic function of the rows and Jacobians that it asks for, so a journal is a checkpoint of any of them,
//! exact to the last bit, and outlives a crash. (argmin's own checkpoints keep the state of a solver, which not all of its solvers can give.)

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;
use std::sync::{Mutex, MutexGuard, PoisonError};

use nalgebra::{DMatrix, DVector};

/// What came out at a point.
#[derive(Debug, Clone, PartialEq)]
pub enum Computed {
    /// The rows of the data.
    Rows(DVector<f64>),
    /// Their Jacobian, rows × coordinates.
    Jacobian(DMatrix<f64>),
    /// The simulation failed, with its own words.
    Failure(String),
}

/// One point of a search. As text it is one line: a word, the number of coordinates, they, then what came out; numbers come back bit by bit.
#[derive(Debug, Clone, PartialEq)]
pub struct JournalEntry {
    /// θ.
    pub coordinates: DVector<f64>,
    /// What came out there.
    pub computed: Computed,
}

/// A line that is no entry.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a line of the journal is no entry; it was cut off or changed")]
pub struct NoEntry;

impl fmt::Display for JournalEntry {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = match self.computed {
            Computed::Rows(_) => "rows",
            Computed::Jacobian(_) => "jacobian",
            Computed::Failure(_) => "failure",
        };
        write!(out, "{word} {}", self.coordinates.len())?;
        self.coordinates.iter().try_for_each(|value| write!(out, " {value:e}"))?;
        match &self.computed {
            Computed::Rows(rows) => rows.iter().try_for_each(|value| write!(out, " {value:e}"))?,
            Computed::Jacobian(matrix) => matrix.iter().try_for_each(|value| write!(out, " {value:e}"))?,
            Computed::Failure(words) => return write!(out, " {}", words.replace('\n', " ")),
        }
        // A line that was cut off has no full stop.
        write!(out, " .")
    }
}

impl FromStr for JournalEntry {
    type Err = NoEntry;

    fn from_str(line: &str) -> Result<Self, NoEntry> {
        let mut words = line.split(' ');
        let (kind, count) = (words.next().ok_or(NoEntry)?, words.next().and_then(|word| word.parse::<usize>().ok()).ok_or(NoEntry)?);
        let number = |word: &str| word.parse::<f64>().map_err(|_| NoEntry);
        let coordinates: Vec<f64> = words.by_ref().take(count).map(number).collect::<Result<_, _>>()?;
        if coordinates.len() != count || count == 0 {
            return Err(NoEntry);
        }
        let rest: Vec<&str> = words.collect();
        let numbers = || match rest.split_last() {
            Some((&".", numbers)) => numbers.iter().map(|word| number(word)).collect::<Result<Vec<f64>, _>>(),
            _ => Err(NoEntry),
        };
        let computed = match kind {
            "rows" => Computed::Rows(DVector::from_vec(numbers()?)),
            "jacobian" => {
                let numbers = numbers()?;
                if !numbers.len().is_multiple_of(count) {
                    return Err(NoEntry);
                }
                Computed::Jacobian(DMatrix::from_vec(numbers.len() / count, count, numbers))
            }
            "failure" => Computed::Failure(rest.join(" ")),
            _ => return Err(NoEntry),
        };
        Ok(Self { coordinates: DVector::from_vec(coordinates), computed })
    }
}

/// What is known at a point.
#[derive(Debug, Clone, Default)]
struct Known {
    rows: Option<Result<DVector<f64>, String>>,
    jacobian: Option<DMatrix<f64>>,
    /// Whether this search has asked for it, and has been charged with it.
    is_charged: [bool; 2],
}

/// Everything computed so far, and what it cost in simulations.
#[derive(Default)]
pub struct Journal<'a> {
    known: Mutex<(BTreeMap<Vec<u64>, Known>, f64)>,
    sink: Option<&'a (dyn Fn(&JournalEntry) + Sync)>,
}

impl<'a> Journal<'a> {
    /// A journal that holds `entries` already, and tells `sink` of everything new.
    pub fn new(entries: impl IntoIterator<Item = JournalEntry>, sink: &'a (dyn Fn(&JournalEntry) + Sync)) -> Self {
        let journal = Self { sink: Some(sink), ..Self::default() };
        entries.into_iter().for_each(|entry| journal.keep(&entry));
        journal
    }

    /// Simulations spent, of which a linearisation counts as several; what an earlier search computed counts when it is asked for.
    pub fn spent(&self) -> f64 {
        self.lock().1
    }

    /// Rows or failure at a point, if they are known; charges for them on the first call.
    pub(super) fn rows(&self, coordinates: &DVector<f64>) -> Option<Result<DVector<f64>, String>> {
        let mut guard = self.lock();
        let (known, spent) = &mut *guard;
        let entry = known.get_mut(&bits(coordinates))?;
        let rows = entry.rows.clone()?;
        *spent += if std::mem::replace(&mut entry.is_charged[0], true) { 0.0 } else { 1.0 };
        Some(rows)
    }

    /// The Jacobian at a point, if it is known; charges `cost` for it on the first call.
    pub(super) fn jacobian(&self, coordinates: &DVector<f64>, cost: f64) -> Option<DMatrix<f64>> {
        let mut guard = self.lock();
        let (known, spent) = &mut *guard;
        let entry = known.get_mut(&bits(coordinates))?;
        let jacobian = entry.jacobian.clone()?;
        *spent += if std::mem::replace(&mut entry.is_charged[1], true) { 0.0 } else { cost };
        Some(jacobian)
    }

    /// Keeps what was computed, and tells the sink.
    pub(super) fn write(&self, entry: &JournalEntry) {
        self.keep(entry);
        if let Some(sink) = self.sink {
            sink(entry);
        }
    }

    fn keep(&self, entry: &JournalEntry) {
        let mut guard = self.lock();
        let known = guard.0.entry(bits(&entry.coordinates)).or_default();
        match &entry.computed {
            Computed::Rows(rows) => known.rows = Some(Ok(rows.clone())),
            Computed::Failure(words) => known.rows = Some(Err(words.clone())),
            Computed::Jacobian(jacobian) => known.jacobian = Some(jacobian.clone()),
        }
    }

    fn lock(&self) -> MutexGuard<'_, (BTreeMap<Vec<u64>, Known>, f64)> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn bits(coordinates: &DVector<f64>) -> Vec<u64> {
    coordinates.iter().map(|value| value.to_bits()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_come_back_bit_by_bit_and_lines_that_were_cut_off_do_not() {
        let coordinates = DVector::from_vec(vec![std::f64::consts::PI, -1e-300]);
        let jacobian = DMatrix::from_fn(3, 2, |row, column| (row as f64 + 0.1).powf(column as f64 + 0.3));
        let computed = [
            Computed::Rows(DVector::from_vec(vec![0.1 + 0.2, -0.0])),
            Computed::Jacobian(jacobian),
            Computed::Failure("it blew up".into()),
        ];
        for computed in computed {
            let entry = JournalEntry { coordinates: coordinates.clone(), computed };
            let line = entry.to_string();
            assert_eq!(line.parse::<JournalEntry>().unwrap(), entry);
            if !matches!(entry.computed, Computed::Failure(_)) {
                assert_eq!(line[..line.len() - 4].parse::<JournalEntry>(), Err(NoEntry), "{line}");
            }
        }
        assert_eq!("rows 0 .".parse::<JournalEntry>(), Err(NoEntry));
        assert_eq!("wows 1 2.0 3.0 .".parse::<JournalEntry>(), Err(NoEntry));
    }

    #[test]
    fn what_is_known_is_charged_once() {
        let journal = Journal::default();
        let coordinates = DVector::from_vec(vec![1.0, 2.0]);
        assert!(journal.rows(&coordinates).is_none());
        journal.write(&JournalEntry { coordinates: coordinates.clone(), computed: Computed::Rows(DVector::zeros(3)) });
        journal.write(&JournalEntry { coordinates: coordinates.clone(), computed: Computed::Jacobian(DMatrix::zeros(3, 2)) });
        for _ in 0..2 {
            assert!(journal.rows(&coordinates).is_some() && journal.jacobian(&coordinates, 2.0).is_some());
        }
        assert_eq!(journal.spent(), 3.0);
    }
}
