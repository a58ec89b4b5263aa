//! The arrows between the rooms point one way, and the rooms below the store stay pure.

use crate::resolve::Target;
use crate::source::{Import, Module, Reach, Sources};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;

/// Who may use whom (DESIGN §2). A room may use itself. `ctl` drives any long computation and `trial` is the recording
/// itself.
const ARROWS: &[(&str, &[&str])] = &[
    ("ctl", &[]),
    ("num", &["ctl"]),
    ("cache", &["ctl"]),
    // The rule by which values are marked: below whoever judges, stores or draws.
    ("trust", &[]),
    ("control", &["ctl", "num"]),
    ("convex", &["ctl", "num"]),
    ("trial", &["num"]),
    ("person", &["control", "num"]),
    ("plants", &["control", "num", "person"]),
    ("simulate", &["control", "ctl", "num", "person", "plants", "trial"]),
    ("response", &["control", "ctl", "num", "trial"]),
    ("identify", &["cache", "control", "ctl", "num", "person", "response", "trial"]),
    ("two_stimulus", &["control", "ctl", "num", "person", "response", "trial"]),
    ("prediction_error", &["control", "ctl", "num", "trial"]),
    ("likelihood", &["control", "ctl", "num", "person", "response"]),
    ("inverse", &["control", "convex", "ctl", "num"]),
    ("excite", &["control", "convex", "ctl", "num", "person", "plants", "simulate"]),
    // Metrics are made from recordings and from the responses of systems.
    ("learning", &["control", "num", "trial", "trust"]),
    (
        "analysis",
        &[
            "cache",
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
            "prediction_error",
            "response",
            "simulate",
            "trial",
            "trust",
            "two_stimulus",
        ],
    ),
    // Files as labs have them: what was read is told in the problems and warnings of analyses. What is written are
    // tables of what was learnt, and models with their responses.
    ("exchange", &["analysis", "control", "learning", "num", "trial", "trust"]),
    // What is drawn of results; loops are simulated once more for the picture, and people for the tests.
    ("figure", &["analysis", "control", "identify", "learning", "num", "plants", "simulate", "trial", "trust"]),
    ("jobs", &["analysis", "ctl"]),
    ("store", &["analysis", "control", "ctl", "jobs", "num", "trial", "trust"]),
    ("worker", &["analysis", "cache", "control", "ctl", "identify", "jobs", "num", "store"]),
    (
        "api",
        &[
            "analysis", "cache", "control", "ctl", "exchange", "excite", "figure", "jobs", "learning", "num", "store",
            "trial", "trust",
        ],
    ),
    // What a browser shows of the same: beside the interface, and never asked by it. Its own files, its own words.
    // Files that are looked at before they are stored are read as the interface reads them; a short excitation is
    // judged while somebody waits.
    ("pages", &["analysis", "api", "ctl", "exchange", "figure", "jobs", "learning", "num", "store", "trust"]),
    ("app", &["*"]),
    ("cli", &["*"]),
    ("config", &["*"]),
    ("telemetry", &["*"]),
    // Compiled for tests only, which call it from where requests are understood.
    (FOR_TESTS, &["*"]),
];

/// The room that only tests may use, and any test may.
const FOR_TESTS: &str = "published";

/// The first of the rooms that are not pure: those before it know no async, clock, environment, file system, HTTP, nor
/// anything that outlives a call.
const FIRST_IMPURE: &str = "store";

/// What a pure room must not mention.
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
    "thread_local!",
    "OnceLock",
    "LazyLock",
    "println!",
    "eprintln!",
];

/// Words of HTTP and its libraries, which a pure room must not mention either.
const HTTP: &[&str] = &[
    "axum",
    "hyper",
    "reqwest",
    "tower_http",
    "utoipa",
    "HTTP",
    "http::",
    "StatusCode",
    "status_code",
    "PreconditionFailed",
    "UnsupportedMediaType",
    "NotAcceptable",
    "MethodNotAllowed",
    "PayloadTooLarge",
    "precondition_failed",
    "unsupported_media_type",
    "not_acceptable",
    "method_not_allowed",
    "payload_too_large",
    "Content-Type",
    "Content-Encoding",
    "If-Match",
    "If-None-Match",
    "ETag",
    "multipart",
    "query parameter",
    "request body",
    "/v1/",
];

/// What makes a static change.
const MUTABLE: &[&str] = &["mut", "Mutex", "RwLock", "Once", "Lazy", "Atomic", "Cell"];

fn sources() -> Sources {
    Sources::read(crate::project())
}

fn table() -> BTreeMap<&'static str, &'static [&'static str]> {
    ARROWS.iter().copied().collect()
}

fn pure(room: &str) -> bool {
    ARROWS.iter().take_while(|(name, _)| *name != FIRST_IMPURE).any(|(name, _)| *name == room)
}

fn without_comments(text: &str) -> String {
    text.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// The room that something is defined in; the crate's root is none.
fn room(sources: &Sources, target: Target) -> Option<&str> {
    sources.modules[target.module()].path.first().map(String::as_str)
}

/// The rooms that a path uses: where what it names is defined, and the one that it goes through.
fn rooms_of<'a>(sources: &'a Sources, module: &'a Module, path: &'a [String], targets: &[Target]) -> BTreeSet<&'a str> {
    let mut rooms: BTreeSet<&str> = targets.iter().filter_map(|target| room(sources, *target)).collect();
    let supers = path.iter().take_while(|word| *word == "super").count();
    if path[0] == "crate" || (supers > 0 && supers == module.path.len()) {
        rooms.extend(path.get(supers.max(1)).map(String::as_str));
    }
    rooms
}

#[test]
fn arrows_point_one_way() {
    let (sources, table) = (sources(), table());
    let mut broken = BTreeSet::new();
    let mut checked = 0;
    for (index, module) in sources.modules.iter().enumerate() {
        let file = &sources.files[module.file];
        let Some(home) = module.path.first() else { continue };
        let allowed = table.get(home.as_str()).unwrap_or_else(|| panic!("{home} is no room of the table"));
        let imports = module.imports.iter();
        let imports = imports.map(|import| (&import.path, import.line, sources.resolve(index, &import.path)));
        let mentions = module.mentions.iter();
        let mentions = mentions.map(|mention| (&mention.path, mention.line, sources.mentioned(index, mention)));
        for (path, line, targets) in imports.chain(mentions) {
            for used in rooms_of(&sources, module, path, &targets) {
                checked += 1;
                // Outside of tests it is not there to be used.
                if used == FOR_TESTS {
                    continue;
                }
                let known = table.contains_key(used);
                if !(known && (used == home || allowed.contains(&"*") || allowed.contains(&used))) {
                    broken.insert(format!("{home} uses {used}: {}:{line} {}", file.path.display(), path.join("::")));
                }
            }
        }
    }
    assert!(checked > 5000, "the scan found only {checked} uses: it is broken itself");
    assert!(broken.is_empty(), "arrows that the design does not have:\n{}", Vec::from_iter(broken).join("\n"));
}

#[test]
fn the_table_has_no_circle_and_every_room() {
    let sources = sources();
    let rooms: BTreeSet<&str> = sources.files.iter().filter_map(|file| file.room()).collect();
    for (at, (room, uses)) in ARROWS.iter().enumerate() {
        assert!(rooms.contains(room), "there is no room {room}");
        for used in uses.iter().filter(|used| **used != "*") {
            let place = ARROWS.iter().position(|(name, _)| name == used);
            assert!(place.is_some_and(|place| place < at), "{room} uses {used}, which does not stand before it");
        }
    }
}

#[test]
fn no_room_hands_on_what_another_defines() {
    let sources = sources();
    let mut broken = BTreeSet::new();
    for (index, module) in sources.modules.iter().enumerate() {
        let home = module.path.first().map_or("the crate's root", String::as_str);
        let leaves = |import: &&Import| match import.reach {
            Reach::Private => false,
            Reach::Some => module.path.len() == 1,
            Reach::Crate => true,
        };
        for import in module.imports.iter().chain(&module.aliases).filter(leaves) {
            let strange = |target: &Target| room(&sources, *target).is_some_and(|room| room != home);
            if sources.resolve(index, &import.path).iter().any(strange) {
                let file = sources.files[module.file].path.display();
                broken.insert(format!("{file}:{} hands on {}", import.line, import.path.join("::")));
            }
        }
    }
    assert!(broken.is_empty(), "{}", Vec::from_iter(broken).join("\n"));
}

#[test]
fn pure_rooms_stay_pure_and_only_the_store_speaks_sql() {
    let mut broken = Vec::new();
    for file in &sources().files {
        let Some(room) = file.room() else { continue };
        let code = without_comments(&file.text);
        if pure(room) {
            for word in IMPURE.iter().chain(HTTP).filter(|word| code.contains(**word)) {
                broken.push(format!("{} mentions {word}", file.path.display()));
            }
            for (declared, line) in &file.statics {
                if MUTABLE.iter().any(|word| declared.contains(word)) {
                    broken.push(format!("{}:{line} is a static that changes: {declared}", file.path.display()));
                }
            }
        }
        if room != "store" && code.contains("sqlx") {
            broken.push(format!("{} mentions sqlx", file.path.display()));
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn unsafe_code_lives_in_one_file() {
    let mut found = 0;
    for file in &sources().files {
        if file.module.starts_with(&["convex".to_owned(), "blas".to_owned()]) {
            found += usize::from(!file.unsafe_lines.is_empty());
        } else {
            assert!(file.unsafe_lines.is_empty(), "{} has unsafe code: {:?}", file.path.display(), file.unsafe_lines);
        }
    }
    assert_eq!(found, 2, "the exempt file and its tests moved");
    let manifest = fs::read_to_string(crate::project().join("Cargo.toml")).unwrap();
    assert!(manifest.contains("unsafe_code = \"deny\""));
}
