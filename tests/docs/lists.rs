//! Lists of the documentation that stand in the program as well: problems and settings.

use crate::{pages, root};
use std::collections::BTreeSet;
use std::process::Command;
use syn::visit::Visit;

fn page(name: &str) -> String {
    pages().into_iter().find(|page| page.name == name).unwrap_or_else(|| panic!("there is no {name}")).text
}

/// The first cell of every row of the tables in a section, without its backticks.
fn first_cells(text: &str, section: &str) -> BTreeSet<String> {
    let begin = text.find(&format!("\n## {section}\n")).unwrap_or_else(|| panic!("there is no section {section}"));
    let rest = &text[begin + 4..];
    let section = &rest[..rest.find("\n## ").unwrap_or(rest.len())];
    section
        .lines()
        .filter_map(|line| line.strip_prefix("| `")?.split_once('`').map(|(cell, _)| cell.to_owned()))
        .collect()
}

/// The names on the wire of `Code`, and of every other `ProblemCode`.
#[test]
fn every_problem_is_listed() {
    #[derive(Default)]
    struct Names(BTreeSet<String>);
    impl<'ast> Visit<'ast> for Names {
        /// Comments are attributes with a literal.
        fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
        fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
            if item.sig.ident == "name" {
                syn::visit::visit_impl_item_fn(self, item);
            }
        }
        fn visit_lit_str(&mut self, text: &'ast syn::LitStr) {
            self.0.insert(text.value());
        }
    }
    let mut names = Names::default();
    for (_, file) in crate::codes::sources() {
        for item in file.items {
            let syn::Item::Impl(item) = &item else { continue };
            let of = item.trait_.as_ref().map(|(_, path, _)| path.segments.last().unwrap().ident.to_string());
            let is_code = |ty: &syn::Type| matches!(ty, syn::Type::Path(path) if path.path.is_ident("Code"));
            if of.as_deref() == Some("ProblemCode") || (of.is_none() && is_code(&item.self_ty)) {
                names.visit_item_impl(item);
            }
        }
    }
    assert!(names.0.len() >= 15, "{:?}", names.0);
    assert_eq!(names.0, first_cells(&page("docs/api.md"), "Problems"));
}

fn help(words: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_volition")).arg("help").args(words).output().unwrap();
    String::from_utf8(output.stdout).unwrap()
}

/// The flags of `serve`, `worker` and `migrate`, with the variables that stand in for them.
#[test]
fn every_setting_is_listed() {
    let mut settings = BTreeSet::new();
    for command in ["serve", "worker", "migrate"] {
        let mut flag = String::new();
        for line in help(&[command]).lines() {
            let line = line.trim();
            if let Some(name) = line.strip_prefix("--") {
                flag = format!("--{}", name.split(' ').next().unwrap());
            } else if let Some(variable) = line.strip_prefix("[env: ").and_then(|rest| rest.split_once('=')) {
                settings.insert((flag.clone(), variable.0.to_owned()));
            }
        }
    }
    assert!(settings.len() >= 12, "{settings:?}");
    let text = page("docs/administration.md");
    let mut listed = BTreeSet::new();
    for line in text.lines().filter(|line| line.starts_with("| `--")) {
        let cells: Vec<&str> = line.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        if cells.get(2).is_some_and(|variable| variable.starts_with("VOLITION_")) {
            listed.insert((cells[1].to_owned(), cells[2].to_owned()));
        }
    }
    assert_eq!(settings, listed);
}

/// The commands of the program.
#[test]
fn every_command_is_listed() {
    let text = help(&[]);
    let commands = text.split("Commands:\n").nth(1).unwrap().split("\n\n").next().unwrap();
    let commands: BTreeSet<String> = commands
        .lines()
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect();
    assert_eq!(commands, first_cells(&page("docs/administration.md"), "Commands"));
}

/// The constants of `docs/numerics.md` have the values that it gives.
#[test]
fn every_tolerance_is_the_one_in_the_code() {
    let mut rows = 0;
    for line in page("docs/numerics.md").lines() {
        let cells: Vec<&str> = line.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        let [_, file, name, value, ..] = cells.as_slice() else { continue };
        if !file.ends_with(".rs") {
            continue;
        }
        rows += 1;
        let text = std::fs::read_to_string(root().join("src").join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        let found = syn::parse_file(&text).unwrap().items.into_iter().find_map(|item| match item {
            syn::Item::Const(item) if item.ident == name => {
                let begin = text.find(&format!("const {name}:"))?;
                let rest = text[begin..].split_once('=')?.1;
                Some(rest.split_once(';')?.0.trim().replace('_', ""))
            }
            _ => None,
        });
        assert_eq!(found.as_deref(), Some(*value), "{name} in src/{file}");
    }
    assert!(rows > 20, "{rows}");
}

/// Routes that pages name are in the OpenAPI document.
#[test]
fn every_route_exists() {
    let text = std::fs::read_to_string(root().join("openapi/openapi.json")).unwrap();
    let document: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut named = 0;
    for page in pages() {
        for (begin, _) in page.text.match_indices("/v1/") {
            let rest = &page.text[begin..];
            let is_path = |c: char| c.is_ascii_alphanumeric() || "/_-{}".contains(c);
            let path = rest[..rest.find(|c| !is_path(c)).unwrap_or(rest.len())].trim_end_matches('/');
            // What follows a variable of the shell is executed with it.
            if rest[path.len()..].starts_with('$') || path == "/v1" {
                continue;
            }
            assert!(document["paths"].get(path).is_some(), "{} names {path}, which is no route", page.name);
            named += 1;
        }
    }
    assert!(named > 10, "{named}");
}

/// Every room of `src` has its row in the walk through the rooms.
#[test]
fn every_room_is_in_the_walk() {
    let text = page("docs/architecture.md");
    let rows: Vec<&str> = text.lines().filter(|line| line.starts_with("| `")).collect();
    for entry in std::fs::read_dir(root().join("src")).unwrap() {
        let path = entry.unwrap().path();
        let room = path.file_stem().unwrap().to_string_lossy().into_owned();
        // What is compiled for tests only is no room that data pass through.
        if !["lib", "main", "published"].contains(&room.as_str()) {
            let name = format!("`{room}`");
            assert!(rows.iter().any(|row| row.split('|').nth(1).unwrap().contains(&name)), "{name} has no row");
        }
    }
}

/// The table of `docs/trust.md` is the rule itself, and its numbers are those that it judges by.
#[test]
fn the_rule_of_trust_is_listed() {
    let text = page("docs/trust.md");
    let rule = volition::trust::rule();
    let listed: Vec<&str> = text.lines().filter(|line| line.starts_with("| ") && line.contains(" | `")).collect();
    let rows: Vec<&str> = listed.iter().copied().filter(|line| line.as_bytes()[2].is_ascii_digit()).collect();
    let expected: Vec<String> = rule
        .rows
        .iter()
        .map(|row| {
            let advice = if row.advice.is_empty() { "–" } else { &row.advice };
            let field = if row.field.is_empty() { "–" } else { &row.field };
            format!(
                "| {} | `{}` | {field} | {} | {} | {} {} | {advice} |",
                row.number,
                row.code,
                row.condition,
                row.quantities,
                row.level.sign(),
                row.level.words()
            )
        })
        .collect();
    for (found, expected) in rows.iter().zip(&expected) {
        assert_eq!(found, expected);
    }
    assert_eq!(rows.len(), expected.len());
    let constants = serde_json::to_value(rule.constants).unwrap();
    for (name, value) in constants.as_object().unwrap() {
        let row = format!("| `{name}` | {:.4} |", value.as_f64().unwrap());
        assert!(text.contains(&row), "docs/trust.md lacks {row}");
    }
}
