//! What a recording must satisfy: said at its upload, kept with the trial, repeated in the reports that use it.

use crate::api::harness::{Lab, TestServer};
use serde_json::{Value, json};
use std::io::Read as _;
use std::path::Path;

fn case(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases/csv").join(name);
    let file = std::fs::File::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut text = String::new();
    flate2::read::GzDecoder::new(file).read_to_string(&mut text).unwrap();
    text
}

fn codes(warnings: &Value) -> Vec<&str> {
    warnings.as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap()).collect()
}

/// The plant of the cases, Zhang's minimum-phase one of chapter 5.
async fn lab(server: &TestServer) -> Lab {
    let mut lab = server.lab().await;
    let body = json!({"name": "chapter five", "model": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0]}});
    lab.plant = server.post(&format!("/v1/studies/{}/plants", lab.study), &body).await.id(201);
    lab
}

#[tokio::test]
async fn every_case_is_told_and_kept_and_stands_in_the_report() {
    let server = TestServer::start().await;
    let lab = lab(&server).await;
    for (number, (name, expected)) in [
        ("F13_csv_time_us_clean.csv.gz", "implausible_sample_time"),
        ("F14_csv_time_index.csv.gz", "implausible_sample_time"),
        ("ms.csv.gz", "implausible_sample_time"),
        ("uzero.csv.gz", "constant_channel"),
        ("swapped.csv.gz", "channels_exchanged"),
    ]
    .into_iter()
    .enumerate()
    {
        let made = server.upload_csv(&lab, &format!("&number={}", number + 1), case(name)).await.json(201);
        let kept = &made["recording_warnings"];
        assert!(codes(kept).contains(&expected), "{name}: {kept}");
        assert!(codes(&made["warnings"]).contains(&expected), "{name}: {made}");
        let stored = server.get(&format!("/v1/trials/{}", made["id"].as_str().unwrap())).await.json(200);
        assert_eq!(&stored["recording_warnings"], kept, "{name}");
        if name == "uzero.csv.gz" {
            assert!(codes(kept).contains(&"output_not_from_control"), "{kept}");
        }

        let request = json!({"kind": "frequency_response", "inputs": {"trial": made["id"]},
            "spec": {"output": "error"}});
        let analysis = server.post("/v1/analyses", &request).await.id(202);
        server.work().await;
        let view = server.get(&format!("/v1/analyses/{analysis}")).await.json(200);
        if view["status"] != "succeeded" {
            // Exchanged columns and constant ones may leave nothing to transform; then there is no report.
            continue;
        }
        let report = server.get(&format!("/v1/analyses/{analysis}/report")).await.json(200);
        let first = &report["warnings"][0];
        assert_eq!(first["code"], kept[0]["code"], "{name}: {}", report["warnings"]);
        assert!(first["message"].as_str().unwrap().contains(made["id"].as_str().unwrap()), "{first}");
    }
    server.finish().await;
}

/// Files of labs, over HTTP: what was understood stands in the answer, and what was done stays with the trial.
#[tokio::test]
async fn what_was_understood_is_answered_and_what_was_done_is_kept() {
    let server = TestServer::start().await;
    let lab = lab(&server).await;
    let german = server.upload_csv(&lab, "&number=1", case("excel_de.csv.gz")).await.json(201);
    let known = &german["understood"];
    assert_eq!(
        (&known["format"], &known["delimiter"], &known["decimal_mark"], &known["header_row"], &known["first_row"]),
        (&json!("text"), &json!("semicolon"), &json!("comma"), &json!(1), &json!(2)),
    );
    assert_eq!(known["columns"][0], json!({"signal": "t", "name": "t", "unit": null}));
    assert!(known["words"][0].as_str().unwrap().contains("cells between semicolons"), "{known}");

    // The same recording, with other names and in milliseconds.
    let query = "&number=2&columns=t:Time,r:Target,u:Joystick,y:Cursor";
    let named = server.upload_csv(&lab, query, case("wrongnames.csv.gz")).await.json(200);
    assert_eq!((&named["duplicate"], &named["id"]), (&json!(true), &german["id"]));
    let ms = server.upload_csv(&lab, "&number=2&time_unit=ms", case("ms.csv.gz")).await.json(200);
    assert_eq!((&ms["sample_time_s"], &ms["understood"]["time_unit"]), (&json!(0.02), &json!("ms")));

    // Uneven times are refused by rows, and resampled on request, which stays with the trial.
    let uneven = server.upload_csv(&lab, "&number=3", case("F19_csv_fluctuating_90_82.csv.gz")).await;
    let problem = uneven.problem(422, "bad_signal");
    assert_eq!(problem["where"], "row 152, column t");
    assert!(problem["mend"].as_str().unwrap().contains("resample=linear"), "{problem}");
    let even = server.upload_csv(&lab, "&number=3&resample=linear", case("F19_csv_fluctuating_90_82.csv.gz")).await;
    let even = even.json(201);
    assert_eq!(even["understood"]["resampled"], true);
    let stored = server.get(&format!("/v1/trials/{}", even["id"].as_str().unwrap())).await.json(200);
    assert!(codes(&stored["recording_warnings"]).contains(&"resampled"), "{stored}");

    // Whatever the media type says, the content decides.
    let path = format!("/v1/subjects/{}/trials?plant={}&number=4", lab.subject, lab.plant);
    for (media, body) in [
        ("text/tab-separated-values", case("F26_csv_bids_tsv_header.csv.gz").replace("n/a", "0.03")),
        ("text/plain", case("F25_csv_space_delim.csv.gz")),
        ("application/octet-stream", case("F16_csv_savetxt_default_fs.csv.gz")),
    ] {
        let path = path.replace("number=4", &format!("number={}", 4 + media.len()));
        let made = server.send(server.request("POST", &path).header("content-type", media).body(body)).await;
        assert_eq!(made.json(201)["understood"]["format"], "text", "{media}");
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/matlab");
    let mat = std::fs::read(folder.join("runs.mat")).unwrap();
    let path = format!("{path}&columns=r:runs(2).signals.r&sample_time_s=0.02").replace("number=4", "number=90");
    let mat = server.send(server.request("POST", &path).header("content-type", "application/octet-stream").body(mat));
    assert_eq!(mat.await.json(201)["understood"]["format"], "matlab_5");

    // An archived folder is a form of its files; tables of Motion-BIDS take what stands beside them.
    let rows =
        |shift: usize| (0..30).map(|i| format!("{}\t{}\t{}", i, 3 * i + shift, 2 * i)).collect::<Vec<_>>().join("\n");
    let channels = "name\ttype\tunits\ntarget\tPOS\tmm\nstick\tMISC\tN\ncursor\tPOS\tmm\n";
    let mut files = vec![("dataset_description.json".to_owned(), "{}".to_owned())];
    for run in 1..=2 {
        let stem = format!("sub-01/motion/sub-01_task-track_run-{run}");
        files.push((format!("{stem}_motion.tsv"), rows(run)));
        files.push((format!("{stem}_channels.tsv"), channels.to_owned()));
        files.push((format!("{stem}_motion.json"), r#"{"SamplingFrequency": 50}"#.to_owned()));
    }
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, text) in &files {
        writer.start_file(name.as_str(), zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut writer, text.as_bytes()).unwrap();
    }
    let archive = writer.finish().unwrap().into_inner();
    let path = format!("/v1/subjects/{}/trials?plant={}&session=5", lab.subject, lab.plant);
    let path = format!("{path}&columns=r:target,u:stick,y:cursor");
    let made = server.send(server.request("POST", &path).header("content-type", "application/zip").body(archive)).await;
    let made = made.json(201);
    assert_eq!(made["items"].as_array().unwrap().len(), 2);
    let second = &made["items"][1];
    assert_eq!(
        (&second["sample_time_s"], &second["samples"], &second["number"]),
        (&json!(0.02), &json!(30), &json!(2))
    );
    assert!(second["file"].as_str().unwrap().ends_with("run-2_motion.tsv"), "{second}");

    for (query, place) in [
        ("&time_unit=min", "query parameter time_unit"),
        ("&resample=cubic", "query parameter resample"),
        ("&columns=stick", "query parameter columns"),
    ] {
        let problem = server.upload_csv(&lab, query, case("ms.csv.gz")).await.problem(400, "malformed");
        assert_eq!(problem["where"], place);
    }
    let path = format!("/v1/subjects/{}/trials?plant={}&columns=r:a", lab.subject, lab.plant);
    let mapped = server.post(&path, &json!({"sample_time_s": 0.02, "r": [0, 1], "u": [0, 1], "y": [0, 1]})).await;
    assert_eq!(mapped.problem(400, "malformed")["where"], "query parameter columns");
    server.finish().await;
}

/// A trial as the plant answers, with a time column or without.
fn tracking(step: f64, gain: f64) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let (mut r, mut u, mut y) = (Vec::new(), Vec::new(), Vec::new());
    let keep = (-step).exp();
    let mut state = 0.0;
    for i in 0..600 {
        let t = step * f64::from(i);
        r.push((1.3 * t).sin());
        y.push(state);
        u.push(gain * (r[i as usize] - state));
        state = keep * state + (1.0 - keep) * u[i as usize];
    }
    (r, u, y)
}

#[tokio::test]
async fn a_good_recording_has_no_warning_and_is_known_in_another_format() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let body = json!({"name": "lag", "model": {"num": [1.0], "den": [1.0, 1.0]}});
    lab.plant = server.post(&format!("/v1/studies/{}/plants", lab.study), &body).await.id(201);
    let (r, u, y) = tracking(0.02, 4.0);
    let rows: Vec<String> = (0..600).map(|i| format!("{},{},{},{}", 0.02 * i as f64, r[i], u[i], y[i])).collect();
    let csv = format!("t,r,u,y\n{}\n", rows.join("\n"));
    let made = server.upload_csv(&lab, "&number=1", csv).await.json(201);
    assert_eq!((&made["recording_warnings"], &made["warnings"]), (&json!([]), &json!([])));

    let path = format!("/v1/subjects/{}/trials?plant={}&number=2", lab.subject, lab.plant);
    let as_json = server.post(&path, &json!({"sample_time_s": 0.02, "r": r, "u": u, "y": y})).await.json(200);
    assert_eq!((&as_json["duplicate"], &as_json["id"]), (&json!(true), &made["id"]));
    // At another rate the same numbers are another recording, and on this plant no possible one.
    let slower = server.post(&path, &json!({"sample_time_s": 0.2, "r": r, "u": u, "y": y})).await.json(201);
    assert_eq!(slower["duplicate"], json!(false));
    server.finish().await;
}

#[tokio::test]
async fn what_files_do_not_say_is_said_once_for_a_study() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let study = format!("/v1/studies/{}", lab.study);
    assert_eq!(server.get(&study).await.json(200)["reading"], serde_json::json!({}));
    let rows = |names: &str, offset: usize| {
        let mut text = format!("{names}\n");
        for i in 0..60 {
            let x = ((i + offset) as f64 * 0.3).sin();
            text.push_str(&format!("{},{x},{},{}\n", 20 * i, 0.5 * x, 0.1 * x));
        }
        text
    };
    let foreign = rows("Clock,Target,Stick,Cursor", 0);
    server.upload_csv(&lab, "&number=1", foreign.clone()).await.problem(400, "malformed");
    // What cannot be read is refused before it is kept.
    let bad =
        server.patch(&study, &serde_json::json!({"reading": {"time_unit": "minutes"}})).await.problem(422, "invalid");
    assert_eq!(bad["where"], "/reading/time_unit");
    let reading = serde_json::json!({"columns": "t:Clock,r:Target,u:Stick,y:Cursor", "time_unit": "ms"});
    let kept = server.patch(&study, &serde_json::json!({"reading": reading})).await.json(200);
    assert_eq!(kept["reading"], reading);
    let stored = server.upload_csv(&lab, "&number=1", foreign).await.json(201);
    assert!((stored["sample_time_s"].as_f64().unwrap() - 0.02).abs() < 1e-12);
    assert_eq!(stored["understood"]["columns"][1]["name"], "Target");
    // Or with the study itself, from the start.
    let new = serde_json::json!({"name": "said at once", "reading": {"time_unit": "minutes"}});
    let bad = server.post("/v1/studies", &new).await.problem(422, "invalid");
    assert_eq!(bad["where"], "/reading/time_unit");
    let new = serde_json::json!({"name": "said at once", "reading": reading});
    assert_eq!(server.post("/v1/studies", &new).await.json(201)["reading"], reading);
    // What an upload says goes before it; a document says itself what it holds.
    let own = "&number=2&columns=t:t,r:r,u:u,y:y&time_unit=ms";
    server.upload_csv(&lab, own, rows("t,r,u,y", 7)).await.json(201);
    let values: Vec<f64> = (0..60).map(|i| f64::from(i).cos()).collect();
    let document = serde_json::json!({"sample_time_s": 0.02, "r": values, "u": values, "y": values});
    let path = format!("/v1/subjects/{}/trials?plant={}&number=3", lab.subject, lab.plant);
    server.post(&path, &document).await.json(201);
    server.finish().await;
}
