//! Documents as lists of what they say.

use maud::{Markup, html};
use serde_json::Value;

/// Entries that are shown; the rest is in the JSON.
const MOST: usize = 40;
/// Numbers of a list that are written out.
const MOST_NUMBERS: usize = 8;
/// Letters of a text.
const MOST_LETTERS: usize = 300;

/// Names with their values; what holds other things is opened once, what is too large is counted.
pub(super) fn list<'a>(
    fields: impl Iterator<Item = (&'a str, &'a Value)>,
    number: impl Fn(f64) -> String + Copy,
) -> Markup {
    let mut flat: Vec<(String, String)> = Vec::new();
    for (name, value) in fields {
        match value {
            Value::Object(inner) => {
                for (own, value) in inner {
                    flat.push((format!("{name} · {own}"), words(value, number)));
                }
            }
            other => flat.push((name.to_owned(), words(other, number))),
        }
    }
    let left = flat.len().saturating_sub(MOST);
    html! {
        dl.values {
            @for (name, value) in flat.iter().take(MOST) {
                div { dt { (name.replace('_', " ")) } dd { (value) } }
            }
        }
        @if left > 0 { p.muted { (left) " more are in the JSON." } }
    }
}

fn words(value: &Value, number: impl Fn(f64) -> String + Copy) -> String {
    match value {
        Value::Null => "–".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::Number(own) => match (own.as_i64(), own.as_f64()) {
            (Some(whole), _) => whole.to_string(),
            (None, Some(real)) => number(real),
            (None, None) => own.to_string(),
        },
        Value::String(text) => text.chars().take(MOST_LETTERS).collect(),
        Value::Array(items) if items.is_empty() => "none".to_owned(),
        Value::Array(items) if items.len() <= MOST_NUMBERS && items.iter().all(|item| !item.is_object()) => {
            items.iter().map(|item| words(item, number)).collect::<Vec<_>>().join(", ")
        }
        Value::Array(items) => format!("{} entries", items.len()),
        Value::Object(fields) => format!("{} fields", fields.len()),
    }
}
