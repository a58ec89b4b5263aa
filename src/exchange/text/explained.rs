//! Refusals of tables, with what the layout explains of them, and how to go on.

use super::layout::{self, Layout, Trap};
use crate::analysis::{Code, Problem};
use crate::trial::ReadError;
use crate::trial::csv::{self, Delimiter};

/// A reader's refusal, with what the layout explains of it, and whether what is missing can be filled.
pub(super) fn refusal(error: ReadError, layout: Option<&Layout>, has_time: bool) -> Problem {
    let is_number = matches!(error, ReadError::NotANumber { .. } | ReadError::Ragged { .. });
    let is_missing = match &error {
        ReadError::NotANumber { text, .. } | ReadError::NotFinite { text, .. } => csv::is_missing(text),
        ReadError::EmptyCell { .. } => true,
        _ => false,
    };
    let known = layout.and_then(|layout| by_its_look(&error, layout));
    let mut problem = Problem::from(error);
    let Some(layout) = layout else { return problem };
    if let Some(known) = known {
        return problem.mend(known);
    }
    let mut mend = problem.mend.take().unwrap_or_default();
    if layout.dialect.decimal_comma {
        mend = mend.replace(" with a decimal point", "");
    }
    if is_missing && has_time {
        mend.push_str(
            " Or ask for resample=linear, which fills up to 0.1 s without a value and is stated with the trial.",
        );
    } else if is_number {
        let mark = if layout.dialect.decimal_comma { "comma" } else { "point" };
        let between = layout::plural(layout.dialect.delimiter);
        mend.push_str(&format!(" The file was taken for one with cells between {between} and a decimal {mark}."));
    }
    problem.mend(mend)
}

/// What to do about a cell or a row whose look tells what it is.
fn by_its_look(error: &ReadError, layout: &Layout) -> Option<String> {
    match error {
        ReadError::Ragged { expected, found, .. }
            if layout.dialect.delimiter == Delimiter::Comma && *found + 1 >= 2 * *expected =>
        {
            Some(
                "If commas stand both between cells and before decimals, export with semicolons or tabs between cells, \
                 or with decimal points (in Unity: CultureInfo.InvariantCulture)."
                    .to_owned(),
            )
        }
        ReadError::NotANumber { text, .. } => of_cell(text, layout.dialect.decimal_comma),
        _ => None,
    }
}

fn of_cell(text: &str, decimal_comma: bool) -> Option<String> {
    let text = text.trim();
    let digits = text.bytes().filter(u8::is_ascii_digit).count();
    if !text.starts_with(|c: char| c.is_ascii_digit() || "+-\u{2212}([".contains(c)) || digits == 0 {
        return None;
    }
    let marks = text.bytes().filter(|byte| b":/-".contains(byte)).count();
    if text.contains(':') && digits >= 4 || marks >= 2 && digits >= 6 {
        return Some(
            "It is a date or a time of day. Write seconds since the start in their place; with pandas: \
             when = pandas.to_datetime(table[NAME]); table['t'] = (when - when[0]).dt.total_seconds(). Or leave the \
             column out and give the time between samples (sample_time_s)."
                .to_owned(),
        );
    }
    if text.starts_with(['[', '(']) {
        return Some("It is a list of numbers. Write each number of it into a column or a row of its own.".to_owned());
    }
    if text.contains('\u{2212}') {
        return Some(
            "Its minus sign is a character of typesetting (U+2212). Replace it by the hyphen: sed 's/\u{2212}/-/g'."
                .to_owned(),
        );
    }
    let (number, rest) = text.split_at(text.find(|c: char| c.is_alphabetic() || c == '%').unwrap_or(text.len()));
    if !rest.is_empty() && csv::is_number(number, decimal_comma) {
        return Some(format!(
            "The unit {rest:?} stands in the cell. Write numbers alone, and the unit into the column's name; of a \
             timetable of MATLAB: T.t = seconds(T.Time)."
        ));
    }
    let is_grouped =
        text.bytes().filter(|byte| b".,'".contains(byte)).count() + text.matches([' ', '\u{a0}', '\u{202f}']).count();
    (rest.is_empty() && is_grouped > 0).then(|| {
        "If it has a mark between thousands, export numbers without one (in Excel: the number format General or 0.000)."
            .to_owned()
    })
}

/// A refusal of rows that look like samples and are none.
pub(super) fn trapped(trap: Trap, row: u64) -> Problem {
    match trap {
        Trap::Sideways => Problem::new(
            Code::Malformed,
            "signals in rows",
            "each row begins with a signal's name and holds its samples, and a table has one sample in each row",
        )
        .mend(
            "Turn it: pandas.read_csv(FILE, header=None, index_col=0).T.to_csv('trial.csv', index=False), or paste it \
             transposed in a spreadsheet.",
        ),
        Trap::Counted => Problem::new(
            Code::Malformed,
            "names or numbers",
            "the first row counts 0, 1, 2, …, which may be a sample or, as pandas writes them, the columns' names",
        )
        .mend("Put a first line t,r,u,y above, or in place of it: table.to_csv(FILE, header=['t', 'r', 'u', 'y'])."),
    }
    .at(format!("row {row}"))
}
