//! The arrows between the modules point one way, and the layers below the store stay pure.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Who may use whom (DESIGN §2; `trial`, the recording itself, is ours). A module may always use itself.
const ARROWS: &[(&str, &[&str])] = &[
    ("ctl", &[]),
    ("num", &["ctl"]),
    ("cache", &["ctl"]),
    ("control", &["num"]),
    ("convex", &["ctl", "num"]),
    ("trial", &["num"]),
    ("person", &["control", "num"]),
    ("plants", &["control", "num", "person"]),
    ("simulate", &["control", "num", "person", "plants", "trial"]),
    ("response", &["control", "ctl", "num", "trial"]),
    ("identify", &["cache", "control", "ctl", "num", "person", "response", "trial"]),
    ("two_stimulus", &["control", "ctl", "num", "person", "response", "trial"]),
    ("likelihood", &["control", "ctl", "num", "person", "response"]),
    ("inverse", &["control", "convex", "ctl", "num"]),
    ("excite", &["control", "convex", "ctl", "num", "person", "plants", "simulate"]),
    ("learning", &["control", "num", "trial"]),
    (
        "analysis",
        &[
            "control",
            "convex",
            "ctl",
            "excite",
            "identify",
            "inverse",
            "learning",
            "likelihood",
            "num",
            "person",
            "plants",
            "response",
            "simulate",
            "trial",
            "two_stimulus",
        ],
    ),
    ("jobs", &["analysis", "ctl"]),
    ("store", &["analysis", "control", "ctl", "jobs", "num", "trial"]),
    ("worker", &["analysis", "cache", "control", "ctl", "identify", "jobs", "num", "store"]),
    ("api", &["analysis", "cache", "control", "ctl", "excite", "jobs", "learning", "num", "store", "trial"]),
    ("app", &["*"]),
    ("cli", &["*"]),
    ("config", &["*"]),
    ("telemetry", &["*"]),
];

/// The layers without async, clock, environment, filesystem or global state.
const PURE: &[&str] = &[
    "ctl",
    "num",
    "cache",
    "control",
    "convex",
    "trial",
    "person",
    "plants",
    "simulate",
    "response",
    "identify",
    "two_stimulus",
    "likelihood",
    "inverse",
    "excite",
    "learning",
    "analysis",
    "jobs",
];

/// What a pure layer must not mention.
const IMPURE: &[&str] = &[
    "async fn",
    "async move",
    ".await",
    "tokio::",
    "Instant::",
    "SystemTime",
    "now_utc",
    "now_v7",
    "std::env::",
    "std::fs",
    "File::open",
    "static mut",
    "thread_local!",
    "OnceLock",
    "LazyLock",
    "println!",
    "eprintln!",
];

struct Source {
    path: PathBuf,
    module: String,
    /// Code with comments removed and test modules kept.
    code: String,
}

fn rust_files(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

fn without_comments(text: &str) -> String {
    text.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&root, &mut files);
    files
        .into_iter()
        .filter_map(|path| {
            let relative = path.strip_prefix(&root).unwrap();
            let module = relative.components().next().unwrap().as_os_str().to_str().unwrap().trim_end_matches(".rs");
            if matches!(module, "lib" | "main") {
                return None;
            }
            let module = module.to_owned();
            let code = without_comments(&fs::read_to_string(&path).unwrap());
            Some(Source { path, module, code })
        })
        .collect()
}

/// Every module named after `crate::` in a piece of code, in plain paths and in `use crate::{…}` groups.
fn modules_used(code: &str) -> Vec<String> {
    let mut used = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let before = code[..at].chars().next_back();
        if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':') {
            continue;
        }
        let rest = &code[at + "crate::".len()..];
        let names: Vec<&str> = if let Some(group) = rest.strip_prefix('{') {
            let mut depth = 0;
            let mut names = Vec::new();
            let mut start = 0;
            for (i, c) in group.char_indices() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => {
                        names.push(&group[start..i]);
                        break;
                    }
                    '}' => depth -= 1,
                    ',' if depth == 0 => {
                        names.push(&group[start..i]);
                        start = i + 1;
                    }
                    _ => {}
                }
            }
            names
        } else {
            vec![rest]
        };
        for name in names {
            let word: String = name.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            if !word.is_empty() {
                used.push(word);
            }
        }
    }
    used
}

#[test]
fn arrows_point_one_way() {
    let table: BTreeMap<&str, &[&str]> = ARROWS.iter().copied().collect();
    let mut broken = Vec::new();
    let mut checked = 0;
    for source in sources() {
        let allowed = table
            .get(source.module.as_str())
            .unwrap_or_else(|| panic!("{} belongs to no module of the table", source.path.display()));
        for used in modules_used(&source.code) {
            checked += 1;
            let known = table.contains_key(used.as_str());
            let fine = used == source.module || allowed.contains(&"*") || allowed.contains(&used.as_str());
            if !(known && fine) {
                broken.push(format!("{} uses {used}", source.path.display()));
            }
        }
    }
    assert!(checked > 50, "the scan found only {checked} uses: it is broken itself");
    assert!(broken.is_empty(), "arrows that the design does not have:\n{}", broken.join("\n"));
}

#[test]
fn pure_layers_stay_pure_and_only_the_store_speaks_sql() {
    let mut broken = Vec::new();
    for source in sources() {
        if PURE.contains(&source.module.as_str()) {
            for word in IMPURE.iter().filter(|word| source.code.contains(**word)) {
                broken.push(format!("{} mentions {word}", source.path.display()));
            }
        }
        if source.module != "store" && source.code.contains("sqlx") {
            broken.push(format!("{} mentions sqlx", source.path.display()));
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn unsafe_code_lives_in_one_file() {
    let exempt = Path::new("convex").join("blas.rs");
    let tests = Path::new("convex").join("blas").join("tests.rs");
    let mut found = 0;
    for source in sources() {
        let mentions = source.code.contains("unsafe {")
            || source.code.contains("unsafe fn")
            || source.code.contains("unsafe impl")
            || source.code.contains("unsafe extern")
            || source.code.contains("allow(unsafe_code)");
        if source.path.ends_with(&exempt) || source.path.ends_with(&tests) {
            found += 1;
        } else {
            assert!(!mentions, "{} has unsafe code", source.path.display());
        }
    }
    assert_eq!(found, 2, "the exempt file moved");
    let manifest = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")).unwrap();
    assert!(manifest.contains("unsafe_code = \"deny\""));
}

#[test]
fn files_stay_small() {
    let long: Vec<String> = sources()
        .iter()
        .map(|source| (source.path.display().to_string(), fs::read_to_string(&source.path).unwrap().lines().count()))
        .filter(|(_, lines)| *lines > 700)
        .map(|(path, lines)| format!("{path}: {lines} lines"))
        .collect();
    assert!(long.is_empty(), "files over 700 lines:\n{}", long.join("\n"));
}

#[test]
fn the_scan_sees_groups_and_plain_paths() {
    let code = "use crate::{control::{self, Model}, num};\nlet x = crate::store::Store::new();\nuse othercrate::api;";
    assert_eq!(modules_used(code), ["control", "num", "store"]);
}
