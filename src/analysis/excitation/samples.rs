//! The samples of a report, as a table.
//!
//! Any result may carry `samples`: `{"sample_time_s", "signal": [..], "output": [..], ..}` with columns of equal length.

use crate::analysis::problem::{Code, Problem};
use crate::excite::sequence::write;
use serde_json::{Map, Value};

/// The columns, `signal` first, as CSV with a time column.
///
/// # Errors
/// `not_found` where the result carries no samples.
pub fn csv(result: &Value) -> Result<String, Problem> {
    let missing = || {
        Problem::new(Code::NotFound, "no samples", "this result carries no samples")
            .mend("Ask for an excitation_quality with \"include_samples\": true.")
    };
    let members: &Map<String, Value> = result.get("samples").and_then(Value::as_object).ok_or_else(missing)?;
    let sample_time_s = members.get("sample_time_s").and_then(Value::as_f64).ok_or_else(missing)?;
    let mut columns: Vec<(&str, Vec<f64>)> = members
        .iter()
        .filter_map(|(name, value)| {
            let values: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
            Some((name.as_str(), values?))
        })
        .collect();
    columns.sort_by_key(|(name, _)| (*name != "signal", (*name).to_owned()));
    let columns: Vec<(&str, &[f64])> = columns.iter().map(|(name, values)| (*name, values.as_slice())).collect();
    let mut text = Vec::new();
    // Writing to memory cannot fail, and numbers are ASCII.
    let _ = write::csv(sample_time_s, &columns, &mut text);
    Ok(String::from_utf8(text).unwrap_or_default())
}
