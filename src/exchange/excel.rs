//! Sheets of Excel (`.xlsx`): their cells as a table of text, which the one reader of tables reads.
//!
//! A number becomes the shortest text that reads back as the same double: the one nearest to the decimal number in the
//! sheet. Dates, truth values and errors keep their words, and are no numbers. Cells come one by one and rows are only
//! as long as they are filled: a sheet that says it is a million columns wide costs nothing.

use crate::analysis::{Code, Problem};
use crate::trial::ReadError;
use calamine::{DataRef, Reader as _, SheetType, Xlsx};
use std::fmt::Write as _;
use std::io::Cursor;

/// Columns beyond this are no recording.
const MAX_COLUMNS: u32 = 1000;

/// A sheet as a table.
pub(super) struct Sheet {
    pub(super) name: String,
    /// Cells between tabs; a line for every row of the sheet, down to the last that is filled.
    pub(super) text: String,
    /// How many other sheets there are.
    pub(super) others: usize,
}

fn damaged(why: impl std::fmt::Display) -> Problem {
    Problem::new(Code::Malformed, "damaged Excel file", format!("the sheets cannot be read: {why}"))
        .mend("Save it anew, or save the sheet as CSV.")
}

/// The sheet with the samples.
///
/// # Errors
/// Where the file is damaged, no sheet has numbers, or several have.
pub(super) fn sheet(file: &[u8], max_rows: usize, max_bytes: u64) -> Result<Sheet, Problem> {
    let mut book = Xlsx::new(Cursor::new(file)).map_err(damaged)?;
    let sheets: Vec<String> = book
        .sheets_metadata()
        .iter()
        .filter(|sheet| sheet.typ == SheetType::WorkSheet)
        .map(|sheet| sheet.name.clone())
        .collect();
    let mut found: Option<(String, String)> = None;
    let mut left = max_bytes;
    for name in &sheets {
        let (text, numbers) = table(&mut book, name, max_rows, left)?;
        left = left.saturating_sub(text.len() as u64);
        // Two samples of three signals at least.
        if numbers < 6 {
            continue;
        }
        if let Some((first, _)) = &found {
            return Err(Problem::new(
                Code::Malformed,
                "several sheets",
                format!("the sheets {first:?} and {name:?} both hold numbers, and a trial is one sheet"),
            )
            .at(format!("sheet {name}"))
            .mend("Save the sheet that is meant as a file of its own, or as CSV."));
        }
        found = Some((name.clone(), text));
    }
    let Some((name, text)) = found else {
        return Err(Problem::new(Code::Malformed, "no data", "no sheet has rows of numbers")
            .mend("Put names in the first row and one sample in each row below."));
    };
    Ok(Sheet { name, text, others: sheets.len() - 1 })
}

/// A sheet's cells between tabs, and how many of them are numbers.
fn table(
    book: &mut Xlsx<Cursor<&[u8]>>,
    name: &str,
    max_rows: usize,
    max_bytes: u64,
) -> Result<(String, usize), Problem> {
    let mut cells = book.worksheet_cells_reader(name).map_err(damaged)?;
    let (mut text, mut numbers) = (String::new(), 0);
    // The row and column where the next cell would be.
    let (mut row, mut column) = (0, 0);
    while let Some(cell) = cells.next_cell().map_err(damaged)? {
        let (at_row, at_column) = cell.get_position();
        let words = match cell.get_value() {
            DataRef::Empty => continue,
            DataRef::Float(value) => format!("{value:?}"),
            DataRef::Int(value) => value.to_string(),
            DataRef::String(words) => plain(words),
            DataRef::SharedString(words) => plain(words),
            DataRef::Bool(value) => value.to_string(),
            DataRef::Error(error) => error.to_string(),
            DataRef::DateTime(_) | DataRef::DateTimeIso(_) | DataRef::DurationIso(_) => "(a date)".to_owned(),
        };
        if words.is_empty() {
            continue;
        }
        if at_column >= MAX_COLUMNS {
            let detail = format!("there is a cell beyond column {MAX_COLUMNS}");
            return Err(Problem::new(Code::TooLarge, "too many columns", detail)
                .at(format!("sheet {name}, row {}", at_row + 1))
                .mend("Put the signals into the first columns."));
        }
        // A few rows above the samples are titles.
        if at_row as usize > max_rows.saturating_add(1000) {
            return Err(ReadError::TooManyRows { limit: max_rows }.into());
        }
        if at_row < row || at_row == row && at_column < column {
            return Err(damaged("its cells are in no order"));
        }
        while row < at_row {
            text.push('\n');
            row += 1;
            column = 0;
        }
        while column < at_column {
            text.push('\t');
            column += 1;
        }
        numbers += usize::from(matches!(cell.get_value(), DataRef::Float(_) | DataRef::Int(_)));
        let _ = write!(text, "{words}");
        if text.len() as u64 > max_bytes {
            return Err(ReadError::TooManyBytes { limit: max_bytes }.into());
        }
    }
    text.push('\n');
    Ok((padded(&text), numbers))
}

/// Text of a cell in one line, without what separates cells.
fn plain(words: &str) -> String {
    words.split(|c: char| c.is_control() || c == '"').map(str::trim).collect::<Vec<_>>().join(" ").trim().to_owned()
}

/// Lines of equal length where cells at their ends are not filled: an empty cell says more than a short row.
fn padded(text: &str) -> String {
    let width = |line: &str| line.bytes().filter(|byte| *byte == b'\t').count();
    let Some(most) = text.lines().map(width).max() else { return String::new() };
    let mut all = String::with_capacity(text.len());
    for line in text.lines() {
        all.push_str(line);
        if !line.is_empty() {
            all.extend(std::iter::repeat_n('\t', most - width(line)));
        }
        all.push('\n');
    }
    all
}
