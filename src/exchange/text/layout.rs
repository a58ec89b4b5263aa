//! How a table is written, recognised from its beginning.
//!
//! Of all ways to take lines apart, the one counts in which most cells of lines of equal length are numbers. The first
//! line of numbers is the first sample; what names the columns is the line above, a comment above, or nothing.

use crate::exchange::names;
use crate::exchange::options::TimeUnit;
use crate::trial::csv::{ColumnMapping, Delimiter, Dialect, is_missing, split};

/// So many lines are looked at.
const LINES: usize = 200;

/// How comments begin.
const COMMENTS: [&str; 5] = ["#", "%", "//", "**", "!"];

/// Ways to take a line apart; of two that explain it equally well, the one that stands first.
const CANDIDATES: [(Delimiter, bool); 9] = [
    (Delimiter::Tab, false),
    (Delimiter::Comma, false),
    (Delimiter::Semicolon, false),
    (Delimiter::Bar, false),
    (Delimiter::Spaces, false),
    (Delimiter::Tab, true),
    (Delimiter::Semicolon, true),
    (Delimiter::Comma, true),
    (Delimiter::Spaces, true),
];

/// Where the names of columns stand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Titles {
    /// In this line, from 1.
    Line(u64),
    /// In this line, which is a comment.
    Comment(u64),
    /// In a file beside.
    Beside,
    /// Nowhere.
    #[default]
    None,
}

/// How a table is written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Layout {
    /// What the reader of rows must know.
    pub dialect: Dialect,
    /// Where the names stand.
    pub titles: Titles,
    /// They, or the columns' positions from 1.
    pub names: Vec<String>,
    /// The units of the columns, where a row of its own gives them.
    pub units: Vec<Option<String>>,
    /// That row, from 1.
    pub units_row: Option<u64>,
    /// The first line that is not empty, from 1.
    pub first_line: u64,
    /// The first sample's line, from 1.
    pub first_row: u64,
    /// Lines before the samples that are neither names nor units.
    pub passed_over: u64,
}

/// The name of a delimiter.
#[must_use]
pub fn name(delimiter: Delimiter) -> &'static str {
    match delimiter {
        Delimiter::Comma => "comma",
        Delimiter::Semicolon => "semicolon",
        Delimiter::Tab => "tab",
        Delimiter::Bar => "bar",
        Delimiter::Spaces => "spaces",
    }
}

/// The name of several.
#[must_use]
pub fn plural(delimiter: Delimiter) -> &'static str {
    match delimiter {
        Delimiter::Comma => "commas",
        Delimiter::Semicolon => "semicolons",
        Delimiter::Tab => "tabs",
        Delimiter::Bar => "bars",
        Delimiter::Spaces => "spaces",
    }
}

/// What a cell is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Number,
    /// What stands for a value that is not there.
    Missing,
    Empty,
    Text,
}

fn kind(cell: &str, decimal_comma: bool) -> Kind {
    let cell = cell.trim();
    if cell.is_empty() {
        return Kind::Empty;
    }
    if is_missing(cell) || ["inf", "-inf"].contains(&cell.to_ascii_lowercase().as_str()) {
        return Kind::Missing;
    }
    let is_number = if decimal_comma {
        let fraction = cell.split_once(',').is_none_or(|(_, f)| f.starts_with(|c: char| c.is_ascii_digit()));
        fraction && !cell.contains('.') && cell.replacen(',', ".", 1).parse::<f64>().is_ok()
    } else {
        cell.parse::<f64>().is_ok()
    };
    if is_number { Kind::Number } else { Kind::Text }
}

/// A line taken apart.
struct Cut {
    line: u64,
    cells: Vec<String>,
    numbers: usize,
    texts: usize,
    missing: usize,
}

impl Cut {
    fn of(line: u64, text: &str, (delimiter, decimal_comma): (Delimiter, bool)) -> Self {
        let cells: Vec<String> = split(text, delimiter).unwrap_or_else(|| vec![text.to_owned()]);
        let cells: Vec<String> = cells.into_iter().map(|cell| cell.trim().to_owned()).collect();
        let count = |wanted| cells.iter().filter(|cell| kind(cell, decimal_comma) == wanted).count();
        let (numbers, texts, missing) = (count(Kind::Number), count(Kind::Text), count(Kind::Missing));
        Self { line, cells, numbers, texts, missing }
    }

    fn is_sample(&self) -> bool {
        let count = self.cells.len();
        count > 1 && (self.numbers > 0 && self.texts <= self.numbers || self.texts == 0 && self.missing > 0)
    }
}

/// Recognises how the text is written; `None` where its beginning holds no row of numbers and no names either.
#[must_use]
pub fn recognise(head: &str, is_whole: bool, mapping: &ColumnMapping) -> Option<Layout> {
    // The reader of rows says that these are no line ends.
    if head.contains('\r') && !head.contains('\n') {
        return None;
    }
    let text = if is_whole { head } else { &head[..=head.rfind('\n')?] };
    let mut lines: Vec<(u64, &str)> = Vec::new();
    let mut open_quote = false;
    for (at, line) in text.split('\n').enumerate() {
        let continues = open_quote;
        open_quote ^= line.bytes().filter(|byte| *byte == b'"').count() % 2 == 1;
        // The reader of rows deals with cells that hold line ends.
        if !continues && !line.trim().is_empty() {
            lines.push((at as u64 + 1, line.trim_end_matches('\r')));
        }
        if lines.len() >= LINES {
            break;
        }
    }
    let first_line = lines.first()?.0;
    let comment =
        COMMENTS.into_iter().find(|marker| lines.iter().any(|(_, line)| line.trim_start().starts_with(marker)));
    let is_comment = |line: &str| comment.is_some_and(|marker| line.trim_start().starts_with(marker));
    let plain: Vec<(u64, &str)> = lines.iter().copied().filter(|(_, line)| !is_comment(line)).collect();

    let choice = best(&plain);
    let Some((candidate, width)) = choice else { return without_rows(&plain, first_line, mapping) };
    let cuts: Vec<Cut> = plain.iter().map(|(line, text)| Cut::of(*line, text, candidate)).collect();
    let first = cuts.iter().position(|cut| cut.is_sample() && cut.cells.len() == width)?;
    let (delimiter, decimal_comma) = candidate;
    let comment_of = comment.map(str::to_owned);
    let dialect = Dialect { delimiter, decimal_comma, comment: comment_of, ..Dialect::default() };
    let mut layout = Layout { dialect, first_line, first_row: cuts[first].line, ..Layout::default() };
    let above = &cuts[..first];
    let mut header = above.iter().rposition(|cut| cut.cells.len() > 1 && names::find(&cut.cells, mapping, "").is_ok());
    if header.is_none() {
        header = above.iter().rposition(|cut| cut.cells.len() > 1 && !cut.is_sample());
        // The row of units, where there is one, is the last above the samples.
        if let Some(at) = header.filter(|at| *at > 0 && are_units(&above[*at].cells) && above[*at - 1].cells.len() > 1)
        {
            header = Some(at - 1);
        }
    }
    if let Some(at) = header {
        layout.titles = Titles::Line(above[at].line);
        layout.names = above[at].cells.clone();
        match above.get(at + 1) {
            Some(next) if at + 2 == above.len() && are_units(&next.cells) => {
                layout.units_row = Some(next.line);
                layout.units = next.cells.iter().map(|cell| bare_unit(cell)).collect();
            }
            // What stands between names and samples is a row with defects: its reader says which.
            Some(next) => layout.first_row = next.line,
            None => {}
        }
    } else if let Some((line, names)) = commented(&lines, layout.first_row, comment, delimiter, width) {
        layout.titles = Titles::Comment(line);
        layout.names = names;
    } else {
        layout.names = (1..=width).map(|at| at.to_string()).collect();
        // A row of another length is a defect, of which its reader tells.
        if let Some(row) = above.iter().find(|cut| cut.is_sample() && cut.texts == 0) {
            layout.first_row = row.line;
        }
    }
    fit_width(&mut layout, &cuts[first..], width);
    let named = u64::from(layout.titles != Titles::None) + u64::from(layout.units_row.is_some());
    let before = lines.iter().filter(|(line, _)| *line < layout.first_row).count() as u64;
    layout.passed_over = before.saturating_sub(named);
    let is_plain = matches!(layout.titles, Titles::Line(1)) && layout.first_row == 2;
    if !is_plain || layout.names != above.first().map(|cut| cut.cells.clone()).unwrap_or_default() {
        layout.dialect.named = Some((layout.names.clone(), layout.first_row));
    }
    Some(layout)
}

/// The way that explains most cells as numbers, and how many cells a row then has.
fn best(lines: &[(u64, &str)]) -> Option<((Delimiter, bool), usize)> {
    let mut best: Option<((Delimiter, bool), usize, usize)> = None;
    for candidate in CANDIDATES {
        let cuts: Vec<Cut> = lines.iter().map(|(line, text)| Cut::of(*line, text, candidate)).collect();
        let samples = || cuts.iter().filter(|cut| cut.is_sample());
        let mut widths = std::collections::BTreeMap::<usize, usize>::new();
        for cut in samples() {
            *widths.entry(cut.cells.len()).or_default() += 1;
        }
        let Some((width, _)) = widths.into_iter().max_by_key(|(width, count)| (*count, *width)) else { continue };
        let score = samples().filter(|cut| cut.cells.len() == width).map(|cut| cut.numbers + cut.missing).sum();
        if score > best.map_or(0, |(_, _, score)| score) {
            best = Some((candidate, width, score));
        }
    }
    best.map(|(candidate, width, _)| (candidate, width))
}

/// Names without a row of numbers below: what separates them, so that the reader of rows can say what is missing.
fn without_rows(lines: &[(u64, &str)], first_line: u64, mapping: &ColumnMapping) -> Option<Layout> {
    let (line, text) = lines.first()?;
    let found = CANDIDATES.into_iter().filter(|(_, decimal_comma)| !decimal_comma).find_map(|candidate| {
        let names = Cut::of(*line, text, candidate).cells;
        names::find(&names, mapping, "").is_ok().then_some((candidate.0, names))
    });
    let (delimiter, names) = found?;
    let first_row = line + 1;
    let named = (*line > 1).then(|| (names.clone(), first_row));
    let dialect = Dialect { delimiter, named, ..Dialect::default() };
    Some(Layout { dialect, titles: Titles::Line(*line), names, first_line, first_row, ..Layout::default() })
}

/// Names in the last comment above the samples.
fn commented(
    lines: &[(u64, &str)],
    first_row: u64,
    comment: Option<&str>,
    delimiter: Delimiter,
    width: usize,
) -> Option<(u64, Vec<String>)> {
    let marker = comment?;
    let (line, text) =
        lines.iter().rev().find(|(line, text)| *line < first_row && text.trim_start().starts_with(marker))?;
    let mut text = text.trim();
    while let Some(rest) = text.strip_prefix(marker) {
        text = rest.trim();
    }
    // Names may be separated otherwise than numbers are.
    [delimiter, Delimiter::Comma, Delimiter::Tab, Delimiter::Semicolon, Delimiter::Spaces].into_iter().find_map(|d| {
        let names: Vec<String> = split(text, d)?.iter().map(|name| name.trim().to_owned()).collect();
        let is_named = names.iter().all(|name| kind(name, false) != Kind::Number);
        (names.len() == width && is_named).then_some((*line, names))
    })
}

/// Whether cells are units: the first says what time counts, or all stand in brackets.
fn are_units(cells: &[String]) -> bool {
    let is_bracketed = |cell: &String| {
        cell.is_empty()
            || [('(', ')'), ('[', ']'), ('{', '}')].iter().any(|(a, b)| cell.starts_with(*a) && cell.ends_with(*b))
    };
    let is_unit = |cell: &String| {
        let bare = bare_unit(cell).unwrap_or_default();
        // `t` and `u` would be names.
        bare.chars().count() <= 8 && !["t", "r", "u", "y", "d"].contains(&bare.to_lowercase().as_str())
    };
    let has_time = cells.iter().any(|cell| bare_unit(cell).is_some_and(|unit| TimeUnit::as_written(&unit).is_some()));
    cells.iter().any(|cell| !cell.is_empty())
        && (cells.iter().all(is_bracketed) || (has_time && cells.iter().all(is_unit)))
}

fn bare_unit(cell: &str) -> Option<String> {
    let bare = cell.trim().trim_matches(['(', ')', '[', ']', '{', '}']).trim();
    (!bare.is_empty()).then(|| bare.to_owned())
}

/// Makes as many names as cells where only a delimiter at the end, or the rows' own numbers in front, make the
/// difference.
fn fit_width(layout: &mut Layout, samples: &[Cut], width: usize) {
    let cell = |row: usize, at: usize| samples.get(row).and_then(|cut| cut.cells.get(at)).map(String::as_str);
    if layout.names.len() + 1 == width {
        if cell(0, width - 1) == Some("") {
            layout.names.push(String::new());
        } else if cell(0, 0) == Some("1") && cell(1, 0) == Some("2") && cell(2, 0) == Some("3") {
            layout.names.insert(0, String::new());
        }
    } else if layout.names.len() == width + 1 && layout.names.last().is_some_and(String::is_empty) {
        layout.names.pop();
    }
}
