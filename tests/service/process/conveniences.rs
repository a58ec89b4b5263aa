//! What makes the command line pleasant: addresses by name, completions, manual pages, summaries, settings that are
//! misspelt, logs without colours.

use crate::process::harness::{Process, volition};
use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::Duration;

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn run(arguments: &[&str], document: &str) -> Output {
    let mut command = volition(&[&["run", "-"], arguments].concat());
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // Whoever refuses its arguments reads no document.
    if let Err(error) = child.stdin.take().unwrap().write_all(document.as_bytes()) {
        assert_eq!(error.kind(), ErrorKind::BrokenPipe, "{error}");
    }
    child.wait_with_output().unwrap()
}

/// The address that a server says it listens on, and its exit code after an interrupt.
fn served(database: &Path, arguments: &[&str]) -> (String, Option<i32>) {
    let all = [&["serve", "--database", database.to_str().unwrap()], arguments].concat();
    let mut child = volition(&all).stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    (line.trim().to_owned(), Process(child).interrupt())
}

#[test]
fn localhost_and_a_port_are_addresses() {
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("lab.db");
    for arguments in [&["--listen", "localhost:0"][..], &["--port", "0"], &["--listen", "[::1]:8080", "--port", "0"]] {
        let (said, code) = served(&database, arguments);
        let host = if arguments.contains(&"[::1]:8080") { "[::1]" } else { "127.0.0.1" };
        assert!(said.starts_with(&format!("volition listens on http://{host}:")), "{said}");
        assert_eq!(code, Some(0), "an interrupted server that drained has done what it was asked for");
    }
    for (flag, value) in [("--listen", "lab.example:80"), ("--listen", "9000"), ("--port", "70000")] {
        let refused = volition(&["serve", flag, value]).output().unwrap();
        assert_eq!(refused.status.code(), Some(2), "{flag} {value}");
    }
    for origin in ["lab.example", "https://lab.example/", "ftp://lab.example", "https://a@lab.example", "*"] {
        let refused = volition(&["serve", "--allow-origin", origin]).output().unwrap();
        let words = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{origin}: {words}");
        assert!(words.contains("--allow-origin"), "{words}");
    }
}

#[test]
fn shells_complete_and_man_has_pages() {
    for (shell, word) in [("bash", "complete -F"), ("zsh", "#compdef volition"), ("fish", "complete -c volition")] {
        let output = volition(&["completions", shell]).output().unwrap();
        let script = text(&output.stdout);
        assert!(output.status.success() && script.contains(word), "{shell}");
        assert!(script.contains("allow-origin") && script.contains("completions"), "{shell}");
    }
    assert_eq!(volition(&["completions", "csh"]).output().unwrap().status.code(), Some(2));
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    let output = volition(&["man", pages.to_str().unwrap()]).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let page = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap();
    assert!(page("volition.1").contains("Exit codes"), "{}", page("volition.1"));
    let serve = page("volition-serve.1");
    assert!(serve.starts_with(".ie") && serve.contains(".TH volition-serve 1"), "{serve}");
    assert!(serve.contains("allow\\-origin") && serve.contains("VOLITION_LISTEN"), "{serve}");
    let commands = text(&volition(&["help"]).output().unwrap().stdout);
    for name in ["worker", "migrate", "backup", "verify", "openapi", "demo", "check", "import", "run", "man"] {
        assert!(commands.contains(name) && !page(&format!("volition-{name}.1")).is_empty(), "{name}");
    }
}

#[test]
fn people_get_a_summary_and_pipes_the_report() {
    let document = r#"{"kind": "inverse_lqr", "inputs": {"a": [[1]], "b": [[1]], "k": [[3]]}}"#;
    let piped = run(&[], document);
    let report: serde_json::Value = serde_json::from_slice(&piped.stdout).unwrap();
    assert_eq!(report["result"]["verdict"], "feasible");
    let forced: serde_json::Value = serde_json::from_slice(&run(&["--json"], document).stdout).unwrap();
    assert_eq!(forced["provenance"]["result_sha256"], report["provenance"]["result_sha256"]);
    let summary = run(&["--summary"], document);
    let words = text(&summary.stdout);
    assert_eq!(summary.status.code(), Some(0), "{}", text(&summary.stderr));
    assert!(words.contains("verdict: feasible") && words.contains("alpha: 3"), "{words}");
    assert!(words.starts_with("inverse_lqr: ") && words.contains("--json") && words.lines().count() > 2, "{words}");
    assert!(!words.contains('\u{1b}') && serde_json::from_str::<serde_json::Value>(&words).is_err(), "{words}");
    let both = run(&["--json", "--summary"], document);
    assert_eq!(both.status.code(), Some(2), "one or the other");
}

#[test]
fn a_run_that_is_interrupted_says_so() {
    // A search that takes minutes.
    let axis = serde_json::json!([{"from": 0.1, "to": 60.0, "step": 0.1}]);
    let omega: Vec<f64> = (1..=20).map(|k| 0.3 * f64::from(k)).collect();
    let h: Vec<[f64; 2]> = omega.iter().map(|w| [1.0 / (1.0 + w * w), -w / (1.0 + w)]).collect();
    let document = serde_json::json!({
        "kind": "ssid",
        "inputs": {
            "plant": {"num": [4.0], "den": [1.0, 2.0], "sample_time_s": null},
            "frequency_response": {"omega_rad_s": omega, "h": h}
        },
        "spec": {"pool": {"grid": {
            "feedforward_denominator": [axis[0], axis[0]], "feedback_numerator": [axis[0], axis[0]],
            "feedback_denominator": [axis[0], axis[0]]
        }}, "feedforward_numerator_degree": 1}
    });
    let mut command = volition(&["run", "-", "--compute-threads", "1"]);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(document.to_string().as_bytes()).unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    assert!(child.try_wait().unwrap().is_none(), "the search ended before it could be interrupted");
    assert_eq!(Process(child).interrupt(), Some(130));
}

#[test]
fn a_misspelt_setting_is_named() {
    let mut command = volition(&["openapi"]);
    command.env("VOLITION_DATABSE", "x.db").env("VOLITION_LOG", "warn").env("VOLITION_DATABASE", "y.db");
    let output = command.output().unwrap();
    let words = text(&output.stderr);
    assert!(output.status.success() && words.contains("VOLITION_DATABSE"), "{words}");
    assert!(!words.contains("VOLITION_DATABASE") && !words.contains("VOLITION_LOG"), "{words}");
    // Standard error is no terminal here.
    assert!(!words.contains('\u{1b}'), "{words:?}");
}
