//! What is to be played, as a table: the samples of a judged signal, of a designed input, of a target.

use crate::analysis::kind::Kind;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::report::Report;
use crate::excite::sequence::write;
use serde_json::Value;

/// The samples of a report as CSV with a time column, `signal` first: of `excitation_quality` with what comes out of the plant or loop, of
/// `input_design` with the `start` that the input was reached from, of `robust_input_design` with the `nominal` target.
///
/// # Errors
/// `not_found` where the report carries no samples.
pub fn csv(report: &Report) -> Result<String, Problem> {
    let result = &report.result;
    let (sample_time_s, columns) = match report.kind {
        Kind::ExcitationQuality => (&result["samples"]["sample_time_s"], of_signal(&result["samples"])),
        Kind::InputDesign => {
            (&result["sample_time_s"], named(&[("signal", &result["input"]), ("start", &result["start_input"])]))
        }
        Kind::RobustInputDesign => (
            &result["robust"]["target"]["sample_time_s"],
            named(&[("signal", &result["robust"]["samples"]), ("nominal", &result["nominal"]["samples"])]),
        ),
        _ => (&Value::Null, Vec::new()),
    };
    let sample_time_s = sample_time_s.as_f64().filter(|_| !columns.is_empty()).ok_or_else(|| {
        Problem::new(Code::NotFound, "no samples", "this result carries no samples").mend(
            "Ask for an excitation_quality with \"include_samples\": true, an input_design or a robust_input_design.",
        )
    })?;
    let columns: Vec<(&str, &[f64])> = columns.iter().map(|(name, values)| (*name, values.as_slice())).collect();
    let mut text = Vec::new();
    // Writing to memory cannot fail, and numbers are ASCII.
    let _ = write::csv(sample_time_s, &columns, &mut text);
    Ok(String::from_utf8(text).unwrap_or_default())
}

fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}

fn named<'a>(columns: &[(&'a str, &Value)]) -> Vec<(&'a str, Vec<f64>)> {
    columns.iter().filter_map(|(name, values)| Some((*name, numbers(values)?))).collect()
}

/// Every array of the samples, `signal` first and the others by name.
fn of_signal(samples: &Value) -> Vec<(&str, Vec<f64>)> {
    let members = samples.as_object().into_iter().flatten();
    let mut columns: Vec<_> = members.filter_map(|(name, values)| Some((name.as_str(), numbers(values)?))).collect();
    columns.sort_by_key(|(name, _)| (*name != "signal", *name));
    columns
}
