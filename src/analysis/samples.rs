//! What is to be played, as a table: the samples of a judged signal, of a designed input, of a target.

use super::contract::Samples;
use super::problem::{Code, Problem};
use super::registry;
use super::report::Report;
use crate::excite::sequence::write;
use serde_json::Value;

/// The samples of a report, the signal first.
///
/// # Errors
/// `not_found` where the report carries no samples.
pub fn of(report: &Report) -> Result<Samples, Problem> {
    registry::samples(report).filter(|samples| !samples.columns.is_empty()).ok_or_else(|| {
        Problem::new(Code::NotFound, "no samples", "this result carries no samples").mend(
            "Ask for an excitation_quality with \"include_samples\": true, an input_design, a robust_input_design or a \
             simulate.",
        )
    })
}

/// The samples of a report as CSV with a time column, the signal first.
///
/// # Errors
/// `not_found` where the report carries no samples.
pub fn csv(report: &Report) -> Result<String, Problem> {
    let Samples { sample_time_s, columns } = of(report)?;
    let columns: Vec<(&str, &[f64])> =
        columns.iter().map(|(name, values)| (name.as_str(), values.as_slice())).collect();
    let mut text = Vec::new();
    // Writing to memory cannot fail, and numbers are ASCII.
    let _ = write::csv(sample_time_s, &columns, &mut text);
    Ok(String::from_utf8(text).unwrap_or_default())
}

impl Samples {
    /// Columns of a result by their names; those that are no arrays of numbers are left out.
    pub(super) fn named(sample_time_s: &Value, columns: &[(&str, &Value)]) -> Option<Self> {
        let columns =
            columns.iter().filter_map(|(name, values)| Some(((*name).to_owned(), numbers(values)?))).collect();
        Some(Self { sample_time_s: sample_time_s.as_f64()?, columns })
    }
}

/// An array of numbers.
fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}
