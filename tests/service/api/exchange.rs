//! What goes out: tables, models, samples. Read back here, and by the programs that people use where those are
//! installed; without them those tests are left out and say so on standard error, past what the test harness captures.

use crate::api::harness::TestServer;
use crate::api::trust::identified;
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Python with pandas, scipy and python-control; `None`, said aloud, where `tests/exchange/install` has not run.
fn python(what: &str) -> Option<PathBuf> {
    let python = root().join("target/exchange/bin/python");
    if python.exists() {
        return Some(python);
    }
    let said = format!("\nLEFT OUT: {what} by Python's own programs; run tests/exchange/install\n");
    std::io::stderr().write_all(said.as_bytes()).unwrap();
    None
}

#[track_caller]
fn run(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{command:?} failed:\n{out}\n{err}");
    out
}

fn rows(bytes: &[u8]) -> (Vec<String>, Vec<Vec<String>>) {
    let mut reader = csv::Reader::from_reader(bytes);
    let columns = reader.headers().unwrap().iter().map(str::to_owned).collect();
    let rows = reader.records().map(|row| row.unwrap().iter().map(str::to_owned).collect()).collect();
    (columns, rows)
}

fn number(text: &str) -> Option<f64> {
    text.parse().ok()
}

#[tokio::test]
async fn a_study_is_one_tidy_table() {
    let server = TestServer::start().await;
    let lab = identified(&server).await;
    let study = format!("/v1/studies/{}", lab.study);
    let answer = server.get(&format!("{study}/table")).await;
    assert_eq!(answer.status, 200);
    assert_eq!(answer.headers["content-type"], "text/csv; charset=utf-8; header=present");
    let (columns, table) = rows(&answer.bytes);
    assert_eq!(columns[..4], ["study", "subject", "group", "session"]);
    assert_eq!(columns.iter().collect::<BTreeSet<_>>().len(), columns.len(), "{columns:?}");
    assert_eq!(table.len(), 12);
    let at = |row: &[String], name: &str| {
        row[columns.iter().position(|own| own == name).unwrap_or_else(|| panic!("no {name} in {columns:?}"))].clone()
    };
    // Trials in their order, and of each its analyses.
    let order: Vec<_> = table.iter().map(|row| (at(row, "subject"), at(row, "number"), at(row, "kind"))).collect();
    assert_eq!(order[0], ("s01".into(), "1".into(), "prediction_error".into()));
    assert_eq!(order[1], ("s01".into(), "1".into(), "ssid".into()));
    assert_eq!(order[11], ("s03".into(), "20".into(), "ssid".into()));
    for row in &table {
        let address = format!("/v1/analyses/{}", at(row, "analysis"));
        let report = server.get(&format!("{address}/report")).await.json(200);
        assert_eq!(at(row, "spec_sha256"), report["provenance"]["spec_sha256"]);
        assert_eq!(at(row, "product_version"), env!("CARGO_PKG_VERSION"));
        let trust = server.get(&format!("{address}/trust")).await.json(200);
        for own in trust["trust"].as_array().unwrap() {
            if own["estimator"] == "ssid_refined" {
                continue;
            }
            let name = own["quantity"].as_str().unwrap();
            assert_eq!(number(&at(row, name)), own["value"].as_f64(), "{name}");
            assert_eq!(number(&at(row, &format!("{name}_low"))), own["interval_95"][0].as_f64(), "{name}");
            if at(row, "divergent") == "false" {
                assert_eq!(at(row, &format!("trust_{name}")), own["level"], "{name}");
            }
        }
        let trial = server.get(&format!("/v1/trials/{}", at(row, "trial"))).await.json(200);
        assert_eq!(number(&at(row, "mean_abs_error")), trial["metrics"]["mean_abs_error"].as_f64());
        let warnings: Vec<&str> =
            report["warnings"].as_array().unwrap().iter().map(|own| own["code"].as_str().unwrap()).collect();
        assert_eq!(at(row, "warnings"), warnings.join(" "));
        if at(row, "kind") == "ssid" {
            for (i, value) in report["result"]["feedback"]["num"].as_array().unwrap().iter().rev().enumerate() {
                assert_eq!(number(&at(row, &format!("feedback_num_{i}"))), value.as_f64());
            }
        }
    }
    // The same as a JSON object a line, asked for either way.
    let lines = server.get(&format!("{study}/table?format=ndjson")).await;
    assert_eq!(lines.headers["content-type"], "application/x-ndjson");
    let asked = server.send(server.request("GET", &format!("{study}/table")).header("accept", "application/x-ndjson"));
    assert_eq!(asked.await.bytes, lines.bytes);
    let text = String::from_utf8(lines.bytes.clone()).unwrap();
    assert_eq!(text.lines().count(), 12);
    for (line, row) in text.lines().zip(&table) {
        let line: Value = serde_json::from_str(line).unwrap();
        assert_eq!(line.as_object().unwrap().len(), columns.len());
        assert_eq!(line["norm_feedback"].as_f64(), number(&at(row, "norm_feedback")));
    }
    // Only some analyses: trials keep their rows.
    let none = rows(&server.get(&format!("{study}/table?kind=gain_fit")).await.bytes);
    assert_eq!(none.1.len(), 6);
    assert!(!none.0.contains(&"kind".to_owned()));
    let some = rows(&server.get(&format!("{study}/table?kind=ssid")).await.bytes);
    assert_eq!(some.1.len(), 6);
    let refused = server.send(server.request("GET", &format!("{study}/table")).header("accept", "image/png")).await;
    assert_eq!(refused.status, 406);
    server.get(&format!("{study}/table?format=wav")).await.problem(400, "malformed");
    // Not modified.
    let tag = answer.headers["etag"].to_str().unwrap().to_owned();
    let again = server.send(server.request("GET", &format!("{study}/table")).header("if-none-match", tag)).await;
    assert_eq!(again.status, 304);

    if let Some(python) = python("the table of a study") {
        let folder = tempfile::tempdir().unwrap();
        let (table, table_lines) = (folder.path().join("t.csv"), folder.path().join("t.ndjson"));
        std::fs::write(&table, &answer.bytes).unwrap();
        std::fs::write(&table_lines, &lines.bytes).unwrap();
        let said = run(Command::new(python).arg(root().join("tests/exchange/table.py")).args([table, table_lines]));
        assert!(said.contains("pandas: 12 rows"), "{said}");
    }
    server.finish().await;
}

#[tokio::test]
async fn answers_about_groups_are_tables_too() {
    let server = TestServer::start().await;
    let lab = identified(&server).await;
    let study = format!("/v1/studies/{}", lab.study);
    let find = |table: &(Vec<String>, Vec<Vec<String>>), wanted: &[(&str, &str)], name: &str| {
        let at = |row: &[String], name: &str| row[table.0.iter().position(|own| own == name).unwrap()].clone();
        let found: Vec<_> =
            table.1.iter().filter(|row| wanted.iter().all(|(name, value)| at(row, name) == *value)).collect();
        assert_eq!(found.len(), 1, "{wanted:?}");
        at(found[0], name)
    };
    let curves = server.get(&format!("{study}/learning-curves")).await.json(200);
    let table = rows(&server.get(&format!("{study}/learning-curves?format=csv")).await.bytes);
    for point in curves["groups"][0]["points"].as_array().unwrap() {
        let number_text = point["number"].to_string();
        let key = [("number", number_text.as_str()), ("metric", "norm_feedback")];
        assert_eq!(number(&find(&table, &key, "mean")), point["metrics"]["norm_feedback"]["mean"].as_f64());
        assert_eq!(find(&table, &key, "n"), point["metrics"]["norm_feedback"]["n"].to_string());
    }
    let subject = server.get(&format!("/v1/subjects/{}/learning-curves", lab.subject)).await.json(200);
    let of_subject = format!("/v1/subjects/{}/learning-curves?format=csv", lab.subject);
    let table = rows(&server.get(&of_subject).await.bytes);
    let point = &subject["curves"][0]["points"][1];
    let key = [("number", "20"), ("metric", "norm_feedforward_plant_minus_one")];
    assert_eq!(number(&find(&table, &key, "value")), point["norm_feedforward_plant_minus_one"].as_f64());

    let path = format!("{study}/frequency-responses?points=3&each_subject=true");
    let responses = server.get(&path).await.json(200);
    let table = rows(&server.get(&format!("{path}&format=csv")).await.bytes);
    let omega = responses["omega_rad_s"][1].as_f64().unwrap();
    let omega_text = format!("{omega:?}");
    let key = [("of", "mean"), ("part", "feedback"), ("omega_rad_s", omega_text.as_str())];
    let mean = &responses["groups"][0]["all"]["feedback"];
    assert_eq!(number(&find(&table, &key, "gain_db")), mean["gain_of_mean_db"][1].as_f64());
    let key = [("of", "subject"), ("subject", "s02"), ("part", "feedforward"), ("omega_rad_s", omega_text.as_str())];
    let person = &responses["groups"][0]["subjects"][1]["feedforward"];
    assert_eq!(number(&find(&table, &key, "phase_deg")), person["phase_deg"][1].as_f64());

    let comparison = server.get(&format!("{study}/comparison")).await.json(200);
    let table = rows(&server.get(&format!("{study}/comparison?format=csv")).await.bytes);
    let metric = &comparison["groups"][0]["metrics"][0];
    assert_eq!((&metric["metric"], &metric["contrasts"][0]["contrast"]), (&"mean_abs_error".into(), &"first".into()));
    let key = [("of", "group"), ("metric", "mean_abs_error"), ("contrast", "first")];
    let mean = metric["contrasts"][0]["mean"]["coefficients"][0]["value"].as_f64();
    assert_eq!(number(&find(&table, &key, "value")), mean);
    server.finish().await;
}

/// Systems of several inputs and outputs, and the covariance of what was estimated.
#[tokio::test]
async fn matrices_of_systems_go_to_other_programs() {
    let server = TestServer::start().await;
    let folder = tempfile::tempdir().unwrap();
    for (kind, counts) in [("ssid_mimo", "0 models, 1 in state space, 2 matrices"), ("gain_fit", "")] {
        let request: Value = serde_json::from_str(
            volition::analysis::registry::kinds().find(|own| own.kind.name() == kind).unwrap().example,
        )
        .unwrap();
        let queued = server.post("/v1/analyses", &request).await.json(202);
        server.work().await;
        let analysis = format!("/v1/analyses/{}", queued["id"].as_str().unwrap());
        let report = server.get(&format!("{analysis}/report")).await.json(200);
        let model = server.get(&format!("{analysis}/model")).await;
        let export = model.json(200);
        if kind == "ssid_mimo" {
            let own = &export["transfer_matrices"]["feedback"];
            assert_eq!(own["pointer"], "/feedback");
            let entries = &report["result"]["feedback"]["transfer_functions"];
            assert_eq!((&own["num"][1][0], &own["den"][0][1]), (&entries[1][0]["num"], &entries[0][1]["den"]));
            assert_eq!((&own["dt"], &own["time_base"]), (&entries[0][0]["sample_time_s"], &"discrete".into()));
        } else {
            assert_eq!(export["covariance"], report["result"]["covariance"]);
            let count = export["parameters"].as_array().unwrap().len();
            assert!(count > 0 && export["covariance"].as_array().is_none_or(|rows| rows.len() == count));
        }
        let mat = server.get(&format!("{analysis}/model?format=mat")).await;
        assert_eq!(mat.headers["content-type"], "application/x-matlab-data");
        if let Some(python) = python("systems of several inputs").filter(|_| !counts.is_empty()) {
            let (json, m) = (folder.path().join("m.json"), folder.path().join("m.mat"));
            std::fs::write(&json, &model.bytes).unwrap();
            std::fs::write(&m, &mat.bytes).unwrap();
            let said = run(Command::new(&python).arg(root().join("tests/exchange/model.py")).args([json, m]));
            assert!(said.contains(counts), "{said}");
        }
    }
    server.finish().await;
}

#[tokio::test]
async fn models_and_samples_go_to_other_programs() {
    let server = TestServer::start().await;
    let lab = identified(&server).await;
    let folder = tempfile::tempdir().unwrap();
    let list = server.get(&format!("/v1/analyses?study={}&kind=ssid&limit=1", lab.study)).await.json(200);
    let analysis = format!("/v1/analyses/{}", list["items"][0]["id"].as_str().unwrap());
    let report = server.get(&format!("{analysis}/report")).await.json(200);
    let model = server.get(&format!("{analysis}/model")).await;
    let export = model.json(200);
    let feedback = &export["models"]["feedback"];
    assert_eq!(feedback["num"], report["result"]["feedback"]["num"]);
    assert_eq!(feedback["time_base"], "discrete");
    assert_eq!(feedback["dt"], feedback["sample_time_s"]);
    assert_eq!(export["models"]["plant"]["pointer"], "/plant");
    let mat = server.get(&format!("{analysis}/model?format=mat")).await;
    assert_eq!(mat.headers["content-type"], "application/x-matlab-data");
    assert!(mat.bytes.starts_with(b"MATLAB 5.0"));
    server.get(&format!("{analysis}/model?format=csv")).await.problem(400, "malformed");

    let trials = server.get(&format!("/v1/subjects/{}/trials", lab.subject)).await.json(200);
    let signals = format!("/v1/trials/{}/signals", trials["items"][0]["id"].as_str().unwrap());
    let mut scale = String::new();
    for form in ["csv", "mat", "npz", "wav"] {
        let answer = server.get(&format!("{signals}?format={form}")).await;
        assert_eq!(answer.status, 200, "{form}");
        if form == "wav" {
            scale = answer.headers["volition-full-scale"].to_str().unwrap().to_owned();
        }
        std::fs::write(folder.path().join(format!("s.{form}")), &answer.bytes).unwrap();
    }
    // What was written is read by the reader of uploads, and is the same recording.
    for form in ["mat", "npz"] {
        let bytes = std::fs::read(folder.path().join(format!("s.{form}"))).unwrap();
        let options =
            volition::exchange::Options { sample_time_s: Some(0.05), ..volition::exchange::Options::default() };
        let read = volition::exchange::read(&bytes, &options).unwrap();
        let text = std::fs::read(folder.path().join("s.csv")).unwrap();
        let written = volition::exchange::read(&text, &options).unwrap();
        assert_eq!(read.trial.signals_sha256(), written.trial.signals_sha256(), "{form}");
    }
    server.get(&format!("{signals}?format=wav&full_scale=1e-9")).await.problem(422, "invalid");
    server.get(&format!("{signals}?format=wav&column=q")).await.problem(422, "invalid");

    if let Some(python) = python("models and samples") {
        let (json, m) = (folder.path().join("m.json"), folder.path().join("m.mat"));
        std::fs::write(&json, &model.bytes).unwrap();
        std::fs::write(&m, &mat.bytes).unwrap();
        let said = run(Command::new(&python).arg(root().join("tests/exchange/model.py")).args([json, m]));
        assert!(said.contains("control: 5 models, 0 in state space"), "{said}");
        let script = root().join("tests/exchange/sequences.py");
        let said = run(Command::new(&python).arg(script).arg(folder.path()).arg(&scale));
        assert!(said.contains("the same in four forms"), "{said}");
    }
    server.finish().await;
}
