//! What the documentation says is what the program does.
//!
//! Every fenced block of README.md, CONTRIBUTING.md and `docs/` says by its info string what it is ([`blocks::What`]);
//! those that are commands or requests are executed here, in a temporary folder and against the built program. Lists
//! that stand in the code as well (warnings, problems, settings, tolerances, kinds) are compared with it.
#![allow(clippy::unwrap_used, missing_docs, unreachable_pub)]

mod blocks;
mod codes;
mod execute;
mod kinds;
mod links;
mod lists;
mod schema;

use std::path::{Path, PathBuf};

/// The repository.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A page: its path in the repository and its text.
pub struct Page {
    pub name: String,
    pub text: String,
}

/// Every page, in the order of their names.
fn pages() -> Vec<Page> {
    let mut files: Vec<PathBuf> =
        ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"].map(|name| root().join(name)).to_vec();
    markdown(&root().join("docs"), &mut files);
    files.sort();
    files
        .into_iter()
        .map(|path| Page {
            name: path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned(),
            text: std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())),
        })
        .collect()
}

fn markdown(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            markdown(&path, into);
        } else if path.extension().is_some_and(|ending| ending == "md") {
            into.push(path);
        }
    }
}

/// Writes past the capture of the test harness: what ran and what did not is for whoever runs the tests, failed or not.
fn tell(text: &str) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "{text}");
}

#[test]
fn the_readme_is_short() {
    let lines = pages().iter().find(|page| page.name == "README.md").unwrap().text.lines().count();
    assert!(lines <= 150, "README.md has {lines} lines, and 150 at most");
}
