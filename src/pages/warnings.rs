//! Warnings with what to do about each, as `docs/warnings.md` has it.

use crate::analysis::Warning;
use maud::{Markup, html};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// By code: what it means, and what to do.
static ENTRIES: LazyLock<BTreeMap<&'static str, Entry>> =
    LazyLock::new(|| read(include_str!("../../docs/warnings.md")));

/// An entry of the page of warnings.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
struct Entry {
    todo: Option<String>,
}

fn read(page: &'static str) -> BTreeMap<&'static str, Entry> {
    let mut entries: BTreeMap<&'static str, Entry> = BTreeMap::new();
    for part in page.split("\n### `").skip(1) {
        let Some((code, text)) = part.split_once('`') else { continue };
        let text = text.split("\n## ").next().unwrap_or_default();
        let todo = text.split("\n\n").map(str::trim).find_map(|paragraph| {
            // Entries that need more than reading begin with what not to do.
            paragraph.strip_prefix("Do: ").or(Some(paragraph).filter(|paragraph| paragraph.starts_with("Do not")))
        });
        entries.insert(code, Entry { todo: todo.map(|todo| todo.replace('\n', " ").replace('`', "")) });
    }
    entries
}

/// What to do about a code; `None` where the page has nothing.
fn todo(code: &str) -> Option<&'static str> {
    ENTRIES.get(code)?.todo.as_deref()
}

/// Warnings, each with its finding and what to do; the same code is said once.
pub(super) fn list(warnings: &[Warning]) -> Markup {
    let mut seen: Vec<(&str, Vec<&str>)> = Vec::new();
    for warning in warnings {
        match seen.iter_mut().find(|(code, _)| *code == warning.code) {
            Some((_, messages)) => messages.push(&warning.message),
            None => seen.push((&warning.code, vec![&warning.message])),
        }
    }
    html! {
        @for (at, (code, messages)) in seen.iter().enumerate() {
            details.warning open[at == 0] {
                summary { code { (code) } @if messages.len() > 1 { " × " (messages.len()) } }
                @for message in messages { p { (message) } }
                @if let Some(todo) = todo(code) { p { b { "What to do: " } (todo) } }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_of_warnings_is_understood() {
        assert!(ENTRIES.len() > 60, "{}", ENTRIES.len());
        let without: Vec<&str> =
            ENTRIES.iter().filter(|(_, entry)| entry.todo.is_none()).map(|(code, _)| *code).collect();
        assert!(without.is_empty(), "{without:?}");
        assert!(todo("few_averages").is_some_and(|todo| todo.starts_with("record more repetitions")));
        assert_eq!(todo("no_such_code"), None);
    }

    #[test]
    fn a_code_is_said_once_and_its_message_stays_text() {
        let two = ["<script>", "b"].map(|message| Warning::new("few_averages", message));
        let text = list(&two).into_string();
        assert_eq!(text.matches("few_averages").count(), 1);
        assert!(text.contains("&lt;script&gt;") && text.contains("× 2") && !text.contains("<script>"), "{text}");
    }
}
