//! Every page in a real browser: no error, nothing from elsewhere, nothing that a person without sight, colours or
//! mouse
//! would miss; dragging, keys, following, cancelling.
//!
//! Chromium is driven by `tests/browser/pages.mjs`. Without it, or before `tests/browser/install`, this test is left
//! out and says so on standard error, past what the test harness captures.

use crate::process::harness::Server;
use std::io::Write as _;
use std::path::Path;
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Whether browser and tools are there; where they are not, this is said aloud.
fn is_ready() -> bool {
    let is_there = |program: &str| Command::new(program).arg("--version").output().is_ok_and(|o| o.status.success());
    let has_tools = root().join("target/browser/node_modules/axe-core/axe.min.js").exists();
    if has_tools && is_there("chromium") && is_there("node") {
        return true;
    }
    assert!(std::env::var_os("VOLITION_BROWSER").is_none(), "VOLITION_BROWSER is set, and chromium or axe is missing");
    let said = "\nLEFT OUT: the pages in a browser; it needs chromium and node, then tests/browser/install\n";
    std::io::stderr().write_all(said.as_bytes()).unwrap();
    false
}

#[test]
fn every_page_stands_in_a_real_browser() {
    if !is_ready() {
        return;
    }
    let databases = tempfile::tempdir().unwrap();
    let (empty, filled) = (databases.path().join("empty.db"), databases.path().join("filled.db"));
    let demo = Command::new(env!("CARGO_BIN_EXE_volition"))
        .args(["demo", "--subjects", "2", "--database"])
        .arg(&filled)
        .output()
        .unwrap();
    assert!(demo.status.success(), "{}", String::from_utf8_lossy(&demo.stderr));
    let servers = [Server::start(&empty, &[]), Server::start(&filled, &[])];
    let pictures = root().join("target/browser/pictures");
    let output = Command::new("node")
        .arg(root().join("tests/browser/pages.mjs"))
        .args([&servers[0].url, &servers[1].url])
        .arg(root().join("target/browser"))
        .arg(&pictures)
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (said, wrong) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success() && said.contains("without a fault"), "{said}\n{wrong}");
    print!("{said}");
}
