//! A report in a few lines, for people at a terminal.

use crate::analysis::estimates::{QuantityTrust, quantities};
use crate::analysis::{Report, registry};
use serde_json::Value;
use std::fmt::Write as _;

/// Members of a result that are shown where a report has no quantities of its own, at most.
const MOST_MEMBERS: usize = 12;
/// Values of a list or matrix that are written out, at most.
const MOST_VALUES: usize = 16;

/// What was asked, the quantities with their intervals and how far they may be used, and what must be read.
pub(super) fn summary(report: &Report) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write(&mut text, report);
    text
}

fn write(out: &mut String, report: &Report) -> std::fmt::Result {
    let title = registry::kinds().find(|about| about.kind == report.kind).map_or("", |about| about.title);
    write!(out, "{}: {title}", report.kind)?;
    if let Some(seconds) = report.provenance.wall_time_s {
        write!(out, ", in {seconds:.2} s")?;
    }
    writeln!(out)?;
    let found = quantities(report, None);
    members(out, &report.result, found.is_empty())?;
    let widest = found.iter().map(|quantity| name(quantity).chars().count()).max().unwrap_or_default();
    for quantity in &found {
        // A matrix stands in the result under its own name.
        let written = || report.result.get(&quantity.trust.quantity).and_then(short).unwrap_or_else(|| "-".to_owned());
        let value = quantity.value.map_or_else(written, number);
        let interval =
            quantity.interval_95.map_or_else(String::new, |[low, high]| format!("[{}, {}]", number(low), number(high)));
        let (name, level) = (name(quantity), quantity.trust.level);
        write!(out, "  {name:<widest$}  {value:>11}  {interval:<26}  {} {}", level.sign(), level.words())?;
        if !quantity.trust.advice.is_empty() {
            write!(out, ": {}", quantity.trust.because)?;
        }
        writeln!(out)?;
    }
    match report.warnings.len() {
        0 => {}
        1 => writeln!(out, "One warning, to be read first:")?,
        count => writeln!(out, "{count} warnings, to be read first:")?,
    }
    for warning in &report.warnings {
        writeln!(out, "  {}: {}", warning.code, warning.message)?;
    }
    writeln!(out, "The whole report: --json, or write it to a file with > report.json")
}

fn name(quantity: &QuantityTrust) -> String {
    match quantity.estimator {
        Some(estimator) => format!("{} ({})", quantity.trust.quantity, estimator.name()),
        None => quantity.trust.quantity.clone(),
    }
}

/// Six digits: what a person reads, and no more than any of these numbers is known to.
fn number(value: f64) -> String {
    let magnitude = value.abs();
    if value == 0.0 || (1e-3..1e6).contains(&magnitude) {
        let digits = if magnitude >= 1.0 { 5 - magnitude.log10().floor() as usize } else { 6 };
        let text = format!("{value:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    } else {
        format!("{value:.5e}")
    }
}

/// Members that are shown before others: what was asked for.
const FIRST: [&str; 3] = ["conclusion", "verdict", "evidence"];

/// The members of a result that are short enough to be read; where its quantities follow, without lists.
fn members(out: &mut String, result: &Value, with_lists: bool) -> std::fmt::Result {
    let all = result.as_object().into_iter().flatten().filter(|(_, value)| with_lists || !value.is_array());
    let mut all: Vec<(&String, String)> = all.filter_map(|(name, value)| Some((name, short(value)?))).collect();
    all.sort_by_key(|(name, _)| FIRST.iter().position(|first| first == name).unwrap_or(FIRST.len()));
    for (name, value) in all.into_iter().take(MOST_MEMBERS) {
        writeln!(out, "  {name}: {value}")?;
    }
    Ok(())
}

fn short(value: &Value) -> Option<String> {
    match value {
        Value::Null | Value::Object(_) => None,
        Value::Bool(truth) => Some(if *truth { "yes" } else { "no" }.to_owned()),
        Value::String(text) => Some(text.clone()),
        Value::Number(found) => found.as_f64().map(number),
        Value::Array(items) => {
            let count: usize = items.iter().map(|item| item.as_array().map_or(1, Vec::len)).sum();
            if items.is_empty() || count > MOST_VALUES {
                return None;
            }
            let items: Option<Vec<String>> = items.iter().map(short).collect();
            Some(format!("[{}]", items?.join(", ")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_have_six_digits() {
        for (value, text) in [
            (0.0, "0"),
            (1.0, "1"),
            (-1.5, "-1.5"),
            (123_456.7, "123457"),
            (1.0 / 3.0, "0.333333"),
            (2.0e-7, "2.00000e-7"),
            (12.345_678_9, "12.3457"),
            (1e9, "1.00000e9"),
        ] {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn matrices_are_written_out_while_they_are_small() {
        assert_eq!(short(&json!([[1.0, 2.0], [2.5, 4.0]])).as_deref(), Some("[[1, 2], [2.5, 4]]"));
        assert_eq!(short(&json!(vec![1.0; 17])), None);
        assert_eq!(short(&json!({"a": 1})), None);
        assert_eq!(short(&json!(true)).as_deref(), Some("yes"));
    }
}
