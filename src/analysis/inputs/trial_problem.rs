//! Readers' errors as problems: what is wrong, where, and how to mend it.

use crate::analysis::problem::{Code, Problem};
use crate::trial::gzip::GzipError;
use crate::trial::{Location, ReadError, TimeDefect, TrialError};

impl From<&ReadError> for Problem {
    fn from(error: &ReadError) -> Self {
        problem(error, "")
    }
}

impl From<ReadError> for Problem {
    fn from(error: ReadError) -> Self {
        Self::from(&error)
    }
}

impl From<&TrialError> for Problem {
    /// For columns that came from no file; the place is the array and the index (`y[17]`).
    fn from(error: &TrialError) -> Self {
        let problem = Self::new(Code::BadSignal, trial_title(error), error.to_string()).mend(trial_advice(error));
        match error.place() {
            (Some(channel), Some(sample)) => problem.at(format!("{}[{sample}]", channel.letter())),
            (Some(channel), None) => problem.at(channel.letter()),
            (None, _) => problem,
        }
    }
}

/// The problem, with JSON pointers prefixed by that of the trial itself (`/inputs/trial`).
#[must_use]
pub fn problem(error: &ReadError, prefix: &str) -> Problem {
    let (code, title) = code_and_title(error);
    let problem = Problem::new(code, title, error.to_string());
    let problem = match error.location() {
        Some(Location::Line(line)) => problem.at(format!("row {line}")),
        Some(Location::Column(column)) => problem.at(format!("column {column}")),
        Some(Location::Cell { line, column }) => problem.at(format!("row {line}, column {column}")),
        Some(Location::Pointer(pointer)) => problem.at(format!("{prefix}{pointer}")),
        None if prefix.is_empty() => problem,
        None => problem.at(prefix),
    };
    match advice(error) {
        Some(advice) => problem.mend(advice),
        None => problem,
    }
}

fn code_and_title(error: &ReadError) -> (Code, &'static str) {
    match error {
        ReadError::Io(_) => (Code::Malformed, "unreadable data"),
        ReadError::Gzip(GzipError::Empty) => (Code::Malformed, "empty gzip"),
        ReadError::Gzip(GzipError::NotGzip) => (Code::Malformed, "not gzip"),
        ReadError::Gzip(GzipError::Truncated { .. }) => (Code::Malformed, "truncated gzip"),
        ReadError::Gzip(GzipError::Corrupted { .. }) => (Code::Malformed, "corrupted gzip"),
        ReadError::Gzip(GzipError::TrailingGarbage { .. }) => (Code::Malformed, "bytes after the end of the gzip"),
        ReadError::TooManyRows { .. } => (Code::TooLarge, "too many rows"),
        ReadError::TooManyBytes { .. } => (Code::TooLarge, "too many bytes"),
        ReadError::LineTooLong { .. } => (Code::TooLarge, "too long a line"),
        ReadError::Empty => (Code::Malformed, "no data"),
        ReadError::NotUtf8 { .. } => (Code::Malformed, "not UTF-8"),
        ReadError::CarriageReturn { .. } => (Code::Malformed, "stray carriage return"),
        ReadError::Quotes { .. } => (Code::Malformed, "broken quotes"),
        ReadError::NoHeader => (Code::Malformed, "no header"),
        ReadError::Delimiter { .. } => (Code::Malformed, "wrong delimiter"),
        ReadError::MissingColumns { .. } => (Code::Malformed, "missing column"),
        ReadError::DuplicateColumn { .. } => (Code::Malformed, "column named twice"),
        ReadError::MappedTwice { .. } => (Code::Invalid, "column mapped twice"),
        ReadError::NoRows => (Code::Malformed, "no rows"),
        ReadError::Ragged { .. } => (Code::Malformed, "rows of unequal length"),
        ReadError::BlankLine { .. } => (Code::Malformed, "empty line"),
        ReadError::EmptyCell { .. } => (Code::BadSignal, "empty cell"),
        ReadError::NotANumber { .. } => (Code::BadSignal, "not a number"),
        ReadError::NotFinite { .. } => (Code::BadSignal, "not a finite number"),
        ReadError::Json { .. } => (Code::Malformed, "unreadable JSON"),
        ReadError::UnknownMember { .. } => (Code::Malformed, "unknown member"),
        ReadError::DuplicateMember { .. } => (Code::Malformed, "member named twice"),
        ReadError::MissingArrays { .. } => (Code::Malformed, "missing signal"),
        ReadError::WrongType { .. } => (Code::BadSignal, "wrong type of value"),
        ReadError::Trial { error, .. } => (Code::BadSignal, trial_title(error)),
    }
}

fn trial_title(error: &TrialError) -> &'static str {
    match error {
        TrialError::TooFewSamples { .. } => "too few samples",
        TrialError::UnequalLengths { .. } => "columns of unequal length",
        TrialError::NotFinite { .. } => "not a finite number",
        TrialError::BadSampleTime(_) => "unusable sample time",
        TrialError::NoSampleTime => "no sample time",
        TrialError::SampleTimes { .. } => "two sample times",
        TrialError::Time(TimeDefect::Reversed { .. }) => "time runs backwards",
        TrialError::Time(TimeDefect::Repeated { .. }) => "repeated time",
        TrialError::Time(TimeDefect::Gap { .. }) => "gap in the time column",
        TrialError::Time(TimeDefect::Jitter { .. }) => "jitter in the time column",
        TrialError::Time(TimeDefect::TooCoarse { .. }) => "time column too coarse",
        TrialError::Time(TimeDefect::Disagrees { .. }) => "sample time disagrees with the time column",
        TrialError::Time(TimeDefect::NoSpan { .. }) => "unusable time column",
    }
}

fn advice(error: &ReadError) -> Option<String> {
    let text = match error {
        ReadError::Io(_)
        | ReadError::Gzip(GzipError::Empty | GzipError::Truncated { .. } | GzipError::Corrupted { .. }) => {
            "Send the whole file again."
        }
        ReadError::Gzip(GzipError::NotGzip) => "Leave out the content encoding, or compress the file.",
        ReadError::Gzip(GzipError::TrailingGarbage { .. }) => "Remove what follows the gzip data.",
        ReadError::TooManyRows { .. } | ReadError::TooManyBytes { .. } => {
            "Split the recording into trials, or resample it."
        }
        ReadError::LineTooLong { .. } => "Send one row per sample.",
        ReadError::Empty | ReadError::NoRows => "Send a header and one row per sample.",
        ReadError::NotUtf8 { .. } => "Save the file as UTF-8.",
        ReadError::CarriageReturn { .. } => "Save the file with line feeds at the ends of lines.",
        ReadError::Quotes { .. } => "Numbers need no quotes; remove them.",
        ReadError::NoHeader => "Put a first line t,r,u,y (or t,r,u,y,d) above the numbers.",
        ReadError::Delimiter { .. } => "Separate the columns by commas, and write numbers with a decimal point.",
        ReadError::MissingColumns { .. } => "Name the columns t, r, u, y (and d), or give a mapping of their names.",
        ReadError::DuplicateColumn { .. } => "Rename one of them.",
        ReadError::MappedTwice { .. } => "Map each signal to a column of its own.",
        ReadError::Ragged { .. } => "Give every row one cell per column; numbers have a decimal point, not a comma.",
        ReadError::BlankLine { .. } => "Remove it, or put in the missing row.",
        ReadError::EmptyCell { .. } | ReadError::NotANumber { .. } | ReadError::NotFinite { .. } => {
            "Every cell must hold a finite number with a decimal point; cut the trial where the recording failed."
        }
        ReadError::WrongType { .. } => "Every value must be a finite number; cut the trial where the recording failed.",
        ReadError::UnknownMember { .. } | ReadError::DuplicateMember { .. } => "Remove or rename it.",
        ReadError::MissingArrays { .. } => "Give the arrays r, u and y.",
        ReadError::Json { .. } => return None,
        ReadError::Trial { error, .. } => return Some(trial_advice(error).to_owned()),
    };
    Some(text.to_owned())
}

fn trial_advice(error: &TrialError) -> &'static str {
    match error {
        TrialError::TooFewSamples { .. } => "Send the whole recording.",
        TrialError::UnequalLengths { .. } => "Give every signal one value per sample.",
        TrialError::NotFinite { .. } => "Cut the trial where the recording failed.",
        TrialError::BadSampleTime(_) => "Give the time between samples in seconds.",
        TrialError::SampleTimes { .. } => "Give it once.",
        TrialError::NoSampleTime => "Give a time column t, or the sample time in seconds (sample_time_s).",
        TrialError::Time(TimeDefect::Disagrees { .. }) => "Correct the sample time, or leave it out.",
        TrialError::Time(TimeDefect::TooCoarse { .. }) => {
            "Print the time with more decimals, or leave the column out and give the sample time."
        }
        TrialError::Time(_) => {
            "Resample the recording to equal steps, cut it at the defect, or, where the samples are equally spaced and \
             only the column is wrong, leave the column out and give the sample time."
        }
    }
}
