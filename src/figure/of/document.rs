//! Reading numbers of a report by their place in it.

use super::bode::Unreadable;
use serde_json::Value;

/// The error where a report has not what a figure needs.
fn lacks(pointer: &str) -> Unreadable {
    Unreadable::Form(format!("it has no numbers at {pointer}"))
}

/// A number; `None` where it is null or not there.
pub(super) fn number(value: &Value, pointer: &str) -> Option<f64> {
    value.pointer(pointer)?.as_f64()
}

/// A text; `None` where it is null or not there.
pub(super) fn text<'a>(value: &'a Value, pointer: &str) -> Option<&'a str> {
    value.pointer(pointer)?.as_str()
}

/// The members of a list; empty where there is none.
pub(super) fn members<'a>(value: &'a Value, pointer: &str) -> &'a [Value] {
    value.pointer(pointer).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// A list of numbers, each null where it is null.
pub(super) fn numbers(value: &Value, pointer: &str) -> Result<Vec<Option<f64>>, Unreadable> {
    let list = value.pointer(pointer).and_then(Value::as_array).ok_or_else(|| lacks(pointer))?;
    Ok(list.iter().map(Value::as_f64).collect())
}

/// A list of numbers that are all there.
pub(super) fn all_numbers(value: &Value, pointer: &str) -> Result<Vec<f64>, Unreadable> {
    numbers(value, pointer)?.into_iter().collect::<Option<_>>().ok_or_else(|| lacks(pointer))
}

/// The texts of a list.
pub(super) fn texts(value: &Value, pointer: &str) -> Vec<String> {
    members(value, pointer).iter().filter_map(|own| own.as_str().map(str::to_owned)).collect()
}

/// A matrix by rows.
pub(super) fn matrix(value: &Value, pointer: &str) -> Result<nalgebra::DMatrix<f64>, Unreadable> {
    let rows: Option<Vec<Vec<f64>>> = value.pointer(pointer).and_then(|rows| serde_json::from_value(rows.clone()).ok());
    let rows = rows.ok_or_else(|| lacks(pointer))?;
    let columns = rows.first().map_or(0, Vec::len);
    if rows.iter().any(|row| row.len() != columns) {
        return Err(lacks(pointer));
    }
    Ok(nalgebra::DMatrix::from_row_iterator(rows.len(), columns, rows.into_iter().flatten()))
}
