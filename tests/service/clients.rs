//! Clients that others' tools generate from the committed document: they compile, and do the whole round.
//!
//! The tools come from `tests/clients/install`; without them these tests are left out and say so on standard error,
//! past what the test harness captures.

use crate::process::harness::Server;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Where the tools are; `None`, said aloud, where they were not installed.
fn tools(of: &str, needed: &str) -> Option<PathBuf> {
    let folder = root().join("target/clients");
    if folder.join(needed).exists() {
        return Some(folder);
    }
    assert!(std::env::var_os("VOLITION_CLIENTS").is_none(), "VOLITION_CLIENTS is set and {needed} is not installed");
    let said = format!("\nLEFT OUT: the generated {of} client, whose tools are not there; run tests/clients/install\n");
    std::io::stderr().write_all(said.as_bytes()).unwrap();
    None
}

#[track_caller]
fn run(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{command:?} failed:\n{out}\n{err}");
    out + &err
}

#[test]
fn a_generated_python_client_does_the_whole_round() {
    let Some(tools) = tools("Python", "venv/bin/openapi-python-client") else { return };
    let package = tools.join("python/volition_client");
    let bin = tools.join("venv/bin");
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap_or_default());
    let generated = run(Command::new(bin.join("openapi-python-client"))
        .env("PATH", &path)
        .args(["generate", "--overwrite", "--meta", "none", "--path"])
        .arg(root().join("openapi/openapi.json"))
        .arg("--output-path")
        .arg(&package));
    // It takes no bodies of text, which it says; whatever else it leaves out is a defect of the document.
    assert!(!generated.contains("Unable to"), "{generated}");
    let script = root().join("tests/clients/python/round_trip.py");
    run(Command::new(bin.join("mypy"))
        .env("MYPYPATH", tools.join("python"))
        .args(["--strict", "--follow-imports", "silent", "--cache-dir"])
        .arg(tools.join("mypy"))
        .arg(&script));
    let databases = tempfile::tempdir().unwrap();
    let server = Server::start(&databases.path().join("clients.db"), &[]);
    let said =
        run(Command::new(bin.join("python")).env("PYTHONPATH", tools.join("python")).arg(script).arg(&server.url));
    assert!(said.contains("python: a study, a trial and two reports, typed"), "{said}");
}

#[test]
fn a_generated_typescript_client_does_the_whole_round() {
    let Some(tools) = tools("TypeScript", "typescript/node_modules/.bin/openapi-typescript") else { return };
    let folder = tools.join("typescript");
    let bin = folder.join("node_modules/.bin");
    run(Command::new(bin.join("openapi-typescript"))
        .arg(root().join("openapi/openapi.json"))
        .arg("-o")
        .arg(folder.join("api.ts")));
    for file in ["round_trip.ts", "tsconfig.json"] {
        std::fs::copy(root().join("tests/clients/typescript").join(file), folder.join(file)).unwrap();
    }
    run(Command::new(bin.join("tsc")).current_dir(&folder));
    let databases = tempfile::tempdir().unwrap();
    let server = Server::start(&databases.path().join("clients.db"), &[]);
    let said = run(Command::new("node").arg(folder.join("built/round_trip.js")).arg(&server.url));
    assert!(said.contains("typescript: a study, a trial and two reports, typed"), "{said}");
}
