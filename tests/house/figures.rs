//! The figures of the house, printed and held to their bounds.

use crate::graph::Graph;
use crate::source::{Sources, rust_files};
use std::fs;
use std::path::Path;

/// Files of the largest import circle.
const MOST_IN_A_CIRCLE: usize = 4;

/// Imports of `identify/search` that run upward ([`Graph::upward`]).
const MOST_UPWARD: usize = 5;

/// Lines of a file.
const MOST_LINES: usize = 500;

/// Columns of a line, in characters.
const MOST_COLUMNS: usize = 120;

/// Where Rust code is.
const FOLDERS: &[&str] = &["src", "tests", "benches", "fuzz"];

/// Prints the figures of a project, and gives what exceeds its bound.
pub fn report(project: &Path) -> Vec<String> {
    let mut broken = Vec::new();
    let graph = Graph::of(&Sources::read(project));
    println!("{} files of the library, {} arrows between them", graph.names.len(), graph.arrows.len());

    let circles = graph.circles();
    println!("\nImport circles of more than one file: {}", circles.len());
    for circle in &circles {
        println!("  {} files: {}", circle.len(), circle.join(" "));
        if circle.len() > MOST_IN_A_CIRCLE {
            broken.push(format!("a circle of {} files: {}", circle.len(), circle.join(" ")));
        }
    }

    let room = ["identify", "search"];
    let (upward, (begin, within)) = (graph.upward(&room), graph.within(&room));
    println!("\nArrows from identify/search: {begin}, {within} of them within it; upward: {}", upward.len());
    for (from, to) in &upward {
        println!("  {from} → {to}");
    }
    if upward.len() > MOST_UPWARD {
        broken.push(format!("{} imports of identify/search run upward", upward.len()));
    }

    let mut files: Vec<_> =
        FOLDERS.iter().map(|folder| project.join(folder)).filter(|folder| folder.is_dir()).collect();
    files = files.iter().flat_map(|folder| rust_files(folder)).collect();
    files.push(project.join("build.rs"));
    let mut lengths = Vec::new();
    let mut wide = Vec::new();
    for path in files {
        let name = path.strip_prefix(project).unwrap_or(&path).display().to_string();
        let text = fs::read_to_string(&path).unwrap();
        let columns = text.lines().map(|line| line.chars().count());
        let lines: Vec<usize> = columns.zip(1..).filter(|(count, _)| *count > MOST_COLUMNS).map(|(_, at)| at).collect();
        if !lines.is_empty() {
            wide.push((name.clone(), lines));
        }
        lengths.push((text.lines().count(), name));
    }
    lengths.sort_by(|a, b| b.cmp(a));
    println!("\nLongest of {} files:", lengths.len());
    for (at, (lines, name)) in lengths.iter().enumerate() {
        if at < 15 || *lines > MOST_LINES {
            println!("  {lines} {name}");
        }
        if *lines > MOST_LINES {
            broken.push(format!("{name} has {lines} lines"));
        }
    }
    let total: usize = wide.iter().map(|(_, lines)| lines.len()).sum();
    println!("\nLines of more than {MOST_COLUMNS} columns: {total} in {} files", wide.len());
    for (name, lines) in wide {
        let lines = lines.iter().map(usize::to_string).collect::<Vec<_>>().join(" ");
        println!("  {name}: {lines}");
        broken.push(format!("{name} has lines of more than {MOST_COLUMNS} columns: {lines}"));
    }
    broken
}

#[test]
fn figures() {
    let broken = report(crate::project());
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}
