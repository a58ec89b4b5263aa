//! Exit codes and words of the command line.

use crate::process::harness::volition;
use serde_json::{Value, json};
use std::io::Write as _;
use std::process::{Output, Stdio};

fn run(document: &str) -> Output {
    let mut child =
        volition(&["run", "-"]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(document.as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

fn problem(output: &Output) -> Value {
    assert!(output.stdout.is_empty(), "a problem goes to standard error alone");
    serde_json::from_slice(&output.stderr).unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)))
}

/// Zhang 2015, section 2.6: Gp = 4/(s+2), Gff = (2.1s+3)/(s+6.5), Gfb = 5.4/(s+7.1), noiseless at 0.2πk rad/s.
fn example() -> Value {
    use volition::control::{Continuous, TransferFunction};
    let continuous = |num: &[f64], den: &[f64]| TransferFunction::new(num, den, Continuous).unwrap();
    let plant = continuous(&[4.0], &[1.0, 2.0]);
    let feedforward = continuous(&[2.1, 3.0], &[1.0, 6.5]);
    let feedback = continuous(&[5.4], &[1.0, 7.1]);
    let omega: Vec<f64> = (1..=20).map(|k| 0.2 * std::f64::consts::PI * f64::from(k)).collect();
    let h: Vec<[f64; 2]> = omega
        .iter()
        .map(|w| {
            let (g, ff, fb) = (plant.response(*w), feedforward.response(*w), feedback.response(*w));
            let h = g * (ff + fb) / (1.0 + g * fb);
            [h.re, h.im]
        })
        .collect();
    let axis = json!([{"from": 3.4, "to": 8.0, "step": 0.1}]);
    json!({
        "kind": "ssid",
        "inputs": {
            "plant": {"num": [4.0], "den": [1.0, 2.0], "sample_time_s": null},
            "frequency_response": {"omega_rad_s": omega, "h": h}
        },
        "spec": {
            "pool": {"grid": {
                "feedforward_denominator": axis, "feedback_numerator": axis, "feedback_denominator": axis
            }, "stability_margin": 0.0},
            "feedforward_numerator_degree": 1
        }
    })
}

#[test]
fn run_answers_the_inverse_problem() {
    // Continuous a = b = 1, K = 3: Q = 3 R.
    let output = run(r#"{"kind": "inverse_lqr", "inputs": {"a": [[1]], "b": [[1]], "k": [[3]]}}"#);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["result"]["verdict"], "feasible");
    assert!((report["result"]["alpha"].as_f64().unwrap() - 3.0).abs() < 1e-7);
    let output = run(r#"{"kind": "inverse_lqr", "inputs": {"a": [[1, 0]], "b": [[1]], "k": [[3]]}}"#);
    assert_eq!(output.status.code(), Some(2));
    let problem = problem(&output);
    assert_eq!(problem["where"], "/inputs/a");
    assert!(problem["detail"].as_str().unwrap().contains("1x2"), "{problem}");
}

#[test]
fn run_writes_the_report_and_exits_with_0() {
    let output = run(&example().to_string());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["kind"], "ssid");
    let coefficients = |which: &str, part: &str| -> Vec<f64> {
        serde_json::from_value(report["result"][which][part].clone()).unwrap()
    };
    for (which, part, expected) in [
        ("feedforward", "num", &[2.1, 3.0][..]),
        ("feedforward", "den", &[1.0, 6.5]),
        ("feedback", "num", &[5.4]),
        ("feedback", "den", &[1.0, 7.1]),
    ] {
        let found = coefficients(which, part);
        assert_eq!(found.len(), expected.len(), "{which} {part}: {found:?}");
        for (a, b) in found.iter().zip(expected) {
            assert!((a - b).abs() < 1e-9, "{which} {part}: {found:?}");
        }
    }
    assert!(report["provenance"]["wall_time_s"].as_f64().unwrap() > 0.0);
}

/// One row and one column, written as matrices: the multivariable form, exact recovery of a static gain and an FIR
/// filter.
#[test]
fn run_takes_matrices_of_frequency_data() {
    use num_complex::Complex64;
    let omega: Vec<f64> = (1..=12).map(|k| 0.2 * f64::from(k)).collect();
    let h: Vec<_> = omega
        .iter()
        .map(|w| {
            let z = Complex64::from_polar(1.0, *w);
            let (g, ff, fb) = (0.4 / (z - 0.9), 0.7 - 0.2 / z, 0.5);
            let h = g * (ff + fb) / (1.0 + g * fb);
            [[[h.re, h.im]]]
        })
        .collect();
    let mut document = json!({
        "kind": "ssid_mimo",
        "inputs": {
            "plant": {"transfer_functions": [[{"num": [0.4], "den": [1.0, -0.9]}]], "sample_time_s": 1.0},
            "frequency_response": {"omega_rad_s": omega, "h": h}
        },
        "spec": {"pool": {"matrix_grid": {"feedback_numerator": [[[{"from": -1, "to": 1, "step": 0.1}]]]}},
                 "feedforward_order": 1}
    });
    let output = run(&document.to_string());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["kind"], &report["schema"]), (&json!("ssid_mimo"), &json!("volition.ssid_mimo/1")));
    assert_eq!(report["result"]["feedback"]["numerator"], json!([[[0.5]]]));
    let feedforward: Vec<f64> =
        serde_json::from_value(report["result"]["feedforward"]["numerator"][0][0].clone()).unwrap();
    assert!((feedforward[0] - 0.7).abs() < 1e-12 && (feedforward[1] + 0.2).abs() < 1e-12, "{feedforward:?}");

    document["inputs"]["frequency_response"]["h"][4] = json!([[[1.0, 0.0], [0.0, 0.0]]]);
    let output = run(&document.to_string());
    assert_eq!(output.status.code(), Some(2));
    let words = problem(&output);
    assert_eq!(words["where"], "/inputs/frequency_response/h/4", "{words}");
    assert!(words["detail"].as_str().unwrap().contains("is 1x2, and must be 1x1"), "{words}");
}

#[test]
fn run_estimates_from_two_stimuli() {
    use num_complex::Complex64;
    use volition::control::{Continuous, TransferFunction};
    // 1/s, feedback 2.5 e^{−0.15 s}/(0.3 s + 1), feedforward 0.7 s e^{−0.2 s}/(0.1 s + 1).
    let plant = TransferFunction::new(&[1.0], &[1.0, 0.0], Continuous).unwrap();
    let laws = |w: f64| {
        let s = Complex64::new(0.0, w);
        (2.5 * (-0.15 * s).exp() / (1.0 + 0.3 * s), 0.7 * s * (-0.2 * s).exp() / (1.0 + 0.1 * s))
    };
    let omega: Vec<f64> = (1..=12).map(|k| 0.6 * f64::from(k)).collect();
    let (mut h_yr, mut h_yd) = (Vec::new(), Vec::new());
    for w in &omega {
        let (g, (fb, ff)) = (plant.response(*w), laws(*w));
        let (r, d) = (g * (ff + fb) / (1.0 + g * fb), g / (1.0 + g * fb));
        h_yr.push([r.re, r.im]);
        h_yd.push([d.re, d.im]);
    }
    let document = json!({
        "kind": "two_stimulus",
        "inputs": {
            "plant": {"num": [1.0], "den": [1.0, 0.0], "sample_time_s": null},
            "frequency_response": {"omega_rad_s": omega, "h_yr": h_yr, "h_yd": h_yd}
        }
    });
    let output = run(&document.to_string());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    for (line, w) in report["result"]["lines"].as_array().unwrap().iter().zip(&omega) {
        let (fb, ff) = laws(*w);
        for (which, truth) in [("feedback", fb), ("feedforward", ff)] {
            let value: [f64; 2] = serde_json::from_value(line[which]["value"].clone()).unwrap();
            assert!((Complex64::new(value[0], value[1]) - truth).norm() < 1e-9, "{which} at {w}: {value:?} {truth}");
        }
    }
    let mut alone = document.clone();
    alone["inputs"]["frequency_response"]["h_yd"] = json!(vec![Value::Null; omega.len()]);
    let refused = run(&alone.to_string());
    assert_eq!(refused.status.code(), Some(1));
    assert_eq!(problem(&refused)["code"], "not_identifiable");
}

#[test]
fn the_same_document_gives_the_same_result() {
    let hash = |output: Output| -> Value {
        serde_json::from_slice::<Value>(&output.stdout).unwrap()["provenance"]["result_sha256"].clone()
    };
    let document = example().to_string();
    assert_eq!(hash(run(&document)), hash(run(&document)));
}

#[test]
fn bad_input_exits_with_2_and_says_where() {
    let mut unknown = example();
    unknown["kind"] = json!("telepathy");
    let mut stored = example();
    stored["inputs"] = json!({"trial": "0190b3e0-0000-7000-8000-000000000001"});
    let mut field = example();
    field["spec"]["poool"] = json!(1);
    let mut twins = example();
    let lines = &mut twins["inputs"]["frequency_response"]["omega_rad_s"];
    lines[3] = lines[2].clone();
    for (document, location) in [
        ("{".to_owned(), "line 1"),
        ("[]".to_owned(), "line 1"),
        (String::new(), "line 1"),
        (unknown.to_string(), "/kind"),
        (stored.to_string(), "/inputs"),
        (field.to_string(), "/spec"),
        (twins.to_string(), "/inputs/frequency_response"),
    ] {
        let output = run(&document);
        let problem = problem(&output);
        assert_eq!(output.status.code(), Some(2), "{problem}");
        assert!(problem["where"].as_str().unwrap().starts_with(location), "{problem}");
        for part in ["title", "detail", "code"] {
            assert!(!problem[part].as_str().unwrap().is_empty(), "{problem}");
        }
    }
}

#[test]
fn other_addresses_than_loopback_are_refused_with_the_reason() {
    for address in ["0.0.0.0:0", "[::]:0", "192.0.2.1:80"] {
        let output = volition(&["serve", "--listen", address, "--database", "/nowhere/volition.db"]).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        let words = String::from_utf8(output.stderr).unwrap();
        assert!(words.contains("refusing to listen on") && words.contains("access tokens"), "{words}");
    }
}

#[test]
fn a_database_that_is_none_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.txt");
    std::fs::write(&path, "these are my notes, and no database at all. ".repeat(100)).unwrap();
    let output = volition(&["migrate", "--database", path.to_str().unwrap()]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8(output.stderr).unwrap().contains("notes.txt"));
    assert!(std::fs::read_to_string(&path).unwrap().starts_with("these are my notes"), "the file was touched");
}

#[test]
fn the_openapi_command_writes_the_committed_document() {
    let output = volition(&["openapi"]).output().unwrap();
    let committed = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/openapi.json");
    assert_eq!(String::from_utf8(output.stdout).unwrap(), std::fs::read_to_string(committed).unwrap());
}

#[test]
fn run_keeps_trees_in_the_users_cache_or_where_it_is_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let omega = [0.7, 1.1, 1.6, 2.2, 2.6, 3.0];
    let h: Vec<[f64; 2]> = omega.iter().map(|w: &f64| [w.cos(), -w.sin()]).collect();
    let document = json!({
        "kind": "ssid",
        "inputs": {"plant": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null},
                   "frequency_response": {"omega_rad_s": omega, "h": h}},
        "spec": {"refine": false, "pool": {"name": "zhang2015_appendix_b",
                 "thin": {"poles": 8, "feedforward_poles": 6, "zeros": 8, "damping": 4, "gains": 2}}}
    });
    let run = |more: &[&str]| {
        let mut command = volition(&["run", "-"]);
        command.args(more).current_dir(folder.path()).env("VOLITION_LOG", "info").stdin(Stdio::piped());
        command.env("XDG_CACHE_HOME", folder.path().join("user"));
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        child.stdin.take().unwrap().write_all(document.to_string().as_bytes()).unwrap();
        let output = child.wait_with_output().unwrap();
        let log = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{log}");
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let said = |words: &str| log.lines().filter(|line| line.contains(words)).count();
        (report["provenance"]["result_sha256"].clone(), [said("kept in the cache"), said("read from the cache")])
    };
    let (result, said) = run(&["--cache-gib", "0"]);
    assert_eq!(said, [0, 0]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    if cfg!(target_os = "linux") {
        assert_eq!(run(&[]), (result.clone(), [2, 0]));
        assert_eq!(run(&[]), (result.clone(), [0, 2]));
        assert!(folder.path().join("user/volition").is_dir());
    }
    assert_eq!(run(&["--cache", "trees"]), (result.clone(), [2, 0]));
    assert_eq!(run(&["--cache", "trees"]), (result.clone(), [0, 2]));
    assert_eq!(run(&["--cache", "trees", "--cache-gib", "0"]), (result, [0, 0]));
    let output = volition(&["run", "-", "--cache-gib=-1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
}

#[tokio::test]
async fn figures_of_a_study_are_written() {
    use volition::store::{NewStudy, Store, StudyReading};
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("lab.db");
    let store = Store::open(Some(&database)).await.unwrap();
    let study = NewStudy {
        name: "two groups".into(),
        description: String::new(),
        display_limit: None,
        reading: StudyReading::default(),
    };
    store.create_study(study, None).await.unwrap();
    store.close().await;
    let out = folder.path().join("drawn");
    let (database, path) = (database.to_str().unwrap(), out.to_str().unwrap());
    let call = |more: &[&str]| {
        let words = [&["figures", "two groups", "--database", database, "--out", path], more].concat();
        volition(&words).stdout(Stdio::piped()).stderr(Stdio::piped()).output().unwrap()
    };
    let done = call(&["--format", "svg", "--width", "320"]);
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let printed = String::from_utf8(done.stdout).unwrap();
    assert_eq!(printed.lines().count(), 17, "{printed}");
    for line in printed.lines() {
        let text = std::fs::read_to_string(line).unwrap();
        // The width of a column of a paper, in its own measure.
        assert!(text.starts_with("<svg ") && text.contains("width=\"84.67mm\""), "{line}: {text:.200}");
    }
    // What a publication shows; a study without trials has nobody's signals.
    for (name, count) in [("zhang2015_chapter_3", 6), ("zhang2015_chapter_5", 13)] {
        let done = call(&["--like", name]);
        assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
        let printed = String::from_utf8(done.stdout).unwrap();
        assert_eq!(printed.lines().count(), count, "{printed}");
        let first = std::fs::read_to_string(out.join("controllers_first.svg")).unwrap();
        assert!(first.contains("on the first trial"), "{first:.400}");
    }
    let unknown = call(&["--like", "zhang2016"]);
    assert_eq!(unknown.status.code(), Some(1));
    let said = String::from_utf8_lossy(&unknown.stderr).into_owned();
    assert!(said.contains("zhang2015_chapter_3, zhang2015_chapter_5, qiu2021"), "{said}");
    let of_an_analysis = call(&["--like", "priess2015_chapter_5"]);
    assert_eq!(of_an_analysis.status.code(), Some(1));
    let said = String::from_utf8_lossy(&of_an_analysis.stderr).into_owned();
    assert!(said.contains("shows an analysis, and this is a study"), "{said}");
    let refused = call(&["--format", "pdf"]);
    assert_eq!(refused.status.code(), Some(2));
    assert_eq!(problem(&refused)["where"], "query parameter format");
}

/// A recording of a lag of one second as a lab has it, with names and a unit of its own.
fn recording(folder: &std::path::Path, with_gap: bool) -> std::path::PathBuf {
    let mut text = "Time;Target;Stick;Cursor\n".to_owned();
    let (mut y, keep) = (0.0_f64, (-0.02_f64).exp());
    for i in 0..400 {
        let t = 20 * i;
        let r = (0.05 * f64::from(i)).sin();
        let u = 4.0 * (r - y);
        if !(with_gap && (100..103).contains(&i)) {
            text.push_str(&format!("{t};{r};{u};{y}\n").replace('.', ","));
        }
        y = keep * y + (1.0 - keep) * u;
    }
    let path = folder.join("s01.csv");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn check_says_what_a_file_is_and_how_to_import_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = recording(folder.path(), false);
    let check = |more: &[&str]| volition(&[&["check", path.to_str().unwrap()], more].concat()).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();

    let unnamed = check(&[]);
    assert_eq!(unnamed.status.code(), Some(2));
    let said = text(&unnamed.stderr);
    assert!(said.contains("at: row 1") && said.contains("--columns t:Time,r:Target,u:Stick,y:Cursor"), "{said}");

    let named = ["--columns", "t:Time,r:Target,u:Stick,y:Cursor"];
    let unsaid = text(&check(&named).stdout);
    assert!(unsaid.contains("implausible_sample_time") && unsaid.contains("--time-unit ms (0.02 s apart)"), "{unsaid}");

    let whole = [&named[..], &["--time-unit", "ms", "--plant", "1/(s+1)"]].concat();
    let good = check(&whole);
    assert_eq!(good.status.code(), Some(0), "{}", text(&good.stderr));
    let said = text(&good.stdout);
    for words in [
        "cells between semicolons, numbers with a decimal comma; row 1 names the columns; rows 2 to 401 are samples",
        "Time is in ms, as was given.",
        "400 samples, 0.02 s apart: 8 s",
        "G u explains 100.00 % of y",
        "--plant '1/(s+1)' --columns t:Time,r:Target,u:Stick,y:Cursor --time-unit ms",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    assert!(!said.contains("warning"), "{said}");
    // The commands do what they say.
    let commands: Vec<&str> = said.lines().skip_while(|line| !line.contains("to import it")).skip(1).collect();
    let script = commands.join("\n").replace("volition import", "\"$VOLITION\" import --database lab.db");
    let output = std::process::Command::new("sh")
        .args(["-c", &script])
        .env("VOLITION", env!("CARGO_BIN_EXE_volition"))
        .current_dir(folder.path())
        .output()
        .unwrap();
    let imported = text(&output.stdout);
    assert!(imported.contains("1 trials imported"), "{imported}{}", text(&output.stderr));

    let report: Value = serde_json::from_slice(&check(&[&whole[..], &["--json"]].concat()).stdout).unwrap();
    assert_eq!((&report["samples"], &report["understood"]["delimiter"]), (&json!(400), &json!("semicolon")));
    assert!(report["explained_output"].as_f64().unwrap() > 0.999, "{report}");

    recording(folder.path(), true);
    let gap = check(&[&whole[..], &["--json"]].concat());
    assert_eq!(gap.status.code(), Some(2));
    let problem: Value = serde_json::from_slice(&gap.stderr).unwrap();
    assert_eq!(problem["where"], "row 102, column Time");
    assert!(problem["detail"].as_str().unwrap().contains("3 samples are missing"), "{problem}");
}

#[test]
fn run_takes_files_in_the_place_of_trials() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path(), false);
    let document = |trial: Value| {
        let document = json!({"kind": "frequency_response", "inputs": {"trial": trial}, "spec": {}});
        let path = folder.path().join("request.json");
        std::fs::write(&path, document.to_string()).unwrap();
        volition(&["run", path.to_str().unwrap()]).output().unwrap()
    };
    let described = json!({"file": "s01.csv", "columns": "t:Time,r:Target,u:Stick,y:Cursor", "time_unit": "ms"});
    let output = document(described.clone());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["kind"], "frequency_response");

    for (trial, place) in [
        (json!("s01.csv"), "/inputs/trial, file s01.csv, row 1"),
        (json!("s02.csv"), "/inputs/trial, file s02.csv, "),
        (json!({"file": "s01.csv", "unit": "ms"}), "/inputs/trial"),
    ] {
        let output = document(trial);
        assert_eq!(output.status.code(), Some(2));
        let problem = problem(&output);
        assert!(problem["where"].as_str().unwrap().starts_with(place), "{problem}");
    }
}
