//! One build for `cargo build` and `cargo test`.

use std::collections::BTreeSet;
use std::process::Command;

/// Packages with their features, over these kinds of dependencies; those of the compiler itself (build scripts,
/// procedural macros) are built apart.
fn packages(edges: &str) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "--prefix", "none", "--edges", edges, "--format", "{p} [{f}]"])
        .current_dir(super::project())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
}

/// A dependency of the tests that switches on a feature has everything above it built a second time, this crate too.
#[test]
fn dependencies_of_the_tests_switch_on_no_features() {
    let (own, with_tests) = (packages("normal,no-proc-macro"), packages("normal,dev,no-proc-macro"));
    let twice: Vec<&String> = own.difference(&with_tests).collect();
    assert!(own.len() > 100, "{own:?}");
    assert!(twice.is_empty(), "name the features of the tests' dependencies in Cargo.toml: {twice:?}");
}
