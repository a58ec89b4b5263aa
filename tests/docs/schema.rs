//! A JSON schema as a page that people read.

use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// Writes the parts of a schema, and after them every type that they name, each once.
pub struct Writer<'a> {
    /// Types by name: `$defs` of the schema.
    definitions: &'a Map<String, Value>,
    /// Types that were named, in the order in which they were.
    named: Vec<String>,
    seen: BTreeSet<String>,
}

impl<'a> Writer<'a> {
    pub fn new(definitions: &'a Map<String, Value>) -> Self {
        Self { definitions, named: Vec::new(), seen: BTreeSet::new() }
    }

    /// A schema with its fields or alternatives.
    pub fn part(&mut self, schema: &Value) -> String {
        let schema = self.resolved(schema);
        let mut out = String::new();
        if let Some(text) = schema["description"].as_str() {
            writeln!(out, "{}\n", without_links(text.trim())).unwrap();
        }
        self.body(schema, 0, &mut out);
        out
    }

    /// The types named so far, and those that they name.
    pub fn types(&mut self) -> String {
        let mut out = String::new();
        let mut next = 0;
        while next < self.named.len() {
            let name = self.named[next].clone();
            next += 1;
            let definitions = self.definitions;
            let schema = definitions.get(&name).unwrap_or_else(|| panic!("no type is called {name}"));
            write!(out, "### `{name}`\n\n{}", self.part(schema)).unwrap();
            out.push('\n');
        }
        out
    }

    /// A reference's own target, where a part is nothing but a reference.
    fn resolved<'s>(&self, schema: &'s Value) -> &'s Value
    where
        'a: 's,
    {
        let is_reference = schema.as_object().is_some_and(|members| members.len() == 1);
        match schema["$ref"].as_str().filter(|_| is_reference).and_then(|path| path.rsplit('/').next()) {
            Some(name) => &self.definitions[name],
            None => schema,
        }
    }

    fn body(&mut self, schema: &Value, depth: usize, out: &mut String) {
        let indent = "  ".repeat(depth);
        let required: BTreeSet<&str> =
            schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let properties = schema["properties"].as_object();
        for (name, field) in properties.into_iter().flatten() {
            let mut notes = vec![self.type_of(field)];
            match field.get("default").filter(|value| !value.is_null()) {
                Some(default) => notes.push(format!("default `{default}`")),
                None if required.contains(name.as_str()) => {}
                None => notes.push("optional".to_owned()),
            }
            write!(out, "{indent}- `{name}` ({})", notes.join(", ")).unwrap();
            match description(field) {
                Some(text) => writeln!(out, ": {text}").unwrap(),
                None => writeln!(out).unwrap(),
            }
            self.inline(field, depth + 1, out);
        }
        for alternatives in ["oneOf", "anyOf", "allOf"].iter().filter_map(|key| schema[*key].as_array()) {
            for alternative in alternatives.iter().filter(|a| a["type"] != "null") {
                write!(out, "{indent}- {}", self.type_of(alternative)).unwrap();
                match description(alternative) {
                    Some(text) => writeln!(out, ": {text}").unwrap(),
                    None => writeln!(out).unwrap(),
                }
                self.inline(alternative, depth + 1, out);
            }
        }
        if properties.is_none() && schema.get("oneOf").or(schema.get("anyOf")).is_none() && depth == 0 {
            writeln!(out, "{}", sentence(&self.type_of(schema))).unwrap();
        }
    }

    /// The fields of an object that has no name of its own.
    fn inline(&mut self, schema: &Value, depth: usize, out: &mut String) {
        if schema["properties"].is_object() || schema["oneOf"].is_array() || schema["anyOf"].is_array() {
            if !is_simple(schema) {
                self.body(schema, depth, out);
            }
        } else if schema["items"]["properties"].is_object() {
            self.body(&schema["items"], depth, out);
        }
    }

    /// The type of a value in a few words.
    fn type_of(&mut self, schema: &Value) -> String {
        if let Some(path) = schema["$ref"].as_str() {
            let name = path.rsplit('/').next().unwrap_or(path).to_owned();
            if self.seen.insert(name.clone()) {
                self.named.push(name.clone());
            }
            return format!("[`{name}`](#{})", name.to_lowercase());
        }
        if let Some(value) = schema.get("const") {
            return format!("`{value}`");
        }
        if let Some(values) = schema["enum"].as_array() {
            let values: Vec<String> = values.iter().map(|value| format!("`{value}`")).collect();
            return or(&values);
        }
        for key in ["oneOf", "anyOf"] {
            if let Some(list) = schema[key].as_array() {
                let mut types: Vec<String> = list.iter().map(|one| self.type_of(one)).collect();
                types.dedup();
                return or(&types);
            }
        }
        if let Some(list) = schema["allOf"].as_array() {
            let types: Vec<String> = list.iter().map(|one| self.type_of(one)).collect();
            return types.join(" and ");
        }
        match &schema["type"] {
            Value::String(name) => self.named_type(name, schema),
            Value::Array(names) => {
                let types: Vec<String> =
                    names.iter().filter_map(Value::as_str).map(|name| self.named_type(name, schema)).collect();
                or(&types)
            }
            _ => "any value".to_owned(),
        }
    }

    fn named_type(&mut self, name: &str, schema: &Value) -> String {
        match name {
            "array" => {
                if let Some(parts) = schema["prefixItems"].as_array() {
                    let parts: Vec<String> = parts.iter().map(|part| self.type_of(part)).collect();
                    return format!("[{}]", parts.join(", "));
                }
                let of = plural(&self.type_of(&schema["items"]));
                match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
                    (Some(least), Some(most)) if least == most => format!("list of {least} {of}"),
                    _ => format!("list of {of}"),
                }
            }
            "object" if schema["properties"].is_object() => "object".to_owned(),
            "object" => match &schema["additionalProperties"] {
                Value::Object(_) => format!("object of {}", self.type_of(&schema["additionalProperties"])),
                _ => "object".to_owned(),
            },
            "string" if schema["format"] == "uuid" => "id".to_owned(),
            "number" => "number".to_owned(),
            "integer" => "whole number".to_owned(),
            other => other.to_owned(),
        }
    }
}

/// Alternatives that a few words say in full.
fn is_simple(schema: &Value) -> bool {
    let of = |key: &str| schema[key].as_array().into_iter().flatten().collect::<Vec<_>>();
    let alternatives: Vec<&Value> = of("oneOf").into_iter().chain(of("anyOf")).collect();
    !alternatives.is_empty()
        && alternatives
            .iter()
            .all(|one| description(one).is_none() || one.get("$ref").is_some() || one["type"] == "null")
}

fn or(types: &[String]) -> String {
    match types {
        [] => "nothing".to_owned(),
        [one] => one.clone(),
        [most @ .., last] => format!("{} or {last}", most.join(", ")),
    }
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first: String = letters.next().into_iter().flat_map(char::to_uppercase).collect();
    format!("{first}{}.", letters.as_str())
}

fn plural(name: &str) -> String {
    match name {
        "number" | "whole number" | "string" | "id" | "object" | "boolean" => format!("{name}s"),
        other => other.strip_prefix("list of ").map_or_else(|| other.to_owned(), |rest| format!("lists of {rest}")),
    }
}

/// The description in one line, without links that only rustdoc follows; of what may be null, that of the other
/// alternative.
fn description(schema: &Value) -> Option<String> {
    let alternatives = || ["oneOf", "anyOf"].iter().filter_map(|key| schema[*key].as_array()).flatten();
    let mut others = alternatives().filter(|one| one["type"] != "null");
    let inner = others.next().filter(|_| alternatives().count() == 2).and_then(|one| one["description"].as_str());
    let text = schema["description"].as_str().or(inner.filter(|_| others.next().is_none()))?;
    let paragraphs: Vec<String> =
        text.split("\n\n").map(|paragraph| paragraph.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    Some(without_links(&paragraphs.join(" ")))
}

/// `` [`name`](path) `` and `` [`name`] `` become `` `name` ``.
fn without_links(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(begin) = rest.find("[`") {
        let (before, after) = rest.split_at(begin);
        out.push_str(before);
        let Some(end) = after.find("`]") else {
            rest = after;
            break;
        };
        out.push_str(&after[1..=end]);
        rest = &after[end + 2..];
        if rest.starts_with('(') {
            rest = rest.find(')').map_or(rest, |close| &rest[close + 1..]);
        }
    }
    out.push_str(rest);
    out
}
