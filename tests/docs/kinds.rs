//! The pages of the kinds, from their schemas and examples.
//!
//! `VOLITION_BLESS=1 cargo test --test docs kinds` writes them anew; without it they are compared.

use crate::root;
use crate::schema::Writer;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use volition::analysis::registry::{About, kinds};

/// Writes the pages instead of comparing them.
const BLESS: &str = "VOLITION_BLESS";

const WRITTEN_BY: &str = "<!-- Written by tests/docs/kinds.rs from the kind's schemas and example: change those. -->";

/// Every page of the folder, by its file name.
fn pages() -> BTreeMap<String, String> {
    let mut index = format!(
        "{WRITTEN_BY}\n# The kinds of analysis\n\nWhat each asks and answers, from its schema. `GET /v1/kinds` of a \
         running server lists the same.\nWhich one to take: [which analysis?](../analyses.md) What they do: \
         [methods](../methods.md).\n\n| kind | |\n|---|---|\n"
    );
    let mut pages = BTreeMap::new();
    for about in kinds() {
        let name = about.kind.name();
        writeln!(index, "| [`{name}`]({name}.md) | {} |", about.title).unwrap();
        pages.insert(format!("{name}.md"), page(about));
    }
    pages.insert("README.md".to_owned(), index);
    pages
}

fn page(about: &About) -> String {
    let mut generator = SchemaSettings::draft2020_12().into_generator();
    let parts = [("Inputs", about.inputs), ("Spec", about.spec), ("Result", about.result)];
    let schemas: Vec<(&str, Value)> =
        parts.iter().map(|(title, part)| (*title, part(&mut generator).to_value())).collect();
    let definitions: Map<String, Value> = generator.take_definitions(true);
    let mut writer = Writer::new(&definitions);
    let name = about.kind.name();
    let mut out = format!(
        "{WRITTEN_BY}\n# {}\n\nKind `{name}`, result `{}`.\n\n{}\n\n## Example\n\n```json\n{}\n```\n\n",
        about.title,
        about.result_schema(),
        about.summary,
        example(about)
    );
    for (title, schema) in &schemas {
        write!(out, "## {title}\n\n{}\n", writer.part(schema)).unwrap();
    }
    write!(out, "## Types\n\n{}", writer.types()).unwrap();
    format!("{}\n", out.trim_end())
}

/// The example, the kind first, in lines that a page has room for.
fn example(about: &About) -> String {
    let request: Value = serde_json::from_str(about.example).unwrap();
    let members = ["kind", "inputs", "spec"].iter().filter_map(|name| Some((*name, request.get(*name)?)));
    let members: Vec<String> = members.map(|(name, value)| format!("\"{name}\": {}", laid_out(value, 1))).collect();
    format!("{{{}}}", members.join(",\n "))
}

/// JSON of at most some hundred columns, indented by so many.
fn laid_out(value: &Value, indent: usize) -> String {
    const WIDTH: usize = 110;
    let parts: Vec<String> = match value {
        Value::Object(members) => members
            .iter()
            .map(|(name, value)| format!("{}: {}", Value::from(name.as_str()), laid_out(value, indent + 2)))
            .collect(),
        Value::Array(items) => items.iter().map(|item| laid_out(item, indent + 2)).collect(),
        plain => return plain.to_string(),
    };
    let [open, close] = if value.is_object() { ['{', '}'] } else { ['[', ']'] };
    let line = parts.join(", ");
    if indent + line.len() <= WIDTH && !line.contains('\n') {
        return format!("{open}{line}{close}");
    }
    let margin = format!("\n{}", " ".repeat(indent + 1));
    let mut out = String::from(open);
    let mut column = indent;
    for (position, part) in parts.iter().enumerate() {
        let comma = if position + 1 < parts.len() { "," } else { "" };
        // Members of objects each have a line of their own; items of lists share lines.
        if position > 0 && (value.is_object() || part.contains('\n') || column + part.len() > WIDTH) {
            out.push_str(&margin);
            column = indent;
        } else if position > 0 {
            out.push(' ');
        }
        out.push_str(part);
        out.push_str(comma);
        column += part.len() + 2;
    }
    out.push(close);
    out
}

#[test]
fn the_pages_of_the_kinds_are_those_of_the_code() {
    let folder = root().join("docs/kinds");
    let expected = pages();
    if std::env::var_os(BLESS).is_some() {
        std::fs::create_dir_all(&folder).unwrap();
        for old in std::fs::read_dir(&folder).unwrap() {
            std::fs::remove_file(old.unwrap().path()).unwrap();
        }
        for (name, text) in &expected {
            std::fs::write(folder.join(name), text).unwrap();
        }
    }
    let mut there = BTreeMap::new();
    for file in std::fs::read_dir(&folder).unwrap() {
        let path = file.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        there.insert(name, std::fs::read_to_string(&path).unwrap());
    }
    assert_eq!(there.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>(), "set {BLESS}=1 to write them");
    for (name, text) in expected {
        let first = there[&name].lines().zip(text.lines()).find(|(a, b)| a != b);
        assert!(there[&name] == text, "docs/kinds/{name} is not that of the code; set {BLESS}=1. First: {first:?}");
    }
}

/// Whoever looks for what to ask, how it works and what proves it finds every kind.
#[test]
fn every_kind_is_in_the_pages_that_list_them() {
    for page in crate::pages() {
        let lists = ["README.md", "CHANGELOG.md", "docs/analyses.md", "docs/methods.md"];
        if lists.contains(&page.name.as_str()) {
            for about in kinds() {
                let name = format!("`{}`", about.kind.name());
                assert!(page.text.contains(&name), "{} does not name {name}", page.name);
            }
        }
    }
}
