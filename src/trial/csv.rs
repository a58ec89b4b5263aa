//! Trials as CSV (RFC 4180): a header that names the columns, one row per sample.
//!
//! The header's `t`, `r`, `u`, `y`, `d` (in either case, in any order) are the signals; a [`ColumnMapping`] gives a
//! signal another name. Other columns are left out and reported by name. A byte order mark, empty lines at the end,
//! spaces around a number and either line end are tolerated; comment lines, empty lines between rows and empty cells
//! are not.

use super::error::{Location, ReadError};
use super::limits::Limits;
use super::signals::{Channel, Signals, Trial};
use super::{ReadTrial, TrialError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read};

/// No line of numbers is longer; a header or an extra column with text may be long, but not endless.
const MAX_LINE_BYTES: usize = 1024 * 1024;

/// Columns beyond this number are no recording of one trial.
const MAX_COLUMNS: usize = 10_000;

/// The names of a file's columns, where they are not `t`, `r`, `u`, `y`, `d`: `{"command": "target_px"}`.
///
/// A signal with a name here is looked for under exactly that name, and no longer under its letter.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ColumnMapping {
    /// Column of the time in seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
    /// Column of the command r.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
    /// Column of the control u.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control: Option<String>,
    /// Column of the output y.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output: Option<String>,
    /// Column of the disturbance d.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disturbance: Option<String>,
}

impl ColumnMapping {
    fn name(&self, channel: Channel) -> Option<&str> {
        match channel {
            Channel::Time => self.time.as_deref(),
            Channel::Command => self.command.as_deref(),
            Channel::Control => self.control.as_deref(),
            Channel::Output => self.output.as_deref(),
            Channel::Disturbance => self.disturbance.as_deref(),
        }
    }
}

/// How a CSV file is read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Names of the columns, where they are not the usual letters.
    pub columns: ColumnMapping,
    /// The sample time; needed where there is no time column, checked against it where there is one.
    pub sample_time_s: Option<f64>,
    /// How much is read.
    pub limits: Limits,
}

/// Reads a trial, row by row: no more than the rows within the limits is ever held.
///
/// # Errors
/// The first [`ReadError`] from the top of the file, with its line (counted from 1, the header included) and column.
pub fn read(source: impl Read, options: &Options) -> Result<ReadTrial, ReadError> {
    let mut lines = Lines::new(source, options.limits.max_bytes);
    let Some(first) = lines.next_record(Vec::new())? else { return Err(ReadError::Empty) };
    if first.text.trim_ascii().is_empty() {
        while let Some(record) = lines.next_record(Vec::new())? {
            if !record.text.trim_ascii().is_empty() {
                return Err(ReadError::BlankLine { line: first.line });
            }
        }
        return Err(ReadError::Empty);
    }
    let header = Header::parse(&first, &options.columns)?;
    let mut table = Table::default();
    let mut blank = None;
    let mut spare = first.text;
    while let Some(record) = lines.next_record(std::mem::take(&mut spare))? {
        if record.text.trim_ascii().is_empty() {
            blank.get_or_insert(record.line);
            spare = record.text;
            continue;
        }
        if let Some(line) = blank {
            return Err(ReadError::BlankLine { line });
        }
        if table.rows() >= options.limits.max_rows {
            return Err(ReadError::TooManyRows { limit: options.limits.max_rows });
        }
        table.push(&header, &record)?;
        spare = record.text;
    }
    if table.rows() == 0 {
        return Err(ReadError::NoRows);
    }
    let trial = table.into_trial(&header, options.sample_time_s)?;
    Ok(ReadTrial { trial, ignored_columns: header.ignored })
}

/// At most 40 characters of a text, for messages.
pub(super) fn shorten(text: &str) -> String {
    const KEPT: usize = 40;
    match text.char_indices().nth(KEPT) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// A record and the line on which it begins.
struct Record {
    line: u64,
    text: Vec<u8>,
}

/// Records of a text: a line, or several where a quoted cell holds line ends.
struct Lines<R> {
    source: BufReader<R>,
    line: u64,
    bytes_left: u64,
    max_bytes: u64,
}

impl<R: Read> Lines<R> {
    fn new(source: R, max_bytes: u64) -> Self {
        Self { source: BufReader::with_capacity(64 * 1024, source), line: 0, bytes_left: max_bytes, max_bytes }
    }

    /// The next record, in the memory of one that is not needed any more.
    fn next_record(&mut self, spare: Vec<u8>) -> Result<Option<Record>, ReadError> {
        let line = self.line + 1;
        let mut text = spare;
        text.clear();
        let mut quotes;
        loop {
            let began = text.len();
            if !self.append_line(line, &mut text)? {
                return if text.is_empty() { Ok(None) } else { Err(ReadError::Quotes { line }) };
            }
            if line == 1 && began == 0 && text.starts_with(b"\xef\xbb\xbf") {
                text.drain(..3);
            }
            quotes = text.iter().filter(|byte| **byte == b'"').count();
            if quotes % 2 == 0 {
                break;
            }
            debug_assert!(text.len() > began, "a line has at least its line end");
        }
        if text.ends_with(b"\n") {
            text.pop();
        }
        if text.ends_with(b"\r") {
            text.pop();
        }
        if quotes == 0 && text.contains(&b'\r') {
            return Err(ReadError::CarriageReturn { line });
        }
        if let Err(error) = std::str::from_utf8(&text) {
            return Err(ReadError::NotUtf8 { line, byte: error.valid_up_to() + 1 });
        }
        Ok(Some(Record { line, text }))
    }

    /// Appends the next line with its line end; false at the end of the text.
    fn append_line(&mut self, record_line: u64, text: &mut Vec<u8>) -> Result<bool, ReadError> {
        let room = (MAX_LINE_BYTES + 1).saturating_sub(text.len()) as u64;
        let allowed = room.min(self.bytes_left.saturating_add(1));
        let count = self.source.by_ref().take(allowed).read_until(b'\n', text)?;
        if count as u64 > self.bytes_left {
            return Err(ReadError::TooManyBytes { limit: self.max_bytes });
        }
        self.bytes_left -= count as u64;
        if text.len() > MAX_LINE_BYTES {
            return Err(ReadError::LineTooLong { line: record_line, limit: MAX_LINE_BYTES });
        }
        self.line += u64::from(count > 0);
        Ok(count > 0)
    }
}

/// The cells of a record; quotes are resolved as RFC 4180 has it.
fn cells(record: &Record) -> Result<Vec<String>, ReadError> {
    let quotes = || ReadError::Quotes { line: record.line };
    if !record.text.contains(&b'"') {
        let text = std::str::from_utf8(&record.text).map_err(|_| ReadError::NotUtf8 { line: record.line, byte: 1 })?;
        return Ok(text.split(',').map(str::to_owned).collect());
    }
    check_quotes(&record.text).ok_or_else(quotes)?;
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(record.text.as_slice());
    let mut cells = csv::StringRecord::new();
    if !reader.read_record(&mut cells).map_err(|_| quotes())? {
        return Err(quotes());
    }
    Ok(cells.iter().map(str::to_owned).collect())
}

/// `None` unless every quoted cell is quoted from its first to its last character. The csv crate would accept more, and
/// guess.
fn check_quotes(text: &[u8]) -> Option<()> {
    let mut i = 0;
    loop {
        if text.get(i) == Some(&b'"') {
            i += 1;
            loop {
                i += text[i..].iter().position(|byte| *byte == b'"')? + 1;
                match text.get(i) {
                    Some(b'"') => i += 1,
                    Some(b',') | None => break,
                    Some(_) => return None,
                }
            }
        } else {
            let end = text[i..].iter().position(|byte| *byte == b',').map_or(text.len(), |n| i + n);
            if text[i..end].contains(&b'"') {
                return None;
            }
            i = end;
        }
        if i >= text.len() {
            return Some(());
        }
        i += 1;
    }
}

/// Which column is which signal.
struct Header {
    names: Vec<String>,
    /// Position of each channel's column, in the order of `Channel::ALL`.
    positions: [Option<usize>; 5],
    ignored: Vec<String>,
}

impl Header {
    fn parse(record: &Record, mapping: &ColumnMapping) -> Result<Self, ReadError> {
        let names: Vec<String> = cells(record)?.iter().map(|name| name.trim().to_owned()).collect();
        if names.iter().all(String::is_empty) {
            return Err(ReadError::NoHeader);
        }
        if names.iter().all(|name| name.parse::<f64>().is_ok()) {
            return Err(ReadError::NoHeader);
        }
        if let [only] = names.as_slice()
            && let Some(delimiter) = [';', '\t', '|'].into_iter().find(|delimiter| only.contains(*delimiter))
        {
            return Err(ReadError::Delimiter { delimiter });
        }
        if names.len() > MAX_COLUMNS {
            return Err(ReadError::LineTooLong { line: 1, limit: MAX_LINE_BYTES });
        }
        refuse_mapped_twice(mapping)?;

        let mut positions = [None; 5];
        let mut missing = Vec::new();
        for (slot, channel) in positions.iter_mut().zip(Channel::ALL) {
            let mapped = mapping.name(channel);
            let fits = |name: &String| match mapped {
                Some(mapped) => name == mapped.trim(),
                // A letter that the mapping gives to another signal is taken.
                None => name.eq_ignore_ascii_case(channel.letter()) && !mapping_takes(mapping, name),
            };
            let mut found = names.iter().enumerate().filter(|(_, name)| fits(name)).map(|(position, _)| position);
            *slot = found.next();
            if let (Some(first), Some(second)) = (*slot, found.next()) {
                let name = names[first].clone();
                return Err(ReadError::DuplicateColumn { name, first: first + 1, second: second + 1 });
            }
            // A time column may be left out where a sample time is given; that is checked with the whole trial.
            let required = mapped.is_some() || !matches!(channel, Channel::Time | Channel::Disturbance);
            if slot.is_none() && required {
                missing.push(mapped.unwrap_or(channel.letter()).to_owned());
            }
        }
        refuse_duplicates(&names)?;
        if !missing.is_empty() {
            return Err(ReadError::MissingColumns { missing, found: names.iter().map(|name| shorten(name)).collect() });
        }
        let ignored = (0..names.len())
            .filter(|position| !positions.contains(&Some(*position)))
            .map(|position| {
                if names[position].is_empty() {
                    format!("(column {}, without a name)", position + 1)
                } else {
                    names[position].clone()
                }
            })
            .collect();
        Ok(Self { names, positions, ignored })
    }

    fn column(&self, slot: usize) -> String {
        self.positions[slot].map_or_else(|| Channel::ALL[slot].letter().to_owned(), |at| self.names[at].clone())
    }
}

fn mapping_takes(mapping: &ColumnMapping, name: &str) -> bool {
    Channel::ALL.into_iter().any(|channel| mapping.name(channel).is_some_and(|mapped| mapped.trim() == name))
}

fn refuse_mapped_twice(mapping: &ColumnMapping) -> Result<(), ReadError> {
    for (i, first) in Channel::ALL.into_iter().enumerate() {
        for second in Channel::ALL.into_iter().skip(i + 1) {
            if let (Some(a), Some(b)) = (mapping.name(first), mapping.name(second))
                && a.trim() == b.trim()
            {
                return Err(ReadError::MappedTwice { name: a.trim().to_owned(), first, second });
            }
        }
    }
    Ok(())
}

fn refuse_duplicates(names: &[String]) -> Result<(), ReadError> {
    let mut seen = std::collections::BTreeMap::new();
    for (position, name) in names.iter().enumerate().filter(|(_, name)| !name.is_empty()) {
        if let Some(first) = seen.insert(name, position) {
            return Err(ReadError::DuplicateColumn { name: name.clone(), first: first + 1, second: position + 1 });
        }
    }
    Ok(())
}

/// The columns as they grow, and the line of every row.
#[derive(Default)]
struct Table {
    columns: [Vec<f64>; 5],
    /// Rows whose line is not the one after the row before, with their line (a quoted cell held a line end). A row
    /// before the first of them is on its number plus 2, since rows count from 0, lines from 1, and there is a header.
    jumps: Vec<(usize, u64)>,
    rows: usize,
}

impl Table {
    fn rows(&self) -> usize {
        self.rows
    }

    fn line(&self, row: usize) -> u64 {
        let (from, line) = self.jumps.iter().rev().find(|(at, _)| *at <= row).copied().unwrap_or((0, 2));
        line + (row - from) as u64
    }

    fn push(&mut self, header: &Header, record: &Record) -> Result<(), ReadError> {
        if self.line(self.rows) != record.line {
            self.jumps.push((self.rows, record.line));
        }
        let (expected, line) = (header.names.len(), record.line);
        if record.text.contains(&b'"') {
            let cells = cells(record)?;
            self.push_cells(header, line, cells.len(), |position| cells[position].as_str())?;
        } else {
            // Nearly every row comes this way, without an allocation per cell.
            let text = std::str::from_utf8(&record.text).map_err(|_| ReadError::NotUtf8 { line, byte: 1 })?;
            let found = text.bytes().filter(|byte| *byte == b',').count() + 1;
            if found != expected {
                return Err(ReadError::Ragged { line, expected, found });
            }
            let mut row = [""; 5];
            for (position, cell) in text.split(',').enumerate() {
                if let Some(slot) = header.positions.iter().position(|at| *at == Some(position)) {
                    row[slot] = cell;
                }
            }
            self.push_row(header, line, row)?;
        }
        self.rows += 1;
        Ok(())
    }

    fn push_cells<'a>(
        &mut self,
        header: &Header,
        line: u64,
        found: usize,
        cell: impl Fn(usize) -> &'a str,
    ) -> Result<(), ReadError> {
        if found != header.names.len() {
            return Err(ReadError::Ragged { line, expected: header.names.len(), found });
        }
        let mut row = [""; 5];
        for (slot, position) in header.positions.iter().enumerate() {
            if let Some(position) = position {
                row[slot] = cell(*position);
            }
        }
        self.push_row(header, line, row)
    }

    fn push_row(&mut self, header: &Header, line: u64, row: [&str; 5]) -> Result<(), ReadError> {
        for (slot, text) in row.into_iter().enumerate() {
            if header.positions[slot].is_some() {
                let value = number(text).map_err(|why| {
                    let (column, text) = (header.column(slot), shorten(text));
                    match why {
                        NoNumber::Empty => ReadError::EmptyCell { line, column },
                        NoNumber::Text => ReadError::NotANumber { line, column, text },
                        NoNumber::NotFinite => ReadError::NotFinite { line, column, text },
                    }
                })?;
                self.columns[slot].push(value);
            }
        }
        Ok(())
    }

    fn into_trial(mut self, header: &Header, sample_time_s: Option<f64>) -> Result<Trial, ReadError> {
        let columns = std::mem::take(&mut self.columns);
        let [time, command, control, output, disturbance] = columns;
        let signals = Signals {
            time_s: header.positions[0].map(|_| time),
            command,
            control,
            output,
            disturbance: header.positions[4].map(|_| disturbance),
        };
        Trial::from_signals(sample_time_s, signals).map_err(|error| {
            let location = self.place(header, &error);
            ReadError::Trial { error, location }
        })
    }

    fn place(&self, header: &Header, error: &TrialError) -> Option<Location> {
        let (channel, sample) = error.place();
        let slot = Channel::ALL.iter().position(|c| Some(*c) == channel)?;
        let column = header.column(slot);
        Some(match sample {
            Some(sample) => Location::Cell { line: self.line(sample), column },
            None => Location::Column(column),
        })
    }
}

enum NoNumber {
    Empty,
    Text,
    NotFinite,
}

fn number(text: &str) -> Result<f64, NoNumber> {
    let text = text.trim();
    if text.is_empty() {
        return Err(NoNumber::Empty);
    }
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(NoNumber::NotFinite),
        // What other programs write for it.
        Err(_)
            if text
                .trim_start_matches(['+', '-', '#'])
                .get(..3)
                .is_some_and(|t| t.eq_ignore_ascii_case("nan") || t.eq_ignore_ascii_case("inf")) =>
        {
            Err(NoNumber::NotFinite)
        }
        Err(_) => Err(NoNumber::Text),
    }
}
