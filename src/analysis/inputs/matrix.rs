//! Matrices of a request: rows of numbers.

use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use nalgebra::DMatrix;
use serde_json::Value;

fn ragged(row: usize, letter: &str, entries: usize, width: usize, at: &str) -> Problem {
    wrong(format!("row {row} of {letter} has {entries} entries where row 0 has {width}"), format!("{at}/{row}"))
}

/// Reads row-major nested arrays, all rows equally long.
///
/// # Errors
/// A [`Problem`] with the JSON pointer of the row or entry that is wrong.
pub fn read_rows(value: &Value, letter: &str, at: &str) -> Result<Vec<Vec<f64>>, Problem> {
    let advice = format!("Give {letter} as an array of rows, each an array of numbers: [[1, 0], [0, 1]].");
    let written =
        value.as_array().ok_or_else(|| wrong(format!("{letter} is no array of rows"), at).mend(advice.clone()))?;
    let mut rows: Vec<Vec<f64>> = Vec::with_capacity(written.len());
    for (i, row) in written.iter().enumerate() {
        let row = row.as_array().ok_or_else(|| {
            wrong(format!("row {i} of {letter} is no array"), format!("{at}/{i}")).mend(advice.clone())
        })?;
        let width = rows.first().map_or(row.len(), Vec::len);
        if row.len() != width {
            return Err(ragged(i, letter, row.len(), width, at));
        }
        let number = |(j, entry): (usize, &Value)| {
            entry.as_f64().ok_or_else(|| {
                wrong(format!("the entry of {letter} at row {i}, column {j} is no number"), format!("{at}/{i}/{j}"))
            })
        };
        rows.push(row.iter().enumerate().map(number).collect::<Result<_, _>>()?);
    }
    Ok(rows)
}

/// The matrix of rows that were read.
///
/// # Errors
/// A [`Problem`] with the JSON pointer of a row that is longer or shorter than the first.
pub fn dense(rows: &[Vec<f64>], letter: &str, at: &str) -> Result<DMatrix<f64>, Problem> {
    let width = rows.first().map_or(0, Vec::len);
    match rows.iter().position(|row| row.len() != width) {
        Some(i) => Err(ragged(i, letter, rows[i].len(), width, at)),
        None => Ok(DMatrix::from_row_iterator(rows.len(), width, rows.iter().flatten().copied())),
    }
}

/// A matrix as row-major nested arrays.
///
/// # Errors
/// As [`read_rows`].
pub fn matrix(value: &Value, letter: &str, at: &str) -> Result<DMatrix<f64>, Problem> {
    dense(&read_rows(value, letter, at)?, letter, at)
}

/// The rows of a matrix.
#[must_use]
pub fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}
