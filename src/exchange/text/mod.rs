//! Tables as text, however they are written.
//!
//! [`encoding`] makes the bytes a text, [`layout`] recognises from its beginning what separates cells and where rows
//! start, and the one reader of tables, [`csv`], reads the rows.

pub mod encoding;
mod explained;
mod foreign;
pub mod layout;
mod rows;

use super::bids::Sidecar;
use super::names;
use super::options::Options;
use super::reading::Reading;
use super::source::{Head, Source};
use super::time::{self, Place, Recorded};
use super::understood::{Understood, UnderstoodColumn};
use crate::analysis::{Code, Problem, Warning};
use crate::trial::csv::{self, ColumnMapping, Places};
use crate::trial::{Channel, ReadError, Signals};
use encoding::Encoding;
use layout::{Layout, Titles};
use std::io::Read;

/// Reads a table.
pub(super) fn read(source: &Source<'_>, head: &Head, options: &Options) -> Result<Reading, Problem> {
    match encoding::recognise(&head.bytes) {
        Encoding::Utf8 { has_mark } => {
            let text = match std::str::from_utf8(&head.bytes) {
                Ok(text) => text,
                // The last character may be cut where the head ends.
                Err(error) if !head.is_whole && head.bytes.len() - error.valid_up_to() < 4 => {
                    std::str::from_utf8(&head.bytes[..error.valid_up_to()]).unwrap_or_default()
                }
                Err(_) => return decoded(source, options),
            };
            let mut rows = source.open();
            let named = if has_mark { "UTF-8 with byte order mark" } else { "UTF-8" };
            match table(&mut rows, text.trim_start_matches('\u{feff}'), head.is_whole, named, options) {
                Err(Stop::NotUtf8) => decoded(source, options),
                Err(Stop::Problem(problem)) => Err(problem),
                Ok(reading) => Ok(Reading { bytes: rows.count(), ..reading }),
            }
        }
        Encoding::Utf16 { .. } => decoded(source, options),
        Encoding::Binary => Err(Problem::new(
            Code::Malformed,
            "unknown format",
            "the file is no text, and of no format that is known here",
        )
        .mend("Send a table as text (CSV), JSON, or a file that says by its content what it is.")),
    }
}

/// Reads a table that is text already, such as the cells of a sheet; `words` say what it is.
pub(super) fn read_sheet(text: &str, words: &str, options: &Options) -> Result<Reading, Problem> {
    let limits = crate::trial::Limits { max_bytes: u64::MAX, ..options.limits };
    let options = Options { limits, ..options.clone() };
    match table(&mut text.as_bytes(), text, true, "", &options) {
        Err(Stop::NotUtf8) => Err(Problem::new(Code::Malformed, "no text", "the sheet cannot be decoded")),
        Err(Stop::Problem(problem)) => Err(problem),
        Ok(mut reading) => {
            let known = &mut reading.understood;
            (known.format, known.encoding, known.delimiter, known.decimal_mark) = ("xlsx", None, None, None);
            // Which cells stand where, without the words for what is between them.
            let rest = known.words[0].split_once("; ").map_or("", |(_, rest)| rest);
            known.words[0] = format!("{words}; {rest}");
            Ok(reading)
        }
    }
}

/// Reads a table that is not UTF-8: it is made so as a whole.
fn decoded(source: &Source<'_>, options: &Options) -> Result<Reading, Problem> {
    let bytes = source.whole(options.limits.max_bytes)?;
    let (text, named) = encoding::decode(&bytes)?;
    // Characters of other encodings may take more bytes in UTF-8.
    let limits = crate::trial::Limits { max_bytes: u64::MAX, ..options.limits };
    let options = Options { limits, ..options.clone() };
    match table(&mut text.as_bytes(), &text, true, &named, &options) {
        Err(Stop::NotUtf8) => Err(Problem::new(Code::Malformed, "not UTF-8", "the text cannot be decoded")),
        Err(Stop::Problem(problem)) => Err(problem),
        Ok(reading) => Ok(Reading { bytes: bytes.len() as u64, ..reading }),
    }
}

/// Why no table was read.
enum Stop {
    /// A byte behind the head is no UTF-8.
    NotUtf8,
    Problem(Problem),
}

impl From<Problem> for Stop {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

fn table(rows: &mut dyn Read, head: &str, is_whole: bool, encoding: &str, options: &Options) -> Result<Reading, Stop> {
    if let Some(problem) = foreign::refuse(head) {
        return Err(problem.into());
    }
    let mut layout = layout::recognise(head, is_whole, &options.columns);
    let mut columns = options.columns.clone();
    if let (Some(layout), Some(sidecar)) = (&mut layout, &options.sidecar) {
        name_by(layout, sidecar)?;
        if columns.time.is_none() {
            columns.time.clone_from(&sidecar.latency);
        }
    }
    let options = &Options { columns, ..options.clone() };
    let (columns, dialect, found) = match &layout {
        None => (ColumnMapping::default(), csv::Dialect::default(), None),
        Some(layout) => {
            let found = find(layout, &options.columns)?;
            let mut names = told_apart(&layout.names);
            let mut columns = ColumnMapping::default();
            for (slot, channel) in Channel::ALL.into_iter().enumerate() {
                let Some(at) = found.positions[slot] else { continue };
                if names[at].is_empty() {
                    names[at] = (at + 1).to_string();
                }
                *columns.name_mut(channel) = Some(names[at].clone());
            }
            let mut dialect = layout.dialect.clone();
            if names != layout.names || dialect.named.is_some() {
                dialect.named = Some((names, layout.first_row));
            }
            (columns, dialect, Some(found))
        }
    };
    // What is not there can be filled where there are times, and where that is asked for.
    let has_time = found.as_ref().is_some_and(|found| found.positions[0].is_some());
    let dialect = csv::Dialect { keeps_missing: options.resample.is_some() && has_time, ..dialect };
    let read_options = csv::Options { columns, dialect, limits: options.limits, ..csv::Options::default() };
    let (mut signals, places) = csv::read_columns(rows, &read_options).map_err(|error| match error {
        ReadError::NotUtf8 { .. } => Stop::NotUtf8,
        error => Stop::Problem(explained::refusal(error, layout.as_ref().filter(|_| !encoding.is_empty()), has_time)),
    })?;

    let mut understood = Understood::new("text");
    understood.encoding = Some(encoding.to_owned());
    let layout = layout.unwrap_or_default();
    let written_unit = found.as_ref().and_then(|found| {
        let at = found.positions[0]?;
        found.time_unit.clone().or_else(|| layout.units.get(at).cloned().flatten())
    });
    describe(&mut understood, &layout, &places, &signals);
    let rows_kept = take_out_missing(&mut signals);
    let kept = rows_kept.as_ref().map_or(places.rows(), Vec::len);
    let line = |sample: usize| places.line(rows_kept.as_ref().map_or(sample, |rows| rows[sample]));
    let place = |sample: Option<usize>, channel: Channel| {
        let column = places.column(channel);
        sample.map_or_else(|| format!("column {column}"), |sample| format!("row {}, column {column}", line(sample)))
    };
    let row = |sample: usize| line(sample).to_string();
    let suggestion = names::suggestion(&layout.names, &options.columns);
    let suggestion = (places.column(Channel::Time) == "t" && suggestion.contains("t:")).then_some(suggestion);
    let place = Place { of: &place, row: &row, rows: "rows", suggestion };
    let sample_time_s = options.sidecar.as_ref().and_then(|sidecar| sidecar.sample_time_s);
    let recorded = Recorded { signals, written_unit, sample_time_s };
    let ignored_columns = places.ignored_columns().to_vec();
    let (trial, mut warnings) = time::settle(recorded, options, &place, &mut understood)?;
    let left_out = places.rows() - kept;
    if left_out > 0 {
        let message =
            format!("{left_out} samples without a value in some signal were left out, and filled on straight lines");
        understood.words.push(format!("{message}."));
        warnings.push(Warning::new("resampled", message));
    }
    Ok(Reading { trial, understood, ignored_columns, warnings, bytes: 0 })
}

/// Names with their positions behind those that are there more than once.
fn told_apart(names: &[String]) -> Vec<String> {
    let mut counts = std::collections::BTreeMap::<&str, usize>::new();
    for name in names {
        *counts.entry(name).or_default() += 1;
    }
    let is_several = |name: &str| !name.is_empty() && counts.get(name).is_some_and(|count| *count > 1);
    let told = |(at, name): (usize, &String)| {
        if is_several(name) { format!("{name} #{}", at + 1) } else { name.clone() }
    };
    names.iter().enumerate().map(told).collect()
}

/// Takes out samples without a value; the rows that stay, where any went.
fn take_out_missing(signals: &mut Signals) -> Option<Vec<usize>> {
    let columns = |signals: &Signals| Channel::ALL.map(|channel| signals.channel(channel).map(<[f64]>::to_vec));
    let is_there =
        |row: usize| Channel::ALL.into_iter().all(|c| signals.channel(c).is_none_or(|column| !column[row].is_nan()));
    let rows: Vec<usize> = (0..signals.output.len()).filter(|row| is_there(*row)).collect();
    if rows.len() == signals.output.len() {
        return None;
    }
    let of_rows = |column: Vec<f64>| rows.iter().map(|row| column[*row]).collect::<Vec<f64>>();
    let [time, command, control, output, disturbance] = columns(signals).map(|column| column.map(of_rows));
    *signals = Signals {
        time_s: time,
        command: command.unwrap_or_default(),
        control: control.unwrap_or_default(),
        output: output.unwrap_or_default(),
        disturbance,
    };
    Some(rows)
}

/// Takes names, units and rate from a file beside.
fn name_by(layout: &mut Layout, sidecar: &Sidecar) -> Result<(), Problem> {
    if layout.titles != Titles::None {
        return Ok(());
    }
    if layout.names.len() != sidecar.names.len() {
        return Err(Problem::new(
            Code::Malformed,
            "a sidecar of another table",
            format!(
                "the table has {} columns, and the file of its channels names {}",
                layout.names.len(),
                sidecar.names.len()
            ),
        )
        .at(format!("row {}", layout.first_row))
        .mend("Name every column of the table in the file of its channels, in their order."));
    }
    layout.names.clone_from(&sidecar.names);
    layout.units.clone_from(&sidecar.units);
    layout.titles = Titles::Beside;
    layout.dialect.named = Some((layout.names.clone(), layout.first_row));
    Ok(())
}

/// Which column is which signal, or how to say it.
fn find(layout: &Layout, mapping: &ColumnMapping) -> Result<names::Found, Problem> {
    if let Some(trap) = layout.trap {
        return Err(explained::trapped(trap, layout.first_row));
    }
    let is_named = layout.names.iter().any(|name| !name.is_empty());
    let by_position = Channel::ALL.into_iter().any(|channel| mapping.name(channel).is_some());
    if layout.titles == Titles::None && !by_position || !is_named {
        let count = layout.names.len();
        let example = ["t", "r", "u", "y"].iter().enumerate().map(|(i, name)| format!("{name}:{}", i + 1));
        let example = if count >= 4 { example.collect::<Vec<_>>().join(",") } else { "r:1,u:2,y:3".to_owned() };
        return Err(Problem::new(
            Code::Malformed,
            "no header",
            format!("the first line does not name the columns: there are {count} of them, and no names above"),
        )
        .at(format!("row {}", layout.first_row.min(layout.first_line)))
        .mend(format!(
            "Say which is which by position, such as columns={example}, or put a first line t,r,u,y above."
        )));
    }
    let place = match layout.titles {
        Titles::Line(line) | Titles::Comment(line) => format!("row {line}"),
        Titles::Beside => "the file of its channels".to_owned(),
        Titles::None => format!("row {}", layout.first_row),
    };
    names::find(&layout.names, mapping, &place)
}

fn describe(understood: &mut Understood, layout: &Layout, places: &Places, signals: &Signals) {
    let dialect = &layout.dialect;
    understood.delimiter = Some(layout::name(dialect.delimiter));
    understood.decimal_mark = Some(if dialect.decimal_comma { "comma" } else { "point" });
    understood.first_row = Some(places.line(0));
    let mut words = format!(
        "Text in {}, cells between {}, numbers with a decimal {}; ",
        understood.encoding.as_deref().unwrap_or_default(),
        layout::plural(dialect.delimiter),
        if dialect.decimal_comma { "comma" } else { "point" }
    );
    match layout.titles {
        Titles::Line(line) => {
            understood.header_row = Some(line);
            words.push_str(&format!("row {line} names the columns"));
        }
        Titles::Comment(line) => {
            understood.header_row = Some(line);
            words.push_str(&format!("the comment in row {line} names the columns"));
        }
        Titles::Beside => words.push_str("the file of its channels names the columns"),
        Titles::None => words.push_str("no row names the columns, which were given by position"),
    }
    if let Some(line) = layout.units_row {
        words.push_str(&format!(", row {line} their units"));
    }
    words.push_str(&format!("; rows {} to {} are samples.", places.line(0), places.line(places.rows() - 1)));
    understood.words.push(words);
    if layout.passed_over > 0 {
        let lines = if layout.passed_over == 1 { "line above them was" } else { "lines above them were" };
        understood.words.push(format!("{} {lines} passed over.", layout.passed_over));
    }
    let span = places.line(places.rows() - 1) - places.line(0) + 1;
    let between = span.saturating_sub(places.rows() as u64);
    if between > 0 && !dialect.comments.is_empty() {
        understood.words.push(format!("{between} lines between samples are no samples: comments, or parts of a cell."));
    }
    for channel in Channel::ALL {
        if signals.channel(channel).is_none() {
            continue;
        }
        let name = places.column(channel);
        // Names that are there more than once have their position behind them.
        let told =
            name.rsplit_once(" #").and_then(|(bare, at)| Some((bare, at.parse::<usize>().ok()?.checked_sub(1)?)));
        let told = told.filter(|(bare, at)| layout.names.get(*at).is_some_and(|own| own == bare));
        let at = layout.names.iter().position(|n| *n == name).or(told.map(|(_, at)| at));
        let row_unit = at.and_then(|at| layout.units.get(at).cloned().flatten());
        let bare = told.map_or(name.as_str(), |(bare, _)| bare);
        let unit = names::without_unit(bare).1.map(str::to_owned).or(row_unit);
        understood.columns.push(UnderstoodColumn { signal: channel.letter(), name, unit });
    }
    let list: Vec<String> = understood.columns.iter().map(|c| format!("{} is {:?}", c.signal, c.name)).collect();
    understood.words.push(format!("{}.", list.join(", ")));
    if !places.ignored_columns().is_empty() {
        understood.words.push(format!("Left out: {}.", places.ignored_columns().join(", ")));
    }
}
