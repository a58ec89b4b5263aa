//! The reader and the resolver on a small library of their own, whose arrows are known.

use crate::graph::Graph;
use crate::source::Sources;
use std::fs;
use std::path::Path;

const FILES: &[(&str, &str)] = &[
    ("lib.rs", "pub mod low;\npub mod high;\nmod kinds;\nmod macros;"),
    ("low/mod.rs", "mod inner;\npub mod leaf;\npub use inner::{Inner as Renamed, *};\npub struct Facade;"),
    ("low/inner.rs", "use super::Facade;\npub struct Inner(Facade);\npub fn work() {}"),
    ("low/leaf.rs", "pub fn leaf() {}\n#[cfg(test)]\nmod tests {\n    use super::super::Facade;\n}"),
    (
        "high.rs",
        "use crate::low::{self, Renamed};\nuse std::fmt::{self, Debug};\nfn f(x: &dyn Debug) -> fmt::Result {\n    \
         low::work();\n    println!(\"{:?}\", low::leaf::leaf());\n    told!();\n    Ok(())\n}\n\
         macro_rules! all {\n    ($($name:ident),*) => { $(crate::$name::made();)* };\n}\n\
         fn g() {\n    all!(kinds, none);\n}",
    ),
    ("kinds.rs", "pub fn made() {}"),
    ("macros.rs", "#[macro_export]\nmacro_rules! told {\n    () => {};\n}"),
];

#[test]
fn the_reader_finds_every_arrow_of_a_small_library() {
    let project = tempfile::tempdir().unwrap();
    for (name, text) in FILES {
        let path = project.path().join("src").join(name);
        fs::create_dir_all(path.parent().unwrap_or(Path::new("."))).unwrap();
        fs::write(path, text).unwrap();
    }
    let graph = Graph::of(&Sources::read(project.path()));
    let arrows: Vec<_> = graph.arrows.iter().map(|(a, b)| format!("{} {}", graph.names[*a], graph.names[*b])).collect();
    let mut expected = [
        "low/mod.rs low/inner.rs",
        "low/inner.rs low/mod.rs",
        "high.rs low/inner.rs",
        "high.rs low/leaf.rs",
        "high.rs kinds.rs",
        "high.rs macros.rs",
    ];
    expected.sort_unstable();
    let mut arrows = arrows;
    arrows.sort_unstable();
    assert_eq!(arrows, expected);
    assert_eq!(graph.circles().len(), 1);
    assert_eq!(graph.upward(&["low"]), [("low/inner.rs", "low/mod.rs")]);
    fs::write(project.path().join("src/stray.rs"), "").unwrap();
    let refused = std::panic::catch_unwind(|| Sources::read(project.path())).unwrap_err();
    assert!(refused.downcast_ref::<String>().unwrap().contains("is in no module"));
}
