//! Why something is no trial, and where in it.

use super::gzip::GzipError;
use super::pointer;
use super::sample_time::TimeDefect;
use super::signals::Channel;

/// Why signals are no trial. Samples count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrialError {
    /// Too short to have a sample time.
    #[error("there are {samples} samples, and a trial needs at least {minimum}")]
    TooFewSamples {
        /// Samples there are.
        samples: usize,
        /// Samples there must be.
        minimum: usize,
    },
    /// A column is longer or shorter than the output.
    #[error("{} has {samples} samples, y has {expected}", .channel.letter())]
    UnequalLengths {
        /// The column.
        channel: Channel,
        /// Its length.
        samples: usize,
        /// The length of y.
        expected: usize,
    },
    /// NaN or infinity.
    #[error("the value is {value}, which is no finite number")]
    NotFinite {
        /// The column.
        channel: Channel,
        /// The row.
        sample: usize,
        /// The value.
        value: f64,
    },
    /// A sample time that is not a positive, finite number of seconds.
    #[error("the sample time is {0} s, and must be positive and finite")]
    BadSampleTime(f64),
    /// Neither a time column nor a sample time.
    #[error("there is neither a time column t nor a sample time")]
    NoSampleTime,
    /// The sample time is given twice, and differently.
    #[error("the document says that the sample time is {document_s} s, and beside it {given_s} s was given")]
    SampleTimes {
        /// The document's.
        document_s: f64,
        /// The one given beside it.
        given_s: f64,
    },
    /// The time column is no uniform grid.
    #[error(transparent)]
    Time(#[from] TimeDefect),
}

impl TrialError {
    /// The column and the row (from 0) at fault, where they are known.
    #[must_use]
    pub fn place(&self) -> (Option<Channel>, Option<usize>) {
        match self {
            Self::TooFewSamples { .. } | Self::NoSampleTime | Self::BadSampleTime(_) | Self::SampleTimes { .. } => {
                (None, None)
            }
            Self::UnequalLengths { channel, .. } => (Some(*channel), None),
            Self::NotFinite { channel, sample, .. } => (Some(*channel), Some(*sample)),
            Self::Time(defect) => (Some(Channel::Time), defect.sample()),
        }
    }
}

/// Where in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Location {
    /// A line of a text file, from 1, the header included.
    Line(u64),
    /// A column of a table, by its name.
    Column(String),
    /// A cell of a table.
    Cell {
        /// The line, from 1, the header included.
        line: u64,
        /// The column, by its name.
        column: String,
    },
    /// A member of a JSON document, as a pointer relative to the trial (`/y`, `/y/17`).
    Pointer(String),
}

/// Why a file is no trial.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The source could not be read.
    #[error("the data could not be read: {0}")]
    Io(std::io::Error),
    /// It says that it is gzip, and is not, or not wholly.
    #[error(transparent)]
    Gzip(GzipError),
    /// More rows than the limit.
    #[error("there are more than {limit} rows, the most that a trial may have")]
    TooManyRows {
        /// The limit.
        limit: usize,
    },
    /// More bytes than the limit, after decompression.
    #[error("there are more than {limit} bytes (after decompression), the most that a trial may have")]
    TooManyBytes {
        /// The limit.
        limit: u64,
    },
    /// A line that no table of numbers has.
    #[error("the line is longer than {limit} bytes")]
    LineTooLong {
        /// The line.
        line: u64,
        /// The limit.
        limit: usize,
    },
    /// There is nothing at all.
    #[error("there is no data: the file is empty")]
    Empty,
    /// The text is not UTF-8.
    #[error("byte {byte} of the line is not UTF-8 text")]
    NotUtf8 {
        /// The line.
        line: u64,
        /// The byte within the line, from 1.
        byte: usize,
    },
    /// A carriage return that does not end a line.
    #[error(
        "the line has a carriage return in its middle; lines end in a line feed, or a carriage return and a line feed"
    )]
    CarriageReturn {
        /// The line.
        line: u64,
    },
    /// A quote that is not closed, or stands in the middle of a cell.
    #[error("the quotes of the line do not pair up as RFC 4180 has it")]
    Quotes {
        /// The line.
        line: u64,
    },
    /// The first line holds numbers, or nothing but commas.
    #[error("the first line does not name the columns")]
    NoHeader,
    /// The first line is one name with another delimiter in it.
    #[error("the columns seem to be separated by {delimiter:?}, not by commas")]
    Delimiter {
        /// The delimiter it seems to be.
        delimiter: char,
    },
    /// Columns that every trial has are not there.
    #[error("there is no column {}; the columns are {}", list(.missing), list(.found))]
    MissingColumns {
        /// The names looked for.
        missing: Vec<String>,
        /// The names found.
        found: Vec<String>,
    },
    /// Two columns have the same name.
    #[error("columns {first} and {second} are both named {name:?}")]
    DuplicateColumn {
        /// The name.
        name: String,
        /// Position of one, from 1.
        first: usize,
        /// Position of the other.
        second: usize,
    },
    /// Two signals are mapped to one column.
    #[error("{} and {} are both mapped to the column {name:?}", .first.letter(), .second.letter())]
    MappedTwice {
        /// The column.
        name: String,
        /// One signal.
        first: Channel,
        /// The other.
        second: Channel,
    },
    /// A header and nothing below it.
    #[error("there is a header, but no row of data below it")]
    NoRows,
    /// A row with more or fewer cells than the header.
    #[error("the row has {found} {}, the header has {expected}", if *.found == 1 { "cell" } else { "cells" })]
    Ragged {
        /// The line.
        line: u64,
        /// Cells of the header.
        expected: usize,
        /// Cells of the row.
        found: usize,
    },
    /// An empty line between rows.
    #[error("the line is empty, and there are rows below it")]
    BlankLine {
        /// The line.
        line: u64,
    },
    /// A cell without a value.
    #[error("the cell is empty")]
    EmptyCell {
        /// The line.
        line: u64,
        /// The column.
        column: String,
    },
    /// A cell that is no number.
    #[error("{text:?} is no number")]
    NotANumber {
        /// The line.
        line: u64,
        /// The column.
        column: String,
        /// The cell, shortened.
        text: String,
    },
    /// NaN, infinity, or a number beyond the range of a double.
    #[error("{text:?} is no finite number")]
    NotFinite {
        /// The line.
        line: u64,
        /// The column.
        column: String,
        /// The cell, shortened.
        text: String,
    },
    /// The text is no JSON document, or its outermost value is no object.
    #[error("the JSON cannot be read: {message}")]
    Json {
        /// What the parser says, with line and column.
        message: String,
    },
    /// A member that a trial does not have.
    #[error("a trial has no member {name:?}; it has sample_time_s, t, r, u, y and d")]
    UnknownMember {
        /// Its name.
        name: String,
    },
    /// A member that is there twice.
    #[error("the member {name:?} is there twice")]
    DuplicateMember {
        /// Its name.
        name: String,
    },
    /// Arrays that every trial has are not there.
    #[error("there is no array {}", list(.missing))]
    MissingArrays {
        /// Their names.
        missing: Vec<String>,
    },
    /// A member, or an element of an array, of the wrong type.
    #[error("there is {found}, where {expected} belongs")]
    WrongType {
        /// Its pointer.
        pointer: String,
        /// What it is.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
    /// The columns can be read, and are no trial.
    #[error("{error}")]
    Trial {
        /// Why.
        error: TrialError,
        /// Where.
        location: Option<Location>,
    },
}

fn list(names: &[String]) -> String {
    names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ")
}

impl ReadError {
    /// Where in the file, as far as it is known.
    #[must_use]
    pub fn location(&self) -> Option<Location> {
        match self {
            Self::LineTooLong { line, .. }
            | Self::NotUtf8 { line, .. }
            | Self::CarriageReturn { line }
            | Self::Quotes { line }
            | Self::Ragged { line, .. }
            | Self::BlankLine { line } => Some(Location::Line(*line)),
            Self::EmptyCell { line, column }
            | Self::NotANumber { line, column, .. }
            | Self::NotFinite { line, column, .. } => Some(Location::Cell { line: *line, column: column.clone() }),
            Self::NoHeader | Self::Delimiter { .. } | Self::MissingColumns { .. } => Some(Location::Line(1)),
            Self::DuplicateColumn { name, .. } | Self::MappedTwice { name, .. } => Some(Location::Column(name.clone())),
            Self::UnknownMember { name } | Self::DuplicateMember { name } => {
                Some(Location::Pointer(pointer::member("", name)))
            }
            Self::WrongType { pointer, .. } => Some(Location::Pointer(pointer.clone())),
            Self::Trial { location, .. } => location.clone(),
            Self::Io(_)
            | Self::Gzip(_)
            | Self::TooManyRows { .. }
            | Self::TooManyBytes { .. }
            | Self::Empty
            | Self::NoRows
            | Self::Json { .. }
            | Self::MissingArrays { .. } => None,
        }
    }
}

impl From<std::io::Error> for ReadError {
    /// A [`GzipError`] that travelled inside an `io::Error` comes out again.
    fn from(error: std::io::Error) -> Self {
        match error.downcast::<GzipError>() {
            Ok(gzip) => Self::Gzip(gzip),
            Err(error) => Self::Io(error),
        }
    }
}
