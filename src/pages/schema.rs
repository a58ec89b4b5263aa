//! The fields of a kind's spec, from its schema.

use crate::analysis::registry::About;
use serde_json::{Map, Value};
use std::sync::LazyLock;

/// The schemas of the published document.
static SCHEMAS: LazyLock<Value> = LazyLock::new(|| crate::api::openapi()["components"]["schemas"].take());

/// How a field is filled in.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Input {
    /// One of these words.
    Choice(Vec<String>),
    /// Yes or no.
    Flag,
    /// A whole number, or any.
    Number { is_whole: bool, least: Option<f64>, most: Option<f64> },
    /// Numbers separated by commas.
    Numbers,
    /// A text.
    Text,
}

/// A field that a form can hold; whatever is richer is written as JSON.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) input: Input,
    pub(super) description: String,
    pub(super) default: Option<Value>,
}

/// A schema with its reference followed, and without the choice of null.
fn resolved(schema: &Value) -> &Value {
    let mut schema = schema;
    for _ in 0..4 {
        if let Some(name) = schema["$ref"].as_str().and_then(|path| path.rsplit('/').next()) {
            schema = &SCHEMAS[name];
        } else if let Some([own, null]) = schema["anyOf"].as_array().map(Vec::as_slice)
            && null["type"] == "null"
        {
            schema = own;
        } else {
            break;
        }
    }
    schema
}

/// Whether a schema is of a type, null aside.
fn is_of(schema: &Value, name: &str) -> bool {
    match &schema["type"] {
        Value::String(own) => own == name,
        Value::Array(all) => all.iter().any(|own| own == name) && all.iter().all(|own| own == name || own == "null"),
        _ => false,
    }
}

/// The words of an enumeration, also where each has a sentence of its own.
fn words(schema: &Value) -> Option<Vec<String>> {
    if let Some(all) = schema["enum"].as_array() {
        return all.iter().map(|word| word.as_str().map(str::to_owned)).collect();
    }
    let all = schema["oneOf"].as_array()?;
    all.iter().map(|one| one["const"].as_str().map(str::to_owned)).collect()
}

fn input(schema: &Value) -> Option<Input> {
    if let Some(words) = words(schema) {
        return Some(Input::Choice(words));
    }
    let bound = |name: &str| schema[name].as_f64();
    let number = |is_whole| Input::Number { is_whole, least: bound("minimum"), most: bound("maximum") };
    match schema {
        own if is_of(own, "boolean") => Some(Input::Flag),
        own if is_of(own, "integer") => Some(number(true)),
        own if is_of(own, "number") => Some(number(false)),
        own if is_of(own, "string") => Some(Input::Text),
        own if is_of(own, "array") => {
            let items = resolved(&own["items"]);
            (is_of(items, "number") || is_of(items, "integer")).then_some(Input::Numbers)
        }
        _ => None,
    }
}

/// The fields of a kind's spec that a form can hold.
pub(super) fn fields(about: &About) -> Vec<Field> {
    let schema = &SCHEMAS[format!("{}Spec", about.type_prefix())];
    let found = schema["properties"].as_object().into_iter().flatten().filter_map(|(name, own)| {
        let inner = resolved(own);
        let text = |key: &str| own[key].as_str().or(inner[key].as_str()).unwrap_or_default().to_owned();
        let default = own.get("default").or(inner.get("default")).filter(|value| !value.is_null()).cloned();
        Some(Field { name: name.clone(), input: input(inner)?, description: text("description"), default })
    });
    found.collect()
}

impl Field {
    /// What somebody wrote as a value; `None` where it was left empty.
    ///
    /// # Errors
    /// What it is not, in words.
    pub(super) fn value(&self, text: &str) -> Result<Option<Value>, String> {
        let text = text.trim();
        if text.is_empty() {
            return Ok(None);
        }
        let number = |text: &str, is_whole: bool| {
            let text = text.trim();
            let whole = text.parse::<i64>().map(Value::from).ok();
            let real = text.parse::<f64>().ok().filter(|value| value.is_finite()).map(Value::from);
            let found = if is_whole { whole } else { whole.or(real) };
            found.ok_or_else(|| format!("'{text}' is not {}", if is_whole { "a whole number" } else { "a number" }))
        };
        let found = match &self.input {
            Input::Choice(_) | Input::Text => Value::from(text),
            Input::Flag => Value::from(text == "yes"),
            Input::Number { is_whole, .. } => number(text, *is_whole)?,
            Input::Numbers => {
                let all: Result<Vec<Value>, String> = text.split(',').map(|one| number(one, false)).collect();
                Value::Array(all?)
            }
        };
        Ok(Some(found))
    }
}

/// What of a kind's example no form field holds.
pub(super) fn rest_of_example(about: &About, fields: &[Field]) -> Map<String, Value> {
    let example: Value = serde_json::from_str(about.example).unwrap_or_default();
    let spec = example["spec"].as_object().cloned().unwrap_or_default();
    spec.into_iter().filter(|(name, _)| fields.iter().all(|field| field.name != *name)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::registry::kinds;

    #[test]
    fn every_kind_has_fields_or_a_rest() {
        let mut all = 0;
        for about in kinds() {
            let found = fields(about);
            assert!(found.iter().all(|field| !field.description.is_empty()), "{}: {found:?}", about.kind);
            all += found.len();
        }
        assert!(all > 40, "{all}");
    }

    #[test]
    fn what_is_written_becomes_what_the_schema_asks_for() {
        let about = kinds().find(|about| about.kind.name() == "prediction_error").unwrap();
        let found = fields(about);
        let of = |name: &str| found.iter().find(|field| field.name == name).unwrap();
        assert_eq!(of("band_hz").input, Input::Numbers);
        assert_eq!(of("band_hz").value("0.02, 0.5").unwrap(), Some(serde_json::json!([0.02, 0.5])));
        assert_eq!(of("band_hz").value("0.02; 0.5").unwrap_err(), "'0.02; 0.5' is not a number");
        assert_eq!(of("autoregressive_order").value(" 8 ").unwrap(), Some(Value::from(8)));
        assert_eq!(of("autoregressive_order").value("8.5").unwrap_err(), "'8.5' is not a whole number");
        assert_eq!(of("preview_s").value("").unwrap(), None);
    }
}
