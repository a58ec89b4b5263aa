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
