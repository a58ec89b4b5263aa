//! Trials as CSV (RFC 4180): a header that names the columns, one row per sample.
//!
//! The header's `t`, `r`, `u`, `y`, `d` (in either case, in any order) are the signals; a [`ColumnMapping`] gives a
//! signal another name. Other columns are left out and reported by name. A byte order mark, empty lines at the end,
//! spaces around a number and either line end are tolerated; comment lines, empty lines between rows and empty cells
//! are not. Tables that are written otherwise have a [`Dialect`].

mod lines;
mod numbers;

pub use lines::split;
pub use numbers::{is_missing, is_number};

use super::error::{Location, ReadError};
use super::limits::Limits;
use super::signals::{Channel, Signals, Trial};
use super::{ReadTrial, TrialError};
use lines::{Lines, Record, cells};
use numbers::{NoNumber, number};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::Read;

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
    /// The name given for a signal.
    #[must_use]
    pub fn name(&self, channel: Channel) -> Option<&str> {
        match channel {
            Channel::Time => self.time.as_deref(),
            Channel::Command => self.command.as_deref(),
            Channel::Control => self.control.as_deref(),
            Channel::Output => self.output.as_deref(),
            Channel::Disturbance => self.disturbance.as_deref(),
        }
    }

    /// The place for the name of a signal.
    pub fn name_mut(&mut self, channel: Channel) -> &mut Option<String> {
        match channel {
            Channel::Time => &mut self.time,
            Channel::Command => &mut self.command,
            Channel::Control => &mut self.control,
            Channel::Output => &mut self.output,
            Channel::Disturbance => &mut self.disturbance,
        }
    }
}

/// What stands between the cells of a row.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Delimiter {
    /// A comma.
    #[default]
    Comma,
    /// A semicolon.
    Semicolon,
    /// A tab.
    Tab,
    /// A vertical bar.
    Bar,
    /// Any number of spaces and tabs.
    Spaces,
}

impl Delimiter {
    /// The character; `None` for runs of spaces.
    #[must_use]
    pub fn character(self) -> Option<char> {
        match self {
            Self::Comma => Some(','),
            Self::Semicolon => Some(';'),
            Self::Tab => Some('\t'),
            Self::Bar => Some('|'),
            Self::Spaces => None,
        }
    }
}

/// How a table is written, where not as RFC 4180 has it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Dialect {
    /// What stands between cells.
    pub delimiter: Delimiter,
    /// Whether numbers have a decimal comma, and no point.
    pub decimal_comma: bool,
    /// Whether what stands for a value that is not there, or an empty cell, is read as NaN, which no trial takes.
    pub keeps_missing: bool,
    /// Lines that begin with one of these are no rows.
    pub comments: Vec<String>,
    /// The columns' names and the line of the first row (from 1), where the names are not the first line.
    pub named: Option<(Vec<String>, u64)>,
}

/// How a CSV file is read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Names of the columns, where they are not the usual letters.
    pub columns: ColumnMapping,
    /// The sample time; needed where there is no time column, checked against it where there is one.
    pub sample_time_s: Option<f64>,
    /// How it is written.
    pub dialect: Dialect,
    /// How much is read.
    pub limits: Limits,
}

/// Reads a trial, row by row: no more than the rows within the limits is ever held.
///
/// # Errors
/// The first [`ReadError`] from the top of the file, with its line (counted from 1, the header included) and column.
pub fn read(source: impl Read, options: &Options) -> Result<ReadTrial, ReadError> {
    let (signals, places) = read_columns(source, options)?;
    let trial = Trial::from_signals(options.sample_time_s, signals).map_err(|error| {
        let location = places.of(&error);
        ReadError::Trial { error, location }
    })?;
    Ok(ReadTrial { trial, ignored_columns: places.header.ignored })
}

/// Reads the columns of signals as they stand, whatever their times, and where each value stood.
///
/// # Errors
/// As [`read`], but for those of the whole trial.
pub fn read_columns(source: impl Read, options: &Options) -> Result<(Signals, Places), ReadError> {
    let dialect = &options.dialect;
    let mut lines = Lines::new(source, options.limits.max_bytes);
    let (header, mut spare, first_row) = if let Some((names, first_row)) = &dialect.named {
        lines.pass_to(*first_row)?;
        (Header::of(names.clone(), &options.columns)?, Vec::new(), *first_row)
    } else {
        let Some(first) = lines.next_record(Vec::new())? else { return Err(ReadError::Empty) };
        if first.text.trim_ascii().is_empty() {
            while let Some(record) = lines.next_record(Vec::new())? {
                if !record.text.trim_ascii().is_empty() {
                    return Err(ReadError::BlankLine { line: first.line });
                }
            }
            return Err(ReadError::Empty);
        }
        (Header::parse(&first, options)?, first.text, 2)
    };
    let mut table = Table { first_row, ..Table::default() };
    let mut blank = None;
    while let Some(record) = lines.next_record(std::mem::take(&mut spare))? {
        let text = record.text.trim_ascii();
        if text.is_empty() {
            blank.get_or_insert(record.line);
            spare = record.text;
            continue;
        }
        if dialect.comments.iter().any(|marker| text.starts_with(marker.as_bytes())) {
            spare = record.text;
            continue;
        }
        if let Some(line) = blank {
            return Err(ReadError::BlankLine { line });
        }
        if table.rows() >= options.limits.max_rows {
            return Err(ReadError::TooManyRows { limit: options.limits.max_rows });
        }
        table.push(&header, dialect, &record)?;
        spare = record.text;
    }
    if table.rows() == 0 {
        return Err(ReadError::NoRows);
    }
    let columns = std::mem::take(&mut table.columns);
    let [time, command, control, output, disturbance] = columns;
    let signals = Signals {
        time_s: header.positions[0].map(|_| time),
        command,
        control,
        output,
        disturbance: header.positions[4].map(|_| disturbance),
    };
    Ok((signals, Places { header, table }))
}

/// Where in a table its values stood.
pub struct Places {
    header: Header,
    table: Table,
}

impl Places {
    /// The columns that are no signals, by name, in the order of the file.
    #[must_use]
    pub fn ignored_columns(&self) -> &[String] {
        &self.header.ignored
    }

    /// The line of a row: rows count from 0, lines from 1.
    #[must_use]
    pub fn line(&self, row: usize) -> u64 {
        self.table.line(row)
    }

    /// How many rows there are.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.table.rows
    }

    /// The name of a signal's column.
    #[must_use]
    pub fn column(&self, channel: Channel) -> String {
        Channel::ALL.iter().position(|c| *c == channel).map_or_else(String::new, |slot| self.header.column(slot))
    }

    /// What a defect of the whole trial is about.
    #[must_use]
    pub fn of(&self, error: &TrialError) -> Option<Location> {
        let (channel, sample) = error.place();
        let column = self.column(channel?);
        Some(match sample {
            Some(sample) => Location::Cell { line: self.line(sample), column },
            None => Location::Column(column),
        })
    }
}

/// At most 40 characters of a text, for messages.
pub(super) fn shorten(text: &str) -> String {
    const KEPT: usize = 40;
    match text.char_indices().nth(KEPT) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
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
    fn parse(record: &Record, options: &Options) -> Result<Self, ReadError> {
        let names = cells(record, options.dialect.delimiter)?;
        let names: Vec<String> = names.iter().map(|name| name.trim().to_owned()).collect();
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
        Self::of(names, &options.columns)
    }

    fn of(names: Vec<String>, mapping: &ColumnMapping) -> Result<Self, ReadError> {
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
    /// The line of the first row.
    first_row: u64,
    /// Rows whose line is not the one after the row before, with their line: a quoted cell held a line end, or there
    /// was a comment.
    jumps: Vec<(usize, u64)>,
    rows: usize,
}

impl Table {
    fn rows(&self) -> usize {
        self.rows
    }

    fn line(&self, row: usize) -> u64 {
        let (from, line) = self.jumps.iter().rev().find(|(at, _)| *at <= row).copied().unwrap_or((0, self.first_row));
        line + (row - from) as u64
    }

    fn push(&mut self, header: &Header, dialect: &Dialect, record: &Record) -> Result<(), ReadError> {
        if self.line(self.rows) != record.line {
            self.jumps.push((self.rows, record.line));
        }
        let line = record.line;
        if record.text.contains(&b'"') {
            let cells = cells(record, dialect.delimiter)?;
            self.push_cells(header, dialect, line, cells.iter().map(String::as_str))?;
        } else {
            // Nearly every row comes this way, without an allocation per cell.
            let text = std::str::from_utf8(&record.text).map_err(|_| ReadError::NotUtf8 { line, byte: 1 })?;
            match dialect.delimiter.character() {
                Some(character) => self.push_cells(header, dialect, line, text.split(character))?,
                None => self.push_cells(header, dialect, line, text.split_ascii_whitespace())?,
            }
        }
        self.rows += 1;
        Ok(())
    }

    fn push_cells<'a>(
        &mut self,
        header: &Header,
        dialect: &Dialect,
        line: u64,
        cells: impl Iterator<Item = &'a str>,
    ) -> Result<(), ReadError> {
        let mut row = [""; 5];
        let mut found = 0;
        for cell in cells {
            if let Some(slot) = header.positions.iter().position(|at| *at == Some(found)) {
                row[slot] = cell;
            }
            found += 1;
        }
        if found != header.names.len() {
            return Err(ReadError::Ragged { line, expected: header.names.len(), found });
        }
        self.push_row(header, dialect, line, row)
    }

    fn push_row(&mut self, header: &Header, dialect: &Dialect, line: u64, row: [&str; 5]) -> Result<(), ReadError> {
        for (slot, text) in row.into_iter().enumerate() {
            if header.positions[slot].is_some() {
                if dialect.keeps_missing && is_missing(text) {
                    self.columns[slot].push(f64::NAN);
                    continue;
                }
                let value = number(text, dialect.decimal_comma).map_err(|why| {
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
}
