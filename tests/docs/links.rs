//! Links from page to page, and to files of the repository, lead somewhere.

use crate::{Page, pages, root};
use pulldown_cmark::{Event, Parser, Tag, TagEnd};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

/// The name that a heading has in links, as GitHub makes it.
fn anchor(heading: &str) -> String {
    heading
        .to_lowercase()
        .chars()
        .filter_map(|c| match c {
            ' ' => Some('-'),
            c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
            _ => None,
        })
        .collect()
}

fn anchors(page: &Page) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut heading: Option<String> = None;
    for event in Parser::new(&page.text) {
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::End(TagEnd::Heading(_)) => found.extend(heading.take().map(|text| anchor(&text))),
            Event::Text(text) | Event::Code(text) => {
                if let Some(heading) = &mut heading {
                    heading.push_str(&text);
                }
            }
            _ => {}
        }
    }
    found
}

/// A path without `..`.
fn plain(path: &Path) -> PathBuf {
    let mut parts = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => {
                parts.pop();
            }
            Component::CurDir => {}
            other => parts.push(other),
        }
    }
    parts
}

#[test]
fn every_link_leads_somewhere() {
    let pages = pages();
    let known: BTreeMap<&str, BTreeSet<String>> = pages.iter().map(|p| (p.name.as_str(), anchors(p))).collect();
    let mut broken = Vec::new();
    for page in &pages {
        for event in Parser::new(&page.text) {
            let Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) = event else { continue };
            if dest_url.contains("://") {
                continue;
            }
            let (file, place) = dest_url.split_once('#').unwrap_or((&dest_url, ""));
            let folder = Path::new(&page.name).parent().unwrap();
            let target = if file.is_empty() { PathBuf::from(&page.name) } else { plain(&folder.join(file)) };
            let is_there = root().join(&target).exists();
            let has_place =
                place.is_empty() || known.get(target.to_str().unwrap()).is_some_and(|anchors| anchors.contains(place));
            if !is_there || !has_place {
                broken.push(format!("{}: {dest_url}", page.name));
            }
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
}

/// A page that no other page leads to is not read.
#[test]
fn every_page_is_linked() {
    let pages = pages();
    let mut linked = BTreeSet::from(["README.md".to_owned()]);
    for page in &pages {
        for event in Parser::new(&page.text) {
            if let Event::Start(Tag::Link { dest_url, .. }) = event {
                let file = dest_url.split('#').next().unwrap();
                linked.insert(plain(&Path::new(&page.name).parent().unwrap().join(file)).display().to_string());
            }
        }
    }
    let lost: Vec<_> = pages.iter().filter(|page| !linked.contains(&page.name)).map(|page| &page.name).collect();
    assert!(lost.is_empty(), "no page links {lost:?}");
}
