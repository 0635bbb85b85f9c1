//! A table that grows a row at a time and may be cut off at any byte: what a study knows of its runs, and where it takes them up again.
//!
//! The last column, `seal`, holds the hash of what the row belongs to and, bound to it, of the row itself: a row that was cut off, garbled or
//! carried over from another study is told from a good one, and is as if it were not there.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::{ReportError, fingerprint_on, write_atomically};

/// Name of the last column.
const SEAL: &str = "seal";

/// A row of a ledger.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LedgerRow {
    /// The hash of what it belongs to.
    pub owner: u64,
    /// Its fields without the seal; the first is its key.
    pub fields: Vec<String>,
}

impl LedgerRow {
    /// Sixteen hexadecimal digits of the owner, and sixteen of owner and fields.
    fn seal(&self) -> String {
        let start = fingerprint_on(super::FINGERPRINT_START, &self.owner.to_le_bytes());
        let own = self.fields.iter().fold(start, |hash, field| fingerprint_on(fingerprint_on(hash, field.as_bytes()), b"\x1f"));
        format!("{:016x}{own:016x}", self.owner)
    }

    /// The row that a record is; none where its seal does not fit.
    fn from_record(record: &csv::StringRecord) -> Option<Self> {
        let mut fields: Vec<String> = record.iter().map(str::to_string).collect();
        let seal = fields.pop()?;
        let owner = u64::from_str_radix(seal.get(..16)?, 16).ok()?;
        let row = Self { owner, fields };
        (row.seal() == seal).then_some(row)
    }
}

/// What a ledger held.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LedgerContents {
    /// The good rows by their keys; the last of equal ones.
    pub rows: BTreeMap<String, LedgerRow>,
    /// Rows that were cut off or garbled.
    pub damaged_count: usize,
    /// Whether the columns are others than expected; no rows then.
    pub has_other_columns: bool,
}

impl LedgerContents {
    /// Reads a ledger; one that is not there is empty.
    ///
    /// # Errors
    /// [`ReportError::Read`] if the file is there and cannot be read.
    pub fn read(file: &Path, columns: &[String]) -> Result<Self, ReportError> {
        let unreadable = |source| ReportError::Read { file: file.to_path_buf(), source };
        let mut contents = Self::default();
        let bytes = match std::fs::read(file) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(contents),
            Err(error) => return Err(unreadable(error)),
        };
        // Line by line, so that a stray quotation mark garbles no more than its own.
        let text = String::from_utf8_lossy(&bytes);
        let mut lines = text.lines();
        let Some(header) = lines.next() else { return Ok(contents) };
        if header != header_of(columns).trim_end() {
            contents.has_other_columns = true;
            return Ok(contents);
        }
        for line in lines {
            match parsed(line).as_ref().and_then(LedgerRow::from_record) {
                Some(row) => drop(contents.rows.insert(row.fields[0].clone(), row)),
                None => contents.damaged_count += 1,
            }
        }
        Ok(contents)
    }
}

fn parsed(line: &str) -> Option<csv::StringRecord> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(line.as_bytes());
    reader.records().next()?.ok()
}

fn as_line<'f>(fields: impl Iterator<Item = &'f str>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    // Writing into memory does not fail.
    let bytes = writer.write_record(fields).ok().and_then(|()| writer.into_inner().ok()).unwrap_or_default();
    String::from_utf8_lossy(&bytes).into_owned()
}

fn header_of(columns: &[String]) -> String {
    as_line(columns.iter().map(String::as_str).chain([SEAL]))
}

fn line_of(row: &LedgerRow) -> String {
    let seal = row.seal();
    as_line(row.fields.iter().map(String::as_str).chain([seal.as_str()]))
}

/// A ledger that rows are added to, from any thread.
#[derive(Debug)]
pub struct Ledger {
    file: PathBuf,
    appended: Mutex<File>,
}

impl Ledger {
    /// Opens a ledger that holds these rows and no others.
    ///
    /// # Errors
    /// [`ReportError::Write`].
    pub fn open<'r>(file: &Path, columns: &[String], rows: impl Iterator<Item = &'r LedgerRow>) -> Result<Self, ReportError> {
        Self::write(file, columns, rows)?;
        let appended = OpenOptions::new().append(true).open(file);
        let appended = appended.map_err(|source| ReportError::Write { file: file.to_path_buf(), source })?;
        Ok(Self { file: file.to_path_buf(), appended: Mutex::new(appended) })
    }

    /// Adds a row.
    ///
    /// # Errors
    /// [`ReportError::Write`]; what was written of the row by then is told from a good one when the ledger is read.
    pub fn append(&self, row: &LedgerRow) -> Result<(), ReportError> {
        let mut appended = self.appended.lock().unwrap_or_else(PoisonError::into_inner);
        appended.write_all(line_of(row).as_bytes()).map_err(|source| ReportError::Write { file: self.file.clone(), source })
    }

    /// Writes a whole ledger, its rows in the order given.
    ///
    /// # Errors
    /// [`ReportError::Write`].
    pub fn write<'r>(file: &Path, columns: &[String], rows: impl Iterator<Item = &'r LedgerRow>) -> Result<(), ReportError> {
        write_atomically(file, |out| {
            out.write_all(header_of(columns).as_bytes())?;
            rows.into_iter().try_for_each(|row| out.write_all(line_of(row).as_bytes()))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns() -> Vec<String> {
        ["run", "reason"].map(str::to_string).to_vec()
    }

    fn row(key: usize) -> LedgerRow {
        LedgerRow { owner: 7, fields: vec![key.to_string(), format!("said \"{key}\", and no more")] }
    }

    /// Cut off at any byte, a ledger gives back rows that were written, each as it was, and at most one is lost that had been begun.
    #[test]
    fn a_ledger_cut_off_anywhere_gives_back_whole_rows_only() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("runs.csv");
        let ledger = Ledger::open(&file, &columns(), [row(0)].iter()).unwrap();
        (1..4).for_each(|key| ledger.append(&row(key)).unwrap());
        let whole = std::fs::read(&file).unwrap();
        let line = line_of(&row(0)).len();
        let header = header_of(&columns()).len();
        for length in 0..=whole.len() {
            std::fs::write(&file, &whole[..length]).unwrap();
            let found = LedgerContents::read(&file, &columns()).unwrap();
            assert!(found.rows.values().enumerate().all(|(key, found)| *found == row(key)), "{length}");
            // A row without its line's end is whole too.
            assert!(found.rows.len() >= length.saturating_sub(header) / line, "{length}: {found:?}");
            assert!(found.damaged_count <= 1, "{length}");
        }
    }

    #[test]
    fn garbled_rows_are_counted_and_those_behind_them_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("runs.csv");
        let rows = [row(0), row(1), row(2)];
        Ledger::write(&file, &columns(), rows.iter()).unwrap();
        let text = std::fs::read_to_string(&file).unwrap().replace("said \"\"1", "sad \"1");
        std::fs::write(&file, text).unwrap();
        let found = LedgerContents::read(&file, &columns()).unwrap();
        assert_eq!((found.rows.len(), found.damaged_count), (2, 1));
        assert!(LedgerContents::read(&file, &columns()[..1]).unwrap().has_other_columns);
        assert_eq!(LedgerContents::read(&folder.path().join("none.csv"), &columns()).unwrap(), LedgerContents::default());
    }

    /// A row that another study left is good in itself, and says whose it is.
    #[test]
    fn a_row_names_its_owner_and_cannot_be_given_another() {
        let own = row(3);
        let line = line_of(&own);
        assert_eq!(LedgerRow::from_record(&parsed(line.trim_end()).unwrap()), Some(own));
        let passed_on = line.replace("0000000000000007", "0000000000000008");
        assert_eq!(LedgerRow::from_record(&parsed(passed_on.trim_end()).unwrap()), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_told() {
        let full = OpenOptions::new().append(true).open("/dev/full").unwrap();
        let ledger = Ledger { file: "runs.csv".into(), appended: Mutex::new(full) };
        let error = ledger.append(&row(0)).unwrap_err();
        assert!(error.to_string().contains("runs.csv; see that its folder is writable and the disk is not full"), "{error}");
    }
}
