//! Lines taken apart, and what their cells seem to be.

use crate::exchange::names::is_unit_of_time;
use crate::exchange::options::TimeUnit;
use crate::trial::csv::{Delimiter, is_missing, is_number, split};

/// What a cell is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Number,
    /// What stands for a value that is not there.
    Missing,
    Empty,
    Text,
}

pub(super) fn kind(cell: &str, decimal_comma: bool) -> Kind {
    let cell = cell.trim();
    if cell.is_empty() {
        return Kind::Empty;
    }
    if is_missing(cell) || ["inf", "-inf"].contains(&cell.to_ascii_lowercase().as_str()) {
        return Kind::Missing;
    }
    if is_number(cell, decimal_comma) { Kind::Number } else { Kind::Text }
}

/// A line taken apart.
pub(super) struct Cut {
    pub(super) line: u64,
    pub(super) cells: Vec<String>,
    pub(super) numbers: usize,
    texts: usize,
    pub(super) missing: usize,
}

/// Numbers of a row that is a sample whatever else stands in it: r, u and y.
const SIGNALS: usize = 3;

impl Cut {
    pub(super) fn of(line: u64, text: &str, (delimiter, decimal_comma): (Delimiter, bool)) -> Self {
        let cells: Vec<String> = split(text, delimiter).unwrap_or_else(|| vec![text.to_owned()]);
        let cells: Vec<String> = cells.into_iter().map(|cell| cell.trim().to_owned()).collect();
        let count = |wanted| cells.iter().filter(|cell| kind(cell, decimal_comma) == wanted).count();
        let (numbers, texts, missing) = (count(Kind::Number), count(Kind::Text), count(Kind::Missing));
        Self { line, cells, numbers, texts, missing }
    }

    pub(super) fn is_sample(&self) -> bool {
        let is_filled = self.numbers >= SIGNALS
            || self.numbers > 0 && self.texts <= self.numbers
            || self.texts == 0 && self.missing > 0;
        self.cells.len() > 1 && is_filled && !(self.has_key() && self.texts == 1)
    }

    /// Whether it begins with the name of a setting: `Range=`, `Channels:`.
    pub(super) fn has_key(&self) -> bool {
        self.cells.first().is_some_and(|key| key.ends_with(['=', ':']))
    }

    /// Whether it holds numbers of values, as one program writes below its names: one number for all columns but the
    /// first.
    pub(super) fn are_counts(&self) -> bool {
        let mut counts = self.cells.iter().filter(|cell| !cell.is_empty());
        let Some(count) = counts.next() else { return false };
        let is_count = count.parse::<u64>().is_ok_and(|count| count > 1);
        let is_behind = self.cells.first().is_some_and(String::is_empty);
        is_count && is_behind && self.numbers > 1 && counts.all(|other| other == count)
    }

    /// Whether it may stand between the names and the samples.
    pub(super) fn is_beside(&self) -> bool {
        let is_of_words = self.numbers == 0 && (self.missing == 0 || self.texts > 0 && are_units(&self.cells));
        is_of_words || self.has_key() && self.texts == 1 || self.are_counts()
    }

    /// Whether it is a setting that names the columns: `ChannelTitle=`.
    pub(super) fn has_title(&self) -> bool {
        let key = self.cells.first().map(|key| key.to_lowercase()).unwrap_or_default();
        self.has_key() && ["title", "name", "channel", "signal", "label"].iter().any(|word| key.contains(word))
    }

    /// Whether it stands among samples and is none: a row of another length, or with a word that begins as numbers do.
    pub(super) fn is_defective(&self) -> bool {
        let begins_so = |cell: &String| cell.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c));
        let is_text = |cell: &&String| kind(cell, false) == Kind::Text && kind(cell, true) == Kind::Text;
        self.is_sample() && self.cells.iter().filter(is_text).all(begins_so) && !self.are_counts()
    }
}

/// Whether cells are units: one says what time counts, or all stand in brackets, or all are units of physics.
pub(super) fn are_units(cells: &[String]) -> bool {
    let is_bracketed = |cell: &String| {
        cell.is_empty()
            || [('(', ')'), ('[', ']'), ('{', '}')].iter().any(|(a, b)| cell.starts_with(*a) && cell.ends_with(*b))
    };
    let is_unit = |cell: &String| {
        let bare = bare_unit(cell).unwrap_or_default();
        // `t` and `u` would be names.
        bare.chars().count() <= 8 && !["t", "r", "u", "y", "d"].contains(&bare.to_lowercase().as_str())
    };
    let is_of_physics = |cell: &String| bare_unit(cell).is_none_or(|unit| is_physical(&unit));
    // `Frame` and `Sample` are names of columns, too.
    let is_time = |unit: &str| is_unit_of_time(unit) && TimeUnit::as_written(unit) != Some(TimeUnit::Samples);
    let has_time = cells.iter().any(|cell| bare_unit(cell).is_some_and(|unit| is_time(&unit)));
    cells.iter().any(|cell| !cell.is_empty())
        && (cells.iter().all(is_bracketed) || has_time && cells.iter().all(is_unit) || cells.iter().all(is_of_physics))
}

/// A unit without brackets around it.
pub(super) fn bare_unit(cell: &str) -> Option<String> {
    let cell = cell.trim();
    let inner = [('(', ')'), ('[', ']'), ('{', '}')]
        .into_iter()
        .find_map(|(open, close)| cell.strip_prefix(open)?.strip_suffix(close));
    let bare = inner.unwrap_or(cell).trim();
    (!bare.is_empty()).then(|| bare.to_owned())
}

/// Units of what labs record, without powers.
const UNITS: [&str; 34] = [
    "m", "mm", "cm", "um", "\u{b5}m", "\u{3bc}m", "in", "deg", "\u{b0}", "rad", "mrad", "s", "ms", "us", "n", "kn",
    "mn", "nm", "nmm", "v", "mv", "uv", "\u{b5}v", "\u{3bc}v", "hz", "kg", "g", "px", "pixel", "pixels", "%", "a",
    "volts", "-",
];

/// Whether a text is a unit, or a product or quotient of units.
fn is_physical(text: &str) -> bool {
    let bare =
        |part: &str| part.trim_end_matches(|c: char| c.is_ascii_digit() || c == '-' || c == '\u{b2}').to_lowercase();
    let parts: Vec<String> =
        text.split(['/', '*', '.', '\u{b7}', ' ', '^', '(', ')']).map(bare).filter(|part| !part.is_empty()).collect();
    let is_unit = |part: &String| UNITS.contains(&part.as_str());
    text == "-" || text.chars().count() <= 12 && !parts.is_empty() && parts.iter().all(is_unit)
}
