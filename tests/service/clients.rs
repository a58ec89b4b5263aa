//! Clients of this repository, and those that others' tools generate from the committed document: they do the whole
//! round with a real server.
//!
//! The tools come from `tests/clients/install`; without them, without Python or without Octave, these tests are left
//! out and say so on standard error, past what the test harness captures.

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
    leave_out(&format!("the generated {of} client, whose tools are not there; run tests/clients/install"));
    None
}

/// Says aloud that a test is left out.
fn leave_out(what: &str) {
    assert!(std::env::var_os("VOLITION_CLIENTS").is_none(), "VOLITION_CLIENTS is set, and {what}");
    std::io::stderr().write_all(format!("\nLEFT OUT: {what}\n").as_bytes()).unwrap();
}

/// Whether a program can be started at all.
fn starts(program: &Path) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success())
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

/// The Python with the tools where they are installed, or else the system's.
fn python() -> PathBuf {
    let own = root().join("target/clients/venv/bin/python");
    if own.exists() { own } else { PathBuf::from("python3") }
}

#[test]
fn the_python_package_does_the_whole_round() {
    let python = python();
    if !starts(&python) {
        return leave_out("clients/python, since there is no python3");
    }
    let source = root().join("clients/python/src");
    let script = root().join("tests/clients/python/ten_functions.py");
    let mypy = python.with_file_name("mypy");
    if mypy.exists() {
        let cache = root().join("target/clients/mypy");
        run(Command::new(mypy)
            .args(["--strict", "--ignore-missing-imports", "--cache-dir"])
            .arg(cache)
            .arg(source.join("volition_lab")));
    }
    let databases = tempfile::tempdir().unwrap();
    let server = Server::start(&databases.path().join("clients.db"), &[]);
    let said = run(Command::new(python)
        .env("PYTHONPATH", source)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .arg(script)
        .arg(&server.url));
    for missing in said.lines().filter(|line| line.starts_with("LEFT OUT")) {
        leave_out(&format!("a part of clients/python: {missing}"));
    }
    assert!(said.contains("python: ten functions"), "{said}");
}

#[test]
fn the_matlab_file_does_the_whole_round() {
    let octave = Path::new("octave-cli");
    if !starts(octave) {
        return leave_out("clients/matlab, since there is no octave-cli");
    }
    let databases = tempfile::tempdir().unwrap();
    let server = Server::start(&databases.path().join("clients.db"), &[]);
    let said = run(Command::new(octave)
        .args(["--norc", "--quiet", "--path"])
        .arg(root().join("clients/matlab"))
        .env("VOLITION_URL", &server.url)
        .arg(root().join("tests/clients/matlab/ten_functions.m")));
    assert!(said.contains("matlab: ten functions"), "{said}");
}
