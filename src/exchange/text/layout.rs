//! How a table is written, recognised from its beginning.
//!
//! Of all ways to take lines apart, the one counts in which most cells of lines of equal length are numbers. The first
//! line of numbers is the first sample; what names the columns is the line above, a comment above, or nothing.

use super::rows::{Cut, Kind, are_units, bare_unit, kind};
use crate::exchange::names;
use crate::trial::Channel;
use crate::trial::csv::{ColumnMapping, Delimiter, Dialect, split};

/// So many lines are looked at.
const LINES: usize = 200;

/// How comments begin.
const COMMENTS: [&str; 5] = ["#", "%", "//", "**", "!"];

/// How lines of an eye tracker's text begin that stand between its samples and are none.
const EVENTS: [&str; 16] = [
    "MSG",
    "START",
    "END",
    "PRESCALER",
    "VPRESCALER",
    "PUPIL",
    "EVENTS",
    "SAMPLES",
    "SFIX",
    "EFIX",
    "SSACC",
    "ESACC",
    "SBLINK",
    "EBLINK",
    "INPUT",
    "BUTTON",
];

/// What the first line of such a text says.
const OF_EYELINK: &str = "CONVERTED FROM";

/// Names of a last column that many programs announce and few fill.
const REMARKS: [&str; 4] = ["comment", "comments", "notes", "kommentar"];

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
    /// Why it must not be read as it stands, where nothing names the columns.
    pub trap: Option<Trap>,
}

/// What looks like rows of samples and is something else.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trap {
    /// A signal in each row, its name in front.
    Sideways,
    /// A first row that counts the columns, 0, 1, 2, …
    Counted,
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
    let mut comments: Vec<String> = comment.iter().map(|marker| (*marker).to_owned()).collect();
    let is_of_eyelink = comment.is_some() && lines[0].1.contains(OF_EYELINK);
    if is_of_eyelink {
        comments.extend(EVENTS.map(str::to_owned));
    }
    let is_comment = |line: &str| comments.iter().any(|marker| line.trim_start().starts_with(marker));
    let plain: Vec<(u64, &str)> = lines.iter().copied().filter(|(_, line)| !is_comment(line)).collect();

    let choice = best(&plain);
    let Some((candidate, width)) = choice else { return without_rows(&plain, first_line, mapping) };
    let cuts: Vec<Cut> = plain.iter().map(|(line, text)| Cut::of(*line, text, candidate)).collect();
    let (delimiter, decimal_comma) = candidate;
    let first = first_sample(&cuts, width, decimal_comma)?;
    let dialect = Dialect { delimiter, decimal_comma, comments, ..Dialect::default() };
    let mut layout = Layout { dialect, first_line, first_row: cuts[first].line, ..Layout::default() };
    let above = &cuts[..first];
    if let Some(at) = header(above, width, mapping) {
        layout.titles = Titles::Line(above[at].line);
        layout.names = above[at].cells.clone();
        // What else stands between names and samples is a row with defects: its reader says which.
        let beside = above[at + 1..].iter().take_while(|cut| cut.is_beside()).count();
        if let Some(row) = above.get(at + 1 + beside) {
            layout.first_row = row.line;
        }
        if let Some(units) = above[at + 1..at + 1 + beside].iter().find(|cut| are_units(&cut.cells)) {
            layout.units_row = Some(units.line);
            layout.units = units.cells.iter().map(|cell| bare_unit(cell)).collect();
        }
    } else if let Some((line, names)) = commented(&lines, layout.first_row, comment, delimiter, width) {
        layout.titles = Titles::Comment(line);
        layout.names = names;
    } else {
        layout.names = (1..=width).map(|at| at.to_string()).collect();
        // A row with a defect, of which its reader tells.
        if let Some(row) = above.iter().find(|cut| cut.is_defective()) {
            layout.first_row = row.line;
        }
        layout.trap = trap(&cuts[first..]);
        if is_of_eyelink {
            // Its first column counts them, whatever the rate.
            layout.units.push(Some("ms".to_owned()));
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

/// The first line in which no words stand where lines mostly have numbers.
fn first_sample(cuts: &[Cut], width: usize, decimal_comma: bool) -> Option<usize> {
    let is_sample = |cut: &Cut| cut.is_sample() && cut.cells.len() == width;
    let kinds = |cut: &Cut| cut.cells.iter().map(|cell| kind(cell, decimal_comma)).collect::<Vec<_>>();
    let samples: Vec<(usize, Vec<Kind>)> =
        cuts.iter().enumerate().filter(|(_, cut)| is_sample(cut)).map(|(at, cut)| (at, kinds(cut))).collect();
    let is_numeric = |kind: Kind| matches!(kind, Kind::Number | Kind::Missing);
    let numeric: Vec<bool> = (0..width)
        .map(|column| 2 * samples.iter().filter(|(_, kinds)| is_numeric(kinds[column])).count() > samples.len())
        .collect();
    let fits = |at: usize, kinds: &[Kind]| {
        let words = kinds.iter().zip(&numeric).any(|(kind, numeric)| *numeric && *kind == Kind::Text);
        !(words || numeric[0] && kinds[0] == Kind::Empty && cuts[at].are_counts())
    };
    samples.iter().find(|(at, kinds)| fits(*at, kinds)).or(samples.first()).map(|(at, _)| *at)
}

/// The line that names the columns: the last that has all names, or the last of words.
fn header(above: &[Cut], width: usize, mapping: &ColumnMapping) -> Option<usize> {
    // By position any line of so many cells would do: then only one that is as long as the samples.
    let by_position = Channel::ALL.into_iter().any(|c| mapping.name(c).is_some_and(|n| n.parse::<usize>().is_ok()));
    let fewer = usize::from(!by_position);
    let is_long = |cut: &Cut| (width.saturating_sub(fewer)..=width + 1).contains(&cut.cells.len());
    let is_row = |cut: &Cut| cut.cells.len() > 1 && cut.numbers == 0 && !cut.is_sample() && !cut.has_key();
    let has_title = |cut: &Cut| cut.cells.len() > 1 && cut.has_title();
    let is_found = |cut: &Cut| (is_long(cut) || !by_position) && names::find(&cut.cells, mapping, "").is_ok();
    let last = |wanted: &dyn Fn(&Cut) -> bool| above.iter().rposition(wanted);
    let at = last(&|cut| is_row(cut) && is_found(cut))
        .or_else(|| last(&|cut| has_title(cut) && is_found(cut)))
        .or_else(|| last(&|cut| is_row(cut) && is_long(cut)))
        .or_else(|| last(&|cut| has_title(cut) && is_long(cut)))
        .or_else(|| last(&|cut| is_row(cut) && !by_position))?;
    // The row of units, where there is one, is the last above the samples.
    let is_below = at > 0 && are_units(&above[at].cells) && is_row(&above[at - 1]);
    Some(if is_below { at - 1 } else { at })
}

/// What rows without names might be instead of samples.
fn trap(samples: &[Cut]) -> Option<Trap> {
    let first = samples.first()?;
    let names: Vec<String> = samples.iter().filter_map(|cut| cut.cells.first()).cloned().collect();
    if samples.len() < 12 && names::find(&names, &ColumnMapping::default(), "").is_ok() {
        return Some(Trap::Sideways);
    }
    let cells = first.cells.strip_prefix(&[String::new()]).unwrap_or(&first.cells);
    (cells.len() > 2 && cells.iter().enumerate().all(|(at, cell)| *cell == at.to_string())).then_some(Trap::Counted)
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
        // Between spaces, settings above the samples may look like some more of them; names with spaces are lost.
        let needed = best.map_or(0, |(other, _, score)| match (other.0, candidate.0) {
            (Delimiter::Tab, Delimiter::Spaces) => score + score / 2,
            _ => score,
        });
        if score > needed {
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
    } else if layout.names.len() == width + 1
        && layout.names.last().is_some_and(|name| name.is_empty() || REMARKS.contains(&name.to_lowercase().as_str()))
    {
        layout.names.pop();
    }
}
